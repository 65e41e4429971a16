"""Recordings from files: one door for all kinds of paths."""

import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.recordings.clockintervals import every_text
from jaxbound.recordings.csvfiles import CsvFile
from jaxbound.recordings.expressions import is_expression
from jaxbound.recordings.live import LiveSource
from jaxbound.recordings.means import every_of, every_step
from jaxbound.recordings.meansource import means_source
from jaxbound.recordings.otherunits import other_units
from jaxbound.recordings.parquet import ParquetSource
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.recordingformat import Formatted, RecordingFormat, Stated, format_of
from jaxbound.recordings.seams import FEW, TOLERATED_DT, UNITS, varied_steps
from jaxbound.recordings.signals import Named, SignalModel, Signals, signals_of
from jaxbound.recordings.source import KINDS, Outline, Source
from jaxbound.recordings.suspects import suspicions
from jaxbound.recordings.table import Data, as_table, is_table
from jaxbound.recordings.tabletime import kinds_of
from jaxbound.text.progress import Progress, in_part, reporter

Signal = str | tuple[str, str]
"""A name, or (name, column)."""


def read(path: object, model: Named, progress: Progress | None = None, recording: Stated = None) -> Recording:
    r"""Read the signals of a model from a CSV file, a Parquet file or a folder of Parquet files, which follow
    each other by name.

    CSV: delimiter `,`, `;` or tab; decimal comma with the latter two. Blank, NaN, null and NA cells are
    missing samples, and so is a blank line where there is one column. Every line is a row: a cell in
    quotation marks ends on its line. Columns that the model does not name are ignored. Time as time
    stamps, as an epoch, or in seconds, unless its name ends in another unit, like `Time [h]` or `t_ms`, or it
    counts days; without a time column the samples are dt apart. A last line without a line end is left out,
    and so are lines above the names, units below them, a summary at the end, and, where there is a time, rows
    without one and repeated headers: .hints count them. A column whose cells all have a unit, signs for
    thousands, or words like ON and OFF, is read so where no other reading is left.

    Args:
        path: of the file or folder, or of a pipe like bash's <(zcat run.csv.gz).
        model: whose signals are wanted: a LinearSystem, an IntervalSystem, relations, an observer or a
            monitor of one, or anything else with names of .inputs and .outputs.
        progress: called with the share of the work done.
        recording: how the file is written, a `RecordingFormat` or a mapping with its fields, beside what the
            model states of it.

    Returns:
        A Recording, which every verb takes in the place of u: detect(relations, read("run.csv", model)).
        Samples that do not follow each other (.starts), those that the model's `where` leaves out (.excluded)
        and missing ones (NaN) are known to it; .hints are sentences for whoever owns the file, .label(k) is
        the time of a sample as it stands there.

    Raises:
        OSError: no such file. ValueError: standard input; anything that is not a regular recording of this
            model: what, and in which row.

    Example:
        >>> import tempfile, pathlib, jaxbound as jb
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "run.csv"
        >>> _ = path.write_text("time,level\n0,1.0\n1,0.5\n2,0.8\n60,0.4\n61,0.2\n")
        >>> m = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, outputs=["level"])
        >>> run = jb.read(path, m)
        >>> run.hints[0]
        'the recording has a gap of 58 s before row 5 (60 s): the recording is split there, and windows across
        are MISSING'
        >>> jb.detect(jb.parity_relations(m), run).status
        array([0, 1, 3, 0, 1], dtype=int8)
    """
    report = reporter(progress, "read")
    if recording is not None:
        model = cast(SignalModel, Formatted(signals_of(model), recording))
    return open_source(path, model).read(progress=report)


def recorded(model: Named, u: Data, y: Data = None, starts: ArrayLike = (), narrow: bool = True) -> Recording:
    """Return the Recording of the samples that a user gives to a verb, see `Recording.of`; a path is read."""
    if isinstance(u, str | PathLike):
        if y is not None:
            raise ValueError(f"a path holds inputs and outputs: leave y out beside {str(u)!r}")
        u = read(u, model)
    return Recording.of(model, u, y, starts, narrow=narrow)


