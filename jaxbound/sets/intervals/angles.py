"""Sine, cosine and their inverses of floats, from + - * / and bits alone, with known errors as in
`approximations`.

| function | reduction | bound of the error in u |
|---|---|---|
| sin, cos | x = k pi/2 + r, pi/2 in parts so short that k times each is exact | 1.7: polynomials on |r| <
0.79 | | tan | sin / cos, a corrected quotient | 4.4 |
| atan, atan2 | t = (a - c b) / (b + c a), c in 0, 1/4, 1/2, 1; |t| < 0.163 | 4.2: t 2.1, two sums |
| asin, acos | near 0 a polynomial, elsewhere atan2 with sqrt((1 - x)(1 + x)) | 4.2: the root 2.4, t 0.7, two
sums |
"""

import math
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals.approximations import ODD, series, split_floats, two_parts, with_derivative

LARGEST_ANGLE = {8: 2.0**20, 4: 2.0**11}  # by itemsize: multiples of the parts of pi/2 are exact up to here
PI = Fraction("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899")
ATAN_1_4 = Fraction("0.24497866312686415417208248121127581091414409838118406712737591466735")
ATAN_1_2 = Fraction("0.46364760900080611621425623146121440202853705428612026381093308872018")

PI_HALVES = {8: split_floats(PI / 2, (32, 65, 98)), 4: split_floats(PI / 2, (11, 23, 35, 47))}
SHORT = {8: 51, 4: 22}  # one float and its rest
ANGLES = {
    c: two_parts(v, SHORT)
    for c, v in ((0.25, ATAN_1_4), (0.5, ATAN_1_2), (1, PI / 4), ("half", PI / 2), ("whole", PI))
}
FACTORIALS = [1 / math.factorial(n) for n in range(18)]
SIN = {8: FACTORIALS[3:18:2], 4: FACTORIALS[3:10:2]}
COS = {8: FACTORIALS[4:18:2], 4: FACTORIALS[4:12:2]}
ARCSINE = [math.comb(2 * n, n) / 4**n / (2 * n + 1) for n in range(1, 15)]
ASIN = {8: ARCSINE, 4: ARCSINE[:6]}


