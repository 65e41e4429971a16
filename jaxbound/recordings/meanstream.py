"""Streams whose samples are means over the intervals of a clock: those of the same recording as a whole.

An interval is judged when the next one begins. The first hundred samples show the usual step, see `means`, so
the means of the first intervals come together behind them. Samples of the interval that is not over are kept,
so that another process goes on with them.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from jaxbound.recordings.columns import moments, to_arrow
from jaxbound.recordings.factors import known
from jaxbound.recordings.means import (
    FIRST,
    Grid,
    Rows,
    every_of,
    finished,
    means_of,
    midnight_of,
    usual_step,
)
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.stream import Stream

__all__ = ["MeansStream"]


class MeansStream(Stream):
    """The means of another stream.

    Args:
        reading: the samples as they are recorded, of `means.recorded_model`. model: with the interval.
        memory: from `.memory()` of another MeansStream, to go on where that ended; None: a new stream.
    """

    def __init__(self, reading: Stream, model: SignalModel, memory: dict[str, Any] | None = None) -> None:
        super().__init__(model, reading.complain, reading.taken)
        self.reading, self.raw, self.units = reading, reading.raw, reading.units
        self.every = every_of(model) or ""
        self.rows: Rows | None = None  # from the last one of the interval before on
        self.usual: int | None = None  # step in ns
        self.origin: np.datetime64 | None = None
        self.zero: int | None = None  # number of the first interval that counts
        self.has_before = False
        if memory is not None:
            self._resume_from(memory)

    @property
    def replaying(self) -> bool:  # type: ignore[override]
        """Whether the sender has begun again, and all that it sends was taken before."""
        return self.reading.replaying

    def _resume_from(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        self._resume_clock(memory)
        if memory["rows"] is not None:
            self.rows = self._rows_of(memory["rows"])
        self.usual, self.zero = memory["usual"], memory["zero"]
        self.has_before = memory["has_before"]
        if memory["origin"] is not None:
            self.origin = np.datetime64(memory["origin"], "ns")

    def _rows_of(self, rows: dict[str, Any]) -> Rows:
        """Return samples from JSON."""
        count = len(rows["instant"])
        return Rows(
            np.array(rows["instant"], np.int64),
            np.array(rows["u"], float).reshape(count, len(known(self.model))),
            np.array(rows["y"], float).reshape(count, len(self.model.outputs)),
            np.array(rows["excluded"], bool),
            np.array(rows["broken"], bool),
        )

    def memory(self) -> dict[str, Any] | None:
        """Return the state from which another process goes on; None before the first sample."""
        reading = self.reading.memory()
        if reading is None:
            return None
        rows = None
        if self.rows is not None:
            rows = self.rows.plain()
        origin = None
        if self.origin is not None:
            origin = int(self.origin.astype(np.int64))
        return {
            "reading": reading,
            **self._clock_memory(),
            "rows": rows,
            "usual": self.usual,
            "origin": origin,
            "zero": self.zero,
            "has_before": self.has_before,
        }

    def pieces(self, arrivals: Iterator[Any]) -> Iterator[tuple[int, Recording]]:
        """Yield (number of its first sample, Recording) of the means that samples complete, as they come.

        Raises:
            ValueError: as the samples themselves, or an interval that is shorter than their step.
        """
        for _, piece in self.reading.pieces(arrivals):
            self.lost, self.skipped = self.reading.lost, self.reading.skipped
            if piece.samples:
                self._take(piece)
            means = self._means()
            if means is None:
                yield self.nothing()
            else:
                yield self.clock.samples - means.samples, means
        if self.usual is None:
            self.complain(
                "means", f"of {FIRST} samples that show the usual step some did not come: none is judged"
            )

    def _take(self, piece: Recording) -> None:
        """Keep the samples of a piece."""
        if self.rows is None:
            self.origin = midnight_of(piece.dates)
        rows = replace(piece, u=np.asarray(piece.u, float), y=np.asarray(piece.y, float)).rows(self.origin)
        rows.broken[piece.starts] = True
        if self.rows is not None:
            rows = self.rows.followed(rows)
        self.rows = rows

    def _means(self) -> Recording | None:
        """Return the means of the intervals that are over; None where there is none."""
        rows = self.rows
        if rows is None:
            return None
        if self.usual is None:
            if len(rows.instant) < FIRST:
                return None
            self.usual = usual_step(rows.instant, self.every)
        begun = self.zero is not None
        done, rest = finished(rows, self.every, self.usual, self.origin, self.has_before, begun)
        if rest:
            self.rows, self.has_before = rows.behind(rest - 1), True
        if not len(done.number):
            return None
        if self.zero is None:
            self.zero = int(done.number[0])
        excluded = None
        if "where" in self.model.columns:
            excluded = rows.excluded
        return self._seamed(done, means_of(done, 0, rows.u, rows.y, excluded, self.model.m))

    def _seamed(self, grid: Grid, samples: tuple[np.ndarray, np.ndarray, np.ndarray | None]) -> Recording:
        """Return means as a Recording with its seams."""
        assert self.zero is not None, "an interval is over"
        like = Recording(*samples[:2], NOWHERE, known(self.model), self.model.outputs)
        means = like.on_grid(grid, self.zero, samples)
        if means.stamps is not None:
            means = replace(means, written=moments(to_arrow(means.stamps)))
        return replace(means, starts=np.union1d(*self.seams(means.time, means.excluded)))