def open_source(data: object, model: Named) -> Source:
    """Return the Source of a path, of arrays or tables. See `read` for the paths, and for errors.

    Args:
        data: a path; or what `Recording.of` takes: a table or a Recording of both, or a tuple (u, y) or (u,
            y, starts).
        model: as for `read`.
    """
    kind, signals = kind_of(data), signals_of(model)
    if every_of(signals) is not None and kind.as_recorded:
        return means_source(kind, data, signals)
    return kind.open(data, signals)


def kind_of(data: object) -> type[Source]:
    """Return the kind of source that takes the data: the one that was registered last, else one of ours."""
    is_path = isinstance(data, str | PathLike) and not LiveSource.takes(data)
    if is_path and str(data) != "-" and not Path(str(data)).exists():
        raise FileNotFoundError(f"there is no data file {data}")
    return next(kind for kind in (*reversed(KINDS), *BUILT_IN) if kind.takes(data))


class Arrays(Source):
    """A table or a Recording that holds both inputs and outputs, or a tuple (u, y) or (u, y, starts)."""

    label = "recording"

    @classmethod
    def takes(cls, data: object) -> bool:
        """Return whether data are no path."""
        return not isinstance(data, str | PathLike)

    @classmethod
    def outline(cls, data: object, how: RecordingFormat) -> Outline:
        """Return the columns of a table."""
        frame = as_table(data, "data")
        if not is_table(frame):
            raise ValueError("data are no table and no path: there are no columns to look at")
        return Outline("a table", kinds_of(frame))

    def whole(self, progress: Progress | None = None) -> Recording:
        """Return the Recording."""
        if isinstance(self.data, tuple):
            return Recording.of(self.model, *self.data)
        return Recording.of(self.model, self.data)


class ReadOnce(Source):
    """A pipe like bash's <(zcat run.csv.gz): it can be read once, and reading needs more, so all that comes
    out of it is kept meanwhile.
    """

    @classmethod
    def takes(cls, data: object) -> bool:
        """Return whether data are a path that is neither a file nor a folder."""
        return isinstance(data, str | PathLike) and not Path(data).is_file() and not Path(data).is_dir()

    def whole(self, progress: Progress | None = None) -> Recording:
        """Return the Recording of the bytes in it, of whatever kind."""
        if str(self.data) == "-":
            raise ValueError(
                "standard input is read by `jaxbound detect MODEL.toml -`: give the name of a file here"
            )
        with self.kept(self.data) as path:
            return replace(open_source(path, self.model).read(progress=progress), source=self.label)

    @classmethod
    @contextmanager
    def kept(cls, data: object, most: int | None = None) -> Iterator[object]:
        """Yield the path of a file with the bytes that come out of the pipe, as long as it is needed."""
        named: str | int = str(data)
        if named == "-":
            named = 0
        with tempfile.NamedTemporaryFile(prefix="jaxbound-") as file:
            with open(named, "rb", closefd=named != 0) as pipe:
                if most is None:
                    shutil.copyfileobj(pipe, file)
                else:
                    file.write(pipe.read(most))
            file.flush()
            try:
                yield file.name
            except ValueError as e:
                raise ValueError(str(e).replace(f"{file.name}: ", "", 1)) from None


BUILT_IN: tuple[type[Source], ...] = (LiveSource, Arrays, ParquetSource, ReadOnce, CsvFile)
"""The kinds that are asked in this order, behind those that a user registered: the last takes any file."""