def sin_cos_quadrant(x: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (sin x, cos x, q) for |x| <= LARGEST_ANGLE, x between q pi/2 and (q + 1) pi/2 exactly."""
    sine, cosine, k, below = _sin_cos(x)
    return sine, cosine, k - below


def tan(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (tan x, q), q as in `sin_cos_quadrant`."""
    sine, cosine, q = sin_cos_quadrant(x)
    return rounding.quotient(sine, cosine), q


def _reduced(x: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (r, rest, k) with x = k pi/2 + r + rest to more than twice the digits of x."""
    first, *middle, last = PI_HALVES[x.dtype.itemsize]
    k = jnp.round(x * float(2 / PI))
    r, rest = (
        x - k * first,
        jnp.zeros_like(x),
    )  # exact: a multiple of the last digit of x, or of k times the first part
    for part in middle:
        r, e = rounding.two_sum(r, -k * part)
        rest = rest + e
    r, rest = rounding.two_sum(r, rest - k * last)
    return r, rest, k


@jax.custom_jvp
def _sin_cos(x: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    r, rest, k = _reduced(x)
    z = r * r
    s = r + (rest - r * (z * series(z, SIN, alternating=True)))
    c = 1 - (0.5 * z - (z * z * series(z, COS, alternating=True) - r * rest))
    odd = k - 2 * jnp.floor(0.5 * k) > 0.5
    half = k - 4 * jnp.floor(0.25 * k)  # 0, 1, 2, 3
    sine = jnp.where(odd, c, s) * jnp.where(half > 1.5, -1, 1)
    cosine = jnp.where(odd, s, c) * jnp.where((half > 0.5) & (half < 2.5), -1, 1)
    return sine, cosine, k, jnp.where(r < 0, 1, 0).astype(x.dtype)


@_sin_cos.defjvp
def _sin_cos_rule(primals, tangents):
    sine, cosine, k, below = _sin_cos(*primals)
    return (sine, cosine, k, below), (
        cosine * tangents[0],
        -sine * tangents[0],
        jnp.zeros_like(k),
        jnp.zeros_like(k),
    )


def _angle(a: jax.Array, b: jax.Array) -> jax.Array:
    """Return atan(a / b) for 0 <= a <= b, b of moderate size: atan c + atan t, t = (a - c b) / (b + c a)."""
    size = a.dtype.itemsize
    c, high, low = jnp.zeros_like(a), jnp.zeros_like(a), jnp.zeros_like(a)
    for value, limit in ((0.25, 0.125), (0.5, 0.37), (1, 0.72)):
        above = a > limit * b
        c, high, low = (
            jnp.where(above, new, old)
            for new, old in zip((value, *ANGLES[value][size]), (c, high, low), strict=True)
        )
    t = rounding.quotient(a - c * b, b + c * a)
    z = t * t
    return high + (t + (low - t * (z * series(z, ODD, alternating=True))))


def _direction(y: jax.Array, x: jax.Array) -> jax.Array:
    """Return the angle in [0, pi] of (x, y), y >= 0."""
    size = x.dtype.itemsize
    length = jnp.abs(x)
    angle = _angle(jnp.minimum(y, length), jnp.maximum(y, length))
    (half, half_rest), (whole, whole_rest) = ANGLES["half"][size], ANGLES["whole"][size]
    angle = jnp.where(y > length, (half - angle) + half_rest, angle)
    return jnp.where(x < 0, (whole - angle) + whole_rest, angle)


@jax.custom_jvp
def atan2(y: jax.Array, x: jax.Array) -> jax.Array:
    """Return the angle of (x, y) in [-pi, pi]; both 0, or both infinite, give a number without meaning."""
    largest = jnp.maximum(jnp.abs(y), jnp.abs(x))
    far = 2.0 ** (np.finfo(x.dtype).maxexp // 2)
    s = jnp.where(largest > far, 1 / far, jnp.where(largest < 1 / far, far, 1))
    finite = jnp.isfinite(largest)
    one = lambda v: jnp.where(finite, v * s, jnp.where(jnp.isinf(v), jnp.sign(v), 0))
    y_near, x_near = one(y), one(x)
    x_near = jnp.where((x_near == 0) & (y_near == 0), 1, x_near)
    angle = _direction(jnp.abs(y_near), x_near)
    return jnp.where(y < 0, -angle, angle)


@with_derivative(lambda x, y: 1 / (1 + x * x))
def atan(x: jax.Array) -> jax.Array:
    """Return the inverse tangent; from 2^100 on pi / 2."""
    return jnp.copysign(_direction(jnp.minimum(jnp.abs(x), 2.0**100), jnp.ones_like(x)), x)


@atan2.defjvp
def _atan2_rule(primals, tangents):
    (y, x), (dy, dx) = primals, tangents
    square = x * x + y * y
    finite = (square > 0) & jnp.isfinite(square)
    square = jnp.where(finite, square, 1)
    return atan2(y, x), jnp.where(finite, (x / square) * dy - (y / square) * dx, 0)


def _arcsine_near(x: jax.Array) -> jax.Array:
    z = jnp.minimum(x * x, 0.0625)
    return x + x * (z * series(z, ASIN))


@with_derivative(lambda x, y: 1 / jnp.sqrt((1 - x) * (1 + x)))
def asin(x: jax.Array) -> jax.Array:
    """Return the inverse sine of -1 <= x <= 1."""
    size = jnp.abs(x)
    far = _direction(size, rounding.root((1 - size) * (1 + size)))
    return jnp.where(size > 0.25, jnp.copysign(far, x), _arcsine_near(x))


@with_derivative(lambda x, y: -1 / jnp.sqrt((1 - x) * (1 + x)))
def acos(x: jax.Array) -> jax.Array:
    """Return the inverse cosine of -1 <= x <= 1; from 7/8 on 2 asin(sqrt((1 - x) / 2))."""
    far = _direction(rounding.root((1 - x) * (1 + x)), x)
    return jnp.where(x > 0.875, 2 * _arcsine_near(rounding.root(0.5 * (1 - x))), far)
