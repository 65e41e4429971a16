"""The layout of CSV text, by its first lines: its delimiter and decimal sign, and the columns of a model.

Rows are counted as a spreadsheet does: the header is row 1.
"""

import csv
import re
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice, zip_longest
from pathlib import Path
from typing import NamedTuple

from jaxbound.recordings.csvlines import BOM, is_open, lines_of
from jaxbound.recordings.oddcells import ERRORS
from jaxbound.recordings.recordingformat import UNSTATED, RecordingFormat
from jaxbound.recordings.timestamps import DIGITS, stamp_kind
from jaxbound.text.names import listed

WORDS = ("NaN", "nan", "NAN", "null", "NULL", "Null", "NA", "N/A", "n/a", "None", "none")
BLANK_CELLS = ("", " ", *WORDS, *(f" {x}" for x in WORDS))
MISSING_CELLS = (*BLANK_CELLS, *ERRORS)
ENOUGH, LINES = 1 << 18, 8  # bytes and lines of a file that show how it is written
LONGEST = 1 << 26  # bytes looked at at most, for a header of many columns
ENDS = (b"\n", b"\r")
FURTHER = 30  # lines in which the names of the columns, and the first samples, are looked for
NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[-+]?[0-9]+)?|[-+]?(inf|infinity)|nan", re.IGNORECASE)
UNENDED = "has no line end, as one that was being written: it is left out (if it is complete, end the line)"
UNCLOSED = "has a quotation mark that is not closed: remove it, or close it on the same line"
DELIMITERS = (";", "\t", ",")
WITH_UNIT = re.compile(r"[-+\u2212]?\d[\d.,]*(\s*[^\s\d:/.,-]+)?\s*$")
WITH_COMMA = re.compile(r"\s*[-+]?\d*,\d+([eE].*)?\s*", re.ASCII)
BLANK = (
    "is blank, and without a column of times nothing says whether a sample is missing there: "
    "remove the line, or leave its cells blank between their delimiters"
)
WIDE = b"\xff\xfe", b"\xfe\xff"
"""What text in UTF-16 begins with."""
READ_AS = "the file is read as {}"
ZEROS = b"\0\0"
"""What a power cut leaves in a file: blocks of zero bytes."""
SIGNATURES = {
    b"PAR1": "a Parquet file",
    b"\x1f\x8b": "a gzip file",
    b"PK\x03\x04": "a zip file or an Excel workbook",
    b"\x89HDF": "an HDF5 file",
    b"ARROW1": "an Arrow file",
}


@dataclass(frozen=True)
class Layout:
    """The layout of a CSV file: how its cells and numbers are written.

    Fields: skip: lines before the data; first: cells of the first row of data; hints: for its owner; blank:
    numbers of the lines that are no rows, once they are known; header: number of the line with the names;
    how: what is stated of the format; above: the lines above the data.
    """

    path: Path
    names: list[str]
    delimiter: str
    decimal: str
    encoding: str
    skip: int
    first: list[str]
    hints: list[str] = field(default_factory=list)
    blank: list[int] = field(default_factory=list)
    header: int = 1
    how: RecordingFormat = UNSTATED
    above: frozenset[str] = frozenset()

    def row(self, k: int) -> str:
        """Return how the user finds sample k."""
        return f"row {self.number(k)}"

    def number(self, k: int) -> int:
        """Return the number of the line of sample k."""
        samples_before = [line - self.skip - 1 - i for i, line in enumerate(self.blank)]
        return k + self.skip + 1 + bisect_right(samples_before, k)

    def text(self, line: bytes) -> str:
        """Return a line as text."""
        return line.removeprefix(BOM).decode(self.encoding, "replace")

    def cells(self, line: bytes) -> list[str]:
        """Return the cells of a line of data."""
        return cells_of(self.text(line), self.delimiter, spaced=False)

    def is_blank(self, line: bytes) -> bool:
        """Return whether a line holds nothing and is no row; of one column it is one, a missing sample."""
        is_row = len(self.names) == 1 or self.delimiter.encode() in line
        return not is_row and not line.removeprefix(BOM).strip()

    def is_open(self, line: bytes) -> bool:
        """Return whether a line has a quotation mark that is not closed."""
        return is_open(line, self.delimiter.encode())

    def dated(self, name: str) -> str:
        """Return the kind of the first cell of a column, see `stamp_kind`."""
        cell = self._cells.get(name) or ""
        if is_number(cell, self.decimal) and not DIGITS.fullmatch(cell.strip()):
            return ""
        return stamp_kind(cell, self.how.time_format)

    @property
    def decimals(self) -> tuple[str, ...]:
        """The decimal signs that numbers may have, the likeliest first."""
        if self.how.decimal:
            return (self.how.decimal,)
        if self.how.thousands:
            return tuple(sign for sign in ".," if sign != self.how.thousands)
        if self.delimiter == ",":
            return (".",)
        if self.decimal == ".":
            return ".", ","
        return ",", "."

    @cached_property
    def _cells(self) -> dict[str, str]:
        return dict(zip(self.names, self.first, strict=False))


