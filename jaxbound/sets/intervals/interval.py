"""Closed intervals [lo, hi] as PyTrees, rounded outward: every operation encloses the exact range over its
arguments.

Empty is lo = +inf, hi = -inf; entire is [-inf, inf]. Operations follow IEEE 1788-2015 (set-based flavour);
edges of domains give the tightest set, so 1 / [0, 1] is [1, inf] and x / [0, 0] is empty.

Compiled code reads a subnormal number as 0. Operations therefore move such a bound outward first (`_read`;
what rounds sums outward has room for it), and comparisons look at the bits. So it does not matter who built
an Interval, the factory or the class.
"""

from __future__ import annotations

import operator
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial, reduce
from typing import TYPE_CHECKING, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals import approximations
from jaxbound.sets.intervals.bounds import Arrays, Number, bound, check, settled
from jaxbound.text.objects import readable

__all__ = [
    "Interval",
    "abs",
    "add",
    "div",
    "equal",
    "hull",
    "interval",
    "mag",
    "matmul",
    "max",
    "mid",
    "mig",
    "min",
    "mul",
    "neg",
    "pow",
    "pown",
    "rad",
    "recip",
    "sqr",
    "sub",
    "sum",
    "wid",
]

_abs, _min, _max, _sum = abs, min, max, sum  # the built-ins, before the operations of the same name


