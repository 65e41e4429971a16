"""Recordings at the door: arrays or DataFrames in, checked arrays out."""

import difflib

import jax
import numpy as np

__all__ = ["arrays", "missing_column", "refuse_infinite"]


def arrays(model, u, y):
    """Return (u, y, index): float arrays (..., T, m) and (..., T, p) of one dtype, and the index of a DataFrame or None.

    Integers become floats; a float64 recording becomes float32 where jax runs with x64 off (the proof counts that rounding).
    Tracers and jax arrays stay what they are.

    Raises:
        ValueError: a column that is not there, text, a shape that does not fit the model or the other array.
    """
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
    return _spread(u, batch), _spread(y, batch), index


def missing_column(wanted, present, where):
    """Return the sentence for a column that is not there, with the nearest name."""
    near = difflib.get_close_matches(wanted, list(map(str, present)), n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"{where} has no column {wanted!r}{hint} It has {', '.join(repr(str(c)) for c in present)}." if hint else (
        f"{where} has no column {wanted!r}: it has {', '.join(repr(str(c)) for c in present)}")  # fmt: skip


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
    if hasattr(data, "columns") and hasattr(data, "iloc"):
        present = list(data.columns)
        wanted = [model.column(c) if model.column(c) in present else c for c in channels]
        for c in wanted:
            if c not in present:
                raise ValueError(missing_column(c, present, name))
            if present.count(c) > 1:
                raise ValueError(f"{name} has {present.count(c)} columns {c!r}: a signal needs exactly one")
        data = data[wanted]
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
        return data if data.dtype.itemsize <= 8 else data.astype(np.float64)
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
