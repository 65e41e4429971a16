"""Searches for the gauge of a point in a zonotope: no claim is made here, `zonotopes.proof` checks what is
found.

The gauge of d is t = min { max_j |x_j| : M x = d } = max { l' d : sum_j |l' M_j| <= 1 }, M (m, q).

**Projections** (`project`), all points of a set at once: their products become matrix products.
Douglas-Rachford between {x : M x = d} and the box [-1, 1]^q: where they meet, the iterates tend to a common
point, else their distance z - clip(z) tends to a vector M' l that separates them. Settles what is some per
cent away from the boundary in some ten steps of two products. Source: Douglas, Rachford 1956; Bauschke,
Combettes, Luke 2004 for what it does where they do not meet.

**Programs** (`program`), on the host: HiGHS, point by point.

**Exchange** (`exchanged`), compiled: the search of windows (`strips.gauge`), many points side by side.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.strips.gauge import gauge_search
from jaxbound.sets.zonotopes.proof import Array, library, product

T = TypeVar("T")
STEPS = 12
"""Vertices that an exchange visits at most, for each row."""


def project(
    M: Array, R: Array, d: Array, z: Array, steps: int, together: bool = False
) -> tuple[Array, Array, Array]:
    """Return (x, l, z) for each point after so many steps: a candidate point, a candidate direction, and
    where to go on from.

    Args:
        M: (S, m, q). R: right inverses of M, nearly, (S, q, m). d: (S, N, m). z: (S, N, q), R d at first.
            NumPy arrays stay on the host, where some steps take less time than to hand them to a device.
        together: the points are columns of one matrix, with sums of |x| along its rows of at most 1.
    """
    xp, turned, back = library(z), M.swapaxes(1, 2), R.swapaxes(1, 2)
    onto = lambda x: x + product(d - product(x, turned), back)
    within = _row_balls if together else lambda x: xp.clip(x, -1, 1)

    def step(z):
        y = within(z)
        return z + onto(2 * y - z) - y

    z = iterated(step, z, steps)
    y = within(z)
    return onto(y), product(z - y, R), z


def towards_point(M: Array, R: Array, d: Array, z: Array, l: Array) -> Array:
    """Return directions l, but towards the point where it is beside the plane of a flat set: z is R d."""
    away = d - product(z, M.swapaxes(1, 2))
    away = away - product(product(away, M), R)  # what rounding left of the plane's own directions
    flat = abs(away).max(2, initial=0) > rounding.unit(d.dtype) ** 0.75 * abs(d).max(2, initial=0)
    return library(d).where(flat[..., None], away, l)


def _row_balls(X: Array) -> Array:
    """Return the nearest columns (S, N, q) whose sums of |x| over all are at most 1 (Held, Wolfe, Crowder
    1974).
    """
    xp, size = library(X), abs(X)
    falling = -xp.sort(-size, 1)
    rank = xp.arange(1, X.shape[1] + 1, dtype=X.dtype)[None, :, None]
    level = ((xp.cumsum(falling, 1) - 1) / rank).max(1)[:, None]
    return xp.sign(X) * xp.maximum(size - xp.maximum(level, 0), 0)


def iterated(
    step: Callable[[T], T], state: T, most: int, going: Callable[[T], object] = lambda state: True
) -> T:
    """Return the state after at most so many steps, as long as it is going: on the host, or inside jit."""
    if isinstance(jax.tree.leaves(state)[0], jax.Array):
        counted = lambda carry: (carry[0] + 1, step(carry[1]))
        goes_on = lambda carry: (carry[0] < most) & going(carry[1])
        last: T = jax.lax.while_loop(goes_on, counted, (np.int32(0), state))[1]
        return last
    for _ in range(most):
        if not going(state):
            break
        state = step(state)
    return state


def program(M: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (l (m,), x (q,)) for a point d (m,) in M (m, q), which is not 0: of max s, M y = s d, |y| <= 1,
    x = y / s. NaN where there is none.
    """
    from scipy.optimize import linprog

    # not by exchanges, as of many: of 428 760 answers they left 754 open that this finds
    (m, q), size = M.shape, abs(d).max()
    tight = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    found = linprog(
        np.append(np.zeros(q), -1.0),
        A_eq=np.c_[M, -d / size],
        b_eq=np.zeros(m),
        bounds=[(-1, 1)] * q + [(0, None)],
        options=tight,
    )
    if found.x is None:
        return np.full(m, np.nan), np.full(q, np.nan)
    return found.eqlin.marginals, found.x[:q] * size / found.x[q]


@jax.jit
def exchanged(M: jax.Array, d: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (l (P, m), x (P, q)) for points d (P, m) in M (P, m, q): NaN and infinity count as 0."""
    m = M.shape[1]
    if not M.shape[2]:
        return d, jnp.zeros((len(d), 0), d.dtype)
    usual = jnp.all(jnp.isfinite(d), 1, keepdims=True)
    size = jnp.max(jnp.abs(d), 1, keepdims=True)
    size = jnp.where(usual & (size > 0), size, 1)
    c = jnp.where(usual, -d / size, 0).T
    h, x, _ = gauge_search(c, jnp.moveaxis(M, 0, 2), jnp.ones_like(c[0]), STEPS * m)
    return -h.T, x.T * size
