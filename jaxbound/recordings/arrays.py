"""Arrays of floats out of what holds them: tables by the names of their columns, masked and null samples as
NaN, everything checked.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

import jax
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.recordings.csvtext import BLANK_CELLS
from jaxbound.recordings.expressions import Expression, derived, expression, fails
from jaxbound.recordings.factors import (
    Factor,
    by_name,
    factors_of,
    followed_by,
    known,
    masked,
    narrowed,
    with_factors,
)
from jaxbound.recordings.notations import noted_numbers
from jaxbound.recordings.oddcells import (
    OddCells,
    error_hints,
    odd_of_frame,
    refuse_odd,
    texts_of_frame,
    unsaid_hints,
)
from jaxbound.recordings.recordingformat import format_of
from jaxbound.recordings.selection import Column, column_for, expressions_of, period
from jaxbound.recordings.signals import Named
from jaxbound.recordings.table import Data, as_table, is_table
from jaxbound.recordings.tabletime import row_time
from jaxbound.text.names import listed
from jaxbound.text.warned import warn_once

if TYPE_CHECKING:
    import pandas as pd

NO_TABLES: Mapping[str, Any] = MappingProxyType({})
HALF = "{} is in half precision: convert it to float32 and state in `resolution` what was rounded away"


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
    if u is None:
        return None
    return _signals_by_name(model, u, name, model.inputs)


def float_array(data: Data, name: str) -> np.ndarray:
    """Return numbers that are no signals of a model as an array of floats: NaN where they are masked, null or
    missing.
    """
    return _without_names(as_table(data, name), name)


def float_arrays(
    model: Named,
    u: Data,
    y: Data,
    narrow: bool,
    tables: Mapping[str, Any] = NO_TABLES,
    excluded: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return u and y as float arrays of one batch that fit the model, with its factors behind the inputs. See
    `Recording.of` for `narrow`.

    Args:
        tables: DataFrames, by their columns factors are worked out. excluded: (T,) bool, samples that do not
            count, or None.

    Raises:
        ValueError: a shape that does not fit the model or the other array, text, half precision, a factor
            that is none.
    """
    y = _channels(_signals_by_name(model, y, "y", model.outputs), "y", model.outputs)
    if u is not None:
        u = _signals_by_name(model, u, "u", model.inputs)
    elif model.inputs:
        raise ValueError(f"u is missing: the model has the inputs {listed(model.inputs, str)}")
    else:
        u = np.zeros((*y.shape[:-1], 0), y.dtype)
    columns, own = model.inputs, known(model)
    if u.ndim > 1 and u.shape[-1] == len(own):
        columns = own
    u = _channels(u, "u", columns)
    if u.shape[-2] != y.shape[-2]:
        raise ValueError(f"u and y must have the same number of samples: {u.shape[-2]} and {y.shape[-2]}")
    if factors_of(model):
        u, y = _factored(model, u, y, tables, excluded)
    if narrow:
        dtype = jax.dtypes.canonicalize_dtype(y.dtype)
        if dtype != y.dtype and isinstance(y, np.ndarray):
            _warn_rounded(y, dtype)
        u, y = narrowed(model, u, dtype), y.astype(dtype, copy=False)
    try:
        batch = np.broadcast_shapes(u.shape[:-2], y.shape[:-2])
    except ValueError:
        raise ValueError(f"the leading axes of u {u.shape} and y {y.shape} do not fit each other") from None
    return _with_batch(u, batch), _with_batch(y, batch)


