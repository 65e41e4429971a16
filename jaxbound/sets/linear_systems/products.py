"""Products of float matrices with interval matrices, inverses in plain floats, and operations on intervals
without empty sets.

One matrix lies in the leading axes, a batch in the axis behind: every step is a pass over the batch.
"""

from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.unrolled import apart, largest, total
from jaxbound.sets.intervals.interval import Interval, mag, mig

Tree = TypeVar("Tree")


def preconditioner(M: Interval) -> jax.Array:
    """Return C (n, r, N): near the (pseudo-)inverse of the middle of M."""
    middle = _middle(M.lo, M.hi)
    r, n = middle.shape[:2]
    if r == n:
        return float_inverse(middle)
    near = float_inverse(apart(lambda m: total([m[i, :, None] * m[i, None] for i in range(r)]))(middle))
    return apart(lambda near, m: total([near[:, k, None] * m[None, :, k] for k in range(n)]))(near, middle)


_middle = apart(lambda lo, hi: 0.5 * lo + 0.5 * hi)


def float_inverse(a: jax.Array) -> jax.Array:
    """Return a float inverse of a (n, n, N): Gauss-Jordan in place, each step takes the row with the largest
    entry; no claim is made.
    """
    n, N = a.shape[0], a.shape[2]
    index = jnp.arange(n)[:, None]

    def step(k, carry):
        a, free, order = carry
        place = _largest(jax.lax.dynamic_index_in_dim(a, k, 1, keepdims=False), free)
        pick = _picked(place, free)
        return solved_for(a, pick, k), free - pick, jax.lax.dynamic_update_index_in_dim(order, place, k, 0)

    start = a, jnp.ones((n, N), a.dtype), jnp.zeros((n, N), jnp.int32)
    a, _, order = jax.lax.fori_loop(0, n, step, start)
    # row p_k belongs to unknown k, column j to right-hand side p_j
    source = total([jnp.where(order[j][None] == index, j, 0) for j in range(n)])
    return jnp.take_along_axis(
        a.reshape(n * n, N), (order[:, None] * n + source[None]).reshape(n * n, N), 0
    ).reshape(n, n, N)


@apart
def _largest(column: jax.Array, free: jax.Array) -> jax.Array:
    """Return the row (N,) of the largest of a column (n, N) among those that are free (1, not 0)."""
    sizes = [jnp.abs(c) * f - (1 - f) for c, f in zip(column, free, strict=True)]
    return largest(sizes, jnp.ones((), column.dtype))[1]


_picked = apart(lambda place, free: (place[None] == jnp.arange(len(free))[:, None]).astype(free.dtype))


def solved_for(a: jax.Array, pick: jax.Array, k: ArrayLike) -> jax.Array:
    """Solve the row that pick (n, N) marks with 1 for unknown k and put it into the others; column k becomes
    that of the inverse.
    """
    return _combined(a, pick, *_pivot_row(a, pick, k))


@apart
def _pivot_row(a: jax.Array, pick: jax.Array, k: ArrayLike) -> tuple[jax.Array, jax.Array, jax.Array]:
    index = jnp.arange(len(a))[:, None] == k
    row = total([pick[i][None] * a[i] for i in range(len(a))])
    over_pivot = 1 / jnp.sum(jnp.where(index, row, 0), 0)
    column = jax.lax.dynamic_index_in_dim(a, k, 1, keepdims=False)
    return jnp.where(index, 1, row) * over_pivot[None], pick - (1 - pick) * column, (~index).astype(a.dtype)


@apart
def _combined(
    a: jax.Array, pick: jax.Array, row: jax.Array, share: jax.Array, others: jax.Array
) -> jax.Array:
    return (1 - pick)[:, None] * (a * others[None]) + share[:, None] * row[None]


def times(C: jax.Array, A: Interval) -> Interval:
    """Enclose C A for numbers C (n, r, N) and an Interval A (r, k, N) or (r, N)."""
    middle, radius = _ball(A)
    return _interval(_matrix_product(C, middle), _matrix_product(_raised(C, len(A)), radius))


