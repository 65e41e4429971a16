"""Closed intervals [lo, hi] as PyTrees, rounded outward: every operation encloses the exact range over its arguments.

Empty is lo = +inf, hi = -inf; entire is [-inf, inf]. Operations follow IEEE 1788-2015 (set-based flavour); edges of domains
give the tightest set, so 1 / [0, 1] is [1, inf] and x / [0, 0] is empty.
"""

import operator
from dataclasses import dataclass
from functools import partial, reduce

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets import approximations, rounding

__all__ = [
    "Interval", "abs", "add", "contains", "disjoint", "div", "equal", "hull", "interior", "intersection", "interval", "less", "mag",
    "matmul", "max", "mid", "mig", "min", "mul", "neg", "pown", "precedes", "rad", "recip", "sqr", "sub", "subset", "sum", "wid",
]  # fmt: skip

_abs, _min, _max, _sum = abs, min, max, sum  # the built-ins, before the operations of the same name


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Interval:
    """An array of closed intervals; `lo` and `hi` have one shape and dtype. Build it with `interval`.

    Encloses: `x + y`, `x - y`, `x * y`, `x / y`, `x @ y`, `-x`, `abs(x)`, `x ** n` (n an integer) enclose the exact results, eagerly
    and compiled.
    """

    lo: jax.Array
    hi: jax.Array

    mid = property(lambda self: mid(self), doc="A float inside, near the middle; NaN if empty.")
    rad = property(lambda self: rad(self), doc="Half the width, rounded up: [mid - rad, mid + rad] encloses; NaN if empty.")
    wid = property(lambda self: wid(self), doc="hi - lo, rounded up; NaN if empty.")
    is_empty = property(lambda self: self.lo > self.hi, doc="True where there is no point.")
    shape = property(lambda self: jnp.shape(self.lo), doc="Shape of the array of intervals.")
    dtype = property(lambda self: self.lo.dtype, doc="Float type of the bounds.")

    def __add__(self, other):
        return add(self, other)

    def __sub__(self, other):
        return sub(self, other)

    def __mul__(self, other):
        return mul(self, other)

    def __truediv__(self, other):
        return div(self, other)

    def __matmul__(self, other):
        return matmul(self, other)

    def __rsub__(self, other):
        return sub(other, self)

    def __rtruediv__(self, other):
        return div(other, self)

    def __rmatmul__(self, other):
        return matmul(other, self)

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self):
        return neg(self)

    def __abs__(self):
        return abs(self)

    def __pow__(self, n):
        return pown(self, n)

    def __getitem__(self, index):
        return Interval(self.lo[index], self.hi[index])

    def __len__(self):
        return len(self.lo)

    def __iter__(self):
        return (self[i] for i in range(len(self)))

    __array_priority__ = 100  # numpy_array * interval comes here
    __array_ufunc__ = None
    __contains__ = None  # `number in x` would walk the entries: use contains


