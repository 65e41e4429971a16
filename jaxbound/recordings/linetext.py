"""Lines of CSV of one stream: how they are written, and the cells of some of them."""

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxbound.recordings.columns import from_arrow
from jaxbound.recordings.csvtext import (
    BLANK,
    MISSING_CELLS,
    UNCLOSED,
    cells_of,
    converting,
    is_number,
    numbered_columns,
    parsing,
    planned,
    sniff,
)
from jaxbound.recordings.oddcells import no_number, thousands
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.thousands import Doubt
from jaxbound.recordings.timestamps import with_day

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["FEW", "SOURCE", "Cells", "LineReader", "WrongCells"]

FEW = 8  # lines that are read one by one
PLAIN = re.compile(r" *[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)? *", re.ASCII)
SOURCE = "standard input"
Cells = tuple[dict[str, np.ndarray], "pa.Array | None"]
"""({column: (N,) numbers or texts}, the time as texts or None where it is a column of numbers or none)."""


class WrongCells(ValueError):
    """The first row of data does not fit the header."""


class LineReader:
    """Reads lines without their ends.

    Args:
        head: the header and the first line of data, before them perhaps one with the delimiter, as bytes.
            model: whose signals are wanted.

    Fields: head; layout (`csvtext.Layout`); plan (`selection.Wanted`); index: {column: its number}; texts:
    columns that are not read as numbers; is_text: the time is written as text.

    Raises:
        WrongCells: the first line of data has more or fewer cells than the header. ValueError: a column is
            not there, no header, no text.
    """

    def __init__(self, head: list[bytes], model: SignalModel) -> None:
        import pyarrow.csv as pc

        try:
            layout = sniff(Path(SOURCE), b"\n".join(head) + b"\n")
            plan = planned(layout, model)
        except ValueError as e:
            raise ValueError(f"{SOURCE}: {str(e).replace('the file', 'the stream')}") from None
        self.head, self.layout = head, layout
        self.plan, self.index, self.is_text, self.texts = plan
        if not self.fits(head[-1]) or layout.is_open(head[-1]):
            raise WrongCells(self.trouble(head[-1]))
        self.doubts: dict[str, Doubt] = {}
        if layout.delimiter != ",":
            self.doubts = {name: Doubt() for name in self.index if name not in {*self.texts, self.plan.time}}
        # one thread: lines come a few at a time
        names = numbered_columns(layout)
        self.reading = pc.ReadOptions(column_names=names, encoding=layout.encoding, use_threads=False)
        self.parsing, self.converting = parsing(layout), converting(layout, plan)

    def cells(self, line: bytes) -> list[str]:
        """Return the cells of a line as texts."""
        text = line.decode(self.layout.encoding, "replace")
        return cells_of(text, self.layout.delimiter, spaced=False)

    def _cell(self, lines: Sequence[bytes], number: int, k: int) -> str:
        """Return the cell of a column in line k."""
        return self.cells(lines[k])[number]

    def is_row(self, line: bytes) -> bool:
        """Return whether a line is a row, or where no time shows that one is missing, may have been meant for
        one.
        """
        return self.plan.time is None or not self.layout.is_blank(line)

    def fits(self, line: bytes) -> bool:
        """Return whether a line has as many cells as the header."""
        return len(self.cells(line)) == len(self.layout.names)

    def columns(self, lines: list[bytes]) -> Cells:
        """Return ({column: (N,) numbers or texts}, the time as a pyarrow array of texts, or None where it is
        a column of numbers or none).

        Raises:
            ValueError: some line cannot be read, or holds an infinite number.
        """
        cells = None
        if len(lines) <= FEW:
            cells = self._few(lines)
        if cells is None:
            cells = self._many(lines)
        for name, x in cells[0].items():
            if x.dtype != object and np.isinf(x).any():
                raise ValueError(f"of column {name!r} is infinite")
            if name in self.doubts:
                odd = self.doubts[name].next_odd(x, partial(self._cell, lines, self.index[name]))
                if odd:
                    raise ValueError(f"of {thousands(name, [f'{odd} behind whole numbers'])}")
        return cells

    def numbers_in(self, line: bytes) -> Cells:
        """Return the same as `columns` of one line, in which a cell that is no number is a missing sample.

        Raises:
            ValueError: it has not as many cells as the header, or an open quotation mark.
        """
        import pyarrow as pa

        cells = self.cells(line)
        if len(cells) != len(self.layout.names) or self.layout.is_open(line):
            raise ValueError("is no row")
        columns: dict[str, np.ndarray] = {}
        times: dict[str, pa.Array] = {}
        for name, i in self.index.items():
            cell = cells[i].strip()
            is_missing = cell in MISSING_CELLS
            if name in self.plan.texts:
                columns[name] = np.array([None if is_missing else cells[i]], object)
            elif name in self.texts:
                times[name] = pa.array([None if is_missing else cells[i]], pa.string())
            elif is_number(cell, self.layout.decimal):
                columns[name] = np.array([float(cell.replace(self.layout.decimal, "."))])
            else:
                columns[name] = np.array([np.nan])
        return columns, self._time_of(times)

    def trouble(self, line: bytes) -> str:
        """Return the trouble with a line, as far as its cells show; or ""."""
        if self.layout.is_open(line):
            return UNCLOSED
        if self.layout.is_blank(line):
            return BLANK
        cells = self.cells(line)
        if len(cells) != len(self.layout.names):
            return f"has {len(cells)} cells, the header has {len(self.layout.names)} columns"
        for name, i in self.index.items():
            cell = cells[i].strip()
            is_read = name in self.texts or cell in MISSING_CELLS or is_number(cell, self.layout.decimal)
            if not is_read:
                return no_number("", name, cell).strip()
        return ""

    def stamp(self, line: bytes) -> str:
        """Return the time of a line as it is written, the day before the clock where they have columns of
        their own.
        """
        cells = self.cells(line)
        halves = [name for name in (self.plan.day, self.plan.time) if name is not None]
        return " ".join(cells[self.index[name]].strip() for name in halves)

    def _few(self, lines: list[bytes]) -> Cells | None:
        """Return the same as `_many`, sooner than pyarrow gets going; None where it must look at lines."""
        import pyarrow as pa

        if self.plan.texts:
            return None
        rows: list[list[str]] = []
        for line in lines:
            cells = line.decode(self.layout.encoding, "replace").split(self.layout.delimiter)
            if len(cells) != len(self.layout.names) or b'"' in line:
                return None
            rows.append([cells[i] for i in self.index.values()])
        columns: dict[str, np.ndarray] = {}
        times: dict[str, pa.Array] = {}
        for name, column in zip(self.index, zip(*rows, strict=True), strict=True):
            if name in self.texts:
                times[name] = pa.array([None if c in MISSING_CELLS else c for c in column], pa.string())
                continue
            numbers = self._plain_numbers(column)
            if numbers is None:
                return None
            columns[name] = numbers
        return columns, self._time_of(times)

    def _plain_numbers(self, cells: Sequence[str]) -> np.ndarray | None:
        """Return the numbers in cells, NaN where one is missing; None where some is written otherwise."""
        numbers: list[float] = []
        for cell in cells:
            if self.layout.decimal == ",":
                cell = cell.replace(",", ".")
            if cell in MISSING_CELLS:
                numbers.append(np.nan)
            elif PLAIN.fullmatch(cell):
                numbers.append(float(cell))
            else:
                return None
        return np.array(numbers)

    def _many(self, lines: list[bytes]) -> Cells:
        """Return ({column: (N,) numbers or texts}, the time as a pyarrow array of texts or None)."""
        table = self._table(b"\n".join(lines) + b"\n")
        if table.num_rows != len(lines) or self.layout.is_open(lines[-1]):
            raise ValueError(UNCLOSED)
        columns: dict[str, np.ndarray] = {}
        times: dict[str, pa.Array] = {}
        for name, i in self.index.items():
            cells = table[f"f{i}"].combine_chunks()
            if name in self.plan.texts:
                columns[name] = np.array(cells.to_pylist(), object)
            elif name in self.texts:
                times[name] = cells
            else:
                columns[name] = from_arrow(cells)
        return columns, self._time_of(times)

    def _table(self, body: bytes) -> "pa.Table":
        import pyarrow as pa
        import pyarrow.csv as pc

        for convert in self.converting:
            try:
                return pc.read_csv(pa.BufferReader(body), self.reading, self.parsing, convert)
            except pa.ArrowInvalid:
                continue
        raise ValueError("cannot be read")

    def _time_of(self, texts: "dict[str, pa.Array]") -> "pa.Array | None":
        """Return the time of columns of texts; None where it is a column of numbers or none."""
        if not self.is_text:
            return None
        assert self.plan.time is not None, "it is a column"
        if self.plan.day is None:
            return texts[self.plan.time]
        return with_day(texts[self.plan.day], texts[self.plan.time])
