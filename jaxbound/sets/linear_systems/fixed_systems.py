"""Interval linear systems whose matrix stays while right-hand sides come by the million: each is then a few matrix-vector products.

C h with C near the inverse of the middle of M, b its enclosure, encloses every solution x of M x = h in

    x_i in (b_i + [-beta_i, beta_i]) / (A_ii + [-alpha_i, alpha_i]),   A = C M,   beta_i = sum over k != i of N_ik |b_k| / N_ii,

N = <A>^-1 the inverse of the comparison matrix, alpha_i = <A>_ii - 1 / N_ii. All but b depends on M alone.

Source: Neumaier 1999, theorem 2.1 (Hansen-Bliek-Rohn).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.unrolled import most, stored, total
from jaxbound.sets.intervals.interval import Interval, mag, mid, mig, rad
from jaxbound.sets.linear_systems.kernels import comparison_inverse, minus, over, preconditioner, times

__all__ = ["Prepared", "prepare", "solutions"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Prepared:
    """q systems that share all rows but their last, for K matrices (1: the same for all right-hand sides).

    Fields: C (q, n, c, K) the preconditioners; weight (q, n, n, K) >= N_ik / N_ii, 0 on the diagonal; scale (q, n, K), Intervals of
    positive numbers around 1 / (A_ii + [-alpha_i, alpha_i]), or NaN where no bound was proved.
    """

    C: jax.Array
    weight: jax.Array
    scale: Interval


def prepare(M: Interval, systems: int = 1) -> Prepared:
    """Prepare `systems` systems of M (r, n, K): the first r - systems rows, and one of the last rows each."""
    r = M.shape[0]
    C, A, *inverse = _preconditioned(M[np.array([[*range(r - systems), last] for last in range(r - systems, r)])])
    return _bounds(C, A, *inverse)


@jax.jit
@jax.vmap
def _preconditioned(M: Interval) -> tuple[jax.Array, Interval, jax.Array, jax.Array, jax.Array]:
    C = preconditioner(M)
    assert C is not None  # as only "none" gives
    A = times(C, M)
    return C, A, *comparison_inverse(A)


@jax.jit
@jax.vmap
def _bounds(C: jax.Array, A: Interval, near: jax.Array, v: jax.Array, omega: jax.Array) -> Prepared:
    """Return what is Prepared; |N - near| <= v omega'."""
    n = A.shape[0]
    slack = rounding.outward(*(v[:, None] * omega[None],) * 2)[1]
    above = stored(jnp.maximum(rounding.outward(near + slack, near + slack)[1], 0))
    diagonal = lambda X: jnp.stack([X[i, i] for i in range(n)])
    point = lambda x: Interval(x, x)
    centre = Interval(diagonal(A.lo), diagonal(A.hi))
    least, one = mig(centre), jnp.ones_like(centre.lo)
    below = rounding.outward(*(diagonal(near - slack),) * 2)[0]
    low = stored(jnp.maximum(below, over(point(one), point(least)).lo))
    alpha = stored(jnp.maximum(minus(point(least), over(point(one), point(diagonal(above)))).hi, 0))
    scale = stored(over(point(one), stored(minus(centre, Interval(-alpha, alpha)))))
    weight = stored(over(point(above), point(low)[:, None]).hi)
    proved = jnp.all(jnp.isfinite(weight), 1) & (scale.lo > 0) & (scale.hi < jnp.inf)
    scale = Interval(*(jnp.where(proved, end, jnp.nan) for end in (scale.lo, scale.hi)))
    return Prepared(C, jnp.where(jnp.eye(n, dtype=bool)[..., None] | ~proved[:, None], 0, weight), scale)


def solutions(systems: Prepared, h: Interval) -> Interval:
    """Enclose the solutions of every system for h (r, N).

    Returns:
        An Interval (q, n, N); everything for an unknown without proved bounds, or where h is not finite.

    Encloses: every x with M' x = h' for M' in M and h' in h, rounding included.
    """
    C, weight, R = systems.C, systems.weight, systems.scale
    n, c = C.shape[1:3]
    gamma, floor = rounding.product_error(max(c, n) + 1, h.dtype)
    size = mag(h)
    middle, radius = stored((mid(h), rad(h) + gamma * size))
    far = stored(floor * (1 + most(list(size))))
    row = lambda x, j: x[j][None, None] if j < c - 1 else x[c - 1 :][:, None]
    largest = (1 + jnp.max(jnp.abs(C), (1, 2)))[:, None]
    value = stored(total([C[:, :, j] * row(middle, j) for j in range(c)]))
    spread = total([jnp.abs(C[:, :, j]) * row(radius, j) for j in range(c)]) + largest * far[None, None]
    spread = stored(spread)
    reach = [jnp.abs(value[:, k]) + spread[:, k] for k in range(n)]
    beside = total([weight[:, :, k] * reach[k][:, None] for k in range(n)]) * (1 + gamma)
    least = stored(floor * ((1 + jnp.max(weight, (1, 2))) * (1 + most(reach))))
    wide = stored((spread + beside + least[:, None]) * (1 + gamma))
    lo, hi = rounding.outward(value - wide, value + wide)
    lo, hi = rounding.outward(jnp.minimum(lo * R.lo, lo * R.hi), jnp.maximum(hi * R.lo, hi * R.hi))
    return Interval(jnp.where(jnp.isnan(lo), -jnp.inf, lo), jnp.where(jnp.isnan(hi), jnp.inf, hi))