class Head(NamedTuple):
    """The first lines of CSV text. Fields: path: of the file; lines; encoding; hints: for its owner."""

    path: Path
    lines: list[str]
    encoding: str
    hints: tuple[str, ...] = ()


def wide_encoding(first: bytes, how: RecordingFormat) -> str:
    """Return the encoding of text with two bytes a letter or four, "" of other text. first: its bytes."""
    if how.encoding.startswith(("utf-16", "utf-32")):
        return how.encoding
    if first.startswith(WIDE):
        return "utf-16"
    return ""


def head_of(path: Path, head: bytes | None = None, encoding: str = "") -> Head:
    """Return the first lines of a file, or of these bytes.

    Args:
        encoding: of the text; "": UTF-8, or Windows-1252 where it is none.

    Raises:
        ValueError: no text, an empty one, or blank lines alone.
    """
    if head is None:
        head = _head_of(path)
    _refuse_no_csv(head)
    text, encoding = _decoded(head, encoding)
    hints: tuple[str, ...] = ()
    if encoding == "cp1252":
        hints = ("the file is not in UTF-8: it is read as Windows-1252, which matters for column names only",)
    # enough of them; splitting all takes longer than parsing
    lines = re.split(r"\r*\n|\r", text, maxsplit=1000)
    if not any(map(str.strip, lines)):
        raise ValueError(f"the file begins with {len(lines)} blank lines: a header is needed")
    return Head(path, lines, encoding, hints)


def sniff(path: Path, head: bytes | None = None, how: RecordingFormat = UNSTATED) -> Layout:
    """Look at the first lines of the file, or at these bytes, and find out how it is written."""
    return layout_of(head_of(path, head, how.encoding), how)


def layout_of(head: Head, how: RecordingFormat = UNSTATED, header: int | None = None) -> Layout:
    """Find out by its first lines how a file is written.

    Args:
        how: what is stated of it. header: number of the line with the names of the columns, from 1; None:
            that which is stated, or the first one that holds something and is no comment.

    Raises:
        ValueError: no names, or no row of data below them.
    """
    lines, delimiter = head.lines, how.delimiter
    at = (header or how.header or 0) - 1
    if at < 0:
        at = next(i for i, line in enumerate(lines) if line.strip())
        stated = re.fullmatch(r"sep=(.)\s*", lines[at])  # as Excel writes it
        if stated is not None and len(lines) > at + 1:
            delimiter, at = stated[1], at + 1
        while how.comment and at < len(lines) - 1 and lines[at].startswith(how.comment):
            at += 1
    if at >= len(lines):
        raise ValueError(f"the names of the columns are said to stand in row {at + 1}: there is none")
    delimiter = delimiter or delimiter_of(lines[at])
    names = list(map(str.strip, cells_of(lines[at], delimiter)))
    numbers: list[int] = []  # of the lines of data, from 1
    data: list[list[str]] = []
    for number, line in enumerate(lines[at + 1 : at + 200], at + 2):
        if line.strip():
            numbers.append(number)
            data.append(cells_of(line, delimiter))
    decimal = how.decimal or _decimal_of(data, delimiter)
    if all(is_number(name, decimal) for name in names):
        instead = ", ".join(["time", *"abcdefgh"[: len(names) - 1]])
        raise ValueError(
            f"the first row must hold the names of the columns: it holds numbers ({listed(names[:3], str)}). "
            f"Put a line above it, such as: {instead}"
        )
    if not data:
        raise ValueError("the file has a header but no row of data")
    hints = list(head.hints)
    begin, skip = _first_of_data(data[:FURTHER], decimal, how), at + 1
    if begin:
        rows = listed(map(str, numbers[:begin]), str)
        hold = "row {} holds" if begin == 1 else "rows {} hold"
        hints.append(f"{hold.format(rows)} no samples below the names of the columns: left out")
        skip = numbers[begin] - 1
    longer = sum(len(cells) == len(names) + 1 and not cells[-1].strip() for cells in data[begin:])
    if 2 * longer > len(data) - begin:  # others are no rows
        hints.append("each row has a delimiter more than the names of the columns, and nothing behind it")
        names.append("")
    first = data[begin] + [""] * (len(names) - len(data[begin]))
    return Layout(
        head.path,
        names,
        delimiter,
        decimal,
        head.encoding,
        skip,
        first,
        hints,
        header=at + 1,
        how=how,
        above=frozenset(map(str.strip, lines[:skip])) - {""},
    )


