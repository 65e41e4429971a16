"""Exponentials, logarithms, hyperbolic functions and powers of floats, from + - * / and bits alone: their
errors are known everywhere.

A compiler's own functions are not to be trusted: log1p was seen 113 ulps off. Here (and in `angles`) every
argument is reduced exactly, or with digits to spare, to a range on which a Taylor polynomial has a remainder
far below u, and roundings are counted: u as in `rounding`, in units of the result. `UNITS` is what
`rounding.outward` needs: the bound of the error plus 1.16, rounded up.

| function | reduction | bound of the error in u |
|---|---|---|
| exp, exp2, exp10 | x = k log 2 + r, e^x = 2^k (1 + r + ...) | 2.5: r 0.25, the polynomial 0.65, 1 + s 0.5,
relative to 0.7 or more | | log | x = 2^k m, f = m - 1, log m = f - (f^2/2 - s (f^2/2 + R)), s = f / (2 + f) |
2.4: terms 0.45, relative to 0.34 or more, a sum | | log2, log10 | the same, times 1 / log 2 or 1 / log 10 |
3.9: two more roundings | | sinh, cosh | below 1 polynomials, from 1 on 2^k (1 + s), s as in exp | 3.7 |
| tanh | x (1 - q), beyond 1: 1 - q, 2 / q = 2^k e^r + 1; q by a continued fraction | 4.1: q 10.3 of which
0.32 remain, a difference | | asinh, acosh, atanh | log(1 + a), a a corrected root or quotient | 4.6, acosh
5.1 | | power | x^n by squaring in double-word arithmetic | 1.1 + 16 n u |

Every product of a reduction is exact, so that contraction into an FMA changes nothing. A flushed subnormal
costs `tiny` at most. Derivatives are the analytic ones (0 where they are infinite), so that bounds can be
tuned by gradient.
Source: the reductions are those of Muller, Elementary Functions (2016), chapters 10 and 11; the polynomials
are Taylor's.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import partial
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxbound.sets.floats import rounding

Function: TypeAlias = Callable[[jax.Array], jax.Array]

UNITS = {
    "sqrt": 4,
    "exp": 4,
    "exp2": 4,
    "exp10": 4,
    "log": 4,
    "log2": 5.2,
    "log10": 5.2,
    "sin": 4,
    "cos": 4,
    "tan": 6,
    "asin": 6,
    "acos": 6,
    "atan": 6,
    "atan2": 6,
    "sinh": 6,
    "cosh": 6,
    "tanh": 5.4,
    "asinh": 6,
    "acosh": 7,
    "atanh": 6,
    "power": 4,
}

LOG_2 = Fraction("0.69314718055994530941723212145817656807550013436025525412068000949339362196969472")
LOG_10 = Fraction("2.30258509299404568401799145468436420760110148862877297603332790096757260967735248")


def split_floats(value: Fraction, grids: Sequence[int]) -> list[float]:
    """Split an exact number into floats: the first ones multiples of 2^-g for g in grids, the last one the
    rest.
    """
    out = []
    for g in grids:
        out.append(Fraction(math.floor(value * 2**g), 2**g))
        value -= out[-1]
    return [float(v) for v in (*out, value)]


GRID = {8: 42, 4: 15}  # multiples of log 2 with k up to 2^11 (2^8) are exact on this grid


def two_parts(value: Fraction, grid: Mapping[int, int]) -> dict[int, list[float]]:
    """Split an exact number for each size of float into a multiple of 2^-g and the rest."""
    return {size: split_floats(value, (digits,)) for size, digits in grid.items()}


BASES = {  # base b: log_b 2 in two parts, 1 / log_b 2, log b
    "e": (two_parts(LOG_2, GRID), float(1 / LOG_2), 1.0),
    "2": (two_parts(Fraction(1), GRID), 1.0, float(LOG_2)),
    "10": (two_parts(LOG_2 / LOG_10, GRID), float(LOG_10 / LOG_2), float(LOG_10)),
}
INVERSE = {"e": 1.0, "2": float(1 / LOG_2), "10": float(1 / LOG_10)}  # 1 / log b


# Taylor coefficients, from the first one left out of the leading terms; the last term dropped is below 0.1 u
FACTORIALS = [1 / math.factorial(n) for n in range(22)]
EXP = {8: FACTORIALS[2:15], 4: FACTORIALS[2:9]}
SINH = {8: FACTORIALS[3:20:2], 4: FACTORIALS[3:12:2]}
COSH = {8: FACTORIALS[4:21:2], 4: FACTORIALS[4:13:2]}
# tanh y = y (B - w N) / B, w = y^2: the continued fraction 1 / (1 + w / (3 + w / (5 + ...))) cut after 9
# terms, or 6; exact integers
TANH_B = {8: [34459425.0, 16216200.0, 945945.0, 13860.0, 45.0], 4: [10395.0, 4725.0, 210.0, 1.0]}
TANH_N = {8: [11486475.0, 810810.0, 12870.0, 44.0], 4: [3465.0, 189.0, 1.0]}
ODD = {8: [1 / (2 * n + 1) for n in range(1, 11)], 4: [1 / (2 * n + 1) for n in range(1, 5)]}
LOG = ODD


def series(z: jax.Array, coefficients: Mapping[int, Sequence[float]], alternating: bool = False) -> jax.Array:
    """Return the polynomial c0 + c1 z + c2 z^2 + ... (with alternating signs: in -z)."""
    chosen = coefficients[z.dtype.itemsize]
    z = -z if alternating else z
    total = jnp.full_like(z, chosen[-1])
    for c in chosen[-2::-1]:
        total = total * z + c
    return total


def with_derivative(
    derivative: Callable[[jax.Array, jax.Array], ArrayLike],
) -> Callable[[Function], Function]:
    """Make f(x) differentiable by derivative(x, f(x)), 0 where that is not finite."""

    def decorate(f):
        g = jax.custom_jvp(f)

        @g.defjvp
        def rule(primals, tangents):
            y = g(*primals)
            slope = derivative(primals[0], y)
            return y, jnp.where(jnp.isfinite(slope), slope, 0) * tangents[0]

        return g

    return decorate


# exponentials


def _exp_reduced(x: jax.Array, base: str = "e") -> tuple[jax.Array, jax.Array]:
    """Return (r, k) with base^x = 2^k e^r, |r| < 0.35."""
    digits, per_unit, log_base = BASES[base]
    high, low = digits[x.dtype.itemsize]
    k = jnp.round(x * per_unit)
    return ((x - k * high) - k * low) * log_base, k


def _exp_parts(x: jax.Array, base: str = "e") -> tuple[jax.Array, jax.Array]:
    """Return (s, k) with base^x = 2^k (1 + s), |s| < 0.42."""
    r, k = _exp_reduced(x, base)
    return r + r * r * series(r, EXP), k


def _exponential(base: str) -> Function:
    """Return the function base^x: 0 where it is below 1.42 times the smallest normal number, twice which
    `rounding.outward` adds.
    """
    _, per_unit, log_base = BASES[base]

    @with_derivative(lambda x, y: y * log_base)
    def power(x: jax.Array) -> jax.Array:
        top = np.finfo(x.dtype).maxexp
        if base == "2":  # its smallest value is exact
            s, k = _exp_parts(jnp.clip(x, -1.1 * top, 1.1 * top), base)
            return rounding.scale(1 + s, k)
        s, k = _exp_parts(jnp.clip(x, (2 - top) / per_unit, (top + 1) / per_unit), base)
        return (2 + 2 * s) * rounding.power_of_two(k - 1)

    return power


exp, exp2, exp10 = map(_exponential, BASES)


# logarithms


def _log1p_near(f: jax.Array) -> jax.Array:
    """Return log(1 + f) for 1 + f between sqrt(1/2) and sqrt(2)."""
    s, half_square = f / (2 + f), 0.5 * f * f
    z = s * s
    return f - (half_square - s * (half_square + 2 * z * series(z, LOG)))


def _logarithm(base: str) -> Function:
    """Return the logarithm of normal x > 0 to a base."""

    @with_derivative(lambda x, y: INVERSE[base] / x)
    def log(x: jax.Array) -> jax.Array:
        m, k = rounding.mantissa_exponent(x)
        return _joined(_log1p_near(m - 1), k, x, base)

    return log


def _joined(near: jax.Array, k: jax.Array, x: jax.Array, base: str = "e") -> jax.Array:
    high, low = BASES[base][0][x.dtype.itemsize]
    near = near if base == "e" else near * INVERSE[base]
    return jnp.where(jnp.isinf(x), x, k * high + (near + k * low))


log, log2, log10 = map(_logarithm, BASES)


def _log1p(a: jax.Array, shift: jax.Array) -> jax.Array:
    """Return log(1 + a) + shift log 2 for a >= 0, without the rounding of 1 + a: f = a 2^-k + (2^-k - 1)."""
    _, k = rounding.mantissa_exponent(1 + a)
    k = jnp.minimum(k, np.finfo(a.dtype).maxexp - 2)
    unit = rounding.power_of_two(-k)
    return _joined(_log1p_near(a * unit + (unit - 1)), k + shift, a)


@with_derivative(lambda x, y: 1 / jnp.sqrt(1 + x * x))
def asinh(x: jax.Array) -> jax.Array:
    """Return the inverse hyperbolic sine: log(1 + a), a = |x| + x^2 / (1 + sqrt(1 + x^2)); from 2^60 on log(2
    |x|).
    """
    size = jnp.abs(x)
    big = size > 2.0**60
    v = jnp.minimum(size, 2.0**60)
    square = v * v
    a = jnp.where(big, size * 0.25, v + square / (1 + jnp.sqrt(1 + square)))
    small = jnp.where(square > rounding.tiny(x.dtype), _log1p(a, jnp.where(big, 3, 0).astype(x.dtype)), size)
    return jnp.where(jnp.isinf(size), x, jnp.copysign(small, x))


@with_derivative(lambda x, y: 1 / jnp.sqrt((x - 1) * (x + 1)))
def acosh(x: jax.Array) -> jax.Array:
    """Return the inverse hyperbolic cosine of x >= 1: log(1 + a), a = t + sqrt(t (t + 2)), t = x - 1; from
    2^60 on log(2 x).
    """
    big = x > 2.0**60
    t = jnp.minimum(x, 2.0**60) - 1
    a = jnp.where(big, x * 0.25, t + rounding.root(t * (t + 2)))
    return jnp.where(jnp.isinf(x), x, _log1p(a, jnp.where(big, 3, 0).astype(x.dtype)))


@with_derivative(lambda x, y: 1 / ((1 - x) * (1 + x)))
def atanh(x: jax.Array) -> jax.Array:
    """Return the inverse hyperbolic tangent of -1 < x < 1: log(1 + 2 |x| / (1 - |x|)) / 2; near 0 its
    series.
    """
    size = jnp.abs(x)
    z = jnp.minimum(size, 0.17) ** 2
    inner = jnp.minimum(size, 1 - rounding.unit(x.dtype))
    far = 0.5 * _log1p(rounding.quotient(2 * inner, 1 - inner), jnp.zeros_like(x))
    return jnp.where(size > 0.17, jnp.copysign(far, x), x + x * (z * series(z, ODD)))


# hyperbolic functions


def _small_sinh_cosh(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    z = jnp.minimum(x * x, 1)
    return x + x * (z * series(z, SINH)), 1 + (0.5 * z + z * z * series(z, COSH))


def _large_sinh_cosh(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return both for x >= 1: 2^(k-1) (1 + (s -+ h)), h = 2^-2k / (1 + s)."""
    s, k = _exp_parts(jnp.minimum(x, 0.8 * np.finfo(x.dtype).maxexp))
    h = rounding.power_of_two(-2 * jnp.clip(k, 0, 60)) / (1 + s)
    return rounding.scale(1 + (s - h), k - 1), rounding.scale(1 + (s + h), k - 1)