@readable
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Interval(Arrays):
    """An array of closed intervals; `lo` and `hi` have one shape and dtype. Build it with `interval`, which
    checks what it is given.

    `x == y` and `x != y` are those of `equal`, entry by entry; an Interval has its identity for a hash.

    Encloses: `x + y`, `x - y`, `x * y`, `x / y`, `x @ y`, `-x`, `abs(x)`, `x ** n` (`pown` for a whole number
    n, else `pow`) enclose the exact results, eagerly and compiled, for every two floats lo <= hi (not one and
    the same infinity), subnormal ones included; relations are exact for them. A bound that is NaN bounds
    nothing: it counts as infinite, results are entire or have NaN for a bound again; no relation holds.
    """

    lo: jax.Array
    hi: jax.Array
    _settled = False  # see `computed`
    if TYPE_CHECKING:

        def __init__(self, lo: Operand, hi: Operand) -> None: ...

    @property
    def mid(self) -> jax.Array:
        """A float inside, near the middle; NaN if empty."""
        return mid(self)

    @property
    def rad(self) -> jax.Array:
        """Half the width, rounded up: [mid - rad, mid + rad] encloses; NaN if empty."""
        return rad(self)

    @property
    def wid(self) -> jax.Array:
        """Hi - lo, rounded up; NaN if empty."""
        return wid(self)

    @property
    def is_empty(self) -> jax.Array:
        """Return whether there is no point."""
        return self.lo > self.hi

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array of intervals."""
        return jnp.shape(self.lo)

    @property
    def dtype(self) -> np.dtype:
        """Float type of the bounds."""
        return self.lo.dtype

    def __add__(self, other: Operand) -> Interval:
        return add(self, other)

    def __sub__(self, other: Operand) -> Interval:
        return sub(self, other)

    def __mul__(self, other: Operand) -> Interval:
        return mul(self, other)

    def __truediv__(self, other: Operand) -> Interval:
        return div(self, other)

    def __matmul__(self, other: Operand) -> Interval:
        return matmul(self, other)

    def __rsub__(self, other: Operand) -> Interval:
        return sub(other, self)

    def __rtruediv__(self, other: Operand) -> Interval:
        return div(other, self)

    def __rmatmul__(self, other: Operand) -> Interval:
        return matmul(other, self)

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self) -> Interval:
        return neg(self)

    def __abs__(self) -> Interval:
        return abs(self)

    def __pow__(self, n: Operand) -> Interval:
        if n is None or isinstance(n, bool | str):
            raise TypeError(f"exponent must be a number or an interval, not {n!r}")
        if isinstance(n, int | float | np.integer | np.floating) and float(n).is_integer():
            return pown(self, int(n))
        return pow(self, n)

    def __rpow__(self, x: Operand) -> Interval:
        return pow(x, self)

    def __eq__(self, other: object) -> jax.Array:  # type: ignore[override]  # as of arrays
        if other is None or isinstance(other, str):
            return NotImplemented
        return equal(self, other)  # type: ignore[arg-type]

    def __ne__(self, other: object) -> jax.Array:  # type: ignore[override]
        if other is None or isinstance(other, str):
            return NotImplemented
        return ~equal(self, other)  # type: ignore[arg-type]

    __hash__ = object.__hash__  # of a class with `==` Python would take it away

    def __getitem__(self, index: object) -> Interval:
        return (computed if self._settled else Interval)(self.lo[index], self.hi[index])

    def __len__(self) -> int:
        return len(self.lo)

    def __iter__(self) -> Iterator[Interval]:
        return (self[i] for i in range(len(self)))

    __array_priority__ = 100  # numpy_array * interval comes here
    __array_ufunc__ = None
    __contains__ = None  # `number in x` would walk the entries: use contains


Operand: TypeAlias = Interval | Number
"""What an operation takes: numbers are points."""


def interval(lo: Operand, hi: Number | None = None) -> Interval:
    """Build an Interval from bounds of one shape (broadcast); `interval(x)` is the point x.

    Args:
        lo, hi: array-likes with lo <= hi. lo = +inf with hi = -inf is the empty interval.

    Returns: an Interval of the wider float dtype of the two. Bounds that the dtype cannot hold (float64
    numbers with x64 off, large
        integers, exact fractions, subnormal numbers) are moved outward, never inward.

    Raises:
        ValueError: NaN, lo > hi anywhere (unless empty), or an infinite point.

    Example:
        >>> x = interval(1.0, 2.0) * interval(-1.0, 3.0)
        >>> print(f"[{x.lo:.3f}, {x.hi:.3f}]")
        [-2.000, 6.000]
    """
    if isinstance(lo, Interval):
        if hi is not None:
            raise ValueError("an Interval already has an upper bound: give numbers as lo and hi, or use hull")
        return lo
    hi = lo if hi is None else hi
    lo, hi = bound(lo, rounding.round_down), bound(hi, rounding.round_up)
    if not isinstance(lo, jax.core.Tracer) and not isinstance(hi, jax.core.Tracer):
        check(np.asarray(lo), np.asarray(hi))
    return computed(*settled(lo, hi))


def alike(*xs: Operand) -> list[Interval]:
    """Return all as Intervals of one dtype; a plain number takes the dtype of its partners, outward."""
    given, out = [x.dtype for x in xs if isinstance(x, Interval)], []
    for x in xs:
        if given and isinstance(x, (int, float)) and not isinstance(x, bool):
            own = jnp.result_type(*given)
            x = interval(rounding.round_down(x, own), rounding.round_up(x, own))
        out.append(interval(x))
    dtype = jnp.result_type(*(x.dtype for x in out))
    # who has that type stays as it is, and with it the mark that its bounds were looked at
    wider = lambda x: jax.tree.map(lambda end: rounding.widened(end, dtype), x)
    return [x if x.dtype == dtype else wider(x) for x in out]


def computed(lo: jax.Array, hi: jax.Array) -> Interval:
    """Return an Interval of bounds that an operation computed: none is subnormal towards the inside, so that
    the next need not look.
    """
    out = Interval(lo, hi)
    object.__setattr__(
        out, "_settled", True
    )  # forgotten by a PyTree's round trip, after which the bounds are looked at again
    return out


def _read(x: Interval) -> Interval:
    """Return x with bounds that compiled code reads as they are or further out."""
    return x if x._settled else computed(*rounding.settle_subnormals(x.lo, x.hi))


def _close(lo: jax.Array, hi: jax.Array, *arguments: Interval) -> Interval:
    """Round outward; empty if any argument is."""
    return or_empty(*rounding.outward(lo, hi), *arguments)


def or_empty(lo: jax.Array, hi: jax.Array, *arguments: Interval) -> Interval:
    """Make the result empty where an argument is; only an empty set has lo = inf, or hi = -inf, so that no
    bound asks for the other.
    """
    return computed(
        jnp.where(reduce(operator.or_, [x.lo == jnp.inf for x in arguments]), jnp.inf, lo),
        jnp.where(reduce(operator.or_, [x.hi == -jnp.inf for x in arguments]), -jnp.inf, hi),
    )


def empty_where(empty: jax.Array, lo: jax.Array, hi: jax.Array) -> Interval:
    """Return an Interval of computed bounds, empty where that is said."""
    return computed(jnp.where(empty, jnp.inf, lo), jnp.where(empty, -jnp.inf, hi))


def add(x: Operand, y: Operand) -> Interval:
    """Return the sum. Source: IEEE 1788 add."""
    x, y = alike(x, y)
    return _close(x.lo + y.lo, x.hi + y.hi, x, y)


def sub(x: Operand, y: Operand) -> Interval:
    """Return the difference. Source: IEEE 1788 sub."""
    x, y = alike(x, y)
    return _close(x.lo - y.hi, x.hi - y.lo, x, neg(y))


def neg(x: Interval) -> Interval:
    """Return -x, exactly. Source: IEEE 1788 neg."""
    return (computed if x._settled else Interval)(-x.hi, -x.lo)


def mul(x: Operand, y: Operand) -> Interval:
    """Return the product; 0 times an infinite bound is 0. Source: IEEE 1788 mul."""
    x, y = map(_read, alike(x, y))
    (above, below), (up, down) = ((v.lo >= 0, v.hi <= 0) for v in (x, y))
    beyond = x.hi >= 0
    least = _times(x.lo, jnp.where(above, y.lo, y.hi)), _times(x.hi, jnp.where(beyond, y.lo, y.hi))
    most = _times(x.lo, jnp.where(above, y.hi, y.lo)), _times(x.hi, jnp.where(beyond, y.hi, y.lo))
    out = _close(jnp.minimum(*least), jnp.maximum(*most), x, y)
    # outward rounding must not cross 0, so that 1 / (x * y) stays half-bounded
    zero = (above & below) | (up & down)
    lo = jnp.where((above & up) | (below & down) | zero, jnp.maximum(out.lo, 0), out.lo)
    hi = jnp.where((above & down) | (below & up) | zero, jnp.minimum(out.hi, 0), out.hi)
    known = (x.lo == x.lo) & (x.hi == x.hi) & (y.lo == y.lo) & (y.hi == y.hi)
    return computed(jnp.where(known, lo, jnp.nan), jnp.where(known, hi, jnp.nan))


def _times(a: jax.Array, b: jax.Array) -> jax.Array:
    """Return a b, and 0 for 0 times infinity."""
    product = a * b
    return jnp.where(jnp.isnan(product), 0, product)


def div(x: Operand, y: Operand) -> Interval:
    """Return the quotient; a divisor with an interior zero gives entire, [0, 0] gives empty. Source: IEEE
    1788 div.
    """
    x, y = (computed(*rounding.unbounded(v.lo, v.hi)) for v in map(_read, alike(x, y)))
    down = y.hi <= 0  # x / y = (-x) / (-y)
    a, b, c, d = (jnp.where(down, -p, q) for p, q in ((x.hi, x.lo), (x.lo, x.hi), (y.hi, y.lo), (y.lo, y.hi)))
    nowhere, across = x.is_empty | y.is_empty | ((c == 0) & (d == 0)), (c < 0) & ~((a == 0) & (b == 0))
    over = lambda n, sign: jnp.where(
        nowhere, jnp.nan, jnp.where(across, sign * jnp.inf, jnp.where(n == 0, sign * -0.0, n))
    )
    low = _quotient(over(a, -1), jnp.where(across, 1, jnp.where(a >= 0, d, c)), -jnp.inf)
    high = _quotient(over(b, 1), jnp.where(across, 1, jnp.where(b > 0, c, d)), jnp.inf)
    lo, hi = rounding.outward(low, high)
    lo, hi = (
        jnp.where(jnp.signbit(low), lo, jnp.maximum(lo, 0)),
        jnp.where(jnp.signbit(high), jnp.minimum(hi, 0), hi),
    )
    return computed(jnp.where(jnp.isnan(low), jnp.inf, lo), jnp.where(jnp.isnan(high), -jnp.inf, hi))


def _quotient(a: jax.Array, b: jax.Array, over_zero: float) -> jax.Array:
    """Return a / b for b >= 0; a / 0 is `over_zero`. Its sign is that of a, even flushed, so that the caller
    need not ask a again.

    A divisor beyond 2^(emax/2) is scaled first, so that its reciprocal, which the compiler may use, is not
    flushed to zero. The barrier keeps the compiler from merging this quotient with one that made `a` or `b`.
    """
    zero, shrink = b == 0, 2.0 ** -(np.finfo(b.dtype).maxexp // 2)
    s = jnp.where(b > 1 / shrink, np.asarray(shrink, b.dtype), np.asarray(1, b.dtype))
    a, b = jnp.where(zero & ~jnp.isnan(a), over_zero, a * s), jnp.where(zero, 1, b * s)
    a, b = jax.lax.optimization_barrier(jnp.broadcast_arrays(a, b))
    return a / b


def recip(x: Interval) -> Interval:
    """Return 1 / x. Source: IEEE 1788 recip."""
    return div(computed(jnp.ones_like(x.lo), jnp.ones_like(x.hi)), x)


def sqr(x: Interval) -> Interval:
    """Return x^2, never negative, and 0 for 0 (so that [0, 0]^-2 is empty). Source: IEEE 1788 sqr."""
    near, far = mig(x), mag(x)
    out = _close(near * near, far * far, x)
    return computed(jnp.maximum(out.lo, 0), jnp.where(far == 0, 0, out.hi))


def pown(x: Interval, n: int) -> Interval:
    """Return x^n for a Python integer n; x^0 is 1. Source: IEEE 1788 pown."""
    if not isinstance(n, (int, np.integer)) or isinstance(n, bool):
        raise TypeError(f"the exponent must be an integer, not {n!r}: pow(x, y) takes others")
    if n < 0:
        return recip(pown(x, -n))
    if n == 0:
        return or_empty(jnp.ones_like(x.lo), jnp.ones_like(x.hi), x)
    if n < 3:
        return sqr(x) if n == 2 else x
    return _power(x, n)


@partial(jax.jit, static_argnums=1)
def _power(x: Interval, n: int) -> Interval:
    x = _read(x)
    near, far = (x.lo, x.hi) if n % 2 else (mig(x), mag(x))
    power = lambda v: jnp.where(v < 0, -1, 1) * approximations.power(jnp.abs(v), n)
    lo, hi = rounding.outward(
        power(near), power(far), approximations.UNITS["power"] + 16 * n * rounding.unit(x.dtype)
    )
    lo, hi = jnp.where(near >= 0, jnp.maximum(lo, 0), lo), jnp.where(far <= 0, jnp.minimum(hi, 0), hi)
    return or_empty(lo, hi, x)


def pow(x: Operand, y: Operand) -> Interval:
    """Return x^y for the numbers of x above 0, and 0 for 0 with a y above 0. Source: IEEE 1788 pow.

    Example:
        >>> x = pow(interval(1.0, 2.0), 0.5)
        >>> print(f"[{x.lo:.4f}, {x.hi:.4f}]")
        [1.0000, 1.4142]
    """
    x, y = map(_read, alike(x, y))
    shape = jnp.broadcast_shapes(x.shape, y.shape)
    x, y = (jax.tree.map(lambda end: jnp.broadcast_to(end, shape), v) for v in (x, y))
    return _real_power(x, y)


@jax.jit
def _real_power(x: Interval, y: Interval) -> Interval:
    """Return e^(y log x), each of the three operations rounded outward."""
    x, y = _read(x), _read(y)
    some, whole = x.hi > 0, x.lo > 0
    low, high = (approximations.log(jnp.where(at, end, 1)) for at, end in ((whole, x.lo), (some, x.hi)))
    low, high = rounding.outward(low, high, approximations.UNITS["log"])
    low = jnp.where(whole, jnp.where(x.lo == 1, 0, low), -jnp.inf)
    exponent = mul(computed(low, jnp.where(x.hi == 1, 0, high)), y)
    ends = approximations.exp(exponent.lo), approximations.exp(exponent.hi)
    lo, hi = rounding.outward(*ends, approximations.UNITS["exp"])
    lo, hi = (jnp.where(e == 0, 1, end) for e, end in ((exponent.lo, lo), (exponent.hi, hi)))
    zero = (x.lo <= 0) & (x.hi >= 0) & (y.hi > 0)  # 0^y
    lo, hi = jnp.where(zero | ~some, 0, jnp.maximum(lo, 0)), jnp.where(some, hi, 0)
    out = empty_where(~some & ~zero, lo, hi)
    return or_empty(out.lo, out.hi, x, y)


def abs(x: Interval) -> Interval:
    """Return |x|, exactly. Source: IEEE 1788 abs."""
    return or_empty(mig(x), mag(x), x)


def min(x: Operand, y: Operand) -> Interval:
    """Return the range of the smaller, exactly. Source: IEEE 1788 min."""
    x, y = map(_read, alike(x, y))
    return or_empty(jnp.minimum(x.lo, y.lo), jnp.minimum(x.hi, y.hi), x, y)


def max(x: Operand, y: Operand) -> Interval:
    """Return the range of the larger, exactly. Source: IEEE 1788 max."""
    x, y = map(_read, alike(x, y))
    return or_empty(jnp.maximum(x.lo, y.lo), jnp.maximum(x.hi, y.hi), x, y)


def sum(x: Interval, axis: int = 0) -> Interval:
    """Return the sum along `axis`; the bound holds for any order of addition."""
    return empty_where(jnp.any(x.is_empty, axis), *rounding.outward_sum(x.lo, x.hi, axis))


def matmul(x: Operand, y: Operand) -> Interval:
    """Return the matrix product of (..., n, k) or (k,) and (..., k, m) or (k,): every entry an enclosed sum
    of products.
    """
    x, y = alike(x, y)
    if not x.shape or not y.shape or x.shape[-1] != y.shape[-2:][0]:
        raise ValueError(
            f"matmul needs (..., n, k) or (k,) and (..., k, m) or (k,): the shapes are {x.shape} and "
            f"{y.shape}"
        )
    vector = len(y.shape) == 1
    left = x if vector else x[..., None]
    right = y if vector or len(x.shape) == 1 else y[..., None, :, :]
    rank = _max(len(left.shape), len(right.shape))
    left, right = (v[(None,) * (rank - len(v.shape))] for v in (left, right))
    return sum(mul(left, right), axis=-1 if vector else -2)


@partial(jax.jit, inline=True)
def mid(x: Interval) -> jax.Array:
    """Return a float inside x near its middle (half-line: the largest float, entire: 0, empty: NaN). Source:
    IEEE 1788 mid.
    """
    top = np.finfo(x.dtype).max
    unbounded = jnp.isnan(x.lo) | (x.lo == -jnp.inf), jnp.isnan(x.hi) | (x.hi == jnp.inf)
    lo, hi = jnp.maximum(x.lo, -top), jnp.minimum(x.hi, top)
    left, right = jax.lax.optimization_barrier(
        (lo * 0.5, hi * 0.5)
    )  # the compiler would make it (lo + hi) * 0.5, which overflows
    middle = jnp.clip(left + right, lo, hi)
    # subnormal bounds, which clip reads as 0
    middle = jnp.where(
        rounding.above(x.lo, middle), x.lo, jnp.where(rounding.above(middle, x.hi), x.hi, middle)
    )
    return jnp.where(
        x.is_empty,
        jnp.nan,
        jnp.where(unbounded[0], jnp.where(unbounded[1], 0, -top), jnp.where(unbounded[1], top, middle)),
    )


@partial(jax.jit, inline=True)
def rad(x: Interval) -> jax.Array:
    """Return a radius, rounded up, with x inside [mid - rad, mid + rad]; NaN for empty. Source: IEEE 1788
    rad.
    """
    return _spread(x, jnp.maximum((m := mid(x)) - x.lo, x.hi - m))


@partial(jax.jit, inline=True)
def wid(x: Interval) -> jax.Array:
    """Return hi - lo, rounded up; NaN for empty. Source: IEEE 1788 wid."""
    return _spread(x, x.hi - x.lo)


def _spread(x: Interval, size: jax.Array) -> jax.Array:
    """Return at least the size, off by two subnormal numbers read as 0: nothing for a point, infinite where a
    bound is not known.
    """
    out = _close(jnp.zeros_like(size), jnp.where(jnp.isnan(size), jnp.inf, size), x).hi
    return jnp.where(
        x.is_empty, jnp.nan, jnp.where(rounding.above(x.hi, x.lo) | jnp.isnan(x.lo + x.hi), out, 0)
    )


def mag(x: Interval) -> jax.Array:
    """Return the largest absolute value, rounded up if subnormal; NaN for empty. Source: IEEE 1788 mag."""
    x = _read(x)
    return jnp.where(x.is_empty, jnp.nan, jnp.maximum(jnp.abs(x.lo), jnp.abs(x.hi)))


def mig(x: Interval) -> jax.Array:
    """Return the smallest absolute value, rounded down if subnormal; NaN for empty. Source: IEEE 1788 mig."""
    x = _read(x)
    return jnp.where(x.is_empty, jnp.nan, jnp.maximum(jnp.maximum(x.lo, -x.hi), 0))


def hull(x: Operand, y: Operand) -> Interval:
    """Return the smallest interval that holds both. Source: IEEE 1788 convexHull."""
    x, y = map(_read, alike(x, y))
    return computed(jnp.minimum(x.lo, y.lo), jnp.maximum(x.hi, y.hi))


def intersection(x: Operand, y: Operand) -> Interval:
    """Return the intersection of two intervals, possibly empty. Source: IEEE 1788 intersection."""
    x, y = alike(x, y)
    above = operator.gt if x._settled and y._settled else rounding.above
    apart = x.is_empty | y.is_empty | above(x.lo, y.hi) | above(y.lo, x.hi)
    x, y = map(_read, (x, y))
    return empty_where(apart, jnp.maximum(x.lo, y.lo), jnp.minimum(x.hi, y.hi))


def equal(x: Operand, y: Operand) -> jax.Array:
    """Return whether both are the same set. Source: IEEE 1788 equal."""
    x, y = alike(x, y)
    same = (rounding.order(x.lo) == rounding.order(y.lo)) & (rounding.order(x.hi) == rounding.order(y.hi))
    return same & (x.lo == x.lo) & (x.hi == x.hi)
