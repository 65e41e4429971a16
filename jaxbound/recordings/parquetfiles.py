"""Parquet files of a recording as they lie on a disk: their order, their columns, and damage.

A page that was damaged on the disk is noticed where its writer left a checksum in it, or where it cannot be
unpacked any more. Of another page nothing tells at the first reading; at every later one the digest of the
recording does (`contents`).

Names are sorted as people do, part-9 before part-10. Names that begin with a dot or an underscore, and
verdicts of ours, are left out.
"""

import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from jaxbound.recordings.recordingformat import format_of
from jaxbound.recordings.selection import STAMPS, Wanted, wanted
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.timestamps import stamp_kind

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

SUFFIXES = (".parquet", ".pq")
VERDICTS, PARTIAL = "verdicts.parquet", "verdicts.partial"  # folders that we write, complete and not
INDEX = "__index_level_0__"  # where pandas puts an index without a name


def files_of(path: Path) -> tuple[Path, ...]:
    """Return the files of a recording in order, of a folder all in its subfolders too; refuse one without
    any.
    """
    if not path.exists():
        raise FileNotFoundError(f"there is no data file {path}")
    if not path.is_dir():
        return (path,)
    inside = [p for p in path.rglob("*") if p.is_file() and not _is_left_out(p.relative_to(path))]
    files = [p for p in inside if p.suffix.lower() in SUFFIXES]
    if not files:
        found = "it is empty"
        if inside:
            found = f"it has {', '.join(sorted(p.name for p in inside)[:3])}"
        raise ValueError(f"{path} is a folder without Parquet files: {found}")
    return tuple(sorted(files, key=lambda p: _natural_order(p.relative_to(path).as_posix())))


def _is_left_out(inside: Path) -> bool:
    return any(part[0] in "._" or part in (VERDICTS, PARTIAL) for part in inside.parts)


def _natural_order(name: str) -> list[tuple[int, str]]:
    """Return a key by which part-9 comes before part-10."""
    key: list[tuple[int, str]] = []
    for piece in re.split(r"(\d+)", name):
        if piece.isdecimal():
            key.append((int(piece), ""))
        else:
            key.append((-1, piece))
    return key


