"""Means over the intervals of a clock: fast recordings at a slower step, irregular ones on a grid.

A sample is the mean of what was recorded from the beginning of an interval, which is its time, up to the end.
It is missing unless all is there that the recorder usually writes: a step of more than 1.5 usual ones is a
hole, and the intervals of the samples that it lacks are missing. So is each in which a sample is missing or
left out. The usual step is one that 19 of 20 of the first hundred steps do not exceed; of a recorder that
skips a sample now and then, the longer one that 99 of 100 do not exceed, where an interval holds at least two
of these. Intervals count from the midnight of the first sample, or from 0 s. One in which nothing was
recorded is a missing sample, too; more than 100 of them in a row are a gap. The first and the last interval
count only where they are whole. A condition holds in an interval where it holds at each of its samples, and
fails where it fails at each: else it is `IN_PART`.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.recordings.clockintervals import nanoseconds, next_interval, seconds_of
from jaxbound.recordings.factors import IN_PART, Factor, factors_of
from jaxbound.recordings.seams import TOLERATED_DT, TOLERATED_STEP, USUAL
from jaxbound.recordings.signals import Named, SignalModel, Signals

EVERY = "every"
"""Key of `columns` that holds the interval."""
FIRST = 100  # samples that show the usual step: a stream waits for them
RARE = 0.99  # share of steps that a recorder does not exceed which skips a sample now and then
SKIPPED = 2.5  # median steps: a longer one skips more than one sample
HOLE = 1.5  # usual steps: a longer one lacks a sample
EMPTY = 100  # intervals without a sample that are missing samples, and no gap
WHOLE = "in the recording as a whole"


class TooShort(ValueError):
    """A recording holds no interval as a whole."""


class Grid(NamedTuple):
    """The intervals of a recording that its samples are means over, in their order.

    Fields: number (K,) of each since the origin; first, stop (K,): its rows, none where they are equal; whole
    (K,) bool; every: length in ns; origin: datetime64[ns] or None, where times are seconds.
    """

    number: np.ndarray
    first: np.ndarray
    stop: np.ndarray
    whole: np.ndarray
    every: int
    origin: np.datetime64 | None

    def part(self, first: int, stop: int) -> "Grid":
        """Return the intervals first .. stop - 1, with the same numbers of rows."""
        here = slice(first, stop)
        return self._replace(
            number=self.number[here], first=self.first[here], stop=self.stop[here], whole=self.whole[here]
        )

    def lacks(self, rows: np.ndarray) -> None:
        """Let no interval of some rows be whole."""
        self.whole[np.searchsorted(self.first, rows, "right") - 1] = False

    def done(self, last: int, step: int) -> int:
        """Return how many intervals are over behind the last sample. last: its time in ns; step: to the next
        one that may come.
        """
        is_over = bool(self.whole[-1]) and (last + step) // self.every > last // self.every
        return len(self.whole) - 1 + int(is_over)

    def counted(self, done: int, begun: bool | None = None) -> "Grid":
        """Return the intervals that count, those in which nothing was recorded too. done: how many are over.
        begun: see `Unfinished`.
        """
        if begun:  # empty ones count from the one before on
            every_one = _with_empty(self.part(0, done))
            return every_one.part(1, len(every_one.number))
        # a recording begins with an interval that is whole, or with the second one
        return _with_empty(self.part(int(begun is not None or not self.whole[0]), done))

    def time(self, zero: int) -> np.ndarray:
        """Return the beginnings of the intervals in s. zero: number of the interval that dates count from."""
        number = self.number
        if self.origin is not None:
            number = number - zero
        return number * self.every / 1e9

    @property
    def stamps(self) -> np.ndarray | None:
        """The beginnings as datetime64[ns], None where times are seconds."""
        if self.origin is None:
            return None
        return self.origin + (self.number * self.every).astype("timedelta64[ns]")


@dataclass(frozen=True, eq=False)
class Rows:
    """Samples as recorded: instant (N,) ns, u (N, m), y (N, p), excluded (N,) bool, and broken (N,) bool:
    something before it was lost.
    """

    instant: np.ndarray
    u: np.ndarray
    y: np.ndarray
    excluded: np.ndarray
    broken: np.ndarray

    def followed(self, other: "Rows") -> "Rows":
        """Return these samples and those behind them."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Rows(*map(np.concatenate, pairs))

    def behind(self, first: int) -> "Rows":
        """Return the samples from number `first` on."""
        return Rows(*(x[first:] for x in vars(self).values()))


