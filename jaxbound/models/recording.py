"""Recordings at the door: arrays or DataFrames in, checked arrays out."""

import jax
import numpy as np

from jaxbound.models.expressions import expression, fails, find_column, is_expression, missing_column

__all__ = ["arrays", "left_out", "missing_column", "recorded_type", "refuse_infinite"]


def arrays(model, u, y, excluded=None):
    """Return (u, y, index): float arrays (..., T, m) and (..., T, p) of one dtype, and the index of a DataFrame or None.

    Integers become floats; a float64 recording becomes float32 where jax runs with x64 off (the proof counts that rounding).
    Tracers and jax arrays stay what they are. excluded: from `left_out`, by whoever takes care of the windows with such samples.

    Raises:
        ValueError: a column that is not there, text, a shape that does not fit the model or the other array; DataFrames for a model with
            a condition on its samples that nobody takes care of.
    """
    if excluded is None and _frames(model, u, y):
        raise ValueError(f"the model counts only samples with {model.columns['where']!r}, which only detect and margins look at in a "
                         "DataFrame: give arrays of those samples")  # fmt: skip
    index = getattr(y, "index", None) if hasattr(y, "columns") or hasattr(y, "iloc") else None
    y = _columns(model, y, "y", model.outputs)
    u = _columns(model, u, "u", model.inputs) if u is not None else None
    if u is None:
        if model.m:
            raise ValueError(f"u is missing: the model has the inputs {', '.join(model.inputs)}")
        u = np.zeros((*y.shape[:-1], 0), y.dtype)
    y = _channels(y, "y", model.outputs)
    u = _channels(u, "u", model.inputs)
    if u.shape[-2] != y.shape[-2]:
        raise ValueError(f"u and y must have the same number of samples: {u.shape[-2]} and {y.shape[-2]}")
    dtype = jax.dtypes.canonicalize_dtype(y.dtype)
    y = y if y.dtype == dtype else y.astype(dtype)
    u = u if u.dtype == dtype else u.astype(dtype)
    try:
        batch = np.broadcast_shapes(u.shape[:-2], y.shape[:-2])
    except ValueError:
        raise ValueError(f"the leading axes of u {u.shape} and y {y.shape} do not fit each other") from None
    if excluded is not None:
        u, y = (np.where(excluded[:, None], np.array(np.nan, dtype), x) for x in (u, y))
    return _spread(u, batch), _spread(y, batch), index


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


def left_out(model, u, y):
    """Return (T,) bool: samples of DataFrames that the model's `where` leaves out. None: it has none, or u and y are arrays.

    Raises:
        ValueError: a column of the condition is in neither DataFrame.
    """
    frames = _frames(model, u, y)
    return fails(_computed(expression(model.columns["where"]), frames, "the recording")) if frames else None


def _frames(model, u, y):
    """Return the DataFrames among u and y in which the condition of the model is to be looked at."""
    condition = "where" in getattr(model, "columns", {})
    return {name: x for name, x in (("y", y), ("u", u)) if condition and hasattr(x, "columns") and hasattr(x, "iloc")}


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


def refuse_infinite(name, data, channels):
    """Raise ValueError if a recorded number is infinite."""
    bad = np.isinf(np.asarray(data))
    if bad.any():
        first = np.argwhere(bad)[0]
        raise ValueError(
            f"{name} must be finite (NaN marks a missing sample): {bad.sum()} of {bad.size} numbers are infinite, "
            f"first in {channels[first[-1]]!r} at sample {first[-2]}"
        )


def _columns(model, data, name, channels):
    """Pick the channels of a DataFrame by name; turn anything else into an array of floats."""
    recorded = None
    if hasattr(data, "columns") and hasattr(data, "iloc"):
        present, taken, whole, sources = list(data.columns), {}, data, []
        for channel in channels:
            if is_expression(column := model.column(channel)) and channel not in present:
                taken[channel] = _computed(expression(column), {"": data}, name)
                sources += [c for c in expression(column).among(present).columns if c in present]
        if taken:
            data = data.assign(**taken)
            present = list(data.columns)
        stripped = {str(c).strip() for c in present}
        wanted = [c if c in taken or model.column(c).strip() not in stripped else model.column(c) for c in channels]
        wanted = [find_column(c, present, name) for c in wanted]
        data = data[wanted]
        recorded = recorded_type(whole[[*(c for c in wanted if c not in taken), *sources]], name)  # of one column, if of any
    if hasattr(data, "iloc"):
        plain = data.to_numpy()
        data = plain if plain.dtype != object else _numbers(lambda: data.to_numpy(dtype=np.float64, na_value=np.nan), name)
    if isinstance(data, jax.Array):
        return data if np.issubdtype(data.dtype, np.floating) else data.astype(float)
    data = np.asarray(data)
    if data.dtype == np.float16:
        raise ValueError(f"{name} is in half precision: convert it to float32 and state in `resolution` what was rounded away")
    if np.iscomplexobj(data):
        raise ValueError(f"{name} must be numbers, not complex ones")
    if np.issubdtype(data.dtype, np.floating):
        narrow = recorded == np.float32 and name == "y"  # what was rounded away counts in the type it was recorded in
        return data.astype(np.float32 if narrow else data.dtype if data.dtype.itemsize <= 8 else np.float64, copy=False)
    return _numbers(lambda: data.astype(np.float64), name)


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
