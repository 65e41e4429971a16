"""Tables of whatever library as pandas DataFrames, so that signals are taken by the names of their columns
and rows by their labels.

Nothing is imported to find out: pandas is known by how it behaves, everything else by `to_pandas` (xarray,
polars, pyarrow, cudf) or by the Arrow protocol. What has names that are not understood is refused: taking its
columns by position would be a guess.
"""

from collections.abc import Hashable, Mapping, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from jaxbound.recordings.signals import Named
from jaxbound.recordings.tabletime import one_level, tells_dates, unlabelled, with_time

if TYPE_CHECKING:
    import pandas as pd

Data = Any
"""A table or an array of whatever library, as a user holds it."""
Rows = np.ndarray | tuple[()]
"""Numbers of rows."""
SIGNS_OF_A_TABLE = ("columns", "column_names", "collect", "keys", "iloc")


def is_table(data: object) -> bool:
    """Return whether this is a DataFrame of pandas, or behaves like one."""
    # in this order: some tables work out their columns when asked
    return hasattr(data, "iloc") and hasattr(data, "columns")


def as_table(data: Data, name: str, channels: Sequence[str] | None = None) -> Data:
    """Return data with named columns as a DataFrame, and anything else as it is.

    Args:
        data: anything. name: "u" or "y", for sentences. channels: names of the signals, which columns that
            have none get; None: not known.

    Raises:
        ValueError: names that are not understood, more than one recording in one table.
    """
    if isinstance(data, (list, tuple)):
        if len(data) and (hasattr(data[0], "iloc") or hasattr(data[0], "to_pandas")):
            what = f"{name} is a list of {len(data)}, the first {_library_type(data[0])}"
            raise ValueError(f"{what}: give one recording at a time, as one table")
        return data
    if isinstance(data, str | PathLike):
        text = repr(str(data))
        raise ValueError(
            f"{name} is the text {text}: a file is read first, with jaxbound.read({text}, model)"
        )
    if data is None or isinstance(data, jax.Array):
        return data
    if isinstance(data, np.ndarray):
        if data.dtype.names is None:
            return data
        return _of_mapping({c: data[c] for c in data.dtype.names}, name)
    if isinstance(data, Mapping) and not hasattr(data, "to_pandas"):
        return _of_mapping(data, name)
    if hasattr(data, "iloc") and hasattr(data, "to_numpy"):
        return _with_names(data, channels)
    if hasattr(data, "to_pandas"):
        return _of_other_library(data, name, channels)
    if hasattr(data, "__arrow_c_stream__") or hasattr(data, "__arrow_c_array__"):
        return _of_arrow(data, channels)
    if any(hasattr(type(data), x) or x in getattr(data, "__dict__", ()) for x in SIGNS_OF_A_TABLE):
        what = f"{name} is {_library_type(data)}, whose names are not understood"
        raise ValueError(f"{what}: give a DataFrame of pandas, or an array")
    return data


def _of_other_library(data: Data, name: str, channels: Sequence[str] | None) -> Data:
    """Return a table of a library that can make one of pandas; an array stays one."""
    try:
        converted = data.to_pandas()
    except (ValueError, NotImplementedError) as e:
        what = _library_type(data)
        raise ValueError(f"{name}, {what}, is no table of one recording, a row a sample: {e}") from None
    if not hasattr(converted, "iloc"):
        return converted
    return _with_coordinates(_with_names(converted, channels, getattr(data, "dims", ())), data)


def _of_arrow(data: Data, channels: Sequence[str] | None) -> Data:
    """Return the table, or the column alone, that something tells by the Arrow protocol."""
    import pyarrow as pa

    try:
        return _with_names(pa.table(data).to_pandas(), channels)
    except (pa.ArrowInvalid, TypeError, ValueError):
        if hasattr(data, "__arrow_c_stream__"):
            return pa.chunked_array(data).to_numpy()
        return pa.array(data).to_numpy(False)


def _library_type(data: object) -> str:
    return f"a {type(data).__name__} of {type(data).__module__.split('.')[0]}"


def _with_coordinates(frame: "pd.DataFrame", data: Data) -> "pd.DataFrame":
    """Return the table of what has coordinates beside its dimensions with those of its rows as columns: one
    may be the time.
    """
    rows = getattr(frame.index, "name", None)
    others = {c: x.values for c, x in getattr(data, "coords", {}).items() if x.dims == (rows,) and c != rows}
    if not others or not hasattr(frame, "columns"):
        return frame
    return frame.assign(**{c: x for c, x in others.items() if c not in frame.columns})


def _of_mapping(columns: Mapping[str, Data], name: str) -> "pd.DataFrame":
    import pandas as pd

    columns = {c: x if np.ndim(x) else [x] for c, x in columns.items()}
    lengths = {len(x) for x in columns.values()}
    if len(lengths) > 1:
        span = f"{min(lengths)} to {max(lengths)}"
        raise ValueError(f"the columns of {name} must have the same number of samples: they have {span}")
    return pd.DataFrame(columns)


