"""CSV files as recordings: a million rows are parsed column by column, only the columns that the model
names.
"""

from collections.abc import Callable
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from jaxbound.recordings.columns import from_arrow, valid
from jaxbound.recordings.csvtext import above_header, is_number, parse_columns, sniff
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import check_period, usual_period
from jaxbound.recordings.selection import NO_TIME, STAMPS, TELLING, wanted
from jaxbound.recordings.source import Source, told
from jaxbound.recordings.timestamps import parse_stamps, read_numbers, with_day

__all__ = ["CsvFile"]


class CsvFile(Source):
    """A CSV file, or any file that no other kind of source takes."""

    @classmethod
    def takes(cls, data: object) -> bool:
        """Return True for every path: what is no CSV file is refused in a sentence."""
        return isinstance(data, str | PathLike)

    def whole(self, progress: Callable[[float], object] | None = None) -> Recording:
        """Return the Recording of the file.

        Raises:
            ValueError: anything that is not a regular recording of this model: what, and in which row.
        """
        return _read(Path(str(self.data)), self.model, progress or (lambda share: None))


def _read(path, model, report):
    layout = sniff(path)
    try:
        plan = wanted(layout.names, model, layout.dated)
    except ValueError as e:
        raise ValueError(f"{e}{above_header(layout)}") from None
    if (
        plan.time is None
        and layout.names[0] == ""
        and layout.first[0]
        and not is_number(layout.first[0], layout.decimal)
    ):
        plan = replace(plan, time="")  # an index of time stamps without a name
    report(0.05)
    index = {name: layout.names.index(name) for name in plan.columns}
    text_time = plan.time is not None and not is_number(layout.first[index[plan.time]], layout.decimal)
    table = parse_columns(
        layout, index, {*plan.texts, *([plan.time, plan.day] if text_time else [])}, plan.time is not None
    )
    report(0.7)
    count = len(table[plan.columns[0]])
    if count < 2:
        raise ValueError("the file has one row of data: a recording has at least two")
    hints = list(layout.hints)
    written = table[plan.time] if plan.time is not None else None
    if plan.day is not None:
        written = with_day(table[plan.day], written)
    if written is not None and written.null_count:
        first = layout.row(int(np.argmin(valid(written))))
        raise ValueError(f"{first} has no time: every row needs one, {written.null_count} do not have it")
    columns = {
        c: _values(layout, c, table[c])
        for c in plan.numbers
        if c not in (plan.time, plan.day) or not text_time
    }
    columns |= {c: np.array(table[c].to_pylist(), object) for c in plan.texts}
    if written is None:
        if model.dt is None:
            raise ValueError(f"the file has no time column: {NO_TIME}")
        time, stamps = np.arange(count) * model.dt, None
        hints.append(
            f"the file has no time column: the rows are taken to be dt = {model.dt:g} s apart, and none to "
            f"be missing"
        )
    elif text_time:
        time, stamps, hint = parse_stamps(written, model.dt, layout.row)
        hints += [hint] if hint else []
    else:
        time, stamps, hint = read_numbers(_values(layout, plan.time, written), model.dt)
        hints += [hint] if hint else []
    columns.setdefault(plan.time, time if stamps is None else stamps)
    u, y, excluded = plan.samples(columns, count)
    recording = Recording.filed(model, (u, y, excluded), (time, stamps, written), path.name)
    try:
        dt = usual_period(time) if model.dt is None else model.dt
        check_period(time, dt, getattr(model, "stated", "the model has"))
    except ValueError as e:
        others = [
            name
            for name in layout.names
            if name not in (plan.time, plan.day) and layout.dated(name) in STAMPS
        ]
        which = (
            f"; the time is taken from column {plan.time!r}, another is {others[0]!r}: say which it is, "
            f"{TELLING}"
            if others
            else ""
        )
        raise ValueError(f"{e}{which}") from None
    report(0.9)
    return told(
        model, replace(recording, dt=dt), layout.row, plan.where.text if plan.where else "", tuple(hints)
    )


def _values(layout, name, column):
    """Return a column as floats, NaN where a sample is missing; refuse infinity and a column without any
    number.
    """
    x = from_arrow(column)
    if np.isinf(x).any():
        k = int(np.argmax(np.isinf(x)))
        raise ValueError(
            f"{layout.row(k)} of column {name!r} is infinite or too large for a number (leave a missing "
            f"sample blank)"
        )
    if np.isnan(x).all():
        raise ValueError(f"column {name!r} holds no number at all: all {len(x)} cells are blank or NaN")
    return x
