"""Advice on a fit: sentences on signals that stand still, and on what the data do not carry."""

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.studies.identification.fit_result import FitCheck
from jaxbound.studies.identification.records import Records, measured_count
from jaxbound.studies.identification.signal_choice import TOGETHER
from jaxbound.text.names import listed
from jaxbound.text.quantities import duration

WIDE, CONTRADICTION, FEW = 1.5, 3.0, 10
"""Above this factor that a recording asks for that is left out, this factor between the bounds of two
recordings, below this number of windows that do not overlap, the user is told that the data do not carry the
monitor."""
ALIKE = 0.75
"""Share of the spread within recordings up to which their means differ where they are alike."""
SEVERAL = "give each as a file of its own, jaxbound fit one.csv two.csv .., fit([one, two])"
SHOWN = "--plot fit.png, plot(model)"


def inputs_at_rest(
    records: Records, inputs: Sequence[str], outputs: Sequence[str], horizon: int
) -> list[str]:
    """Return a sentence for each input that never moves, none where there is no window.

    Raises:
        ValueError: an output stands still, or every input.
    """
    if measured_count(records) <= horizon:
        return []  # refused for that
    u, y = (np.concatenate([r[side] for r in records]) for side in (0, 1))
    for name, x in zip(outputs, y.T, strict=True):
        if _stands_still(x):
            raise ValueError(
                f"{name} stands still in all recordings: nothing can be learnt of it; leave it out, or look "
                f"at the sensor"
            )
    still = [name for name, x in zip(inputs, u.T, strict=True) if _stands_still(x)]
    if still and len(still) == len(inputs):
        raise ValueError(
            f"no input moves in these recordings ({listed(still, str)}), so nothing can be learnt of them: "
            f"record a step, or leave them out of the inputs"
        )
    return [
        f"{name} never moves in these recordings: what it does to the outputs is unknown, and the model says "
        f"nothing; record a step of it, or {_without(name, inputs)}"
        for name in still
    ]


COMPLETE_ONLY = (
    "tests that are not taken were judged by complete windows alone: windows that lack samples may ask for "
    "wider bounds; fit one of them alone to see by how much, --recipe horizon=30"
)


def _without(name: str, inputs: Sequence[str]) -> str:
    """Return the command that fits without one of the inputs."""
    rest = [other for other in inputs if other != name]
    return f"fit again with {name} taken out of --inputs, inputs={rest!r}"


def apart(records: Records, inputs: Sequence[str], outputs: Sequence[str]) -> Iterator[str]:
    """Yield a sentence for each signal of which two recordings have nothing in common: units may differ."""
    for side, names in ((0, inputs), (1, outputs)):
        for i, name in enumerate(names):
            ranges = [(x[side][:, i], number) for number, x in enumerate(records, 1)]
            moving = [(np.nanmin(x), np.nanmax(x), number) for x, number in ranges if not _stands_still(x)]
            if len(moving) < 2:
                continue
            low, high = min(moving, key=lambda r: r[1]), max(moving)
            if low[1] < high[0]:
                below = f"{low[0]:.4g} to {low[1]:.4g} in recording {low[2]}"
                above = f"{high[0]:.4g} to {high[1]:.4g} in recording {high[2]}"
                yield (
                    f"{name} lies at {below} and at {above}, which have nothing in common: is it in two "
                    f"units, like degC and degF, or are these two plants? Bring it to one unit, or fit a "
                    f"model to each, jaxbound fit FILE"
                )


def inputs_together(records: Records, inputs: Sequence[str]) -> Iterator[str]:
    """Yield a sentence for each pair of inputs that move together."""
    u = np.concatenate([r[0] for r in records])
    u = u[np.isfinite(u).all(1)]
    for i, j in itertools.combinations(range(len(inputs)), 2):
        if _stands_still(u[:, i]) or _stands_still(u[:, j]):
            continue
        together = abs(float(np.corrcoef(u[:, i], u[:, j])[0, 1]))
        if together > TOGETHER:
            yield (
                f"{inputs[i]} and {inputs[j]} move together (correlation {together:.3f}): the data do not "
                f"tell apart what each does, and an hour in which they part looks like a fault; record steps "
                f"of one alone, or {_without(inputs[j], inputs)}"
            )


def _stands_still(x: np.ndarray) -> bool:
    return len(np.unique(x[~np.isnan(x)])) < 2


def no_average(name: str, samples: int) -> str:
    """Return the sentence on an output whose errors do not average out."""
    return (
        f"errors of {name} do not average out: the mean of {samples} in a row is as large as one of them, "
        f"and gets no bound; fit again without average, average=None"
    )


def data_limits(model: LinearSystem, check: FitCheck, held_out: float) -> list[str]:
    """Return sentences on what the data do not carry.

    Args:
        held_out: the share that was to be held out.
    """
    sentences = [_few_windows(model, check), *_left_out(model, check, held_out), _disagreement(check)]
    return list(filter(None, sentences))


