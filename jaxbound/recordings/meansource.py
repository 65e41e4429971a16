"""Sources whose samples are means over the intervals of a clock, see `means`, of what another source reads.

Of a source in parts the times alone are read first: they say which rows each interval has. So a piece of the
samples is the same however the recording is cut.
"""

from collections.abc import Iterator
from functools import cached_property, reduce
from pathlib import Path

import numpy as np

from jaxbound.recordings.clockintervals import seconds_of
from jaxbound.recordings.columns import Arrow, from_arrow
from jaxbound.recordings.means import (
    Grid,
    TooShort,
    Unfinished,
    every_of,
    grid_of,
    instants,
    midnight_of,
    recorded_model,
    usual_step,
)
from jaxbound.recordings.parquet import ParquetSource
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.selection import looks_back
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.source import PartSource, Progress, Source, with_hints
from jaxbound.recordings.timestamps import SECOND

ROWS = 1_000_000  # read at once


def means_source(kind: type[Source], data: object, model: SignalModel) -> Source:
    """Return the source of means of data that another kind of source reads as they were recorded."""
    raw = kind.open(data, recorded_model(model))
    if isinstance(raw, ParquetSource):
        return PartMeans(raw, data, model)
    return MeansSource(raw, data, model)


class MeansSource(Source):
    """The means of a source that is read as a whole.

    Args:
        raw: the source, opened with `recorded_model`. data: of it. model: with the interval.

    Fields: before: the `rest` of the recording before; None: there is none. goes_on: whether others follow.
    """

    before: Unfinished | None = None
    goes_on = False

    def __init__(self, raw: Source, data: object, model: SignalModel) -> None:
        super().__init__(data, model)
        self.raw = raw
        self.every = every_of(model) or ""

    def behind(self, before: Unfinished | None) -> "MeansSource":
        """Return the source of the same means, read as a whole, between a recording before and the next."""
        source = MeansSource(self.raw, self.data, self.model)
        source.before, source.goes_on = before, True
        return source

    @cached_property
    def content(self) -> str | None:
        """The digest of the data as they are when it is first asked for."""
        return self.raw.content

    def whole(self, progress: Progress | None = None) -> Recording:
        """Return the Recording of all means."""
        read = self.raw.read if self.raw.parts else self.raw.whole  # one of them names the data in refusals
        recorded = read(progress=progress)
        left = recorded.unfinished(self.before)
        try:
            grid, behind = left.over(self.every, self.goes_on, bool(looks_back(self.model)))
        except TooShort:
            self.rest = left
            raise
        means = recorded.averaged(grid, left.rows, self.model.m).worded()
        where = self.model.columns.get("where", "")
        means = with_hints(self.model, means, "sample {}".format, where, recorded.hints)
        self.rest = behind
        return means


class PartMeans(PartSource, MeansSource):
    """The means of a recording in Parquet files, none of which is held in memory."""

    raw: ParquetSource

    def __init__(self, raw: ParquetSource, data: object, model: SignalModel) -> None:
        super().__init__(raw, data, model)
        self.path, self.dtype, self.hints, self.plan = raw.path, raw.dtype, raw.hints, raw.plan
        self.dt = seconds_of(self.every)

    @property
    def layout(self) -> str:
        """The facts that are known of the data before they are read, as text."""
        return self.raw.layout

    @property
    def samples(self) -> int:
        """The number of samples."""
        return len(self.grid.number)

    @cached_property
    def grid(self) -> Grid:
        """The intervals, of which the times of all rows are read."""
        raw = self.raw
        if raw.time_name is None:
            raise ValueError(f"{raw.path}: every = {self.every!r} needs a column of times: there is none")
        time, stamps = raw.first_times()
        origin = midnight_of(stamps)
        usual = usual_step(instants(time, stamps, origin), self.every)
        clock = raw.clock(ROWS, raw.samples)
        chunks = (instants(seconds, dates, origin) for seconds, dates in clock)
        try:
            return grid_of(chunks, self.every, usual, origin, bool(looks_back(self.model)))
        except ValueError as e:
            raise ValueError(f"{raw.path}: {e}") from None

    def unchanged(self, *files: Path) -> None:
        """Raise ValueError if one of the files was written since it was opened."""
        self.raw.unchanged(*files)

    def content_of(self, first: int, stop: int) -> str:
        """Return the digest of the row groups that the samples first..stop are means of."""
        part = self.grid.part(first, stop)
        if not len(part.first):
            return self.raw.content_of(0, 0)
        return self.raw.content_of(int(part.first[0]), int(part.stop[-1]))

    def row(self, k: int) -> str:
        """Return how the user finds the first row of sample k."""
        return self.raw.row(min(int(self.grid.first[k]), self.raw.samples - 1))

    def time(self, k: int) -> float:
        """Return the time of sample k in seconds."""
        return float(self.grid.part(k, k + 1).time(self._zero)[0])

    @property
    def zero(self) -> np.datetime64 | None:
        """The time stamp of 0 s, or None where there are none."""
        stamps = self.grid.part(0, 1).stamps
        return None if stamps is None else stamps[0]

    def times(self, start: int, written: Arrow) -> tuple[np.ndarray, np.ndarray | None]:
        """Return (seconds, datetime64[ns] or None) of a column of times of means."""
        times = from_arrow(written)
        if self.zero is None:
            return times, None
        return (times - self.zero) / SECOND, times

    def chunks(self, first: int, stop: int, size: int) -> Iterator[tuple[int, Recording]]:
        """Yield (number of its first sample, Recording) of `size` samples each."""
        for at in range(first, stop, size):
            yield at, self._part(at, min(at + size, stop))

    @property
    def _zero(self) -> int:
        """The number of the first interval."""
        return int(self.grid.number[0])

    def _part(self, first: int, stop: int) -> Recording:
        """Return the samples first..stop without starts and hints, of some rows at a time."""
        pieces: list[Recording] = []
        at = first
        while at < stop:
            last = int(self.grid.first[at]) + ROWS
            end = min(max(int(np.searchsorted(self.grid.stop, last, "right")), at + 1), stop)
            part = self.grid.part(at, end)
            like = self._recorded(int(part.first[0]), int(part.stop[-1]))
            rows = like.rows(self.grid.origin)
            pieces.append(like.averaged(part, rows, self.model.m, int(part.first[0]), self._zero))
            at = end
        return reduce(Recording.followed, pieces)

    def _recorded(self, first: int, stop: int) -> Recording:
        """Return the rows first..stop as they were recorded; where there are none, one that is in no mean."""
        stop = max(stop, first + 1)
        if stop > self.raw.samples:
            first, stop = self.raw.samples - 1, self.raw.samples
        ((_, recorded),) = self.raw.chunks(first, stop, stop - first)
        return recorded
