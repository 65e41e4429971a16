"""The source of the bounds of a fit: the window that needs the most of them, and whether windows like it lie
at one time, which a condition would leave out.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from jaxbound.recordings.expressions import TIME_OF_DAY, TIME_SINCE_START, derived
from jaxbound.recordings.recording import Recording
from jaxbound.studies.identification.bounds import rounded_up
from jaxbound.studies.identification.records import sample_text
from jaxbound.studies.identification.training import Training
from jaxbound.text.objects import readable
from jaxbound.text.quantities import duration, percent, three_digits

GAIN, COST = 0.8, 0.1
"""Samples are worth leaving out if other windows need at most this share of what the widest one needs, and if
they are at most this share of all."""
CLOSE = 1.05
"""Of conditions whose other windows need so nearly the same, the one with most windows left is proposed."""
LEVELS = np.linspace(0.95, 0.05, 19)
"""Shares of the largest need: the windows above one of them are to be left out."""
STEP = 0.1
"""Of the range of an input: it steps where it moves farther from one sample to the next."""
DAY, MINUTE = 86400, 60


@readable
@dataclass(frozen=True, eq=False)
class Widest:
    """The window of a fit that asks for the widest bounds, and what leaving out samples like it would give.

    Fields:
        recording, sample: their numbers, from 1 and from 0 on: the window ends there. when: its time, as its
            owner writes it. share: of the bounds, that it needs.
        where: the condition that leaves out the samples at one time, "" where none is worth it; span: that
            time in words; rest: the share of the bounds that the other windows need at most, under this
            model: a fit without them finds its own; cost: the share of the samples that it leaves out,
            missing: of the windows.
        stepping: the input without whose steps windows need at most `rest`; "": there is none.
        clock: (T,) seconds of each recording that `where` looks at; stretch: from, to: what it leaves out.
    """

    recording: int
    sample: int
    when: str
    share: float
    where: str = ""
    span: str = ""
    rest: float = 1.0
    cost: float = 0.0
    missing: float = 0.0
    stepping: str = ""
    clock: tuple[np.ndarray, ...] = field(default=(), repr=False)
    stretch: tuple[float, float] = (0.0, 0.0)

    @property
    def counted(self) -> str:
        """From when on `clock` counts, in words."""
        return "since midnight" if np.isfinite(self.stretch[0]) else "since the start of the recording"

    def rows(self, names: Sequence[object]) -> Iterator[tuple[str, str]]:
        """Yield (label, sentence) for a reader. names: of the recordings."""
        at = f"the window that ends at {sample_text(self.when, self.sample)}"
        yield "widest bounds", f"{names[self.recording - 1]}, {at} needs {percent(self.share)} of them"
        narrower = f"the other windows need {percent(self.rest)} at most"
        if self.where:
            times = three_digits(self.rest / self.share)
            yield (
                "leave out",
                f"{self.span}: {narrower}, bounds about {times} times as wide; nothing would watch "
                f"{percent(self.cost)} of the samples, {percent(self.missing)} of the windows: "
                f"`--where '{self.where}'`",
            )
        if self.stepping:
            yield (
                "steps",
                f"{narrower}, those without a step of {self.stepping}: `--recipe order=auto,delay=auto` may "
                f"follow it better",
            )


class _Windows(NamedTuple):
    """The windows of all recordings. Fields, (N,) each: need: share of the bounds; first, last: the time of
    their first and of their last sample, by a clock; group: the day, or the recording, that they belong to.
    """

    need: np.ndarray
    first: np.ndarray
    last: np.ndarray
    group: np.ndarray

    def touched(self, low: float, high: float) -> np.ndarray:
        """Return (N,) bool: some sample lies between two times; a window over midnight begins below 0."""
        inside = (self.first <= high) & (self.last >= low)
        return np.asarray(inside | (self.first < 0) & (self.first + DAY <= high))


def widest_of(training: Training, used: Sequence[np.ndarray], horizon: int | None) -> Widest | None:
    """Return the Widest of a fit; None: no window needs anything.

    Args:
        used: (T,) a recording, the share of the bounds that each window needs. horizon: of the windows; None:
            of an observer, which carries on what it saw: nothing is said of leaving out.
    """
    largest = [float(np.fmax.reduce(need, initial=-1.0)) for need in used]
    number = int(np.argmax(largest))
    if not largest[number] > 0:
        return None
    sample = int(np.nanargmax(used[number]))
    window = Widest(number + 1, sample, training.again()[number].label(sample), largest[number])
    if horizon is None:
        return window
    tried: list[Widest] = []
    for name in (TIME_SINCE_START, TIME_OF_DAY):
        tried += _left_out(name, window, training, used, horizon)
    if tried:
        rest = CLOSE * min(one.rest for one in tried)
        best = min((one for one in tried if one.rest <= rest), key=lambda one: one.missing)
        if "where" in training.columns:
            best = replace(best, where=f"({training.columns['where']}) and ({best.where})")
        return best
    return _behind_steps(window, training, used, horizon)


def _by_clock(
    name: str, recordings: Sequence[Recording], used: Sequence[np.ndarray], horizon: int
) -> tuple[tuple[np.ndarray, ...], _Windows]:
    """Return (the times of all samples, the windows) by a name of `CLOCK`.

    Raises:
        ValueError: a recording does not tell it.
    """
    clock, parts = [], []
    for number, (recording, need) in enumerate(zip(recordings, used, strict=True)):
        since = recording.time
        if since is not None:
            since = np.asarray(since - since[0], float)
        time = derived((name,), recording.samples, since, recording.stamps)[name]
        end = np.flatnonzero(np.isfinite(need))
        end = end[end >= horizon]
        first = time[end] - (since[end] - since[end - horizon])
        group = np.full(len(end), number)
        if recording.stamps is not None and name == TIME_OF_DAY:
            group = recording.stamps[end].astype("datetime64[D]").astype(int)
        clock.append(time)
        parts.append((need[end], first, time[end], group))
    return tuple(clock), _Windows(*map(np.concatenate, zip(*parts, strict=True)))


def _left_out(
    name: str, window: Widest, training: Training, used: Sequence[np.ndarray], horizon: int
) -> Iterator[Widest]:
    """Yield each Widest that is worth it by a name of `CLOCK`; none where a recording does not tell it."""
    try:
        clock, windows = _by_clock(name, training.again(), used, horizon)
    except ValueError:
        return
    samples = np.concatenate(clock)[~np.isnan(np.concatenate([y for _, y, _ in training.records])).all(1)]
    for level in LEVELS:
        over = windows.need > level * window.share
        low, high = -np.inf, float(windows.first[over].max())
        if name == TIME_OF_DAY:
            low, high = sorted((float(windows.last[over].min()), high))
            low = max(low // MINUTE * MINUTE, 0.0)
        # a sample that is a mean lasts until the next one
        high += training.dt
        if name == TIME_OF_DAY:
            high = -(-high // MINUTE) * MINUTE
        else:
            high = rounded_up(high, 2)
        touched = windows.touched(low, high)
        rest = float(windows.need[~touched].max(initial=0.0))
        cost = float(((samples >= low) & (samples <= high)).mean())
        if not 0 < rest <= GAIN * window.share or cost > COST or not _is_habit(name, windows, touched, rest):
            continue
        where, span = f"{name} > {high:.12g}", f"the first {duration(high)} of each recording"
        if name == TIME_OF_DAY:
            where, span = f"{name} < {low:.12g} or {where}", f"{_of_day(low)} to {_of_day(high)} of each day"
        one = replace(window, where=where, span=span, clock=clock, stretch=(low, high))
        yield replace(one, rest=rest, cost=cost, missing=float(touched.mean()))


def _is_habit(name: str, windows: _Windows, touched: np.ndarray, rest: float) -> bool:
    """Return whether most days, or starts, need more than all else at this time: a single event is none."""
    there = np.unique(windows.group[touched])
    more = np.unique(windows.group[touched & (windows.need > rest)])
    return 2 * len(more) > len(there) and (len(more) > 1 or name == TIME_SINCE_START)


def _of_day(seconds: float) -> str:
    """Return a time of the day, like 07:05."""
    return f"{int(seconds) // 3600:02}:{int(seconds) // MINUTE % 60:02}"


def _behind_steps(window: Widest, training: Training, used: Sequence[np.ndarray], horizon: int) -> Widest:
    """Return the Widest with the input without whose steps windows need least, if that is worth saying."""
    need = np.concatenate(list(used))
    whole = np.isfinite(need)
    for name, (low, high) in training.ranges.items():
        column, parts = training.inputs.index(name), []
        for u, _, _ in training.records:
            stepped = np.abs(np.diff(u[:, column], prepend=np.nan)) > STEP * (high - low)
            parts.append(np.convolve(stepped, np.ones(horizon + 1))[: len(u)] > 0.5)
        still = need[whole & ~np.concatenate(parts)]
        rest = float(still.max(initial=0.0))
        if len(still) >= COST * whole.sum() and 0 < rest <= min(GAIN * window.share, window.rest):
            window = replace(window, rest=rest, stepping=name)
    return window
