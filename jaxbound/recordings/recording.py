"""A recording is a value: u, y, where samples do not follow each other, which do not count. Every verb builds one first, by one door.

Tables in (`table`), checked arrays out. What a table says beyond its numbers is found here, so that no verb can forget it: the names of its
columns, gaps in the time of its rows, samples that the model's `where` leaves out, samples that are masked or null.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import jax
import numpy as np

from jaxbound.recordings.expressions import expression, fails, find_column, is_expression, missing_column
from jaxbound.recordings.naming import listed
from jaxbound.recordings.seams import Clock, all_starts, around, aside, check_period, crossing, irregular, tick, usual_period
from jaxbound.recordings.table import as_table, is_date, is_table, paired, time_like, unlabelled, usual_step

__all__ = ["Recording", "Signals", "floats", "holds_both", "inputs_of", "is_made", "missing_column", "recorded_type", "refuse_infinite"]


@dataclass(frozen=True)
class Signals:
    """What reading needs to know where there is no model yet.

    Fields: inputs, outputs: names; columns: as of a LinearSystem; dt: sampling period in s, None: the median step of the recording.
    """

    inputs: tuple
    outputs: tuple
    columns: dict
    dt: float | None = None
    stated = "you gave"  # who says what dt is

    m = property(lambda self: len(self.inputs))
    resolution = property(lambda self: (np.inf,) * len(self.outputs))  # nothing is stated that could be too small

    def column(self, signal):
        """Return the column of a recording that holds a signal."""
        return self.columns.get(signal, signal)


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording, or a batch of one length, as every verb takes it. Build it with `Recording.of`.

    Fields:
        u, y: (..., T, m), (..., T, p) of one float dtype in the order of the model's signals; NaN where a sample is missing or does not
            count. Tracers and jax arrays stay what they are.
        starts: (k,) whole numbers, ascending: samples that do not follow the one before. Windows across are MISSING.
        inputs, outputs: names of the signals.
        excluded: (T,) bool, samples that the model's `where` leaves out, with a start at either end of each stretch; None: it has none, or
            there was no table to look at.
        index: labels of the rows, of the table that y came from, else of that of u; None: there was none.
        time: (T,) seconds since the first sample, as the index tells them; None where it tells nothing. origin: s, of the first one.
        dt: sampling period in s that dates or time spans in the index show; None: there are none.
    """

    u: np.ndarray
    y: np.ndarray
    starts: np.ndarray
    inputs: tuple
    outputs: tuple
    excluded: np.ndarray | None = None
    index: object = None
    time: np.ndarray | None = None
    origin: float = np.nan
    dt: float | None = None

    @classmethod
    def of(cls, model, u, y=None, starts=(), regular=True, narrow=True):
        """Return the Recording of a model's signals.

        Integers become floats.

        Args:
            model: with .inputs, .outputs and, where tables may be named otherwise, .columns, .column(signal), .dt (None: not known).
            u, y: arrays (..., T, m), (..., T, p), masked or not; or tables: DataFrames of pandas or polars, tables of pyarrow, Datasets and
                labelled DataArrays of xarray, dicts of columns. Signals are taken by name, rows of two tables by the labels of their
                index. u is None for a model without inputs. y None: u holds both, a table or a Recording (or anything with .u and .y).
            starts: numbers of the samples that do not follow the one before; the gaps that an index shows are found from it: of dates and
                time spans, by the model's dt; of numbers, by their usual step.
            regular: whether an index of dates must have the model's dt for its usual step. narrow: whether u takes the type of y, and both
                become float32 where jax runs with x64 off (`detect` counts that rounding); else each keeps the type it was recorded in.

        Raises:
            ValueError: a column that is not there, names that are not understood, text, a shape that does not fit the model or the other
                array, indexes that hold different rows, a wrong sampling period, starts that are no numbers of samples.
        """
        if y is None and is_made(u):
            return cls._again(model, u, starts, narrow)
        one = u is y or y is None
        u = as_table(u, "u", model.inputs)
        y = u if one and is_table(u) else as_table(y, "y", model.outputs)
        if y is None:
            raise ValueError("y is missing: give u and y, or one table or Recording that holds both")
        u, y, out = paired(u, y, model)
        index = next((x.index for x in (y, u) if hasattr(x, "iloc")), None)
        tables = {name: x for name, x in (("y", y), ("u", u)) if is_table(x)}
        found = cls(*_arrays(model, u, y, narrow), np.zeros(0, np.int64), tuple(model.inputs), tuple(model.outputs), index=index)
        if "where" in getattr(model, "columns", {}) and tables:
            found = found._without(fails(_computed(expression(model.columns["where"]), tables, "the recording")))
        if index is not None:
            found = found._timed(getattr(model, "dt", None), getattr(model, "stated", "the model has"), regular)
        if not np.size(starts) and not len(out):
            return found
        return replace(found, starts=_union(found.starts, out, all_starts(starts, found.y.shape[-2])))

    @classmethod
    def _again(cls, model, given, starts, narrow):
        """Return the Recording of something that has been one: its signals, by their names if it knows them, and what it knows beside."""
        u, y = given.u, given.y
        names = [*getattr(given, "inputs", ()), *getattr(given, "outputs", ())]
        if names and (given.inputs, given.outputs) != (tuple(model.inputs), tuple(model.outputs)):
            both = [x[..., i] for x in (u, y) for i in range(x.shape[-1])]
            pick = lambda side: [both[names.index(find_column(c, names, "the recording"))] for c in side]
            stack = lambda side, like: np.stack(side, -1) if side else like[..., :0]
            u, y = stack(pick(model.inputs), u), stack(pick(model.outputs), y)
        seams = _union(getattr(given, "starts", ()), all_starts(starts, np.shape(y)[-2]))
        beside = {name: getattr(given, name, None) for name in ("excluded", "index", "dt")}
        if isinstance(given, cls):
            beside |= {"time": given.time, "origin": given.origin}
        if beside["dt"] and getattr(model, "dt", None):
            check_period(np.arange(2) * beside["dt"], model.dt, getattr(model, "stated", "the model has"))
        return cls(*_arrays(model, u, y, narrow), seams, tuple(model.inputs), tuple(model.outputs), **beside)

    def across(self, horizon):
        """Return (T,) bool: True where the window of horizon + 1 samples that ends at a sample lies across a seam."""
        return crossing(self.starts, horizon, 0, self.y.shape[-2])

    def aside(self, horizon):
        """Return how many windows of horizon + 1 samples have one that does not count."""
        return aside(self.excluded, horizon)

    def finite(self):
        """Return the same recording; raise ValueError if a number of it is infinite."""
        refuse_infinite("u", self.u, self.inputs)
        refuse_infinite("y", self.y, self.outputs)
        return self

    def _without(self, excluded):
        """Leave samples out, (T,) bool."""
        u, y = (np.where(excluded[:, None], np.array(np.nan, x.dtype), x) for x in (self.u, self.y))
        return replace(self, u=u, y=y, excluded=excluded, starts=_union(self.starts, around(excluded)))

    def _timed(self, dt, whose, regular):
        """Find the time of the rows from their index, and where they do not follow each other."""
        index = self.index.to_timestamp() if hasattr(self.index, "to_timestamp") else self.index  # periods
        if len(index) and index.dtype == object and is_date(index[0]):
            index = _as_dates(index)
        kind = getattr(getattr(index, "dtype", None), "kind", None)
        if kind in ("m", "M"):
            time, origin = _seconds(index)
            found = None
            if regular and len(time) > 1:
                found = usual_period(time) if dt is None else dt
                check_period(time, found, whose)
            clock, seams = tick(Clock(found or dt or 1.0), time)
            if regular and len(time) > 1 and (sentence := irregular(clock, lambda k: str(self.index[k]), lambda k: f"row {k}")):
                raise ValueError(sentence)
        elif len(index) and time_like(index[0]):
            raise ValueError("the index holds times as text: turn it into times with pandas.to_datetime first")
        elif kind in ("i", "u", "f") and not unlabelled(index):
            time, found = _counted(np.asarray(index, np.float64), kind == "f", dt or 1.0), None
            if time is None:
                return self
            origin, time = (float(time[0]), time - time[0]) if len(time) else (np.nan, time)
            seams = tick(Clock(dt or 1.0), time)[1]
        else:
            return self
        return replace(self, time=time, origin=origin, dt=found, starts=_union(self.starts, seams))


