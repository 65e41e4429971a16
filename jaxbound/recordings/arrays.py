"""Arrays of floats out of what holds them: tables by the names of their columns, masked and null samples as
NaN, everything checked.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import jax
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.recordings.expressions import Expression, expression, find_column, is_expression
from jaxbound.recordings.signals import Named
from jaxbound.recordings.table import Data, as_table, is_table
from jaxbound.text.names import listed

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "computed",
    "float_arrays",
    "floats",
    "holds_both",
    "inputs_of",
    "is_made",
    "recorded_type",
    "refuse_infinite",
]


def is_made(data: object) -> bool:
    """Return whether this is a Recording, or the like: it has .u and .y, which are no columns of a table."""
    return not is_table(data) and not isinstance(data, Mapping) and hasattr(data, "u") and hasattr(data, "y")


def holds_both(data: object) -> bool:
    """Return whether one thing has the inputs and the outputs of a recording: a table, or a Recording."""
    return is_made(data) or is_table(as_table(data, "u"))


def inputs_of(model: Named, u: Data, name: str = "u") -> np.ndarray | jax.Array | None:
    """Return inputs alone as an array (..., T, m), as `Recording.of` does; None stays None."""
    u = as_table(u, name, model.inputs)
    if getattr(u, "dtype", None) == np.float16:  # no resolution to be stated: they are what they are
        u = np.asarray(u, np.float64)
    return None if u is None else _columns(model, u, name, model.inputs)


def floats(data: Data, name: str) -> np.ndarray:
    """Return numbers that are no signals of a model as an array of floats: NaN where they are masked, null or
    missing.
    """
    data = as_table(data, name)
    return _plain(data if not hasattr(data, "iloc") else _of_frame(data, name), name)


def float_arrays(model: Named, u: Data, y: Data, narrow: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return u and y as float arrays of one batch that fit the model. See `Recording.of` for `narrow`.

    Raises:
        ValueError: a shape that does not fit the model or the other array, text, half precision.
    """
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
        if dtype != y.dtype and isinstance(y, np.ndarray):
            _warn_rounded(y, dtype)
        y = y if y.dtype == dtype else y.astype(dtype)
        u = u if u.dtype == dtype else u.astype(dtype)
    try:
        batch = np.broadcast_shapes(u.shape[:-2], y.shape[:-2])
    except ValueError:
        raise ValueError(f"the leading axes of u {u.shape} and y {y.shape} do not fit each other") from None
    return _spread(u, batch), _spread(y, batch)


def _warn_rounded(y: np.ndarray, dtype: np.dtype) -> None:
    """Warn that jax runs with x64 off, where that costs precision."""
    with np.errstate(over="ignore"):
        rounded = (y.astype(dtype) != y) & ~np.isnan(y)
    if rounded.any():
        warnings.warn(
            "samples in float64 are rounded to float32, because jax runs with x64 off: verdicts stay proofs, "
            "but every bound grows by "
            "2.4e-07 of the largest sample, and faults below that are not seen. "
            "jax.config.update('jax_enable_x64', True) keeps them; "
            "arrays of float32 say that this is meant",
            stacklevel=2,
        )


def refuse_infinite(name: str, data: ArrayLike, channels: Sequence[str]) -> None:
    """Raise ValueError if a recorded number is infinite."""
    bad = np.isinf(np.asarray(data))
    if bad.any():
        first = np.argwhere(bad)[0]
        raise ValueError(
            f"{name} must be finite (NaN marks a missing sample): {bad.sum()} of {bad.size} numbers are "
            f"infinite, "
            f"first in {channels[first[-1]]!r} at sample {first[-2]}"
        )


def computed(e: Expression, frames: Mapping[str, Any], name: str) -> np.ndarray:
    """Return the values of an Expression over the columns of DataFrames, and over their index by its name."""
    import pandas as pd

    found: dict[str, Any] = {}
    for frame in reversed(list(frames.values())):
        found |= {str(frame.index.name): frame.index.to_series()} | {c: frame[c] for c in frame.columns}
    e = e.among(list(found))
    number = lambda c: _numbers(lambda: found[c].to_numpy(np.float64, na_value=np.nan), name)
    text = lambda c: found[c].astype(object).where(found[c].notna(), None).to_numpy(object)
    dates = {
        c: found[c].to_numpy("datetime64[ns]")
        for c in e.columns
        if pd.api.types.is_datetime64_any_dtype(found[c])
    }
    return e.values(
        {c: dates[c] if c in dates else text(c) if c in e.texts else number(c) for c in e.columns}
    )


