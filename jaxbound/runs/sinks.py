"""The outputs of every command that tests a recording."""

from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from jaxbound.recordings.recording import Recording
from jaxbound.runs.loop import Quiet
from jaxbound.runs.runfile import RunRecord
from jaxbound.runs.sink import REGISTERED, Outcome, Sink, Verdicts
from jaxbound.runs.verdictfiles import AlarmTable, VerdictTable

__all__ = ["BUILT_IN", "Beside", "close_all", "file_names", "kinds", "open_sinks"]

BUILT_IN: tuple[type[Sink], ...] = (VerdictTable, AlarmTable, RunRecord)


def kinds(whole: bool) -> list[type[Sink]]:
    """Return the kinds of output of a recording that is in memory, or (`whole` False) of any other."""
    return [kind for kind in (*BUILT_IN, *REGISTERED) if whole or not kind.whole]


def file_names(whole: bool = True) -> tuple[str, ...]:
    """Return the names of all files that sinks may write of a recording, read as a whole or in parts."""
    names: list[str] = []
    for kind in kinds(whole):
        names += kind.names
    return tuple(names)


def open_sinks(folder: Path, whole: bool = True) -> list[Sink]:
    """Return a sink of each kind, for one run that writes into a folder."""
    return [kind(folder) for kind in kinds(whole)]


def close_all(sinks: Iterable[Sink], outcome: Outcome) -> None:
    """Let all sinks write their files of the end."""
    for sink in sinks:
        sink.close(outcome)


class Beside(Quiet):
    """Sinks that write in a thread of their own: together a sink, and a context that waits for it.

    A million verdicts are written while pictures are drawn. Only for recordings in memory: these have no
    checkpoint to be ahead of.
    """

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self.sinks = sinks
        self.thread = ThreadPoolExecutor(1)
        self.jobs: list[Future[None]] = []

    def __enter__(self) -> "Beside":
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        self.thread.shutdown(cancel_futures=kind is not None)
        if kind is None:
            for job in self.jobs:
                job.result()

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        """Let each sink take the samples."""
        self.jobs += [self.thread.submit(sink.add, piece, verdicts) for sink in self.sinks]

    def close(self, outcome: Outcome) -> None:
        """Let each sink write its files of the end."""
        self.jobs += [self.thread.submit(sink.close, outcome) for sink in self.sinks]
