"""Tables of whatever library as pandas DataFrames, so that signals are taken by the names of their columns and rows by their labels.

Nothing is imported to find out: pandas is known by how it behaves, everything else by `to_pandas` (xarray, polars, pyarrow, cudf) or by the
Arrow protocol. What has names that are not understood is refused: taking its columns by position would be a guess.
"""

import datetime
import re
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from jaxbound.recordings.expressions import TIMES, find_column, likely
from jaxbound.recordings.naming import listed
from jaxbound.recordings.seams import TOLERATED_STEP
from jaxbound.recordings.selection import STAMPS, only_dated
from jaxbound.recordings.timestamps import stamp_kind

__all__ = ["as_table", "is_date", "is_table", "one_row", "paired", "time_like", "unlabelled", "usual_step"]

EPOCHS = (1.0, 1e3, 1e6, 1e9)


def is_table(data: Any) -> bool:
    """Return whether this is a DataFrame of pandas, or behaves like one."""
    return hasattr(data, "iloc") and hasattr(data, "columns")  # in this order: some tables work out their columns when asked


def as_table(data: Any, name: str, channels: Sequence[str] | None = None) -> Any:
    """Return what has named columns as a DataFrame, and anything else as it is.

    Args:
        data: anything. name: "u" or "y", for sentences. channels: names of the signals, which columns that have none get; None: not known.

    Raises:
        ValueError: names that are not understood, more than one recording in one table.
    """
    if data is None or isinstance(data, (list, tuple, jax.Array)):
        return data
    if isinstance(data, np.ndarray):
        return data if data.dtype.names is None else _of_mapping({c: data[c] for c in data.dtype.names}, name)
    if isinstance(data, Mapping) and not hasattr(data, "to_pandas"):
        return _of_mapping(data, name)
    if hasattr(data, "iloc") and hasattr(data, "to_numpy"):
        return _named(data, channels)
    if hasattr(data, "to_pandas"):
        try:
            found = data.to_pandas()
        except (ValueError, NotImplementedError) as e:
            raise ValueError(f"{name}, {_kind(data)}, is no table of one recording, a row a sample: {e}") from None
        return _named(found, channels, getattr(data, "dims", ())) if hasattr(found, "iloc") else found
    if hasattr(data, "__arrow_c_stream__") or hasattr(data, "__arrow_c_array__"):
        import pyarrow as pa

        try:
            return pa.table(data).to_pandas()
        except (pa.ArrowInvalid, TypeError, ValueError):  # a column alone
            return pa.chunked_array(data).to_numpy() if hasattr(data, "__arrow_c_stream__") else pa.array(data).to_numpy(False)
    if any(hasattr(type(data), x) or x in getattr(data, "__dict__", ()) for x in ("columns", "column_names", "collect", "keys", "iloc")):
        raise ValueError(f"{name} is {_kind(data)}, whose names are not understood: give a DataFrame of pandas, or an array")
    return data


def _kind(data):
    return f"a {type(data).__name__} of {type(data).__module__.split('.')[0]}"


def _of_mapping(columns, name):
    import pandas as pd

    columns = {c: x if np.ndim(x) else [x] for c, x in columns.items()}
    if len(lengths := {len(x) for x in columns.values()}) > 1:
        raise ValueError(f"the columns of {name} must have the same number of samples: they have {min(lengths)} to {max(lengths)}")
    return pd.DataFrame(columns)


def _named(data, channels, dims=()):
    """Return a DataFrame or a Series as a DataFrame whose columns have names, if it can be."""
    if not hasattr(data, "columns"):
        name = data.name if data.name is not None else channels[0] if channels is not None and len(channels) == 1 else None
        return data if name is None else data.to_frame(name)
    if len(dims) == 2 and channels is not None:  # an array with labels on its axes: those of the channels say which axis is which
        if set(channels) <= set(data.index) and not set(channels) <= set(data.columns):
            return data.T
        if unlabelled(data.columns) and data.shape[1] == len(channels):
            return data.set_axis(list(channels), axis=1)
    return data


