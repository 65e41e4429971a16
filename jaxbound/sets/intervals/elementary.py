"""Elementary functions of Intervals, rounded outward: each encloses the exact range over the part of its
argument inside its domain.

Operations follow IEEE 1788-2015 (set-based flavour): sqrt of [-1, 4] is [0, 2], log of [-1, 0] is empty. An
argument is an Interval of any shape, or numbers, taken as points; two or three are broadcast. The bounds can
be differentiated.

Encloses: f(v) for every v of the argument at which f is defined, eagerly and compiled, in float32 and
float64: the floats at the ends come from `approximations` and `angles`, whose errors are known, and are
widened by `rounding.outward`. They lie within 8 ulps of the tightest bounds (acosh: 9), results near the
smallest normal number apart. Beyond 2^20 (float32: 2^11) sin and cos are [-1, 1], tan is entire.

Example:
    >>> from jaxbound import sets
    >>> x = sets.sin(sets.interval(1.0, 2.0))
    >>> print(f"[{x.lo:.4f}, {x.hi:.4f}]")
    [0.8415, 1.0000]
    >>> sets.log(sets.interval(-1.0, 0.0)).is_empty.item()
    True
"""

from collections.abc import Callable
from functools import reduce, wraps
from typing import cast, overload

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike

from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals import angles, approximations
from jaxbound.sets.intervals.interval import Interval, Operand, alike, empty_where, or_empty

__all__ = [
    "acos",
    "acosh",
    "asin",
    "asinh",
    "atan",
    "atan2",
    "atanh",
    "cos",
    "cosh",
    "exp",
    "exp10",
    "exp2",
    "fma",
    "log",
    "log10",
    "log2",
    "sin",
    "sinh",
    "sqrt",
    "tan",
    "tanh",
]


@overload
def enclosing(f: Callable[[Interval], Interval]) -> Callable[[Operand], Interval]: ...
@overload
def enclosing(f: Callable[[Interval, Interval], Interval]) -> Callable[[Operand, Operand], Interval]: ...
@overload
def enclosing(
    f: Callable[[Interval, Interval, Interval], Interval],
) -> Callable[[Operand, Operand, Operand], Interval]: ...
def enclosing(f: Callable[..., Interval]) -> Callable[..., Interval]:
    """Compile a function of Intervals; numbers and arrays are taken as points."""

    @jax.jit
    def compiled(*xs):
        sets = [Interval(*rounding.readable_bounds(x.lo, x.hi)) for x in xs]
        out = f(*sets)
        return or_empty(out.lo, out.hi, *sets)

    @wraps(f)
    def call(*xs):
        given = alike(*xs)
        shape = jnp.broadcast_shapes(*(x.shape for x in given))
        return compiled(*jax.tree.map(lambda end: jnp.broadcast_to(end, shape), given))

    return call


def _widen(
    name: str, lo: jax.Array, hi: jax.Array, least: ArrayLike = -np.inf, largest: ArrayLike = np.inf
) -> tuple[jax.Array, jax.Array]:
    """Widen by the bound of `name` and cut to its range."""
    lo, hi = rounding.outward(lo, hi, approximations.UNITS[name])
    return jnp.maximum(lo, least), jnp.minimum(hi, largest)


def kept_sign(x: Interval, lo: jax.Array, hi: jax.Array) -> Interval:
    """Keep rounding from carrying what has the sign of x, and is 0 at 0, across 0."""
    return Interval(
        jnp.where(x.lo >= 0, jnp.maximum(lo, 0), lo), jnp.where(x.hi <= 0, jnp.minimum(hi, 0), hi)
    )


def _up(value: object, dtype: DTypeLike) -> np.floating:
    """Return the float of `dtype` above an exact number."""
    return cast(np.floating, rounding.round_up(value, dtype)[()])


