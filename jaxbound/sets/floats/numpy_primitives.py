"""The primitives of JAX in NumPy: each rounds once, as IEEE 754 says, and nothing fuses, reorders or copies them.

A primitive is looked up by its name. Its entry takes the parameters of an equation and returns a function of arrays. What `sets` states
of rounding holds here too: a bound that allows any compiler its choices allows NumPy's, which makes none.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

__all__ = ["PRIMITIVES", "primitive"]

Function = Callable[..., Any]

PRIMITIVES: dict[str, Callable[[dict], Function]] = {}
"""{name of a primitive: of the parameters of an equation, the function of arrays that it stands for}."""


def primitive(name: str, params: dict) -> Function:
    """Return a primitive as a function of NumPy arrays.

    Raises:
        NotImplementedError: it has no entry here.
    """
    if name not in PRIMITIVES:
        raise NotImplementedError(f"the primitive {name} of JAX is not written in NumPy")
    return PRIMITIVES[name](params)


def _entry(*names: str) -> Callable:
    def register(make):
        for name in names:
            PRIMITIVES[name] = make
        return make

    return register


def _plain(**functions: Function) -> None:
    """Register functions of arrays without parameters."""
    for name, function in functions.items():
        PRIMITIVES[name] = partial(_ignoring, function)


def _ignoring(function, params):
    return function


def _identity(x):
    return x


def _several(*arrays):
    return arrays


def _select(which, *cases):
    if which.dtype == bool:
        return np.where(which, cases[1], cases[0])
    return np.choose(which, cases)


def _quotient(x, y):
    if np.issubdtype(x.dtype, np.integer):
        return np.asarray(np.trunc(np.true_divide(x, np.where(y == 0, 1, y))), x.dtype)
    return np.divide(x, y)


def _reciprocal_root(x):
    return np.asarray(1, x.dtype) / np.sqrt(x)


def _logistic(x):
    one = np.asarray(1, x.dtype)
    return one / (one + np.exp(-x))


def _shifted_right(x, by):
    unsigned = x.view(f"u{x.dtype.itemsize}")
    return (unsigned >> by.astype(unsigned.dtype)).view(x.dtype)


def _bits_set(x):
    return np.bitwise_count(x.view(f"u{x.dtype.itemsize}")).astype(x.dtype)


_plain(
    add=np.add, add_any=np.add, sub=np.subtract, mul=np.multiply, div=_quotient, rem=np.fmod, neg=np.negative, sign=np.sign,
    abs=np.absolute, max=np.maximum, min=np.minimum, floor=np.floor, ceil=np.ceil, sqrt=np.sqrt, rsqrt=_reciprocal_root, cbrt=np.cbrt,
    square=np.square, exp=np.exp, exp2=np.exp2, expm1=np.expm1, log=np.log, log1p=np.log1p, sin=np.sin, cos=np.cos, tan=np.tan,
    asin=np.arcsin, acos=np.arccos, atan=np.arctan, atan2=np.arctan2, sinh=np.sinh, cosh=np.cosh, tanh=np.tanh, asinh=np.arcsinh,
    acosh=np.arccosh, atanh=np.arctanh, pow=np.power, nextafter=np.nextafter, logistic=_logistic, is_finite=np.isfinite,
    eq=np.equal, ne=np.not_equal, lt=np.less, le=np.less_equal, gt=np.greater, ge=np.greater_equal, select_n=_select,
    shift_left=np.left_shift, shift_right_logical=_shifted_right, shift_right_arithmetic=np.right_shift, population_count=_bits_set,
    real=np.real, imag=np.imag, conj=np.conj, copy=_identity, copy_p=_identity, stop_gradient=_identity,
    optimization_barrier=_several, device_put=_several,
)  # fmt: skip
PRIMITIVES["and"] = partial(_ignoring, np.bitwise_and)
PRIMITIVES["or"] = partial(_ignoring, np.bitwise_or)
PRIMITIVES["xor"] = partial(_ignoring, np.bitwise_xor)
PRIMITIVES["not"] = partial(_ignoring, np.invert)


@_entry("clamp")
def _clamp(params):
    return lambda lo, x, hi: np.minimum(np.maximum(x, lo), hi)


@_entry("complex")
def _complex(params):
    def joined(re, im):
        out = np.empty(np.broadcast_shapes(re.shape, im.shape), np.result_type(re.dtype, np.complex64))
        out.real, out.imag = re, im
        return out

    return joined


@_entry("round")
def _round(params):
    if int(params["rounding_method"]) == 1:
        return np.rint
    return lambda x: np.trunc(x + np.copysign(np.asarray(0.5, x.dtype), x))


@_entry("integer_pow")
def _integer_pow(params):
    return partial(_powered, abs(params["y"]), params["y"] < 0)


def _powered(y, inverted, x):
    """Return x ** y by squares and products, as XLA writes it."""
    out, square = None, x
    while y:
        if y & 1:
            out = square if out is None else out * square
        y >>= 1
        if y:
            square = square * square
    out = np.ones_like(x) if out is None else out
    return np.asarray(1, x.dtype) / out if inverted else out


@_entry("convert_element_type")
def _converted(params):
    return partial(_cast, np.dtype(params["new_dtype"]))


def _cast(dtype, x):
    if x.dtype == dtype:
        return x
    if x.dtype.kind == "f" and dtype.kind in "iu":  # XLA takes the nearest end where NumPy wraps around; NaN is 0
        ends = np.iinfo(dtype)
        inside = np.clip(np.nan_to_num(x, nan=0.0), float(ends.min), float(ends.max))
        out = inside.astype(np.float64).astype(dtype)
        return np.where(x >= float(ends.max), ends.max, np.where(x <= float(ends.min), ends.min, out)).astype(dtype)
    return x.astype(dtype)


@_entry("bitcast_convert_type")
def _bitcast(params):
    return lambda x: np.ascontiguousarray(x).view(params["new_dtype"]).reshape(x.shape)


@_entry("reduce_precision")
def _reduced_precision(params):
    whole = (params["exponent_bits"], params["mantissa_bits"]) in ((8, 23), (11, 52))
    if not whole:
        raise NotImplementedError("reduce_precision to other than float32 and float64 is not written in NumPy")
    return _identity


@_entry("iota")
def _iota(params):
    shape, dimension = params["shape"], params["dimension"]
    along = np.arange(shape[dimension], dtype=params["dtype"])
    along = along.reshape([-1 if i == dimension else 1 for i in range(len(shape))])
    return lambda: np.broadcast_to(along, shape)


@_entry("platform_index")
def _platform(params):
    """Return the branch of a CPU, or the one for all that is not named."""
    index = next(i for i, names in enumerate(params["platforms"]) if names is None or "cpu" in names)
    return lambda: np.asarray(index, np.int32)


@_entry("broadcast_in_dim")
def _broadcast(params):
    shape, dimensions = params["shape"], params["broadcast_dimensions"]
    if not shape:
        return _identity
    in_place = tuple(dimensions) == tuple(range(len(shape)))

    def broadcast(x):
        if x.ndim and not in_place:
            x = x.reshape([x.shape[dimensions.index(i)] if i in dimensions else 1 for i in range(len(shape))])
        if x.shape == shape:
            return x
        return np.broadcast_to(x, shape)

    return broadcast


@_entry("reshape")
def _reshaped(params):
    shape = params["new_sizes"]
    return lambda x: x.reshape(shape)


@_entry("squeeze")
def _squeezed(params):
    return lambda x: x.squeeze(tuple(params["dimensions"]))


@_entry("expand_dims")
def _expanded(params):
    return lambda x: np.expand_dims(x, tuple(params["dimensions"]))


@_entry("transpose")
def _transposed(params):
    return lambda x: x.transpose(params["permutation"])


@_entry("rev")
def _reversed(params):
    return lambda x: np.flip(x, params["dimensions"])


@_entry("concatenate")
def _concatenated(params):
    return lambda *parts: np.concatenate(parts, params["dimension"])


@_entry("stack")
def _stacked(params):
    return lambda *parts: np.stack(parts, params["axis"])


@_entry("tile")
def _tiled(params):
    return lambda x: np.tile(x, params["reps"])


@_entry("split")
def _split(params):
    ends = np.cumsum(params["sizes"])[:-1]
    return lambda x: np.split(x, ends, params["axis"])


@_entry("pad")
def _padded(params):
    def padded(x, value):
        shape, source, place = [], [], []
        for n, (low, high, between) in zip(x.shape, params["padding_config"], strict=True):
            shape.append(low + high + n + max(n - 1, 0) * between)
            at = low + (between + 1) * np.arange(n)
            kept = (at >= 0) & (at < shape[-1])
            source.append(np.flatnonzero(kept))
            place.append(at[kept])
        out = np.full(shape, value, x.dtype)
        out[np.ix_(*place)] = x[np.ix_(*source)]
        return out

    return padded


@_entry("slice")
def _sliced(params):
    first, stop = params["start_indices"], params["limit_indices"]
    steps = params["strides"] or (1,) * len(first)
    where = tuple(map(slice, first, stop, steps))
    return lambda x: x[where]


def _corner(starts, shape, sizes):
    """Return the slices of a part of an array, moved inside where it begins outside."""
    firsts = [min(max(int(at), 0), n - size) for at, n, size in zip(starts, shape, sizes, strict=True)]
    return tuple(slice(at, at + size) for at, size in zip(firsts, sizes, strict=True))


@_entry("dynamic_slice")
def _dynamic_slice(params):
    sizes = params["slice_sizes"]
    return lambda x, *starts: x[_corner(starts, x.shape, sizes)]


@_entry("dynamic_update_slice")
def _dynamic_update_slice(params):
    def updated(x, part, *starts):
        out = np.array(x)
        out[_corner(starts, x.shape, part.shape)] = part
        return out

    return updated


@_entry("sort")
def _sorted(params):
    axis, keys = params["dimension"], params["num_keys"]

    def sort(*arrays):
        if len(arrays) == 1:
            return (np.sort(arrays[0], axis, kind="stable"),)
        order = np.argsort(arrays[keys - 1], axis, kind="stable")
        for key in reversed(arrays[: keys - 1]):
            again = np.argsort(np.take_along_axis(key, order, axis), axis, kind="stable")
            order = np.take_along_axis(order, again, axis)
        return tuple(np.take_along_axis(x, order, axis) for x in arrays)

    return sort


@_entry("argmax")
def _argmax(params):
    (axis,) = params["axes"]
    return lambda x: np.argmax(x, axis).astype(params["index_dtype"])


@_entry("argmin")
def _argmin(params):
    (axis,) = params["axes"]
    return lambda x: np.argmin(x, axis).astype(params["index_dtype"])


def _reduction(function: Any) -> Callable[[dict], Function]:
    def make(params):
        axes = tuple(params["axes"])
        return lambda x: function.reduce(x, axis=axes, dtype=x.dtype)

    return make


def _extreme(function: Any, end: str) -> Callable[[dict], Function]:
    def make(params):
        axes = tuple(params["axes"])

        def reduced(x):
            if x.size:
                return function.reduce(x, axis=axes)
            limits = np.finfo(x.dtype) if x.dtype.kind == "f" else np.iinfo(x.dtype)
            nothing = getattr(limits, end)
            return np.full(np.delete(x.shape, axes), np.copysign(np.inf, nothing) if x.dtype.kind == "f" else nothing, x.dtype)

        return reduced

    return make


PRIMITIVES["reduce_sum"] = _reduction(np.add)
PRIMITIVES["reduce_prod"] = _reduction(np.multiply)
PRIMITIVES["reduce_and"] = _reduction(np.bitwise_and)
PRIMITIVES["reduce_or"] = _reduction(np.bitwise_or)
PRIMITIVES["reduce_xor"] = _reduction(np.bitwise_xor)
PRIMITIVES["reduce_max"] = _extreme(np.maximum, "min")
PRIMITIVES["reduce_min"] = _extreme(np.minimum, "max")


def _running(function: Any) -> Callable[[dict], Function]:
    def make(params):
        axis = params["axis"]
        if params["reverse"]:
            return lambda x: np.flip(function.accumulate(np.flip(x, axis), axis, dtype=x.dtype), axis)
        return lambda x: function.accumulate(x, axis, dtype=x.dtype)

    return make


PRIMITIVES["cumsum"] = _running(np.add)
PRIMITIVES["cumprod"] = _running(np.multiply)
PRIMITIVES["cummax"] = _running(np.maximum)
PRIMITIVES["cummin"] = _running(np.minimum)


@_entry("dot_general")
def _dot_general(params):
    (across_x, across_y), (batch_x, batch_y) = params["dimension_numbers"]

    def product(x, y):
        free_x = [i for i in range(x.ndim) if i not in (*across_x, *batch_x)]
        free_y = [i for i in range(y.ndim) if i not in (*across_y, *batch_y)]
        size = lambda a, dims: math.prod(a.shape[i] for i in dims)
        batch = [x.shape[i] for i in batch_x]
        left = x.transpose(*batch_x, *free_x, *across_x).reshape(*batch, size(x, free_x), size(x, across_x))
        right = y.transpose(*batch_y, *across_y, *free_y).reshape(*batch, size(y, across_y), size(y, free_y))
        out = np.matmul(left, right)
        out = out.reshape(*batch, *(x.shape[i] for i in free_x), *(y.shape[i] for i in free_y))
        wanted = params["preferred_element_type"]
        return out if wanted is None else out.astype(wanted, copy=False)

    return product


@_entry("gather")
def _gather(params):
    numbers, sizes, mode = params["dimension_numbers"], params["slice_sizes"], str(params["mode"])

    def gathered(x, indices):
        at, outside = _places(x.shape, indices, numbers.start_index_map, numbers.operand_batching_dims,
                              numbers.start_indices_batching_dims, numbers.collapsed_slice_dims, sizes)  # fmt: skip
        found = x[at]
        lead = indices.ndim - 1
        if "FILL" in mode and outside.any():
            fill = params["fill_value"]
            if fill is None:
                fill = np.nan if x.dtype.kind == "f" else 0
            gone = outside.reshape(*outside.shape, *(1,) * (found.ndim - lead))
            found = np.where(gone, np.asarray(fill, x.dtype), found)
        batch = iter(range(lead))
        rest = iter(range(lead, found.ndim))
        return found.transpose([next(rest) if i in numbers.offset_dims else next(batch) for i in range(found.ndim)])

    return gathered


def _places(shape, indices, index_map, operand_batch, index_batch, left_out, sizes):
    """Return (index arrays of the parts of an array that start at `indices`, which of these starts lie outside)."""
    lead = indices.shape[:-1]
    kept = [i for i in range(len(shape)) if i not in (*left_out, *operand_batch)]
    outside = np.zeros(lead, bool)
    at = []
    for axis, (n, size) in enumerate(zip(shape, sizes, strict=True)):
        if axis in operand_batch:
            along = index_batch[operand_batch.index(axis)]
            start = np.arange(n).reshape([-1 if i == along else 1 for i in range(len(lead))])
        elif axis in index_map:
            start = indices[..., index_map.index(axis)].astype(np.int64)
            outside |= (start < 0) | (start > n - size)
            start = np.clip(start, 0, n - size)
        else:
            start = np.zeros((1,) * len(lead), np.int64)
        start = start.reshape(*start.shape, *(1,) * len(kept))
        if axis in kept:
            start = start + np.arange(size).reshape([-1 if i == axis else 1 for i in kept])
        at.append(start)
    return tuple(at), outside


def _scattered(combine: Function) -> Callable[[dict], Function]:
    def make(params):
        numbers, mode = params["dimension_numbers"], str(params["mode"])

        def scattered(x, indices, updates):
            out, lead = np.array(x), indices.ndim - 1
            windows = [i for i in range(updates.ndim) if i in numbers.update_window_dims]
            batch = [i for i in range(updates.ndim) if i not in windows]
            updates = updates.transpose(*batch, *windows)
            lengths = iter(updates.shape[lead:])
            gone = (*numbers.inserted_window_dims, *numbers.operand_batching_dims)
            sizes = [1 if i in gone else next(lengths) for i in range(x.ndim)]
            at, outside = _places(x.shape, indices, numbers.scatter_dims_to_operand_dims, numbers.operand_batching_dims,
                                  numbers.scatter_indices_batching_dims, numbers.inserted_window_dims, sizes)  # fmt: skip
            if "CLIP" not in mode and outside.any():
                inside = ~outside
                at = tuple(np.broadcast_to(i, updates.shape)[inside] for i in at)
                updates = updates[inside]
            combine(out, at, updates)
            return out

        return scattered

    return make


def _assign(out, at, updates):
    out[at] = updates


PRIMITIVES["scatter"] = _scattered(_assign)
PRIMITIVES["scatter-add"] = PRIMITIVES["scatter_add"] = _scattered(np.add.at)
PRIMITIVES["scatter-mul"] = PRIMITIVES["scatter_mul"] = _scattered(np.multiply.at)
PRIMITIVES["scatter-min"] = PRIMITIVES["scatter_min"] = _scattered(np.minimum.at)
PRIMITIVES["scatter-max"] = PRIMITIVES["scatter_max"] = _scattered(np.maximum.at)
