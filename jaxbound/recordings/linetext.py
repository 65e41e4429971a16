"""Lines of CSV to columns, of a file or of a few lines that came through a pipe.

Columns are parsed by pyarrow, only those that are wanted. When that fails, or gives another number of rows
than there are lines, a second, slow pass finds the row and says what stands there.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from io import BytesIO
from itertools import islice
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxbound.recordings.columns import from_arrow
from jaxbound.recordings.csvlines import CountedLines, let_go, line_ends, lines_of
from jaxbound.recordings.csvtext import (
    BLANK,
    BLANK_CELLS,
    FURTHER,
    MISSING_CELLS,
    NUMBER,
    UNCLOSED,
    UNENDED,
    ZEROS,
    Head,
    Layout,
    is_number,
    layout_of,
)
from jaxbound.recordings.notations import Notation, notation_of
from jaxbound.recordings.oddcells import OddCells, no_number, refuse_odd
from jaxbound.recordings.recordingformat import RecordingFormat
from jaxbound.recordings.selection import wanted
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.thousands import is_grouped
from jaxbound.recordings.timestamps import DATES, parse_stamps, with_day

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.csv as pc

FEW = 8  # lines that are read one by one, sooner than pyarrow gets going
SINGULAR = {"are": "is", "have": "has", "hold": "holds", "repeat": "repeats"}
Opened = Callable[[], IO[bytes]]
"""Opens the bytes of the lines, from their beginning."""


class Cells(NamedTuple):
    """The wanted columns of some rows.

    Fields: columns: {name: (N,) floats, NaN where there is none, or texts, None where there is none}; times:
    the time as it is written, a pyarrow array of texts, or None where it is a column of numbers or none; odd:
    of columns of numbers, the cells that hold none; rows: N; decimal: the sign of all numbers, "" where some
    cells hold none.
    """

    columns: dict[str, np.ndarray]
    times: "pa.Array | None"
    odd: dict[str, OddCells]
    rows: int
    decimal: str = ""

    @property
    def repeated(self) -> np.ndarray:
        """(N - 1,) bool: whether each row but the first holds the numbers and texts of the row before it."""
        same = np.ones(max(self.rows - 1, 0), bool)
        for x in self.columns.values():
            missing = x != x  # NaN; a text is what it is
            same &= (x[1:] == x[:-1]) | (missing[1:] & missing[:-1])
        return same

    def kept(self, rows: np.ndarray) -> "Cells":
        """Return the cells of some rows, (N,) bool."""
        import pyarrow as pa

        places = np.cumsum(rows) - 1
        odd = {}
        for name, words in self.odd.items():
            left = words.at(rows[words.rows])
            odd[name] = OddCells(places[left.rows], left.words)
        columns = {name: x[rows] for name, x in self.columns.items()}
        times = self.times
        if times is not None:
            times = times.filter(pa.array(rows))
        return Cells(columns, times, odd, int(rows.sum()), self.decimal)


class LineReader:
    """Reads lines of one layout.

    Args:
        layout: of the text; its .blank and .hints are filled. model: whose signals are wanted.

    Fields: layout; plan (`selection.Wanted`); index: {column: its number}; texts: columns that are not read
    as numbers; is_text: the time is written as text; notations: of columns whose numbers are written in
    another way than those of the file; left: {reason: numbers of lines that are no rows for it}.

    Raises:
        ValueError: see `selection.wanted`.
    """

    def __init__(self, layout: Layout, model: SignalModel) -> None:
        self.layout, names, first = layout, layout.names, layout.first[0]
        self.plan = wanted(names, model, layout.dated)
        if self.plan.time is None and names[0] == "" and first and not is_number(first, layout.decimal):
            self.plan = replace(self.plan, time="")  # an index of time stamps without a name, as of pandas
        self.index = {name: names.index(name) for name in self.plan.columns}
        self.texts, time = {*self.plan.texts}, self.plan.time
        self.notations: dict[str, Notation] = {}
        self.plain: set[str] = set()  # columns of a stream in which usual numbers came
        self.unsigned: set[str] = set()  # those of a stream whose notation no cell has shown yet
        self.signs: dict[str, str] = {}  # of columns of a stream, the decimal sign that came first
        self.sure: set[str] = set()  # those of which it cannot be for thousands
        self.left: dict[str, list[int]] = {}
        self.sign = ""  # of most numbers, where some cells hold none
        self.is_text = time is not None and (
            layout.how.time_format not in ("", *DATES)
            or not is_number(layout.first[self.index[time]], layout.decimal)
        )
        if self.is_text:
            self.texts |= {name for name in (time, self.plan.day) if name is not None}

    def read(self, opened: Opened) -> Cells:
        """Return the cells of all rows, a column whose cells all are written in another way in that one.

        Raises:
            ValueError: a row that cannot be read, or is not what pyarrow took for one: which, and why.
        """
        cells = self._read(opened)
        noted = []
        for name, odd in cells.odd.items():
            if name != self.plan.time and odd.among(None, errors=False).words:
                noted.append(name)
        if noted:
            texts = self.written(opened)
            assert texts is not None, "it was read before"
            for name in noted:
                self._note(name, texts[name], cells)
        return cells

    def _read(self, opened: Opened) -> Cells:
        """Return the cells of all rows, in the notation of the file."""
        signs = self.layout.decimals
        if self.signs:  # those of a stream
            signs = tuple(sorted(signs, key=[*self.signs.values(), *signs].index))
        for decimal in signs:
            # the first rows may be whole numbers, which do not show the decimal sign of those below
            table = self._table(opened, decimal)
            if table is not None:
                return self._without_missing(self._cells(table, {}, decimal))
        texts = self.written(opened)
        if texts is None:
            raise ValueError(self.trouble_in(opened))
        readings = [self._numbers_among(texts, sign) for sign in self.layout.decimals]
        counts = [sum(len(odd.rows) for odd in cells.odd.values()) for cells in readings]
        best = counts.index(min(counts))
        self.sign = self.layout.decimals[best]
        return self._without_missing(readings[best])

    def _note(self, name: str, texts: "pa.Array", cells: Cells) -> None:
        """Read a column in the notation that all its cells have, if there is one, and say so."""
        import pyarrow as pa
        import pyarrow.compute as pc

        trimmed = pc.utf8_trim_whitespace(texts)
        missing = pc.is_in(trimmed, pa.array([*MISSING_CELLS, *self.layout.how.missing]))
        known = pc.if_else(missing, pa.scalar(None, pa.string()), trimmed)
        notation = notation_of(pc.drop_null(known), self.layout.decimals, self.layout.how)
        if notation is None:
            return
        errors = cells.odd.pop(name).among(None, errors=True)
        if errors.words:
            cells.odd[name] = errors
        cells.columns[name] = notation.numbers(known)[0]
        self.notations[name] = notation
        self.layout.hints.append(
            f"column {name!r} is read as written, like {pc.drop_null(known)[0]}: {notation.words}"
        )

    def _without_missing(self, cells: Cells) -> Cells:
        """Return cells without the words that are stated to stand for missing samples."""
        odd = {}
        for name, words in cells.odd.items():
            others = words.without(self.layout.how.missing)
            if others.words:
                odd[name] = others
        return cells._replace(odd=odd)

    def aside(self, line: bytes) -> str:
        """Return the reason for which a line below the header is no row, "" where it may be one.

        Where no column tells the time nothing would say that samples are missing there, and each is a row.
        """
        layout, how = self.layout, self.layout.how
        text = layout.text(line)
        if how.comment and text.startswith(how.comment):
            return "are a comment"
        if ZEROS in line and self.plan.time is not None:
            return "hold zero bytes, as a power cut leaves them"
        if self.plan.time is None or len(layout.names) == 1 or layout.is_blank(line):
            return ""
        if text.strip() in layout.above:
            return "repeat what stands above the samples"
        if not text.strip(layout.delimiter + ' "'):
            return "hold no cell"
        cells = layout.cells(line)
        for name in (self.plan.day, self.plan.time):
            is_whole = name is not None and len(cells) == len(layout.names)
            if is_whole and cells[self.index[str(name)]].strip() in BLANK_CELLS:
                return "hold no time"
        return ""

    def sifted(self, opened: Opened) -> bytes | None:
        """Return all lines, without what stands in those that are no rows; None where there are none.

        The last lines may be a summary: those behind the last one that is a row.
        """
        skipped = {*self.layout.how.skip}
        with opened() as file:
            *lines, tail = line_ends(file.read())
        rows, left = [], self.left
        for number in range(self.layout.skip, len(lines)):
            line = lines[number]
            reason = self.aside(line)
            if number + 1 in skipped:
                reason = "are left out as stated"
            if reason:
                left.setdefault(reason, []).append(number + 1)
            elif not self.layout.is_blank(line):
                rows.append(number + 1)
        footer = self._footer(lines, rows)
        if footer:
            left["hold no sample, behind the last"] = footer
        untimed = left.get("hold no time", ())
        if not left or 2 * len(untimed) > len(rows) + len(untimed):
            return None
        for numbers in left.values():
            for number in numbers:
                lines[number - 1] = b""
        return b"\n".join([*lines, tail])

    def _footer(self, lines: Sequence[bytes], rows: Sequence[int]) -> list[int]:
        """Return the numbers of lines, behind all rows, that hold no sample; [] where there are many."""
        behind: list[int] = []
        for number in reversed(rows):
            if self._is_sample(lines[number - 1]):
                return behind[::-1]
            behind.append(number)
            if len(behind) > FURTHER:
                break
        return []

    def _is_sample(self, line: bytes) -> bool:
        """Return whether a line has as many cells as the header, and a time like the first one's."""
        import pyarrow as pa

        layout, cells = self.layout, self.layout.cells(line)
        if len(cells) != len(layout.names) or layout.is_open(line):
            return len(cells) == len(layout.names)
        if self.plan.time is None:
            return not self.trouble(line)
        at = self.index[self.plan.time]
        if not self.is_text:
            return is_number(cells[at], layout.decimal)
        try:
            parse_stamps(pa.array([layout.first[at], cells[at]]), 1.0, str, layout.how)
        except ValueError:
            return False
        return True

    @property
    def time_name(self) -> str:
        """The name of the column of times, behind which the unit stands that is stated."""
        unit = self.layout.how.time_unit
        if not unit:
            return str(self.plan.time)
        return f"{self.plan.time} [{unit}]"

    @property
    def left_hints(self) -> list[str]:
        """The sentences on lines that are no rows."""
        hints = []
        for reason, numbers in self.left.items():
            if len(numbers) == 1:
                hints.append(f"row {numbers[0]} {of_one(reason)}: left out")
            else:
                hints.append(f"{len(numbers)} rows {reason}, the first is row {numbers[0]}: left out")
        return hints

    def written(self, opened: Opened) -> "dict[str, pa.Array] | None":
        """Return all columns as the texts that stand there; None where some row cannot be read."""
        return self._table(opened, None)

    def read_few(self, lines: Sequence[bytes]) -> Cells:
        """Return the cells of a few lines without their ends, as `read` does.

        Raises:
            ValueError: a line that is no row.
        """
        if len(lines) > FEW and not self.notations:
            cells = self._read(lambda: BytesIO(b"\n".join(lines) + b"\n"))
            if not cells.decimal:  # a few lines at a time have a sign each, however a stream is cut
                raise ValueError("some cells hold no numbers")
            for name, x in cells.columns.items():
                if x.dtype != object and not np.isnan(x).all():
                    self.plain.add(name)
                    is_known = name in self.sure and self.signs[name] == cells.decimal
                    if name != self.plan.time and not is_known:
                        self._show_signs(name, x, lines, cells.decimal)
            return cells
        rows: list[list[str]] = []
        for line in lines:
            row = self.row_of(line)
            if len(row) != len(self.layout.names) or self.layout.is_open(line):
                raise ValueError(self.trouble(line))
            rows.append(row)
        return self._without_missing(self._plain_cells(rows))

    def row_of(self, line: bytes) -> list[str]:
        """Return the cells of a line: `layout.cells`, sooner."""
        if b'"' in line:
            return self.layout.cells(line)
        return self.layout.text(line).split(self.layout.delimiter)

    def _show_signs(self, name: str, x: np.ndarray, lines: Sequence[bytes], sign: str) -> None:
        """Note the decimal sign that the cells of a column of numbers, (N,), show in some lines.

        Raises:
            ValueError: the column has shown another one before.
        """
        rows: list[int] = np.flatnonzero(x % 1 != 0)[:FEW].tolist()
        if len(self.layout.decimals) > 1:  # else a sign behind whole numbers is no other
            rows += [k for k, line in enumerate(lines) if may_end_in_zeros(line)]
        for k in rows:
            if not self._shows_sign(name, self.row_of(lines[k])[self.index[name]], sign):
                raise ValueError("other decimal signs came before")
            if name in self.sure and self.signs[name] == sign:
                break

    def _shows_sign(self, name: str, cell: str, sign: str) -> bool:
        """Note the decimal sign that a cell shows; return whether it is the first one of its column.

        A cell like 1.002 shows it as long as no other tells that its sign is for thousands.
        """
        if sign not in cell:
            return True
        is_first = self.signs.setdefault(name, sign) == sign
        if is_first and not is_grouped(cell.strip()):
            self.sure.add(name)
        return is_first

    def trouble(self, line: bytes) -> str:
        """Return the trouble with a line, as far as its cells show; or ""."""
        trouble, cells = self._trouble_of_form(line), self.layout.cells(line)
        if trouble:
            return trouble
        for name, i in self.index.items():
            cell = cells[i].strip()
            is_read = name in self.texts or cell in MISSING_CELLS or is_number(cell, self.layout.decimal)
            if not is_read:
                return no_number("", name, cell).strip()
        return ""

    def _trouble_of_form(self, line: bytes) -> str:
        """Return why a line is no row, whatever its cells hold; or ""."""
        if self.layout.is_open(line):
            return UNCLOSED
        if self.layout.is_blank(line):
            return BLANK
        cells, names = self.layout.cells(line), self.layout.names
        if len(cells) != len(names):
            return f"has {len(cells)} cells, the header has {len(names)} columns"
        return ""

    def refuse(self, cells: Cells, excluded: np.ndarray | None, row: Callable[[int], str]) -> None:
        """Raise ValueError if a cell holds no number, or an infinite one, in a row that `where` does not
        leave out.
        """
        refuse_odd(cells.odd, excluded, row)
        for name in self.plan.numbers:
            if name in cells.columns:
                refuse_infinite(name, cells.columns[name], excluded, row)

    def _plain_cells(self, rows: Sequence[Sequence[str]]) -> Cells:
        """Return the cells of rows, the numbers of each by the decimal sign that leaves least of it over."""
        import pyarrow as pa

        columns: dict[str, np.ndarray] = {}
        times: dict[str, pa.Array] = {}
        odd: dict[str, OddCells] = {}
        read = list(map(self._numbers_in, rows))
        for name, i in self.index.items():
            written = [None if row[i] in BLANK_CELLS else row[i] for row in rows]
            if name in self.plan.texts:
                columns[name] = np.array(written, object)
            elif name in self.texts:
                times[name] = pa.array([None if x in MISSING_CELLS else x for x in written], pa.string())
            else:
                numbers = [row[name] for row in read]
                columns[name] = np.array([np.nan if x is None else x for x in numbers])
                bad = [k for k, x in enumerate(numbers) if x is None]
                if bad:
                    odd[name] = OddCells(np.array(bad), [rows[k][i].strip() for k in bad])
        return Cells(columns, self.joined_time(times), odd, len(rows))

    def _numbers_in(self, row: Sequence[str]) -> dict[str, float | None]:
        """Return {column: its number in a row, NaN of a blank cell, None where it holds none}."""
        best: dict[str, float | None] = {}
        fewest, best_sign = math.inf, ""
        for sign in self.layout.decimals:
            numbers = {n: _number(row[i], sign) for n, i in self.index.items() if n not in self.texts}
            count = list(numbers.values()).count(None)
            if count < fewest:
                best, fewest, best_sign = numbers, count, sign
            if not count:
                break
        for name, number in best.items():
            cell = row[self.index[name]].strip()
            is_known = number is not None and np.isnan(number)
            if name == self.plan.time or is_known:
                continue
            shows = number is not None and name not in self.notations
            if shows and not self._shows_sign(name, cell, best_sign):
                number = None  # 1.002 and 998,5: one of them may have a sign for thousands
            if number is None or name in self.notations:
                best[name] = self._noted_number(name, cell)
            else:
                self.plain.add(name)
        return best

    def memory(self) -> dict[str, Any]:
        """Return the notations of a stream as JSON holds them."""
        noted = {name: asdict(notation) for name, notation in self.notations.items()}
        return {
            "notations": noted,
            "plain": sorted(self.plain),
            "unsigned": sorted(self.unsigned),
            "signs": self.signs,
            "sure": sorted(self.sure),
        }

    def resume(self, memory: Mapping[str, Any]) -> None:
        """Go on with the notations of a stream. memory: of another reader; {}: there is none."""
        self.plain, self.unsigned = {*memory.get("plain", ())}, {*memory.get("unsigned", ())}
        self.signs, self.sure = dict(memory.get("signs", {})), {*memory.get("sure", ())}
        for name, fields in memory.get("notations", {}).items():
            self.notations[name] = Notation(**fields | {k: tuple(fields[k]) for k in ("on", "off")})

    def _noted_number(self, name: str, cell: str) -> float | None:
        """Return the number of a cell in the notation of its column, which the first such cells show."""
        import pyarrow as pa

        notation = self.notations.get(name)
        is_open = (notation is None and name not in self.plain) or name in self.unsigned
        if is_open and cell not in self.layout.how.missing:
            shown = notation_of(pa.array([cell]), self.layout.decimals, self.layout.how)
            if shown is None or (notation is not None and shown.unit != notation.unit):
                return None
            self.notations[name] = notation = shown
            self.unsigned.add(name)
            if shown.shows_signs(cell):
                self.unsigned.remove(name)
        elif notation is None:
            notation = self._grouped(name, cell)
        if notation is None:
            return None
        return notation.number(cell)

    def _grouped(self, name: str, cell: str) -> Notation | None:
        """Return the notation with signs for thousands that a cell shows first, behind usual numbers that
        have shown their decimal sign, or where that is stated; None where it shows none.
        """
        import pyarrow as pa

        sign, how = "", self.layout.how
        if how.decimal or how.thousands:
            sign = self.layout.decimals[0]
        elif name in self.sure:
            sign = self.signs[name]
        else:
            return None
        shown = notation_of(pa.array([cell]), (sign,), replace(how, decimal=sign))
        if shown is None or shown.unit or not shown.thousands:
            return None
        self.notations[name] = shown
        return shown

    def _table(self, opened: Opened, decimal: str | None) -> "dict[str, pa.Array] | None":
        """Return the wanted columns; None where some row or cell cannot be read. decimal: of numbers; None:
        all are read as texts.
        """
        import pyarrow as pa
        import pyarrow.csv as pc

        # those in the file may stand twice
        names = [f"f{i}" for i in range(len(self.layout.names))]
        # a block has to hold a whole line, and a line of thousands of columns is longer than a megabyte
        size = max(1 << 20, 64 * len(names), 16 * sum(map(len, self.layout.names)))
        read = pc.ReadOptions(
            column_names=names, skip_rows=self.layout.skip, encoding=self.layout.encoding, block_size=size
        )
        with opened() as file:
            lines, parsing = CountedLines(file, self.layout.delimiter), self._parsing()
            with let_go(lines):
                try:
                    table = pc.read_csv(lines, read, parsing, self._converting(decimal))
                except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeError):
                    table = None
        if lines.unended and (table is not None or lines.lines <= self.layout.skip):
            self._note_unended(lines.lines + 1)
        if table is None:
            return None
        self._refuse_lost_rows(opened, lines, table.num_rows)
        return {name: table[f"f{i}"].combine_chunks() for name, i in self.index.items()}

    def _parsing(self) -> "pc.ParseOptions":
        """Return the options by which lines are taken apart: a blank one is no row; where there is one column
        it is a missing sample.
        """
        import pyarrow.csv as pc

        def of_wrong_length(row: "pc.InvalidRow") -> str:
            if self.layout.is_blank(row.text.encode()):
                return "skip"
            return "error"

        return pc.ParseOptions(
            delimiter=self.layout.delimiter,
            newlines_in_values=False,
            ignore_empty_lines=len(self.layout.names) > 1,
            invalid_row_handler=of_wrong_length,
        )

    def _converting(self, decimal: str | None) -> "pc.ConvertOptions":
        """Return the options by which cells are read, see `_table`."""
        import pyarrow as pa
        import pyarrow.csv as pc

        kinds = dict.fromkeys([f"f{i}" for i in self.index.values()], pa.string())
        if decimal is not None:
            kinds |= {f"f{i}": pa.float64() for name, i in self.index.items() if name not in self.texts}
        return pc.ConvertOptions(
            include_columns=list(kinds),
            decimal_point=decimal or ".",
            null_values=list(BLANK_CELLS),
            strings_can_be_null=True,
            column_types=kinds,
        )

    def _cells(self, table: "Mapping[str, pa.Array]", odd: dict[str, OddCells], decimal: str = "") -> Cells:
        """Return the cells of columns of numbers and of texts."""
        columns: dict[str, np.ndarray] = {}
        for name in self.index:
            if name in self.plan.texts:
                columns[name] = np.array(table[name].to_pylist(), object)
            elif name not in self.texts:
                columns[name] = from_arrow(table[name])
        return Cells(columns, self.joined_time(table), odd, len(next(iter(table.values()))), decimal)

    def joined_time(self, texts: "Mapping[str, pa.Array]") -> "pa.Array | None":
        """Return the time of columns of texts; None where it is a column of numbers or none."""
        if not self.is_text:
            return None
        assert self.plan.time is not None, "it is a column"
        if self.plan.day is None:
            return texts[self.plan.time]
        return with_day(texts[self.plan.day], texts[self.plan.time])

    def _numbers_among(self, texts: "Mapping[str, pa.Array]", decimal: str) -> Cells:
        """Return the cells of columns of texts, as numbers with this decimal sign."""
        columns, odd = dict(texts), {}
        for name in texts:
            if name not in self.texts:
                columns[name], cells = _numbers_of(texts[name], decimal)
                if len(cells.rows):
                    odd[name] = cells
        return self._cells(columns, odd)

    def _note_unended(self, number: int) -> None:
        """Say once that the last line has no end; refuse a file without any row before it."""
        if number <= self.layout.skip + 1:
            raise ValueError(f"row {number}, the only one, {UNENDED}")
        note = f"row {number}, the last, {UNENDED}"
        if note not in self.layout.hints:
            self.layout.hints.append(note)

    def _refuse_lost_rows(self, opened: Opened, counted: CountedLines, rows: int) -> None:
        """Raise ValueError unless every line below the header is a row that was read; note those that are
        blank.
        """
        layout, last, blank = self.layout, counted.last, self.layout.blank
        if len(layout.names) == 1:  # a blank line is a row there
            last = counted.lines
        # pyarrow counts rows, CountedLines lines: they differ where a quotation mark took line ends in
        if rows == last - layout.skip and not counted.open_end:
            return
        blank.clear()
        for number, line in self._numbered(opened):
            if number > last:
                break
            if layout.is_open(line):
                raise ValueError(f"row {number} {UNCLOSED}")
            if layout.is_blank(line):
                blank.append(number)
        lines = last - layout.skip - len(blank)
        if rows != lines:
            remedy = "write the file again without quotation marks"
            raise ValueError(f"of {lines} rows {rows} can be read: {remedy}")
        between = [number for i, number in enumerate(blank) if number > layout.skip + 1 + i]
        if between and self.plan.time is None:
            raise ValueError(f"row {between[0]} {BLANK}")

    def trouble_in(self, opened: Opened) -> str:
        """Return a sentence on the first line that is no row."""
        for number, line in self._numbered(opened):
            trouble = self._trouble_of_form(line)
            if trouble and trouble != BLANK:
                return f"row {number} {trouble}"
        return "the file cannot be read"

    def _numbered(self, opened: Opened) -> Iterator[tuple[int, bytes]]:
        """Yield the lines below the header, each behind its number."""
        with opened() as file:
            yield from islice(enumerate(lines_of(file), 1), self.layout.skip, None)


