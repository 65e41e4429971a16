"""The one loop of every verb and command: pieces from a source, judged, handed to sinks.

| run | source | judge | sinks |
|---|---|---|---|
| Parquet, to verdicts | chunks of the files | windows, or an observer | parts of a fixed size |
| Parquet, to a report | the parts | none: they are judged | counts, timeline, alarms |
| a pipe, or a live source | samples as they come | a Monitor | counts, rows of CSV, lines on stdout |
| a fleet | units of one model | `detect` of each | pages, rows of the table |

A share of a recording is the second with fewer parts.
"""

import time
from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol, TypeVar

Piece = TypeVar("Piece")
PieceIn = TypeVar("PieceIn", contravariant=True)
Samples = TypeVar("Samples")
SamplesIn = TypeVar("SamplesIn", contravariant=True)
SamplesOut = TypeVar("SamplesOut", covariant=True)
Verdicts = TypeVar("Verdicts")
VerdictsIn = TypeVar("VerdictsIn", contravariant=True)
VerdictsOut = TypeVar("VerdictsOut", covariant=True)
Memory = object
"""State that JSON can hold; None: there is none."""


class Remembering(Protocol):
    """A part of the loop whose state stands in a checkpoint."""

    def memory(self) -> Memory:
        """Return the state behind the last piece, as JSON holds it."""


class Judge(Protocol[PieceIn, SamplesOut, VerdictsOut]):
    """The judge of pieces: it yields the samples that are new in one, with their verdicts."""

    def __call__(self, piece: PieceIn, /) -> Iterable[tuple[SamplesOut, VerdictsOut]]:
        """Judge the next piece; a piece without new samples yields nothing."""


class Taker(Remembering, Protocol[SamplesIn, VerdictsIn]):
    """A sink as the loop sees it, see `sink.Sink`."""

    def add(self, piece: SamplesIn, verdicts: VerdictsIn, /) -> None:
        """Take the next samples and their verdicts."""

    def flush(self) -> None:
        """Hand on what was taken: from now on it is in the checkpoint."""


class Quiet:
    """The half of a sink that needs no memory, and hands nothing on before the end."""

    def memory(self) -> Memory:
        """Return None: the next process begins with this sink anew, or finds its work on the disk."""
        return None

    def flush(self) -> None:
        """Do nothing: nobody waits for what was taken."""


class Journaled(Protocol):
    """The one checkpoint of a run."""

    def save(self) -> None:
        """Save the memory of source, judge and sinks together, or nothing."""


class Laps:
    """Seconds of the stages of the loop.

    Fields: seconds: {name of a stage: seconds so far}.
    """

    def __init__(self, seconds: dict[str, float]) -> None:
        self.seconds, self.last = seconds, time.perf_counter()

    def __call__(self, stage: str) -> None:
        """Add the time since the last call to a stage."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self.last
        self.last = now


def follow(
    source: Iterable[Piece],
    judge: Judge[Piece, Samples, Verdicts],
    sinks: Sequence[Taker[Samples, Verdicts]],
    checkpoint: Journaled | None = None,
    laps: Laps | None = None,
) -> Iterator[Piece]:
    """Judge the pieces of a source and hand each to all sinks; yield each piece behind them.

    The order is what makes a killed run whole: sinks take, then the checkpoint is saved, then sinks hand on.
    Whenever the process dies, the next one knows from the last checkpoint what was to be handed on.

    Args:
        source: the pieces, in order. judge: of each of them. sinks: see `sink.Sink`. checkpoint: saved behind
            each piece; None: the sinks themselves are all there is to go on from. laps: gets the seconds of
            the stages "read", "compute" and "write"; a judge may add more.
    """
    lap = laps or Laps({})
    for piece in source:
        lap("read")
        for samples, verdicts in judge(piece):
            lap("compute")
            for sink in sinks:
                sink.add(samples, verdicts)
            lap("write")
        if checkpoint is not None:
            checkpoint.save()
        for sink in sinks:
            sink.flush()
        yield piece
