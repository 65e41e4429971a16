"""Which columns of a recording a model needs, and how its signals come out of them: as they are, or by an
expression.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from jaxbound.recordings.expressions import (
    TIMES,
    Expression,
    expression,
    fails,
    find_column,
    is_expression,
    likely,
)
from jaxbound.recordings.signals import SignalModel
from jaxbound.text.names import listed

__all__ = ["NO_TIME", "STAMPS", "TELLING", "Wanted", "time_column", "wanted", "where_hints"]

STAMPS, DAYS = ("stamp", "day", "clock"), ("day", "digits")  # kinds of cells, see `stamp_kind`
DAILY = 43200  # seconds: what is sampled less often needs no clock
TELLING = "with `time` among the columns of the model (fit: --time)"
NO_TIME = (
    f"no column is called like time or holds time stamps: name it, {TELLING}, or, if no row is "
    f"missing, give dt (--dt)"
)


@dataclass(frozen=True, eq=False)
class Wanted:
    """The columns that are read of a recording. Build it with `wanted`.

    Fields: inputs, outputs: a column or an Expression for each signal; where: the Expression of the
    condition, or None; time: the column of the time, or None; day: the column of the day where the time is
    only that of a day, or None.
    """

    inputs: tuple[str | Expression, ...]
    outputs: tuple[str | Expression, ...]
    where: Expression | None
    time: Any  # a name, or None
    day: Any = None  # likewise

    @property
    def signals(self) -> list[str]:
        """Names of the columns that signals need, each once, in the order of the inputs and outputs."""
        return list(
            dict.fromkeys(
                c
                for s in self.inputs + self.outputs
                for c in (s.columns if isinstance(s, Expression) else (s,))
            )
        )

    @property
    def numbers(self) -> list[str]:
        """Names of the columns that hold numbers, the signals' first; a numeric time that only orders the
        samples is not among them.
        """
        where = [c for c in self.where.columns if c not in self.where.texts] if self.where else []
        return list(dict.fromkeys(self.signals + where))

    @property
    def texts(self) -> list[str]:
        """Names of the columns that are compared with text, the time left out."""
        expressions = [s for s in (*self.inputs, *self.outputs, self.where) if isinstance(s, Expression)]
        return list(
            dict.fromkeys(
                c for e in expressions for c in e.columns if c in e.texts and c not in (self.time, self.day)
            )
        )

    @property
    def columns(self) -> list[str]:
        """Names of all columns that are read, each once, the time last."""
        return list(
            dict.fromkeys(self.numbers + self.texts + [c for c in (self.day, self.time) if c is not None])
        )

    def samples(
        self, columns: Mapping[str, np.ndarray], count: int, dtype: DTypeLike = np.float64
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return (u, y, excluded): (N, m) and (N, p), NaN where a sample is missing or left out; (N,) bool,
        left out by `where`, or None.

        Args:
            columns: {name: (N,) floats, or what `Expression.values` takes}. count: N. dtype: of y; u is as
                wide as its widest column.

        Raises:
            ValueError: see `Expression.values`.
        """
        value = lambda s: s.values(columns) if isinstance(s, Expression) else columns[s]
        stack = lambda signals, to: (
            np.stack([value(s) for s in signals], 1, dtype=to) if signals else np.zeros((count, 0), to)
        )
        u, y, excluded = stack(self.inputs, None), stack(self.outputs, dtype), None
        if self.where is not None:
            excluded = fails(self.where.values(columns))
            u[excluded], y[excluded] = np.nan, np.nan
        return u, y, excluded


