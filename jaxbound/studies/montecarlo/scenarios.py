"""Which fault, of which size, from when on: what a study varies, and what a fault does to a sample."""

import dataclasses
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, cast

import jax
import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.detectability import detectable
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.models.arguments import listed_argument
from jaxbound.models.faults import KINDS, Fault, refuse_unknown_signal
from jaxbound.models.numbers import is_whole
from jaxbound.models.operating_point import at_factors
from jaxbound.models.simulate import Channel
from jaxbound.models.system import LinearSystem
from jaxbound.random.threefry import Array
from jaxbound.relations.bounds import model_bounds
from jaxbound.studies.montecarlo import recursion

SIZELESS = ("stuck", "dropout")
SHIFTS = ("bias", "drift", "gain")
"""Kinds that one kernel serves."""
GRID = np.array([0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2])
"""Sizes where none are given, in units of the guaranteed one."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One fault in all its sizes and onsets.

    Fields: fault: a Fault, its size meaning nothing; None for healthy scenarios. sizes: (S,). onset: (lo,
    hi), it starts at a sample drawn uniformly from lo <= k < hi. length: samples that it lasts, at most to
    the end. guaranteed: from `detectable`, nan where it says nothing.
    """

    fault: Fault | None
    sizes: np.ndarray
    onset: tuple[int, int]
    length: int
    guaranteed: float = np.nan

    @property
    def label(self) -> str:
        """Its name, like y1:bias."""
        return "no fault" if self.fault is None else _label(self.fault)

    def spans(self, onset: np.ndarray, samples: int, relations: Relations) -> tuple[np.ndarray, np.ndarray]:
        """Return (windows wholly inside the fault, windows without a faulty sample) of scenarios with such
        onsets.

        Of an observer: samples of the fault, and those before it.
        """
        stop, horizon = np.minimum(onset + self.length, samples), relations.horizon
        if relations.remembers:
            return stop - onset, np.maximum(onset - horizon, 0)
        inside = np.maximum(stop - onset - horizon, 0)
        return inside, np.maximum(onset - horizon, 0) + np.maximum(samples - stop - horizon, 0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Act:
    """A Trial as a kernel sees it: kind is static ("shift" for bias, drift and gain), everything else
    traced.

    Fields: output, input: its number, or -1. bias, drift, gain: 1 where the fault is that. sizes (S,). first,
    span, length: of the onset.
    """

    output: Array
    input: Array
    bias: Array
    drift: Array
    gain: Array
    sizes: Array
    first: Array
    span: Array
    length: Array
    kind: str = field(metadata={"static": True})

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The fault as `models.simulate` sees it; none where there is none."""
        if self.kind == "none":
            return ()
        kind = self.kind
        for name in SHIFTS:
            if kind == "shift" and getattr(self, name):
                kind = name
        places = [None if number < 0 else int(number) for number in (self.output, self.input)]
        return (Channel(kind, *places),)


def act_of(trial: Trial, model: LinearSystem, dtype: np.dtype) -> Act:
    """Return the Act of a Trial."""
    signal, kind = None, "none"
    if trial.fault is not None:
        signal, kind = trial.fault.signal, trial.fault.kind
    first, stop = trial.onset
    return Act(
        output=np.asarray(_number_of(signal, model.outputs), np.int32),
        input=np.asarray(_number_of(signal, model.inputs), np.int32),
        bias=np.asarray(kind == "bias", dtype),
        drift=np.asarray(kind == "drift", dtype),
        gain=np.asarray(kind == "gain", dtype),
        sizes=np.asarray(trial.sizes, dtype),
        first=np.asarray(first, np.uint32),
        span=np.asarray(stop - first, np.uint32),
        length=np.asarray(trial.length, np.int32),
        kind="shift" if kind in SHIFTS else kind,
    )


def _number_of(signal: str | None, names: tuple[str, ...]) -> int:
    """Return the number of a signal, -1 where it is none of these."""
    if signal is None or signal not in names:
        return -1
    return names.index(signal)


@dataclass(frozen=True, eq=False)
class Ground:
    """The plant, the monitor and the range of a study, whatever the fault.

    Fields: model, relations: as of the study. samples: of a scenario. highest: (m,) the largest |u - offset|.
    """

    model: LinearSystem
    relations: Relations
    samples: int
    highest: np.ndarray

    def trials(
        self,
        faults: str | Fault | Sequence[str | Fault],
        sizes: Sequence[float] | dict[str, Sequence[float]] | None,
        onset: int | tuple[int, int] | None,
    ) -> list[Trial]:
        """Return a list of Trial, everything checked.

        Args:
            faults: a Fault, a text "signal:kind", a sequence of these, or none for healthy scenarios.
            sizes: None; a sequence for all faults; {"signal:kind": sequence}. onset: None, a sample, or (lo,
                hi).

        Raises:
            ValueError: an unknown signal or kind, sizes that no fault takes, onsets outside the scenario.
        """
        samples = self.samples
        if samples <= self.relations.horizon:
            raise ValueError(
                f"a scenario of {samples} samples has no window of {self.relations.horizon + 1}: take more "
                f"samples"
            )
        several: Sequence[str | Fault]
        if isinstance(faults, str | Fault):
            several = [faults]
        else:
            several = listed_argument("faults", faults, "['T1:bias']")
        named = [_fault(self.model, fault) for fault in several]
        labels = list(map(_label, named))
        if not named:
            return [Trial(None, np.zeros(1), (samples, samples + 1), 1)]
        if isinstance(sizes, dict) and (extra := sorted(set(sizes) - set(labels))):
            raise ValueError(f"sizes speak of {', '.join(extra)}, but the faults are {', '.join(labels)}")
        out = []
        for fault, stated in zip(named, several, strict=True):
            own = sizes.get(_label(fault)) if isinstance(sizes, dict) else sizes
            if own is None and isinstance(stated, Fault) and fault.size:
                own = (fault.size,)
            first, stop = _onset(onset, samples)
            if onset is None and isinstance(stated, Fault):
                first, stop = fault.start, fault.start + 1
            if not 0 <= first < stop <= samples:
                raise ValueError(
                    f"the fault {_label(fault)} must start at a sample 0 <= k < {samples}, not in "
                    f"{first}..{stop - 1}"
                )
            length = samples if fault.stop is None else fault.stop - fault.start
            each = self._sizes_of(fault, own)
            sure = self.guaranteed_size(fault, float(np.abs(each).max()))
            nothing = dataclasses.replace(fault, size=0.0, start=0, stop=None)
            out.append(Trial(nothing, each, (int(first), int(stop)), int(length), sure))
        return out

    def _sizes_of(self, fault: Fault, own: Sequence[float] | None) -> np.ndarray:
        """Return the sizes (S,) of a fault: 0 of one without sizes, those stated, or usual ones."""
        if fault.kind in SIZELESS:
            return np.zeros(1)
        if own is None:
            return self._usual_sizes(fault)
        try:
            each = np.atleast_1d(np.asarray(own, float))
        except (TypeError, ValueError):
            raise ValueError(f"sizes must be numbers, like [0.5, 1, 2], not {own!r}") from None
        if each.ndim != 1 or not each.size or not np.isfinite(each).all():
            raise ValueError(f"sizes of {_label(fault)} must be finite numbers, not {each.tolist()}")
        return each

    def largest_input(self, trial: Trial) -> np.ndarray:
        """Return the largest |v - offset| (m,) that acts on the plant, the fault included."""
        model, largest = self.model, np.array(self.highest, float)
        if trial.fault is None or trial.fault.signal not in model.inputs:
            return largest
        i, size, kind = model.inputs.index(trial.fault.signal), np.abs(trial.sizes).max(), trial.fault.kind
        level = abs(float(model.offset["u"][i]))
        added = {
            "bias": size,
            "noise": size,
            "drift": size * self.samples,
            "gain": size * (largest[i] + level),
            "dropout": level,
        }
        largest[i] += added.get(kind, 0.0)
        return largest

    def largest_room(self, trials: Sequence[Trial], dtype: np.dtype) -> np.ndarray:
        """Return the room (p,) for rounding that suffices for every trial."""
        reach = self.samples if self.relations.remembers else self.relations.horizon
        rooms = []
        for trial in trials:
            largest = self.largest_input(trial)
            rooms.append(recursion.rounding_room(self.model, reach, largest, self.samples, dtype))
        return np.asarray(np.max(rooms, 0))

    def guaranteed_size(self, fault: Fault, largest: float) -> float:
        """Return the size of a bias from which on the monitor must see it in every scenario of the study, nan
        where nothing is known.

        The operating range is what the readings of this study can come to, with a fault of that size.
        """
        model, relations, samples = self.model, self.relations, self.samples
        if relations.parts:
            sizes = [np.nan]
            for watch in relations.watches:
                if watch.when is None:  # others may not watch while the fault acts
                    own = dataclasses.replace(self, relations=watch.relations)
                    sizes.append(own.guaranteed_size(fault, largest))
            return float(np.fmin.reduce(sizes))
        if fault.kind != "bias" or relations.linear is None:
            return np.nan
        monitor = relations.linear.model
        stated = model_bounds(monitor)
        if monitor.constant_tolerance or model.d or monitor.factors or model.factors:
            return np.nan
        if any(not np.array_equal(relations.bounds[name], stated[name]) for name in stated):
            return np.nan
        size = largest
        before: tuple[float, float] | None = None
        for _ in range(8):
            # a larger range may need a larger fault, which makes a larger range: a straight line, or nearly
            trial = Trial(fault, np.array([size]), (0, 1), samples)
            _, readings = recursion.largest_reach(model, self.largest_input(trial), samples)
            readings = np.maximum(readings, 1e-9 * max(float(readings.max(initial=0)), 1e-9))
            if fault.signal in model.outputs:
                readings[model.outputs.index(fault.signal)] += size
            if not np.isfinite(readings).all():
                return np.nan
            needed = float(detectable(monitor, fault, operating_range=readings.tolist(), **relations.span))
            if needed <= size or not np.isfinite(needed):
                return needed
            slope = 0.0
            if before is not None:
                slope = (needed - before[1]) / (size - before[0])
            if slope >= 1:
                return np.inf
            size, before = 1.0001 * (needed - slope * size) / (1 - slope), (size, needed)
        return np.inf

    def _usual_sizes(self, fault: Fault) -> np.ndarray:
        """Return sizes around the one that is guaranteed to be seen as a bias, or around what the bounds
        allow.
        """
        bias, model = Fault(fault.signal), _at_one(self.model)
        bases = [np.nan]
        for test in (self.relations.parts or {"": self.relations}).values():
            plain = dataclasses.replace(self, model=model, relations=_unfactored(test))
            bases.append(plain._seen_as_bias(bias))
        base = float(np.fmin.reduce(bases))
        if fault.signal in model.outputs:
            i = model.outputs.index(fault.signal)
            _, readings = recursion.largest_reach(model, np.asarray(self.highest, float), self.samples)
            level = float(readings[i])
        else:
            i = model.inputs.index(fault.signal)
            level = float(self.highest[i])
        if not np.isfinite(base) or not base > 0:
            base = level
        if fault.kind == "tolerance":
            least = float(model.tolerance[i])
            return _rounded(least + (1 - least) * GRID[:10])
        if fault.kind == "drift":
            base = base / max(self.samples // 4, 1)
        elif fault.kind == "gain":
            base = base / level if level > 0 else 1.0
        if not np.isfinite(base) or base <= 0:
            raise ValueError(f"no usual size is known for {_label(fault)}: give sizes")
        return _rounded(base * GRID)

    def _seen_as_bias(self, bias: Fault) -> float:
        """Return the size from which on one test sees a bias, nan where nothing is known."""
        if self.relations.remembers:
            with suppress(NotImplementedError):
                return float(detectable(cast(SetObserver[Any], self.relations), bias))
        return self.guaranteed_size(bias, 0.0)


def _label(fault: Fault) -> str:
    return f"{fault.signal}:{fault.kind}"


def _fault(model: LinearSystem, stated: str | Fault) -> Fault:
    """Return a fault, checked; of a text "signal:kind", or a signal alone, which may hold colons."""
    if isinstance(stated, Fault):
        fault = stated
    else:
        fault = Fault(*_signal_and_kind(model, stated))
    refuse_unknown_signal(model, fault.signal, fault.kind)
    return fault


def _signal_and_kind(model: LinearSystem, text: str) -> tuple[str, str]:
    """Return the signal and the kind that a text names; "bias" where it names none."""
    before, colon, kind = text.rpartition(":")
    if kind in KINDS:
        signal = before
    elif colon and text not in model.outputs + model.inputs:
        signal = before  # the kind is unknown, and refused as such
    else:
        return text, "bias"
    return signal, kind


def _onset(onset: int | tuple[int, int] | None, samples: int) -> tuple[int, int]:
    """Return (lo, hi) of the onset; by default in the second quarter."""
    if onset is None:
        return samples // 4, max(samples // 2, samples // 4 + 1)
    if is_whole(onset):
        return onset, onset + 1
    if np.shape(onset) != (2,) or not all(map(is_whole, np.asarray(onset))):
        raise ValueError(f"onset must be a sample, or a pair of them like (50, 100), not {onset!r}")
    first, stop = map(int, cast("tuple[int, int]", onset))
    return first, stop


def _unfactored(relations: Relations) -> Relations:
    """Return relations, or an observer, of the model where its factors are 1."""
    model = relations.model
    if not isinstance(model, LinearSystem) or not model.factors:
        return relations
    return relations.of(_at_one(model))


def _at_one(model: LinearSystem) -> LinearSystem:
    """Return a model where its factors are 1."""
    return at_factors(model, dict.fromkeys(model.times, 1))


def _rounded(sizes: np.ndarray) -> np.ndarray:
    """Return sizes of three digits."""
    return np.array([float(f"{size:.3g}") for size in sizes])