def interval(lo, hi=None):
    """Build an Interval from bounds of one shape (broadcast); `interval(x)` is the point x.

    Args:
        lo, hi: array-likes with lo <= hi. lo = +inf with hi = -inf is the empty interval.

    Returns:
        An Interval of the wider float dtype of the two. Bounds that the dtype cannot hold (float64 numbers with x64 off, large
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
    lo, hi = _bound(lo, rounding.round_down), _bound(hi, rounding.round_up)
    if not isinstance(lo, jax.core.Tracer) and not isinstance(hi, jax.core.Tracer):
        _check(np.asarray(lo), np.asarray(hi))
    shape, dtype = jnp.broadcast_shapes(jnp.shape(lo), jnp.shape(hi)), jnp.result_type(lo, hi)
    return Interval(*rounding.settle_subnormals(*(jnp.broadcast_to(end, shape).astype(dtype) for end in (lo, hi))))


def _check(lo, hi):
    empty = (lo == np.inf) & (hi == -np.inf)
    for bad, rule in (
        (np.isnan(lo) | np.isnan(hi), "bounds must be numbers, not NaN"),
        ((lo > hi) & ~empty, "lo must be <= hi"),
        (((lo == np.inf) | (hi == -np.inf)) & ~empty, "a point must be finite"),
    ):
        if bad.any():
            first = tuple(int(i) for i in np.argwhere(bad)[0])
            raise ValueError(f"{rule}: {bad.sum()} of {bad.size} entries violate it, first at {first}")


def _bound(x, directed):
    """Convert to a float32 or float64 array; a number that does not fit is rounded in the given direction."""
    if isinstance(x, jax.Array) and jnp.issubdtype(x.dtype, jnp.floating):
        return x if x.dtype.itemsize >= 4 else x.astype(jnp.float32)
    if isinstance(x, jax.core.Tracer):  # integers: one step outward where a float does not hold them all
        near = x.astype(jnp.result_type(float))
        step = 2 * rounding.unit(near.dtype) * jnp.abs(near) * (1 if directed is rounding.round_up else -1)
        return near + jnp.where(jnp.abs(step) < 1, 0, step)
    x = np.asarray(x)
    narrow = jnp.issubdtype(x.dtype, jnp.floating) and x.dtype.itemsize <= 4
    wanted = jax.dtypes.canonicalize_dtype(np.float32 if narrow else np.float64)
    return x if x.dtype == wanted else directed(x, wanted)


def _pair(x, y):
    """Return both as Intervals; a plain number takes the dtype of its partner, outward."""
    if not isinstance(x, Interval):
        x, y = _pair(y, x)[::-1] if isinstance(y, Interval) else (interval(x), y)
    if not isinstance(y, Interval):
        number = isinstance(y, (int, float)) and not isinstance(y, bool)
        y = interval(rounding.round_down(y, x.dtype), rounding.round_up(y, x.dtype)) if number else interval(y)
    return x, y


def _close(lo, hi, *arguments):
    """Round outward; empty if any argument is."""
    lo, hi = rounding.outward(lo, hi)
    return _or_empty(lo, hi, *arguments)


def _or_empty(lo, hi, *arguments):
    """Make the result empty where an argument is; only an empty set has lo = inf, or hi = -inf, so that no bound asks for the other."""
    return Interval(
        jnp.where(reduce(operator.or_, [x.lo == jnp.inf for x in arguments]), jnp.inf, lo),
        jnp.where(reduce(operator.or_, [x.hi == -jnp.inf for x in arguments]), -jnp.inf, hi),
    )


def _empty_where(empty, lo, hi):
    return Interval(jnp.where(empty, jnp.inf, lo), jnp.where(empty, -jnp.inf, hi))


def add(x, y):
    """Return the sum. Source: IEEE 1788 add."""
    x, y = _pair(x, y)
    return _close(x.lo + y.lo, x.hi + y.hi, x, y)


def sub(x, y):
    """Return the difference. Source: IEEE 1788 sub."""
    x, y = _pair(x, y)
    return _close(x.lo - y.hi, x.hi - y.lo, x, neg(y))


def neg(x):
    """Return -x, exactly. Source: IEEE 1788 neg."""
    return Interval(-x.hi, -x.lo)


def mul(x, y):
    """Return the product; 0 times an infinite bound is 0. Source: IEEE 1788 mul."""
    x, y = _pair(x, y)
    products = [a * b for a in (x.lo, x.hi) for b in (y.lo, y.hi)]
    out = _close(*_range([jnp.where(jnp.isnan(p), 0, p) for p in products]), x, y)
    # outward rounding must not cross 0, so that 1 / (x * y) stays half-bounded
    (above, below), (up, down) = ((v.lo >= 0, v.hi <= 0) for v in (x, y))
    zero = (above & below) | (up & down)
    lo = jnp.where((above & up) | (below & down) | zero, jnp.maximum(out.lo, 0), out.lo)
    return Interval(lo, jnp.where((above & down) | (below & up) | zero, jnp.minimum(out.hi, 0), out.hi))


def div(x, y):
    """Return the quotient; a divisor with an interior zero gives entire, [0, 0] gives empty. Source: IEEE 1788 div."""
    x, y = _pair(x, y)
    down = y.hi <= 0  # x / y = (-x) / (-y)
    a, b, c, d = (jnp.where(down, -p, q) for p, q in ((x.hi, x.lo), (x.lo, x.hi), (y.hi, y.lo), (y.lo, y.hi)))
    nowhere, across = x.is_empty | y.is_empty | ((c == 0) & (d == 0)), (c < 0) & ~((a == 0) & (b == 0))
    over = lambda n, sign: jnp.where(nowhere, jnp.nan, jnp.where(across, sign * jnp.inf, jnp.where(n == 0, sign * -0.0, n)))
    low = _quotient(over(a, -1), jnp.where(across, 1, jnp.where(a >= 0, d, c)), -jnp.inf)
    high = _quotient(over(b, 1), jnp.where(across, 1, jnp.where(b > 0, c, d)), jnp.inf)
    lo, hi = rounding.outward(low, high)
    lo, hi = jnp.where(jnp.signbit(low), lo, jnp.maximum(lo, 0)), jnp.where(jnp.signbit(high), jnp.minimum(hi, 0), hi)
    return Interval(jnp.where(jnp.isnan(low), jnp.inf, lo), jnp.where(jnp.isnan(high), -jnp.inf, hi))


def _quotient(a, b, over_zero):
    """Return a / b for b >= 0; a / 0 is `over_zero`. Its sign is that of a, even flushed, so that the caller need not ask a again.

    A divisor beyond 2^(emax/2) is scaled first, so that its reciprocal, which the compiler may use, is not flushed to zero. The
    barrier keeps the compiler from merging this quotient with one that made `a` or `b`.
    """
    zero, shrink = b == 0, 2.0 ** -(np.finfo(b.dtype).maxexp // 2)
    s = jnp.where(b > 1 / shrink, np.asarray(shrink, b.dtype), np.asarray(1, b.dtype))
    a, b = jnp.where(zero & ~jnp.isnan(a), over_zero, a * s), jnp.where(zero, 1, b * s)
    a, b = jax.lax.optimization_barrier(jnp.broadcast_arrays(a, b))
    return a / b


def _range(values):
    lo = hi = values[0]
    for v in values[1:]:
        lo, hi = jnp.minimum(lo, v), jnp.maximum(hi, v)
    return lo, hi


def recip(x):
    """Return 1 / x. Source: IEEE 1788 recip."""
    return div(Interval(jnp.ones_like(x.lo), jnp.ones_like(x.hi)), x)


def sqr(x):
    """Return x^2, never negative, and 0 for 0 (so that [0, 0]^-2 is empty). Source: IEEE 1788 sqr."""
    near, far = mig(x), mag(x)
    out = _close(near * near, far * far, x)
    return Interval(jnp.maximum(out.lo, 0), jnp.where(far == 0, 0, out.hi))


def pown(x, n):
    """Return x^n for a Python integer n; x^0 is 1. Source: IEEE 1788 pown."""
    if not isinstance(n, (int, np.integer)) or isinstance(n, bool):
        raise TypeError(f"the exponent must be an integer, not {n!r}")
    if n < 0:
        return recip(pown(x, -n))
    if n == 0:
        return _or_empty(jnp.ones_like(x.lo), jnp.ones_like(x.hi), x)
    if n < 3:
        return sqr(x) if n == 2 else x
    return _power(x, n)


@partial(jax.jit, static_argnums=1)
def _power(x, n):
    near, far = (x.lo, x.hi) if n % 2 else (mig(x), mag(x))
    power = lambda v: jnp.where(v < 0, -1, 1) * approximations.power(jnp.abs(v), n)
    lo, hi = rounding.outward(power(near), power(far), approximations.UNITS["power"] + 16 * n * rounding.unit(x.dtype))
    lo, hi = jnp.where(near >= 0, jnp.maximum(lo, 0), lo), jnp.where(far <= 0, jnp.minimum(hi, 0), hi)
    return _or_empty(lo, hi, x)


def abs(x):
    """Return |x|, exactly. Source: IEEE 1788 abs."""
    return _or_empty(mig(x), mag(x), x)


def min(x, y):
    """Return the range of the smaller, exactly. Source: IEEE 1788 min."""
    x, y = _pair(x, y)
    return _or_empty(jnp.minimum(x.lo, y.lo), jnp.minimum(x.hi, y.hi), x, y)


def max(x, y):
    """Return the range of the larger, exactly. Source: IEEE 1788 max."""
    x, y = _pair(x, y)
    return _or_empty(jnp.maximum(x.lo, y.lo), jnp.maximum(x.hi, y.hi), x, y)


def sum(x, axis=0):
    """Return the sum along `axis`; the bound holds for any order of addition."""
    return _empty_where(jnp.any(x.is_empty, axis), *rounding.outward_sum(x.lo, x.hi, axis))


def matmul(x, y):
    """Return the matrix product of (..., n, k) or (k,) and (..., k, m) or (k,): every entry an enclosed sum of products."""
    x, y = _pair(x, y)
    if not x.shape or not y.shape or x.shape[-1] != y.shape[-2:][0]:
        raise ValueError(f"matmul needs (..., n, k) or (k,) and (..., k, m) or (k,): the shapes are {x.shape} and {y.shape}")
    vector = len(y.shape) == 1
    left = x if vector else x[..., None]
    right = y if vector or len(x.shape) == 1 else y[..., None, :, :]
    rank = _max(len(left.shape), len(right.shape))
    left, right = (v[(None,) * (rank - len(v.shape))] for v in (left, right))
    return sum(mul(left, right), axis=-1 if vector else -2)


def mid(x):
    """Return a float inside x near its middle (half-line: the largest float, entire: 0, empty: NaN). Source: IEEE 1788 mid."""
    top = np.finfo(x.dtype).max
    lo, hi = jnp.maximum(x.lo, -top), jnp.minimum(x.hi, top)
    left, right = jax.lax.optimization_barrier((lo * 0.5, hi * 0.5))  # the compiler would make it (lo + hi) * 0.5, which overflows
    middle = jnp.clip(left + right, lo, hi)
    ends = jnp.where(x.lo == -jnp.inf, jnp.where(x.hi == jnp.inf, 0, -top), jnp.where(x.hi == jnp.inf, top, middle))
    return jnp.where(x.is_empty, jnp.nan, ends)


def rad(x):
    """Return a radius, rounded up, with x inside [mid - rad, mid + rad]; NaN for empty. Source: IEEE 1788 rad."""
    m = mid(x)
    spread = _close(jnp.zeros_like(m), jnp.maximum(m - x.lo, x.hi - m), x).hi
    return jnp.where(x.is_empty, jnp.nan, jnp.where(x.lo == x.hi, 0, spread))


def wid(x):
    """Return hi - lo, rounded up; NaN for empty. Source: IEEE 1788 wid."""
    width = _close(jnp.zeros_like(x.lo), x.hi - x.lo, x).hi
    return jnp.where(x.is_empty, jnp.nan, jnp.where(x.lo == x.hi, 0, width))


def mag(x):
    """Return the largest absolute value; NaN for empty. Source: IEEE 1788 mag."""
    return jnp.where(x.is_empty, jnp.nan, jnp.maximum(jnp.abs(x.lo), jnp.abs(x.hi)))


def mig(x):
    """Return the smallest absolute value; NaN for empty. Source: IEEE 1788 mig."""
    return jnp.where(x.is_empty, jnp.nan, jnp.maximum(jnp.maximum(x.lo, -x.hi), 0))


def hull(x, y):
    """Return the smallest interval that holds both. Source: IEEE 1788 convexHull."""
    x, y = _pair(x, y)
    return Interval(jnp.minimum(x.lo, y.lo), jnp.maximum(x.hi, y.hi))


def intersection(x, y):
    """Return what both share, possibly empty. Source: IEEE 1788 intersection."""
    x, y = _pair(x, y)
    lo, hi = jnp.maximum(x.lo, y.lo), jnp.minimum(x.hi, y.hi)
    return _empty_where(lo > hi, lo, hi)


def equal(x, y):
    """True where both are the same set. Source: IEEE 1788 equal."""
    x, y = _pair(x, y)
    return (x.is_empty & y.is_empty) | ((x.lo == y.lo) & (x.hi == y.hi))


def subset(x, y):
    """True where x lies in y. Source: IEEE 1788 subset."""
    x, y = _pair(x, y)
    return x.is_empty | ((x.lo >= y.lo) & (x.hi <= y.hi))


def interior(x, y):
    """True where x lies in the interior of y. Source: IEEE 1788 interior."""
    x, y = _pair(x, y)
    below = (x.lo > y.lo) | (y.lo == -jnp.inf)
    above = (x.hi < y.hi) | (y.hi == jnp.inf)
    return x.is_empty | (below & above & ~y.is_empty)


def disjoint(x, y):
    """True where no point is shared. Source: IEEE 1788 disjoint."""
    x, y = _pair(x, y)
    return x.is_empty | y.is_empty | (x.hi < y.lo) | (y.hi < x.lo)


def less(x, y):
    """True where x is weakly below y: both ends are. Source: IEEE 1788 less."""
    x, y = _pair(x, y)
    return (x.is_empty & y.is_empty) | (~x.is_empty & ~y.is_empty & (x.lo <= y.lo) & (x.hi <= y.hi))


def precedes(x, y):
    """True where every point of x is <= every point of y. Source: IEEE 1788 precedes."""
    x, y = _pair(x, y)
    return x.is_empty | y.is_empty | (x.hi <= y.lo)


def contains(x, point):
    """True where the number lies in x; infinities and NaN never do. Source: IEEE 1788 isMember."""
    # a number between two floats lies in x where both do
    below, above = _bound(point, rounding.round_down), _bound(point, rounding.round_up)
    below, above = rounding.settle_subnormals(jnp.asarray(below), jnp.asarray(above))
    return (x.lo <= below) & (above <= x.hi) & (jnp.isfinite(below) | jnp.isfinite(above))
