"""Which fault, of which size, from when on: what a study varies, and what a fault does to a sample."""

import dataclasses
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.detectability import detectable
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.models.faults import KINDS, Fault, refuse_unknown_signal
from jaxbound.models.system import LinearSystem
from jaxbound.random.threefry import Array
from jaxbound.relations.bounds import model_bounds
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.sentence import remembers
from jaxbound.studies.montecarlo import recursion

__all__ = ["Act", "Trial", "act_of", "changed", "largest_input", "trials"]

SIZELESS = ("stuck", "dropout")
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
        return "no fault" if self.fault is None else f"{self.fault.signal}:{self.fault.kind}"

    def spans(self, onset: np.ndarray, samples: int, relations: Relations) -> tuple[np.ndarray, np.ndarray]:
        """Return (windows wholly inside the fault, windows without a faulty sample) of scenarios with such
        onsets.

        Of an observer: samples of the fault, and those before it.
        """
        stop, horizon = np.minimum(onset + self.length, samples), relations.horizon
        if remembers(relations):
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


def act_of(trial: Trial, model: LinearSystem, dtype: np.dtype) -> Act:
    """Return the Act of a Trial."""
    fault, number = (
        trial.fault,
        lambda names, signal: np.asarray(names.index(signal) if signal in names else -1, np.int32),
    )
    signal, kind = (fault.signal, fault.kind) if fault else (None, "none")
    bias, drift, gain = flags = [np.asarray(kind == k, dtype) for k in ("bias", "drift", "gain")]
    first, stop = trial.onset
    return Act(
        number(model.outputs, signal),
        number(model.inputs, signal),
        bias,
        drift,
        gain,
        np.asarray(trial.sizes, dtype),
        np.asarray(first, np.uint32),
        np.asarray(stop - first, np.uint32),
        np.asarray(trial.length, np.int32),
        "shift" if any(flags) else kind,
    )


def changed(
    act: Act, value: Array, size: Array, since: Array, extra: Array | None, held: Array, dropped: float
) -> Array:
    """Return a value as the fault leaves it, `since` samples after its onset.

    Args:
        extra: a number in [-1, 1] for kind "noise". held: the value at the onset. dropped: what is left of a
            missing sample.
    """
    if act.kind == "noise":
        assert extra is not None, "a noise fault draws"
        return value + size * extra
    if act.kind == "shift":
        return value + size * (act.bias + act.drift * since.astype(value.dtype) + act.gain * value)
    return {"stuck": lambda: held, "dropout": lambda: jnp.full_like(value, dropped)}[act.kind]()


def trials(
    model: LinearSystem,
    faults: str | Fault | Sequence[str | Fault],
    sizes: Sequence[float] | dict[str, Sequence[float]] | None,
    onset: int | tuple[int, int] | None,
    samples: int,
    relations: Relations,
    highest: np.ndarray,
) -> list[Trial]:
    """Return a list of Trial, everything checked.

    Args:
        model, relations: as of the study. faults: a Fault, a text "signal:kind", a sequence of these, or none
            for healthy scenarios.
        sizes: None; a sequence for all faults; {"signal:kind": sequence}. onset: None, a sample, or (lo, hi).
            samples: of a scenario.
        highest: (m,) the largest |u - offset|.

    Raises:
        ValueError: an unknown signal or kind, sizes that no fault takes, onsets outside the scenario.
    """
    if samples <= relations.horizon:
        raise ValueError(
            f"a scenario of {samples} samples has no window of {relations.horizon + 1}: take more samples"
        )
    faults = [faults] if isinstance(faults, str | Fault) else list(faults)
    given = [_fault(model, f) for f in faults]
    labels = [f"{f.signal}:{f.kind}" for f in given]
    if not faults:
        return [Trial(None, np.zeros(1), (samples, samples + 1), 1)]
    if isinstance(sizes, dict) and (extra := sorted(set(sizes) - set(labels))):
        raise ValueError(f"sizes speak of {', '.join(extra)}, but the faults are {', '.join(labels)}")
    out = []
    for fault, label, original in zip(given, labels, faults, strict=True):
        own = sizes.get(label) if isinstance(sizes, dict) else sizes
        placed = isinstance(original, Fault) and (onset is None)
        first, stop = (fault.start, fault.start + 1) if placed else _onset(onset, samples)
        length = samples if fault.stop is None else fault.stop - fault.start
        if not 0 <= first < stop <= samples:
            raise ValueError(
                f"the fault {label} must start at a sample 0 <= k < {samples}, not in {first}..{stop - 1}"
            )
        if fault.kind in SIZELESS:
            own = (0.0,)
        elif own is None:
            own = (
                (fault.size,)
                if isinstance(original, Fault) and fault.size
                else _usual_sizes(model, fault, relations, highest, samples)
            )
        each = np.atleast_1d(np.asarray(own, float))
        if each.ndim != 1 or not each.size or not np.isfinite(each).all():
            raise ValueError(f"sizes of {label} must be finite numbers, not {each.tolist()}")
        sure = guaranteed_size(model, fault, relations, highest, samples, float(np.abs(each).max()))
        out.append(
            Trial(
                dataclasses.replace(fault, size=0.0, start=0, stop=None),
                each,
                (int(first), int(stop)),
                int(length),
                sure,
            )
        )
    return out