class Unfinished(NamedTuple):
    """The samples of a recording, or a stream, that are in no mean yet: by them the next ones go on.

    Fields: rows: from the last sample of the interval before on; shown: instants of the first samples of all
    so far, in ns, which show the usual step; origin: what intervals count from; begun: whether an interval
    counted; None: none was over yet, so no sample is of one before.
    """

    rows: Rows
    shown: np.ndarray
    origin: np.datetime64 | None
    begun: bool | None = None

    def leads_to(self, time: np.ndarray, stamps: np.ndarray | None, y: np.ndarray) -> bool:
        """Return whether samples come later, by the same clock and of the same type."""
        if (stamps is None) != (self.origin is None) or y.dtype != self.rows.y.dtype:
            return False
        return bool(instants(time, stamps, self.origin)[0] > self.rows.instant[-1])

    def followed(self, rows: Rows) -> "Unfinished":
        """Return these samples and those behind them."""
        shown = np.concatenate([self.shown, rows.instant])[:FIRST]
        return self._replace(rows=self.rows.followed(rows), shown=shown)

    @classmethod
    def of(cls, arrays: Mapping[str, ArrayLike]) -> "Unfinished":
        """Return the samples of `arrays`, or of lists of them."""
        kept = {name: np.asarray(x) for name, x in arrays.items()}
        shown, begun = kept.pop("shown"), kept.pop("begun").tolist()
        origin = kept.pop("origin").astype("datetime64[ns]")
        return cls(Rows(**kept), shown, [*origin, None][0], [*begun, None][0])

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all of it as arrays by their names."""
        origin, begun = np.zeros(0, np.int64), np.zeros(0, bool)
        if self.origin is not None:
            origin = np.append(origin, self.origin.astype(np.int64))
        if self.begun is not None:
            begun = np.append(begun, self.begun)
        return vars(self.rows) | {"shown": self.shown, "origin": origin, "begun": begun}

    def over(
        self, every: str, follows: bool | None = False, rates: bool = False
    ) -> tuple[Grid, "Unfinished"]:
        """Return (the intervals that are over and count, the samples that are left behind them).

        Args:
            every: the interval. follows: whether a recording follows, which may hold a sample for the last
                interval; None: samples follow, so that this one is over as soon as the next begins. rates:
                see `grid_of`.

        Raises:
            ValueError: an interval that is shorter than the usual step. TooShort: of a recording, none is
                over.
        """
        rows, step = self.rows, usual_step(self.shown, every)
        grid = _intervals([rows.instant], every, step, self.origin, rates, self.begun is not None)
        lost = np.flatnonzero(rows.broken)
        grid.lacks(np.append(lost, lost[lost > 0] - 1))
        done = len(grid.whole) - 1
        if follows is not None:
            if follows:
                step = min(step, int(np.median(np.diff(self.shown))))
            done = grid.done(int(rows.instant[-1]), step)
        counted = grid.counted(done, self.begun)
        if follows is not None:
            _refuse_none(counted, every, "over in the recording and the one before" if self.begun else WHOLE)
        if not done:
            return counted, self
        begun = bool(self.begun or len(counted.number))
        return counted, self._replace(rows=rows.behind(int(grid.stop[done - 1]) - 1), begun=begun)


def every_of(model: Named) -> str | None:
    """Return the interval that the samples of a model are means over, as it is written, or None."""
    columns: Mapping[str, str] = getattr(model, "columns", {})
    return columns.get(EVERY)


def every_step(columns: Mapping[str, str], dt: float | None) -> float | None:
    """Return the dt of samples that are means over an interval; of others dt as it is.

    Raises:
        ValueError: another dt, or no interval.
    """
    every = columns.get(EVERY)
    if every is None:
        return dt
    seconds = seconds_of(every)
    if dt is not None and abs(dt - seconds) > 1e-9 * seconds:
        raise ValueError(f"every = {every!r} makes dt = {seconds:g} s: leave out dt = {dt:g}")
    return seconds


def refuse_every(model: Named, what: str) -> None:
    """Raise ValueError for a model whose samples are means over intervals. what: cannot be averaged."""
    every = every_of(model)
    if every is not None:
        raise ValueError(
            f"the model's samples are means over {every}, which {what} are not: give a file, or average them "
            f"before and take `every` out of the model"
        )


@dataclass(frozen=True)
class _Recorded(Signals):
    """Signals with the conditions that are asked for at each sample. Fields: factors: these."""

    factors: tuple[Factor, ...] = ()


def recorded_model(model: SignalModel) -> Signals:
    """Return the names of a model whose samples are means, to read what was recorded at its own step."""
    columns = {name: column for name, column in model.columns.items() if name != EVERY}
    inputs, outputs = tuple(model.inputs), tuple(model.outputs)
    return _Recorded(inputs, outputs, columns, regular=False, factors=factors_of(model))


def instants(time: np.ndarray, stamps: np.ndarray | None, origin: np.datetime64 | None) -> np.ndarray:
    """Return times in whole ns, (N,): since the origin where there are dates, else since 0 s.

    Args:
        time: (N,) s. stamps: (N,) datetime64, or None. origin: a midnight.
    """
    if stamps is None:
        return np.round(time * 1e9).astype(np.int64)
    return (stamps.astype("datetime64[ns]") - origin).astype(np.int64)


def midnight_of(stamps: np.ndarray | None) -> np.datetime64 | None:
    """Return the midnight before the first of (N,) dates, or None where there are none."""
    if stamps is None or not len(stamps):
        return None
    day: np.datetime64 = stamps[0].astype("datetime64[D]").astype("datetime64[ns]")
    return day


def usual_step(instant: np.ndarray, every: str) -> int:
    """Return the step in ns that 19 of 20 steps of the first samples do not exceed, or 99 of 100 where that
    is a single sample that is skipped, and the interval holds two such steps.

    Raises:
        ValueError: fewer than two samples, or time that stands still or runs backwards.
    """
    steps = np.diff(instant[:FIRST])
    steps = np.sort(steps[steps > 0])
    if not len(steps):
        raise ValueError("its times do not go on, so nothing can be averaged: a recording needs two at least")
    median, usual, rare = (int(steps[int(np.ceil(share * len(steps))) - 1]) for share in (0.5, USUAL, RARE))
    if rare <= SKIPPED * median and 2 * rare <= nanoseconds(every):
        return rare
    return usual


def _length(every: str, usual: int) -> int:
    """Return an interval in ns; refuse one that is shorter than the usual step."""
    length = nanoseconds(every)
    if length < (1 - TOLERATED_STEP) * usual:
        longer = next_interval(usual / 1e9)
        raise ValueError(
            f"every = {every!r} is shorter than the steps of the recording, up to {usual / 1e9:.3g} s: "
            f"nothing would lie in most intervals; every = {longer!r} holds one at least"
        )
    return length


def grid_of(
    chunks: Iterable[np.ndarray],
    every: str,
    usual: int,
    origin: np.datetime64 | None = None,
    rates: bool = False,
) -> Grid:
    """Return the intervals of a recording.

    Args:
        chunks: times in ns from `instants`, in order. every: the interval. usual: from `usual_step`. origin:
            what dates count from. rates: whether signals look back, so that no sample behind a hole counts.

    Raises:
        ValueError: an interval that is shorter than the usual step, or no interval that is whole.
    """
    last = 0

    def seen() -> Iterator[np.ndarray]:
        nonlocal last
        for chunk in chunks:
            last = int(chunk[-1]) if len(chunk) else last
            yield chunk

    grid = _intervals(seen(), every, usual, origin, rates)
    counted = grid.counted(grid.done(last, usual))
    _refuse_none(counted, every, WHOLE)
    return counted


def _refuse_none(grid: Grid, every: str, where: str) -> None:
    """Raise TooShort if there is no interval."""
    if not len(grid.number):
        raise TooShort(f"no interval of {every} is {where}: it is too short")


def _intervals(
    chunks: Iterable[np.ndarray],
    every: str,
    usual: int,
    origin: np.datetime64 | None,
    rates: bool,
    has_before: bool = False,
) -> Grid:
    """Return the intervals of rows, whole where no sample is lacking between these; arguments as of `grid_of`
    and `finished`.
    """
    length = _length(every, usual)
    firsts: list[np.ndarray] = []
    numbers: list[np.ndarray] = []
    odd: list[np.ndarray] = []  # rows in whose interval a sample is lacking
    last: np.ndarray = np.zeros(0, np.int64)
    rows = 0
    for chunk in chunks:
        if not len(chunk):
            continue
        instant = np.concatenate([last, chunk])
        at = rows - len(last)  # number of the first row of them
        own = instant // length
        step = np.diff(instant)
        begins = np.flatnonzero((np.diff(own) != 0) | (step < 0)) + 1
        odd += [at + row for row in _beside_holes(instant, own, step, usual, length, rates)]
        if not len(last):
            begins = np.append(0, begins)
            if not has_before and (instant[0] - usual) // length >= own[0]:
                odd.append(np.zeros(1, np.int64))
        firsts.append(at + begins)
        numbers.append(own[begins])
        rows += len(chunk)
        last = instant[-1:]
    first, each = np.concatenate(firsts), np.concatenate(numbers)
    grid = Grid(each, first, np.append(first[1:], rows), np.ones(len(first), bool), length, origin)
    grid.lacks(np.concatenate(odd))
    return grid


def _beside_holes(
    instant: np.ndarray, number: np.ndarray, step: np.ndarray, usual: int, length: int, rates: bool
) -> list[np.ndarray]:
    """Return the rows before and behind a hole in whose interval a sample is lacking; rates: see
    `grid_of`.
    """
    back = step < 0
    before = np.flatnonzero(back | (step > HOLE * usual))
    behind = before + 1
    next_one, one_before = (instant[before] + usual) // length, (instant[behind] - usual) // length
    is_back = back[before]
    low = np.where(is_back, next_one, np.minimum(next_one, one_before))
    high = np.where(is_back, one_before, np.maximum(next_one, one_before))
    return [before[low <= number[before]], behind[rates | (high >= number[behind])]]


def _with_empty(grid: Grid) -> Grid:
    """Return the intervals with those between them in which nothing was recorded, unless there are many."""
    empty = np.diff(grid.number) - 1
    empty = np.append(np.where((empty > 0) & (empty <= EMPTY), empty, 0), 0)
    if not empty.any():
        return grid
    count = empty + 1
    own = np.repeat(np.arange(len(count)), count)
    behind = np.arange(len(own)) - np.repeat(np.cumsum(count) - count, count)  # how many after its own one
    is_recorded = behind == 0
    first = np.where(is_recorded, grid.first[own], grid.stop[own])
    whole = is_recorded & grid.whole[own]
    return Grid(grid.number[own] + behind, first, grid.stop[own], whole, grid.every, grid.origin)


def means_of(grid: Grid, rows: Rows, m: int, begin: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (u, y, excluded) of intervals: (K, m + c), (K, p) means, NaN where one is missing; (K,) bool.

    Args:
        grid: the intervals. rows: all samples of these intervals. m: number of the inputs in u, conditions
            stand behind them. begin: number of the first row.
    """
    recorded = grid.stop > grid.first
    bounds = np.append(grid.first[recorded], grid.stop[-1:]) - begin
    u, y = (_means(x, bounds, recorded, grid.whole) for x in (rows.u, rows.y))
    if rows.u.shape[1] > m:
        u[:, m:] = _held(rows.u[:, m:], bounds, recorded, grid.whole)
    excluded = np.zeros(len(recorded), bool)
    if recorded.any():
        excluded[recorded] = np.logical_or.reduceat(rows.excluded[: bounds[-1]], bounds[:-1])
    u[excluded], y[excluded] = np.nan, np.nan
    return u, y, excluded