def one_row(data: Any, name: str) -> Any:
    """Return one sample, (n,) numbers, a Series or a dict, as a recording of one: a row of an array, or a table where there are names.

    Raises:
        ValueError: a table of another number of rows.
    """
    if data is None:
        return None
    if (type(data) is np.ndarray and data.dtype.names is None) or isinstance(data, (list, tuple)):
        return np.asarray(data)[None]
    if hasattr(data, "iloc") and not hasattr(data, "columns") and any(isinstance(c, str) for c in data.index):
        row = data.to_frame().T
        return row if data.name is not None else row.reset_index(drop=True)
    data = as_table(data, name)
    if not is_table(data):
        return np.asanyarray(data)[None]
    if len(data) != 1:
        raise ValueError(f"step takes one sample, {name} has {len(data)}: use run")
    return data


def unlabelled(index: Any) -> bool:
    """Return whether an index is none: 0, 1, 2, ..., as a table has that was given no labels."""
    return getattr(index, "start", None) == 0 and getattr(index, "step", None) == 1


def paired(u: Any, y: Any, model: Any) -> tuple[Any, Any, Any]:
    """Return (u, y, starts): two tables with the rows that belong together, by their labels, and where that left rows out.

    Where one index holds all labels of the other, its rows are selected by them; nothing is ever interpolated. A table without labels has
    the times of its time column for labels (`_dated`). What is no table stays as it is.

    Returns:
        starts: numbers of the rows before which there were others, for labels that are no times: those show for themselves what is missing.

    Raises:
        ValueError: each index has labels that the other has not, or a label is there twice; a time column that holds text.
    """
    if u is y or not is_table(u) or not is_table(y):
        y = _dated(y, model)
        return y if u is y else _dated(u, model), y, ()
    no_labels = unlabelled(u.index) and unlabelled(y.index)
    u, y = _dated(u, model), _dated(y, model)
    a, b = u.index, y.index
    if a is b or a.equals(b):
        return u, y, ()
    if no_labels and unlabelled(a) | unlabelled(b):  # at most one of them has a time; where they are not as long, they are refused for that
        index = b if unlabelled(a) else a
        return *(x.set_axis(index) if len(x) == len(index) else x for x in (u, y)), ()
    for name, index in (("u", a), ("y", b)):
        if not index.is_unique:
            twice = index[index.duplicated()][0]
            raise ValueError(
                f"u and y have different indexes, and {twice} is twice in that of {name}: nothing says which rows belong together"
            )
    places = a.get_indexer(b)
    if (places >= 0).all():
        return u.iloc[places].set_axis(b), y, _jumps(places, b)
    back = b.get_indexer(a)
    if (back >= 0).all():
        return u, y.iloc[back].set_axis(a), _jumps(back, a)
    raise ValueError(
        f"u and y have different rows: {a[back < 0][0]} is in the index of u only, {b[places < 0][0]} in that of y only: select the rows "
        "that both have, or give arrays to pair them one by one"
    )


def _dated(frame, model):
    """Return a table whose rows are only numbered with the times of its time column for an index; any other as it is.

    The time column is the one that the model names; else the one column of dates, of several one that is called like a time; else one of
    numbers that is called so, which shows gaps but, its unit not being known, no period; else one of texts that are time stamps. Times of
    day, of Python or as differences, are counted from the one column of days.

    Raises:
        ValueError: the time column holds text, or times of day without a day; several hold time stamps, and none is called like a time.
    """
    if not is_table(frame) or not unlabelled(frame.index) or not len(frame) or not frame.columns.is_unique:
        return frame
    named, kind = getattr(model, "columns", {}).get("time"), lambda c: getattr(frame.dtypes[c], "kind", None)
    of_signal = getattr(model, "column", lambda signal: signal)
    signals = {name for signal in (*model.inputs, *model.outputs) for name in (signal, of_signal(signal))}
    free = [c for c in frame.columns if c not in signals]
    if named is not None and any(str(c).strip() == named.strip() for c in frame.columns):
        name = find_column(named, list(frame.columns), "the recording")
        return frame.set_axis(_index_of(frame, name, free, checked=True))
    dates = [c for c in free if kind(c) in ("m", "M") or is_date(frame[c].iloc[0])]
    counts = lambda c: kind(c) in ("i", "u", "f") and usual_step(frame[c].to_numpy(np.float64, na_value=np.nan)) is not None
    called = likely(dates, TIMES) if dates else [c for c in likely(free, TIMES) if counts(c) or time_like(frame[c].iloc[0])]
    stamps = dates or [c for c in free if is_text_stamp(frame[c].iloc[0])]
    column = next(iter(dates if len(dates) == 1 else called or _clock_of_days(frame, dates) or only_dated(stamps)), None)
    return frame if column is None else frame.set_axis(_index_of(frame, column, free))


