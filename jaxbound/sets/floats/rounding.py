"""The only file that knows about ulps: how far a compiled floating-point result can be from the exact one.

What a compiler may do to `a * b + c` is wide: contract it into one FMA, replace a division by a product with
a reciprocal, add in any order, flush subnormals to zero on the way in and on the way out. Everything here
holds under all of these.

Notation: u is half the spacing of floats at 1, tiny the smallest normal number, both of the working dtype.

What is assumed of processor, device and compiler is asked by `probe`, before every proof.

**One operation** (`outward`). A compiled +, -, * or / whose exact result is r returns f with
|f - r| <= 2.84 u |f| + tiny (2.84: a quotient by a reciprocal, 1.42 ulp; tiny: a flushed result). Subtracting
4 u |f| + 2 tiny and rounding once more costs at most u |f|, and 2.84 + 1 < 4. The claim needs no barrier:
contraction into an FMA only removes roundings. A quotient needs a divisor whose reciprocal is not flushed:
`interval.div` scales it first. In float32 on a card of NVIDIA a quotient may be off by 4 u: there 6 u are
subtracted (`kinds.extra_units`).

**One sum of products** (`residual_error`). See its docstring: a forward error bound that covers a whole
residual, once.

**NaN.** A reduction of 4096 numbers or more, with the operations that only it reads, may go to a library
whose maximum and minimum, along an axis or of two arrays, overlook NaN; infinity stays, and so do errors as
above. So no proof waits for a maximum to show NaN: it compares something else that is NaN then (a sum, or the
row itself), and a comparison with NaN proves nothing; but what cannot be below 0, like |x| and x x, is >= 0
for the compiler without a look, NaN or not.

**Bounds and coefficients** come from decimals. `fraction_to_float` rounds them to nearest (counted in
`residual_error`), `round_up` away from zero, so that a float bound is never smaller than the decimal the user
wrote.
"""

from collections.abc import Sequence
from fractions import Fraction
from functools import partial
from itertools import starmap
from typing import Any, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike

from jaxbound.exact.linalg import Whole
from jaxbound.sets.floats.kinds import extra_units

Pair: TypeAlias = tuple[jax.Array, jax.Array]
"""A number in two floats, the second what the first leaves."""


def _scalar(value: ArrayLike, dtype: DTypeLike) -> np.floating:
    return cast(np.floating, np.asarray(value, dtype)[()])


def unit(dtype: DTypeLike) -> np.floating:
    """Return the unit roundoff u (2^-53 in float64) as a scalar of `dtype`."""
    return _scalar(np.finfo(dtype).eps / 2, dtype)


def tiny(dtype: DTypeLike) -> np.floating:
    """Return the smallest normal number of `dtype`: the largest error of a flushed subnormal."""
    return _scalar(np.finfo(dtype).tiny, dtype)


def outward(lo: ArrayLike, hi: ArrayLike, units: float | np.floating = 4) -> tuple[jax.Array, jax.Array]:
    """Widen the computed bounds (lo, hi) of one operation so that they enclose the exact ones.

    The bounds may be off by (units - 1.16) u |f| + tiny: four units fit one operation; `approximations`
    states its own. Where quotients are coarse there are two more (`kinds.extra_units`). A bound that
    overflowed to the wrong infinity falls back to the largest finite number.
    """
    lo, hi = jnp.asarray(lo), jnp.asarray(hi)
    units = units + extra_units(lo.dtype)
    u4, t2, top = np.asarray(units, lo.dtype)[()] * unit(lo.dtype), 2 * tiny(lo.dtype), np.finfo(lo.dtype).max
    lo_out = jnp.where(lo == jnp.inf, top, lo - (u4 * jnp.abs(lo) + t2))
    hi_out = jnp.where(hi == -jnp.inf, -top, hi + (u4 * jnp.abs(hi) + t2))
    return lo_out, hi_out