@with_derivative(lambda x, y: cosh(x))
def sinh(x: jax.Array) -> jax.Array:
    """Return the hyperbolic sine."""
    size = jnp.abs(x)
    return jnp.where(size > 1, jnp.copysign(_large_sinh_cosh(size)[0], x), _small_sinh_cosh(x)[0])


@with_derivative(lambda x, y: sinh(x))
def cosh(x: jax.Array) -> jax.Array:
    """Return the hyperbolic cosine."""
    size = jnp.abs(x)
    return jnp.where(size > 1, _large_sinh_cosh(size)[1], _small_sinh_cosh(size)[1])


@with_derivative(lambda x, y: (1 - y) * (1 + y))
def tanh(x: jax.Array) -> jax.Array:
    """Return the hyperbolic tangent: |x| (1 - q), q = w N / B, up to 1; from there 1 - q, q = 2 / (e^2|x| +
    1); 1 beyond 30.

    With tanh y = y A / B, A = B - w N, e^r is (B + y A) / (B - y A), y = r / 2: one division serves both.
    """
    size = jnp.abs(x)
    far = size > 1
    r, k = _exp_reduced(jnp.minimum(2 * size, 60))
    y, unit = jnp.where(far, 0.5 * r, size), rounding.power_of_two(k)
    w = y * y
    B, wN = series(w, TANH_B), w * series(w, TANH_N)
    yA = y * (B - wN)
    q = jnp.where(far, 2 * (B - yA), wN) / jnp.where(far, (unit + 1) * B + (unit - 1) * yA, B)
    whole = jnp.where(far, jnp.copysign(1, x), x)
    return whole - whole * q


