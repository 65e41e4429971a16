"""Hints for the owner of a recording: what is missing, what the recorder rounds, what is
too short.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol, SupportsFloat

import numpy as np

from jaxbound.recordings.signals import Named
from jaxbound.text.names import listed

__all__ = [
    "missing_hints",
    "missing_samples",
    "missing_sentences",
    "recorded_step",
    "refuse_short",
    "rounding_hints",
]


class Rounded(Named, Protocol):
    """Names of signals, and how far the recording of each output is stated to be rounded."""

    @property
    def resolution(self) -> Sequence[SupportsFloat]:
        """Half a step of each output."""


def refuse_short(source: object, samples: int | None, horizon: int | None) -> None:
    """Raise ValueError if a recording has no whole window. To be asked before relations are worked out.

    Args:
        source: name of the recording. samples, horizon: None where they are not known yet.
    """
    if horizon is not None and samples is not None and samples <= horizon:
        needs = f"{horizon + 1}" if horizon < 10**15 else "more than 1e+15"
        raise ValueError(f"{source}: the recording has {samples} samples, one window needs {needs}")


def missing_hints(
    model: Named, u: np.ndarray, y: np.ndarray, excluded: np.ndarray | None = None
) -> list[str]:
    """Return a sentence for each signal with missing samples. Args: u (T, m), y (T, p); excluded (T,) bool:
    samples that do not count.
    """
    if excluded is not None:
        u, y = u[~excluded], y[~excluded]
    return missing_sentences(missing_samples(model, u, y), len(y))


def missing_samples(model: Named, u: np.ndarray, y: np.ndarray) -> dict[str, int]:
    """Return {signal: number of its missing samples}."""
    return {
        name: int(np.isnan(x[:, i]).sum())
        for names, x in ((model.inputs, u), (model.outputs, y))
        for i, name in enumerate(names)
    }


def missing_sentences(missing: Mapping[str, int], samples: int) -> list[str]:
    """Return a sentence for each signal of which samples are missing."""
    return [
        f"{count} of {samples} samples of {name} are missing: the windows around them are judged without them"
        for name, count in missing.items()
        if count
    ]


def rounding_hints(model: Rounded, y: np.ndarray) -> list[str]:
    """Return sentences on outputs that the recorder seems to round more than the model states."""
    found: dict[str, list[str]] = {}
    for i, name in enumerate(model.outputs):
        step = recorded_step(y[:, i])
        if step and float(model.resolution[i]) < step / 2 * (1 - 1e-9):
            found.setdefault(f"{step:.6g}", []).append(name)
    return [
        f"every sample of {listed(names, str)} is a multiple of {step}, more than the resolution that the "
        f"model states: "
        f"if the recorder rounds, add `resolution = {float(step) / 2:.6g}` there in the model file"
        for step, names in found.items()
    ]


def recorded_step(x: np.ndarray) -> float:
    """Return the largest step that all values are multiples of (counted from one of them), or 0: a recorder
    that rounds.
    """
    x = x[~np.isnan(x)]
    values = np.unique(x[:20_000])
    if len(values) < 3:
        return 0.0
    fits = lambda v, step, slack: (abs(v / step - np.rint(v / step)) <= slack).all()
    top, found = float(abs(x).max()), 0.0
    for places in range(10):
        if top * 10.0**places > 1e12:
            break
        if fits(values, 10.0**-places, 2e-15 * top * 10.0**places + 1e-9) and fits(
            x, 10.0**-places, 2e-15 * top * 10.0**places + 1e-9
        ):
            found = 10.0**-places
            break
    gaps = np.diff(values)
    coarse = float(gaps.min())
    if coarse > max(1.5 * found, 1e-6 * top) and fits(gaps, coarse, 0.01):
        coarse = float((values[-1] - values[0]) / np.rint(gaps / coarse).sum())
        if fits(x - values[0], coarse, 0.02):
            return coarse
    return found
