"""Recordings from files.

A million rows of CSV are parsed column by column, only the columns that the model names. Parquet that fits into memory is read here too;
what does not is streamed (`streaming`).
"""

import shutil
import tempfile
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxbound.recordings.columns import from_arrow, valid
from jaxbound.recordings.csvtext import is_number, parse_columns, sniff
from jaxbound.recordings.derived import Signals, wanted, where_hints
from jaxbound.recordings.hints import Recording, missing_hints, rounding_hints
from jaxbound.recordings.parquet import is_parquet, open_parquet
from jaxbound.recordings.seams import TOLERATED_DT, Clock, around, check_period, irregular, seam_hints, tick, usual_period
from jaxbound.recordings.stillness import still_hints
from jaxbound.recordings.timestamps import parse_stamps, read_numbers

__all__ = ["read_recording", "read_signals"]


def read_recording(path, model, progress=None):
    """Read the signals of a model from a CSV file, a Parquet file or a folder of Parquet files, which follow each other by name.

    CSV: delimiter `,`, `;` or tab; decimal comma with the latter two. Blank, NaN, null and NA cells are missing samples. Columns that the
    model does not name are ignored. Time in seconds, as time stamps or as an epoch; without a time column the samples are dt apart.

    Args:
        path: of the file or folder. model: a LinearSystem. progress: called with the share of the work done.

    Returns:
        A Recording.

    Raises:
        OSError: no such file. NotImplementedError: standard input.
        ValueError: anything that is not a regular recording of this model: what, and in which row.
    """
    path = Path(path)
    report = progress or (lambda share: None)
    if str(path) == "-":
        raise NotImplementedError("reading from standard input is not implemented yet: give the name of a file")
    if not path.exists():
        raise FileNotFoundError(f"there is no data file {path}")
    if not path.is_file() and not path.is_dir():
        with _kept(path) as file:
            return replace(_read_file(file, model, report, path), source=path.name)
    return _read_file(path, model, report, path)


@contextmanager
def _kept(path):
    """Give a file with all that comes out of a pipe, like bash's <(zcat run.csv.gz): it can be read once, and reading needs more."""
    with tempfile.NamedTemporaryFile(prefix="jaxbound-") as file:
        with open(path, "rb") as pipe:
            shutil.copyfileobj(pipe, file)
        file.flush()
        yield Path(file.name)


def _read_file(path, model, report, named):
    if is_parquet(path):
        source = open_parquet(path, model)
        return source.read(0, source.samples, report)
    try:
        return _read(path, model, report)
    except ValueError as e:
        raise ValueError(f"{named}: {e}") from None


def read_signals(paths, inputs, outputs, columns=None, dt=None, progress=None):
    """Read recordings before there is a model, to fit one.

    Args:
        paths: one path or several, each as for `read_recording`.
        inputs, outputs: of each signal the name, or (name, column), where a column may be "= an expression" over columns.
        columns: {"time": column, "where": condition, signal: column}, as of a LinearSystem. dt: seconds between samples; None: the median
            step of the time column, a sentence in .hints says which.
        progress: called with the share of the work done.

    Returns:
        A list of Recordings, all with the same .dt.

    Raises:
        OSError, ValueError: as `read_recording`; recordings of different dt; no sample for which `where` holds.
    """
    paths = [paths] if isinstance(paths, (str, Path)) else list(paths)
    if not paths:
        raise ValueError("there is no recording: give at least one")
    named = [[s if isinstance(s, str) else s[0] for s in side] for side in (inputs, outputs)]
    if not named[1]:
        raise ValueError("there is no output: give at least one")
    columns = dict(columns or {}) | {s[0]: s[1] for s in (*inputs, *outputs) if not isinstance(s, str)}
    model = Signals(*map(tuple, named), columns, dt)
    found = []
    for i, path in enumerate(paths):
        report = None if progress is None else lambda share, i=i: progress((i + share) / len(paths))
        r = read_recording(path, model, report)
        if r.excluded is not None and r.excluded.all():
            raise ValueError(f"{path}: the condition {columns['where']!r} holds for none of its {len(r.time)} samples")
        found.append(r)
    low, high = min(found, key=lambda r: r.dt), max(found, key=lambda r: r.dt)
    if high.dt - low.dt > TOLERATED_DT * low.dt:
        slow, quick = (paths[found.index(r)] for r in (high, low))
        fold = high.dt / low.dt
        thin = f"keep one of every {round(fold)} rows of {quick}" if abs(fold - round(fold)) < TOLERATED_DT else "bring them to one period"
        raise ValueError(f"{slow} has a sample every {high.dt:g} s, {quick} every {low.dt:g} s, and a model has one sampling period: "
                         f"fit a model to each, or {thin} first")  # fmt: skip
    said = [] if dt is not None else [f"dt = {found[0].dt:g} s, the median step of the time"]
    return [replace(r, dt=found[0].dt, hints=(*said, *r.hints)) for r in found]


