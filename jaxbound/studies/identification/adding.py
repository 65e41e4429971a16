"""A model that is widened by healthy recordings which it does not hold: by how much, and what that costs.

Each test gets the smallest factor on its bounds at which these recordings are explained: found as by `tune`,
proved as by `fit`. Bounds never become narrower, so what was held before is held.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from os import PathLike
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.consistency.monitorbank import MonitorBank
from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.monitoring import monitor, relations_of_test
from jaxbound.estimation.methods import observer_method
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.modelfile import load_model
from jaxbound.models.numbers import is_real
from jaxbound.models.statedtests import StatedTest, StatedTests
from jaxbound.models.system import FOR_OBSERVER, LinearSystem
from jaxbound.models.testmodels import model_of
from jaxbound.models.watched import NO, UNKNOWN
from jaxbound.recordings.hints import refuse_short
from jaxbound.recordings.read import recorded
from jaxbound.recordings.recording import Recording
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.sets.floats.status import Status
from jaxbound.studies.identification.bank import observer_fields
from jaxbound.studies.identification.judging import Judge, ObserverJudge, Sizes, WindowJudge
from jaxbound.studies.identification.recipe import recipe_of
from jaxbound.studies.identification.records import Records, is_pair, sample_text
from jaxbound.studies.identification.regression import Scales, scales_of
from jaxbound.studies.tuning.monitor_tuning import short_factor
from jaxbound.studies.tuning.observer_tuning import observer_scale
from jaxbound.text.names import listed
from jaxbound.text.objects import readable
from jaxbound.text.progress import reporter
from jaxbound.text.quantities import three_digits, times

MOST = 3.0
"""Bounds that have to grow by more may learn a fault."""
ATTEMPTS = 50
STEP = 1.001
"""Factor on bounds that rounding alone leaves undecided."""
NO_MODE = (
    "the monitor refutes a sample whose mode is not known, whatever the mode: give recordings with values of "
    "all that the conditions read"
)
Range: TypeAlias = tuple[float, float]


class Grown(NamedTuple):
    """The widening of one test.

    Fields: factor: on its bounds, 1 where they held. day: the number of the recording that asks for it, from
    0 on, and sample: that at which the window ends which needs the most; None: all held.
    """

    factor: float = 1.0
    day: int | None = None
    sample: int | None = None


@readable
@dataclass(frozen=True, eq=False)
class Widened:
    """A model that holds more healthy recordings, and what that costs.

    Fields:
        model: the LinearSystem, for `save_model`: with wider bounds, and ranges of inputs that hold those of
            the recordings.
        tests: {name: Grown}. days: the recordings.
        before, after: (jump, steady), {output: size}, of errors that are always seen, see `FitCheck`; steady
            is {} of observers; {} where all bounds hold.
        ranges: {input: ((low, high) before, after)} of the region of training where it grew.
    """

    model: LinearSystem
    tests: Mapping[str, Grown]
    days: Sequence[Recording]
    before: tuple[Sizes, Sizes]
    after: tuple[Sizes, Sizes]
    ranges: Mapping[str, tuple[Range, Range]]

    @property
    def factor(self) -> float:
        """The largest factor on the bounds of a test."""
        return max(grown.factor for grown in self.tests.values())

    @property
    def changed(self) -> bool:
        """Whether the model is another than before."""
        return self.factor > 1 or bool(self.ranges)

    def rows(self) -> Iterator[tuple[str, str]]:
        """Yield (label, sentence) for a reader."""
        for name, grown in self.tests.items():
            text = "its bounds hold, and stay"
            if grown.day is not None:
                where = place(self.days, grown.day, grown.sample)
                text = f"bounds {times(grown.factor)} as wide, for {where}"
            yield f"test: {name}", text
        for name, ((low, high), (least, most)) in self.ranges.items():
            text = f"{low:.6g} to {high:.6g}, now {least:.6g} to {most:.6g} {self.model.unit(name)}".rstrip()
            yield f"training: {name}", text
        if self.factor == 1:
            return
        for name in self.model.outputs:
            yield f"cost: {name}", self._cost(name)

    def _cost(self, name: str) -> str:
        """Return from which sizes on errors of an output were always seen, and are now."""
        texts = []
        for what, before, after in zip(("jumps", "lasting errors"), self.before, self.after, strict=True):
            if name in before:
                size = f"{three_digits(after[name])} {self.model.unit(name)}".rstrip()
                texts.append(f"{what} always seen from {three_digits(before[name])} on, now from {size}")
        return "; ".join(texts)


def place(days: Sequence[Recording], day: int, sample: int | None = None) -> str:
    """Return words for a sample of a recording."""
    name = days[day].source or f"recording {day + 1}"
    if sample is None:
        return name
    return f"{name} at {sample_text(days[day].label(sample), sample)}"


@where_proofs_hold(compiled=False)
def widen(
    model: ModelLike | str | PathLike[str],
    recordings: object,
    most: float = MOST,
    progress: Callable[[float], object] | None = None,
) -> Widened:
    """Widen a model by healthy recordings that it does not hold: `fit` with `add`.

    The bounds of each of its tests grow by the smallest factor under which the monitor finds no FAULT in them
    and their windows CONSISTENT; the region of training grows, the provenance says by what.

    Args:
        model: a LinearSystem, or the path of its file. recordings: one or several, as `fit` takes them.
            Bounds of a recipe for an observer, of a file, are widened for that one.
        most: bounds that would have to grow by more are refused: a fault would be learnt. progress: called
            with the share of the work done.

    Returns:
        A Widened. A recording that is held changes no bounds.

    Raises:
        OSError: no such file. ValueError: bounds would have to grow by more, with the time of the sample that
            asks for most; no factor holds the recordings; one has no window; nothing says for which
            observer bounds are; otherwise as `monitor` and `read`.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, horizon=1)
        >>> wider = widen(m, (None, [[1.0], [0.85], [0.3]]))  # |y[k-1] - 2 y[k]| <= 3 noise
        >>> wider.factor, float(wider.model.noise[0])
        (2.334, 0.2334)
    """
    if not (is_real(most) and most >= 1):
        raise ValueError(f"most is a factor >= 1 that bounds may grow by, not {most!r}")
    report = reporter(progress, "widen")
    tests = _tests_of(model)
    if isinstance(model, str | PathLike):
        model = load_model(model)
    model = as_model(model, factors=True)
    bank = monitor(model, tests)
    days = []
    for one in recordings if isinstance(recordings, list) else [recordings]:
        parts: Any = one if isinstance(one, tuple) and is_pair(one) else (one,)
        days.append(recorded(bank.plant, *parts).finite())
    for number, day in enumerate(days):  # what no test judges says nothing of bounds
        refuse_short(place(days, number), day.samples, min(watch.relations.horizon for watch in bank.watches))
    grown = _grown(bank, days, float(most))
    report(0.5)
    records = [(day.u[:, : model.m], day.y, day.starts) for day in days]
    ranges = dict(_ranges(model, records))
    if ranges:
        moved = {name: after for name, (_, after) in ranges.items()}
        region = model.replace(ranges={**model.ranges, **moved})
        inside = monitor(region, tests)
        # outside of training bounds are wider: where these alone hold a recording, it stays outside
        if any(one.factor > 1 for one in grown.values()) or _holds(inside, days):
            model, grown = region, _grown(inside, days, float(most))
        else:
            ranges = {}
    report(0.9)
    wide = _widened(model, grown)
    if wide is not model or ranges:
        source = listed((place(days, number) for number in range(len(days))), str)
        origin = f"{model.provenance.get('noise', 'not stated')}; widened by {source}"
        wide = wide.replace(provenance={**model.provenance, "noise": origin})
    widened = Widened(wide, grown, days, ({}, {}), ({}, {}), ranges)
    wider, scales = monitor(wide, tests), scales_of(records)
    if bank.conditions and any(detect(wider, day).counts["FAULT"] for day in days):
        raise ValueError(NO_MODE)
    if widened.factor > 1:
        widened = replace(widened, before=_sizes(bank, scales), after=_sizes(wider, scales))
    report(1.0)
    return widened


def _tests_of(model: object) -> StatedTests | None:
    """Return the tests of a model whose bounds are for an observer alone; None: those of its monitor.

    Raises:
        ValueError: nothing says which observer.
    """
    plant = model
    if isinstance(model, str | PathLike):
        plant = load_model(model)
    if not isinstance(plant, LinearSystem) or plant.tests or FOR_OBSERVER not in str(plant.provenance):
        return None
    why = "the bounds of this model are for an observer: state it, tests=[{'name': .., 'observer': 'joint'}]"
    if plant is model:
        raise ValueError(why)
    method = recipe_of(model, {}).observing
    if method is None:
        raise ValueError(why)
    return [{"name": f"observer {method.name}", **observer_fields(method)}]


def _seen(bank: MonitorBank, number: int, recording: Recording) -> Recording:
    """Return a recording as a test sees it: where its condition is not known, it has nothing to explain."""
    modes = bank.modes_of(recording.u)
    return bank.seen_by(number, recording, np.where(modes == UNKNOWN, NO, modes))


def _holds(bank: MonitorBank, days: Sequence[Recording]) -> bool:
    """Return whether no test of a monitor asks for wider bounds."""
    for number, watch in enumerate(bank.watches):
        if any(_need(watch.relations, _seen(bank, number, day))[0] for day in days):
            return False
    return True


def _grown(bank: MonitorBank, days: Sequence[Recording], most: float) -> dict[str, Grown]:
    """Return the widening of each test under which it holds recordings, by its name.

    Raises:
        ValueError: as `_grown_test`.
    """
    return {name: _grown_test(bank, number, days, most) for number, name in enumerate(bank.names)}


def _grown_test(bank: MonitorBank, number: int, days: Sequence[Recording], most: float) -> Grown:
    """Return the widening of one test under which it holds recordings.

    Raises:
        ValueError: it is more than `most`; no factor holds them.
    """
    test, widest = bank.plant.tests[number], Grown()
    for day, recording in enumerate(days):
        own = _seen(bank, number, recording)
        for _ in range(ATTEMPTS):
            relations = relations_of_test(bank.plant, _times(test, widest.factor))
            need, sample = _need(relations, own)
            if not need:
                break
            factor = float(short_factor(Fraction(str(widest.factor)) * Fraction(need)))
            if relations.remembers:
                factor = max(factor, _observed_factor(bank.plant, test, own))
            if factor > most:
                where, least = place(days, day, sample), f"{np.ceil(factor):.6g}"
                raise ValueError(
                    f"test {test.name!r}: {where} needs bounds {times(factor)} as wide, and then no fault "
                    f"like it is ever seen again. If it was healthy, say so by how much bounds may grow, "
                    f"--most {least}"
                )
            widest = Grown(factor, day, sample)
        else:
            raise ValueError(
                f"test {test.name!r}: no bounds were found that are proved to hold {place(days, day)}: look "
                f"at what is different in it"
            )
    return widest


def _times(test: StatedTest, factor: float) -> StatedTest:
    """Return a test whose bounds are so many times as wide."""
    if factor == 1:
        return test
    return replace(test, factor=short_factor(test.factor * Fraction(str(factor))))


def _need(relations: Relations, own: Recording) -> tuple[float, int]:
    """Return (need, sample): how many times as wide bounds have to be at least for a recording, 0 where they
    hold it, and where.

    What the recorder rounds away does not grow with the bounds, so the factor on all others is this or more.
    """
    result = detect(relations, own, margins="exact")
    refuted, margin = result.status == Status.FAULT, result.margin
    if relations.linear is not None:
        refuted = refuted | (margin <= 0)
    if not refuted.any():
        return 0.0, -1
    if relations.remembers:  # what it carries depends on its bounds: a search says by how much
        return STEP, int(np.argmax(refuted))
    sample = int(np.argmin(np.where(refuted, margin, np.inf)))
    return max(1 - float(margin[sample]), STEP), sample


def _observed_factor(plant: LinearSystem, test: StatedTest, own: Recording) -> float:
    """Return the factor on the bounds of an observer at which it follows a recording."""

    def scaled(scale: float) -> SetObserver[Any]:
        return cast("SetObserver[Any]", relations_of_test(plant, _times(test, scale)))

    return observer_scale(scaled, own.u, own.y, own.starts)


def _widened(model: LinearSystem, grown: Mapping[str, Grown]) -> LinearSystem:
    """Return a model whose tests are wider by factors; whose bounds, by the largest, where it states none."""
    factors = {name: one.factor for name, one in grown.items()}
    if max(factors.values()) == 1:
        return model
    if model.tests:
        return model.replace(tests=[_times(test, factors[test.name]) for test in model.tests])
    return model_of(model, _times(StatedTest("all"), max(factors.values())))


def _ranges(model: LinearSystem, records: Records) -> Iterator[tuple[str, tuple[Range, Range]]]:
    """Yield (input, (before, after)) of each range of training that recordings leave."""
    u = np.concatenate([one for one, _, _ in records])
    for name, (low, high) in model.ranges.items():
        column = u[:, model.inputs.index(name)]
        least, most = np.fmin.reduce(column, initial=float(low)), np.fmax.reduce(column, initial=float(high))
        if (before := (float(low), float(high))) != (after := (float(least), float(most))):
            yield name, (before, after)


def _sizes(bank: MonitorBank, scales: Scales) -> tuple[Sizes, Sizes]:
    """Return (jump, steady): the smallest errors of each output that one of the tests of a monitor is sure to
    see; of windows, where there are some.
    """
    windows = [watch for watch in bank.watches if not watch.relations.remembers]
    jumps: Sizes = {}
    lasting: Sizes = {}
    for watch in windows or bank.watches:
        own = cast(LinearSystem, watch.relations.model)
        judge: Judge = ObserverJudge(observer_method("zonotope"))
        if not watch.relations.remembers:
            relations = cast("ParityRelation | UncertainRelations", watch.relations)
            judge, own = WindowJudge({own: relations}), own.replace(**relations.span)
        jump, steady = judge.sizes(own.replace(times=None), scales)
        for sizes, more in ((jumps, jump), (lasting, steady)):
            sizes.update({name: min(size, sizes.get(name, size)) for name, size in more.items()})
    return jumps, lasting