# powers


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def power(x: jax.Array, n: int) -> jax.Array:
    """Return x^n for normal x >= 0 and a Python integer n > 0, by squaring in double-word arithmetic with
    exponents apart.
    """
    inside = (x > 0) & jnp.isfinite(x)
    m, k = rounding.mantissa_exponent(jnp.where(inside, x, 1))
    base, exponent = (m, jnp.zeros_like(m)), jnp.zeros_like(m)
    out: rounding.Pair | None = None
    while n:
        if n & 1:
            out, exponent = base if out is None else rounding.dd_mul(out, base), exponent + k
        n >>= 1
        if n:
            high, low = rounding.dd_mul(base, base)
            m, more = rounding.mantissa_exponent(high)
            base, k = (m, low * rounding.power_of_two(-more)), jnp.clip(2 * k + more, -1e5, 1e5)
    assert out is not None  # n > 0
    limit = 1.9 * np.finfo(x.dtype).maxexp
    m, more = rounding.mantissa_exponent(out[0] + out[1])
    return jnp.where(inside, rounding.scale(m, jnp.clip(exponent + more, -limit, limit)), x)


@power.defjvp
def _power_rule(n, primals, tangents):
    (x,), (dx,) = primals, tangents
    slope = n * (power(x, n - 1) if n > 1 else jnp.ones_like(x))
    return power(x, n), jnp.where(jnp.isfinite(slope), slope, 0) * dx
