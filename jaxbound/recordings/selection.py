"""Columns of a recording that a model needs, and its signals out of them: as they are, or computed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import DTypeLike

from jaxbound.recordings.expressions import (
    TIME_SINCE_START,
    TIMES,
    Expression,
    derived,
    expression,
    fails,
    find_column,
    is_expression,
    likely,
)
from jaxbound.recordings.factors import by_name, factors_of, with_factors
from jaxbound.recordings.recordingformat import format_of
from jaxbound.recordings.signals import Named, SignalModel
from jaxbound.text.names import listed

Moments = tuple[np.ndarray, np.ndarray | None]
"""Times of samples: (s since the first sample of the recording, datetime64 or None)."""
STAMPS, DAYS = ("stamp", "day", "clock"), ("day", "digits")  # kinds of cells, see `stamp_kind`
DAILY = 43200  # seconds: what is sampled less often needs no clock
TELLING = "with `time` among the columns of the model (fit: --time)"
NO_TIME = (
    f"no column is called like time or holds time stamps: name it, {TELLING}, or, if no row is "
    f"missing, give dt (--dt)"
)


@dataclass(frozen=True, eq=False)
class Column:
    """A signal that is taken from a column as it is; like an Expression otherwise. Fields: name: of it."""

    name: str
    texts = clock = frozenset[str]()
    looks_back = False

    @property
    def read(self) -> tuple[str, ...]:
        """Names of the columns that are read of a recording."""
        return (self.name,)

    def values(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return (N,) numbers."""
        return columns[self.name]


