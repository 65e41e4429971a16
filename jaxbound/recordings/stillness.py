"""Stretches in which a signal stands still: a sensor that is frozen or at the end of its range.

Such a sensor can look consistent, so a verdict says little about it there. These are hints: no proof uses
them and they change no verdict. A signal is followed in chunks, with a `Runs` that is carried from one to the
next.

A run is a stretch of equal numbers. What is usual differs: full floats hardly ever repeat, a temperature
rounded to 0.1 K does for minutes. So a run is called frozen if it is 20 times as long as those that a quarter
of all other samples lie in (and has 20 samples or more), and an output saturated if it comes to rest at its
largest or smallest number again and again, or once for half as long. An input stands still where it is told
to, so it counts as frozen only if it changes from sample to sample everywhere else.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxbound.recordings.factors import known
from jaxbound.recordings.signals import Named

FROZEN = 20  # samples, and times the usual length of a run
SATURATED = 5  # samples, and times the usual length of a run
AGAIN = 3  # so often
RESTING = 10  # or once for so many samples, and times the usual length of a run
USUAL = 0.25  # this share of all other samples lies in runs of the usual length or shorter
CAP = 1000  # run lengths are counted one by one up to here
LIVELY = 0.01  # share of repeated numbers in an input that is measured, not set
KEPT = 100  # longest runs that are remembered
NO_NUMBERS = {
    9999.0,
    99999.0,
    -999.0,
    -999.25,
    -9999.0,
    -99999.0,
    32767.0,
    -32768.0,
    65535.0,
    1e20,
    1e30,
    1e35,
    -1e20,
    -1e30,
    -1e35,
}


class Run(NamedTuple):
    """Samples start .. start + length - 1 all have this value."""

    length: int
    start: int
    value: float


@dataclass(frozen=True, eq=False)
class Runs:
    """The runs of one signal so far.

    Fields: samples: how many there were; present: how many of them are there; counts (CAP + 1,): finished
    runs of each length, the last for all that are longer; longest: the longest finished runs; low, high:
    smallest and largest value; last: the run that may go on, or None;
    first: the run that the first sample is in, or None.
    """

    samples: int = 0
    counts: np.ndarray | None = None
    present: int = 0
    longest: tuple[Run, ...] = ()
    low: float = math.inf
    high: float = -math.inf
    last: Run | None = None
    first: Run | None = None


class Stretch(NamedTuple):
    """One kind of stillness of a signal: "constant", "frozen" or "saturated", the longest run of it and how
    many times there is one.
    """

    kind: str
    longest: Run
    times: int
    extreme: str  # "largest", "smallest", or "" if the run is at neither


def follow_runs(runs: Runs, x: np.ndarray) -> Runs:
    """Take the next chunk of one signal.

    Args:
        runs: the Runs after all chunks before, `Runs()` at first. x: (N,) its samples, NaN where one is
            missing, which ends a run.

    Returns:
        The Runs after this chunk.
    """
    x = np.asarray(x)
    if not len(x):
        return runs
    edges = np.flatnonzero(np.diff(x[1:] == x[:-1], prepend=False, append=False))
    starts, lengths = edges[::2], edges[1::2] - edges[::2] + 1  # of two samples or more
    if not len(starts) or starts[0] > 0:
        starts, lengths = np.append(0, starts), np.append(1, lengths)
    if starts[-1] + lengths[-1] < len(x):
        starts, lengths = np.append(starts, len(x) - 1), np.append(lengths, 1)
    values = x[starts]
    there = ~np.isnan(values)
    present = int(np.count_nonzero(x == x))
    done = there.copy()
    done[-1] = False
    counts = np.bincount(np.minimum(lengths[done], CAP), minlength=CAP + 1)
    counts[1] += present - int(lengths[there].sum())
    long = np.flatnonzero(done & (lengths >= SATURATED))
    long = long[np.argsort(-lengths[long], kind="stable")[:KEPT]]

    def run(i: int | np.intp) -> Run:
        return Run(int(lengths[i]), int(starts[i] + runs.samples), float(values[i]))

    return joined_runs(
        runs,
        Runs(
            samples=runs.samples + len(x),
            counts=counts,
            present=present,
            longest=tuple(map(run, long)),
            low=float(np.fmin.reduce(x, initial=np.inf)),
            high=float(np.fmax.reduce(x, initial=-np.inf)),
            last=run(-1) if there[-1] else None,
            first=run(0) if there[0] else None,
        ),
    )


def joined_runs(a: Runs, b: Runs) -> Runs:
    """Return the Runs of two stretches of samples that follow each other, of which the second was followed
    from `Runs(a.samples)` on.
    """
    if b.counts is None:
        return a
    if a.counts is None:
        return b
    counts, finished = a.counts + b.counts, [*a.longest, *b.longest]
    first, over, last = a.first, a.last, b.last
    if over is not None and b.first is not None and b.first.value == over.value:  # one run across the seam
        over = Run(over.length + b.first.length, over.start, over.value)
        if a.first == a.last:
            first = over
        if b.first == b.last:  # it may still go on
            over, last = None, over
        else:
            counts[min(b.first.length, CAP)] -= 1
            finished = [run for run in finished if run != b.first]
    if over is not None:
        counts[min(over.length, CAP)] += 1
        if over.length >= SATURATED:
            finished.append(over)
    finished.sort(key=lambda r: (-r.length, r.start))
    low, high = min(a.low, b.low), max(a.high, b.high)
    return Runs(b.samples, counts, a.present + b.present, tuple(finished[:KEPT]), low, high, last, first)


def stretches(runs: Runs, driven: bool = False) -> tuple[Stretch, ...]:
    """Return the stretches that stood still; driven: the signal is an input.

    Example:
        >>> x = np.sin(np.arange(500.0))
        >>> x[300:400] = x[300]
        >>> stretches(follow_runs(Runs(), x))
        (Stretch(kind='frozen', longest=Run(length=100, start=300, value=-0.99975...), times=1, extreme=''),)
    """
    if runs.counts is None or not runs.present:
        return ()
    counts, every = runs.counts, [*runs.longest]
    if runs.last is not None:
        counts = counts + np.bincount([min(runs.last.length, CAP)], minlength=CAP + 1)
        every.append(runs.last)
    every.sort(key=lambda run: (-run.length, run.start))
    if every and every[0].length == runs.present >= FROZEN:
        if driven:
            return ()
        return (Stretch("constant", every[0], 1, ""),)
    least = {run: _usual_length(counts, runs.present, run, driven) for run in every}
    frozen = [run for run in every if run.length >= FROZEN * least[run]]
    still: list[Stretch] = []
    if frozen:
        still.append(Stretch("frozen", frozen[0], len(frozen), _which_extreme(runs, frozen[0].value)))
    if driven:
        return tuple(still)
    frozen_at = {_which_extreme(runs, run.value) for run in frozen}
    for end in ("largest", "smallest"):
        if end in frozen_at:
            continue
        resting = [run for run in every if _which_extreme(runs, run.value) == end]
        resting = [run for run in resting if run.length >= SATURATED * least[run]]
        once = resting and resting[0].length >= RESTING * least[resting[0]]
        if once or len(resting) >= AGAIN:
            still.append(Stretch("saturated", resting[0], len(resting), end))
    return tuple(still)


def _usual_length(counts: np.ndarray, present: int, run: Run, driven: bool) -> float:
    """Return the length of a run that is usual outside of it, or likely by chance: the larger."""
    rest, finished = present - run.length, counts.sum() - 1
    # samples in runs up to each length, without the run in question: it is no evidence of what is usual
    below = np.cumsum(counts[:CAP] * np.arange(CAP))
    below[run.length :] -= run.length
    usual = int(np.searchsorted(below, USUAL * rest))
    if not rest > finished > 0:
        return max(usual, 1)
    repeats = 1 - finished / rest
    if driven and repeats > LIVELY:
        return math.inf
    # of independent samples, runs this long come by chance once in a million recordings of this length
    likely = math.log(1e6 * present) / -math.log(repeats)
    return max(usual, 1, likely / FROZEN)


def _which_extreme(runs: Runs, value: float) -> str:
    if value == runs.high:
        return "largest"
    if value == runs.low:
        return "smallest"
    return ""


def windows_inside(runs: Runs, horizon: int) -> int:
    """Return how many windows of horizon + 1 samples lie inside one run each, for a horizon up to 1000.

    Example:
        >>> windows_inside(follow_runs(Runs(), np.array([1.0, 1.0, 1.0, np.nan, 1.0, 1.0])), 1)
        3
    """
    if runs.counts is None:
        return 0
    last, lengths = 0, np.arange(CAP)
    if runs.last is not None:
        last = runs.last.length
    # samples in longer runs, which are not counted one by one
    long = runs.present - last - int(runs.counts[:CAP] @ lengths)
    inside = int(runs.counts[:CAP] @ np.maximum(lengths - horizon, 0))
    return inside + max(long - int(runs.counts[CAP]) * horizon, 0) + max(last - horizon, 0)


def still_hints(model: Named, u: np.ndarray, y: np.ndarray, label: Callable[[int], str]) -> Iterator[str]:
    """Yield sentences on all signals of a recording, u (T, m) and y (T, p), that stand still. Other
    arguments as for `signal_hints`.
    """
    for name, signal in zip(model.outputs, y.T, strict=True):
        yield from signal_hints(name, follow_runs(Runs(), np.ascontiguousarray(signal)), label)
    for name, signal in zip(known(model), u.T, strict=True):
        if name not in model.inputs:
            continue  # a factor stands still where the plant does
        yield from signal_hints(name, follow_runs(Runs(), np.ascontiguousarray(signal)), label, driven=True)


def signal_hints(name: str, runs: Runs, label: Callable[[int], str], driven: bool = False) -> list[str]:
    """Return sentences on where a signal stands still: which, when, how long; and on numbers that may stand
    for a missing sample.

    Args:
        name: of the signal. runs: its Runs after all samples. label: number of a sample -> text of its time.
            driven: it is an input.
    """
    hints: list[str] = []
    for extreme in (runs.low, runs.high):
        if extreme in NO_NUMBERS:
            stands = "if that stands for a missing sample, leave the cell blank (NaN)"
            hints.append(f"{name} is exactly {extreme:.6g} somewhere: {stands}")
    return hints + [_stillness_sentence(name, stretch, label) for stretch in stretches(runs, driven)]


def _stillness_sentence(name: str, stretch: Stretch, label: Callable[[int], str]) -> str:
    """Return the sentence on one kind of stillness of a signal."""
    kind, run, count, extreme = stretch
    if kind == "constant":
        doubt = "if its sensor is frozen, it can still look consistent"
        return f"{name} is {run.value:.6g} in every sample: {doubt}"
    span = f"{run.length} samples from {label(run.start)} to {label(run.start + run.length - 1)}"
    at = ""
    if extreme:
        at = f", its {extreme} value,"
    doubt = "sensor can look consistent, so no FAULT there does not mean that it works"
    if kind == "saturated":
        where = f"for {span}"
        if count > 1:
            where = f"in {count} stretches, the longest of {span}"
        return f"{name} rests at exactly {run.value:.6g}{at} {where}: a saturated {doubt}"
    many, broken = "", "frozen"
    if count > 1:
        many = f" ({count} such stretches in all)"
    if extreme:
        broken = "saturated or frozen"
    return f"{name} stays at exactly {run.value:.6g}{at} for {span}{many}: a {broken} {doubt}"
