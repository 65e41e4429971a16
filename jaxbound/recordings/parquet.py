"""Recordings in Parquet: a file, or a folder of files that follow each other by name, read in chunks so that
size does not matter.

Rows count from 1.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxbound.recordings.columns import from_arrow, valid
from jaxbound.recordings.contents import Contents
from jaxbound.recordings.counting import SECONDS_ALONE, Numbers, numbers_of
from jaxbound.recordings.linetext import refuse_infinite
from jaxbound.recordings.parquetfiles import (
    PARTIAL,
    SUFFIXES,
    VERDICTS,
    Damage,
    checked,
    dated_columns,
    files_of,
    groups_of,
    holds_numbers,
    opened,
    plan_of,
    spans_of,
)
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.recordingformat import RecordingFormat, format_of
from jaxbound.recordings.seams import period_of, rows_apart
from jaxbound.recordings.selection import NO_TIME, STAMPS, Wanted
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.source import NUMBER, PROBE, TEXT, Outline, PartSource
from jaxbound.recordings.timestamps import in_ns, iso_stamps, since_epoch, time_label

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["PARTIAL", "VERDICTS", "ParquetSource", "is_parquet", "open_parquet"]

BATCH = 1 << 16  # rows decoded at once at least
Types = dict[str, "pa.DataType"]
"""{column: its type}."""


def is_parquet(path: Path) -> bool:
    """Return whether a path is to be read as Parquet: a folder, or a file that is called or that begins like
    one.
    """
    if path.is_dir() or path.suffix.lower() in SUFFIXES:
        return True
    if not path.is_file():
        return False  # a pipe: what is read from it is gone
    with open(path, "rb") as f:
        return f.read(4) == b"PAR1"


@dataclass(frozen=True, eq=False)
class ParquetSource(PartSource):
    """A recording in Parquet files, none of which is held in memory. Build it with `open_parquet`.

    Fields:
        path: as given; files: the files in order; rows: (F + 1,) number of the first sample of each file, and
            of all samples.
        model: whose signals are read; plan: the columns for them; time_name: the column of the time, or None.
        dt: sampling period in s, of the model, or else as the time column shows it.
        dtype: float32 if an output, or what it is computed from, is stored so, else float64: what was rounded
            away is counted in the type it was recorded in.
        begin: time of the first sample in s. origin: the first time stamp, None where the time is written
            as numbers; numbers: how these tell it.
        hints: sentences on how the files were read.
        states: (bytes, time of the last change) of each file when it was opened.
    """

    path: Path
    files: tuple[Path, ...]
    rows: np.ndarray
    model: SignalModel
    plan: Wanted
    dtype: np.dtype
    dt: float
    origin: np.datetime64 | None = None
    numbers: Numbers = SECONDS_ALONE
    hints: tuple[str, ...] = ()
    states: tuple[tuple[int, int], ...] = ()
    begin: float = 0.0

    as_recorded = True

    @classmethod
    def takes(cls, data: object) -> bool:
        """Return whether data are the path of a folder, or of a file that is called or that begins like
        Parquet.
        """
        return isinstance(data, str | PathLike) and is_parquet(Path(data))

    @classmethod
    def open(cls, data: object, model: SignalModel) -> "ParquetSource":
        """Return the source of a file or folder. See `open_parquet`."""
        return open_parquet(str(data), model)

    @classmethod
    def outline(cls, data: object, how: RecordingFormat) -> Outline:
        """Return how the files are written, by the types of the first."""
        files = files_of(Path(str(data)))
        with opened(files[0], str(files[0])) as f:
            stamps, kinds = dated_columns(f), {}
            for field in f.schema_arrow:
                kinds[field.name] = NUMBER
                if field.name in stamps:
                    kinds[field.name] = STAMPS[0]
                elif not holds_numbers(field.type):
                    kinds[field.name] = TEXT
        return Outline(f"Parquet, {len(files)} file{'s' * (len(files) > 1)}", kinds)

    @cached_property
    def content(self) -> str | None:
        """The digest of all files, as they are when it is first asked for. See `contents`."""
        return self._contents.all()

    @cached_property
    def _contents(self) -> Contents:
        return Contents(self.path, self.digests)

    def content_of(self, first: int, stop: int) -> str:
        """Return the digest of the row groups that the samples first..stop are in, without the rest of large
        files.
        """
        spans: list[tuple[Path, int, int]] = []
        for file, low, high in self._in(first, stop):
            spans += [(file, begin, end) for begin, end in spans_of(file, self.name(file), low, high)]
        return self._contents.of(spans)

    @property
    def layout(self) -> str:
        """The files, their sizes and rows, and how columns and time are understood, as text."""
        names = [""]  # a file may be moved
        if self.path.is_dir():
            names = list(map(self.name, self.files))
        files = [(name, size) for name, (size, _) in zip(names, self.states, strict=True)]
        counting, scale, origin = self.numbers
        begin = self.origin if scale is None else origin
        return repr(
            (
                files,
                self.rows.tolist(),
                self.plan.columns,
                self.time_name,
                str(self.dtype),
                str(begin),
                scale,
                *([counting] if counting.unit else []),
            )
        )

    @property
    def label(self) -> str:
        """The name of the file or folder."""
        return self.path.name

    def unchanged(self, *files: Path) -> None:
        """Raise ValueError if one of the files, by default any, was written since it was opened."""
        for file, state in zip(self.files, self.states, strict=True):
            if (not files or file in files) and _state(file) != state:
                raise ValueError(
                    f"{self.name(file)} has changed since it was opened: test it again once it is complete"
                )

    @property
    def time_name(self) -> str | None:
        """The column of the time, or None."""
        return self.plan.time

    @property
    def samples(self) -> int:
        """The number of samples."""
        return int(self.rows[-1])

    def row(self, k: int) -> str:
        """Return how the user finds sample k."""
        i = int(np.searchsorted(self.rows, k, "right")) - 1
        row = f"row {k - self.rows[i] + 1}"
        if self.path.is_dir():
            return f"{row} of {self.name(self.files[i])}"
        return row

    def chunks(self, first: int, stop: int, size: int) -> Iterator[tuple[int, Recording]]:
        """Yield (number of its first sample, Recording) of `size` samples each, the last one what is left.

        Raises:
            ValueError: a file is damaged; a sample is infinite or too large, or has no time.
        """
        import pyarrow as pa

        held: list[pa.RecordBatch] = []
        rows, start = 0, first
        if self.looks_back and first < stop:  # the row before is no sample of these, but a rate needs it
            held += self._batches(max(first - 1, 0), first, size, self.plan.columns)
        for batch in self._batches(first, stop, size, self.plan.columns):
            while len(batch):
                part = batch.slice(0, size - rows)
                held.append(part)
                rows, batch = rows + len(part), batch.slice(len(part))
                if rows == size or start + rows == stop:
                    table = pa.Table.from_batches(held)
                    before = len(table) - rows
                    chunk = self._chunk(start - before, table)
                    if before:
                        chunk = chunk.cut(before, chunk.samples)
                    yield start, chunk
                    held, rows, start = [], 0, start + rows
                    if self.looks_back:
                        held = [part.slice(len(part) - 1)]

    @cached_property
    def looks_back(self) -> bool:
        """Whether a signal needs the sample before."""
        return any(signal.looks_back for signal in self.plan.every)

    def _chunk(self, start: int, table: "pa.Table") -> Recording:
        """Return the samples of a table, which begins at sample `start`."""
        columns: dict[str, np.ndarray] = {}
        written = stamps = None
        time = np.arange(start, start + len(table)) * self.dt
        if self.time_name is not None:
            written = _one_array(table.column(self.time_name))
            time, stamps = self.times(start, written)
            columns[self.time_name] = time if stamps is None else stamps
        # numbers of the time itself replace its seconds where an expression is over that column
        for name in self.plan.numbers:
            if name != self.time_name or _is_numeric(table.column(name).type):
                columns[name] = self._numbers(start, name, table.column(name))
        for name in self.plan.texts:
            columns[name] = np.array(table.column(name).to_pylist(), object)
        try:
            since = time - self.begin
            samples = self.plan.samples(columns, len(table), (since, stamps), self.dtype, start, self.dt)
        except ValueError as e:
            raise ValueError(f"{self.path}: {e}") from None
        return Recording.filed(self.model, samples, (time, stamps, written), self.path.name, self.dt)

    def name(self, file: Path) -> str:
        """Return how the user knows one of the files."""
        return _name_in(self.path, file)

    def time(self, k: int) -> float:
        """Return the time of sample k in seconds."""
        if self.time_name is None:
            return k * self.dt
        (batch,) = self._batches(k, k + 1, 1, [self.time_name])
        return float(self.times(k, batch.column(0))[0][0])

    def _batches(self, first: int, stop: int, size: int, columns: list[str]) -> Iterator["pa.RecordBatch"]:
        """Yield record batches of the samples first..stop."""
        for file, low, high in self._in(first, stop):
            yield from self._of_file(file, low, high, size, columns)

    def _in(self, first: int, stop: int) -> Iterator[tuple[Path, int, int]]:
        """Yield (file, its first row, the row behind its last) for the samples first..stop."""
        for file, low, high in zip(self.files, self.rows[:-1], self.rows[1:], strict=True):
            if low < stop and high > first:
                yield file, int(max(first - low, 0)), int(min(stop, high) - low)

    def _of_file(
        self, file: Path, first: int, stop: int, size: int, columns: list[str]
    ) -> Iterator["pa.RecordBatch"]:
        """Yield record batches of the rows first..stop of one file; row groups outside are not touched."""
        self.unchanged(file)
        with opened(file, self.name(file)) as f:
            groups, at = groups_of(f, first, stop)
            batches = f.iter_batches(max(size, BATCH), groups, columns)
            while True:
                with Damage(self.name(file)):
                    batch = next(batches, None)
                if batch is None:
                    return
                low, high = max(first - at, 0), min(stop - at, len(batch))
                if high > low:
                    yield batch.slice(low, high - low)
                at += len(batch)

    def _numbers(self, start: int, name: str, column: "pa.ChunkedArray") -> np.ndarray:
        """Return a column as floats, NaN where a sample is missing."""
        import pyarrow as pa

        kind = pa.float64()
        if pa.types.is_float32(column.type):
            kind = pa.float32()
        try:
            x = from_arrow(_one_array(column.cast(kind)))
        except pa.ArrowInvalid:
            raise ValueError(
                f"column {name!r} of {self.path} holds whole numbers too large for a float: scale them"
            ) from None
        refuse_infinite(name, x, None, partial(self._place, start))
        return x

    def _place(self, start: int, k: int) -> str:
        """Return how the user finds the row k behind sample `start`."""
        return f"{self.path}: {self.row(start + k)}"

    def times(self, start: int, written: "pa.Array") -> tuple[np.ndarray, np.ndarray | None]:
        """Return (seconds, datetime64[ns] or None) of a piece of the time column, which begins at sample
        `start`.
        """
        import pyarrow as pa

        if not _is_numeric(written.type):
            self._refuse_untimed(start, valid(written))
            stamps = self._stamps(start, written)
            origin = stamps[0]
            if self.origin is not None:
                origin = self.origin
            return (stamps - origin) / np.timedelta64(1, "s"), stamps
        values = since_epoch(from_arrow(written.cast(pa.float64(), safe=False)))
        self._refuse_untimed(start, np.isfinite(values))
        return self.numbers.times(values)

    def _stamps(self, start: int, written: "pa.Array") -> np.ndarray:
        """Return datetime64[ns] of a piece of a column of time stamps, dates or ISO 8601 texts."""
        import pyarrow as pa

        where = partial(self._place, start)
        if pa.types.is_timestamp(written.type):
            return in_ns(from_arrow(written), where)
        if pa.types.is_date(written.type):
            return in_ns(from_arrow(written.cast(pa.timestamp("s"))), where)
        stamps = iso_stamps(written, where)
        if stamps is None:
            holds = f"the time column {self.time_name!r} holds texts like {written[0].as_py()!r}"
            raise ValueError(f"{self.path}: {holds}: write it as time stamps, or as ISO 8601")
        return stamps

    def _refuse_untimed(self, start: int, known: np.ndarray) -> None:
        """Refuse a piece, which begins at sample `start`, in which some time is not known."""
        if not known.all():
            row = self._place(start, int(np.argmin(known)))
            raise ValueError(f"{row} has no time: every row needs one")

    @property
    def zero(self) -> np.datetime64 | None:
        """The time stamp of 0 s, or None where the time is in seconds."""
        if self.numbers.scale is None:
            return self.origin
        return np.datetime64(round(self.numbers.origin * (1e9 / self.numbers.scale)), "ns")

    def clock(self, size: int, stop: int) -> Iterator[tuple[np.ndarray, np.ndarray | None]]:
        """Yield (seconds, datetime64[ns] or None) of the rows before `stop`, about `size` at once."""
        assert self.time_name is not None, "there is a column of times"
        start = 0
        for batch in self._batches(0, stop, size, [self.time_name]):
            yield self.times(start, batch.column(0))
            start += len(batch)

    def first_times(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Return (seconds, datetime64[ns] or None) of the first 100 000 rows."""
        import pyarrow as pa

        assert self.time_name is not None, "there is a column of times"
        size = min(self.samples, PROBE)
        rows = pa.Table.from_batches(self._batches(0, size, size, [self.time_name]))
        return self.times(0, _one_array(rows.column(0)))


