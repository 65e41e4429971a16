"""Verdicts and alarms as files: CSV with the times of the recording as its owner wrote them."""

from collections.abc import Sequence
from functools import singledispatch
from os import PathLike
from typing import Any

import numpy as np

from jaxbound.diagnosis.alarms import ENDINGS, Alarm
from jaxbound.recordings.columns import to_arrow, words, write_columns
from jaxbound.recordings.recording import Recording
from jaxbound.runs.sink import Outcome, Sink, Verdicts
from jaxbound.sets.floats.status import Status

__all__ = ["AlarmTable", "VerdictTable", "alarm_columns", "columns_of", "write_alarms", "write_verdicts"]


class VerdictTable(Sink):
    """verdicts.csv: one row a sample, of a recording that fits into memory; others have verdicts.parquet."""

    names, whole = ("verdicts.csv",), True

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        """Write the table: the recording comes as one piece."""
        write_verdicts(self.folder / self.names[0], verdicts, piece)


class AlarmTable(Sink):
    """alarms.csv: one row an alarm; those of a recording in parts are written as its verdicts are read."""

    names, whole = ("alarms.csv",), True

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        """Keep the recording, whose times the alarms are told by."""
        self.recording = piece

    def close(self, outcome: Outcome) -> None:
        """Write the table."""
        write_alarms(self.folder / self.names[0], outcome.alarms, self.recording, outcome.model.dt)


def write_verdicts(path: str | PathLike, result: Any, recording: Recording | None = None) -> None:
    """Write one row a sample: time (as the recording has it), and the columns of the result.

    Args:
        path: of the CSV file to write. result: of one recording. recording: from `read`; None: sample
            numbers.
    """
    time = to_arrow(np.arange(len(result.status))) if recording is None else recording.column
    write_columns(path, {"time": time, **columns_of(result)})


@singledispatch
def columns_of(result: Any) -> dict[str, Any]:
    """Return the columns of a result beside the time: status, margin (blank where there is none), suspect."""
    return {
        "status": words([x.name for x in Status], result.status),
        "margin": to_arrow(result.margin),
        "suspect": to_arrow(result.suspect),
    }


def write_alarms(path: str | PathLike, alarms: Sequence[Alarm], recording: Recording, dt: float) -> None:
    """Write one row an alarm: start and end (time of the recording), duration in s, FAULT windows, depth and
    when it was reached.

    `factor` is how many times wider the bounds would have to be; an alarm of a single sample lasts dt;
    `ended`: see `Alarm`.
    """
    column = lambda name, kind=np.int64: np.array([getattr(a, name) for a in alarms], kind)
    written = recording.column
    starts, ends, depth = column("start"), column("end"), column("depth", np.float64)
    when = {name: written.take(to_arrow(column(name))) for name in ("start", "end", "worst")}
    seconds = {"from": recording.time[starts], "to": recording.time[ends]}
    ended = np.array([ENDINGS.index(a.ended) for a in alarms], np.int64)
    found = {
        "first_sample": starts,
        "last_sample": ends,
        "windows": column("windows"),
        "depth": depth,
        "ended": ended,
    }
    write_columns(path, alarm_columns({**when, **seconds, **found}, dt))


def alarm_columns(alarms: Any, dt: float) -> dict[str, Any]:
    """Return the columns of alarms.csv.

    Args:
        alarms: {"start", "end", "worst": times as the recording has them (pyarrow), "from", "to": seconds,
            "first_sample", "last_sample", "windows", "depth", "ended" (numbers of ENDINGS): NumPy}, one entry
            an alarm.
    """
    return {
        "start": alarms["start"],
        "end": alarms["end"],
        "duration_s": to_arrow(np.round(alarms["to"] - alarms["from"] + dt, 9)),
        "first_sample": to_arrow(alarms["first_sample"]),
        "last_sample": to_arrow(alarms["last_sample"]),
        "windows": to_arrow(alarms["windows"]),
        "depth": to_arrow(alarms["depth"]),
        "factor": to_arrow(1 - alarms["depth"]),
        "worst": alarms["worst"],
        "ended": words(ENDINGS, alarms["ended"]),
    }
