"""Where what was found goes: one file a kind of output, which every command that tests a recording writes
once it is registered.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from jaxbound.models.system import LinearSystem
from jaxbound.recordings.recording import Recording
from jaxbound.runs.summary import Summary

__all__ = ["SINKS", "Outcome", "Sink", "file_names", "register", "write_all"]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What the test of one recording came to.

    Fields: result: a Result, or what else a test returns, a Digest where the recording did not fit into
    memory, None where verdicts were written as samples came; recording: the Recording, or None then; alarms:
    those that are kept; summary; model: that was tested; data: the path of the recording; content: its
    digest, None where it is gone; method, horizon: of the test;
    options: of an observer.
    """

    result: Any
    recording: Recording | None
    alarms: list
    summary: Summary
    model: LinearSystem
    data: Path
    content: str | None
    method: str
    horizon: int
    options: dict = field(default_factory=dict)


class Sink:
    """One kind of output.

    Fields: names: of the files that it writes into the folder of a run, which then are jaxbound's to replace.
    whole: whether it needs the recording in memory.
    """

    names: ClassVar[tuple[str, ...]] = ()
    whole: ClassVar[bool] = False

    def write(self, folder: Path, outcome: Outcome) -> None:
        """Write the files. folder: where they come to lie as a whole, all of a run or none."""
        raise NotImplementedError


SINKS: list[Sink] = []


def register(kind: type[Sink]) -> type[Sink]:
    """Make every command that tests a recording write this output too.

    Args:
        kind: a subclass of Sink.

    Example:
        >>> @register
        ... class Verdict(Sink):
        ...     names = ("verdict.txt",)
        ...     def write(self, folder, outcome):
        ...         (folder / "verdict.txt").write_text(outcome.summary.sentence)
        >>> SINKS.pop().names
        ('verdict.txt',)
    """
    SINKS.append(kind())
    return kind


def file_names(whole: bool = True) -> tuple[str, ...]:
    """Return the names of all files that sinks may write of a recording, read as a whole or in parts."""
    return tuple(name for sink in SINKS if whole or not sink.whole for name in sink.names)


def write_all(folder: Path, outcome: Outcome) -> None:
    """Hand what was found to every sink."""
    for sink in SINKS:
        if outcome.recording is not None or not sink.whole:
            sink.write(folder, outcome)