@apart
def _ball(A: Interval) -> tuple[jax.Array, jax.Array]:
    """Return the middle of A, and a radius that covers its rounding and that of a product with C.

    By `rounding.product_error` a row of C A is off by less than gamma sum|C| size + floor (1 + max|C|) (1 +
    max size). With t = sqrt(floor), sum (|C| + t) (radius + gamma size + t) is above that, and above the
    rounding of itself.
    """
    gamma, floor = rounding.product_error(len(A), A.dtype)
    middle, size = 0.5 * A.lo + 0.5 * A.hi, jnp.maximum(jnp.abs(A.lo), jnp.abs(A.hi))
    return middle, jnp.maximum(middle - A.lo, A.hi - middle) + gamma * size + np.sqrt(floor)


def _raised(C: jax.Array, terms: int) -> jax.Array:
    return _above_all(C, np.sqrt(rounding.product_error(terms, C.dtype)[1]))


_above_all = apart(lambda C, t: jnp.abs(C) + t)


@apart
def _matrix_product(C: jax.Array, A: jax.Array) -> jax.Array:
    """Return C A for numbers (n, r, N) and (r, k, N) or (r, N), elementwise over N."""
    return total([(C[:, j, None] if A.ndim == 3 else C[:, j]) * A[j][None] for j in range(len(A))])


@apart
def _interval(middle: jax.Array, radius: jax.Array) -> Interval:
    known = (radius < jnp.inf) & (jnp.abs(middle) < jnp.inf)
    return Interval(jnp.where(known, middle - radius, -jnp.inf), jnp.where(known, middle + radius, jnp.inf))


def entry_at(x: Tree, k: ArrayLike, axis: int) -> Tree:
    """Return entry k, which may be traced, along an axis."""
    return jax.tree.map(lambda a: jax.lax.dynamic_index_in_dim(a, k, axis, keepdims=False), x)


def where(condition: jax.Array, x: Interval, y: Interval) -> Interval:
    """Return x where the condition holds, else y, both Intervals."""
    return Interval(jnp.where(condition, x.lo, y.lo), jnp.where(condition, x.hi, y.hi))


def product(x: Interval, y: Interval) -> Interval:
    """Enclose x y for non-empty Intervals; everything where 0 meets infinity."""
    return _closed_outward(*extremes(x, y))


def extremes(x: Interval, y: Interval) -> tuple[jax.Array, jax.Array]:
    """Return the least and the largest product of the ends."""
    return _ends([a * b for a in (x.lo, x.hi) for b in (y.lo, y.hi)])


def _ends(ends: list[jax.Array]) -> tuple[jax.Array, jax.Array]:
    """Return the least and the largest of four numbers."""
    least = jnp.minimum(jnp.minimum(ends[0], ends[1]), jnp.minimum(ends[2], ends[3]))
    return least, jnp.maximum(jnp.maximum(ends[0], ends[1]), jnp.maximum(ends[2], ends[3]))


def minus(x: Interval, y: Interval) -> Interval:
    """Enclose x - y for non-empty Intervals."""
    return _closed_outward(x.lo - y.hi, x.hi - y.lo)


def reciprocal(y: Interval) -> Interval:
    """Enclose 1 / y for a non-empty Interval: everything where y holds 0, or is too large. See `over`."""
    sound = _divides(y)
    lo, hi = (jnp.where(sound, 1 / jnp.where(sound, end, 1), jnp.nan) for end in (y.hi, y.lo))
    return _closed_outward(lo, hi)


def _divides(y: Interval) -> jax.Array:
    """Return whether 0 is not in y, and its ends are not so large that the compiler's reciprocal could be
    flushed.
    """
    return (mig(y) > 0) & (mag(y) < 2.0 ** (np.finfo(y.dtype).maxexp // 2))


def over(x: Interval, y: Interval) -> Interval:
    """Enclose every z with y' z = x' for some x' in x and y' in y, for non-empty Intervals: everything where
    y holds 0.

    (The set-based quotient by [0, 0] is empty, which would pass for a proof that there is no solution.)
    """
    sound = _divides(y)
    lo, hi = (jnp.where(sound, end, 1) for end in (y.lo, y.hi))
    low, high = _ends([a / b for a in (x.lo, x.hi) for b in jax.lax.optimization_barrier((lo, hi))])
    return _closed_outward(jnp.where(sound, low, jnp.nan), jnp.where(sound, high, jnp.nan))


def _closed_outward(lo: jax.Array, hi: jax.Array) -> Interval:
    """Round outward; NaN gives everything."""
    lo, hi = rounding.outward(lo, hi)
    return Interval(jnp.where(jnp.isnan(lo), -jnp.inf, lo), jnp.where(jnp.isnan(hi), jnp.inf, hi))