def _union(*starts):
    return np.unique(np.concatenate([np.asarray(x, np.int64) for x in starts]))


def _as_dates(index):
    import pandas as pd

    return pd.DatetimeIndex(index)


def _seconds(index):
    """Return (time, origin): seconds since the first date or time span of an index, and that one since 1970 or zero."""
    if (gone := np.asarray(index.isna())).any():
        raise ValueError(
            f"the index has no time in {gone.sum()} of {len(gone)} rows, the first is row {int(gone.argmax())}: leave them out"
        )
    if not len(index):
        return np.zeros(0), np.nan
    second = np.timedelta64(1, "s")
    first = np.asarray(index[:1].to_numpy() if index.dtype.kind == "m" else index[:1].to_numpy("datetime64[ns]"))[0]
    origin = (first if index.dtype.kind == "m" else first - np.datetime64(0, "s")) / second
    return np.asarray(index - index[0]) / second, float(origin)


def _counted(labels, seconds, dt):
    """Return the time in s that labels which are numbers stand for, or None where more than half of their steps are irregular.

    Their unit is not known: their usual step is dt. Of less than three there is none: they count rows then, or seconds.
    """
    usual = usual_step(labels) if len(labels) > 2 else dt if seconds else 1.0
    return None if usual is None else labels * (dt / usual)