def _within(x: Interval, least: float, largest: float) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the ends of x cut to a domain, and whether anything is left."""
    lo, hi = jnp.clip(x.lo, least, largest), jnp.clip(x.hi, least, largest)
    return lo, hi, (x.hi < least) | (x.lo > largest)


@enclosing
def sqrt(x: Interval) -> Interval:
    """Return the square root of the numbers >= 0 in x. Source: IEEE 1788 sqrt."""
    empty = rounding.order(-x.hi) > 0
    low, high = (_root(jnp.where(empty, jnp.nan, jnp.maximum(end, 0))) for end in (x.lo, x.hi))
    lo, hi = _widen("sqrt", low, high, least=0)
    return Interval(
        jnp.where(jnp.isnan(low), jnp.inf, lo),
        jnp.where(jnp.isnan(high), -jnp.inf, jnp.where(high == 0, 0, hi)),
    )


@approximations.with_derivative(lambda x, y: 0.5 / y)
def _root(x: jax.Array) -> jax.Array:
    return jnp.sqrt(x)


def _exponential(name: str, x: Interval) -> Interval:
    """Enclose a power of x, exactly where the power is known to be a float."""
    f = getattr(approximations, name)
    low, high = f(x.lo), f(x.hi)
    lo, hi = _widen(name, low, high, least=0)
    if name == "exp2":
        exact = lambda bound, value: (
            (bound == jnp.round(bound)) & (value >= rounding.tiny(x.dtype)) & jnp.isfinite(value)
        )
    else:
        # e^0 and 10^0 are 1, and no other power of a float is known to be one
        exact = lambda bound, value: bound == 0
    return Interval(jnp.where(exact(x.lo, low), low, lo), jnp.where(exact(x.hi, high), high, hi))


@enclosing
def exp(x: Interval) -> Interval:
    """Return e^x. Source: IEEE 1788 exp."""
    return _exponential("exp", x)


@enclosing
def exp2(x: Interval) -> Interval:
    """Return 2^x. Source: IEEE 1788 exp2."""
    return _exponential("exp2", x)


@enclosing
def exp10(x: Interval) -> Interval:
    """Return 10^x. Source: IEEE 1788 exp10."""
    return _exponential("exp10", x)


def _logarithm(name: str, x: Interval) -> Interval:
    f, low, high = getattr(approximations, name), rounding.order(x.lo) > 0, rounding.order(x.hi) > 0
    lo, hi = _widen(name, f(jnp.where(low, x.lo, 1)), f(jnp.where(high, x.hi, 1)))
    # log 1 is 0 in every base
    lo, hi = jnp.where(x.lo == 1, 0, lo), jnp.where(x.hi == 1, 0, hi)
    return empty_where(~high, jnp.where(low, lo, -jnp.inf), hi)


@enclosing
def log(x: Interval) -> Interval:
    """Return the natural logarithm of the numbers > 0 in x. Source: IEEE 1788 log."""
    return _logarithm("log", x)


@enclosing
def log2(x: Interval) -> Interval:
    """Return the logarithm to base 2 of the numbers > 0 in x. Source: IEEE 1788 log2."""
    return _logarithm("log2", x)


@enclosing
def log10(x: Interval) -> Interval:
    """Return the logarithm to base 10 of the numbers > 0 in x. Source: IEEE 1788 log10."""
    return _logarithm("log10", x)


def _turns(x, f):
    """Return f at both ends, cut to the angles that can be reduced, and whether an end is too large."""
    limit = angles.LARGEST_ANGLE[x.dtype.itemsize]
    cut = ~((x.lo >= -limit) & (x.hi <= limit))
    # both bounds need both ends: without the barrier the compiler evaluates them twice
    return jax.lax.optimization_barrier(
        (f(jnp.clip(x.lo, -limit, limit)), f(jnp.clip(x.hi, -limit, limit)), cut)
    )


def _meets(low: jax.Array, high: jax.Array, k: int, period: int) -> jax.Array:
    """Return whether [lo, hi], in quadrants low to high, holds a multiple n of pi/2 with n = k modulo the
    period.
    """
    return jnp.floor((high - k) / period) > jnp.floor((low - k) / period)


def _wave(x: Interval, which: int) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Enclose sin (which = 0) or cos (1), 1 at quarter turn `top`, -1 two quarters later; return the
    quadrants of the ends as well.
    """
    (*low, first), (*high, last), cut = _turns(x, angles.sin_cos_quadrant)
    a, b, top = low[which], high[which], 1 - which
    lo, hi = _widen(("sin", "cos")[which], jnp.minimum(a, b), jnp.maximum(a, b), -1, 1)
    lo = jnp.where(cut | _meets(first, last, top + 2, 4), -1, lo)
    return lo, jnp.where(cut | _meets(first, last, top, 4), 1, hi), first, last


