"""The outputs of every command that tests a recording."""

from collections.abc import Iterable
from pathlib import Path

from jaxbound.runs.runfile import RunRecord
from jaxbound.runs.sink import REGISTERED, Outcome, Sink
from jaxbound.runs.verdictfiles import AlarmTable, VerdictTable

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
