"""The test for which a fit finds bounds: windows, or a set observer that follows recordings to their ends."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.observer_sizes import least_seen
from jaxbound.estimation.methods import ObserverMethod
from jaxbound.estimation.observer import observer
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.models.faults import Fault
from jaxbound.models.system import LinearSystem
from jaxbound.relations.parity import ParityRelation, parity_relations
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla
from jaxbound.sets.floats.status import Status
from jaxbound.studies.identification.records import Records
from jaxbound.studies.identification.regression import Scales, courses, in_windows
from jaxbound.studies.tuning.observer_tuning import observer_scale

FEW = 2_048
"""Samples up to which a search is proved in NumPy: that takes half a millisecond each, compiling it 5 s."""
Windows = ParityRelation | UncertainRelations
Sizes = dict[str, float]
"""{output: size}."""


class Judge(ABC):
    """A test of recordings under a model and its noise: of windows, unless it says otherwise."""

    def least(self, model: LinearSystem) -> int:
        """Return the samples that a recording must have for one verdict."""
        assert model.horizon is not None, "a model that is fitted for windows has one"
        return model.horizon + 1

    @abstractmethod
    def needs(self, model: LinearSystem, parts: Records) -> list[np.ndarray]:
        """Return, an array (T,) a recording, the factor on all bounds of the model that just explains each
        window; nan where there is none.
        """

    def shares(self, model: LinearSystem, parts: Records) -> tuple[bool, list[np.ndarray]]:
        """Return (whether nothing in the recordings speaks against the model, the share of its bounds that
        each window needs, an array (T,) a recording).
        """
        needs = self.needs(model, parts)
        return not any((need > 1).any() for need in needs), needs

    @abstractmethod
    def sizes(self, model: LinearSystem, scales: Scales) -> tuple[Sizes, Sizes]:
        """Return (jump, steady): sizes of an error of one output that no noise hides; inf where there is
        none, {} where nobody can say.

        A jump begins while a test looks at it, a steady error was always there.
        """


@dataclass(frozen=True)
class WindowJudge(Judge):
    """The joint test of the windows of the model: horizon or lags.

    Fields: kept: the relations of the model that was judged last.
    """

    kept: dict[LinearSystem, Windows] = field(default_factory=dict, repr=False, compare=False)

    def _relations(self, model: LinearSystem) -> Windows:
        if model not in self.kept:
            self.kept.clear()
            self.kept[model] = parity_relations(model)
        return self.kept[model]

    def needs(self, model: LinearSystem, parts: Records) -> list[np.ndarray]:
        """Return the need of each window."""
        return [need for _, need in _tested(self._relations(model), parts)]

    def shares(self, model: LinearSystem, parts: Records) -> tuple[bool, list[np.ndarray]]:
        """Return (whether every window is CONSISTENT, the need of each)."""
        verdicts = _tested(self._relations(model), parts)
        return _all_consistent(verdicts), [need for _, need in verdicts]

    def sizes(self, model: LinearSystem, scales: Scales) -> tuple[Sizes, Sizes]:
        """Return (jump, steady): a jump begins in the middle of a window, a steady error fills it."""
        count, p = self.least(model), model.p
        wrong = (
            courses(count - 1)[:, None, :, None] * np.diag(scales.y_spread)[None, :, None]
        )  # (2, p, s + 1, p)
        y = np.array(model.offset["y"], float) + wrong
        u = None
        if model.m:
            u = np.broadcast_to(np.array(model.offset["u"], float), (2, p, count, model.m))
        relations = self._relations(model)
        with outside_xla(relations.searched or is_outside_xla()):
            margin = detect(relations, u, y, margins="exact").margin[..., -1]
        with np.errstate(divide="ignore"):  # a need grows with the size; healthy noise takes 1 of it
            sizes = np.where(1 - margin > 1e-9, 2 * scales.y_spread / (1 - margin), np.inf)
        jump, steady = (dict(zip(model.outputs, row, strict=True)) for row in sizes.tolist())
        return jump, steady


@dataclass(frozen=True)
class ObserverJudge(Judge):
    """A set observer that no healthy sample may contradict.

    Fields: method: of `observer`.
    """

    method: ObserverMethod

    def least(self, model: LinearSystem) -> int:
        """Return the samples that show the state, and one."""
        return observer(model, method=self.method).horizon + 1

    def needs(self, model: LinearSystem, parts: Records) -> list[np.ndarray]:
        """Return the factor of each recording, at all its samples."""
        watch, needs = observer(model, method=self.method), []

        def scaled(scale: float) -> SetObserver[Any]:
            return watch.of(model.replace(noise=[scale * float(x) for x in model.noise]))

        for part in parts:
            need = np.full(len(part[1]), np.nan)
            if len(need) > watch.horizon:
                need[:] = observer_scale(scaled, *part)
            needs.append(need)
        return needs

    def shares(self, model: LinearSystem, parts: Records) -> tuple[bool, list[np.ndarray]]:
        """Return (whether no sample is a FAULT, how far each is off, in units of what is allowed)."""
        watch, holds, used = observer(model, method=self.method), True, []
        for u, y, starts in parts:
            result = detect(watch, _inputs(u), y, starts=starts)
            holds &= not result.counts["FAULT"]
            used.append(1 - result.margin)
        return holds, used

    def sizes(self, model: LinearSystem, scales: Scales) -> tuple[Sizes, Sizes]:
        """Return (jump, {}): of a bias that begins, as zonotopes see it, which every method has beside it or
        is as sharp as; nothing is worked out of one that was always there.
        """
        watch = observer(model)
        jump = {}
        for name in model.outputs:
            size, _, _ = least_seen(watch, Fault(name, "bias", 1.0))
            jump[name] = size
        return jump, {}


def explains(relations: Windows, parts: Records) -> bool:
    """Return whether every window of the recordings is CONSISTENT."""
    return _all_consistent(_tested(relations, parts))


def _tested(relations: Windows, parts: Records) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return (status, need) of each recording, (T,) each; a window that lacks an input and is UNDECIDED is
    MISSING.
    """
    verdicts = []
    few = is_outside_xla() or relations.searched and sum(len(y) for _, y, _ in parts) < FEW
    for u, y, starts in parts:
        if len(y) <= relations.horizon:
            verdicts.append((np.zeros(len(y), np.int8), np.full(len(y), np.nan)))
            continue
        with outside_xla(few):
            result = detect(relations, _inputs(u), y, starts=starts, margins="exact")
        # an input that is missing may leave a window open however wide its bounds are
        lacks = np.zeros(len(y), bool)
        lacks[relations.horizon :] = in_windows(np.asarray(np.isnan(u).any(1)), relations.horizon) > 0
        silent = lacks & (result.status == Status.UNDECIDED)
        status = np.where(silent, np.int8(Status.MISSING), result.status)
        verdicts.append((status, 1 - result.margin))
    return verdicts


def _all_consistent(verdicts: Sequence[tuple[np.ndarray, np.ndarray]]) -> bool:
    """Return whether every window is CONSISTENT or MISSING."""
    return all(np.isin(status, (Status.MISSING, Status.CONSISTENT)).all() for status, _ in verdicts)


def _inputs(u: np.ndarray) -> np.ndarray | None:
    """Return inputs as `detect` takes them."""
    return u if u.shape[1] else None