def _with_names(data: Data, channels: Sequence[str] | None, dims: Sequence[Hashable] = ()) -> Data:
    """Return a DataFrame or a Series as a DataFrame whose columns have names, if it can be, with one label a
    row.
    """
    data = one_level(data)
    if not hasattr(data, "columns"):
        if data.name is not None:
            return data.to_frame(data.name)
        if channels is not None and len(channels) == 1:
            return data.to_frame(channels[0])
        return data
    # an array with labels on its axes: those of the channels say which axis is which
    if len(dims) == 2 and channels is not None:
        if set(channels) <= set(data.index) and not set(channels) <= set(data.columns):
            return data.T
        if unlabelled(data.columns) and data.shape[1] == len(channels):
            return data.set_axis(list(channels), axis=1)
    return data


def one_row(data: Data, name: str) -> Data:
    """Return one sample, (n,) numbers, a Series or a dict, as a recording of one: a row of an array, or a
    table where there are names.

    Raises:
        ValueError: a table of another number of rows.
    """
    if data is None:
        return None
    if (type(data) is np.ndarray and data.dtype.names is None) or isinstance(data, (list, tuple)):
        return np.asarray(data)[None]
    if hasattr(data, "iloc") and not hasattr(data, "columns") and any(isinstance(c, str) for c in data.index):
        row = data.to_frame().T
        if data.name is None:
            return row.reset_index(drop=True)
        return row
    data = as_table(data, name)
    if not is_table(data):
        return np.asanyarray(data)[None]
    if len(data) != 1:
        raise ValueError(f"step takes one sample, {name} has {len(data)}: use run")
    return data


def paired(u: Data, y: Data, model: Named) -> tuple[Data, Data, Rows]:
    """Return (u, y, starts): two tables with the rows that belong together, by their labels, and where that
    left rows out.

    Where one index holds all labels of the other, its rows are selected by them; nothing is ever
    interpolated. What a time column tells (`with_time`) goes before other labels, but where one table has it
    alone, rows are paired as they are labelled, or by their order where they are not. What is no table stays
    as it is.

    Returns:
        starts: numbers of the rows before which there were others, for labels that are no times: those show
            for themselves what is missing.

    Raises:
        ValueError: each index has labels that the other has not, or a label is there twice; what `with_time`
            and `one_level` raise.
    """
    if u is y:
        both = _timed_table(y, model)
        return both, both, ()
    by_u, by_y = _timed_table(u, model), _timed_table(y, model)
    if not is_table(u) or not is_table(y):
        return by_u, by_y, ()
    alone = (by_u is u) != (by_y is y)  # one of the two has a column of times
    if not alone or tells_dates(u.index) or tells_dates(y.index):
        return _matched(by_u, by_y)
    if unlabelled(u.index) and unlabelled(y.index):
        if len(u) != len(y):  # it is refused for that
            return by_u, by_y, ()
        times = by_y.index if by_u is u else by_u.index
        return u.set_axis(times), y.set_axis(times), ()
    rows_u, rows_y = _paired_rows(u.index, y.index)
    times = by_y.index[rows_y] if by_u is u else by_u.index[rows_u]
    return u.iloc[rows_u].set_axis(times), y.iloc[rows_y].set_axis(times), ()


def _timed_table(data: Data, model: Named) -> Data:
    """Return a table by its times, where it tells some; anything else as it is."""
    if is_table(data):
        return with_time(data, model)
    return data


def _matched(u: "pd.DataFrame", y: "pd.DataFrame") -> tuple[Data, Data, Rows]:
    """Return the result of `paired` for two tables, by the labels of their rows."""
    a, b = u.index, y.index
    if a is b or a.equals(b) or (unlabelled(a) and unlabelled(b)):  # of another length: refused for that
        return u, y, ()
    rows_u, rows_y = _paired_rows(a, b)
    if len(rows_y) == len(b):  # in the order of y
        return u.iloc[rows_u].set_axis(b), y, _jumps(rows_u, b)
    return u, y.iloc[rows_y].set_axis(a), _jumps(rows_y, a)


def _paired_rows(a: "pd.Index", b: "pd.Index") -> tuple[np.ndarray, np.ndarray]:
    """Return (rows of the table with the labels a, rows of that with b) that belong together, in the order of
    the shorter one.

    Raises:
        ValueError: each has labels that the other has not, or a label is there twice.
    """
    if a.equals(b):
        return np.arange(len(a)), np.arange(len(b))
    for name, index in (("u", a), ("y", b)):
        if not index.is_unique:
            twice = index[index.duplicated()][0]
            raise ValueError(
                f"u and y have different indexes, and {twice} is twice in that of {name}: nothing says which "
                f"rows belong together"
            )
    places = a.get_indexer(b)
    if (places >= 0).all():
        return places, np.arange(len(b))
    back = b.get_indexer(a)
    if (back >= 0).all():
        return np.arange(len(a)), back
    raise ValueError(
        f"u and y have different rows: {a[back < 0][0]} is in the index of u only, {b[places < 0][0]} in "
        f"that of y only: select the rows "
        "that both have, or give arrays to pair them one by one"
    )


def _jumps(places: np.ndarray, index: "pd.Index") -> Rows:
    """Return the rows before which others were left out, where the labels themselves do not say so."""
    if getattr(index.dtype, "kind", None) in tuple("mMiuf"):
        return ()
    return np.flatnonzero(np.diff(places) != 1) + 1
