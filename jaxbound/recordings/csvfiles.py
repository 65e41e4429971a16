"""CSV files as recordings: a million rows are parsed column by column, only the columns that the model
names.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from io import BytesIO, FileIO
from itertools import chain, islice
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from jaxbound.recordings.columns import Arrow, to_arrow, valid
from jaxbound.recordings.counting import read_numbers
from jaxbound.recordings.csvlines import lines_of
from jaxbound.recordings.csvtext import (
    ENOUGH,
    FURTHER,
    MISSING_CELLS,
    READ_AS,
    Head,
    Layout,
    above_header,
    cells_of,
    head_of,
    is_value,
    layout_of,
    wide_encoding,
)
from jaxbound.recordings.hold import DEADBAND, INPUTS, grid_of, held
from jaxbound.recordings.linetext import Cells, LineReader, Opened, reader_of, refuse_infinite
from jaxbound.recordings.longformat import pivoted
from jaxbound.recordings.oddcells import error_hints, no_number, refuse_odd, thousands, unsaid_hints
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.recordingformat import RecordingFormat, format_of
from jaxbound.recordings.seams import may_turn_back, period_of, rows_apart
from jaxbound.recordings.selection import NO_TIME, STAMPS, TELLING, Column, Wanted
from jaxbound.recordings.signals import SignalModel, Signals
from jaxbound.recordings.source import NUMBER, TEXT, WORDS, Outline, Progress, Source, with_hints
from jaxbound.recordings.suspects import least_change
from jaxbound.recordings.thousands import all_grouped, in_doubt, may_be_grouped
from jaxbound.recordings.timestamps import NO_CLOCK, order_of, parse_stamps, without_clock
from jaxbound.text.progress import reporter

SIGNS = {".": "points", ",": "commas"}
SHOWN = 200  # lines whose cells show whether a column holds numbers


def _likely_layout(head: Head, how: RecordingFormat) -> Layout:
    """Return the layout by the first row that has as many cells as most of those behind it, where nobody asks
    for columns yet.
    """
    for number in range(1, min(FURTHER, len(head.lines))):
        try:
            layout = layout_of(head, how, how.header or number)
        except ValueError:
            continue
        widths = [len(cells_of(line, layout.delimiter)) for line in head.lines[layout.skip :][:FURTHER]]
        if 2 * widths.count(len(layout.names)) > len(widths) and len(layout.names) > 1:
            return layout
    return layout_of(head, how)


def how_written(layout: Layout) -> str:
    """Return how a file is written, in words."""
    encoding = {"utf-8": "UTF-8", "cp1252": "Windows-1252"}.get(layout.encoding, layout.encoding)
    parted = {"\t": "tabs"}.get(layout.delimiter, repr(layout.delimiter))
    sign = {",": ", decimal comma"}.get(layout.decimal, "")
    return f"{encoding}, cells between {parted}{sign}, names in row {layout.header}"


class CsvFile(Source):
    """A CSV file, or any file that no other kind of source takes."""

    as_recorded = True

    @classmethod
    def takes(cls, data: object) -> bool:
        """Return True for every path: what is no CSV file is refused in a sentence."""
        return isinstance(data, str | PathLike)

    @classmethod
    def outline(cls, data: object, how: RecordingFormat) -> Outline:
        """Return how the file is written: its columns by their first cells."""
        opened, head, how = _wide(Path(str(data)), Signals((), (), {}), how)
        layout = _likely_layout(head, how)
        with opened() as file:
            lines = list(islice(lines_of(file), layout.skip, layout.skip + SHOWN))
        rows = list(filter(any, map(layout.cells, lines)))
        kinds: dict[str, str] = {}
        for i, name in enumerate(layout.names):
            cells = {*chain.from_iterable(row[i : i + 1] for row in rows)} - {*MISSING_CELLS}
            kinds[name] = layout.dated(name) or NUMBER
            is_value_here = partial(is_value, decimal=layout.decimal, how=how)
            if kinds[name] == NUMBER and cells and not any(map(is_value_here, cells)):
                kinds[name] = WORDS
                if len(cells) > 2:
                    kinds[name] = TEXT
        taken = {"header": layout.header, "delimiter": layout.delimiter, "decimal": layout.decimal}
        return Outline(how_written(layout), kinds, taken | {"encoding": layout.encoding})

    def whole(self, progress: Progress | None = None) -> Recording:
        """Return the Recording of the file.

        Raises:
            ValueError: anything that is not a regular recording of this model: what, and in which row.
        """
        return _recording_of(Path(str(self.data)), self.model, reporter(progress))


def _recording_of(path: Path, model: SignalModel, report: Progress) -> Recording:
    opened, head, how = _wide(path, model, format_of(model))
    try:
        reader = reader_of(head, model, how)
    except ValueError as e:
        raise ValueError(f"{e}{_header_hint(head, how)}") from None
    report(0.05)
    if not how.skip and not how.comment:
        try:
            return _read(reader, opened, path, model, report)
        except ValueError:
            sifted = reader.sifted(opened)
            if sifted is None:
                raise
    else:
        sifted = reader.sifted(opened)
    again = reader_of(head, model, how)
    again.left = reader.left
    if sifted is not None:
        opened = partial(BytesIO, sifted)
    return _read(again, opened, path, model, report)


def _opened(path: Path, how: RecordingFormat) -> tuple[Opened, Head]:
    """Return (opener of the bytes of a file, its first lines); of text in two bytes a letter the same in
    UTF-8.
    """
    with open(path, "rb") as file:
        encoding = wide_encoding(file.read(2), how)
    if encoding:
        data = path.read_bytes().decode(encoding, "replace").removeprefix("\ufeff").encode()
        head = head_of(path, data[:ENOUGH])
        return partial(BytesIO, data), head._replace(hints=(READ_AS.format(encoding.upper()),))
    return partial(FileIO, path), head_of(path, None, how.encoding)


def _wide(path: Path, model: SignalModel, how: RecordingFormat) -> tuple[Opened, Head, RecordingFormat]:
    """Return (opener of the bytes of a file, its first lines, how they are written), with a column a tag."""
    opened, head = _opened(path, how)
    if not how.long:
        return opened, head, how
    data, hints = pivoted(opened, head, model, how)
    wide = head_of(path, data[:ENOUGH], "utf-8")._replace(hints=hints)
    return partial(BytesIO, data), wide, how.wide


def _header_hint(head: Head, how: RecordingFormat) -> str:
    """Return the end of a sentence on a column that is not there, see `above_header`."""
    try:
        return above_header(layout_of(head, how))
    except ValueError:
        return ""


def _read(reader: LineReader, opened: Opened, path: Path, model: SignalModel, report: Progress) -> Recording:
    """Return the Recording of lines all of which are rows."""
    layout, cells, plan = reader.layout, reader.read(opened), reader.plan
    _refuse_thousands(reader, opened, cells)
    report(0.7)
    if cells.rows < 2:
        raise ValueError("the file has one row of data: a recording has at least two")
    written = _written_times(layout, plan, cells)
    _refuse_empty(layout, plan, cells)
    time, stamps, hint = _times_of(reader, written, cells, model)
    is_shown = not hint  # the order of day and month
    for counting in (_rows_of_samples, _counting_rows):
        rows = counting(reader, opened, time, cells)
        if written is not None and not rows.all():
            cells, time, written = cells.kept(rows), time[rows], written.filter(to_arrow(rows))
            if stamps is not None:
                stamps = stamps[rows]
    if layout.how.hold and written is not None:
        reader.refuse(cells, None, layout.row)
        hint = " ".join(filter(None, [hint, *_deadband_hints(layout.how, model, plan, cells)]))
        cells, time, stamps, written = _held(reader, cells, time, stamps, model)
    columns = dict(cells.columns)
    if plan.time is not None:  # an expression may compare it with a date
        columns.setdefault(plan.time, time if stamps is None else stamps)
    samples = plan.samples(columns, cells.rows, (time - time[0], stamps))
    reader.refuse(cells, samples[2], layout.row)
    condition = () if plan.where is None else plan.where.read
    hints = [*layout.hints, *plan.hints, *filter(None, [hint]), *reader.left_hints]
    hints += [
        *error_hints(cells.odd, samples[2], layout.row),
        *unsaid_hints(cells.odd, condition, layout.row),
    ]
    dt = _period_of(layout, plan, model, time)
    recording = Recording.filed(model, samples, (time, stamps, written), path.name, dt)
    if not is_shown:
        written = None
    recording = replace(recording, taken=_taken(reader, cells, written, stamps))
    report(0.9)
    return with_hints(model, recording, layout.row, plan.condition, hints)


def _taken(
    reader: LineReader, cells: Cells, written: "Arrow | None", stamps: np.ndarray | None
) -> RecordingFormat:
    """Return the format by which a file was read, as far as another file of the plant may not show it."""
    how, sign = reader.layout.how, cells.decimal or reader.sign
    taken: dict[str, Any] = {}
    for notation in reader.notations.values():
        for name, value in notation.stated.items():
            if taken.setdefault(name, value) != value:
                return how  # columns have a notation each
    for name, x in cells.columns.items():
        is_plain = name not in reader.notations and name not in reader.texts and name != reader.plan.time
        if is_plain and taken.get("decimal", sign) != sign and (x != np.floor(x)).any():
            return how
    if written is not None and stamps is not None and cells.times is not None:
        taken["time_format"] = order_of(written, stamps)
    return RecordingFormat.of({k: x for k, x in taken.items() if x} | how.stated)


def _counting_rows(reader: LineReader, opened: Opened, time: np.ndarray, cells: Cells) -> np.ndarray:
    """Return (N,) bool: of rows of one time that which is stated to count, else all that do not repeat the
    row before; the others are noted.
    """
    layout = reader.layout
    is_same = np.diff(time) == 0
    rows = np.ones(len(time), bool)
    if not is_same.any():
        return rows
    if not layout.how.equal and may_turn_back(np.diff(time)):
        return rows
    reason = "have the time of another row"
    if layout.how.equal == "last":
        rows[:-1] = ~is_same
    else:
        rows[1:] = ~is_same
    if not layout.how.equal:
        rows[1:] |= ~cells.repeated
        rows |= ~_repeated(opened, layout, rows)
        reason = "repeat the row before"
    _leave_out(reader, reason, rows)
    return rows


def _rows_of_samples(reader: LineReader, opened: Opened, time: np.ndarray, cells: Cells) -> np.ndarray:
    """Return (N,) bool: the rows whose times have a clock where those of others have one; others are
    noted.
    """
    if cells.times is None or len(time) < 2:
        return np.ones(len(time), bool)
    rows = ~without_clock(cells.times, time, float(np.median(np.diff(time))))
    _leave_out(reader, NO_CLOCK, rows)
    return rows


def _leave_out(reader: LineReader, reason: str, rows: np.ndarray) -> None:
    """Note rows, those of (N,) bool that are False, as left out."""
    layout = reader.layout
    gone = [layout.number(int(k)) for k in np.flatnonzero(~rows)]
    if gone:
        reader.left[reason] = gone
        layout.blank[:] = sorted([*layout.blank, *gone])


def _repeated(opened: Opened, layout: Layout, rows: np.ndarray) -> np.ndarray:
    """Return (N,) bool: which of the rows that are False hold what the line before does, in all columns."""
    again = np.zeros(len(rows), bool)
    numbers = {layout.number(int(k)): int(k) for k in np.flatnonzero(~rows)}
    if not numbers:
        return again
    before = b""
    with opened() as file:
        for number, line in enumerate(lines_of(file), 1):
            if number in numbers:
                again[numbers[number]] = line == before
            if line.strip():
                before = line
    return again


def _held(
    reader: LineReader, cells: Cells, time: np.ndarray, stamps: np.ndarray | None, model: SignalModel
) -> tuple[Cells, np.ndarray, np.ndarray | None, Arrow]:
    """Return (cells, time, stamps, written) in which the last value stands for as long as is stated: at the
    times of the rows, or, where dt is known, dt apart.
    """
    if (np.diff(time) < 0).any():
        raise ValueError("rows that go back in time have no last value that could be held: sort them by time")
    grid = time
    if model.dt is not None and getattr(model, "regular", True):
        grid = grid_of(time, model.dt)
    columns = held(cells.columns, time, grid, reader.layout.how.hold)
    if stamps is not None:
        stamps = stamps[0] + np.round((grid - time[0]) * 1e9).astype("timedelta64[ns]")
    written = to_arrow(grid if stamps is None else stamps)
    return Cells(columns, None, {}, len(grid), cells.decimal), grid, stamps, written


def _deadband_hints(how: RecordingFormat, model: SignalModel, plan: Wanted, cells: Cells) -> Iterator[str]:
    """Yield sentences on the deadbands that are not stated, and those that inputs seem to be written by."""
    seen: dict[str, str] = {}
    for name, signal in zip((*model.inputs, *model.outputs), (*plan.inputs, *plan.outputs), strict=True):
        change = least_change(cells.columns[signal.name]) if isinstance(signal, Column) else 0.0
        if change:
            seen[name] = f"{name}:{change:.6g}"
    of_outputs = [seen[name] for name in model.outputs if name in seen]
    if not how.deadband:
        perhaps = f", as they changed perhaps {','.join(of_outputs)}" * bool(of_outputs)
        yield DEADBAND.format(hold=how.hold, seen=perhaps)
    if len(seen) > len(of_outputs):
        yield INPUTS.format(seen=",".join(seen[name] for name in model.inputs if name in seen))


_FileTimes = tuple[np.ndarray, np.ndarray | None, str]
"""(time of all rows in s, as datetime64 or None, a sentence for the owner or "")."""


def _refuse_thousands(reader: LineReader, opened: Opened, cells: Cells) -> None:
    """Raise ValueError for a column whose decimal signs may be signs for thousands."""
    layout, signs = reader.layout, _signs_of(reader, cells)
    if layout.how.decimal or layout.how.thousands:
        return
    if layout.delimiter == "," and "," not in signs.values():
        return  # cells that are parted by commas have decimal points
    doubted = [n for n in signs if n != reader.plan.time and may_be_grouped(cells.columns[n])]
    if not doubted:
        return
    shown = {}
    for name, sign in signs.items():
        values = cells.columns[name]
        if (values[np.isfinite(values)] % 1).any():
            shown[name] = sign
    texts = reader.written(opened)
    assert texts is not None, "it was read before"
    for name in doubted:
        column, sign, notation = texts[name], signs[name], reader.notations.get(name)
        if notation is not None:
            column = notation.without_unit(column)
        is_other = any(other != sign for other in shown.values()) or (sign == "." and layout.decimal == ",")
        places = in_doubt(column, cells.columns[name], sign, is_other)
        if places:
            found = [f"{texts[name][k].as_py().strip()} in {layout.row(k)}" for k in places]
            raise ValueError(thousands(name, found))
        like = all_grouped(column, sign)
        if like and (sign == "." or layout.delimiter == "\t"):
            decimals = f"column {name!r} is read as decimals, like {like}"
            layout.hints.append(f"{decimals}: if {SIGNS[sign]} are for thousands, write it without them")


def _signs_of(reader: LineReader, cells: Cells) -> dict[str, str]:
    """Return {column: the decimal sign by which it is read} of those with numbers that are not by
    thousands.
    """
    signs: dict[str, str] = {}
    for name in cells.columns:
        notation = reader.notations.get(name)
        if name in reader.texts or (notation is not None and (notation.thousands or notation.on)):
            continue
        signs[name] = cells.decimal or reader.sign
        if notation is not None:
            signs[name] = notation.decimal
    return signs


def _written_times(layout: Layout, plan: Wanted, cells: Cells) -> "Arrow | None":
    """Return the times as they stand in the file, None where there are none; refuse a row without."""
    if plan.time is None:
        return None
    if plan.time in cells.odd:
        odd = cells.odd[plan.time]
        raise ValueError(no_number(layout.row(int(odd.rows[0])), plan.time, odd.words[0]))
    written = cells.times
    if written is None:
        written = to_arrow(cells.columns[plan.time])
    if written.null_count:
        first = layout.row(int(np.argmin(valid(written))))
        raise ValueError(f"{first} has no time: every row needs one, {written.null_count} do not have it")
    return written


def _times_of(reader: LineReader, written: "Arrow | None", cells: Cells, model: SignalModel) -> _FileTimes:
    """Return the times of all rows; refuse a file without any where the model has no dt."""
    dt, layout, plan = model.dt, reader.layout, reader.plan
    if plan.time is None:
        if not getattr(model, "regular", True):
            raise ValueError("the file has no time column, which means over intervals of a clock need")
        if dt is None:
            raise ValueError(f"the file has no time column: {NO_TIME}")
        return (np.arange(cells.rows) * dt, None, f"the file has no time column: {rows_apart(dt)}")
    if cells.times is not None:
        return parse_stamps(written, dt, layout.row, layout.how)
    refuse_infinite(plan.time, cells.columns[plan.time], None, layout.row)
    return read_numbers(cells.columns[plan.time], dt, reader.time_name)


def _period_of(layout: Layout, plan: Wanted, model: SignalModel, time: np.ndarray) -> float | None:
    """Return the sampling period in s, None where there need not be one; refuse times that have another than
    the model's.
    """
    try:
        return period_of(time, model)
    except ValueError as e:
        for name in layout.names:
            if name not in (plan.time, plan.day) and layout.dated(name) in STAMPS:
                taken = f"the time is taken from column {plan.time!r}, another is {name!r}"
                raise ValueError(f"{e}; {taken}: say which it is, {TELLING}") from None
        raise


def _refuse_empty(layout: Layout, plan: Wanted, cells: Cells) -> None:
    """Refuse a column without any number."""
    for name in plan.numbers:
        if name in cells.columns and np.isnan(cells.columns[name]).all():
            refuse_odd({name: cells.odd[name]} if name in cells.odd else {}, None, layout.row)
            count = cells.rows
            raise ValueError(f"column {name!r} holds no number at all: all {count} cells are blank or NaN")
