"""Interval linear systems whose matrix stays while right-hand sides come by the million: each is then a few
matrix-vector products.

C h with C near the inverse of the middle of M, b its enclosure, encloses every solution x of M x = h in

    x_i in (b_i + [-beta_i, beta_i]) / (A_ii + [-alpha_i, alpha_i]),   A = C M,   beta_i = sum over k != i of
    N_ik |b_k| / N_ii,

N = <A>^-1 the inverse of the comparison matrix, alpha_i = <A>_ii - 1 / N_ii. All but b depends on M alone.

Source: Neumaier 1999, theorem 2.1 (Hansen-Bliek-Rohn).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel, outside_xla
from jaxbound.sets.floats.unrolled import most, stored, total
from jaxbound.sets.intervals.interval import Interval, mag, mid, rad
from jaxbound.sets.linear_systems.ends import upward
from jaxbound.sets.linear_systems.kernels import comparison_inverse, hansen_bliek_rohn
from jaxbound.sets.linear_systems.products import over, preconditioner, reciprocal, times


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Prepared:
    """q systems that share all rows but their last, for K matrices (1: the same for all right-hand sides).

    Fields: C (q, n, c, K) the preconditioners; weight (q, n, n, K) >= N_ik / N_ii, 0 on the diagonal; scale
    (q, n, K), Intervals of positive numbers around 1 / (A_ii + [-alpha_i, alpha_i]), or NaN where no bound
    was proved.
    """

    C: jax.Array
    weight: jax.Array
    scale: Interval


def prepare(M: Interval, systems: int = 1) -> Prepared:
    """Prepare `systems` systems of M (r, n, K): the first r - systems rows, and one of the last rows each. On
    the host.
    """
    with outside_xla():
        prepared: Prepared = _prepared(jax.tree.map(np.asarray, M), systems)
    return prepared


@kernel(static_argnums=1)
def _prepared(M: Interval, systems: int) -> Prepared:
    r, n, _ = M.shape
    chosen = np.array([[*range(r - systems), last] for last in range(r - systems, r)])
    together = lambda a: jnp.moveaxis(a[chosen], 0, -2).reshape(chosen.shape[1], n, -1)
    lanes = jax.tree.map(together, M)
    C = preconditioner(lanes)
    A = times(C, lanes)
    above, low, divisor = hansen_bliek_rohn(A, comparison_inverse(A))
    weight = over(Interval(above, above), Interval(low, low)[:, None]).hi
    scale = reciprocal(divisor)
    proved = (low > 0) & (divisor.lo > 0) & (scale.lo > 0) & (scale.hi < jnp.inf)
    proved &= jnp.isfinite(weight).all(1)
    weight = jnp.where(jnp.eye(n, dtype=bool)[..., None] | ~proved[:, None], 0, weight)
    scale = jax.tree.map(lambda end: jnp.where(proved, end, jnp.nan), scale)
    apart = lambda a: jnp.moveaxis(a.reshape(*a.shape[:-1], systems, -1), -2, 0)
    return jax.tree.map(apart, Prepared(jnp.where(jnp.isfinite(C), C, 0), weight, scale))


def solutions(systems: Prepared, h: Interval) -> jax.Array:
    """Enclose the solutions of every system for h (r, N).

    Returns:
        Their `ends` (2, q, n, N); infinite for an unknown without proved bounds, or where h is not finite.

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
    side = jnp.asarray([-1, 1], h.dtype)[:, None, None, None]
    x = upward(side * value[None] + wide[None])
    return upward(jnp.maximum(x * R.lo[None], x * R.hi[None]))
