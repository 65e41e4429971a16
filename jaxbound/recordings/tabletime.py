"""The time of the rows of a table: its index, or the column by which a file with these columns would be read.

Which column that is, `selection.time_column` says, of files and of tables. An index of dates or time spans
tells the time by itself. Numbers do as they would in a file: in seconds, or as an epoch. Whole numbers in an
index that nobody called a time count the samples. Whatever tells a time is asked whether the rows are one
sampling period apart.
"""

import datetime
import numbers
from collections.abc import Callable, Sized
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from jaxbound.recordings.counting import read_numbers
from jaxbound.recordings.csvtext import is_number
from jaxbound.recordings.seams import TOLERATED_STEP, Clock, check_period, irregular, tick, usual_period
from jaxbound.recordings.selection import columns_of_signals, time_column
from jaxbound.recordings.signals import Named
from jaxbound.recordings.timestamps import DIGITS, EPOCH, SECOND, in_ns, stamp_kind, time_like

if TYPE_CHECKING:
    import pandas as pd

T = TypeVar("T", bound=Sized)

TO_DATETIME = "turn them into times with pandas.to_datetime first"
DAY = np.timedelta64(1, "D")


class RowTime(NamedTuple):
    """The time that an index tells.

    Fields: time, origin, dt, stamps: as of a Recording; seams: numbers of rows that do not follow the one
    before.
    """

    time: np.ndarray | None = None
    origin: float = np.nan
    dt: float | None = None
    stamps: np.ndarray | None = None
    seams: np.ndarray = np.zeros(0, np.int64)


def unlabelled(index: "pd.Index") -> bool:
    """Return whether an index is none: 0, 1, 2, ..., as a table has that was given no labels."""
    return getattr(index, "start", None) == 0 and getattr(index, "step", None) == 1


def tells_dates(index: "pd.Index") -> bool:
    """Return whether an index holds dates or time spans."""
    return plain_labels(index).dtype.kind in ("m", "M")


def one_level(frame: "pd.DataFrame") -> "pd.DataFrame":
    """Return a table with one label a row: levels of its index that hold one value throughout are dropped.

    Raises:
        ValueError: several levels are left.
    """
    index = frame.index
    if getattr(index, "nlevels", 1) == 1:
        return frame
    levels = [index.get_level_values(level) for level in range(index.nlevels)]
    several = [labels for labels in levels if labels.nunique(dropna=False) > 1]
    if len(several) > 1:
        names = ", ".join(map(_name_of_level, several))
        one = "give one unit at a time, like frame.xs(unit), with the time of its rows as index"
        raise ValueError(f"the index has the levels {names}: a recording is one sequence of samples; {one}")
    return frame.set_axis([*several, levels[-1]][0])


def _name_of_level(labels: "pd.Index") -> str:
    if labels.name is None:
        return "one without a name"
    return str(labels.name)


def plain_labels(labels: "pd.Index") -> "pd.Index":
    """Return an index as dates, time spans or numbers where it holds these as objects, text, categories or
    periods.

    Any other comes back as it is.

    Raises:
        ValueError: times of a calendar that is not understood.
    """
    import pandas as pd

    if hasattr(labels, "to_timestamp"):
        return labels.to_timestamp()
    labels = getattr(labels, "left", labels)  # of intervals
    if isinstance(labels.dtype, pd.CategoricalDtype):
        labels = pd.Index(np.asarray(labels), name=labels.name)
    kind = labels.dtype.kind
    if kind == "M":
        return pd.DatetimeIndex(labels)
    if kind == "m":
        return pd.TimedeltaIndex(labels)
    labels = _text_labels(labels)
    first = _first_label(labels)
    if kind != "O" or first is None or isinstance(first, datetime.time):
        return labels
    if isinstance(first, datetime.timedelta | np.timedelta64):
        return pd.TimedeltaIndex(labels)
    if hasattr(first, "isoformat") or isinstance(first, np.datetime64):
        try:
            return pd.DatetimeIndex(labels)
        except (TypeError, ValueError):
            kind = type(first).__name__
            raise ValueError(f"times of type {kind} are not understood: {TO_DATETIME}") from None
    if isinstance(first, str):
        if not is_number(first, ","):
            return labels
        labels = labels.str.replace(",", ".")
    try:
        return pd.Index(pd.to_numeric(labels), name=labels.name)
    except (TypeError, ValueError):
        return labels
    except OverflowError:
        raise ValueError("the index holds a number that is too large to compute with") from None