def read_signals(
    paths: Iterable[object] | str | PathLike[str],
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    columns: Mapping[str, str] | None = None,
    dt: float | None = None,
    progress: Progress | None = None,
) -> list[Recording]:
    """Read recordings before there is a model, to fit one.

    Args:
        paths: one path or several, each as for `read`.
        inputs, outputs: of each signal the name, or (name, column), where a column may be "= an expression"
            over columns.
        columns: {"time": column, "where": condition, "every": interval, signal: column}, as of a
            LinearSystem. dt: seconds
            between samples; None: the median step of the time column, a sentence in .hints says which.
        progress: called with the share of the work done.

    Returns:
        A list of Recordings, all with the same .dt.

    Raises:
        OSError, ValueError: as `read`; recordings of different dt; no sample for which `where` holds.
    """
    report = reporter(progress, "read")
    paths = [paths] if isinstance(paths, str | PathLike) else list(paths)
    if not paths:
        raise ValueError("there is no recording: give at least one")
    if not outputs:
        raise ValueError("there is no output: give at least one")
    columns = dict(columns or {})
    columns |= {signal[0]: signal[1] for signal in (*inputs, *outputs) if not isinstance(signal, str)}
    if dt is not None and not 0 < dt < np.inf:
        raise ValueError(f"dt must be a positive number of seconds, not {dt:g}")
    dt = every_step(columns, dt)
    model = Signals(tuple(map(_name_of, inputs)), tuple(map(_name_of, outputs)), columns, dt)
    recordings: list[Recording] = []
    for i, path in enumerate(paths):
        r = read(path, model, partial(in_part, report, i / len(paths), 1 / len(paths)))
        if r.excluded is not None and r.excluded.all():
            raise ValueError(
                f"{path}: the condition {columns['where']!r} holds for none of its {r.samples} samples"
            )
        recordings.append(r)
    _refuse_other_periods(paths, recordings)
    period = recordings[0].dt
    hints: tuple[str, ...] = ()
    if dt is None:
        hints = (f"dt = {period:g} s, the median step of the time",)
    return [replace(r, dt=period, hints=(*hints, *r.hints, *_no_levels(model, r))) for r in recordings]


def _no_levels(model: SignalModel, r: Recording) -> Iterator[str]:
    """Yield a sentence on each signal that is taken as a level from a column that is none."""
    how = format_of(model)
    for names, samples in ((model.inputs, r.u), (model.outputs, r.y)):
        for name, x in zip(names, samples.T, strict=False):  # factors stand behind the inputs
            if is_expression(model.column(name)):
                continue
            for kind, sentence in suspicions(name, model.column(name), np.asarray(x, float)):
                if kind != "on change" or not (how.hold or how.deadband or names is model.inputs):
                    yield sentence
    for name, sentence in other_units((*model.inputs, *model.outputs), r.u[:, : model.m], r.y):
        if not is_expression(model.column(name)):
            yield sentence


def _name_of(signal: Signal) -> str:
    if isinstance(signal, str):
        return signal
    return signal[0]


def _refuse_other_periods(paths: Sequence[object], recordings: Sequence[Recording]) -> None:
    """Raise ValueError if recordings of one model have several sampling periods."""
    periods = [r.dt for r in recordings]
    low, high = min(periods), max(periods)
    if high - low <= TOLERATED_DT * low:
        return
    slow, quick = paths[periods.index(high)], paths[periods.index(low)]
    fold = high / low
    for path, r in zip(paths, recordings, strict=True):
        varied = varied_steps(np.asarray(r.time))
        if varied:
            raise ValueError(f"{path}: {varied}")
    thin = "or bring them to one period first"
    if abs(fold - round(fold)) < TOLERATED_DT:
        thin = f"or let the samples of all be means (--every {every_text(high)})"
        if fold <= FEW:
            thin = f"keep one of every {round(fold)} rows of {quick} first, {thin}"
    for other, factor in ((slow, fold), (quick, 1 / fold)):
        unit = next((unit for scale, unit in UNITS.items() if abs(factor / scale - 1) < TOLERATED_DT), "")
        if unit:
            thin += f"; or, if the time of {other} is in {unit}, call its column so, like 'time [{unit}]'"
    several = f"{slow} has a sample every {high:g} s, {quick} every {low:g} s"
    raise ValueError(f"{several}, and a model has one sampling period: fit a model to each, {thin}")