def _means(x: np.ndarray, bounds: np.ndarray, recorded: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Return (K, n) means of the rows between bounds, each to the last digit."""
    out = np.full((len(recorded), x.shape[1]), np.nan, x.dtype)
    if not recorded.any():
        return out
    rows = np.asarray(x[bounds[0] : bounds[-1]], np.float64)
    count = np.diff(bounds)
    at = bounds[:-1] - bounds[0]
    mean = np.add.reduceat(rows, at) / count[:, None]
    # what rounding left over of many summands
    rest = np.add.reduceat(rows - np.repeat(mean, count, axis=0), at) / count[:, None]
    out[recorded] = mean + rest
    out[~whole] = np.nan
    return out


def _held(x: np.ndarray, bounds: np.ndarray, recorded: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Return (K, c): 1 where a condition holds at all rows between bounds, 0 where at none, NaN where nobody
    knows it at any, else `IN_PART`: where it changes, becomes known or unknown, or a row is lacking.
    """
    out = np.full((len(recorded), x.shape[1]), IN_PART, x.dtype)
    if not recorded.any():
        return out
    rows, at = x[bounds[0] : bounds[-1]], bounds[:-1] - bounds[0]
    told = np.where(np.isnan(rows), IN_PART, rows)
    least, most = np.minimum.reduceat(told, at), np.maximum.reduceat(told, at)
    unknown = np.logical_and.reduceat(np.isnan(rows), at)
    out[recorded] = np.where(unknown, np.nan, np.where(least == most, least, IN_PART))
    out[~whole] = IN_PART
    return out


def is_period(dt: float | None, every: str) -> bool:
    """Return whether samples dt apart, in s, have the step of the interval already."""
    seconds = seconds_of(every)
    return dt is not None and abs(float(dt) - seconds) <= TOLERATED_DT * seconds