def _factored(
    model: Named, u: np.ndarray, y: np.ndarray, tables: Mapping[str, Any], excluded: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return (u, y) with the factors of a model behind its inputs, where they are not there already."""
    m = len(model.inputs)
    if u.shape[-1] > m:
        followed_by(model, u)
        return u, masked(model, u, y)
    if isinstance(u, jax.core.Tracer) or isinstance(y, jax.core.Tracer):
        raise ValueError(
            "factors on noise are worked out on the host: inside jit, vmap or grad give u with the factors "
            "behind its inputs, as Recording.of(model, u, y).u has them"
        )
    u, y = np.asarray(u), np.asarray(y)
    if tables:
        inputs = by_name(model, u)
        values = [computed(x.expression, tables, "the recording", model, inputs) for x in factors_of(model)]
    else:
        for factor in factors_of(model):
            _refuse_columns(model, factor)
        values = [factor.expression.values(by_name(model, u)) for factor in factors_of(model)]
    if excluded is not None:
        values = [np.where(excluded, np.nan, x) for x in values]
    return with_factors(model, u, y, values)


def _refuse_columns(model: Named, factor: Factor) -> None:
    """Raise ValueError for a factor that needs more than the inputs of a model: arrays have no columns."""
    others = [name for name in factor.expression.columns if name not in model.inputs]
    if others:
        raise ValueError(
            f"{factor.about}, and arrays have no column {listed(others)}: give a table or a file, or u with "
            f"the factors behind its inputs"
        )


def _warn_rounded(y: np.ndarray, dtype: np.dtype) -> None:
    """Warn that jax runs with x64 off, where that costs precision."""
    with np.errstate(over="ignore"):
        rounded = (y.astype(dtype) != y) & ~np.isnan(y)
    if rounded.any():
        warn_once(
            "samples in float64 are rounded to float32, because jax runs with x64 off: verdicts stay proofs, "
            "but every bound grows by "
            "2.4e-07 of the largest sample, and faults below that are not seen. "
            "jax.config.update('jax_enable_x64', True) keeps them; "
            "arrays of float32 say that this is meant"
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


def computed(
    e: Expression,
    frames: Mapping[str, Any],
    name: str,
    model: Named,
    given: Mapping[str, np.ndarray] = NO_TABLES,
) -> np.ndarray:
    """Return the values of an Expression over the columns of DataFrames, and over their index by its name.

    Args:
        given: {name: floats}, which go before columns of the same name.
    """
    names = [*given]
    for frame in frames.values():
        names += [*frame.columns, str(frame.index.name)]
    return _values(e.among(list(dict.fromkeys(names))), frames, name, model, given)


def _values(
    e: Column | Expression,
    frames: Mapping[str, Any],
    name: str,
    model: Named,
    given: Mapping[str, np.ndarray] = NO_TABLES,
) -> np.ndarray:
    """Return the values of a signal, whose columns are called as they are in the tables; see `computed`."""
    values: dict[str, np.ndarray] = {}
    if e.clock:
        values |= _told_by_clock(e, frames, model)
    for column in e.read:
        if column in given:
            values[column] = given[column]
            continue
        cells = _cells_of(column, frames)
        if cells.dtype.kind == "M":
            values[column] = cells.to_numpy("datetime64[ns]")
        elif column in e.texts:
            values[column] = cells.astype(object).where(cells.notna(), None).to_numpy(object)
        else:
            values[column] = _without_names(cells, name)
    return e.values(values)


def _cells_of(column: str, frames: Mapping[str, Any]) -> "pd.Series":
    """Return a column of the first table that has it, else an index of this name."""
    for frame in frames.values():
        if column in frame.columns:
            cells: pd.Series = frame[column]
            return cells
    return next(x.index.to_series() for x in frames.values() if str(x.index.name) == column)


def _told_by_clock(e: Column | Expression, frames: Mapping[str, Any], model: Named) -> dict[str, np.ndarray]:
    """Return the names that the times of the rows tell, see `expressions.derived`."""
    index = next(iter(frames.values())).index
    times = row_time(index, None, "", regular=False)
    since = times.time
    if since is not None and len(since):
        since = since - since[0]
    return derived(e.clock, len(index), since, times.stamps, period(model, since))


def without_words(model: Named, u: Data, y: Data) -> tuple[Data, Data, np.ndarray | None, list[str]]:
    """Return (u, y, excluded, sentences): tables with missing samples in the place of words; (T,) bool, the
    samples that the model's `where` leaves out by them, None where it has none or there is no table.

    Raises:
        ValueError: a word, no error of a spreadsheet, in a row that is not left out.
    """
    cleaned = {name: x for name, x in (("y", y), ("u", u)) if is_table(x)}
    odd: dict[str, OddCells] = {}
    how, hints = format_of(model), []
    for name, frame in cleaned.items():
        for column in _number_columns(frame, model) if how.numbers else ():
            known = frame[column].mask(frame[column].isin(how.numbers))
            cleaned[name] = cleaned[name].assign(**{column: known})
        for column in _text_columns(frame, model):
            column_cells = cleaned[name][column].astype(object)  # categories of text are text
            numbers, cells = odd_of_frame(column_cells)
            if how.decimal == "," or how.thousands:  # pandas reads 35.010 as decimals all the same
                cells = texts_of_frame(column_cells)
            if not len(cells.rows):
                continue
            cells = cells.without((*BLANK_CELLS, *how.missing))
            errors = cells.among(None, errors=True)
            if len(errors.rows) < len(cells.rows):
                noted = noted_numbers(column_cells.tolist(), how)
                if noted is not None:
                    numbers, cells = noted[0], errors
                    hint = f"column {column!r} is read as written, like {noted[1]}"
                    hints += [hint] * (hint not in hints)  # u and y may be one table
            odd[column] = cells
            cleaned[name] = cleaned[name].assign(**{column: numbers})
    condition, excluded, row = _condition(model), None, "row {}".format
    if condition is not None and cleaned:
        excluded = fails(computed(condition, cleaned, "the recording", model))
    refuse_odd(odd, excluded, row)
    hints += error_hints(odd, excluded, row)
    if condition is not None:
        hints += unsaid_hints(odd, condition.columns, row)
    return cleaned.get("u", u), cleaned.get("y", y), excluded, hints


def _condition(model: Named) -> Expression | None:
    """Return the condition of a model by which samples are left out, or None."""
    where = getattr(model, "columns", {}).get("where")
    if where is None:
        return None
    return expression(where)


def _text_columns(frame: "pd.DataFrame", model: Named) -> list[str]:
    """Return the columns of a table that hold text and that a model needs as numbers."""
    import pandas as pd

    words = []
    for c, kind in zip(frame.columns, frame.dtypes, strict=True):
        if isinstance(kind, pd.CategoricalDtype):
            kind = kind.categories.dtype
        if kind == np.dtype(object) or pd.api.types.is_string_dtype(kind):
            words.append(c)
    words = [c for c in words if list(frame.columns).count(c) == 1]
    if not words:
        return []
    return [c for c in words if c in _number_columns(frame, model)]


def _number_columns(frame: "pd.DataFrame", model: Named) -> list[str]:
    """Return the columns of a table that a model needs as numbers."""
    signals = (*model.inputs, *model.outputs)
    needed = {*signals, *map(str.strip, map(getattr(model, "column", str), signals))}
    for e in expressions_of(model):
        needed.update(set(e.columns) - e.texts)
    return [c for c in frame.columns if str(c).strip() in needed]


def _signals_by_name(model: Named, data: Data, name: str, channels: Sequence[str]) -> np.ndarray:
    """Pick the channels of a DataFrame by name; turn anything else into an array of floats.

    Outputs get the type in which they were recorded, float32 if any column of them is that, else float64:
    what was rounded away counts in it.
    """
    if not is_table(data):
        return _without_names(data, name)
    names, numbers = list(data.columns), []
    if data.index.name not in (None, *names):
        names.append(data.index.name)
    recorded: np.dtype = np.dtype(np.float64)
    for channel in channels:
        signal = column_for(channel, names, model, name)
        numbers.append(_float_array(_values(signal, {"": data}, name, model), name))
        for column in signal.read:
            kind = _cells_of(column, {"": data}).dtype
            if getattr(kind, "numpy_dtype", kind) == np.float32:  # of pandas' own types
                recorded = np.dtype(np.float32)
    if not numbers:
        return np.zeros((len(data), 0))
    table = np.stack(numbers, -1)
    return table.astype(recorded, copy=False) if name == "y" else table


def _without_names(data: Data, name: str) -> np.ndarray:
    """Return an array of floats of a table, or of what has no names of columns."""
    if hasattr(data, "iloc"):
        data = _of_frame(data, name)
    return _float_array(data, name)


def _of_frame(data: "pd.DataFrame", name: str) -> np.ndarray:
    plain: np.ndarray = data.to_numpy()
    if plain.dtype != object:
        return plain
    return _converted(partial(data.to_numpy, dtype=np.float64, na_value=np.nan), name)


def _float_array(data: Data, name: str) -> np.ndarray:
    """Return an array of floats, NaN where it was masked."""
    if isinstance(data, jax.Array):
        if not np.issubdtype(data.dtype, np.floating):
            data = data.astype(float)
        return cast(np.ndarray, data)  # an array of JAX stays one
    x = np.asarray(data)
    if x.dtype == np.float16:
        raise ValueError(HALF.format(name))
    if np.iscomplexobj(x):
        raise ValueError(f"{name} must be numbers, not complex ones")
    if x.dtype.kind in "mM":
        raise ValueError(f"{name} must be numbers, not times")
    if not np.issubdtype(x.dtype, np.floating) or x.dtype.itemsize > 8:
        x = _converted(partial(x.astype, np.float64), name)
    if not x.dtype.isnative:  # of a file from another kind of machine
        x = x.astype(x.dtype.newbyteorder("="))
    if isinstance(data, np.ma.MaskedArray) and np.ma.getmask(data) is not np.ma.nomask:
        return np.where(np.ma.getmask(data), np.array(np.nan, x.dtype), x)
    return x


def _converted(convert: Callable[[], np.ndarray], name: str) -> np.ndarray:
    try:
        return convert()
    except (ValueError, TypeError, OverflowError) as e:
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


def _with_batch(x: np.ndarray, batch: tuple[int, ...]) -> np.ndarray:
    if x.shape[:-2] == batch:
        return x
    if isinstance(x, jax.core.Tracer):
        return jax.numpy.broadcast_to(x, batch + x.shape[-2:])
    return np.broadcast_to(np.asarray(x), batch + x.shape[-2:])