class Damage:
    """A context that turns errors of pyarrow on a damaged file into a sentence."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __enter__(self) -> "Damage":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, e: BaseException | None, trace: TracebackType | None
    ) -> None:
        import pyarrow as pa

        # an OSError with a file name is of the system: no such file, no right to read it
        if isinstance(e, (pa.ArrowException, OSError)) and not getattr(e, "filename", None):
            why = str(e).splitlines()[0].rstrip(".")
            raise ValueError(f"{self.name} is a damaged Parquet file: {why}") from None


def opened(file: Path, name: str) -> "pq.ParquetFile":
    """Open a file to be read row group by row group; refuse one that is no whole Parquet file."""
    import pyarrow.parquet as pq

    with open(file, "rb") as f:
        begins = f.read(4) == b"PAR1"
        f.seek(max(file.stat().st_size - 4, 0))
        ends = f.read(4) == b"PAR1" and file.stat().st_size > 8
    if not begins:
        raise ValueError(f"{name} is no Parquet file")
    if not ends:
        raise ValueError(f"{name} is a truncated Parquet file: its end is missing")
    with Damage(name):  # not pre_buffer: pyarrow would hold whole row groups
        return pq.ParquetFile(file, buffer_size=1 << 20, pre_buffer=False, page_checksum_verification=True)


def groups_of(f: "pq.ParquetFile", first: int, stop: int) -> tuple[list[int], int]:
    """Return (the row groups that hold the rows first..stop, number of the first row in them)."""
    groups: list[int] = []
    begin = end = 0
    for g in range(f.num_row_groups):
        start, end = end, end + f.metadata.row_group(g).num_rows
        if start < stop and end > first:
            begin = begin if groups else start
            groups.append(g)
    return groups, begin


def spans_of(file: Path, name: str, first: int, stop: int) -> list[tuple[int, int]]:
    """Return spans of bytes, (first, behind the last): the row groups that hold the rows first..stop, and the
    footer that says where they are.
    """
    with opened(file, name) as f:
        groups, _ = groups_of(f, first, stop)
        end = file.stat().st_size
        spans = [(max(end - f.metadata.serialized_size - 8, 0), end)]
        for g in groups:
            group = f.metadata.row_group(g)
            begins, ends = [], []
            for c in range(group.num_columns):
                chunk = group.column(c)
                begin = min(chunk.data_page_offset, chunk.dictionary_page_offset or chunk.data_page_offset)
                begins.append(begin)
                ends.append(begin + chunk.total_compressed_size)
            spans.append((min(begins), max(ends)))
        return spans


def dated_columns(file: "pq.ParquetFile") -> frozenset[str]:
    """Return the columns of an open file that hold time stamps: by their type, or texts by the first of
    them.
    """
    import pyarrow as pa

    texts: list[str] = []
    stamps: set[str] = set()
    fields = {field.name: field.type for field in file.schema_arrow}
    for column, kind in fields.items():
        if pa.types.is_timestamp(kind) or pa.types.is_date(kind):
            stamps.add(column)
        if _is_text_type(kind):
            texts.append(column)
    if not texts:
        return frozenset(stamps)
    first = next(file.iter_batches(batch_size=1, columns=texts), None)
    if first is not None and first.num_rows:
        (row,) = first.to_pylist()
        stamps |= {column for column in texts if stamp_kind(row[column]) in STAMPS}
    return frozenset(stamps)


def checked(
    schema: "pa.Schema", model: SignalModel, name: str, dated: Container[str] = ()
) -> dict[str, "pa.DataType"]:
    """Return {column: type} of the wanted columns of a file, the signals first; refuse types that are not
    numbers or time.

    Args:
        name: of the file. dated: columns with time stamps, from `dated_columns`.
    """
    import pyarrow as pa

    plan = plan_of(schema.names, {f.name: f.type for f in schema}, model, dated)
    for column in plan.numbers:
        kind = schema.field(column).type
        if column == plan.time and (pa.types.is_temporal(kind) or pa.types.is_string(kind)):
            continue
        _refuse_no_numbers(column, kind)
    types = {column: schema.field(column).type for column in plan.columns}
    if plan.time is not None:
        _refuse_no_times(plan.time, types[plan.time])
    return types


def _refuse_no_numbers(column: str, kind: "pa.DataType") -> None:
    """Raise ValueError if the type of a signal's column is none of numbers."""
    from pyarrow import types

    if types.is_float16(kind):
        raise ValueError(
            f"column {column!r} is in half precision: write it as float32 and state in `resolution` what "
            f"was rounded away"
        )
    if not holds_numbers(kind):
        raise ValueError(f"column {column!r} holds {_in_words(kind)}: numbers are needed")


def holds_numbers(kind: "pa.DataType") -> bool:
    """Return whether a type is one of numbers, of yes and no, or of nothing."""
    from pyarrow import types

    numeric = types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind)
    return bool(numeric or types.is_boolean(kind) or types.is_null(kind))


def _refuse_no_times(column: str, kind: "pa.DataType") -> None:
    """Raise ValueError if the type of the time column is none of time stamps, texts or numbers."""
    from pyarrow import types

    stamps = types.is_timestamp(kind) or types.is_date(kind) or _is_text_type(kind)
    if not stamps and not types.is_integer(kind) and not types.is_floating(kind):
        what = _in_words(kind)
        raise ValueError(f"the time column {column!r} holds {what}: time stamps or numbers are needed")


def plan_of(
    names: Sequence[str], types: Mapping[str, "pa.DataType"], model: SignalModel, dated: Container[str] = ()
) -> Wanted:
    """Return the Wanted of a file with these columns; the time may be an index without a name."""
    import pyarrow as pa

    def kind_of_cells(name: str) -> str:
        return "stamp" if name != INDEX and name in dated else ""

    format_of(model).refuse_in("Parquet", "hold", "equal", "time_unit", "zone")
    plan = wanted(names, model, kind_of_cells)
    if plan.time is None and INDEX in types and pa.types.is_temporal(types[INDEX]):
        return replace(plan, time=INDEX)
    return plan


def _is_text_type(kind: "pa.DataType") -> bool:
    import pyarrow as pa

    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _in_words(kind: "pa.DataType") -> str:
    if _is_text_type(kind):
        return f"text ({kind})"
    return f"values of type {kind}"
