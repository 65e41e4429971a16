"""Recordings in Parquet: a file, or a folder of files that follow each other by name, read in chunks so that
size does not matter.

Rows count from 1.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from jaxbound.recordings.columns import from_arrow, valid
from jaxbound.recordings.contents import Contents
from jaxbound.recordings.expressions import Expression
from jaxbound.recordings.parquetfiles import (
    PARTIAL,
    SUFFIXES,
    VERDICTS,
    Damage,
    checked,
    dated_columns,
    files_of,
    groups_of,
    opened,
    plan_of,
    spans_of,
)
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import Clock, around, check_period, tick, usual_period
from jaxbound.recordings.selection import NO_TIME, Wanted
from jaxbound.recordings.source import Source, overlapping, told
from jaxbound.recordings.timestamps import EPOCHS, epoch_scale, since_epoch, time_label

__all__ = ["PARTIAL", "VERDICTS", "ParquetSource", "is_parquet", "open_parquet"]

PROBE = 100_000  # samples that show the sampling period, the unit of time and the rounding of the recorder
BATCH = 1 << 16  # rows decoded at once at least


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
class ParquetSource(Source):
    """A recording in Parquet files, none of which is held in memory. Build it with `open_parquet`.

    Fields:
        path: as given; files: the files in order; rows: (F + 1,) number of the first sample of each file, and
            of all samples.
        model: whose signals are read; plan: the columns for them; time_name: the column of the time, or None.
        dtype: float32 if an output, or what it is computed from, is stored so, else float64: what was rounded
            away is counted in the type it was recorded in.
        origin: what the time is counted from; scale: units a second of a numeric time column that is an
            epoch, or None.
        hints: sentences on how the files were read.
        states: (bytes, time of the last change) of each file when it was opened.
    """

    path: Path
    files: tuple
    rows: np.ndarray
    model: Any
    plan: Wanted
    dtype: np.dtype
    origin: Any = None
    scale: float | None = None
    hints: tuple = ()
    states: tuple = ()

    parts = True

    @classmethod
    def takes(cls, data: object) -> bool:
        """Return whether data are the path of a folder, or of a file that is called or that begins like
        Parquet.
        """
        return isinstance(data, str | PathLike) and is_parquet(Path(data))

    @classmethod
    def open(cls, data: Any, model: Any) -> "ParquetSource":
        """Return the source of a file or folder. See `open_parquet`."""
        return open_parquet(data, model)

    @cached_property
    def content(self) -> str | None:
        """The digest of all files, as they are when it is first asked for. See `contents`."""
        return self._contents.all()

    @cached_property
    def _contents(self):
        return Contents(self.path, self.digests)

    def content_of(self, first: int, stop: int) -> str:
        """Return the digest of what the samples first..stop are read from, without the rest of large
        files.
        """
        spans = [
            (file, *span)
            for file, low, high in self._in(first, stop)
            for span in spans_of(file, self.name(file), low, high)
        ]
        return self._contents.of(spans)

    @property
    def layout(self) -> str:
        """What is known of the recording before it is read, as text: files, their sizes and rows, how columns
        and time are understood.
        """
        files = [
            (self.name(file) if self.path.is_dir() else "", state[0])
            for file, state in zip(self.files, self.states, strict=True)
        ]
        return repr(
            (
                files,
                self.rows.tolist(),
                self.plan.columns,
                self.time_name,
                str(self.dtype),
                str(self.origin),
                self.scale,
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
    def time_name(self) -> Any:
        """The column of the time, or None."""
        return self.plan.time

    @property
    def samples(self) -> int:
        """The number of samples."""
        return int(self.rows[-1])

    def row(self, k: int) -> str:
        """Return how the user finds sample k."""
        i = int(np.searchsorted(self.rows, k, "right")) - 1
        return f"row {k - self.rows[i] + 1}" + (
            f" of {self.name(self.files[i])}" if self.path.is_dir() else ""
        )

    def tables(self, first: int, stop: int, size: int) -> Iterator:
        """Yield (number of its first sample, pyarrow table) for the samples first..stop, `size` rows each,
        the last one what is left.

        Raises:
            ValueError: a file is damaged.
        """
        import pyarrow as pa

        held, rows, start = [], 0, first
        for batch in self._batches(first, stop, size, self.plan.columns):
            while len(batch):
                part = batch.slice(0, size - rows)
                held.append(part)
                rows, batch = rows + len(part), batch.slice(len(part))
                if rows == size or start + rows == stop:
                    yield start, pa.Table.from_batches(held)
                    held, rows, start = [], 0, start + rows

    def chunk(self, start: int, table: Any) -> Recording:
        """Return the samples of a table from `tables` as a Recording without hints and without starts; those
        left out are .excluded.

        Raises:
            ValueError: a sample is infinite or too large, or has no time.
        """
        x = {
            c: self._numbers(start, c, table.column(c))
            for c in self.plan.numbers
            if c != self.time_name or self._numeric(table)
        }
        x |= {c: np.array(table.column(c).to_pylist(), object) for c in self.plan.texts}
        written = None if self.time_name is None else _whole(table.column(self.time_name))
        time, stamps = (
            (np.arange(start, start + len(table)) * self.model.dt, None)
            if written is None
            else self.times(start, written)
        )
        x.setdefault(self.time_name, time if stamps is None else stamps)
        try:
            u, y, excluded = self.plan.samples(x, len(table), self.dtype)
        except ValueError as e:
            raise ValueError(f"{self.path}: {e}") from None
        return Recording.filed(self.model, (u, y, excluded), (time, stamps, written), self.path.name)

    def _numeric(self, table):
        import pyarrow as pa

        kind = table.column(self.time_name).type
        return pa.types.is_integer(kind) or pa.types.is_floating(kind)

    def pieces(
        self, size: int, overlap: int = 0, first: int = 0, stop: int | None = None
    ) -> Iterator[tuple[int, Recording]]:
        """Yield (number of its first sample, Recording) of `size` samples each, behind the `overlap` before
        them. See `tables`, `chunk`.
        """
        chunks = (
            (at, self.chunk(at, table))
            for at, table in self.tables(first, self.samples if stop is None else stop, size)
        )
        return overlapping(chunks, overlap, self.model.dt)

    def find(self, text: str) -> None:
        """Return None: what is written in files is not searched, but where its time is."""
        return None

    def read(self, first: int = 0, stop: int | None = None, progress: Callable | None = None) -> Recording:
        """Return the samples first..stop as one Recording, with its seams; hints only if that is all of them.

        Raises:
            ValueError: as `tables` and `chunk`; more seams than steps of one sampling period, if these are
                all samples.
        """
        report = progress or (lambda share: None)
        stop = self.samples if stop is None else stop
        ((_, table),) = self.tables(first, stop, stop - first)
        report(0.7)
        r = self.chunk(first, table)
        if stop - first < self.samples:
            return replace(r, starts=np.union1d(tick(Clock(self.model.dt), r.time)[1], around(r.excluded)))
        try:
            return told(self.model, r, self.row, self.plan.where.text if self.plan.where else "", self.hints)
        except ValueError as e:
            raise ValueError(f"{self.path}: {e}") from None

    def name(self, file: Path) -> str:
        """Return how the user knows one of the files."""
        return file.relative_to(self.path).as_posix() if self.path.is_dir() else str(file)

    def time(self, k: int) -> float:
        """Return the time of sample k in seconds."""
        (batch,) = self._batches(k, k + 1, 1, [self.time_name])
        return float(self.times(k, batch.column(0))[0][0])

    def _batches(self, first, stop, size, columns):
        for file, low, high in self._in(first, stop):
            yield from self._of_file(file, low, high, size, columns)

    def _in(self, first, stop):
        """Yield (file, its first row, the row behind its last) for the samples first..stop."""
        for file, low, high in zip(self.files, self.rows[:-1], self.rows[1:], strict=True):
            if low < stop and high > first:
                yield file, int(max(first - low, 0)), int(min(stop, high) - low)

    def _of_file(self, file, first, stop, size, columns):
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

    def _numbers(self, start, name, column):
        """Return a column as floats, NaN where a sample is missing."""
        import pyarrow as pa

        computed = any(
            isinstance(s, Expression) and name in s.columns
            for s in (*self.plan.inputs, *self.plan.outputs, self.plan.where)
        )
        try:
            x = from_arrow(
                _whole(
                    column.cast(
                        pa.float32() if pa.types.is_float32(column.type) and not computed else pa.float64()
                    )
                )
            )
        except pa.ArrowInvalid:
            raise ValueError(
                f"column {name!r} of {self.path} holds whole numbers too large for a float: scale them"
            ) from None
        if np.isinf(x).any():
            k = start + int(np.argmax(np.isinf(x)))
            raise ValueError(
                f"{self.path}: {self.row(k)} of column {name!r} is infinite or too large for a number "
                "(leave a missing sample blank)"
            )
        return x

    def times(self, start: int, written: Any) -> tuple[np.ndarray, np.ndarray | None]:
        """Return (seconds, datetime64[ns] or None) of a piece of the time column, which begins at sample
        `start`.
        """
        import pyarrow as pa

        numeric = pa.types.is_integer(written.type) or pa.types.is_floating(written.type)
        values: Any = since_epoch(from_arrow(written.cast(pa.float64(), safe=False))) if numeric else None
        known = np.isfinite(values) if numeric else valid(written)
        if not known.all():
            raise ValueError(
                f"{self.path}: {self.row(start + int(np.argmin(known)))} has no time: every row needs one"
            )
        if not numeric:
            stamps = _stamps(written, self.path, self.time_name)
            return (stamps - (stamps[0] if self.origin is None else self.origin)) / np.timedelta64(
                1, "s"
            ), stamps
        if self.scale is None:
            return values, None
        return (values - self.origin) / self.scale, np.round(values * (1e9 / self.scale)).astype(
            "int64"
        ).astype("datetime64[ns]")

    def stamp(self, seconds: float) -> np.datetime64 | None:
        """Return the time stamp that lies so many seconds behind the first, or None where the time is in
        seconds.
        """
        if self.origin is None:
            return None
        origin = np.datetime64(round(self.origin * (1e9 / self.scale)), "ns") if self.scale else self.origin
        return origin + np.timedelta64(round(seconds * 1e9), "ns")

    def probe(self) -> Recording:
        """Return the first 100 000 samples."""
        ((_, table),) = self.tables(0, min(self.samples, PROBE), PROBE)
        return self.chunk(0, table)


def open_parquet(path: str | PathLike, model: Any) -> ParquetSource:
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
    files = files_of(path)
    states = tuple(map(_state, files))
    source = ParquetSource(
        path, files, np.zeros(len(files) + 1, np.int64), model, Wanted((), (), None, None), np.dtype(float)
    )
    counts: list[int] = []
    first: dict[str, Any] = {}
    dated: frozenset[str] = frozenset()
    for file in files:
        name = source.name(file) if path.is_dir() else str(path)
        with opened(file, name) as f:
            counts.append(f.metadata.num_rows)
            try:
                dated = dated or dated_columns(f)
                schema = checked(f.schema_arrow, model, name, dated)
            except ValueError as e:
                mixed = f", as the files before it have (first {source.name(files[0])})" if first else ""
                raise ValueError(f"{path}{'/' + name if path.is_dir() else ''}: {e}{mixed}") from None
        first = first or schema
        for column in {**first, **schema}:
            if first.get(column) != schema.get(column):
                here, before = (
                    f"of type {s[column]}" if column in s else "not used" for s in (schema, first)
                )
                same = "all files of a folder need the same columns"
                raise ValueError(
                    f"{path}/{name}: column {column!r} is {here}, {before} in {source.name(files[0])}: {same}"
                )
    rows = np.cumsum([0, *counts])
    if rows[-1] < 2:
        raise ValueError(
            f"{path}: {'no row' if not rows[-1] else 'one row'} of data: a recording has at least two"
        )
    plan = plan_of(list(first), first, model, dated)
    stored = [c for s in plan.outputs for c in (s.columns if isinstance(s, Expression) else (s,))]
    single = pa.float32() in {first.get(c) for c in stored}
    zone = getattr(first.get(plan.time), "tz", None)
    hints = (f"time stamps have the zone {zone}: they are shown in UTC",) if zone not in (None, "UTC") else ()
    dtype = np.dtype(np.float32 if single else np.float64)
    return _clocked(ParquetSource(path, files, rows, model, plan, dtype, hints=hints, states=states))


def _state(file):
    found = file.stat()
    return found.st_size, found.st_mtime_ns


def _whole(column):
    import pyarrow as pa

    return column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column


def _stamps(written, path, name):
    """Return datetime64[ns] of a column of time stamps, dates or ISO 8601 texts."""
    import pyarrow as pa

    if not pa.types.is_timestamp(written.type):
        for kind in (pa.timestamp("ns"), pa.timestamp("ns", "UTC")):
            try:
                written = written.cast(kind)
                break
            except pa.ArrowInvalid:
                pass
        else:
            first = written[0].as_py()
            raise ValueError(
                f"{path}: the time column {name!r} holds texts like {first!r}: write it as time stamps, or "
                f"as ISO 8601"
            )
    return from_arrow(written).astype("datetime64[ns]")


def _clocked(source):
    """Return the source with its time understood; refuse files in the wrong order and another period than the
    model's.
    """
    dt = source.model.dt
    if source.time_name is None and dt is None:
        raise ValueError(f"{source.path}: there is no time column: {NO_TIME}")
    if source.time_name is None:
        return replace(
            source,
            hints=(
                f"the recording has no time column: the rows are taken to be dt = {dt:g} s apart, and none "
                f"to be missing",
            ),
        )
    probe = source.probe()
    if probe.stamps is not None:
        source = replace(source, origin=probe.stamps[0])
    elif (scale := epoch_scale(probe.time, dt)) is not None:
        source, unit = replace(source, origin=float(probe.time[0]), scale=scale), EPOCHS[scale]
        source = replace(
            source, hints=() if scale == 1 else (f"the time column is read as an epoch in {unit}",)
        )
        probe = source.probe()
    try:
        if dt is None:
            dt = usual_period(probe.time)
            source = replace(source, model=replace(source.model, dt=dt))
        check_period(probe.time, dt, getattr(source.model, "stated", "the model has"))
    except ValueError as e:
        raise ValueError(f"{source.path}: {e}") from None
    if len(source.files) > 1:
        _refuse_disorder(source)
    return source


def _refuse_disorder(source):
    end, last = -np.inf, None
    label = lambda seconds: time_label(seconds, source.stamp(seconds), source.model.dt)
    for file, low, high in zip(source.files, source.rows[:-1], source.rows[1:], strict=True):
        if low < high:
            if (begin := source.time(low)) < end:
                raise ValueError(
                    f"{source.path}: {source.name(file)} begins at {label(begin)}, before the end of {last} "
                    f"at {label(end)}: "
                    "files follow each other by name, so rename them, or give one at a time"
                )
            end, last = source.time(high - 1), source.name(file)