def wanted(names: Sequence[str], model: SignalModel, dated: Callable[[str], str] = lambda name: "") -> Wanted:
    """Find the columns of a model among those of a recording.

    Args:
        names: of the columns that there are. model: with .inputs, .outputs, .columns and .column(signal).
        dated: called with a name: what that column begins with, see `stamp_kind`.

    Returns:
        A Wanted. A signal whose column is not there is taken from the one called like the signal. Time: the
        column that the model names, or one that is called like it, or else the one that holds time stamps;
        the day beside it, where those are times of day.

    Raises:
        ValueError: a column is not there, or there twice; several hold time stamps and none is called like
            time; several hold days.
    """
    inputs, outputs = (
        tuple(_source(s, names, model) for s in side) for side in (model.inputs, model.outputs)
    )
    found = Wanted(inputs, outputs, None, None)
    where = model.columns.get("where")
    free = [name for name in names if name not in found.signals]
    day, time = time_column(names, free, model.columns.get("time"), dated, getattr(model, "dt", None))
    return Wanted(inputs, outputs, None if where is None else expression(where).among(names), time, day)


def time_column(
    names: Sequence[str],
    free: Sequence[str],
    named: str | None,
    dated: Callable[[str], str],
    dt: float | None,
) -> tuple[str | None, str | None]:
    """Return (the column of the day or None, the column of the time or None) of a recording, be it a file or
    a table.

    Args:
        names: of all columns. free: of those that no signal is in. named: the one that the model names, None:
            none. dated: as for `wanted`.
        dt: sampling period in s, None: not known.

    Raises:
        ValueError: as `wanted`.
    """
    called = [named] if named is not None else likely(free, TIMES)
    if not called:
        stamps = {name: kind for name in free if (kind := dated(name)) in STAMPS}
        halves = sorted(stamps.values()) == ["clock", "day"]
        called = [name for name in stamps if stamps[name] == "clock"] if halves else _only_dated(list(stamps))
    if not called:
        return None, None
    return _day_and_clock(find_column(called[0], names, "the recording"), names, free, dated, dt)


def _day_and_clock(
    time: str,
    names: Sequence[str],
    free: Sequence[str],
    dated: Callable[[str], str],
    dt: float | None,
) -> tuple[str | None, str]:
    """Return (the column of the day or None, the time): the other half of a time stamp stands beside it, or
    is called like a time.
    """
    kind = dated(time) if time in free else ""
    if kind not in ("clock", *DAYS) or (dt or 0) >= DAILY:
        return None, time
    at, others = names.index(time), DAYS if kind == "clock" else ("clock",)
    near = dict.fromkeys([*names[max(at - 1, 0) : at], *names[at + 1 : at + 2], *likely(free, TIMES)])
    halves = [c for c in free if c in near and c != time and dated(c) in others]
    if len(halves) > 1:
        what = "times without a day" if kind == "clock" else "days"
        raise ValueError(
            f"column {time!r} holds {what}, and the columns {listed(halves)} hold "
            f"{'days' if kind == 'clock' else 'times'}: "
            "keep one of them"
        )
    if not halves:
        return None, time
    return (halves[0], time) if kind == "clock" else (time, halves[0])


def _only_dated(columns: list[str]) -> list[str]:
    """Return the columns with time stamps where there is one at most; refuse several."""
    if len(columns) > 1:
        raise ValueError(
            f"the columns {listed(list(map(str, columns)))} hold time stamps: say which is the time, "
            f"{TELLING}"
        )
    return columns


def _source(signal: str, names: Sequence[str], model: SignalModel) -> str | Expression:
    named = model.column(signal)
    e = expression(named) if is_expression(named) else None
    try:
        return find_column(named, names, "the recording") if e is None else e.among(names)
    except ValueError:
        if signal in names and signal != named and (e is not None or named not in names):
            return find_column(signal, names, "the recording")
        raise


def where_hints(where: str, left_out: int, samples: int) -> list[str]:
    """Return a sentence on the samples that are no part of the recording. Args: where: the condition as text;
    left_out: how many.
    """
    if not left_out:
        return []
    return [
        f"{left_out} of {samples} samples are set aside by the condition {where!r}: windows with them are "
        f"MISSING"
    ]
