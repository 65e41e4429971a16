"""The only file that knows about ulps: how far a compiled floating-point result can be from the exact one.

What a compiler may do to `a * b + c` is wide: contract it into one FMA, replace a division by a product with a
reciprocal, add in any order, flush subnormals to zero on the way in and on the way out. Everything here holds under all of these.

Notation: u is half the spacing of floats at 1, tiny the smallest normal number, both of the working dtype.

**One operation** (`outward`). A compiled +, -, * or / whose exact result is r returns f with
|f - r| <= 2.84 u |f| + tiny (2.84: a quotient by a reciprocal, 1.42 ulp; tiny: a flushed result). Subtracting
4 u |f| + 2 tiny and rounding once more costs at most u |f|, and 2.84 + 1 < 4. The claim needs no barrier: contraction into an
FMA only removes roundings. A quotient needs a divisor whose reciprocal is not flushed: `interval.div` scales it first.

**One sum of products** (`residual_error`). See its docstring: a forward error bound that covers a whole residual, once.

**Bounds and coefficients** come from decimals. `fraction_to_float` rounds them to nearest (counted in `residual_error`),
`round_up` away from zero, so that a float bound is never smaller than the decimal the user wrote.
"""

from fractions import Fraction
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

__all__ = [
    "dd_add",
    "dd_mul",
    "fraction_to_float",
    "outward",
    "outward_sum",
    "residual_error",
    "round_down",
    "round_up",
    "settle_subnormals",
    "tiny",
    "two_prod",
    "two_sum",
    "unit",
]


def unit(dtype):
    """Return the unit roundoff u (2^-53 in float64) as a scalar of `dtype`."""
    return np.asarray(np.finfo(dtype).eps / 2, dtype)[()]


def tiny(dtype):
    """Return the smallest normal number of `dtype`: the largest error of a flushed subnormal."""
    return np.asarray(np.finfo(dtype).tiny, dtype)[()]


def outward(lo, hi):
    """Widen the computed bounds (lo, hi) of one operation so that they enclose the exact ones.

    A bound that overflowed to the wrong infinity falls back to the largest finite number.
    """
    u4, t2, top = 4 * unit(lo.dtype), 2 * tiny(lo.dtype), np.finfo(lo.dtype).max
    lo_out = jnp.where(lo == jnp.inf, top, lo - (u4 * jnp.abs(lo) + t2))
    hi_out = jnp.where(hi == -jnp.inf, -top, hi + (u4 * jnp.abs(hi) + t2))
    return lo_out, hi_out


@partial(jax.jit, static_argnums=2)
def outward_sum(lo, hi, axis):
    """Enclose the sums of lo and of hi along `axis`, in any order of addition.

    n terms added in any order are off by at most (n - 1) u sum|x|, and sum|x| is at most its computed value / (1 - n u).
    A sum whose magnitudes overflow, or of more than 1 / (2 u) terms, is unbounded.
    """
    n = lo.shape[axis]
    share = (n + 4) * float(unit(lo.dtype))
    grow = np.asarray(share / (1 - share) if share < 0.5 else np.inf, lo.dtype)
    floor = np.asarray((n + 2) * float(tiny(lo.dtype)), lo.dtype)
    below, above = (grow * _total(jnp.abs(x), axis) + floor for x in (lo, hi))
    return (
        jnp.where(below < jnp.inf, _total(lo, axis) - below, -jnp.inf),
        jnp.where(above < jnp.inf, _total(hi, axis) + above, jnp.inf),
    )


def _total(x, axis):
    """Add along a short axis term by term, which fuses with its surroundings; a reduction does not."""
    if x.shape[axis] > 32:
        return jnp.sum(x, axis)
    parts = [jax.lax.index_in_dim(x, i, axis, keepdims=False) for i in range(x.shape[axis])]
    return sum(parts[1:], parts[0]) if parts else jnp.sum(x, axis)


def residual_error(terms, dtype):
    """Return (gamma, floor) such that a compiled strip test is safe with the slack gamma * scale + floor.

    The test is |sum_i h_i m_i - sum_j k_j v_j| <= sum_i |h_i| r_i with, per row i,

        d = y - offset,  m = d + sigma clip(d, -rho, rho),  r = rho + sigma max(|d|, rho),
        scale = sum_i |h_i| ((1 + sigma_i)(|y_i| + |offset_i|) + r_i) + sum_j |k_j| (|v_j| + |offset_j|).

    Proof, counting relative roundings, every one <= u: y and v may have been rounded once to the working dtype and so has each
    offset, the difference adds one: 2 u (|y| + |offset|) on d. With clip(d, -rho, rho) and max(|d|, rho) computed as half the difference
    and half the sum of |d + rho| and |d - rho|, m is off by 5 u (1 + sigma)(|y| + |offset|) + 3 u r.
    h is a rounded rational times a rounded 1 / ((1 - sigma)(1 + sigma)): 8 u. A product adds 1, a sum of N terms N - 1, in any order.
    Hence (N + 13) u on the left-hand side; likewise (N + 11) u on the right-hand side; comparing the two adds 2.
    Sum: (2 N + 26) u scale to first order; 2 N + 32 covers second-order terms and the rounding of the slack itself for
    N u < 1e-3. Each of at most 8 N operations may flush a result below `tiny`, after which a factor |h| may follow: `floor` is
    to be multiplied by 1 + max|h|.
    """
    return np.asarray((2 * terms + 32) * unit(dtype), dtype)[()], np.asarray(8 * terms * tiny(dtype), dtype)[()]


