"""Seams of a recording: where a sample does not come one sampling period after the one before.

A window is a statement about samples that are dt apart. One that lies across a seam is MISSING: neither
healthy nor a fault. Time is taken in chunks, with a `Clock` that is carried from one to the next, so that a
recording larger than memory is cut exactly as one in memory.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.recordings.clockintervals import every_text, next_interval
from jaxbound.recordings.signals import SignalModel

MANY = 100_000  # samples that show how far apart they are
USUAL = 0.95  # share of steps that are no longer than a usual one
GAPS = 10  # usual steps from which on others are gaps
VARIED = 0.2  # share of seams from which on hardly a window is left
TOLERATED_DT = 0.05  # median step against the model's dt
DISORDER = 0.1  # share of steps back in time from which on the rows are out of order
TOLERATED_STEP = 0.20  # one step against the model's dt: logger jitter is far below, a missing row far above
REPEATED = ": more than half of the rows repeat the time of the row before"
KINDS = ("gap", "early", "repeated", "backward")
JUMPS = ("gap", "backward")
"""Kinds of which one is longer than another."""
SENTENCES = {
    "gap": (
        "the recording has a gap of {size} before {at}",
        "the recording has {n} gaps, the longest, {size}, before {at}",
    ),
    "early": (
        "{at} comes only {size} after the row before it",
        "{n} rows come too soon, the first, {at}, after {size}",
    ),
    "repeated": (
        "{at} repeats the time of the row before it",
        "{n} rows repeat the time of the row before, the first is {at}",
    ),
    "backward": (
        "the clock goes back by {size} before {at}",
        "the clock goes back {n} times, the farthest, {size}, before {at}",
    ),
}
"""{kind: (of one seam, of several)}."""
UNITS = {1e3: "ms", 1e6: "us", 1e9: "ns", 1 / 60: "min", 1 / 3600: "h", 1 / 86400: "d"}
"""{units a second: what they are called}."""
SUMMER = 1800.0  # s by which a clock is turned at least
FEW = 60  # rows of which one may be kept: of more, hardly anything is left


@dataclass(frozen=True)
class Seam:
    """One seam, and how many there are of its kind.

    Fields: kind: "gap", "early" (sooner than dt), "repeated" (the same time again) or "backward"; count;
    sample: number of the first sample behind the longest jump (early, repeated: behind the first); step:
    seconds from the sample before it.
    """

    kind: str
    count: int
    sample: int
    step: float


@dataclass(frozen=True)
class Clock:
    """The time of a recording so far.

    Fields: dt: the model's sampling period in s; samples: how many there were; last: time of the last one in
    s; seams: one Seam a kind.

    Example:
        >>> clock, starts = tick(Clock(dt=1.0), np.array([0.0, 1.0, 2.02]))
        >>> clock, starts = tick(clock, np.array([3.0, 60.0, 61.0]))
        >>> starts, clock.seams[0].kind, clock.seams[0].step
        (array([4]), 'gap', 57.0)
    """

    dt: float
    samples: int = 0
    last: float = math.nan
    seams: tuple[Seam, ...] = ()


def tick(clock: Clock, time: ArrayLike) -> tuple[Clock, np.ndarray]:
    """Take the next chunk of time stamps.

    Args:
        clock: the Clock after all chunks before, `Clock(dt)` at first. time: (N,) seconds, counted from the
            same instant in every chunk.

    Returns:
        (clock, starts): the Clock after this chunk; the numbers of its samples, counted over all chunks, that
        do not follow the one before. A step that is off by up to 20 % of dt is jitter, and no seam.
    """
    time = np.asarray(time, np.float64)
    if not len(time):
        return clock, np.zeros(0, np.int64)
    steps, first = np.diff(time), clock.samples + 1
    if clock.samples:  # the first one follows a sample before
        steps, first = np.diff(time, prepend=clock.last), clock.samples
    # not "more than": a step that is NaN is odd too
    odd = np.flatnonzero(~(np.abs(steps - clock.dt) <= TOLERATED_STEP * clock.dt))
    starts, step = odd + first, steps[odd]
    seams = {seam.kind: seam for seam in clock.seams}
    kinds = {
        "gap": step > clock.dt,
        "early": (step > 0) & (step < clock.dt),
        "repeated": step == 0,
        "backward": step < 0,
    }
    for kind, which in kinds.items():
        if which.any():
            at = _place_of_worst(kind, which, step)
            fresh = Seam(kind, int(which.sum()), int(starts[at]), float(step[at]))
            seams[kind] = _with_more(seams.get(kind), fresh)
    return Clock(clock.dt, clock.samples + len(time), float(time[-1]), tuple(seams.values())), starts


def _place_of_worst(kind: str, which: np.ndarray, step: np.ndarray) -> int:
    """Return the number of the longest jump of a kind, or of the first where jumps are alike."""
    if kind in JUMPS:
        return int(np.argmax(np.abs(np.where(which, step, 0))))
    return int(np.argmax(which))


def _with_more(old: Seam | None, fresh: Seam) -> Seam:
    """Return the seams of a kind so far, with more of them."""
    if old is None:
        return fresh
    count = old.count + fresh.count
    if fresh.kind in JUMPS and abs(fresh.step) > abs(old.step):
        return replace(fresh, count=count)
    return replace(old, count=count)


def crossing(starts: ArrayLike, horizon: int, first: int, stop: int) -> np.ndarray:
    """Return (stop - first,) bool: True where the window that ends at sample first, first + 1, ... lies
    across a seam.

    Args:
        starts: numbers of samples that do not follow the one before, in any order; those before first -
            horizon do not matter.
        horizon: s, a window has s + 1 samples. first, stop: the samples asked for.

    Example:
        >>> crossing(np.array([2]), 2, 0, 6)
        array([False, False,  True,  True, False, False])
    """
    across = np.zeros(max(stop - first, 0), bool)
    starts = np.asarray(starts, np.int64).reshape(-1)
    starts = starts[(starts > first - horizon) & (starts < stop)]
    ends = (starts[:, None] + np.arange(horizon)).ravel() - first
    across[ends[(ends >= 0) & (ends < len(across))]] = True
    return across


def around(excluded: np.ndarray | None) -> np.ndarray:
    """Return the numbers of the samples at which a stretch of excluded samples begins, and of those behind
    its end.

    Windows that reach into the stretch lie across one of them; those inside it have no data.

    Args:
        excluded: (T,) bool; None: no sample.

    Example:
        >>> around(np.array([False, True, True, False, True]))
        array([1, 3, 4])
    """
    if excluded is None:
        return np.zeros(0, np.int64)
    return np.flatnonzero(np.diff(np.asarray(excluded, np.int8), prepend=0))


def aside(excluded: np.ndarray | None, horizon: int) -> int:
    """Return how many windows of horizon + 1 samples have one that is excluded, (T,) bool or None."""
    if excluded is None:
        return 0
    before = np.cumsum(np.append(0, excluded))
    return int(np.count_nonzero(before[horizon + 1 :] - before[: max(len(excluded) - horizon, 0)]))


def all_starts(given: ArrayLike, samples: int) -> np.ndarray:
    """Return the numbers of samples that do not follow the one before, ascending, each once.

    Args:
        given: whole numbers. samples: how many there are.

    Raises:
        ValueError: something else than numbers of samples.
    """
    given = np.asarray(given)
    if given.size and (given.dtype.kind not in "iu" or given.ndim != 1):
        raise ValueError(
            f"starts needs the numbers of samples, like [120, 4711]: it holds {given.dtype} of shape "
            f"{given.shape}"
        )
    starts = np.unique(given.astype(np.int64))
    outside = starts[(starts < 0) | (starts >= samples)]
    if len(outside):
        wrong = outside[0] if outside[0] < 0 else outside[-1]
        raise ValueError(f"starts needs the numbers of samples, 0 to {samples - 1} here: it holds {wrong}")
    return starts


def rows_apart(dt: float) -> str:
    """Return the end of a sentence on a recording without times. dt: sampling period in s."""
    return f"the rows are taken to be dt = {dt:g} s apart, and none to be missing"


def usual_period(time: np.ndarray) -> float:
    """Return the median step of a time axis in s, to as few digits as are within 0.2 % of it: a logger's
    jitter is no information.

    Args:
        time: (N,) seconds.

    Raises:
        ValueError: fewer than two samples, time that stands still or runs backwards.

    Example:
        >>> usual_period(np.array([0.0, 2.9977, 6.0003, 9.0]))
        3.0
    """
    if len(time) < 2:
        raise ValueError("one row has no sampling period: a recording has at least two")
    median = float(np.median(np.diff(time)))
    if not median > 0:
        refuse_backward(time)
        raise ValueError(f"the rows of the recording are 0 s apart{REPEATED}")
    digits = 1
    while abs(float(f"{median:.{digits}g}") - median) > 0.002 * median:
        digits += 1
    return float(f"{median:.{digits}g}")


def period_of(time: np.ndarray, model: SignalModel) -> float | None:
    """Return the sampling period of a recording in s, of the model or else as its times show it; None where
    it need not have one.

    Raises:
        ValueError: as `usual_period` and `check_period`.
    """
    if not getattr(model, "regular", True):
        return None
    dt = usual_period(time) if model.dt is None else model.dt
    check_period(time, dt, getattr(model, "stated", "the model has"))
    return dt


def refuse_backward(time: np.ndarray) -> int:
    """Return how many rows go back in time; refuse a recording where nearly all do."""
    back = int(np.count_nonzero(np.diff(time) < 0))
    if back > (1 - DISORDER) * max(len(time) - 1, 1):
        raise ValueError("the rows run backwards in time, the newest first: sort them by time")
    return back


def check_period(time: np.ndarray, dt: float, whose: str = "the model has") -> None:
    """Refuse a time axis with another sampling period than the model.

    Args:
        time: (N,) seconds, a whole recording or its first chunk. dt: of the model, in s. whose: who says so.

    Raises:
        ValueError: the median step is off by more than 5 % of dt, or the rows run backwards.
    """
    if len(time) < 2:
        return
    median, back = float(np.median(np.diff(time))), refuse_backward(time)
    if _is_near(median, dt):
        return
    if back > DISORDER * len(time):
        raise ValueError(f"{back} of {len(time)} rows go back in time: sort them by time")
    apart = f"{whose} dt = {dt:g} s, but the rows of the recording are {median:.6g} s apart"
    raise ValueError(f"{apart}{_advice(median, dt, varied_steps(time))}")


def _is_near(period: float, dt: float) -> bool:
    return not abs(period - dt) > TOLERATED_DT * dt


def _advice(median: float, dt: float, varied: str) -> str:
    """Return the likely reason of another sampling period, and the remedy, as the end of a sentence."""
    if median == 0:
        return REPEATED
    if varied:
        return f"; {varied}"
    fold, remedy = round(dt / median), f"fit again, with healthy recordings {median:.3g} s apart"
    if fold > 1 and abs(dt / median - fold) <= TOLERATED_DT * fold:
        remedy = f"let samples be means (--every {every_text(dt)}), or {remedy}"
        if fold <= FEW:
            remedy = f"keep one of every {fold} rows, {remedy}"
    for factor, unit in UNITS.items():
        if _is_near(median / factor, dt):
            named = f"is its time in {unit}? Then call its column so, like 'time [{unit}]'"
            if fold > 1:
                return f": {named}; else {remedy}"
            return f": {named}"
    return f": {remedy}"


def varied_steps(time: np.ndarray) -> str:
    """Return a sentence on the steps of a time axis, (N,) s, and the interval that serves, where they vary by
    more than jitter; else "".

    Example:
        >>> varied_steps(np.array([0.0, 1.0, 3.0, 4.0, 6.0]))
        'its steps vary from 1 s to 2 s: means over intervals that hold the longest bring them to a grid,
        every = "2s" (--every 2s)'
    """
    low, high = _varied(time)
    every = varied_interval(time)
    if not every:
        return ""
    means = "means over intervals that hold the longest bring them to a grid"
    return f'its steps vary from {low:.3g} s to {high:.3g} s: {means}, every = "{every}" (--every {every})'


def varied_interval(time: np.ndarray) -> str:
    """Return the interval that serves where the steps of a time axis vary by more than jitter; else ""."""
    low, high = _varied(time)
    if not (1 + 2 * TOLERATED_STEP) * low < high < GAPS * low:
        return ""
    return next_interval(high)


def may_turn_back(steps: np.ndarray) -> bool:
    """Return whether steps, (N,) s, are so long that a clock without a zone shows a sample's time twice where
    summer ends: then it is no row that was written twice.
    """
    steps = steps[steps > 0]
    return len(steps) > 0 and float(np.median(steps)) >= SUMMER


def _varied(time: np.ndarray) -> tuple[float, float]:
    """Return the shortest and the longest usual step of a time axis, (N,) s; zeros where it does not go
    on.
    """
    steps = np.sort(np.diff(time[:MANY]))
    steps = steps[steps > 0]
    if not len(steps):
        return 0.0, 0.0
    return float(steps[int((1 - USUAL) * (len(steps) - 1))]), float(steps[int(USUAL * (len(steps) - 1))])


def varied_hints(clock: Clock, time: np.ndarray) -> list[str]:
    """Return a sentence where many windows are lost because steps vary. clock: after all samples."""
    count = sum(seam.count for seam in clock.seams)
    varied = ""
    if count > DISORDER * clock.samples:
        varied = varied_steps(time)
    if not varied:
        return []
    return [f"{count} of {clock.samples - 1} steps of the recording are not dt = {clock.dt:g} s: {varied}"]


def irregular(
    clock: Clock, label: Callable[[int], str], where: Callable[[int], str], time: np.ndarray | None = None
) -> str:
    """Return a sentence if more than half of all steps are seams, or a fifth where steps vary, else "": such
    a recording is no sequence of samples dt apart.

    Args:
        clock: the Clock after all samples. label: number of a sample -> text of its time. where: number of a
            sample -> "row 7". time: of the samples, or of the first ones, in s.
    """
    count, steps, varied = sum(seam.count for seam in clock.seams), max(clock.samples - 1, 0), ""
    if count > VARIED * steps and time is not None:
        varied = varied_steps(time)
    if count <= steps / 2 and not varied:
        return ""
    seam = min(clock.seams, key=lambda s: s.sample)
    many = f"{count} of {clock.samples - 1} steps differ from dt = {clock.dt:g} s"
    one = f"{where(seam.sample)} ({label(seam.sample)}), for one,"
    late = f"comes {seam.step:.6g} s after the row before it"
    sentence = f"the recording is not regular: {many} by more than {TOLERATED_STEP:.0%}; {one} {late}"
    if varied:
        return f"{sentence}; {varied}"
    return sentence


def seam_hints(clock: Clock, label: Callable[[int], str], where: Callable[[int], str]) -> Iterator[str]:
    """Yield one sentence a kind of seam: how many, the worst or the first, and what became of it. Arguments
    as for `irregular`.
    """
    for seam in sorted(clock.seams, key=lambda s: KINDS.index(s.kind)):
        one, many = SENTENCES[seam.kind]
        sentence = one if seam.count == 1 else many
        at, size = f"{where(seam.sample)} ({label(seam.sample)})", f"{abs(seam.step):.6g} s"
        event = sentence.format(n=seam.count, at=at, size=size)
        yield f"{event}: the recording is split there, and windows across are MISSING"
