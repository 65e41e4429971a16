"""The text of a CSV file: how it is written, its columns, and the row that cannot be read.

Columns are parsed by pyarrow, only those that are wanted; when that fails, a second, slow pass finds the row and says what stands there.
Rows are counted as a spreadsheet does: the header is row 1.
"""

import csv
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from jaxbound.recordings.naming import listed
from jaxbound.recordings.timestamps import DIGITS, stamp_kind

__all__ = ["Layout", "cells_of", "is_number", "parse_columns", "sniff"]

WORDS = ("NaN", "nan", "NAN", "null", "NULL", "Null", "NA", "N/A", "n/a", "#N/A", "None", "none")
MISSING_CELLS = ("", " ", *WORDS, *(f" {x}" for x in WORDS))
ENOUGH, LINES, LONGEST = 1 << 18, 8, 1 << 26  # bytes and lines of a file that show how it is written; bytes looked at at most
FURTHER = 20  # lines below the first row that show whether it is the header
MANY = 10  # words that a sentence on cells that are no numbers repeats at most
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(inf|infinity)|nan", re.IGNORECASE)
SIGNATURES = {
    b"PAR1": "a Parquet file",
    b"\x1f\x8b": "a gzip file",
    b"PK\x03\x04": "a zip file or an Excel workbook",
    b"\x89HDF": "an HDF5 file",
    b"ARROW1": "an Arrow file",
}


@dataclass(frozen=True)
class Layout:
    """How a CSV file is written."""

    path: Path
    names: list
    delimiter: str
    decimal: str
    encoding: str
    skip: int  # lines before the data
    first: list  # cells of the first data row
    hints: list = field(default_factory=list)

    def row(self, k: int) -> str:
        """Return how the user finds sample k."""
        return f"row {k + self.skip + 1}"

    def dated(self, name: str) -> str:
        """Return what the first cell of a column is, see `stamp_kind`."""
        cell = self._cells.get(name) or ""
        return stamp_kind(cell) if DIGITS.fullmatch(cell.strip()) or not is_number(cell, self.decimal) else ""

    @cached_property
    def _cells(self):
        return dict(zip(self.names, self.first, strict=False))


def sniff(path: Path, head: bytes | None = None) -> Layout:
    """Look at the first lines of the file, or at these bytes, and find out how it is written."""
    if head is None:
        with open(path, "rb") as f:
            head = f.read(ENOUGH)
            while head.count(b"\n") < LINES and len(head) < LONGEST and (more := f.read(ENOUGH)):  # a header of many columns
                head += more
    if not head.strip(b"\xef\xbb\xbf \t\r\n"):
        raise ValueError("the file is empty")
    for magic, kind in SIGNATURES.items():
        if head.startswith(magic):
            raise ValueError(f"this is {kind}, not text: give a CSV file")
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise ValueError("the file is in UTF-16: save it as UTF-8")
    if b"\0" in head:
        raise ValueError("this is a binary file, or text in UTF-16: give a CSV file in UTF-8")
    hints, encoding = [], "utf-8"
    try:
        body = head.removeprefix(b"\xef\xbb\xbf")
        text = (body if len(head) < ENOUGH or b"\n" not in body else body[: body.rfind(b"\n") + 1]).decode()
    except UnicodeDecodeError:
        if sum(b < 9 for b in head) or sum(b > 127 for b in head) > len(head) // 4:
            raise ValueError("this is not a text file: give a CSV file in UTF-8") from None
        encoding, text = "cp1252", head.decode("cp1252", "replace")
        hints.append("the file is not in UTF-8: it is read as Windows-1252, which matters for column names only")
    lines = re.split(r"\r\n|\n|\r", text, maxsplit=1000)  # enough of them; splitting all takes longer than parsing
    skip = next((i for i, line in enumerate(lines) if line.strip()), None)
    if skip is None:
        raise ValueError(f"the file begins with {len(lines)} blank lines: a header is needed")
    delimiter = None
    if (m := re.fullmatch(r"sep=(.)\s*", lines[skip])) and len(lines) > skip + 1:  # as Excel writes it
        delimiter, skip = m[1], skip + 1
    header = lines[skip]
    delimiter = delimiter or next((d for d in (";", "\t", ",") if d in header), ",")
    names = [name.strip() for name in cells_of(header, delimiter)]
    data = [cells_of(line, delimiter) for line in lines[skip + 1 : skip + 200] if line.strip()]
    decimal = "," if delimiter != "," and any(re.fullmatch(r"\s*[-+]?\d*,\d+([eE].*)?\s*", c) for row in data for c in row) else "."
    if all(is_number(name, decimal) for name in names):
        raise ValueError(f"the first row must hold the names of the columns: it holds numbers ({listed(names[:3], str)}). "
                         f"Put a line above it, such as: {', '.join(['time', *('abcdefgh'[: len(names) - 1])])}")  # fmt: skip
    if not data:
        raise ValueError("the file has a header but no row of data")
    first = data[0] + [""] * (len(names) - len(data[0]))
    return Layout(path, names, delimiter, decimal, encoding, skip + 1, first, hints)


