"""Streams whose samples are means over the intervals of a clock: those of the same recording as a whole.

An interval is judged when the next one begins. The first hundred samples show the usual step, see `means`, so
the means of the first intervals come together behind them. Samples of the interval that is not over are kept,
so that another process goes on with them.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from jaxbound.recordings.means import FIRST, Unfinished, every_of
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.selection import looks_back
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.stream import Stream


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
        self.left: Unfinished | None = None  # samples that are in no mean yet
        self.rates = bool(looks_back(model))
        self.zero: int | None = None  # number of the first interval that counts
        if memory is not None:
            self._resume_clock(memory)
            self.zero = memory["zero"]
            if memory["left"] is not None:
                self.left = Unfinished.of(memory["left"])

    @property
    def replaying(self) -> bool:  # type: ignore[override]
        """Whether the sender has begun again, and all that it sends was taken before."""
        return self.reading.replaying

    def memory(self) -> dict[str, Any] | None:
        """Return the state from which another process goes on; None before the first sample."""
        reading = self.reading.memory()
        if reading is None:
            return None
        left = None
        if self.left is not None:
            left = {name: x.tolist() for name, x in self.left.arrays().items()}
        return {"reading": reading, **self._clock_memory(), "left": left, "zero": self.zero}

    def pieces(self, arrivals: Iterable[Any]) -> Iterator[tuple[int, Recording]]:
        """Yield (number of its first sample, Recording) of the means that samples complete, as they come.

        Raises:
            ValueError: as the samples themselves, or an interval that is shorter than their step.
        """
        for _, piece in self.reading.pieces(arrivals):
            self.lost, self.skipped = self.reading.lost, self.reading.skipped
            means = None
            if piece.samples:
                means = self._means(piece)
            yield self.numbered(means)
        if self.left is None or len(self.left.shown) < FIRST:
            self.complain(
                "means", f"of {FIRST} samples that show the usual step some did not come: none is judged"
            )

    def _means(self, piece: Recording) -> Recording | None:
        """Return the means of the intervals that are over behind a piece; None where there is none."""
        piece = replace(piece, u=np.asarray(piece.u, float), y=np.asarray(piece.y, float))
        if self.left is None:
            left = piece.unfinished()
        else:
            left = self.left.followed(piece.rows(self.left.origin))
        left.rows.broken[piece.starts - piece.samples] = True
        self.left = left
        if len(left.shown) < FIRST:
            return None
        over, self.left = left.over(self.every, None, self.rates)
        if not len(over.number):
            return None
        if self.zero is None:
            self.zero = int(over.number[0])
        means = piece.averaged(over, left.rows, self.model.m, zero=self.zero).worded()
        return replace(means, starts=np.union1d(*self.seams(means.time, means.excluded)))