def open_parquet(path: str | PathLike[str], model: SignalModel) -> ParquetSource:
    """Look at the Parquet files of a recording without reading them.

    Args:
        path: of a file, or of a folder whose files (in subfolders too) follow each other by name. model:
            whose signals are wanted.

    Returns:
        A ParquetSource.

    Raises:
        OSError: no such file. ValueError: no Parquet file, a damaged one, a column that is missing or of the
            wrong type, files with
        different columns or in the wrong order, another sampling period than the model's.
    """
    import pyarrow as pa

    path = Path(path)
    format_of(model).refuse_in("Parquet", "hold", "equal", "long")
    files = files_of(path)
    states = tuple(map(_state, files))
    counts, types, dated = _schemas(path, files, model)
    rows = np.cumsum([0, *counts])
    if rows[-1] < 2:
        how_many = "one row" if rows[-1] else "no row"
        raise ValueError(f"{path}: {how_many} of data: a recording has at least two")
    plan = plan_of(list(types), types, model, dated)
    single = any(types.get(c) == pa.float32() for signal in plan.outputs for c in signal.read)
    dtype = np.dtype(np.float32 if single else np.float64)
    hints: tuple[str, ...] = ()
    zone = None
    if plan.time is not None:
        zone = getattr(types[plan.time], "tz", None)
    if zone not in (None, "UTC"):
        hints = (f"time stamps have the zone {zone}: they are shown in UTC",)
    dt = model.dt or np.nan  # until the times show it
    return _clocked(ParquetSource(path, files, rows, model, plan, dtype, dt, hints=hints, states=states))


