"""Parquet files as they lie on a disk: which belong to a recording, which are damaged, which columns they
have.

A page that was damaged on the disk is noticed where its writer left a checksum in it, or where it cannot be
unpacked any more. Of another page nothing tells at the first reading; at every later one the digest of the
recording does (`contents`).

Names are sorted as people do, part-9 before part-10. Names that begin with a dot or an underscore, and
verdicts of ours, are left out.
"""

import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from types import TracebackType
from typing import Any

from jaxbound.recordings.selection import STAMPS, Wanted, wanted
from jaxbound.recordings.timestamps import stamp_kind

__all__ = [
    "INDEX",
    "PARTIAL",
    "SUFFIXES",
    "VERDICTS",
    "Damage",
    "checked",
    "dated_columns",
    "files_of",
    "groups_of",
    "opened",
    "plan_of",
    "spans_of",
]

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
    skipped = lambda part: part[0] in "._" or part in (VERDICTS, PARTIAL)
    inside = [p for p in path.rglob("*") if p.is_file() and not any(map(skipped, p.relative_to(path).parts))]
    files = [p for p in inside if p.suffix.lower() in SUFFIXES]
    if not files:
        names = ", ".join(sorted(p.name for p in inside)[:3])
        raise ValueError(
            f"{path} is a folder without Parquet files: " + (f"it has {names}" if names else "it is empty")
        )
    natural = lambda p: [
        (int(t), "") if t.isdecimal() else (-1, t) for t in re.split(r"(\d+)", p.relative_to(path).as_posix())
    ]
    return tuple(sorted(files, key=natural))


class Damage:
    """Turns what pyarrow says of a damaged file into a sentence."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __enter__(self) -> "Damage":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, e: BaseException | None, trace: TracebackType | None
    ) -> None:
        import pyarrow as pa

        if (
            kind is not None
            and issubclass(kind, (pa.ArrowException, OSError))
            and not getattr(e, "filename", None)
        ):
            raise ValueError(
                f"{self.name} is a damaged Parquet file: {str(e).splitlines()[0].rstrip('.')}"
            ) from None


def opened(file: Path, name: str) -> Any:
    """Return a pyarrow.parquet.ParquetFile that reads row group by row group; refuse what is no whole Parquet
    file.
    """
    import pyarrow.parquet as pq

    with open(file, "rb") as f:
        begins = f.read(4) == b"PAR1"
        f.seek(max(file.stat().st_size - 4, 0))
        ends = f.read(4) == b"PAR1" and file.stat().st_size > 8
    if not begins or not ends:
        raise ValueError(
            f"{name} is a truncated Parquet file: its end is missing"
            if begins
            else f"{name} is no Parquet file"
        )
    with Damage(name):  # not pre_buffer: pyarrow would hold whole row groups
        return pq.ParquetFile(file, buffer_size=1 << 20, pre_buffer=False, page_checksum_verification=True)


def groups_of(f: Any, first: int, stop: int) -> tuple[list[int], int]:
    """Return (the row groups of a ParquetFile that hold the rows first..stop, number of the first row in
    them).
    """
    ends = list(accumulate((f.metadata.row_group(g).num_rows for g in range(f.num_row_groups)), initial=0))
    groups = [g for g in range(f.num_row_groups) if ends[g] < stop and ends[g + 1] > first]
    return groups, ends[groups[0]] if groups else 0


def spans_of(file: Path, name: str, first: int, stop: int) -> list[tuple[int, int]]:
    """Return spans of bytes, (first, behind the last): the row groups that hold the rows first..stop, and
    what says where they are.
    """
    with opened(file, name) as f:
        groups, _ = groups_of(f, first, stop)
        end = file.stat().st_size
        spans = [(max(end - f.metadata.serialized_size - 8, 0), end)]
        for g in groups:
            group = f.metadata.row_group(g)
            chunks = [group.column(c) for c in range(group.num_columns)]
            starts = [min(c.data_page_offset, c.dictionary_page_offset or c.data_page_offset) for c in chunks]
            spans.append(
                (min(starts), max(at + c.total_compressed_size for at, c in zip(starts, chunks, strict=True)))
            )
        return spans


def dated_columns(file: Any) -> frozenset[str]:
    """Return the columns of an open file that hold time stamps: by their type, or texts by the first of
    them.
    """
    import pyarrow as pa

    fields = {f.name: f.type for f in file.schema_arrow}
    texts = [c for c, kind in fields.items() if pa.types.is_string(kind) or pa.types.is_large_string(kind)]
    first = next(file.iter_batches(batch_size=1, columns=texts), None) if texts else None
    row = first.to_pylist()[0] if first is not None and first.num_rows else {}
    stamps = {c for c, kind in fields.items() if pa.types.is_timestamp(kind) or pa.types.is_date(kind)}
    return frozenset(stamps | {c for c in texts if stamp_kind(row.get(c)) in STAMPS})


def checked(schema: Any, model: Any, name: str, dated: Container[str] = ()) -> dict[str, Any]:
    """Return {column: type} of the wanted columns of a file, the signals first; refuse types that are not
    numbers or time.

    Args:
        name: of the file. dated: columns with time stamps, from `dated_columns`.
    """
    import pyarrow as pa

    kinds = pa.types
    plan = plan_of(schema.names, {f.name: f.type for f in schema}, model, dated)
    time = plan.time
    for column in plan.numbers:
        kind = schema.field(column).type
        if column == time and (kinds.is_temporal(kind) or kinds.is_string(kind)):
            continue
        if kinds.is_float16(kind):
            raise ValueError(
                f"column {column!r} is in half precision: write it as float32 and state in `resolution` what "
                f"was rounded away"
            )
        if not any(
            is_kind(kind)
            for is_kind in (
                kinds.is_integer,
                kinds.is_floating,
                kinds.is_decimal,
                kinds.is_boolean,
                kinds.is_null,
            )
        ):
            raise ValueError(f"column {column!r} holds {_kind(kind)}: numbers are needed")
    found = {column: schema.field(column).type for column in plan.columns}
    if time is not None:
        kind = found[time] = schema.field(time).type
        text = kinds.is_string(kind) or kinds.is_large_string(kind)
        if not (
            kinds.is_timestamp(kind)
            or kinds.is_date(kind)
            or kinds.is_integer(kind)
            or kinds.is_floating(kind)
            or text
        ):
            raise ValueError(
                f"the time column {time!r} holds {_kind(kind)}: time stamps or numbers are needed"
            )
    return found


def plan_of(names: Sequence[str], types: Mapping[str, Any], model: Any, dated: Container[str] = ()) -> Wanted:
    """Return the Wanted of a file with these columns; the time may be an index without a name."""
    import pyarrow as pa

    plan = wanted(names, model, lambda name: "stamp" if name != INDEX and name in dated else "")
    return (
        replace(plan, time=INDEX)
        if plan.time is None and INDEX in types and pa.types.is_temporal(types[INDEX])
        else plan
    )


def _kind(kind):
    import pyarrow as pa

    return (
        f"text ({kind})"
        if pa.types.is_string(kind) or pa.types.is_large_string(kind)
        else f"values of type {kind}"
    )