@jax.jit
def settle_subnormals(lo, hi):
    """Move subnormal bounds outward to 0 or to the smallest normal number: compiled code would read them as 0."""
    return _settle(lo, up=False), _settle(hi, up=True)


def _settle(x, up):
    bits, mantissa, exponent = {8: (jnp.int64, 52, 0x7FF), 4: (jnp.int32, 23, 0xFF)}[x.dtype.itemsize]
    pattern = jax.lax.bitcast_convert_type(x, bits)
    subnormal = ((pattern >> mantissa) & exponent == 0) & (pattern & ((1 << mantissa) - 1) != 0)
    edge = tiny(x.dtype)
    moved = jnp.where(pattern < 0, 0 if up else -edge, edge if up else 0)
    return jnp.where(subnormal, moved.astype(x.dtype), x)


def fraction_to_float(value, dtype=np.float64):
    """Round an exact rational to the nearest float; refuse one that `dtype` would flush to zero."""
    with np.errstate(over="ignore"):
        out = np.asarray(_nearest(value), dtype)[()]
    if value != 0 and (abs(out) < tiny(dtype) or not np.isfinite(out)):
        raise ValueError(
            f"the coefficients of a relation span more than {np.dtype(dtype).name} holds: give the signals units of similar size"
        )
    return out


def _nearest(value):
    """Return the nearest Python float of any number or numeral; infinity where it overflows."""
    try:
        return float(value)
    except OverflowError:
        return np.inf if value > 0 else -np.inf


def round_up(value, dtype=np.float64):
    """Return the float of `dtype` next above or equal to `value` (an array of floats, or of any exact numbers), on the host."""
    return _directed(value, dtype, np.inf)


def round_down(value, dtype=np.float64):
    """Return the float of `dtype` next below or equal to `value` (an array of floats, or of any exact numbers), on the host."""
    return _directed(value, dtype, -np.inf)


def _directed(value, dtype, towards):
    value = np.asarray(value)
    if value.dtype.kind != "f":  # Python's comparisons of numbers are exact; numerals become Fractions
        items = [Fraction(v) if isinstance(v, str) else v for v in value.ravel().tolist()]
        value = np.array([*items, None], object)[:-1].reshape(value.shape)
    with np.errstate(all="ignore"):
        out = np.vectorize(_nearest, otypes=[float])(value) if value.dtype == object and value.size else value
        out = out.astype(dtype)
        wrong = (out < value if towards > 0 else out > value).astype(bool)
        return np.where(wrong, np.nextafter(out, np.asarray(towards, dtype)), out)


def two_sum(a, b):
    """Return (s, e) with s = fl(a + b) and s + e = a + b exactly (Knuth).

    The barrier keeps the compiler from turning (1 + b) - 1 into b. An inexact product handed in directly may be fused into the sum.
    """
    return _two_sum(*jax.lax.optimization_barrier((a, b)))


def _two_sum(a, b):
    s = a + b
    z = s - a
    return s, (a - (s - z)) + (b - z)


def two_prod(a, b):
    """Return (p, e) with p = fl(a * b) and p + e = a * b exactly barring underflow of e.

    The products of halves and the sum of the two mixed ones fit the digits, so that contraction into an FMA changes nothing (it
    breaks Dekker's splitting, and his fl(a * b), in a batched loop).
    """
    (a_hi, a_lo), (b_hi, b_lo) = _halves(a), _halves(b)
    mixed = a_hi * b_lo + a_lo * b_hi
    s = a_hi * b_hi + mixed
    rest = mixed - (s - a_hi * b_hi) + a_lo * b_lo  # exact as well
    p = s + rest
    return p, rest - (p - s)


def _halves(x):
    """Split floats into two of half the digits, by rounding the bits."""
    bits, low = {8: (jnp.int64, 27), 4: (jnp.int32, 12)}[x.dtype.itemsize]
    pattern = jax.lax.bitcast_convert_type(x, bits) + (1 << (low - 1))
    hi = jax.lax.bitcast_convert_type(pattern & -(1 << low), x.dtype)
    return hi, x - hi


def dd_add(x, y):
    """Add two double-word numbers (hi, lo): about twice the digits of the dtype."""
    s, e = two_sum(x[0], y[0])
    t, f = two_sum(x[1], y[1])
    s, e = _two_sum(s, e + t)
    return _two_sum(s, e + f)


def dd_mul(x, y):
    """Multiply two double-word numbers (hi, lo)."""
    p, e = two_prod(x[0], y[0])
    return _two_sum(p, e + (x[0] * y[1] + x[1] * y[0]))