@dataclass(frozen=True, eq=False)
class Wanted:
    """The columns that are read of a recording. Build it with `wanted`.

    Fields: inputs, outputs: a Column or an Expression for each signal; where: the Expression of the
    condition, or None; time: the column of the time, or None; day: the column of the day where the time is
    only that of a day, or None; factors: an Expression for each factor of the model, over columns and inputs;
    model: whose factors they are; missing: numbers that stand for missing samples; alike: columns that are
    called like the time but for capitals and blanks, where the model does not say which it is.
    """

    inputs: tuple[Column | Expression, ...]
    outputs: tuple[Column | Expression, ...]
    where: Expression | None
    time: str | None
    day: str | None = None
    factors: tuple[Expression, ...] = ()
    model: Named | None = None
    missing: tuple[float, ...] = ()
    alike: tuple[str, ...] = ()

    @property
    def hints(self) -> tuple[str, ...]:
        """A sentence where another column is called like that of the time, which is known by its name."""
        if not self.alike:
            return ()
        others = listed(self.alike)
        return (f"the time is column {self.time!r}, not {others}, called alike: say which, {TELLING}",)

    @property
    def every(self) -> tuple[Column | Expression, ...]:
        """The signals, the condition, and the factors."""
        where = () if self.where is None else (self.where,)
        return (*self.inputs, *self.outputs, *where, *self.factors)

    def own(self, e: Column | Expression) -> list[str]:
        """Return the names of the columns that a signal needs, a condition or a factor; inputs are none."""
        if self.model is None or e not in self.factors:
            return list(e.read)
        return [c for c in e.read if c not in self.model.inputs]

    @property
    def signals(self) -> list[str]:
        """Names of the columns that signals need, each once, in the order of the inputs and outputs."""
        return list(dict.fromkeys(c for signal in self.inputs + self.outputs for c in signal.read))

    @property
    def numbers(self) -> list[str]:
        """Names of the columns that hold numbers, the signals' first; a numeric time that only orders the
        samples is not among them.
        """
        return list(dict.fromkeys(c for e in self.every for c in self.own(e) if c not in e.texts))

    @property
    def texts(self) -> list[str]:
        """Names of the columns that are compared with text, the time left out."""
        texts = dict.fromkeys(c for e in self.every for c in e.read if c in e.texts)
        return [c for c in texts if c not in (self.time, self.day)]

    @property
    def condition(self) -> str:
        """The condition `where` as text, "" where there is none."""
        if self.where is None:
            return ""
        return self.where.text

    @property
    def columns(self) -> list[str]:
        """Names of all columns that are read, each once, the time last."""
        times = [column for column in (self.day, self.time) if column is not None]
        return list(dict.fromkeys(self.numbers + self.texts + times))

    @property
    def clock(self) -> list[str]:
        """Names that the clock of the recording tells, see `expressions.CLOCK`."""
        return list(dict.fromkeys(name for e in self.every for name in sorted(e.clock)))

    def samples(
        self,
        columns: Mapping[str, np.ndarray],
        count: int,
        moments: Moments,
        dtype: DTypeLike = np.float64,
        first: int = 0,
        dt: float | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return (u, y, excluded): (N, m) and (N, p), NaN where a sample is missing or left out; (N,) bool,
        left out by `where`, or None.

        Args:
            columns: {name: (N,) floats, or what `Expression.values` takes}. count: N. moments: (s since the
                first sample of the recording, dates or None). dtype: of y; u is as wide as its widest column.
            first: number of the first sample, for sentences. dt: sampling period in s; None: the model's, or
                as the times show it.

        Raises:
            ValueError: see `Expression.values` and `derived`; a factor that is none.
        """
        since, stamps = moments
        if self.model is not None:
            dt = period(self.model, since, dt)
        columns = {**columns, **derived(self.clock, count, since, stamps, dt)}
        for name in self.numbers if self.missing else ():
            if name in columns and name != self.time:
                columns[name] = np.where(np.isin(columns[name], self.missing), np.nan, columns[name])
        u, y = _stack(self.inputs, columns, count, None), _stack(self.outputs, columns, count, dtype)
        excluded = None
        if self.where is not None:
            excluded = fails(self.where.values(columns))
            for x, signals in ((u, self.inputs), (y, self.outputs)):
                x[without_looks(excluded, signals)] = np.nan
        if self.factors and self.model is not None:
            values, every = [], {**columns, **by_name(self.model, u)}
            for e in self.factors:
                values.append(e.values(every))
                if excluded is not None:
                    values[-1] = np.where(excluded, np.nan, values[-1])
            u, y = with_factors(self.model, u, y, values, first)
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
    inputs = tuple(column_for(signal, names, model) for signal in model.inputs)
    outputs = tuple(column_for(signal, names, model) for signal in model.outputs)
    factors = []
    for factor in factors_of(model):
        factors.append(factor.expression.among(dict.fromkeys((*model.inputs, *names))))
    missing = format_of(model).numbers
    signals = Wanted(inputs, outputs, None, None, factors=tuple(factors), model=model, missing=missing)
    taken = signals.signals
    free = [name for name in names if name not in taken]
    day, time = time_column(names, free, model.columns.get("time"), dated, getattr(model, "dt", None))
    if time is not None and "time" not in model.columns:
        twins = [c for c in free if c != time and c.strip().lower() == time.strip().lower()]
        signals = replace(signals, alike=tuple(twins))
    if "where" not in model.columns:
        return replace(signals, time=time, day=day)
    return replace(signals, where=expression(model.columns["where"]).among(names), time=time, day=day)


def without_looks(excluded: np.ndarray, signals: Sequence[Column | Expression]) -> np.ndarray:
    """Return (N, n) bool: samples of signals that are left out, and those that look back at one. excluded:
    (N,) bool, left out by `where`.
    """
    behind = excluded | np.append(False, excluded[:-1])
    either = np.stack([excluded, behind])
    back = [int(signal.looks_back) for signal in signals]
    gone: np.ndarray = either[back].T
    return gone


def without_looks_of(excluded: np.ndarray, model: Named, names: Sequence[str]) -> np.ndarray:
    """Return `without_looks` of signals of a model by their names, and of its factors."""
    stated = getattr(model, "column", str)
    signals: list[Column | Expression] = []
    for column in map(stated, names):
        signal: Column | Expression = Column(column)
        if is_expression(column):
            signal = expression(column)
        signals.append(signal)
    return without_looks(excluded, signals)


def period(model: Named, since: np.ndarray | None, dt: float | None = None) -> float | None:
    """Return the sampling period in s of a model, or that of times, (N,) s; None where there need not be
    one. dt: it, where it is known.
    """
    if since is None or not getattr(model, "regular", True):
        return None
    if dt:
        return dt
    steps = np.diff(since)
    if getattr(model, "dt", None) or not (steps > 0).any():
        return getattr(model, "dt", None)
    return float(np.median(steps[steps > 0]))


def looks_back(model: Named) -> str:
    """Return the first expression that needs the sample before; "" if none does."""
    return next((e.text for e in expressions_of(model) if e.looks_back), "")


def _stack(
    signals: Sequence[Column | Expression],
    columns: Mapping[str, np.ndarray],
    count: int,
    dtype: DTypeLike | None,
) -> np.ndarray:
    """Return signals as an array (count, n); dtype None: as wide as the widest of them."""
    if not signals:
        return np.zeros((count, 0), dtype)
    return np.stack([signal.values(columns) for signal in signals], 1, dtype=dtype)


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
    if named is not None:
        called = [named]
    else:
        called = likely(free, TIMES) or _with_stamps(free, dated)
    if not called:
        return None, None
    return _day_and_clock(find_column(called[0], names, "the recording"), names, free, dated, dt)


def _with_stamps(free: Sequence[str], dated: Callable[[str], str]) -> list[str]:
    """Return the column that holds time stamps, of a day and a clock that of the clock; refuse several."""
    stamps = {name: kind for name, kind in zip(free, map(dated, free), strict=True) if kind in STAMPS}
    if sorted(stamps.values()) == ["clock", "day"]:
        return [name for name, kind in stamps.items() if kind == "clock"]
    if len(stamps) > 1:
        raise ValueError(
            f"the columns {listed(list(map(str, stamps)))} hold time stamps: say which is the time, {TELLING}"
        )
    return list(stamps)


def _day_and_clock(
    time: str, names: Sequence[str], free: Sequence[str], dated: Callable[[str], str], dt: float | None
) -> tuple[str | None, str]:
    """Return (the column of the day or None, the time): the other half of a time stamp stands beside it, or
    is called like a time.
    """
    if time not in free or (dt or 0) >= DAILY:
        return None, time
    kind = dated(time)
    if kind == "clock":
        what, other, others = "times without a day", "days", set(DAYS)
    elif kind in DAYS:
        what, other, others = "days", "times", {"clock"}
    else:
        return None, time
    at = names.index(time)
    # the other half stands in the column before or behind it, or is called like a time itself
    near = {*names[max(at - 1, 0) : at], *names[at + 1 : at + 2], *likely(free, TIMES)}
    halves = [c for c in free if c in near and c != time and dated(c) in others]
    if len(halves) > 1:
        raise ValueError(
            f"column {time!r} holds {what}, and the columns {listed(halves)} hold {other}: keep one of them"
        )
    if not halves:
        return None, time
    if kind == "clock":
        return halves[0], time
    return time, halves[0]


def column_for(
    signal: str, names: Sequence[str], model: Named, where: str = "the recording"
) -> Column | Expression:
    """Return the Column of a signal or its Expression; if it is not there, the column called like it.

    Args:
        names: of the columns that there are. where: they are, for sentences.
    """
    stated = getattr(model, "column", str)(signal)
    computed = None
    if is_expression(stated):
        computed = expression(stated)
    try:
        if computed is not None:
            return computed.among(names)
        used = (*columns_of_signals(model), *likely(names, TIMES)[:1])
        return Column(find_column(stated, names, where, used))
    except ValueError:
        there = {str(name).strip() for name in names}
        if signal.strip() in there and signal != stated and (computed is not None or stated not in names):
            return Column(find_column(signal, names, where))
        raise


def columns_of_signals(model: Named) -> set[str]:
    """Return the names of all columns that hold a signal."""
    stated = getattr(model, "column", str)
    names: set[str] = set()
    for signal in (*model.inputs, *model.outputs):
        column = stated(signal)
        names |= {signal, column}
        if is_expression(column):
            names.update(expression(column).columns)
    return names


def expressions_of(model: Named) -> list[Expression]:
    """Return the expressions over the columns of recordings: the condition, signals and factors."""
    stated = getattr(model, "column", str)
    texts = [getattr(model, "columns", {}).get("where", ""), *(factor.text for factor in factors_of(model))]
    texts += filter(is_expression, map(stated, (*model.inputs, *model.outputs)))
    return [expression(text) for text in texts if text]


def counted_from_start(model: Named) -> str:
    """Return the first expression that counts from the first sample of a recording; "" if none does."""
    return next((e.text for e in expressions_of(model) if TIME_SINCE_START in e.columns), "")


def where_hints(where: str, left_out: int, samples: int) -> list[str]:
    """Return a sentence on the samples that are no part of the recording, if there are any.

    Args:
        where: the condition as text. left_out, samples: how many.
    """
    if not left_out:
        return []
    return [
        f"{left_out} of {samples} samples are set aside by the condition {where!r}: windows with them are "
        f"MISSING"
    ]
