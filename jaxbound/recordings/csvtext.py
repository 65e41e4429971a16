"""The text of a CSV file: how it is written, its columns, and the row that cannot be read.

Columns are parsed by pyarrow, only those that are wanted; when that fails, or gives another number of rows
than there are lines, a second, slow pass finds the row and says what stands there. Rows are counted as a
spreadsheet does: the header is row 1.
"""

import csv
import re
from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxbound.recordings.csvlines import BOM, CountedLines, is_blank, is_open, lines_of
from jaxbound.recordings.timestamps import DIGITS, stamp_kind
from jaxbound.text.names import listed

if TYPE_CHECKING:
    import pyarrow.csv as pc

__all__ = ["BLANK", "UNCLOSED", "Layout", "cells_of", "is_number", "parse_columns", "parsing", "sniff"]

WORDS = ("NaN", "nan", "NAN", "null", "NULL", "Null", "NA", "N/A", "n/a", "#N/A", "None", "none")
MISSING_CELLS = ("", " ", *WORDS, *(f" {x}" for x in WORDS))
ENOUGH, LINES, LONGEST = (
    1 << 18,
    8,
    1 << 26,
)  # bytes and lines of a file that show how it is written; bytes looked at at most
ENDS = (b"\n", b"\r")
FURTHER = 20  # lines below the first row that show whether it is the header
MANY = 10  # words that a sentence on cells that are no numbers repeats at most
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(inf|infinity)|nan", re.IGNORECASE)
UNCLOSED = "has a quotation mark that is not closed: remove it, or close it on the same line"
BLANK = (
    "is blank, and without a column of times nothing says whether a sample is missing there: "
    "remove the line, or leave its cells blank between their delimiters"
)
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
    names: list[str]
    delimiter: str
    decimal: str
    encoding: str
    skip: int  # lines before the data
    first: list[str]  # cells of the first data row
    hints: list[str] = field(default_factory=list)
    blank: list[int] = field(
        default_factory=list
    )  # numbers of the lines that are no rows, once they are known

    def row(self, k: int) -> str:
        """Return how the user finds sample k."""
        samples_before = [line - self.skip - 1 - i for i, line in enumerate(self.blank)]
        return f"row {k + self.skip + 1 + bisect_right(samples_before, k)}"

    def is_blank(self, line: bytes) -> bool:
        """Return whether a line is no row, see `csvlines`."""
        return is_blank(line, len(self.names), self.delimiter.encode())

    def is_open(self, line: bytes) -> bool:
        """Return whether a line has a quotation mark that is not closed."""
        return is_open(line, self.delimiter.encode())

    def dated(self, name: str) -> str:
        """Return the kind of the first cell of a column, see `stamp_kind`."""
        cell = self._cells.get(name) or ""
        return stamp_kind(cell) if DIGITS.fullmatch(cell.strip()) or not is_number(cell, self.decimal) else ""

    @cached_property
    def _cells(self) -> dict[str, str]:
        return dict(zip(self.names, self.first, strict=False))


def sniff(path: Path, head: bytes | None = None) -> Layout:
    """Look at the first lines of the file, or at these bytes, and find out how it is written."""
    if head is None:
        with open(path, "rb") as f:
            head = f.read(ENOUGH)
            while (
                max(map(head.count, ENDS)) < LINES and len(head) < LONGEST and (more := f.read(ENOUGH))
            ):  # a header of many columns
                head += more
    if not head.strip(BOM + b" \t\r\n"):
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
        body = head.removeprefix(BOM)
        end = max(map(body.rfind, ENDS)) + 1
        text = (body if len(head) < ENOUGH or not end else body[:end]).decode()
    except UnicodeDecodeError:
        if sum(b < 9 for b in head) or sum(b > 127 for b in head) > len(head) // 4:
            raise ValueError("this is not a text file: give a CSV file in UTF-8") from None
        encoding, text = "cp1252", head.decode("cp1252", "replace")
        hints.append(
            "the file is not in UTF-8: it is read as Windows-1252, which matters for column names only"
        )
    lines = re.split(
        r"\r*\n|\r", text, maxsplit=1000
    )  # enough of them; splitting all takes longer than parsing
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
    decimal = (
        ","
        if delimiter != ","
        and any(re.fullmatch(r"\s*[-+]?\d*,\d+([eE].*)?\s*", c) for row in data for c in row)
        else "."
    )
    if all(is_number(name, decimal) for name in names):
        raise ValueError(
            f"the first row must hold the names of the columns: it holds numbers ({listed(names[:3], str)}). "
            f"Put a line above it, such as: {', '.join(['time', *('abcdefgh'[: len(names) - 1])])}"
        )
    if not data:
        raise ValueError("the file has a header but no row of data")
    first = data[0] + [""] * (len(names) - len(data[0]))
    return Layout(path, names, delimiter, decimal, encoding, skip + 1, first, hints)


def above_header(layout: Layout) -> str:
    """Return the end of a sentence on a column that is not there: "", or that the first row is no
    header.
    """
    lines = [
        _text(line, layout)
        for line, _ in zip(lines_of(layout.path), range(layout.skip + FURTHER), strict=False)
    ]
    widths = [max(len(cells_of(line, d)) for d in (";", "\t", ",")) for line in lines]
    first = widths[layout.skip - 1] if len(widths) >= layout.skip else 0
    if not widths or first >= max(widths):
        return ""
    here, there = (
        f"row {layout.skip} has {first} cell{'s' * (first != 1)}",
        f"row {widths.index(max(widths)) + 1} has {max(widths)}",
    )
    return f"; the header must be the first row: {here}, {there}"