def _text_labels(labels: "pd.Index") -> "pd.Index":
    """Return an index whose texts are texts, where they are bytes, as HDF5 and fields of NumPy hold them."""
    import pandas as pd

    if labels.dtype.kind != "O" or not isinstance(next(iter(labels.dropna()), None), bytes):
        return labels
    texts = [x.decode("utf-8", "replace") if isinstance(x, bytes) else x for x in labels]
    return pd.Index(texts, dtype=object, name=labels.name)


def with_time(frame: "pd.DataFrame", model: Named) -> "pd.DataFrame":
    """Return a table with the time of its rows for an index, where a column tells it; else as it is.

    The column is the one by which the same table would be read from a file. An index of dates or time spans
    comes before all columns but the one that the model names.

    Raises:
        ValueError: a time column that holds text, or times of day without a day; several columns of time
            stamps, none called like a time.
    """
    if not len(frame):
        return frame
    columns = list(frame.columns)
    if frame.index.name is not None and frame.index.name not in columns:
        columns = [frame.index.name, *columns]
    named = getattr(model, "columns", {}).get("time")
    if not any(named is not None and str(c).strip() == named.strip() for c in columns):
        named = None
    if named is None and tells_dates(frame.index):
        return frame
    taken = columns_of_signals(model)
    free = [c for c in columns if c not in taken]

    def kind_of(name: str) -> str:
        return _kind_of_labels(_labels_of_rows(frame, name))

    day, time = time_column(columns, free, named, kind_of, getattr(model, "dt", None))
    if time is None:
        return frame
    if day is None:
        return frame.set_axis(_in_seconds(_labels_of_rows(frame, time), time))
    days, clocks = plain_labels(_labels_of_rows(frame, day)), plain_labels(_labels_of_rows(frame, time))
    for name, labels, turn in ((day, days, "to_datetime"), (time, clocks, "to_timedelta")):
        if isinstance(_first_label(labels), str):
            raise ValueError(f"the column {name!r} holds text: turn it into times with pandas.{turn} first")
    return frame.set_axis(_of_day_and_clock(days, clocks))


def row_time(index: "pd.Index", dt: float | None, whose: str, regular: bool) -> RowTime:
    """Return the time of the rows of an index.

    Args:
        index: from `with_time`. dt: sampling period in s, None: not known. whose: who says so, see
            `check_period`.
        regular: whether rows of another period are refused; else each of them is a seam.

    Raises:
        ValueError: no time in some row; another sampling period; rows that run backwards or are not regular;
            times as text.
    """
    plain, stamps = plain_labels(index), None
    kind = plain.dtype.kind
    if kind in ("m", "M"):
        time, origin = _since_first_label(plain)
        if kind == "M":
            stamps = in_ns(_dates(plain), lambda k: f"the index of row {k}")
    elif kind not in ("i", "u", "f"):
        return RowTime(seams=_change_rows(plain))
    elif unlabelled(plain) or not len(plain):
        return RowTime()
    else:
        labels = _without_missing(plain.to_numpy(np.float64, na_value=np.nan), np.isnan)
        if kind != "f":  # they count the samples
            if regular:
                _refuse_steps(labels)
            time = labels * (dt or 1.0)
            _, seams = _period_and_seams(time, index, dt or 1.0, whose, regular)
            return RowTime(time, 0.0, seams=seams)
        time, stamps, _ = read_numbers(labels, dt, str(index.name or ""))
        origin = 0.0
        if stamps is not None:
            origin = float((stamps[0] - EPOCH) / SECOND)
    period, seams = _period_and_seams(time, index, dt, whose, regular)
    return RowTime(time, origin, period, stamps, seams)


