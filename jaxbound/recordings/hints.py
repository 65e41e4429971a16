"""Hints for the owner of a recording: missing samples, a recorder that rounds, too few samples."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from jaxbound.recordings.factors import known
from jaxbound.recordings.recordingformat import format_of
from jaxbound.recordings.signals import Named
from jaxbound.text.names import listed

FIRST = 20_000
"""Samples of which the different values are looked at first."""
WITHOUT_INPUT = (
    "windows that need one are judged as if it could be anything, FAULT where that proves it, CONSISTENT "
    "where a search finds what it may be, else UNDECIDED or MISSING: their margins are of the rest only"
)


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
) -> Iterator[str]:
    """Yield a sentence for each signal with missing samples. Args: u (T, m), y (T, p); excluded (T,) bool:
    samples that do not count.
    """
    if excluded is not None:
        u, y = u[~excluded], y[~excluded]
    return missing_sentences(model, missing_samples(model, u, y), len(y))


def missing_samples(model: Named, u: np.ndarray, y: np.ndarray) -> dict[str, int]:
    """Return {signal: number of its missing samples}."""
    missing = [*np.isnan(u).sum(0).tolist(), *np.isnan(y).sum(0).tolist()]
    return dict(zip((*known(model), *model.outputs), missing, strict=True))


def missing_sentences(model: Named, missing: Mapping[str, int], samples: int) -> Iterator[str]:
    """Yield a sentence for each signal of which samples are missing: what is claimed of windows around."""
    for name, count in missing.items():
        if not count:
            continue
        claim = "the windows around them are judged without them"
        if name in model.inputs:
            claim = WITHOUT_INPUT
        yield f"{count} of {samples} samples of {name} are missing: {claim}"


def rounding_hints(model: Named, y: np.ndarray) -> Iterator[str]:
    """Yield sentences on outputs that the recorder seems to round more than the model states.

    Args:
        model: with .resolution, half a step of each output; without it nothing is stated. y: (T, p).
    """
    resolution: Sequence[float] | None = getattr(model, "resolution", None)
    if resolution is None:
        return
    bands = format_of(model).deadbands(model.outputs)
    outputs: dict[tuple[str, float], list[str]] = {}
    for i, name in enumerate(model.outputs):
        step, band = recorded_step(y[:, i]), float(bands[name])
        if step and float(resolution[i]) - band < step / 2 * (1 - 1e-9):
            outputs.setdefault((f"{step:.6g}", band), []).append(name)
    for (written, band), names in outputs.items():
        multiple = f"every sample of {listed(names, str)} is a multiple of {written}"
        advice = f"add `resolution = {float(written) / 2 + band:.6g}` there in the model file"
        yield f"{multiple}, more than the resolution that the model states: if the recorder rounds, {advice}"


def recorded_step(x: np.ndarray) -> float:
    """Return the largest step that all values are multiples of (counted from one of them), or 0: a recorder
    that rounds.
    """
    x = x[~np.isnan(x)]
    values = np.unique(x[:FIRST])
    if len(values) < 3:
        return 0.0
    decimal = _decimal_step(x, values)
    gaps = np.diff(values)
    coarse = float(gaps.min())
    if coarse > max(1.5 * decimal, 1e-6 * float(abs(x).max())) and _are_multiples(gaps, coarse, 0.01):
        coarse = float((values[-1] - values[0]) / np.rint(gaps / coarse).sum())
        if _are_multiples(x - values[0], coarse, 0.02):
            return coarse
    return decimal


def _decimal_step(x: np.ndarray, values: np.ndarray) -> float:
    """Return the largest power of ten, 1 to 1e-9, that all numbers are multiples of, or 0.

    Args:
        x: all numbers. values: some of them, which rule out most steps sooner.
    """
    top = float(abs(x).max())
    for places in range(10):
        if top * 10.0**places > 1e12:
            return 0.0
        step, slack = 10.0**-places, 2e-15 * top * 10.0**places + 1e-9
        if _are_multiples(values, step, slack) and _are_multiples(x, step, slack):
            return step
    return 0.0


def _are_multiples(x: np.ndarray, step: float, slack: float) -> bool:
    return bool((abs(x / step - np.rint(x / step)) <= slack).all())
