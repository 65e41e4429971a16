"""How the lines of CSV of one stream are written, and what stands in some of them."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxbound.recordings.columns import from_arrow
from jaxbound.recordings.csvtext import BLANK, MISSING_CELLS, UNCLOSED, cells_of, is_number, parsing, sniff
from jaxbound.recordings.selection import wanted
from jaxbound.recordings.timestamps import with_day

__all__ = ["FEW", "SOURCE", "LineReader", "WrongCells"]

FEW = 8  # lines that are read one by one
PLAIN = re.compile(r" *[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)? *")
SOURCE = "standard input"


class WrongCells(ValueError):
    """The first row of data does not fit the header."""


class LineReader:
    """Reads lines without their ends.

    Args:
        head: the header and the first line of data, before them perhaps one with the delimiter, as bytes.
            model: whose signals are wanted.

    Fields: head; plan (`derived.Wanted`); is_text: the time is written as text; layout (`csvtext.Layout`).

    Raises:
        WrongCells: the first line of data has more or fewer cells than the header. ValueError: a column is
            not there, no header, no text.
    """

    def __init__(self, head: list[bytes], model: Any) -> None:
        import pyarrow as pa
        import pyarrow.csv as pc

        try:
            layout = sniff(Path(SOURCE), b"\n".join(head) + b"\n")
            plan = wanted(layout.names, model, layout.dated)
        except ValueError as e:
            raise ValueError(f"{SOURCE}: {str(e).replace('the file', 'the stream')}") from None
        self.layout = layout
        if not self.fits(head[-1]) or layout.is_open(head[-1]):
            raise WrongCells(self.trouble(head[-1]))
        if (
            plan.time is None
            and layout.names[0] == ""
            and layout.first[0]
            and not is_number(layout.first[0], layout.decimal)
        ):
            plan = replace(plan, time="")
        index = {name: layout.names.index(name) for name in plan.columns}
        text = plan.time is not None and not is_number(layout.first[index[plan.time]], layout.decimal)
        strings = {*plan.texts, *([plan.time, plan.day] if text else [])}
        self.head, self.plan, self.is_text, self.index = head, plan, text, index
        names = [f"f{i}" for i in range(len(layout.names))]
        self.reading = pc.ReadOptions(column_names=names, encoding=layout.encoding, use_threads=False)
        self.parsing = parsing(layout)
        kinds = {f"f{i}": pa.string() if name in strings else pa.float64() for name, i in index.items()}
        self.converting = [
            pc.ConvertOptions(
                include_columns=list(kinds),
                decimal_point=d,
                null_values=list(MISSING_CELLS),
                strings_can_be_null=True,
                column_types=kinds,
            )
            for d in (
                (layout.decimal, "," if layout.decimal == "." else ".") if layout.delimiter != "," else (".",)
            )
        ]

    def cells(self, line: bytes) -> list[str]:
        """Return the cells of a line as texts."""
        text = line.decode(self.layout.encoding, "replace")
        return cells_of(text, self.layout.delimiter, spaced=False)

    def is_row(self, line: bytes) -> bool:
        """Return whether a line is a row, or where no time shows that one is missing, may have been meant for
        one.
        """
        return self.plan.time is None or not self.layout.is_blank(line)

    def fits(self, line: bytes) -> bool:
        """Return whether a line has as many cells as the header."""
        return len(self.cells(line)) == len(self.layout.names)

    def columns(self, lines: list[bytes]) -> tuple[dict[str, np.ndarray], Any]:
        """Return ({column: (N,) numbers or texts}, the time as a pyarrow array of texts, or None where it is
        a column of numbers or none).

        Raises:
            ValueError: some line cannot be read, or holds an infinite number.
        """
        columns, stamps = (len(lines) <= FEW and self._few(lines)) or self._many(lines)
        for name, x in columns.items():
            if x.dtype != object and np.isinf(x).any():
                raise ValueError(f"of column {name!r} is infinite")
        return columns, stamps

    def trouble(self, line: bytes) -> str:
        """Return what is wrong with a line, as far as its cells show; or ""."""
        if self.layout.is_open(line):
            return UNCLOSED
        if self.layout.is_blank(line):
            return BLANK
        cells = self.cells(line)
        if len(cells) != len(self.layout.names):
            return f"has {len(cells)} cells, the header has {len(self.layout.names)} columns"
        for name, i in self.index.items():
            cell = cells[i].strip()
            text = name in self.plan.texts or (name in (self.plan.time, self.plan.day) and self.is_text)
            if not text and cell not in MISSING_CELLS and not is_number(cell, self.layout.decimal):
                return (
                    f"of column {name!r} holds {cell[:60]!r}, which is not a number: leave a missing "
                    f"sample blank"
                )
        return ""

    def stamp(self, line: bytes) -> str:
        """Return the time of a line as it is written, the day before the clock where they have columns of
        their own.
        """
        cells = self.cells(line)
        return " ".join(
            cells[self.index[name]].strip() for name in (self.plan.day, self.plan.time) if name is not None
        )

    def _stamps(self, columns):
        """Take the time out of columns of texts and return it, or None where it is a column of numbers or
        none.
        """
        if not self.is_text:
            return None
        stamps = columns.pop(self.plan.time)
        return stamps if self.plan.day is None else with_day(columns.pop(self.plan.day), stamps)

    def _few(self, lines):
        """Return what `_many` returns, of a few lines that are plain, sooner than pyarrow gets going; None
        where it must look at them.
        """
        import pyarrow as pa

        if self.plan.texts:
            return None
        rows = []
        for line in lines:
            cells = line.decode(self.layout.encoding, "replace").split(self.layout.delimiter)
            if len(cells) != len(self.layout.names) or b'"' in line:
                return None
            rows.append([cells[i] for i in self.index.values()])
        columns, texts = {}, {}
        for name, cells in zip(self.index, zip(*rows, strict=True), strict=True):
            if name in (self.plan.time, self.plan.day) and self.is_text:
                texts[name] = pa.array([None if c in MISSING_CELLS else c for c in cells], pa.string())
                continue
            if self.layout.decimal == ",":
                cells = [c.replace(",", ".") for c in cells]
            if not all(PLAIN.fullmatch(c) or c in MISSING_CELLS for c in cells):
                return None
            columns[name] = np.array([np.nan if c in MISSING_CELLS else float(c) for c in cells])
        return columns, self._stamps(texts)

    def _many(self, lines):
        """Return ({column: (N,) numbers or texts}, the time as a pyarrow array of texts or None)."""
        import pyarrow as pa
        import pyarrow.csv as pc

        body = b"\n".join(lines) + b"\n"
        for convert in self.converting:
            try:
                table = pc.read_csv(pa.BufferReader(body), self.reading, self.parsing, convert)
                break
            except pa.ArrowInvalid:
                continue
        else:
            raise ValueError("cannot be read")
        if table.num_rows != len(lines) or self.layout.is_open(lines[-1]):
            raise ValueError(UNCLOSED)
        found = {name: table[f"f{i}"].combine_chunks() for name, i in self.index.items()}
        stamps = self._stamps(found)
        columns = {name: from_arrow(x) for name, x in found.items() if name not in self.plan.texts}
        return columns | {name: np.array(found[name].to_pylist(), object) for name in self.plan.texts}, stamps
