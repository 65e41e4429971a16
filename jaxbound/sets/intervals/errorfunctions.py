"""The error function of Intervals and its complement, rounded outward.

Both are evaluated in interval arithmetic, so that nothing is claimed of rounding beyond what `interval` and
`elementary` claim; what is cut off is an interval, too.

Up to 2.5 erf x = 2 x e^(-x^2) / sqrt(pi) (1 + z/3 (1 + z/5 (1 + ...))) with z = 2 x^2: the innermost bracket
lies between 1 and 1 / (1 - z/n). Beyond, erfc x = e^(-x^2) / sqrt(pi) / (x + 1/2 / (x + 2/2 / (x + 3/2 / (x +
...)))): the innermost denominator lies between x and x + n / (2 x). The bounds of erf lie within 200 ulps.

Source: Abramowitz and Stegun 1964, 7.1.6 and 7.1.14.
"""

from fractions import Fraction

import jax
import jax.numpy as jnp

from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals.elementary import enclosing, exp, kept_sign
from jaxbound.sets.intervals.interval import Interval, add, div, mul, neg, sqr, sub

__all__ = ["erf", "erfc"]

TWO_OVER_ROOT_PI = Fraction("1.12837916709551257389615890312154517168810125865799771368817")
"""2 / sqrt(pi), further than either of its nearest floats is told apart by."""
NEAR = 2.5
TERMS, FRACTIONS = 48, 60
LARGEST = 30.0
"""An argument from which on 1 - erf is below the smallest normal number, and so is erfc."""


@enclosing
def erf(x: Interval) -> Interval:
    """Return the error function."""
    near, far = _parts(x)
    beyond = jnp.abs(_ends(x)) > NEAR
    far = sub(_number(1, far), far)
    lo, hi = (jnp.where(beyond, f, n) for f, n in ((far.lo, near.lo), (far.hi, near.hi)))
    low, high = _of_sign(x, lo, hi)
    return kept_sign(x, jnp.maximum(low, -1), jnp.minimum(high, 1))


@enclosing
def erfc(x: Interval) -> Interval:
    """Return 1 - erf x, to relative precision where x is large."""
    near, far = _parts(x)
    ends = _ends(x)
    one = _number(1, near)
    close, mirrored = sub(one, near), sub(_number(2, far), far)
    opposite = add(one, near)
    beyond, negative = jnp.abs(ends) > NEAR, ends < 0
    lo, hi = (
        jnp.where(negative, jnp.where(beyond, m, o), jnp.where(beyond, f, c))
        for m, o, f, c in (
            (mirrored.lo, opposite.lo, far.lo, close.lo),
            (mirrored.hi, opposite.hi, far.hi, close.hi),
        )
    )
    low, high = jnp.maximum(lo[1], 0), jnp.minimum(hi[0], 2)  # it falls
    return Interval(jnp.where(x.hi > LARGEST, 0, low), high)


def _ends(x: Interval) -> jax.Array:
    """Return the ends of x, (2, ...)."""
    return jnp.stack([x.lo, x.hi])


def _of_sign(x: Interval, lo: jax.Array, hi: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the bounds of an odd function that rises, from those at the sizes of both ends."""
    return jnp.where(x.lo < 0, -hi[0], lo[0]), jnp.where(x.hi < 0, -lo[1], hi[1])


def _parts(x: Interval) -> tuple[Interval, Interval]:
    """Return erf of the sizes of the ends of x, at most NEAR, and erfc of them, at least that; (2, ...)."""
    size = jnp.minimum(jnp.abs(_ends(x)), LARGEST)
    return _near(jnp.minimum(size, NEAR)), _far(jnp.maximum(size, NEAR))


def _near(size: jax.Array) -> Interval:
    x = Interval(size, size)
    z = mul(_number(2, x), sqr(x))

    def inward(bracket: Interval, n: jax.Array) -> tuple[Interval, None]:
        return add(_number(1, x), mul(div(z, Interval(n, n)), bracket)), None

    share = div(z, _number(2 * TERMS + 3, x))
    innermost = Interval(jnp.ones_like(size), div(_number(1, x), sub(_number(1, x), share)).hi)
    odd = jnp.arange(2 * TERMS + 1, 1, -2, dtype=size.dtype)
    bracket, _ = jax.lax.scan(inward, innermost, odd)
    return mul(mul(mul(_two_over_root_pi(x), x), exp(neg(sqr(x)))), bracket)


def _far(size: jax.Array) -> Interval:
    x = Interval(size, size)

    def inward(denominator: Interval, n: jax.Array) -> tuple[Interval, None]:
        return add(x, div(Interval(n / 2, n / 2), denominator)), None

    innermost = Interval(size, add(x, div(_number(FRACTIONS / 2, x), x)).hi)
    counts = jnp.arange(FRACTIONS - 1, 0, -1, dtype=size.dtype)
    denominator, _ = jax.lax.scan(inward, innermost, counts)
    half = div(_two_over_root_pi(x), _number(2, x))
    return div(mul(half, exp(neg(sqr(x)))), denominator)


def _number(value: float, like: Interval) -> Interval:
    whole = jnp.full_like(like.lo, value)
    return Interval(whole, whole)


def _two_over_root_pi(like: Interval) -> Interval:
    """Return the constant, as wide as its two nearest floats are apart."""
    lo, hi = (side(TWO_OVER_ROOT_PI, like.dtype) for side in (rounding.round_down, rounding.round_up))
    return Interval(jnp.full_like(like.lo, lo), jnp.full_like(like.hi, hi))
