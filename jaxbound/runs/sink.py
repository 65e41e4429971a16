"""Outputs for verdicts: one file a kind of output, which every command that tests a recording writes.

The outputs of jaxbound stand in a list, `sinks.BUILT_IN`; `register` adds one of a user.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.causes import Verdicts
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.recording import Recording
from jaxbound.runs.ask import Ask
from jaxbound.runs.loop import Memory, Quiet
from jaxbound.runs.summary import Summary

__all__ = ["REGISTERED", "Outcome", "Sink", "Verdicts", "register"]


@dataclass(frozen=True, eq=False)
class Outcome:
    """The outcome of the test of one recording.

    Fields: alarms: those that are kept; summary; model: that was tested; data: the path of the recording;
    content: its digest, None where it is gone; ask, horizon: of the test; names_suspects: whether the alarms
    name their suspects.
    """

    alarms: Sequence[Alarm]
    summary: Summary
    model: LinearSystem
    data: Path
    content: str | None
    ask: Ask
    horizon: int
    names_suspects: bool = False


class Sink(Quiet):
    """One kind of output of one run.

    Args:
        folder: to write into; the files come to lie there as a whole, all of a run or none.

    Fields: names: of the files that it writes into the folder of a run, which then are jaxbound's to replace.
    whole: whether it needs the recording in memory.

    Samples come once, in order, by `add`: those of a recording in memory at once, with a Result (or whatever
    the test returns), those of a larger one in parts, those of a pipe as they come. Of a larger recording the
    pieces have times and no signals.
    """

    names: ClassVar[tuple[str, ...]] = ()
    whole: ClassVar[bool] = False

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        """Take the next samples and their verdicts."""

    def memory(self) -> Memory:
        """Return the state from which the next process goes on if this one is killed, as JSON holds it."""
        return None

    def resume(self, memory: Memory) -> None:
        """Go on from the `memory` of another process."""

    def flush(self) -> None:
        """Hand on the samples that were taken, as to stdout: `memory` is safe by now."""

    def close(self, outcome: Outcome) -> None:
        """Write the files that are written at the end."""


REGISTERED: list[type[Sink]] = []


def register(kind: type[Sink]) -> type[Sink]:
    """Make every command that tests a recording write this output too.

    Args:
        kind: a subclass of Sink.

    Example:
        >>> @register
        ... class Verdict(Sink):
        ...     names = ("verdict.txt",)
        ...     def close(self, outcome):
        ...         (self.folder / "verdict.txt").write_text(outcome.summary.sentence)
        >>> REGISTERED.pop().names
        ('verdict.txt',)
    """
    REGISTERED.append(kind)
    return kind
