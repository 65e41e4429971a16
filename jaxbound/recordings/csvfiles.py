"""CSV files as recordings: a million rows are parsed column by column, only the columns that the model
names.
"""

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxbound.recordings.columns import from_arrow, valid
from jaxbound.recordings.counting import read_numbers
from jaxbound.recordings.csvtext import Layout, Planned, above_header, parse_columns, planned, sniff
from jaxbound.recordings.oddcells import OddCells, error_hints, no_number, refuse_odd, unsaid_hints
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import check_period, rows_apart, usual_period
from jaxbound.recordings.selection import NO_TIME, STAMPS, TELLING, Wanted
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.source import Progress, Source, with_hints
from jaxbound.recordings.timestamps import parse_stamps, with_day
from jaxbound.text.progress import reporter

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["CsvFile"]


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
    try:
        plan = planned(layout, model)
    except ValueError as e:
        raise ValueError(f"{e}{above_header(layout)}") from None
    report(0.05)
    table, odd = parse_columns(layout, plan)
    report(0.7)
    count = len(table[plan.wanted.columns[0]])
    if count < 2:
        raise ValueError("the file has one row of data: a recording has at least two")
    _refuse_odd_times(layout, plan.wanted, odd)
    written = _written_times(layout, plan.wanted, table)
    columns = _columns_of(layout, plan, table, odd)
    times = _times_of(layout, plan, written, model, count)
    if plan.wanted.time is not None:  # an expression may compare it with a date
        columns.setdefault(plan.wanted.time, times.time if times.stamps is None else times.stamps)
    samples = plan.wanted.samples(columns, count, (times.time - times.time[0], times.stamps))
    hints = _about_cells(layout, plan.wanted, columns, odd, samples[2])
    recording = Recording.filed(model, samples, (times.time, times.stamps, written), path.name)
    dt = _period_of(layout, plan.wanted, model, times.time)
    report(0.9)
    hints = [*layout.hints, *filter(None, [times.hint]), *hints]
    return with_hints(model, replace(recording, dt=dt), layout.row, plan.wanted.condition, hints)


class _FileTimes(NamedTuple):
    """The times of all rows: in s; as datetime64 or None; a sentence for the owner or ""."""

    time: np.ndarray
    stamps: np.ndarray | None
    hint: str


def _written_times(layout: Layout, plan: Wanted, table: Mapping[str, "pa.Array"]) -> "pa.Array | None":
    """Return the times as they stand in the file, None where there are none; refuse a row without."""
    if plan.time is None:
        return None
    written = table[plan.time]
    if plan.day is not None:
        written = with_day(table[plan.day], written)
    if written.null_count:
        first = layout.row(int(np.argmin(valid(written))))
        raise ValueError(f"{first} has no time: every row needs one, {written.null_count} do not have it")
    return written


def _refuse_odd_times(layout: Layout, plan: Wanted, odd: Mapping[str, OddCells]) -> None:
    """Refuse a time that is no number where others are."""
    if plan.time is not None and plan.time in odd:
        cells = odd[plan.time]
        raise ValueError(no_number(layout.row(int(cells.rows[0])), plan.time, cells.words[0]))


def _about_cells(
    layout: Layout,
    plan: Wanted,
    columns: Mapping[str, np.ndarray],
    odd: Mapping[str, OddCells],
    excluded: np.ndarray | None,
) -> list[str]:
    """Return sentences on cells that hold no numbers; refuse those, and infinite ones, in rows that count."""
    condition: tuple[str, ...] = ()
    if plan.where is not None:
        condition = plan.where.read
    refuse_odd(odd, excluded, layout.row)
    for name in plan.numbers:
        if name in columns and columns[name].dtype.kind == "f":
            _refuse_infinite(layout, name, np.isinf(columns[name]), excluded)
    return [*error_hints(odd, excluded, layout.row), *unsaid_hints(odd, condition, layout.row)]


def _refuse_infinite(layout: Layout, name: str, infinite: np.ndarray, excluded: np.ndarray | None) -> None:
    """Refuse an infinite number in a row that counts."""
    if excluded is not None:
        infinite = infinite & ~excluded
    if infinite.any():
        first = layout.row(int(np.argmax(infinite)))
        wrong = "is infinite or too large for a number (leave a missing sample blank)"
        raise ValueError(f"{first} of column {name!r} {wrong}")


def _columns_of(
    layout: Layout, plan: Planned, table: Mapping[str, "pa.Array"], odd: Mapping[str, OddCells]
) -> dict[str, np.ndarray]:
    """Return {column: floats, or texts} of the columns that signals and the condition need."""
    columns: dict[str, np.ndarray] = {}
    for name in plan.wanted.numbers:
        if name not in (plan.wanted.time, plan.wanted.day) or not plan.is_text:
            columns[name] = from_arrow(table[name])
            _refuse_empty(layout, name, columns[name], odd)
    for name in plan.wanted.texts:
        columns[name] = np.array(table[name].to_pylist(), object)
    return columns


def _times_of(
    layout: Layout, plan: Planned, written: "pa.Array | None", model: SignalModel, count: int
) -> _FileTimes:
    """Return the times of all rows; refuse a file without any where the model has no dt."""
    name, dt = plan.wanted.time, model.dt
    if name is None:
        if not getattr(model, "regular", True):
            raise ValueError("the file has no time column, which means over intervals of a clock need")
        if dt is None:
            raise ValueError(f"the file has no time column: {NO_TIME}")
        return _FileTimes(np.arange(count) * dt, None, f"the file has no time column: {rows_apart(dt)}")
    if plan.is_text:
        return _FileTimes(*parse_stamps(written, dt, layout.row))
    seconds = from_arrow(written)
    _refuse_infinite(layout, name, np.isinf(seconds), None)
    return _FileTimes(*read_numbers(seconds, dt, name))


def _period_of(layout: Layout, plan: Wanted, model: SignalModel, time: np.ndarray) -> float | None:
    """Return the sampling period in s, None where there need not be one; refuse times that have another than
    the model's.
    """
    if not getattr(model, "regular", True):
        return None
    try:
        dt = usual_period(time) if model.dt is None else model.dt
        check_period(time, dt, getattr(model, "stated", "the model has"))
    except ValueError as e:
        for name in layout.names:
            if name not in (plan.time, plan.day) and layout.dated(name) in STAMPS:
                taken = f"the time is taken from column {plan.time!r}, another is {name!r}"
                raise ValueError(f"{e}; {taken}: say which it is, {TELLING}") from None
        raise
    return dt


def _refuse_empty(layout: Layout, name: str, x: np.ndarray, odd: Mapping[str, OddCells]) -> None:
    """Refuse a column without any number."""
    if np.isnan(x).all():
        refuse_odd({name: odd[name]} if name in odd else {}, None, layout.row)
        raise ValueError(f"column {name!r} holds no number at all: all {len(x)} cells are blank or NaN")