def blind(model: LinearSystem, check: FitCheck) -> list[str]:
    """Return a sentence on each output that moved less than any error of it that is sure to be seen."""
    return [sentence for name in model.outputs if (sentence := _blind(model, check, name))]


def _few_windows(model: LinearSystem, check: FitCheck) -> str:
    if model.horizon is None:  # an observer has no windows
        return ""
    length = model.horizon + 1
    whole = sum(-int(-r["windows"] // length) for r in check.recordings)
    if whole >= FEW:
        return ""
    return (
        f"the recordings hold only {whole} windows of {length} samples that do not overlap: bounds from so "
        f"little history may not last; record longer, or fit again with "
        f"--recipe horizon={max(length // 2, 1)}"
    )


def _left_out(model: LinearSystem, check: FitCheck, held_out: float) -> Iterator[str]:
    """Yield sentences on what a day that was not seen may ask for."""
    if not check.left_out:
        why, again = "the recording is too short to leave a part of it out", f"record more, and {SEVERAL}"
        if not held_out:
            why, again = "nothing was left out", "fit again with --recipe held_out=0.3"
        yield f"{why}: what the monitor makes of data that it has not seen is unknown; {again}"
        return
    alone = len(check.recordings) == 1
    what = "block" if alone else "recording"
    if alone:
        blocks = len(check.left_out)
        length = duration(check.recordings[0]["samples"] * model.dt / blocks)
        yield (
            f"there is one recording, and its {blocks} blocks of {length} follow each other: what another "
            f"time asks for is unknown; record more of them, and {SEVERAL}"
        )
    for number, one in enumerate(check.left_out, 1):
        if one.why:
            yield (
                f"{what} {number} says nothing of another day: {one.why}; record more, or cut a long "
                f"recording into files, and {SEVERAL}"
            )
    factor = _largest(check)
    if factor > WIDE:
        yield (
            f"a {what} that is left out needs bounds {factor:.2f} times as wide as all together: they "
            f"do not show all of healthy operation; record more of it, or look at what was different, {SHOWN}"
        )


def _largest(check: FitCheck) -> float:
    """Return the largest factor that a part asks for; 1 where none is known."""
    return max((one.factor for one in check.left_out if not one.why), default=1.0)


def alike(records: Records, inputs: Sequence[str], check: FitCheck) -> Iterator[str]:
    """Yield a sentence where several recordings ask for nothing, left out, and are at one operating point."""
    if len(records) < 2 or not inputs or _largest(check) > WIDE:
        return
    means, within = [], []
    for u, _, _ in records:
        means.append(np.nanmean(u, axis=0))
        within.append(np.nanstd(u, axis=0))
    if (np.ptp(means, axis=0) <= ALIKE * np.mean(within, axis=0)).all():
        yield (
            f"the {len(records)} recordings are alike, every input is about the same on average: what a day "
            f"unlike them asks for, a cold one or of another load, is unknown; record one, and {SEVERAL}"
        )


def _disagreement(check: FitCheck) -> str:
    """Return the sentence on two recordings whose bounds differ too much; "" where none do."""
    shares = {i: r["used"] for i, r in enumerate(check.recordings) if r["windows"]}
    if len(shares) < 2:
        return ""
    low, high = min(shares, key=shares.__getitem__), max(shares, key=shares.__getitem__)
    if not shares[high] > CONTRADICTION * shares[low]:
        return ""
    return (
        f"recording {high + 1} needs bounds {shares[high] / shares[low]:.1f} times as wide as recording "
        f"{low + 1}: they contradict each other; look at what was different, {SHOWN}, or fit a model to "
        f"each, jaxbound fit FILE"
    )


def _blind(model: LinearSystem, check: FitCheck, name: str) -> str:
    """Return the sentence on an output that moved less than any error of it that is seen; "" else."""
    span = check.moved[name]
    jump, steady = check.hidden.get(name, check.jump[name]), check.steady.get(name, 0.0)
    unit = f" {model.unit(name)}".rstrip()
    moved = f"in all recordings {name} moved by {span:.3g}{unit} only"
    if jump > span:
        size = "however large" if math.isinf(jump) else f"below {jump:.3g}{unit}"
        return (
            f"the monitor is blind for {name}: no jump {size} is sure to be seen, but {moved}; record what "
            f"moves it, or fit again without it or with --recipe order=auto"
        )
    if not steady > span or model.horizon is None:
        return ""
    size = "however large" if math.isinf(steady) else f"below {steady:.3g}{unit}"
    return (
        f"an error of {name} that was there before the recording began and never changes may stay unseen, "
        f"{size}, and {moved}: within {model.horizon + 1} samples the model can follow it; a longer "
        f"horizon sees smaller ones, --recipe horizon={2 * model.horizon + 1}"
    )