@enclosing
def sin(x: Interval) -> Interval:
    """Return the sine. Source: IEEE 1788 sin."""
    lo, hi, first, last = _wave(x, 0)
    # sin 0 is 0: an end widened below it would add numbers of the wrong sign
    lo = jnp.where((x.lo == 0) & (last < 2), jnp.maximum(lo, 0), lo)
    return Interval(lo, jnp.where((x.hi == 0) & (first >= -2), jnp.minimum(hi, 0), hi))


@enclosing
def cos(x: Interval) -> Interval:
    """Return the cosine. Source: IEEE 1788 cos."""
    lo, hi, *_ = _wave(x, 1)
    return Interval(jnp.where((x.lo == 0) & (x.hi == 0), 1, lo), hi)


@enclosing
def tan(x: Interval) -> Interval:
    """Return the tangent; entire where x meets a pole. Source: IEEE 1788 tan."""
    (low, first), (high, last), cut = _turns(x, angles.tan)
    lo, hi = _widen("tan", low, high)
    # tan 0 is 0, and its sign that of x up to the pole
    lo, hi = jnp.where(x.lo == 0, jnp.maximum(lo, 0), lo), jnp.where(x.hi == 0, jnp.minimum(hi, 0), hi)
    pole = cut | _meets(first, last, 1, 2)
    return Interval(jnp.where(pole, -jnp.inf, lo), jnp.where(pole, jnp.inf, hi))


@enclosing
def asin(x: Interval) -> Interval:
    """Return the inverse sine of the numbers of x in [-1, 1]. Source: IEEE 1788 asin."""
    low, high, empty = _within(x, -1, 1)
    top = _up(angles.PI / 2, x.dtype)
    out = kept_sign(x, *_widen("asin", angles.asin(low), angles.asin(high), -top, top))
    return empty_where(empty, out.lo, out.hi)


@enclosing
def acos(x: Interval) -> Interval:
    """Return the inverse cosine of the numbers of x in [-1, 1]. Source: IEEE 1788 acos."""
    low, high, empty = _within(x, -1, 1)
    # it falls: the upper end gives the lower bound
    lo, hi = _widen("acos", angles.acos(high), angles.acos(low), 0, _up(angles.PI, x.dtype))
    return empty_where(empty, lo, jnp.where(low == 1, 0, hi))


@enclosing
def atan(x: Interval) -> Interval:
    """Return the inverse tangent. Source: IEEE 1788 atan."""
    top = _up(angles.PI / 2, x.dtype)
    return kept_sign(x, *_widen("atan", angles.atan(x.lo), angles.atan(x.hi), -top, top))


@enclosing
def atan2(y: Interval, x: Interval) -> Interval:
    """Return the angles in (-pi, pi] of the points (x, y), the origin left out; [-pi, pi] across the cut.
    Source: IEEE 1788 atan2.
    """
    above, below = y.lo >= 0, y.hi <= 0
    straddling = ~above & ~below
    # off the cut the angle is least and largest at two corners, chosen by the signs of x and y
    low_y = jnp.where(above, jnp.where(x.hi > 0, y.lo, y.hi), jnp.where(below & (x.lo < 0), y.hi, y.lo))
    low_x = jnp.where(above & ~((x.hi == 0) & (y.hi == 0)), x.hi, x.lo)
    high_y = jnp.where(above, jnp.where(x.lo < 0, y.lo, y.hi), jnp.where(straddling | (x.hi > 0), y.hi, y.lo))
    high_x = jnp.where(above | straddling, x.lo, x.hi)
    top = _up(angles.PI, x.dtype)
    lo, hi = _widen("atan2", angles.atan2(low_y, low_x), angles.atan2(high_y, high_x), -top, top)
    lo = jnp.where(above, jnp.maximum(lo, 0), lo)
    hi = jnp.where(below & ((y.hi < 0) | (x.lo >= 0)), jnp.minimum(hi, 0), hi)
    # across the negative axis angles jump from -pi to pi
    cut = (y.lo < 0) & (y.hi >= 0) & (x.lo < 0)
    origin = (y.lo == 0) & (y.hi == 0) & (x.lo == 0) & (x.hi == 0)
    return empty_where(origin, jnp.where(cut, -top, lo), jnp.where(cut, top, hi))