def _text(line: bytes, layout: Layout) -> str:
    return line.removeprefix(BOM).decode(layout.encoding, "replace")


def cells_of(line: str, delimiter: str, spaced: bool = True) -> list[str]:
    """Return the cells of a line; of one that csv cannot read, what lies between the delimiters.

    Args:
        line: without its end. delimiter: between cells. spaced: a quotation mark behind a space begins a
            cell, as in headers.
    """
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=spaced), [""]) or [""]
    except csv.Error:  # a cell of more than 128 KiB
        return line.split(delimiter)


def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell is a number written with this decimal sign."""
    return NUMBER.fullmatch(cell.strip().replace(decimal, ".")) is not None


def parsing(layout: Layout) -> "pc.ParseOptions":
    """Return how pyarrow takes the lines apart: one that is blank is no row, but where there is one column a
    missing sample.
    """
    import pyarrow.csv as pc

    def of_wrong_length(row):
        return "skip" if layout.is_blank(row.text.encode()) else "error"

    return pc.ParseOptions(
        delimiter=layout.delimiter,
        newlines_in_values=False,
        ignore_empty_lines=len(layout.names) > 1,
        invalid_row_handler=of_wrong_length,
    )


def parse_columns(
    layout: Layout, index: Mapping[str, int], texts: Iterable[str], timed: bool = True
) -> dict[str, Any]:
    """Return {column: pyarrow array} of the wanted columns, an element for each row of the file.

    Args:
        layout: of the file; its .blank is filled. index: {column: its number}. texts: those that are not
            numbers. timed: a column tells the time; without one a blank line between rows is refused.

    Raises:
        ValueError: a row that cannot be read, or is not what pyarrow took for one: which, and why.
    """
    import pyarrow as pa
    import pyarrow.csv as pc

    key = {name: f"f{i}" for name, i in index.items()}
    read = pc.ReadOptions(
        column_names=[f"f{i}" for i in range(len(layout.names))],
        skip_rows=layout.skip,
        encoding=layout.encoding,
        block_size=max(1 << 20, 64 * len(layout.names), 16 * sum(map(len, layout.names))),
    )
    failure = None
    for decimal in (
        (layout.decimal, "," if layout.decimal == "." else ".") if layout.delimiter != "," else (".",)
    ):
        convert = pc.ConvertOptions(
            include_columns=list(key.values()),
            decimal_point=decimal,
            null_values=list(MISSING_CELLS),
            strings_can_be_null=True,
            column_types={k: pa.string() if name in texts else pa.float64() for name, k in key.items()},
        )
        with open(layout.path, "rb", buffering=0) as file:
            lines = CountedLines(file, layout.delimiter)
            try:
                table = pc.read_csv(lines, read, parsing(layout), convert)
            except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeError) as e:
                failure = failure or e
                continue
        _refuse_lost_rows(layout, lines, table.num_rows, timed)
        return {name: table[k].combine_chunks() for name, k in key.items()}
    raise ValueError(_bad_row(layout, index, texts) or str(failure).splitlines()[0])


def _refuse_lost_rows(layout, counted, rows, timed):
    """Raise ValueError unless every line below the header is a row that was read; note those that are
    blank.
    """
    last = counted.lines if len(layout.names) == 1 else counted.last
    if rows == last - layout.skip and not counted.open_end:
        return
    for number, line in enumerate(lines_of(layout.path), 1):
        if number <= layout.skip or number > last:
            continue
        if layout.is_open(line):
            raise ValueError(f"row {number} {UNCLOSED}")
        if layout.is_blank(line):
            layout.blank.append(number)
    lines = last - layout.skip - len(layout.blank)
    if rows != lines:
        raise ValueError(f"of {lines} rows {rows} can be read: write the file again without quotation marks")
    between = [number for i, number in enumerate(layout.blank) if number > layout.skip + 1 + i]
    if between and not timed:
        raise ValueError(f"row {between[0]} {BLANK}")


def _bad_row(layout, index, texts):
    """Return a sentence on the first row that cannot be read, and on all cells like it: the slow second
    pass.
    """
    first, others = "", 0
    words: dict[str, None] = {}
    for number, line in enumerate(lines_of(layout.path), 1):
        if number <= layout.skip or layout.is_blank(line):
            continue
        if layout.is_open(line):
            return first or f"row {number} {UNCLOSED}"
        row = cells_of(_text(line, layout), layout.delimiter, spaced=False)
        if len(row) != len(layout.names):
            return first or f"row {number} has {len(row)} cells, the header has {len(layout.names)} columns"
        for name, i in index.items():
            cell = row[i]
            if name in texts or cell in MISSING_CELLS or is_number(cell, layout.decimal):
                continue
            word = cell.strip()[:60]
            if first:
                others += 1
                words |= {word: None} if len(words) < MANY else {}
            else:
                first = (
                    f"row {number} of column {name!r} holds {word!r}, which is not a number: leave a "
                    f"missing sample blank"
                )
    more = f"; {others} more cells hold {listed(list(words))}, too" if others else ""
    return f"{first}{more}" or None
