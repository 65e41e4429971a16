"""Streams: recordings that come as time goes by, piece by piece, each sample once.

A stream is a source as any other (`source.Source`, with `live`): it yields Recordings. It also remembers its
position, so that another process can go on behind it.
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from jaxbound.recordings.factors import known
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.recordings.seams import Clock, Seam
from jaxbound.recordings.signals import SignalModel

__all__ = ["Complain", "Stream"]

Complain = Callable[[str, str], None]
"""Called with (kind, sentence) on each sample that is left out, and each seam."""


class Stream:
    """Samples as they come.

    Args:
        model: whose signals are wanted. complain: see `Complain`.

    Fields: raw: where they come from, an iterator, or the number of an open file; dt: sampling period in s;
    regular: whether samples have to be dt apart; else no step is a seam; clock: of all samples so far; lost:
    samples, or lines, that could not be read; replaying: whether the sender has begun again, and all that it
    sends was taken before.
    """

    raw: Any = ()
    replaying = False

    def __init__(self, model: SignalModel, complain: Complain) -> None:
        self.model, self.complain = model, complain
        self.dt = model.dt or 1.0
        self.regular: bool = getattr(model, "regular", True)
        self.clock = Clock(self.dt)
        self.lost = 0

    def pieces(self, arrivals: Iterator[Any]) -> Iterator[tuple[int, Recording]]:
        """Yield (number of its first sample, Recording) as samples come; one without samples where there are
        none.

        `starts` of a piece has 0 where its first sample does not follow the last one before.

        Args:
            arrivals: what comes from `raw`; None in it ends the stream as a signal does.
        """
        raise NotImplementedError

    def memory(self) -> dict[str, Any] | None:
        """Return the state from which another process goes on, as JSON holds it; None where there is none
        yet.
        """
        raise NotImplementedError

    def when(self, piece: Recording, k: int) -> str | float:
        """Return the time of a sample of a piece, as JSON holds it."""
        raise NotImplementedError

    def label(self, when: str | float) -> str:
        """Return a time from `when` as the owner of the samples would write it."""
        raise NotImplementedError

    def nothing(self) -> tuple[int, Recording]:
        """Return the piece without samples."""
        columns, outputs = known(self.model), self.model.outputs
        u, y = np.empty((0, len(columns))), np.empty((0, len(outputs)))
        return self.clock.samples, Recording(u, y, NOWHERE, columns, outputs)

    def _clock_memory(self) -> dict[str, Any]:
        """Return the memory of the clock."""
        return {
            "samples": self.clock.samples,
            "time": self.clock.last,
            "seams": [asdict(seam) for seam in self.clock.seams],
            "lost": self.lost,
        }

    def _resume_clock(self, memory: dict[str, Any]) -> None:
        """Let the clock go on from a memory."""
        seams = tuple(Seam(**seam) for seam in memory["seams"])
        self.clock = Clock(self.dt, memory["samples"], memory["time"], seams)
        self.lost = memory["lost"]