@enclosing
def sinh(x: Interval) -> Interval:
    """Return the hyperbolic sine. Source: IEEE 1788 sinh."""
    return kept_sign(x, *_widen("sinh", approximations.sinh(x.lo), approximations.sinh(x.hi)))


@enclosing
def cosh(x: Interval) -> Interval:
    """Return the hyperbolic cosine. Source: IEEE 1788 cosh."""
    # even: least at the number next to 0, largest at the one farthest from it
    near, far = jnp.maximum(jnp.maximum(x.lo, -x.hi), 0), jnp.maximum(jnp.abs(x.lo), jnp.abs(x.hi))
    lo, hi = _widen("cosh", approximations.cosh(near), approximations.cosh(far), least=1)
    return Interval(lo, jnp.where(far == 0, 1, hi))


@enclosing
def tanh(x: Interval) -> Interval:
    """Return the hyperbolic tangent. Source: IEEE 1788 tanh."""
    return kept_sign(x, *_widen("tanh", approximations.tanh(x.lo), approximations.tanh(x.hi), -1, 1))


@enclosing
def asinh(x: Interval) -> Interval:
    """Return the inverse hyperbolic sine. Source: IEEE 1788 asinh."""
    return kept_sign(x, *_widen("asinh", approximations.asinh(x.lo), approximations.asinh(x.hi)))


@enclosing
def acosh(x: Interval) -> Interval:
    """Return the inverse hyperbolic cosine of the numbers >= 1 in x. Source: IEEE 1788 acosh."""
    low, high, empty = _within(x, 1, jnp.inf)
    lo, hi = _widen("acosh", approximations.acosh(low), approximations.acosh(high), least=0)
    return empty_where(empty, lo, jnp.where(high == 1, 0, hi))


@enclosing
def atanh(x: Interval) -> Interval:
    """Return the inverse hyperbolic tangent of the numbers of x in (-1, 1). Source: IEEE 1788 atanh."""
    low, high, _ = _within(x, -1, 1)
    out = kept_sign(x, *_widen("atanh", approximations.atanh(low), approximations.atanh(high)))
    return empty_where(
        (x.hi <= -1) | (x.lo >= 1),
        jnp.where(x.lo <= -1, -jnp.inf, out.lo),
        jnp.where(x.hi >= 1, jnp.inf, out.hi),
    )


@enclosing
def fma(x: Interval, y: Interval, z: Interval) -> Interval:
    """Return x * y + z, rounded once. Source: IEEE 1788 fma."""
    factors = [(a, b) for a in (x.lo, x.hi) for b in (y.lo, y.hi)]
    low, high = ([_fused(a, b, c, side) for a, b in factors] for side, c in enumerate((z.lo, z.hi)))
    return Interval(reduce(jnp.minimum, low), reduce(jnp.maximum, high))


def _fused(a: jax.Array, b: jax.Array, c: jax.Array, side: int) -> jax.Array:
    """Return a bound of a b + c from below (side 0) or above (1): two_prod and two_sum keep what the product
    and the sum lose.

    Factors whose product could overflow or lose digits to underflow, and sums that could overflow, are
    rounded twice instead.
    """
    info, zero = np.finfo(a.dtype), (a == 0) | (b == 0)
    moderate = lambda v: (
        (jnp.abs(v) < 2.0 ** (info.maxexp // 2 - 2)) & (jnp.abs(v) > 2.0 ** (info.minexp // 4))
    )
    # where two_prod loses nothing
    fine = (moderate(a) & moderate(b) | zero) & (jnp.abs(c) < info.max / 4)
    p, e = rounding.two_prod(*(jnp.where(fine & ~zero, v, 0) for v in (a, b)))
    s, t = rounding.two_sum(p, jnp.where(fine, c, 0))
    product = jnp.where(zero, 0, a * b)
    bound = lambda v: rounding.outward(v, v)[side]
    rounded = jnp.where(fine, bound(s + (t + e)), bound(bound(product) + jnp.where(jnp.isinf(c), 0, c)))
    unbounded = (jnp.isinf(a) | jnp.isinf(b)) & ~zero
    return jnp.where(jnp.isinf(c), c, jnp.where(unbounded, product, rounded))