def of_one(reason: str) -> str:
    """Return the reason for which lines are no rows, said of a single one."""
    verb, _, rest = reason.partition(" ")
    return f"{SINGULAR[verb]} {rest}"


def reader_of(head: Head, model: SignalModel, how: RecordingFormat) -> LineReader:
    """Return the reader of lines that begin so: the row in which the names of a model stand is the header.

    Raises:
        ValueError: no row of the first ones is; see `layout_of` and `selection.wanted`.
    """
    try:
        return LineReader(layout_of(head, how), model)
    except ValueError:
        if how.header is not None:
            raise
        for number, line in enumerate(head.lines[:FURTHER], 1):
            if not line.strip():
                continue
            try:
                reader = LineReader(layout_of(head, how, number), model)
            except ValueError:
                continue
            above = len(list(filter(str.strip, head.lines[: number - 1])))
            rows = f"{above} row{'s' * (above != 1)}"
            if above:
                reader.layout.hints.append(
                    f"row {number} holds the names of the columns: {rows} above it left out"
                )
            return reader
        raise


def may_end_in_zeros(line: bytes) -> bool:
    """Return whether a whole number may stand in a line with zeros behind a sign: else it has no sign."""
    return b".0" in line or b",0" in line


def refuse_infinite(name: str, x: np.ndarray, excluded: np.ndarray | None, row: Callable[[int], str]) -> None:
    """Raise ValueError for an infinite number in a row that is not left out."""
    infinite = np.isinf(x)
    if excluded is not None:
        infinite &= ~excluded
    if infinite.any():
        wrong = "is infinite or too large for a number (leave a missing sample blank)"
        raise ValueError(f"{row(int(np.argmax(infinite)))} of column {name!r} {wrong}")


def _number(cell: str, decimal: str) -> float | None:
    """Return the number in a cell, NaN of a blank one; None where it holds none."""
    if cell in BLANK_CELLS:
        return np.nan
    text = cell.strip()
    if decimal != ".":  # a point stands in no number then
        text = text.replace(".", "#").replace(decimal, ".")
    if NUMBER.fullmatch(text) is None:
        return None
    return float(text)


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
