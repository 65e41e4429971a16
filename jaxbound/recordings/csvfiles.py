"""CSV files as recordings: a million rows are parsed column by column, only the columns that the model
names.
"""

from os import PathLike
from pathlib import Path
from typing import IO

import numpy as np

from jaxbound.recordings.columns import Arrow, to_arrow, valid
from jaxbound.recordings.counting import read_numbers
from jaxbound.recordings.csvtext import Layout, above_header, sniff
from jaxbound.recordings.linetext import Cells, LineReader, Opened, refuse_infinite
from jaxbound.recordings.oddcells import error_hints, no_number, refuse_odd, thousands, unsaid_hints
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import period_of, rows_apart
from jaxbound.recordings.selection import NO_TIME, STAMPS, TELLING, Wanted
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.source import Progress, Source, with_hints
from jaxbound.recordings.thousands import all_grouped, in_doubt, may_be_grouped
from jaxbound.recordings.timestamps import parse_stamps
from jaxbound.text.progress import reporter


class CsvFile(Source):
    """A CSV file, or any file that no other kind of source takes."""

    as_recorded = True

    @classmethod
    def takes(cls, data: object) -> bool:
        """Return True for every path: what is no CSV file is refused in a sentence."""
        return isinstance(data, str | PathLike)

    def whole(self, progress: Progress | None = None) -> Recording:
        """Return the Recording of the file.

        Raises:
            ValueError: anything that is not a regular recording of this model: what, and in which row.
        """
        return _recording_of(Path(str(self.data)), self.model, reporter(progress))


def _recording_of(path: Path, model: SignalModel, report: Progress) -> Recording:
    layout = sniff(path)

    def opened() -> IO[bytes]:
        return open(path, "rb", buffering=0)

    try:
        reader = LineReader(layout, model)
    except ValueError as e:
        raise ValueError(f"{e}{above_header(layout)}") from None
    report(0.05)
    cells, plan = reader.read(opened), reader.plan
    _refuse_thousands(reader, opened, cells)
    report(0.7)
    if cells.rows < 2:
        raise ValueError("the file has one row of data: a recording has at least two")
    written = _written_times(layout, plan, cells)
    _refuse_empty(layout, plan, cells)
    time, stamps, hint = _times_of(layout, plan, written, cells, model)
    columns = dict(cells.columns)
    if plan.time is not None:  # an expression may compare it with a date
        columns.setdefault(plan.time, time if stamps is None else stamps)
    samples = plan.samples(columns, cells.rows, (time - time[0], stamps))
    reader.refuse(cells, samples[2], layout.row)
    condition = () if plan.where is None else plan.where.read
    hints = [*layout.hints, *plan.hints, *filter(None, [hint])]
    hints += error_hints(cells.odd, samples[2], layout.row)
    hints += unsaid_hints(cells.odd, condition, layout.row)
    dt = _period_of(layout, plan, model, time)
    recording = Recording.filed(model, samples, (time, stamps, written), path.name, dt)
    report(0.9)
    return with_hints(model, recording, layout.row, plan.condition, hints)


_FileTimes = tuple[np.ndarray, np.ndarray | None, str]
"""(time of all rows in s, as datetime64 or None, a sentence for the owner or "")."""


def _refuse_thousands(reader: LineReader, opened: Opened, cells: Cells) -> None:
    """Raise ValueError for a column whose decimal signs may be signs for thousands."""
    layout, doubted = reader.layout, []
    for name, values in cells.columns.items():
        if layout.delimiter == "," or not cells.decimal or name in reader.texts or name == reader.plan.time:
            continue  # cells that are parted by commas have decimal points
        if may_be_grouped(values):
            doubted.append(name)
    if not doubted:
        return
    texts = reader.written(opened)
    assert texts is not None, "it was read before"
    for name in doubted:
        is_other = cells.decimal == "." and layout.decimal == ","
        places = in_doubt(texts[name], cells.columns[name], cells.decimal, is_other)
        if places:
            found = [f"{texts[name][k].as_py().strip()} in {layout.row(k)}" for k in places]
            raise ValueError(thousands(name, found))
        like = all_grouped(texts[name])
        if like:
            decimals = f"column {name!r} is read as decimals, like {like}"
            layout.hints.append(f"{decimals}: if points are for thousands, write it without them")


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


def _times_of(
    layout: Layout, plan: Wanted, written: "Arrow | None", cells: Cells, model: SignalModel
) -> _FileTimes:
    """Return the times of all rows; refuse a file without any where the model has no dt."""
    dt = model.dt
    if plan.time is None:
        if not getattr(model, "regular", True):
            raise ValueError("the file has no time column, which means over intervals of a clock need")
        if dt is None:
            raise ValueError(f"the file has no time column: {NO_TIME}")
        return (np.arange(cells.rows) * dt, None, f"the file has no time column: {rows_apart(dt)}")
    if cells.times is not None:
        return parse_stamps(written, dt, layout.row)
    refuse_infinite(plan.time, cells.columns[plan.time], None, layout.row)
    return read_numbers(cells.columns[plan.time], dt, plan.time)


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
