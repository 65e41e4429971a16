"""Verdicts and alarms as files: CSV with the times of the recording as its owner wrote them."""

from collections.abc import Callable, Sequence
from functools import singledispatch
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.result import Result, suspected
from jaxbound.diagnosis.suspects import tells_causes
from jaxbound.recordings.columns import Arrow, Words, texts, to_arrow, write_columns
from jaxbound.recordings.parquet import VERDICTS
from jaxbound.recordings.recording import Recording
from jaxbound.runs.contradiction import Spoken
from jaxbound.runs.sink import Outcome, Sink, Verdicts
from jaxbound.sets.floats.status import Status

STATUS = [status.name for status in Status]
Columns = dict[str, Arrow]
"""{name: column}, as they are written."""


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
        found = outcome.summary.found
        region = found is not None and found.outside is not None
        tests, suspects = found is not None and found.tests is not None, outcome.names_suspects
        causes = suspects and tells_causes(outcome.model)
        shows = AlarmColumns(outcome.model.dt, region, tests, suspects, causes)
        write_alarms(self.folder / self.names[0], outcome.alarms, self.recording, shows)


def write_verdicts(path: str | PathLike[str], result: Verdicts, recording: Recording | None = None) -> None:
    """Write one row a sample: time (as the recording has it), and the columns of the result.

    Args:
        path: of the CSV file to write. result: of one recording. recording: from `read`; None: sample
            numbers.
    """
    if recording is None:
        time = to_arrow(np.arange(len(result.status)))
    else:
        time = recording.column
    write_columns(path, {"time": time, **verdict_columns(result)})


def spoken_of(folder: Path, k: int) -> Spoken:
    """Return the word of a run's files, in a folder, on sample k; none of files that are gone."""
    import pyarrow.csv
    import pyarrow.dataset

    wanted = ["status", "test"]
    table, parts = folder / VerdictTable.names[0], folder / VERDICTS
    if table.is_file():
        options = pyarrow.csv.ConvertOptions(strings_can_be_null=False)
        rows = pyarrow.csv.read_csv(table, convert_options=options).slice(k, 1)
    elif parts.exists():
        files = pyarrow.dataset.dataset(parts)
        rows = files.take([k], columns=[name for name in wanted if name in files.schema.names])
    else:
        return Spoken()
    said = rows.to_pylist()
    if not said:
        return Spoken()
    return Spoken(*(str(said[0].get(name) or "") for name in wanted))


def named_columns(result: Verdicts) -> dict[str, np.ndarray | Words]:
    """Return the columns of verdicts beside the time.

    status; margin, blank where there is none. Where there is a region of training: outside, the share by
    which a window lies outside, 0 inside, blank where it is MISSING; outside_by, the input; outside_at, its
    sample. Of a monitor: test, the one that speaks, blank where none does. Those of the test; suspect.
    """
    columns: dict[str, np.ndarray | Words] = {"status": Words(STATUS, result.status), "margin": result.margin}
    departure, by = result.departure, getattr(result, "by", None)
    if departure is not None:
        columns["outside"] = departure.share
        columns["outside_by"] = Words(departure.names, departure.by + 1)
        columns["outside_at"] = departure.reading
    if by is not None:
        columns["test"] = Words(("", *getattr(result, "names", ())), by + 1)
    columns |= getattr(result, "columns", {})
    return columns | {"suspect": suspected(result.status, result.margin)}


@singledispatch
def verdict_columns(result: Verdicts) -> Columns:
    """Return `named_columns` as they are written."""
    columns = named_columns(result)
    return dict(zip(columns, map(to_arrow, columns.values()), strict=True))


@verdict_columns.register(Result)
def _(result: Result) -> Columns:
    """Return those of a Result: margins of FAULT windows are exact."""
    return verdict_columns(result.judged())


class AlarmColumns(NamedTuple):
    """The columns of alarms.csv.

    Fields: dt: sampling period in s. region: whether there is a region of training. tests: whether a monitor
    judged. suspects: whether the rule of alarms names them. causes: whether the model names faults, too.
    """

    dt: float
    region: bool = False
    tests: bool = False
    suspects: bool = False
    causes: bool = False

    def of(self, alarms: Sequence[Alarm], at: Callable[[np.ndarray], tuple[Arrow, np.ndarray]]) -> Columns:
        """Return start and end (time of the recording), duration in s, FAULT windows, depth and when it was
        reached.

        `factor` is how many times wider the bounds would have to be; an alarm of a single sample lasts dt;
        `ended`, `test`, `suspect`, `size`, `cause`, `outside`, `outside_by`: see `Alarm`.

        Args:
            at: the times of samples, as written and in seconds.
        """

        def numbers(name: str, kind: type = np.int64) -> np.ndarray:
            return np.array([getattr(alarm, name) for alarm in alarms], kind)

        def said(name: str) -> Arrow:
            return texts([getattr(alarm, name) for alarm in alarms])

        start, end, depth = numbers("start"), numbers("end"), numbers("depth", np.float64)
        (begun, begin), (over, stop) = at(start), at(end)
        columns = {
            "start": begun,
            "end": over,
            "duration_s": to_arrow(np.round(stop - begin + self.dt, 9)),
            "first_sample": to_arrow(start),
            "last_sample": to_arrow(end),
            "windows": to_arrow(numbers("windows")),
            "depth": to_arrow(depth),
            "factor": to_arrow(1 - depth),
            "worst": at(numbers("worst"))[0],
            "ended": said("ended"),
        }
        if self.tests:
            columns["test"] = said("test")
        if self.suspects:
            columns |= {"suspect": said("suspect"), "size": to_arrow(numbers("size", np.float64))}
        if self.causes:
            columns["cause"] = said("cause")
        if self.region:
            columns |= {"outside": to_arrow(numbers("outside")), "outside_by": said("outside_by")}
        return columns


def write_alarms(
    path: str | PathLike[str], alarms: Sequence[Alarm], recording: Recording, shows: AlarmColumns
) -> None:
    """Write one row an alarm, with the times of the recording."""
    written, time = recording.column, recording.time

    def at(samples: np.ndarray) -> tuple[Arrow, np.ndarray]:
        return written.take(to_arrow(samples)), time[samples]

    write_columns(path, shows.of(alarms, at))