def _schemas(
    path: Path, files: tuple[Path, ...], model: SignalModel
) -> tuple[list[int], Types, frozenset[str]]:
    """Return (rows of each file, {column: type} of those that are wanted, columns with time stamps); refuse
    files that differ in those that are wanted.
    """
    counts: list[int] = []
    first: Types = {}
    dated: frozenset[str] = frozenset()
    first_name = _name_in(path, files[0])
    for file in files:
        name = _name_in(path, file)
        with opened(file, name) as f:
            counts.append(f.metadata.num_rows)
            try:
                dated = dated or dated_columns(f)
                types = checked(f.schema_arrow, model, name, dated)
            except ValueError as e:
                mixed = ""
                if first:
                    mixed = f", as the files before it have (first {first_name})"
                raise ValueError(f"{file}: {e}{mixed}") from None
        first = first or types
        _refuse_other_types(path / name, types, first, first_name)
    return counts, first, dated


def _refuse_other_types(place: Path, types: Types, first: Types, first_name: str) -> None:
    """Refuse a file whose columns are not those of the first file."""
    for column in {**first, **types}:
        if first.get(column) != types.get(column):
            here, before = _use_of(column, types), _use_of(column, first)
            same = "all files of a folder need the same columns"
            raise ValueError(f"{place}: column {column!r} is {here}, {before} in {first_name}: {same}")