def recorded_type(data: object, name: str) -> np.dtype:
    """Return the float type in which data were rounded: float32 if any of it (a column of a DataFrame) is
    that, else float64.

    Raises:
        ValueError: half precision.
    """
    if hasattr(data, "dtypes") and hasattr(data, "iloc"):
        types = list(data.dtypes) if hasattr(data, "columns") else [data.dtypes]
        types = [getattr(t, "numpy_dtype", t) for t in types]  # of pandas' own types
    else:
        types = [data.dtype if hasattr(data, "dtype") else np.asarray(data).dtype]
    if np.float16 in types:
        raise ValueError(
            f"{name} is in half precision: convert it to float32 and state in `resolution` what was rounded "
            f"away"
        )
    return np.dtype(np.float32 if np.float32 in types else np.float64)


def _columns(model: Named, data: Data, name: str, channels: Sequence[str]) -> np.ndarray:
    """Pick the channels of a DataFrame by name; turn anything else into an array of floats."""
    if not is_table(data):
        return _plain(_of_frame(data, name) if hasattr(data, "iloc") else data, name)
    column = getattr(model, "column", lambda channel: channel)
    present, taken, whole, sources = list(data.columns), {}, data, []
    for channel in channels:
        if is_expression(text := column(channel)) and channel not in present:
            taken[channel] = computed(expression(text), {"": data}, name)
            sources += [c for c in expression(text).among(present).columns if c in present]
    if taken:
        data = data.assign(**taken)
        present = list(data.columns)
    stripped = {str(c).strip() for c in present}
    wanted = [c if c in taken or column(c).strip() not in stripped else column(c) for c in channels]
    wanted = [find_column(c, present, name) for c in wanted]
    recorded = recorded_type(
        whole[[*(c for c in wanted if c not in taken), *sources]], name
    )  # of one column, if of any
    found = _plain(_of_frame(data[wanted], name), name)
    return (
        found.astype(recorded, copy=False) if name == "y" else found
    )  # what was rounded away counts in the type it was recorded in


def _of_frame(data: "pd.DataFrame", name: str) -> np.ndarray:
    plain = data.to_numpy()
    return (
        plain
        if plain.dtype != object
        else _numbers(partial(data.to_numpy, dtype=np.float64, na_value=np.nan), name)
    )


def _plain(data: Data, name: str) -> np.ndarray:
    """Return an array of floats, NaN where it was masked."""
    if isinstance(data, jax.Array):
        if not np.issubdtype(data.dtype, np.floating):
            data = data.astype(float)
        return cast(np.ndarray, data)  # an array of JAX stays one
    mask = np.ma.getmask(data) if isinstance(data, np.ma.MaskedArray) else np.ma.nomask
    data = np.asarray(data)
    if data.dtype == np.float16:
        raise ValueError(
            f"{name} is in half precision: convert it to float32 and state in `resolution` what was rounded "
            f"away"
        )
    if np.iscomplexobj(data) or data.dtype.kind in "mM":
        raise ValueError(
            f"{name} must be numbers, not {'complex ones' if np.iscomplexobj(data) else 'times'}"
        )
    if not np.issubdtype(data.dtype, np.floating) or data.dtype.itemsize > 8:
        data = _numbers(lambda: data.astype(np.float64), name)
    if not data.dtype.isnative:  # of a file from another kind of machine
        data = data.astype(data.dtype.newbyteorder("="))
    return data if mask is np.ma.nomask else np.where(mask, np.array(np.nan, data.dtype), data)


def _numbers(convert: Callable[[], np.ndarray], name: str) -> np.ndarray:
    try:
        return convert()
    except (ValueError, TypeError) as e:
        raise ValueError(f"{name} must be numbers, NaN where a sample is missing: {e}") from None


def _channels(x: np.ndarray, name: str, channels: Sequence[str]) -> np.ndarray:
    if x.ndim == 1 and len(channels) == 1:
        x = x[:, None]
    if x.ndim < 2 or x.shape[-1] != len(channels):
        raise ValueError(
            f"{name} must have shape (..., T, {len(channels)}), time first, one column for each of "
            f"{', '.join(channels) or 'no signal'}: its shape is {x.shape}"
        )
    return x


def _spread(x: np.ndarray, batch: tuple[int, ...]) -> np.ndarray:
    if x.shape[:-2] == batch:
        return x
    return (
        np.broadcast_to(np.asarray(x), batch + x.shape[-2:])
        if not isinstance(x, jax.core.Tracer)
        else jax.numpy.broadcast_to(x, batch + x.shape[-2:])
    )