def _first_of_data(rows: Sequence[Sequence[str]], decimal: str, how: RecordingFormat) -> int:
    """Return the number of the first row below the header that is one of data: in the columns that hold
    numbers and times further below, units and the like hold words, or 1 where the first of them is a word.
    """
    for number, row in enumerate(rows[:-1]):
        cells = list(map(str.strip, row))
        if any(cell != "1" and is_value(cell, decimal, how) for cell in cells):
            return number
        below = list(zip_longest(*rows[number + 1 :], fillvalue=""))
        valued = []  # cells of this row, in columns that hold values below
        for cell, column in zip(cells, below, strict=False):
            values = [is_value(other, decimal, how) for other in column]
            if values[-1] or 2 * sum(values) > len(values):
                valued.append(cell)
        if not {*valued} - {"1", *MISSING_CELLS} or valued[0] == "1":
            return number
    return max(len(rows) - 1, 0)


def is_value(cell: str, decimal: str, how: RecordingFormat = UNSTATED) -> bool:
    """Return whether a cell holds a number, perhaps with a unit, or a time."""
    cell = cell.strip()
    if not any(c.isdigit() for c in cell):
        return False
    if is_number(cell, decimal) or WITH_UNIT.fullmatch(cell):
        return True
    return bool(stamp_kind(cell, how.time_format))


def _head_of(path: Path) -> bytes:
    """Return the first bytes of a file, with some lines in them if there are any."""
    with open(path, "rb") as f:
        head = f.read(ENOUGH)
        while max(map(head.count, ENDS)) < LINES and len(head) < LONGEST:
            more = f.read(ENOUGH)
            if not more:
                break
            head += more
    return head


def _refuse_no_csv(head: bytes) -> None:
    """Raise ValueError if the first bytes of a file show that it is empty, or no text in bytes."""
    if not head.strip(BOM + b" \t\r\n"):
        raise ValueError("the file is empty")
    for magic, kind in SIGNATURES.items():
        if head.startswith(magic):
            raise ValueError(f"this is {kind}, not text: give a CSV file")
    if head.startswith(WIDE):
        raise ValueError("the file is in UTF-16: save it as UTF-8")
    first = re.split(rb"[\r\n]", head, maxsplit=1)[0]
    if b"\0" in first or b"\0" in re.sub(rb"\0{2,}", b"", head):
        raise ValueError("this is a binary file, or text in UTF-16: give a CSV file in UTF-8")


def _decoded(head: bytes, encoding: str = "") -> tuple[str, str]:
    """Return (text, encoding) of the first bytes of a file: UTF-8, or Windows-1252 where they are not, unless
    another is stated.
    """
    if encoding not in ("", "utf-8"):
        return head.decode(encoding, "replace"), encoding
    body = head.removeprefix(BOM)
    end = max(map(body.rfind, ENDS)) + 1
    if end and len(head) >= ENOUGH:  # they end within a line, perhaps within a character
        body = body[:end]
    try:
        return body.decode(), "utf-8"
    except UnicodeDecodeError:
        # Latin letters with accents are rare in any text, and control characters stand in none
        controls, foreign = sum(b < 9 for b in head.replace(ZEROS, b"")), sum(b > 127 for b in head)
        if controls or foreign > len(head) // 4:
            raise ValueError("this is not a text file: give a CSV file in UTF-8") from None
        return head.decode("cp1252", "replace"), "cp1252"


def delimiter_of(header: str) -> str:
    """Return the delimiter between the cells of a header."""
    for delimiter in DELIMITERS:
        if delimiter in header:
            return delimiter
    return ","


def _decimal_of(rows: Iterable[Iterable[str]], delimiter: str) -> str:
    """Return the decimal sign: a comma where some cell is written so, and cells are not parted by it."""
    if delimiter == ",":
        return "."
    for row in rows:
        if any(map(WITH_COMMA.fullmatch, row)):
            return ","
    return "."


def above_header(layout: Layout) -> str:
    """Return the end of a sentence on a column that is not there: "", or that the first row is no
    header.
    """
    widths: list[int] = []
    with open(layout.path, "rb", buffering=0) as file:
        lines = list(islice(lines_of(file), layout.skip + FURTHER))
    for line in lines:
        text = layout.text(line)
        widths.append(max(len(cells_of(text, delimiter)) for delimiter in DELIMITERS))
    first = 0
    if len(widths) >= layout.skip:
        first = widths[layout.skip - 1]
    if not widths or first >= max(widths):
        return ""
    here = f"row {layout.skip} has {first} cell{'s' * (first != 1)}"
    there = f"row {widths.index(max(widths)) + 1} has {max(widths)}"
    return f"; the header must be the first row: {here}, {there}"


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