def _use_of(column: str, types: Types) -> str:
    if column in types:
        return f"of type {types[column]}"
    return "not used"


def _name_in(path: Path, file: Path) -> str:
    """Return how the user knows a file of a folder, or one that is a recording alone."""
    if path.is_dir():
        return file.relative_to(path).as_posix()
    return str(path)


def _state(file: Path) -> tuple[int, int]:
    about = file.stat()
    return about.st_size, about.st_mtime_ns


def _one_array(column: "pa.Array | pa.ChunkedArray") -> "pa.Array":
    """Return a column as one array."""
    import pyarrow as pa

    if isinstance(column, pa.ChunkedArray):
        return column.combine_chunks()
    return column


def _is_numeric(kind: "pa.DataType") -> bool:
    """Return whether a type is that of whole numbers or of floats."""
    import pyarrow as pa

    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind))


def _clocked(source: ParquetSource) -> ParquetSource:
    """Return the source with its time understood; refuse files in the wrong order and another period than the
    model's.
    """
    dt, regular = source.model.dt, getattr(source.model, "regular", True)
    if source.time_name is None:
        if not regular:
            return source
        if dt is None:
            raise ValueError(f"{source.path}: there is no time column: {NO_TIME}")
        return replace(source, hints=(f"the recording has no time column: {rows_apart(dt)}",))
    time, stamps = source.first_times()
    if stamps is not None:
        source = replace(source, origin=stamps[0])
    else:
        numbers, hint = numbers_of(time, dt, str(source.time_name))
        source = replace(source, numbers=numbers, hints=(*source.hints, *filter(None, [hint])))
        time, _ = numbers.times(time)
    try:
        dt = period_of(time, source.model)
    except ValueError as e:
        raise ValueError(f"{source.path}: {e}") from None
    source = replace(source, begin=float(time[0]), dt=dt or 1.0)  # else rows are as far apart as they are
    if len(source.files) > 1:
        _refuse_disorder(source)
    return source


def _refuse_disorder(source: ParquetSource) -> None:
    """Refuse files of which one begins before the end of the one before it."""
    end, last = -np.inf, ""
    for file, low, high in zip(source.files, source.rows[:-1], source.rows[1:], strict=True):
        if low == high:
            continue
        begin = source.time(low)
        if begin < end:
            raise ValueError(
                f"{source.path}: {source.name(file)} begins at {_label(source, begin)}, before the end of "
                f"{last} at {_label(source, end)}: files follow each other by name, so rename them, or give "
                f"one at a time"
            )
        end, last = source.time(high - 1), source.name(file)


def _label(source: ParquetSource, seconds: float) -> str:
    return time_label(seconds, source.stamp(seconds), source.dt)