@partial(jax.jit, static_argnums=2)
def outward_sum(lo: jax.Array, hi: jax.Array, axis: int) -> tuple[jax.Array, jax.Array]:
    """Enclose the sums of lo and of hi along `axis`, in any order of addition.

    n terms added in any order are off by at most (n - 1) u sum|x|, and sum|x| is at most its computed value /
    (1 - n u). A sum whose magnitudes overflow, or of more than 1 / (2 u) terms, is unbounded.
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


def _total(x: jax.Array, axis: int) -> jax.Array:
    """Add along a short axis term by term, which fuses with its surroundings; a reduction does not."""
    if x.shape[axis] > 32:
        return jnp.sum(x, axis)
    parts = [jax.lax.index_in_dim(x, i, axis, keepdims=False) for i in range(x.shape[axis])]
    return sum(parts[1:], parts[0]) if parts else jnp.sum(x, axis)


def residual_error(terms: int, dtype: DTypeLike) -> tuple[np.floating, np.floating]:
    """Return (gamma, floor) such that a compiled strip test is safe with the slack gamma * scale + floor.

    The test is |sum_i h_i m_i - sum_j k_j v_j| <= sum_i |h_i| r_i with, per row i,

        d = y - offset,  m = d + sigma clip(d, -rho, rho),  r = rho + sigma max(|d|, rho),
        scale = sum_i |h_i| ((1 + sigma_i)(|y_i| + |offset_i|) + r_i) + sum_j |k_j| (|v_j| + |offset_j|).

    Proof, counting relative roundings, every one <= u: y and v may have been rounded once to the working
    dtype and so has each offset, the difference adds one: 2 u (|y| + |offset|) on d. With clip(d, -rho, rho)
    and max(|d|, rho) computed as half the difference and half the sum of |d + rho| and |d - rho|, m is off by
    5 u (1 + sigma)(|y| + |offset|) + 3 u r. h is a rounded rational times a rounded 1 / ((1 - sigma)(1 +
    sigma)): 8 u. A product adds 1, a sum of N terms N - 1, in any order. Hence (N + 13) u on the left-hand
    side; likewise (N + 11) u on the right-hand side; comparing the two adds 2.
    Sum: (2 N + 26) u scale to first order; 2 N + 32 covers second-order terms and the rounding of the slack
    itself for N u < 1e-3. A noise that is the product of a bound and a factor is off by u rho more: by sigma
    u rho on m and (1 + sigma) u rho on r. Of r the left-hand side has (N + 11) u before, 2 u less than of
    |y|, so that (2 N + 26) u still holds. Each of at most 9 N operations may flush a result below `tiny`,
    after which a factor |h| may follow: `floor` is to be multiplied by 1 + max|h|.
    """
    return _scalar((2 * terms + 32) * unit(dtype), dtype), _scalar(9 * terms * tiny(dtype), dtype)


def folded_error(terms: int, dtype: DTypeLike) -> tuple[np.floating, np.floating]:
    """Return (gamma, floor) as `residual_error` does, for readings whose last factor joins the coefficient:

        d = y - offset,  q = max(|d| - rho, 0),  c = sigma / (1 + sigma),
        m = d - c sign(d) q,  r = rho + c q,  H = h / (1 - sigma),
        scale = sum_i |H_i| (S_i + r_i) + sum_j |k_j| (|v_j| + |offset_j|),

    with S = |y| + |offset|. Proof, in units of u, by c < 1/2: d is off by 2 S, rho by 3 rho, q by 3 S + 3
    rho, c by 3.84 c (a quotient and its divisor). So m is off by 2 S + c (3 S + 3 rho) + 4.84 c q and a last
    rounding, 6.92 S + 1.5 rho in all, r by 7.34 r + 1.5 S, H by 5.84 H. A product adds 1, a sum of N terms
    N - 1: (N + 12.8) S + 1.5 rho on the left-hand side, (N + 13.2) r + 1.5 S on the right, and 1 of either
    for their difference. Together less than (N + 16) u scale to first order; 9 N / 8 + 24 covers second-order
    terms and the rounding of the slack itself for N u < 1e-3. A noise that is a product is off by u rho more:
    by c u rho on m and u rho on r, in all less than (N + 18) u scale. Per row 10 flushed results may follow
    in m, 10 in r, each times |H|, and fewer than 6 in the sums: `floor` is to be multiplied by 1 + max|H|.
    """
    return _scalar((1.125 * terms + 24) * unit(dtype), dtype), _scalar(26 * terms * tiny(dtype), dtype)


def search_error(outer: int, inner: int, known: int, dtype: DTypeLike) -> tuple[np.floating, np.floating]:
    """Return (gamma, floor) for the two proofs of `sets.strips.separation`, with c outer rows, k inner rows
    and l known values.

    Per outer row, z_j = m_j - sum_i R_ji m_i - sum_b K_jb v_b is one sum of N = k + l + 1 products as in
    `residual_error`, whose bound (2 N + 32) u M_j, M_j = scale_j + sum_i |R_ji| scale_i + sum_b |K_jb| (|v_b|
    + |offset_b|), covers z_j and the radii in its row.

    Inside, |z_j - R_j d| <= r_j with |d_i| <= r_i: rounded R, products and the sum add (k + 3) u (|z_j| +
    |R_j| r) <= 2 (k + 3) u M_j. Outside, |h z| > sum_j |h_j| r_j + sum_i |h R|_i r_i: the outer sum adds (c +
    1) u |h| M on the left; on the right, h R is off by (c + 2) u |h| |R|, the radii by 11 u, their sum by (c
    + k + 1) u. Together at most (3 c + 3 k + 2 l + 50) u |h| M. Both are below (4 (c + k + l) + 52) u, the
    bound of `residual_error` for 2 (c + k + l) + 10 terms. h is
    exact: whatever it is.

    An underflow, in any of the sums of row j or in a coefficient off by that much (`nearest_normals`), costs
    tiny times at most one coefficient of R or K and one M, inner scale_i or |v_b| + |offset_b| (a column of R
    can be as small as tiny, and M then says nothing of its scale): `floor` is to be multiplied by 1 + max|R|,
    1 + max|K|, and 1 + the sum of all these.
    """
    terms = 2 * (outer + inner + known) + 10
    gamma, floor = residual_error(terms, dtype)
    return gamma, _scalar(floor * terms, dtype)


@jax.jit
def settle_subnormals(lo: jax.Array, hi: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Move subnormal bounds outward to the smallest normal number where reading them as 0, as compiled code
    does, would go inward.
    """
    return jnp.where(_inward(lo, False), -tiny(lo.dtype), lo), jnp.where(
        _inward(hi, True), tiny(hi.dtype), hi
    )