def is_made(data):
    """Return whether this is a Recording, or the like: it has .u and .y, which are no columns of a table."""
    return not is_table(data) and not isinstance(data, Mapping) and hasattr(data, "u") and hasattr(data, "y")


def holds_both(data):
    """Return whether one thing has the inputs and the outputs of a recording: a table, or a Recording."""
    return is_made(data) or is_table(as_table(data, "u"))


def inputs_of(model, u, name="u"):
    """Return inputs alone as an array (..., T, m), as `Recording.of` does; None stays None."""
    u = as_table(u, name, model.inputs)
    if getattr(u, "dtype", None) == np.float16:  # no resolution to be stated: they are what they are
        u = np.asarray(u, np.float64)
    return None if u is None else _columns(model, u, name, model.inputs)


def floats(data, name):
    """Return numbers that are no signals of a model as an array of floats: NaN where they are masked, null or missing."""
    data = as_table(data, name)
    return _plain(data if not hasattr(data, "iloc") else _of_frame(data, name), name)


def _arrays(model, u, y, narrow):
    """Return u and y as float arrays of one batch that fit the model."""
    y = _channels(_columns(model, y, "y", model.outputs), "y", model.outputs)
    u = _columns(model, u, "u", model.inputs) if u is not None else None
    if u is None:
        if model.inputs:
            raise ValueError(f"u is missing: the model has the inputs {listed(model.inputs, str)}")
        u = np.zeros((*y.shape[:-1], 0), y.dtype)
    u = _channels(u, "u", model.inputs)
    if u.shape[-2] != y.shape[-2]:
        raise ValueError(f"u and y must have the same number of samples: {u.shape[-2]} and {y.shape[-2]}")
    if narrow:
        dtype = jax.dtypes.canonicalize_dtype(y.dtype)
        y = y if y.dtype == dtype else y.astype(dtype)
        u = u if u.dtype == dtype else u.astype(dtype)
    try:
        batch = np.broadcast_shapes(u.shape[:-2], y.shape[:-2])
    except ValueError:
        raise ValueError(f"the leading axes of u {u.shape} and y {y.shape} do not fit each other") from None
    return _spread(u, batch), _spread(y, batch)


def refuse_infinite(name, data, channels):
    """Raise ValueError if a recorded number is infinite."""
    bad = np.isinf(np.asarray(data))
    if bad.any():
        first = np.argwhere(bad)[0]
        raise ValueError(
            f"{name} must be finite (NaN marks a missing sample): {bad.sum()} of {bad.size} numbers are infinite, "
            f"first in {channels[first[-1]]!r} at sample {first[-2]}"
        )


def _computed(e, frames, name):
    """Return the values of an Expression over the columns of DataFrames, and over their index by its name."""
    import pandas as pd

    found = {}
    for frame in reversed(frames.values()):
        found |= {str(frame.index.name): frame.index.to_series()} | {c: frame[c] for c in frame.columns}
    e = e.among(list(found))
    number = lambda c: _numbers(lambda: found[c].to_numpy(np.float64, na_value=np.nan), name)
    text = lambda c: found[c].astype(object).where(found[c].notna(), None).to_numpy(object)
    dates = {c: found[c].to_numpy("datetime64[ns]") for c in e.columns if pd.api.types.is_datetime64_any_dtype(found[c])}
    return e.values({c: dates[c] if c in dates else text(c) if c in e.texts else number(c) for c in e.columns})