def instants_of(index: "pd.Index | np.ndarray | None", samples: int, dt: float | None) -> np.ndarray:
    """Return the times (T,) of rows in s, as `Recording.instants` has them.

    Args:
        index: their labels, as a Result has them; None: there are none. samples: T. dt: sampling period in s,
            None: not known.
    """
    import pandas as pd

    if index is not None:
        rows = row_time(pd.Index(index), dt, "", regular=False)
        if rows.time is not None:
            return np.round(rows.origin + rows.time, 6)
    return np.arange(float(samples))


def _labels_of_rows(frame: "pd.DataFrame", name: str) -> "pd.Index":
    """Return a column of a table, or its index, which may have a name like one."""
    import pandas as pd

    if name not in frame.columns:
        return frame.index
    return pd.Index(frame.iloc[:, list(frame.columns).index(name)])


def kinds_of(frame: "pd.DataFrame") -> dict[str, str]:
    """Return {column: the kind of its cells} of a table, see `source.Outline`; an index of times is none."""
    kinds: dict[str, str] = {}
    for name in frame.columns:
        labels = _labels_of_rows(frame, name)
        kinds[name] = _kind_of_labels(labels) or "number"
        if kinds[name] == "number" and isinstance(_first_label(labels), str):
            kinds[name] = "text"
    return kinds


def _first_label(labels: "pd.Index") -> object:
    """Return the first label that there is, or None."""
    first = labels[:1]
    if not len(first) or first.hasnans:
        first = labels.dropna()[:1]
    if not len(first):
        return None
    return first[0]


def _kind_of_labels(labels: "pd.Index") -> str:
    """Return the kind of labels, as `stamp_kind` does of text."""
    first = _first_label(labels)
    if isinstance(first, (int, np.integer)):
        return stamp_kind(str(first)) if DIGITS.fullmatch(str(first)) else ""
    if isinstance(first, str):
        if is_number(first, ",") and not DIGITS.fullmatch(first):
            return ""
        return stamp_kind(first)
    if isinstance(first, datetime.time):
        return "clock"
    plain = plain_labels(labels)
    if plain.dtype.kind == "M":
        return _kind_of_dates(plain.dropna(), len(labels))
    if plain.dtype.kind == "m":
        if ((plain >= np.timedelta64(0, "D")) & (plain < DAY)).all():
            return "clock"
        return "stamp"
    return ""


def _kind_of_dates(dates: "pd.Index", rows: int) -> str:
    """Return "day" of days that several rows share, else "stamp".

    Days that are all different are the time of a daily recording.
    """
    if (dates == dates.normalize()).all() and (rows == 1 or not dates.is_unique):
        return "day"
    return "stamp"


def _in_seconds(labels: "pd.Index", name: str) -> "pd.Index":
    """Return the labels of a time column as dates, time spans, or floats, which are seconds or an epoch."""
    plain = plain_labels(labels)
    if plain.dtype.kind in ("i", "u", "f"):
        plain = _float_labels(plain)
    elif isinstance(_first_label(plain), datetime.time):
        lacking = "times without a day, and no column holds the days: add one, or index by times"
        raise ValueError(f"the time column {name!r} holds {lacking}")
    elif plain.dtype.kind not in ("m", "M"):
        raise ValueError(f"the time column {name!r} holds text: {TO_DATETIME.replace('them', 'it')}")
    return plain.rename(name)


def _float_labels(labels: "pd.Index") -> "pd.Index":
    import pandas as pd

    if isinstance(labels.dtype, np.dtype):
        return labels.astype(np.float64)
    return pd.Index(labels.to_numpy(np.float64, na_value=np.nan))


def _of_day_and_clock(days: "pd.Index", clocks: "pd.Index") -> "pd.Index":
    import pandas as pd

    since = clocks
    if clocks.dtype.kind != "m":
        since = pd.to_timedelta([clock.isoformat() for clock in clocks])
    if days.dtype.kind in ("i", "u"):
        days = pd.to_datetime(days.astype(str), format="%Y%m%d")
    return pd.DatetimeIndex(days + pd.TimedeltaIndex(since), name=clocks.name)


