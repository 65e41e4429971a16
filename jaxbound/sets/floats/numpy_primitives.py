"""The primitives of JAX that compute, in NumPy: each rounds once, as IEEE 754 says, and nothing fuses or
reorders them.

A primitive is looked up by its name. Its entry takes the parameters of an equation and returns a function of
arrays. What `sets` states of rounding holds here too: a bound that allows any compiler its choices allows
NumPy's, which makes none. Those that move numbers are in `numpy_moves`.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

Function = Callable[..., Any]
Entries = dict[str, Callable[[dict], Function]]
"""{name of a primitive: of the parameters of an equation, the function of arrays that it stands for}."""
COMPUTED: Entries = {}


def entering(table: Entries, name: str) -> Callable:
    """Return a decorator that enters what makes the functions of a primitive into a table."""

    def register(make):
        table[name] = make
        return make

    return register


_entry = partial(entering, COMPUTED)


def _plain(**functions: Function) -> None:
    """Register functions of arrays without parameters."""
    for name, function in functions.items():
        COMPUTED[name] = partial(_ignoring, function)


def _ignoring(function, params):
    return function


def identity(x: np.ndarray) -> np.ndarray:
    """Return x."""
    return x


def _several(*arrays):
    return arrays


def _select(which, *cases):
    if which.dtype.kind == "b":
        return np.where(which, cases[1], cases[0])
    return np.choose(which, cases)


def _quotient(x, y):
    if x.dtype.kind in "iu":
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


SAME = (
    "add cbrt ceil conj cos cosh exp exp2 expm1 floor imag log log1p nextafter real sign sin sinh sqrt "
    "square tan tanh"
)
"""Primitives that have the name of their function of NumPy."""
_plain(**{name: getattr(np, name) for name in SAME.split()})
_plain(
    add_any=np.add,
    sub=np.subtract,
    mul=np.multiply,
    div=_quotient,
    rem=np.fmod,
    neg=np.negative,
    abs=np.absolute,
    max=np.maximum,
    min=np.minimum,
    rsqrt=_reciprocal_root,
    asin=np.arcsin,
    acos=np.arccos,
    atan=np.arctan,
    atan2=np.arctan2,
    asinh=np.arcsinh,
    acosh=np.arccosh,
    atanh=np.arctanh,
    pow=np.power,
    logistic=_logistic,
    clamp=lambda lo, x, hi: np.minimum(np.maximum(x, lo), hi),
    is_finite=np.isfinite,
    eq=np.equal,
    ne=np.not_equal,
    lt=np.less,
    le=np.less_equal,
    gt=np.greater,
    ge=np.greater_equal,
    select_n=_select,
    shift_left=np.left_shift,
    shift_right_logical=_shifted_right,
    shift_right_arithmetic=np.right_shift,
    population_count=_bits_set,
    copy=identity,
    copy_p=identity,
    stop_gradient=identity,
    optimization_barrier=_several,
    device_put=_several,
)
_plain(**{"and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor, "not": np.invert})


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
    if x.dtype.kind != "f" or dtype.kind not in "iu":
        return x.astype(dtype, copy=False)
    # XLA takes the nearest end where NumPy wraps around; NaN is 0
    ends = np.iinfo(dtype)
    least, most = float(ends.min), float(ends.max)
    if ((least < x) & (x < most)).all():
        return x.astype(dtype)
    out = np.clip(np.nan_to_num(x, nan=0.0), least, most).astype(np.float64).astype(dtype)
    return np.where(x >= most, ends.max, np.where(x <= least, ends.min, out)).astype(dtype)


@_entry("bitcast_convert_type")
def _bitcast(params):
    return lambda x: np.ascontiguousarray(x).view(params["new_dtype"]).reshape(x.shape)


@_entry("reduce_precision")
def _reduced_precision(params):
    whole = (params["exponent_bits"], params["mantissa_bits"]) in ((8, 23), (11, 52))
    if not whole:
        raise NotImplementedError(
            "reduce_precision to other than float32 and float64 is not written in NumPy"
        )
    return identity


def _place(function: Function) -> Callable[[dict], Function]:
    return lambda params: lambda x: function(x, *params["axes"]).astype(params["index_dtype"])


COMPUTED["argmax"] = _place(np.argmax)
COMPUTED["argmin"] = _place(np.argmin)


def _reduction(function: np.ufunc) -> Callable[[dict], Function]:
    def make(params):
        axes = tuple(params["axes"])
        return lambda x: function.reduce(x, axis=axes, dtype=x.dtype)

    return make


def _extreme(function: np.ufunc, end: str) -> Callable[[dict], Function]:
    def make(params):
        axes = tuple(params["axes"])

        def reduced(x):
            if x.size:
                return function.reduce(x, axis=axes)
            limits = np.finfo(x.dtype) if x.dtype.kind == "f" else np.iinfo(x.dtype)
            nothing = getattr(limits, end)
            return np.full(
                np.delete(x.shape, axes),
                np.copysign(np.inf, nothing) if x.dtype.kind == "f" else nothing,
                x.dtype,
            )

        return reduced

    return make


COMPUTED["reduce_sum"] = _reduction(np.add)
COMPUTED["reduce_prod"] = _reduction(np.multiply)
COMPUTED["reduce_and"] = _reduction(np.bitwise_and)
COMPUTED["reduce_or"] = _reduction(np.bitwise_or)
COMPUTED["reduce_xor"] = _reduction(np.bitwise_xor)
COMPUTED["reduce_max"] = _extreme(np.maximum, "min")
COMPUTED["reduce_min"] = _extreme(np.minimum, "max")


def _running(function: np.ufunc) -> Callable[[dict], Function]:
    def make(params):
        axis = params["axis"]
        if params["reverse"]:
            return lambda x: np.flip(function.accumulate(np.flip(x, axis), axis, dtype=x.dtype), axis)
        return lambda x: function.accumulate(x, axis, dtype=x.dtype)

    return make


COMPUTED["cumsum"] = _running(np.add)
COMPUTED["cumprod"] = _running(np.multiply)
COMPUTED["cummax"] = _running(np.maximum)
COMPUTED["cummin"] = _running(np.minimum)


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
        out = out.reshape((*batch, *(x.shape[i] for i in free_x), *(y.shape[i] for i in free_y)))
        wanted = params["preferred_element_type"]
        return out if wanted is None else out.astype(wanted, copy=False)

    return product