def _read(path, model, report):
    layout = sniff(path)
    plan = wanted(layout.names, model)
    if plan.time is None and layout.names[0] == "" and layout.first[0] and not is_number(layout.first[0], layout.decimal):
        plan = replace(plan, time="")  # an index of time stamps without a name
    report(0.05)
    index = {name: layout.names.index(name) for name in plan.columns}
    text_time = plan.time is not None and not is_number(layout.first[index[plan.time]], layout.decimal)
    table = parse_columns(layout, index, {*plan.texts, *([plan.time] if text_time else [])})
    report(0.7)
    count = len(table[plan.columns[0]])
    if count < 2:
        raise ValueError("the file has one row of data: a recording has at least two")
    hints = list(layout.hints)
    written = table[plan.time] if plan.time is not None else None
    if written is not None and written.null_count:
        first = layout.row(int(np.argmin(valid(written))))
        raise ValueError(f"{first} has no time: every row needs one, {written.null_count} do not have it")
    columns = {c: _values(layout, c, table[c]) for c in plan.numbers if c != plan.time or not text_time}
    columns |= {c: np.array(table[c].to_pylist(), object) for c in plan.texts}
    if written is None:
        if model.dt is None:
            raise ValueError("the file has no time column: say how many seconds its rows are apart, with dt (--dt)")
        time, stamps = np.arange(count) * model.dt, None
        hints.append(f"the file has no time column: the rows are taken to be dt = {model.dt:g} s apart")
    elif text_time:
        time, stamps, hint = parse_stamps(written, model.dt, layout.row)
        hints += [hint] if hint else []
    else:
        time, stamps, hint = read_numbers(_values(layout, plan.time, written), model.dt)
        hints += [hint] if hint else []
    columns.setdefault(plan.time, time if stamps is None else stamps)
    u, y, excluded = plan.samples(columns, count)
    recording = Recording(time, stamps, u, y, (), written, path.name)
    dt = usual_period(time) if model.dt is None else model.dt
    check_period(time, dt, getattr(model, "stated", "the model has"))
    starts, seams = _seams(time, dt, recording.label, layout.row)
    report(0.9)
    hints += seams + missing_hints(model, u, y, excluded) + rounding_hints(model, y) + still_hints(model, u, y, recording.label)
    if excluded is not None:
        starts = np.union1d(starts, around(excluded))
        hints += where_hints(plan.where.text, np.count_nonzero(excluded), count)
    report(1.0)
    return replace(recording, hints=tuple(hints), starts=starts, excluded=excluded, dt=dt)


def _seams(time, dt, label, where):
    """Return (starts, hints) of a whole time axis; refuse one that is irregular."""
    clock, starts = tick(Clock(dt), time)
    if sentence := irregular(clock, label, where):
        raise ValueError(sentence)
    return starts, seam_hints(clock, label, where)


def _values(layout, name, column):
    """Return a column as floats, NaN where a sample is missing; refuse infinity and a column without any number."""
    x = from_arrow(column)
    if np.isinf(x).any():
        k = int(np.argmax(np.isinf(x)))
        raise ValueError(f"{layout.row(k)} of column {name!r} is infinite or too large for a number (leave a missing sample blank)")
    if np.isnan(x).all():
        raise ValueError(f"column {name!r} holds no number at all: all {len(x)} cells are blank or NaN")
    return x