def _since_first_label(index: "pd.Index") -> tuple[np.ndarray, float]:
    """Return (time, origin): seconds since the first label of an index, and that one's since 1970 or zero."""
    _without_missing(index, lambda x: np.asarray(x.isna()))
    if not len(index):
        return np.zeros(0), np.nan
    if index.dtype.kind == "m":
        origin = index[:1].to_numpy()[0]
    else:
        origin = in_ns(_dates(index[:1]), lambda k: "the index")[0] - EPOCH
    return np.asarray(index - index[0]) / SECOND, float(origin / SECOND)


def _dates(index: "pd.Index") -> np.ndarray:
    """Return a DatetimeIndex as datetime64 of its own unit, in UTC."""
    return np.asarray(index.to_numpy(f"datetime64[{index.unit}]"))


def _without_missing(labels: T, gone: Callable[[T], np.ndarray]) -> T:
    """Return the labels; refuse some that are none."""
    missing = gone(labels)
    if missing.any():
        rows = f"{missing.sum()} of {len(labels)} rows, the first is row {int(missing.argmax())}"
        raise ValueError(f"the index has no time in {rows}: leave them out")
    return labels


def _refuse_steps(labels: np.ndarray) -> None:
    """Refuse an index that counts, but not every sample, as one of every second row of a table does."""
    if len(labels) < 2:
        return
    step = float(np.median(np.diff(labels)))
    if step > 0 and abs(step - 1) > TOLERATED_STEP:
        seconds = (
            "If these are seconds, call the index 'time'; if the rows follow each other, "
            "frame.reset_index(drop=True)"
        )
        raise ValueError(f"the index counts in steps of {step:g}, as if rows were left out. {seconds}")


def _period_and_seams(
    time: np.ndarray, index: "pd.Index", dt: float | None, whose: str, regular: bool
) -> tuple[float | None, np.ndarray]:
    """Return (sampling period, seams) of rows at these times; None: it was not asked for."""
    if not regular or len(time) < 2:
        _, seams = tick(Clock(dt or 1.0), time)
        return None, seams
    try:
        period = dt
        if period is None:
            period = usual_period(time)
        check_period(time, period, whose)
        clock, seams = tick(Clock(period), time)
        sentence = irregular(clock, lambda k: str(index[k]), "row {}".format, time)
        if sentence:
            raise ValueError(sentence)
    except ValueError as e:
        if index.name is None:
            raise ValueError(str(e)) from None
        taken = f"the time is taken from {index.name!r}: where that is none, rename it or leave it out"
        raise ValueError(f"{e}; {taken}") from None
    return period, seams


def _change_rows(labels: "pd.Index") -> np.ndarray:
    """Return the rows before which labels that tell no time change, where they repeat.

    Rows of one label follow each other, if any do.

    Raises:
        ValueError: labels that are times, but as text or without a day; numbers among other labels.
    """
    first = _first_label(labels)
    drop = "or leave it out with frame.reset_index(drop=True)"
    if time_like(first):
        raise ValueError(f"the index holds times as text: {TO_DATETIME.replace('them', 'it')}")
    if isinstance(first, datetime.time):
        raise ValueError(f"the index holds times without a day: add the days, {drop}")
    if isinstance(first, numbers.Number) or (isinstance(first, str) and is_number(first, ",")):
        raise ValueError(f"the index holds numbers and other labels: give the times of the rows, {drop}")
    if first is not None and not isinstance(first, str | bool | np.bool_):
        kind = type(first).__name__
        raise ValueError(
            f"the index holds labels of type {kind}, of which none tells a time: {TO_DATETIME}, {drop}"
        )
    if labels.is_unique:
        return np.zeros(0, np.int64)
    codes = labels.factorize()[0]
    return np.flatnonzero(np.diff(codes)) + 1
