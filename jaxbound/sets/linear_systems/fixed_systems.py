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
from jaxbound.sets.floats.unrolled import most, stored, total
from jaxbound.sets.intervals.interval import Interval, mag, mid, rad
from jaxbound.sets.linear_systems.ends import upward

__all__ = ["Prepared", "prepare", "solutions"]


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
    r, n, _ = M.shape
    chosen = np.array([[*range(r - systems), last] for last in range(r - systems, r)])
    ends = (np.moveaxis(np.asarray(end)[chosen], -1, 1) for end in (M.lo, M.hi))  # (q, K, c, n)
    with np.errstate(all="ignore"):
        C, lo, hi = _preconditioned(*ends)
        weight, scale, proved = _bounds(lo, hi)
    last = lambda a: np.moveaxis(a, 1, -1)
    weight = np.where(np.eye(n, dtype=bool) | ~proved[..., None], 0, weight)
    return Prepared(last(C), last(weight), Interval(*(last(np.where(proved, end, np.nan)) for end in scale)))


def _preconditioned(lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return C near the (pseudo-)inverse of the middle of M (..., c, n), and the ends of C M."""
    C = _inverse(0.5 * lo + 0.5 * hi)
    return C, *_times(C, lo, hi)


def _inverse(A: np.ndarray) -> np.ndarray:
    """Return numbers near the (pseudo-)inverse; 0 where A is not finite."""
    return np.linalg.pinv(np.where(np.all(np.isfinite(A), axis=(-1, -2), keepdims=True), A, 0))


def _times(C: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Enclose C M for numbers C: the ball of `products.times`."""
    gamma, floor = rounding.product_error(lo.shape[-2], lo.dtype)
    middle = 0.5 * lo + 0.5 * hi
    radius = np.maximum(middle - lo, hi - middle) + gamma * np.maximum(abs(lo), abs(hi)) + np.sqrt(floor)
    centre, reach = C @ middle, (abs(C) + np.sqrt(floor)) @ radius
    return centre - reach, centre + reach


def _bounds(lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Return (weight, ends of scale, where they are proved), see `Prepared`, of matrices A (..., n, n).

    |N - near| <= v omega' entry by entry, as in `kernels.comparison_inverse`.
    """
    n, tiny, up = lo.shape[-1], rounding.tiny(lo.dtype), rounding.raised
    down = lambda x: -up(-x)
    eye = np.eye(n, dtype=lo.dtype)
    least = np.maximum(np.maximum(lo, -hi), 0)
    S = np.where(eye > 0, least, -np.maximum(abs(lo), abs(hi)))
    near = _inverse(S)
    v = np.maximum(near.sum(-1), tiny)
    both = np.concatenate([near, v[..., None]], -1)
    below, above = _times(S, both, both)
    w = below[..., n, None]
    off = np.maximum(abs(below[..., :n] - eye), abs(above[..., :n] - eye)) + 4 * tiny
    omega = up(up(up(off) / w).max(-2))
    regular = np.all(w > 0, axis=(-1, -2)) & np.all(omega < np.inf, axis=-1)
    slack = up(v[..., None] * omega[..., None, :])
    most = np.maximum(up(near + slack), 0)
    diagonal = lambda X: np.diagonal(X, axis1=-2, axis2=-1)
    low = np.maximum(down(diagonal(near - slack)), down(1 / diagonal(least)))
    alpha = np.maximum(up(diagonal(least) - down(1 / diagonal(most))), 0)
    divisor = down(diagonal(lo) - alpha), up(diagonal(hi) + alpha)
    weight = up(most / low[..., None])
    scale = down(1 / divisor[1]), up(1 / divisor[0])
    proved = (
        np.asarray(regular)[..., None]
        & np.isfinite(weight).all(-1)
        & (low > 0)
        & (divisor[0] > 0)
        & (scale[0] > 0)
        & (scale[1] < np.inf)
    )
    return weight, scale, proved


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
