"""The text of a CSV file: its delimiter and decimal sign, its columns, and the row that cannot be read.

Columns are parsed by pyarrow, only those that are wanted; when that fails, or gives another number of rows
than there are lines, a second, slow pass finds the row and says what stands there. Rows are counted as a
spreadsheet does: the header is row 1.
"""

import csv
import re
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxbound.recordings.columns import from_arrow
from jaxbound.recordings.csvlines import BOM, CountedLines, is_blank, is_open, lines_of
from jaxbound.recordings.oddcells import ERRORS, OddCells, no_number, thousands
from jaxbound.recordings.selection import Wanted, wanted
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.thousands import all_grouped, in_doubt, may_be_grouped
from jaxbound.recordings.timestamps import DIGITS, stamp_kind
from jaxbound.text.names import listed

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.csv as pc

__all__ = [
    "BLANK",
    "UNCLOSED",
    "UNENDED",
    "Layout",
    "Planned",
    "above_header",
    "cells_of",
    "converting",
    "delimiter_of",
    "is_number",
    "numbered_columns",
    "parse_columns",
    "parsing",
    "planned",
    "sniff",
]

WORDS = ("NaN", "nan", "NAN", "null", "NULL", "Null", "NA", "N/A", "n/a", "None", "none")
BLANK_CELLS = ("", " ", *WORDS, *(f" {x}" for x in WORDS))
MISSING_CELLS = (*BLANK_CELLS, *ERRORS)
ENOUGH, LINES = 1 << 18, 8  # bytes and lines of a file that show how it is written
LONGEST = 1 << 26  # bytes looked at at most, for a header of many columns
ENDS = (b"\n", b"\r")
FURTHER = 20  # lines below the first row that show whether it is the header
NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[-+]?[0-9]+)?|[-+]?(inf|infinity)|nan", re.IGNORECASE)
UNENDED = "has no line end, as one that was being written: it is left out (if it is complete, end the line)"
UNCLOSED = "has a quotation mark that is not closed: remove it, or close it on the same line"
DELIMITERS = (";", "\t", ",")
WITH_COMMA = re.compile(r"\s*[-+]?\d*,\d+([eE].*)?\s*", re.ASCII)
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
    """The layout of a CSV file: how its cells and numbers are written.

    Fields: skip: lines before the data; first: cells of the first row of data; hints: for its owner; blank:
    numbers of the lines that are no rows, once they are known.
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
        if is_number(cell, self.decimal) and not DIGITS.fullmatch(cell.strip()):
            return ""
        return stamp_kind(cell)

    @property
    def decimals(self) -> tuple[str, ...]:
        """The decimal signs that numbers may have, the likeliest first."""
        if self.delimiter == ",":
            return (".",)
        if self.decimal == ".":
            return ".", ","
        return ",", "."

    @cached_property
    def _cells(self) -> dict[str, str]:
        return dict(zip(self.names, self.first, strict=False))


def sniff(path: Path, head: bytes | None = None) -> Layout:
    """Look at the first lines of the file, or at these bytes, and find out how it is written."""
    if head is None:
        head = _head_of(path)
    _refuse_no_csv(head)
    text, encoding = _decoded(head)
    hints: list[str] = []
    if encoding != "utf-8":
        hints = ["the file is not in UTF-8: it is read as Windows-1252, which matters for column names only"]
    # enough of them; splitting all takes longer than parsing
    lines = re.split(r"\r*\n|\r", text, maxsplit=1000)
    skip = next((i for i, line in enumerate(lines) if line.strip()), None)
    if skip is None:
        raise ValueError(f"the file begins with {len(lines)} blank lines: a header is needed")
    delimiter = ""
    stated = re.fullmatch(r"sep=(.)\s*", lines[skip])  # as Excel writes it
    if stated is not None and len(lines) > skip + 1:
        delimiter, skip = stated[1], skip + 1
    header = lines[skip]
    delimiter = delimiter or delimiter_of(header)
    names = [name.strip() for name in cells_of(header, delimiter)]
    data = [cells_of(line, delimiter) for line in lines[skip + 1 : skip + 200] if line.strip()]
    decimal = _decimal_of(data, delimiter)
    if all(is_number(name, decimal) for name in names):
        instead = ", ".join(["time", *"abcdefgh"[: len(names) - 1]])
        raise ValueError(
            f"the first row must hold the names of the columns: it holds numbers ({listed(names[:3], str)}). "
            f"Put a line above it, such as: {instead}"
        )
    if not data:
        raise ValueError("the file has a header but no row of data")
    first = data[0] + [""] * (len(names) - len(data[0]))
    return Layout(path, names, delimiter, decimal, encoding, skip + 1, first, hints)


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
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise ValueError("the file is in UTF-16: save it as UTF-8")
    if b"\0" in head:
        raise ValueError("this is a binary file, or text in UTF-16: give a CSV file in UTF-8")


def _decoded(head: bytes) -> tuple[str, str]:
    """Return (text, encoding) of the first bytes of a file: UTF-8, or Windows-1252 where they are not."""
    body = head.removeprefix(BOM)
    end = max(map(body.rfind, ENDS)) + 1
    if end and len(head) >= ENOUGH:  # they end within a line, perhaps within a character
        body = body[:end]
    try:
        return body.decode(), "utf-8"
    except UnicodeDecodeError:
        # Latin letters with accents are rare in any text, and control characters stand in none
        controls, foreign = sum(b < 9 for b in head), sum(b > 127 for b in head)
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
    for line, _ in zip(lines_of(layout.path), range(layout.skip + FURTHER), strict=False):
        text = _line_text(line, layout)
        widths.append(max(len(cells_of(text, delimiter)) for delimiter in DELIMITERS))
    first = 0
    if len(widths) >= layout.skip:
        first = widths[layout.skip - 1]
    if not widths or first >= max(widths):
        return ""
    here = f"row {layout.skip} has {first} cell{'s' * (first != 1)}"
    there = f"row {widths.index(max(widths)) + 1} has {max(widths)}"
    return f"; the header must be the first row: {here}, {there}"


class Planned(NamedTuple):
    """The columns of a CSV file that a model needs, and how they are read.

    Fields: wanted: the columns; numbers: {column: its number in the file}; is_text: whether the time is
    written as text; texts: columns that are not read as numbers.
    """

    wanted: Wanted
    numbers: dict[str, int]
    is_text: bool
    texts: frozenset[str]


def planned(layout: Layout, model: SignalModel) -> Planned:
    """Find the columns of a model in a file.

    Raises:
        ValueError: see `selection.wanted`.
    """
    plan = wanted(layout.names, model, layout.dated)
    first = layout.first[0]
    if plan.time is None and layout.names[0] == "" and first and not is_number(first, layout.decimal):
        plan = replace(plan, time="")  # an index of time stamps without a name, as pandas writes one
    index = {name: layout.names.index(name) for name in plan.columns}
    texts = frozenset(plan.texts)
    is_text = plan.time is not None and not is_number(layout.first[index[plan.time]], layout.decimal)
    if is_text:
        texts |= {name for name in (plan.time, plan.day) if name is not None}
    return Planned(plan, index, is_text, texts)


def _line_text(line: bytes, layout: Layout) -> str:
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
    """Return the options by which pyarrow takes lines apart.

    A blank line is no row; where there is one column it is a missing sample.
    """
    import pyarrow.csv as pc

    def of_wrong_length(row: "pc.InvalidRow") -> str:
        if layout.is_blank(row.text.encode()):
            return "skip"
        return "error"

    return pc.ParseOptions(
        delimiter=layout.delimiter,
        newlines_in_values=False,
        ignore_empty_lines=len(layout.names) > 1,
        invalid_row_handler=of_wrong_length,
    )


def converting(layout: Layout, plan: Planned, as_texts: bool = False) -> list["pc.ConvertOptions"]:
    """Return the options by which pyarrow reads cells, one for each decimal sign that there may be.

    Args:
        as_texts: numbers as the texts that they are written in, errors of a spreadsheet too.
    """
    import pyarrow as pa
    import pyarrow.csv as pc

    kinds = dict.fromkeys([f"f{i}" for i in plan.numbers.values()], pa.string())
    missing = BLANK_CELLS
    if not as_texts:
        missing = MISSING_CELLS
        kinds |= {f"f{i}": pa.float64() for name, i in plan.numbers.items() if name not in plan.texts}
    options: list[pc.ConvertOptions] = []
    for decimal in layout.decimals:
        options.append(
            pc.ConvertOptions(
                include_columns=list(kinds),
                decimal_point=decimal,
                null_values=list(missing),
                strings_can_be_null=True,
                column_types=kinds,
            )
        )
    return options


def numbered_columns(layout: Layout) -> list[str]:
    """Return the names by which pyarrow calls all columns: those in the file may stand twice."""
    return [f"f{i}" for i in range(len(layout.names))]


class Cells(NamedTuple):
    """The wanted columns of a file.

    Fields: columns: {name: pyarrow array} with an element for each row of the file; odd: of columns of
    numbers, the cells that hold none.
    """

    columns: dict[str, "pa.Array"]
    odd: dict[str, OddCells]


def parse_columns(layout: Layout, plan: Planned) -> Cells:
    """Return the wanted columns of a file.

    Args:
        layout: of the file; its .blank is filled. plan: the columns; without a time, a blank line between
            rows is refused.

    Raises:
        ValueError: a row that cannot be read, or is not what pyarrow took for one: which, and why.
    """
    for decimal, convert in zip(layout.decimals, converting(layout, plan), strict=True):
        # the first rows may be whole numbers, which do not show the decimal sign of those below
        table, has_errors = _table_of(layout, plan, convert)
        if table is not None and not has_errors:
            columns = {name: table[f"f{i}"].combine_chunks() for name, i in plan.numbers.items()}
            _refuse_thousands(layout, plan, columns, decimal)
            return Cells(columns, {})
        if table is not None:
            break
    table, _ = _table_of(layout, plan, converting(layout, plan, as_texts=True)[0])
    if table is None:
        raise ValueError(_bad_row(layout, plan))
    texts = {name: table[f"f{i}"].combine_chunks() for name, i in plan.numbers.items()}
    return _numbers_among(layout, plan, texts)


def _table_of(layout: Layout, plan: Planned, convert: "pc.ConvertOptions") -> "tuple[pa.Table | None, bool]":
    """Return (table of the wanted columns, whether there may be errors of a spreadsheet in it); None where
    some row or cell cannot be read.
    """
    import pyarrow as pa
    import pyarrow.csv as pc

    # a block has to hold a whole line, and a line of thousands of columns is longer than a megabyte
    read = pc.ReadOptions(
        column_names=numbered_columns(layout),
        skip_rows=layout.skip,
        encoding=layout.encoding,
        block_size=max(1 << 20, 64 * len(layout.names), 16 * sum(map(len, layout.names))),
    )
    with open(layout.path, "rb", buffering=0) as file:
        lines = CountedLines(file, layout.delimiter)
        try:
            table = pc.read_csv(lines, read, parsing(layout), convert)
        except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeError):
            if lines.unended and lines.lines <= layout.skip:
                _note_unended(layout, lines.lines + 1)
            return None, False
    if lines.unended:
        _note_unended(layout, lines.lines + 1)
    _refuse_lost_rows(layout, lines, table.num_rows, plan.wanted.time is not None)
    return table, lines.has_errors


def _refuse_thousands(layout: Layout, plan: Planned, columns: dict[str, "pa.Array"], decimal: str) -> None:
    """Raise ValueError for a column whose decimal signs may be signs for thousands."""
    doubted: dict[str, np.ndarray] = {}
    for name in columns:
        if layout.delimiter == "," or name in plan.texts or name == plan.wanted.time:
            continue  # cells that are parted by commas have decimal points
        values = from_arrow(columns[name])
        if may_be_grouped(values):
            doubted[name] = values
    if not doubted:
        return
    texts, _ = _table_of(layout, plan, converting(layout, plan, as_texts=True)[0])
    assert texts is not None, "it was read before"
    for name, values in doubted.items():
        cells = texts[f"f{plan.numbers[name]}"].combine_chunks()
        places = in_doubt(cells, values, decimal, decimal == "." and layout.decimal == ",")
        if places:
            found = [f"{cells[k].as_py().strip()} in {layout.row(k)}" for k in places]
            raise ValueError(thousands(name, found))
        like = all_grouped(cells)
        if like:
            decimals = f"column {name!r} is read as decimals, like {like}"
            layout.hints.append(f"{decimals}: if points are for thousands, write it without them")


def _note_unended(layout: Layout, number: int) -> None:
    """Say once that the last line has no end; refuse a file without any row before it."""
    if number <= layout.skip + 1:
        raise ValueError(f"row {number}, the only one, {UNENDED}")
    note = f"row {number}, the last, {UNENDED}"
    if note not in layout.hints:
        layout.hints.append(note)


def _numbers_among(layout: Layout, plan: Planned, texts: dict[str, "pa.Array"]) -> Cells:
    """Return the numbers that are written in columns of texts, by the decimal sign that leaves least over."""
    best: Cells | None = None
    for decimal in layout.decimals:
        columns, odd = dict(texts), {}
        for name in texts:
            if name not in plan.texts:
                columns[name], cells = _numbers_of(texts[name], decimal)
                if len(cells.rows):
                    odd[name] = cells
        if best is None or _count(odd) < _count(best.odd):
            best = Cells(columns, odd)
    assert best is not None, "there is a decimal sign"
    return best


def _count(odd: dict[str, OddCells]) -> int:
    return sum(len(cells.rows) for cells in odd.values())


def _numbers_of(cells: "pa.Array", decimal: str) -> "tuple[pa.Array, OddCells]":
    """Return (floats, null where there is none, the cells that are no numbers) of a column of texts."""
    import pyarrow as pa
    import pyarrow.compute as pc

    trimmed = pc.utf8_trim_whitespace(cells)
    plain = trimmed
    if decimal != ".":  # a point stands in no number then
        plain = pc.replace_substring(pc.replace_substring(trimmed, ".", "#"), decimal, ".")
    plain = pc.utf8_ltrim(plain, "+")
    is_number = pc.match_substring_regex(plain, f"^({NUMBER.pattern})$", ignore_case=True)
    numbers = pc.if_else(is_number, plain, pa.scalar(None, pa.string())).cast(pa.float64())
    odd = np.flatnonzero(pc.fill_null(pc.invert(is_number), False).to_numpy(zero_copy_only=False))
    return numbers, OddCells(odd, trimmed.take(pa.array(odd)).to_pylist())


def _refuse_lost_rows(layout: Layout, counted: CountedLines, rows: int, timed: bool) -> None:
    """Raise ValueError unless every line below the header is a row that was read; note those that are
    blank.
    """
    last = counted.last
    if len(layout.names) == 1:  # a blank line is a row there
        last = counted.lines
    # pyarrow counts rows, CountedLines lines: they differ where a quotation mark took line ends into a cell
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


def _bad_row(layout: Layout, plan: Planned) -> str:
    """Return a sentence on the first row that is none, or whose cells have no number in between before it:
    the slow second pass.
    """
    for number, line in enumerate(lines_of(layout.path), 1):
        if number <= layout.skip or layout.is_blank(line):
            continue
        if layout.is_open(line):
            return f"row {number} {UNCLOSED}"
        row = cells_of(_line_text(line, layout), layout.delimiter, spaced=False)
        if len(row) != len(layout.names):
            return f"row {number} has {len(row)} cells, the header has {len(layout.names)} columns"
        for name, i in plan.numbers.items():
            is_read = name in plan.texts or row[i] in MISSING_CELLS or is_number(row[i], layout.decimal)
            if not is_read:
                return no_number(f"row {number}", name, row[i].strip())
    return "the file cannot be read"
