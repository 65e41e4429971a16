"""Who judges the pieces of a recording as they are read: windows, or an observer that goes on from piece to
piece.
"""

import itertools
from collections.abc import Iterator
from typing import Any

from jaxbound.diagnosis.again import COUNT, decided_again, judged_elsewhere
from jaxbound.diagnosis.detection import detect
from jaxbound.files.checkpoint import as_texts
from jaxbound.recordings.recording import Recording

__all__ = ["Carried", "Windows"]


class Windows:
    """Judges the samples of a piece by windows, which reach back into the piece before.

    Fields: overlap: so many samples of it are needed. begins: and of those before the first piece. again:
    {devices: how many windows were decided again on the CPU} since somebody took it; none where CPUs judge.

    Args:
        samples: of the whole recording, over which those that are decided again are spread.
    """

    def __init__(self, relations: Any, method: str, samples: int) -> None:
        self.relations, self.method, self.overlap, self.begins = (
            relations,
            method,
            relations.horizon,
            relations.horizon,
        )
        self.samples = samples
        self.again: dict[str, int] = {}

    def __call__(self, piece: Recording, first: int, done: int) -> Iterator[tuple]:
        """Yield (samples of the piece, their status and margin, what is carried on) of what is new in it:
        from sample `done` on.
        """
        found, fresh = detect(self.relations, piece, method=self.method), slice(done - first, piece.samples)
        if devices := judged_elsewhere():
            count = decided_again(found, -(-COUNT * piece.samples // self.samples), seed=first)
            self.again[devices] = self.again.get(devices, 0) + count
        yield fresh, found.status[fresh], found.margin[fresh], None


class Carried:
    """Judges the samples of a piece by an observer, part by part. overlap: the sample before says whether the
    first one follows it.

    Args:
        watch, carry: the observer and what it carries. size: of a part, in samples.
        warm: samples before the first part that it is given, in the first piece; None: it goes on with the
            carry.
    """

    overlap = 1
    again: dict[str, int] = {}  # nobody decides again what rests on all samples before

    def __init__(self, watch: Any, carry: Any, size: int, warm: int | None = None) -> None:
        self.watch, self.carry, self.size, self.warm = watch, carry, size, warm
        self.begins = max(warm or 0, self.overlap)

    def __call__(self, piece: Recording, first: int, done: int) -> Iterator[tuple]:
        """As of Windows, and what is carried behind them."""
        _, piece = self.watch.recording(piece)
        stop = first + piece.samples
        if self.warm and done > first:
            self.carry, _ = self.watch.fold(
                self.carry, piece.cut(max(done - self.warm - first, 0), done - first)
            )
        self.warm = None
        edges = [done, *range((done // self.size + 1) * self.size, stop, self.size), stop]
        for begin, end in itertools.pairwise(edges):
            fresh = slice(begin - first, end - first)
            self.carry, found = self.watch.fold(self.carry, piece.cut(fresh.start, fresh.stop))
            yield fresh, found.status, found.margin, as_texts(self.carry)