def recorded_type(data, name):
    """Return the float type in which data were rounded: float32 if any of it (a column of a DataFrame) is that, else float64.

    Raises:
        ValueError: half precision.
    """
    if hasattr(data, "dtypes") and hasattr(data, "iloc"):
        types = list(data.dtypes) if hasattr(data, "columns") else [data.dtypes]
        types = [getattr(t, "numpy_dtype", t) for t in types]  # of pandas' own types
    else:
        types = [data.dtype if hasattr(data, "dtype") else np.asarray(data).dtype]
    if np.float16 in types:
        raise ValueError(f"{name} is in half precision: convert it to float32 and state in `resolution` what was rounded away")
    return np.dtype(np.float32 if np.float32 in types else np.float64)


def _columns(model, data, name, channels):
    """Pick the channels of a DataFrame by name; turn anything else into an array of floats."""
    if not is_table(data):
        return _plain(_of_frame(data, name) if hasattr(data, "iloc") else data, name)
    column = getattr(model, "column", lambda channel: channel)
    present, taken, whole, sources = list(data.columns), {}, data, []
    for channel in channels:
        if is_expression(text := column(channel)) and channel not in present:
            taken[channel] = _computed(expression(text), {"": data}, name)
            sources += [c for c in expression(text).among(present).columns if c in present]
    if taken:
        data = data.assign(**taken)
        present = list(data.columns)
    stripped = {str(c).strip() for c in present}
    wanted = [c if c in taken or column(c).strip() not in stripped else column(c) for c in channels]
    wanted = [find_column(c, present, name) for c in wanted]
    recorded = recorded_type(whole[[*(c for c in wanted if c not in taken), *sources]], name)  # of one column, if of any
    found = _plain(_of_frame(data[wanted], name), name)
    return found.astype(recorded, copy=False) if name == "y" else found  # what was rounded away counts in the type it was recorded in


def _of_frame(data, name):
    plain = data.to_numpy()
    return plain if plain.dtype != object else _numbers(partial(data.to_numpy, dtype=np.float64, na_value=np.nan), name)


def _plain(data, name):
    """Return an array of floats, NaN where it was masked."""
    if isinstance(data, jax.Array):
        return data if np.issubdtype(data.dtype, np.floating) else data.astype(float)
    mask = np.ma.getmask(data) if isinstance(data, np.ma.MaskedArray) else np.ma.nomask
    data = np.asarray(data)
    if data.dtype == np.float16:
        raise ValueError(f"{name} is in half precision: convert it to float32 and state in `resolution` what was rounded away")
    if np.iscomplexobj(data) or data.dtype.kind in "mM":
        raise ValueError(f"{name} must be numbers, not {'complex ones' if np.iscomplexobj(data) else 'times'}")
    if not np.issubdtype(data.dtype, np.floating) or data.dtype.itemsize > 8:
        data = _numbers(lambda: data.astype(np.float64), name)
    return data if mask is np.ma.nomask else np.where(mask, np.array(np.nan, data.dtype), data)


def _numbers(convert, name):
    try:
        return convert()
    except (ValueError, TypeError) as e:
        raise ValueError(f"{name} must be numbers, NaN where a sample is missing: {e}") from None


def _channels(x, name, channels):
    if x.ndim == 1 and len(channels) == 1:
        x = x[:, None]
    if x.ndim < 2 or x.shape[-1] != len(channels):
        raise ValueError(
            f"{name} must have shape (..., T, {len(channels)}), time first, one column for each of "
            f"{', '.join(channels) or 'no signal'}: its shape is {x.shape}"
        )
    return x


def _spread(x, batch):
    if x.shape[:-2] == batch:
        return x
    return (
        np.broadcast_to(np.asarray(x), batch + x.shape[-2:])
        if not isinstance(x, jax.core.Tracer)
        else jax.numpy.broadcast_to(x, batch + x.shape[-2:])
    )