def settled_on_host(lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Settle subnormal bounds as `settle_subnormals` does, without a compilation for each shape."""
    return np.where(_inward(lo, False), -tiny(lo.dtype), lo), np.where(_inward(hi, True), tiny(hi.dtype), hi)


def _inward(x, up):
    """Say which bounds are subnormal, and nearer to the inside if read as 0."""
    pattern, least, first = _pattern(x)
    return (pattern > 0) & (pattern < least) if up else (pattern > first) & (pattern < first + least)


def readable_bounds(lo: jax.Array, hi: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return bounds that compiled code reads as they are or further out: subnormal ones settled, none
    (infinite) for NaN.
    """
    return unbounded(*settle_subnormals(lo, hi))


def unbounded(lo: jax.Array, hi: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return bounds of which none is NaN, but infinite there."""
    return jnp.where(jnp.isnan(lo), -jnp.inf, lo), jnp.where(jnp.isnan(hi), jnp.inf, hi)


def _pattern(x):
    """Return the bits of floats as integers, those of the smallest normal number and those of -0."""
    sizes: dict[int, type[np.signedinteger]] = {8: np.int64, 4: np.int32, 2: np.int16}
    bits = sizes[x.dtype.itemsize]
    pattern = x.view(bits) if isinstance(x, np.ndarray) else jax.lax.bitcast_convert_type(x, bits)
    return pattern, bits(1 << jnp.finfo(x.dtype).nmant), np.iinfo(bits).min


def order(x: jax.Array) -> jax.Array:
    """Return integers in the order of the floats x, subnormal ones included; -0 is 0. NaN is beyond all
    others of its sign.
    """
    pattern, _, first = _pattern(x)
    return jnp.where(pattern < 0, first - pattern, pattern)


def above(x: jax.Array, y: jax.Array) -> jax.Array:
    """Return whether x > y, subnormal numbers included; never for NaN."""
    return (order(x) > order(y)) & (x == x) & (y == y)


def widened(x: jax.Array, dtype: DTypeLike) -> jax.Array:
    """Convert float32 to float64 exactly, subnormal numbers included, which compiled code converts to 0."""
    if x.dtype == dtype or x.dtype.itemsize != 4:
        return x.astype(dtype)
    pattern, least, _ = _pattern(x)
    as_float = lambda v: jax.lax.bitcast_convert_type(v, x.dtype)
    small = (pattern & np.int32(0x7FFFFFFF)) < least
    digits = as_float(jnp.where(small, pattern | np.float32(2.0**23).view(np.int32), pattern))
    counted = (digits.astype(dtype) - jnp.copysign(2.0**23, digits).astype(dtype)) * 2.0**-149
    return jnp.where(small, counted, digits.astype(dtype))


def one_dtype(*trees: Any) -> Any:
    """Return the trees of arrays, a tuple of them, all in the widest dtype of any: exactly, see `widened`."""
    dtype = jnp.result_type(*jax.tree.leaves(trees))
    return jax.tree.map(lambda x: widened(x, dtype), trees)


def product_error(terms: int, dtype: DTypeLike) -> tuple[np.floating, np.floating]:
    """Return (gamma, floor): a compiled sum of `terms` products a b is within half of gamma sum|a b| + floor
    (1 + max|a|)(1 + max|b|).

    Proof: in any order, with or without FMA, the sum is off by terms u sum|a b| to first order. An a that is
    read as zero costs tiny max|b|, and likewise b; a product or partial sum that is flushed costs tiny. gamma
    holds twice that and 8 u, floor twice that: the half that is left covers the rounding of this bound itself
    and of a few operations more on it and the sum.
    """
    return _scalar(2 * (2 * terms + 8) * unit(dtype), dtype), _scalar(16 * (terms + 1) * tiny(dtype), dtype)


def fraction_to_float(value: Fraction | float, dtype: DTypeLike = np.float64) -> np.floating:
    """Round an exact rational to the nearest float; refuse one that `dtype` would flush to zero."""
    with np.errstate(over="ignore"):
        out = _scalar(_nearest(value), dtype)
    if value != 0 and (abs(out) < tiny(dtype) or not np.isfinite(out)):
        raise ValueError(
            f"the coefficients of a relation span more than {np.dtype(dtype).name} holds: give the signals "
            f"units of similar size"
        )
    return out


def nearest_normals(values: Sequence[Whole], dtype: DTypeLike = np.float64) -> np.ndarray:
    """Round rows of rationals to the nearest floats, one below the normal range to the smallest normal number
    of its sign: never to 0.
    """
    pairs = [(x, row.over) for row in values for x in row.numbers]
    out = np.array(list(starmap(_nearest, pairs)), np.float64).astype(dtype)
    for i in np.flatnonzero(abs(out) < tiny(dtype)).tolist():
        x, _ = pairs[i]
        out[i] = ((x > 0) - (x < 0)) * tiny(dtype)
    return out


def _nearest(value, over=None):
    """Return the nearest Python float of any number or numeral, or of an integer over one; infinity where it
    overflows.
    """
    try:
        return float(value) if over is None else value / over
    except OverflowError:
        return np.inf if value > 0 else -np.inf


def round_up(value: object, dtype: DTypeLike = np.float64) -> np.ndarray:
    """Return the float of `dtype` next above or equal to `value` (an array of floats, or of any exact
    numbers), on the host.
    """
    return _rounded_towards(value, dtype, np.inf)


def round_down(value: object, dtype: DTypeLike = np.float64) -> np.ndarray:
    """Return the float of `dtype` next below or equal to `value` (an array of floats, or of any exact
    numbers), on the host.
    """
    return _rounded_towards(value, dtype, -np.inf)


def _rounded_towards(value, dtype, towards):
    value = np.asarray(value)
    if value.dtype.kind != "f":  # Python's comparisons of numbers are exact; numerals become Fractions
        items = [Fraction(v) if isinstance(v, str) else v for v in value.ravel().tolist()]
        value = np.array([*items, None], object)[:-1].reshape(value.shape)
    with np.errstate(all="ignore"):
        out = np.vectorize(_nearest, otypes=[float])(value) if value.dtype == object and value.size else value
        out = out.astype(dtype)
        wrong = (out < value if towards > 0 else out > value).astype(bool)
        return np.where(wrong, np.nextafter(out, np.asarray(towards, dtype)), out)


def two_sum(a: jax.Array, b: ArrayLike) -> Pair:
    """Return (s, e) with s = fl(a + b) and s + e = a + b exactly (Knuth).

    The barrier keeps the compiler from turning (1 + b) - 1 into b. An inexact product handed in directly may
    be fused into the sum.
    """
    return _two_sum(*jax.lax.optimization_barrier((a, b)))


def _two_sum(a: jax.Array, b: jax.Array) -> Pair:
    s = a + b
    z = s - a
    return s, (a - (s - z)) + (b - z)


def two_prod(a: jax.Array, b: jax.Array) -> Pair:
    """Return (p, e) with p = fl(a * b) and p + e = a * b exactly barring underflow of e.

    The products of halves and the sum of the two mixed ones fit the digits, so that contraction into an FMA
    changes nothing (it breaks Dekker's splitting, and his fl(a * b), in a batched loop).
    """
    (a_hi, a_lo), (b_hi, b_lo) = _halves(a), _halves(b)
    mixed = a_hi * b_lo + a_lo * b_hi
    s = a_hi * b_hi + mixed
    rest = mixed - (s - a_hi * b_hi) + a_lo * b_lo  # exact as well
    p = s + rest
    return p, rest - (p - s)


def _halves(x: jax.Array) -> Pair:
    """Split floats into two of half the digits, by rounding the bits."""
    bits, low = {8: (jnp.int64, 27), 4: (jnp.int32, 12)}[x.dtype.itemsize]
    pattern = jax.lax.bitcast_convert_type(x, bits) + (1 << (low - 1))
    hi = jax.lax.bitcast_convert_type(pattern & -(1 << low), x.dtype)
    return hi, x - hi


def dd_add(x: Pair, y: Pair) -> Pair:
    """Add two double-word numbers (hi, lo): about twice the digits of the dtype."""
    s, e = two_sum(x[0], y[0])
    t, f = two_sum(x[1], y[1])
    s, e = _two_sum(s, e + t)
    return _two_sum(s, e + f)


def dd_mul(x: Pair, y: Pair) -> Pair:
    """Multiply two double-word numbers (hi, lo)."""
    p, e = two_prod(x[0], y[0])
    return _two_sum(p, e + (x[0] * y[1] + x[1] * y[0]))


def quotient(n: jax.Array, d: jax.Array) -> jax.Array:
    """Divide with an error of 1.01 u |n / d|, whatever the compiler makes of the division; d and 1 / d
    normal, n / d far from overflow.

    Half the digits of n / d leave a remainder n - q d that is exact (its products fit the digits, its digits
    start where those of q end), so that one more step gives the other half. Where n, d or q is so small that
    digits of the remainder could be flushed, it is n (1 / d), off by 2.84 u.
    """
    inverse = 1 / d
    rough = n * inverse
    q, (high, low) = _halves(rough)[0], _halves(d)
    floor = np.asarray(float(tiny(q.dtype)) / float(unit(q.dtype)) ** 2 * 4, q.dtype)
    keeps = (jnp.abs(n) > floor) & (jnp.abs(d) > floor) & (jnp.abs(rough) > floor)
    return jnp.where(keeps, q + ((n - q * high) - q * low) * inverse, rough)


def root(x: jax.Array) -> jax.Array:
    """Return the square root of x >= 0 with an error of 1.01 u, whatever the compiler's is; sqrt(0) = 0, x
    far from underflow.
    """
    s = jnp.sqrt(x)
    p, e = two_prod(s, s)
    return s + ((x - p) - e) / jnp.where(s > 0, 2 * s, 1)


def mantissa_exponent(x: jax.Array) -> Pair:
    """Split x > 0, subnormal or not, exactly into m 2^k with sqrt(1/2) <= m < sqrt(2); k is an integer as a
    float.
    """
    bits, mantissa, bias, magic = _layout(x.dtype)
    as_bits, as_float = (
        (lambda v: np.asarray(v, x.dtype).view(bits)),
        (lambda v: jax.lax.bitcast_convert_type(v, x.dtype)),
    )
    pattern = jax.lax.bitcast_convert_type(x, bits)
    whole = (
        as_float(pattern | as_bits(2.0**mantissa)) - 2.0**mantissa
    )  # a subnormal number's digits count its smallest one
    small = pattern < 1 << mantissa
    pattern = jnp.where(small, jax.lax.bitcast_convert_type(whole, bits), pattern)
    k = (pattern - as_bits(np.sqrt(0.5))) >> mantissa
    m = as_float(pattern - (k << mantissa))
    return m, as_float(jnp.where(small, k - (bias + mantissa - 1), k) + as_bits(magic)) - magic


def power_of_two(k: jax.Array) -> jax.Array:
    """Return 2^k, exactly, for an integer k (as a float) in the normal range."""
    bits, mantissa, bias, magic = _layout(k.dtype)
    # the last digits of k + magic are those of k + bias in two's complement; the shift leaves them as an
    # exponent
    return jax.lax.bitcast_convert_type(
        jax.lax.bitcast_convert_type(k + (magic + bias), bits) << mantissa, k.dtype
    )


def scale(x: jax.Array, k: jax.Array) -> jax.Array:
    """Return x 2^k, exact barring underflow (flushed) and overflow (infinite), for |k| up to twice the normal
    range.
    """
    half = jnp.floor(k * 0.5)
    return x * power_of_two(half) * power_of_two(k - half)


def _layout(dtype):
    """Return the integers of one size, the mantissa's digits, the exponent's bias and a float whose last
    digit counts ones.
    """
    bits, mantissa, bias = {8: (np.int64, 52, 1023), 4: (np.int32, 23, 127)}[jnp.dtype(dtype).itemsize]
    return bits, mantissa, bias, 1.5 * 2.0**mantissa