def above_header(layout: Layout) -> str:
    """Return what to add to a sentence on a column that is not there: "", or that the first row is no header."""
    with open(layout.path, encoding=layout.encoding, errors="replace", newline="") as f:
        lines = [line for line, _ in zip(f, range(layout.skip + FURTHER), strict=False)]
    widths = [max(len(cells_of(line, d)) for d in (";", "\t", ",")) for line in lines]
    first = widths[layout.skip - 1] if len(widths) >= layout.skip else 0
    if not widths or first >= max(widths):
        return ""
    here, there = f"row {layout.skip} has {first} cell{'s' * (first != 1)}", f"row {widths.index(max(widths)) + 1} has {max(widths)}"
    return f"; the header must be the first row: {here}, {there}"


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; of one that csv cannot read, what lies between the delimiters."""
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:  # a cell of more than 128 KiB
        return line.split(delimiter)


def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell is a number written with this decimal sign."""
    return NUMBER.fullmatch(cell.strip().replace(decimal, ".")) is not None


def parse_columns(layout: Layout, index: Mapping[str, int], texts: Iterable[str]) -> dict[str, Any]:
    """Return {column: pyarrow array} of the wanted columns; `texts` are those that are not numbers."""
    import pyarrow as pa
    import pyarrow.csv as pc

    key = {name: f"f{i}" for name, i in index.items()}
    read = pc.ReadOptions(column_names=[f"f{i}" for i in range(len(layout.names))], skip_rows=layout.skip, encoding=layout.encoding,
                          block_size=max(1 << 20, 64 * len(layout.names), 16 * sum(map(len, layout.names))))  # fmt: skip
    failure = None
    for decimal in (layout.decimal, "," if layout.decimal == "." else ".") if layout.delimiter != "," else (".",):
        convert = pc.ConvertOptions(
            include_columns=list(key.values()), decimal_point=decimal, null_values=list(MISSING_CELLS), strings_can_be_null=True,
            column_types={k: pa.string() if name in texts else pa.float64() for name, k in key.items()})  # fmt: skip
        try:
            table = pc.read_csv(layout.path, read, pc.ParseOptions(delimiter=layout.delimiter, newlines_in_values=False), convert)
            return {name: table[k].combine_chunks() for name, k in key.items()}
        except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeError) as e:
            failure = failure or e
    raise ValueError(_bad_row(layout, index, texts) or str(failure).splitlines()[0])


def _bad_row(layout, index, texts):
    """Return a sentence on the first row that cannot be read, and on all cells like it: the slow second pass."""
    first, others = "", 0
    words: dict[str, None] = {}
    with open(layout.path, encoding="utf-8-sig" if layout.encoding == "utf-8" else layout.encoding, errors="replace", newline="") as f:
        reader = csv.reader(f, delimiter=layout.delimiter)
        while True:
            try:
                row = next(reader, None)
            except csv.Error as e:
                return first or f"row {reader.line_num} cannot be read: {e}"
            if row is None:
                more = f"; {others} more cells hold {listed(list(words))}, too" if others else ""
                return f"{first}{more}" or None
            if reader.line_num <= layout.skip or not row:
                continue
            if len(row) != len(layout.names):
                return first or f"row {reader.line_num} has {len(row)} cells, the header has {len(layout.names)} columns"
            for name, i in index.items():
                cell = row[i]
                if name in texts or cell in MISSING_CELLS or is_number(cell, layout.decimal):
                    continue
                word = cell.strip()[:60]
                if first:
                    others += 1
                    words |= {word: None} if len(words) < MANY else {}
                else:
                    first = f"row {reader.line_num} of column {name!r} holds {word!r}, which is not a number: leave a missing sample blank"