def _fault(model, given):
    if isinstance(given, str):
        signal, _, kind = given.rpartition(":") if given.rpartition(":")[2] in KINDS else (given, "", "bias")
        if signal not in model.outputs + model.inputs and ":" in given:
            signal, _, kind = given.rpartition(":")
        given = Fault(signal, kind)
    refuse_unknown_signal(model, given.signal, given.kind)
    return given


def _onset(onset, samples):
    """Return (lo, hi) of the onset; by default in the second quarter."""
    if onset is None:
        return samples // 4, max(samples // 2, samples // 4 + 1)
    return (int(onset), int(onset) + 1) if np.ndim(onset) == 0 else tuple(map(int, onset))


def largest_input(model: LinearSystem, trial: Trial | None, highest: np.ndarray, samples: int) -> np.ndarray:
    """Return the largest |v - offset| (m,) that acts on the plant, the fault included."""
    out = np.array(highest, float)
    if trial is None or trial.fault is None or trial.fault.signal not in model.inputs:
        return out
    i, size, kind = model.inputs.index(trial.fault.signal), np.abs(trial.sizes).max(), trial.fault.kind
    level = abs(float(model.offset["u"][i]))
    out[i] += {
        "bias": size,
        "noise": size,
        "drift": size * samples,
        "gain": size * (out[i] + level),
        "dropout": level,
    }.get(kind, 0.0)
    return out


def guaranteed_size(
    model: Any, fault: Any, relations: Any, highest: Any, samples: int, largest: float
) -> float:
    """Return the size of a bias from which on the monitor must see it in every scenario of the study, nan
    where nothing is known.

    The operating range is what the readings of this study can come to, with a fault of that size.
    """
    if (
        fault.kind != "bias"
        or not isinstance(relations, ParityRelation)
        or relations.model.constant_tolerance
        or model.d
    ):
        return np.nan
    monitor, own = relations.model, model_bounds(relations.model)
    if any(not np.array_equal(relations.bounds[name], own[name]) for name in own):
        return np.nan
    size, before = largest, None
    for _ in range(
        8
    ):  # a larger range may need a larger fault, which makes a larger range: a straight line, or nearly
        trial = Trial(fault, np.array([size]), (0, 1), samples)
        _, readings = recursion.reach(model, largest_input(model, trial, highest, samples), samples)
        readings = np.maximum(readings, 1e-9 * max(float(readings.max(initial=0)), 1e-9))
        readings[[i for i, name in enumerate(model.outputs) if name == fault.signal]] += size
        if not np.isfinite(readings).all():
            return np.nan
        found = float(detectable(monitor, fault, operating_range=readings.tolist(), **relations.window))
        if found <= size or not np.isfinite(found):
            return found
        slope = (found - before[1]) / (size - before[0]) if before else 0.0
        if slope >= 1:
            return np.inf
        size, before = 1.0001 * (found - slope * size) / (1 - slope), (size, found)
    return np.inf


def _usual_sizes(model, fault, relations, highest, samples):
    """Return sizes around the one that is guaranteed to be seen as a bias, or around what the bounds
    allow.
    """
    base = guaranteed_size(model, Fault(fault.signal), relations, highest, samples, 0.0)
    if isinstance(relations, SetObserver):
        with suppress(NotImplementedError):
            base = float(detectable(relations, Fault(fault.signal)))
    _, readings = recursion.reach(model, np.asarray(highest, float), samples)
    inside = fault.signal in model.outputs
    i = (model.outputs if inside else model.inputs).index(fault.signal)
    level = float(readings[i] if inside else highest[i])
    if not np.isfinite(base) or not base > 0:
        base = level
    if fault.kind == "tolerance":
        least = float(model.tolerance[i])
        return np.array([float(f"{least + (1 - least) * share:.3g}") for share in GRID[:10]])
    base = {"drift": base / max(samples // 4, 1), "gain": base / level if level > 0 else 1.0}.get(
        fault.kind, base
    )
    if not np.isfinite(base) or base <= 0:
        raise ValueError(f"no usual size is known for {fault.signal}:{fault.kind}: give sizes")
    return np.array([float(f"{base * share:.3g}") for share in GRID])
