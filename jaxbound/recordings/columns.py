"""Columns between pyarrow and NumPy, by their buffers: pyarrow's own conversions import pandas, which takes
longer than parsing a file.
"""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from typing import IO, TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.text.characters import cell

if TYPE_CHECKING:
    import pyarrow as pa

Arrow: TypeAlias = "pa.Array"
"""A column as pyarrow has it, which is imported where one is made."""
UNITS = ("s", "ms", "us", "ns")
"""Of a time stamp: the first that it is a whole number of is written."""


class Words(NamedTuple):
    """A column of names[code].

    Example:
        >>> Words(["no", "yes"], np.array([1, 0])).tolist()
        ['yes', 'no']
    """

    names: Sequence[str]
    codes: np.ndarray

    def tolist(self) -> list[str]:
        """Return the words, as an array returns its numbers."""
        return list(map(self.names.__getitem__, self.codes.tolist()))


def from_arrow(column: "pa.Array") -> np.ndarray:
    """Return a pyarrow column of floats or time stamps as NumPy floats or datetime64; null becomes NaN or
    NaT.
    """
    import pyarrow as pa

    dtype: np.dtype = np.dtype(np.float64)
    missing = "NaN"
    if pa.types.is_timestamp(column.type):
        dtype, missing = np.dtype(f"datetime64[{column.type.unit}]"), "NaT"
    elif pa.types.is_float32(column.type):
        dtype = np.dtype(np.float32)
    x = np.frombuffer(column.buffers()[1], dtype, len(column), dtype.itemsize * column.offset)
    if not column.null_count:
        return x
    return np.where(valid(column), x, np.array(missing, dtype))


def valid(column: "pa.Array") -> np.ndarray:
    """Return (N,) bool: False where a pyarrow column is null."""
    if not column.null_count:
        return np.ones(len(column), bool)
    bits = np.unpackbits(np.frombuffer(column.buffers()[0], np.uint8), bitorder="little")
    return bits[column.offset : column.offset + len(column)].astype(bool)


def to_arrow(x: "ArrayLike | Words") -> "pa.Array":
    """Return floats (NaN becomes null), whole numbers, bools, datetime64[ns] or Words as a pyarrow array."""
    import pyarrow as pa

    if isinstance(x, Words):
        return texts(x.names).take(to_arrow(x.codes))
    x = np.ascontiguousarray(x)
    if x.dtype == bool:
        return pa.Array.from_buffers(pa.bool_(), len(x), [None, _packed_bits(x)])
    if x.dtype.kind == "M":
        x = x.astype("datetime64[ns]")
        data = pa.py_buffer(x.view(np.int64))
        return pa.Array.from_buffers(pa.timestamp("ns"), len(x), [_packed_bits(~np.isnat(x)), data])
    if x.dtype.kind == "f":
        x = x.astype(np.float64)
        return pa.Array.from_buffers(pa.float64(), len(x), [_packed_bits(~np.isnan(x)), pa.py_buffer(x)])
    return pa.Array.from_buffers(pa.int64(), len(x), [None, pa.py_buffer(x.astype(np.int64))])


def _packed_bits(mask: np.ndarray) -> "pa.Buffer":
    """Return bools as Arrow holds them, eight in a byte."""
    import pyarrow as pa

    return pa.py_buffer(np.packbits(mask, bitorder="little"))


def texts(names: Sequence[str]) -> "pa.Array":
    """Return texts as a pyarrow array.

    Example:
        >>> texts(["tank", "größe"]).to_pylist()
        ['tank', 'größe']
    """
    import pyarrow as pa

    parts = [name.encode() for name in names]
    ends = np.cumsum([0, *map(len, parts)]).astype(np.int32)
    return pa.StringArray.from_buffers(len(parts), pa.py_buffer(ends), pa.py_buffer(b"".join(parts)))


def categories(names: Sequence[str], codes: np.ndarray) -> "pa.Array":
    """Return names[code] for int8 codes as a pyarrow array that holds every name once.

    Example:
        >>> categories(["no", "yes"], np.array([1, 0], np.int8)).to_pylist()
        ['yes', 'no']
    """
    import pyarrow as pa

    indices = pa.Array.from_buffers(
        pa.int8(), len(codes), [None, pa.py_buffer(np.ascontiguousarray(codes, np.int8))]
    )
    return pa.DictionaryArray.from_arrays(indices, texts(names))


def moments(column: "pa.Array") -> "pa.Array":
    """Return a pyarrow column as CSV has it: time stamps become texts to the second, or with three, six or
    nine digits behind it where they need them, and with the offset of their zone; others are left alone.

    Example:
        >>> stamps = np.array(["2026-03-01T08:00", "2026-03-01T08:00:00.25"], "datetime64[ns]")
        >>> moments(to_arrow(stamps)).to_pylist()
        ['2026-03-01 08:00:00', '2026-03-01 08:00:00.250']
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    if not pa.types.is_timestamp(column.type):
        return column
    cells, is_exact = column.cast(pa.string()), pa.scalar(False)
    for unit in UNITS:
        coarse = column.cast(pa.timestamp(unit, column.type.tz), safe=False)
        cells = pc.if_else(is_exact, cells, coarse.cast(pa.string()))
        is_exact = pc.equal(coarse.cast(column.type, safe=False), column)
        if pc.all(is_exact).as_py() is not False:
            break
    if column.type.tz:
        cells = pc.replace_substring_regex(cells, r"([+-]\d\d)(\d\d)$", r"\1:\2")
    return cells


def write_columns(path: str | PathLike[str], columns: Mapping[str, "pa.Array"], append: bool = False) -> None:
    """Write {name: pyarrow array} as CSV, with quotes only if a text needs them; `append` to a file that has
    its header already.
    """
    mode = "ab" if append else "wb"
    with open(path, mode) as f:
        if not append:
            f.write(header_line(columns))
        write_rows(f, columns)


def header_line(names: Iterable[str], delimiter: str = ",") -> bytes:
    """Return the first line of a CSV file."""
    line = io.StringIO()
    csv.writer(line, delimiter=delimiter, lineterminator="\n").writerow(map(cell, names))
    return line.getvalue().encode("utf-8", "backslashreplace")


def write_rows(sink: IO[bytes], columns: Mapping[str, "pa.Array"]) -> None:
    """Write {name: pyarrow array} as lines of CSV without a header into what pyarrow can write to."""
    import pyarrow as pa
    import pyarrow.csv

    columns = {name: moments(column) for name, column in columns.items()}
    quoting = "needed"
    if all(map(is_plain, columns.values())):
        quoting = "none"
    options = pyarrow.csv.WriteOptions(include_header=False, quoting_style=quoting)
    pyarrow.csv.write_csv(pa.Table.from_arrays(list(columns.values()), list(columns)), sink, options)


def is_plain(column: "pa.Array") -> bool:
    """Return whether no cell of a pyarrow column needs quotes in a CSV file."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if not pa.types.is_string(column.type):
        return True
    return not pc.any(pc.match_substring_regex(column, '[",\r\n]')).as_py()