def _clock_of_days(frame, dates):
    """Return [the times of day] of columns that hold these once, and days besides; else []."""
    clocks = [c for c in dates if _is_clock(frame[c])]
    return clocks if len(clocks) == 1 and all(c in clocks or _is_day(frame[c]) for c in dates) else []


def _index_of(frame, column, free, checked=False):
    """Return the index that the time column gives; one that holds half of a time stamp, with the other half."""
    clock = _is_clock(frame[column])
    if not clock and not (_is_day(frame[column]) and frame[column].duplicated().any()):
        return _time_index(frame[column], column, checked)
    others = [c for c in free if (_is_day if clock else _is_clock)(frame[c])]
    if not others:
        return _time_index(frame[column], column, checked)
    days, clocks = (others, [column]) if clock else ([column], others)
    if len(others) > 1:
        raise ValueError(f"the columns {listed(list(map(str, days)))} hold days and {listed(list(map(str, clocks)))} times of day: "
                         "keep one of each")  # fmt: skip
    return _of_day_and_clock(frame[days[0]], frame[clocks[0]])


def _is_day(x):
    """Return whether a column holds days without a time."""
    if getattr(x.dtype, "kind", None) == "M":
        return bool((x.dt.normalize() == x).all())
    return isinstance(x.iloc[0], datetime.date) and not isinstance(x.iloc[0], datetime.datetime)


def _is_clock(x):
    """Return whether a column holds times of day: of Python, or differences below a day."""
    if getattr(x.dtype, "kind", None) == "m":
        return bool(((x >= np.timedelta64(0, "D")) & (x < np.timedelta64(1, "D"))).all())
    return isinstance(x.iloc[0], datetime.time)


def _of_day_and_clock(days, clocks):
    import pandas as pd

    since = clocks if getattr(clocks.dtype, "kind", None) == "m" else pd.to_timedelta([t.isoformat() for t in clocks])
    return pd.DatetimeIndex(pd.DatetimeIndex(days) + pd.TimedeltaIndex(since), name=clocks.name)


def _time_index(x, column, checked=False):
    import pandas as pd

    if getattr(x.dtype, "kind", None) in ("m", "M"):
        return pd.Index(x, name=column)
    if isinstance(x.iloc[0], datetime.time):
        raise ValueError(f"the time column {column!r} holds times without a day, and no column holds the days: add one, or index by times")
    if is_date(x.iloc[0]):
        return pd.DatetimeIndex(x, name=column)
    try:
        seconds = x.to_numpy(np.float64, na_value=np.nan)
    except (ValueError, TypeError):
        raise ValueError(f"the time column {column!r} holds text: turn it into times with pandas.to_datetime first") from None
    if not checked:
        return pd.Index(seconds, name=column)
    scale = next((s for s in EPOCHS if 1e9 * s <= seconds[0] < 5e9 * s), 1.0)  # seconds, or an epoch in s, ms, us, ns
    return pd.TimedeltaIndex(np.round(seconds * (1e9 / scale)).astype("timedelta64[ns]"), name=column)


def usual_step(labels: np.ndarray) -> float | None:
    """Return the median step of labels that are numbers, None where they run backwards or more than half of their steps are others."""
    steps = np.diff(labels)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return usual if usual > 0 and 2 * np.count_nonzero(np.abs(steps - usual) <= TOLERATED_STEP * usual) >= len(steps) else None


def is_date(label: Any) -> bool:
    """Return whether a label is a date of Python or pandas."""
    return hasattr(label, "isoformat")


def time_like(label: Any) -> bool:
    """Return whether a label is text that looks like a time."""
    return isinstance(label, str) and re.search(r"\d[-/.:]\d+[-/.: T]", label + " ") is not None


def is_text_stamp(label: Any) -> bool:
    """Return whether a label is text that holds a time stamp."""
    return isinstance(label, str) and stamp_kind(label) in STAMPS


def _jumps(places, index):
    """Return the rows before which others were left out, where the labels themselves do not say so."""
    if getattr(index.dtype, "kind", None) in tuple("mMiuf"):
        return ()
    return np.flatnonzero(np.diff(places) != 1) + 1
