"""Search for the gauge of a point in a zonotope: no claim is made here, `zonotopes.proof` checks what is found.

The gauge of d is t = min { max_j |x_j| : M x = d } = max { l' d : sum_j |l' M_j| <= 1 }, M (m, q). Kernels are written for one point
of one set and batched by vmap, or for all; over points of one set their products become matrix products. None is unrolled over generators.

**Projections** (`project`). Douglas-Rachford between {x : M x = d} and the box [-1, 1]^q: where they meet, the iterates tend to a common
point, else their distance z - clip(z) tends to a vector M' l that separates them. Settles what is some per cent away from the boundary in
some ten steps of two products. Source: Douglas, Rachford 1956; Bauschke, Combettes, Luke 2004 for what it does where they do not meet.

**Interior points** (`interior_point`). A predictor-corrector method (Mehrotra 1992) for the pair of linear programs, with slacks a = t - x,
b = t + x and multipliers u, w >= 0, u - w = M' l, sum(u + w) = 1. With s = a b / (u b + w a), a Newton step solves (M diag(s) M') dl = f.
Ten to twenty steps, whatever the size. At the end s is large where |x_j| < t: the vertex is known (`vertex_basis` in `proof`).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxbound.sets.zonotopes.proof import Array, library, product

__all__ = ["interior_point", "project", "project_rows"]

STEPS = 40
"""At most so many steps of interior points; ten to twenty are the rule."""


def project(M: Array, R: Array, d: Array, z: Array, steps: int) -> tuple[Array, Array, Array]:
    """Return (x, l, z) for each point after so many steps: a candidate point, a candidate direction, and where to go on from.

    Args:
        M: (S, m, q). R: right inverses of M, nearly, (S, q, m). d: (S, N, m). z: (S, N, q), R d at first. NumPy arrays stay on the host,
            where some steps take less time than to hand them to a device.
    """
    xp, turned, back = library(z), M.swapaxes(1, 2), R.swapaxes(1, 2)
    least = product(d, back)
    onto = lambda x: x + least - product(product(x, turned), back)

    def step(_, z):
        y = xp.clip(z, -1, 1)
        return z + onto(2 * y - z) - y

    if xp is np:
        for i in range(steps):
            z = step(i, z)
    else:
        z = jax.lax.fori_loop(0, steps, step, z)
    y = xp.clip(z, -1, 1)
    return onto(y), product(z - y, R), z


@jax.jit
def project_rows(M: jax.Array, R: jax.Array, D: jax.Array, Z: jax.Array, steps: ArrayLike) -> tuple[jax.Array, jax.Array]:
    """Return (X, Z) for each set after so many steps between M X = D (S, m, p) and rows of |X| with sums of at most 1: as `project`."""
    return jax.vmap(_project_rows, (0, 0, 0, 0, None))(M, R, D, Z, steps)


def _project_rows(M: jax.Array, R: jax.Array, D: jax.Array, Z: jax.Array, steps: ArrayLike) -> tuple[jax.Array, jax.Array]:
    onto = lambda X: X + R @ (D - M @ X)

    def step(_, Z):
        Y = _row_balls(Z)
        return Z + onto(2 * Y - Z) - Y

    Z = jax.lax.fori_loop(0, steps, step, Z)
    Y = _row_balls(Z)
    near, reflected = onto(Y), onto(2 * Y - Z)
    sums = lambda X: jnp.max(jnp.sum(jnp.abs(X), 1))
    return jnp.where(sums(near) < sums(reflected), near, reflected), Z


def _row_balls(X: jax.Array) -> jax.Array:
    """Return the nearest rows with sums of |x| of at most 1 (Held, Wolfe, Crowder 1974)."""
    size = jnp.abs(X)
    falling = -jnp.sort(-size, 1)
    rank = jnp.arange(1, X.shape[1] + 1, dtype=X.dtype)[None]
    level = jnp.max((jnp.cumsum(falling, 1) - 1) / rank, 1, keepdims=True)
    return jnp.sign(X) * jnp.maximum(size - jnp.maximum(level, 0), 0)


@jax.jit
def interior_point(
    M: jax.Array, R: jax.Array, d: jax.Array, enough: ArrayLike, steps: ArrayLike = STEPS
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (x, l, s) for each point: near-optimal for the two programs, and how free each x_j is.

    Args:
        M, R, d: as for `project`. enough: a point for which t < 1 - enough or l' d > 1 + enough is settled; inf to go on to the optimum.
        steps: traced, at most so many.
    """
    start = jax.vmap(jax.vmap(_start, (None, None, 0)))(M, R, d)
    advance = jax.vmap(jax.vmap(_advance, (None, 0, 0, None)), (0, 0, 0, None))
    going = lambda carry: (carry[1] < steps) & jnp.any(~carry[0][-1])
    (x, t, l, u, w, size, _), _ = jax.lax.while_loop(going, lambda c: (advance(M, d, c[0], enough), c[1] + 1), (start, jnp.int32(0)))
    a, b = t[..., None] - x, t[..., None] + x
    return x * size[..., None], l, a * b / (u * b + w * a)


def _start(M: jax.Array, R: jax.Array, d: jax.Array) -> tuple[jax.Array, ...]:
    q = M.shape[1]
    x = R @ d
    size = jnp.max(jnp.abs(x))
    size = jnp.where((size > 0) & (size < jnp.inf), size, 1)
    even = jnp.full(q, 0.5 / q, x.dtype)
    return x / size, jnp.asarray(1.5, x.dtype), jnp.zeros_like(d), even, even, size, ~jnp.isfinite(jnp.sum(x))


def _advance(M: jax.Array, d: jax.Array, state: tuple[jax.Array, ...], enough: ArrayLike) -> tuple[jax.Array, ...]:
    x, t, l, u, w, size, done = state
    m, q = M.shape
    eps = jnp.finfo(x.dtype).eps
    a, b = t - x, t + x
    d = d / size
    alpha, beta = u / a, w / b
    s = 1 / (alpha + beta)
    lean = (alpha - beta) * s
    N = (M * s[None]) @ M.T
    L = jnp.linalg.cholesky(N + jnp.eye(m, dtype=x.dtype) * (jnp.trace(N) * (4 * eps / m)))
    v = M @ lean
    lack, slope, total = d - M @ x, l @ M - u + w, 1 - jnp.sum(u + w)
    curve, gap = jnp.sum(4 * alpha * beta * s), jnp.sum(a * u + b * w)

    def newton(_, carry):
        """Take the step with a du + u da = ra and b dw + w db = rb; return what to correct it by, it, and how far it may go."""
        ra, rb, *_ = carry
        ra, rb = ra / a, rb / b
        h = slope - ra + rb
        f, Nv = jax.scipy.linalg.cho_solve((L, True), jnp.stack([lack - M @ (s * h), v], 1)).T
        dt = (v @ f - (total - lean @ h - jnp.sum(ra + rb))) / (v @ Nv + curve)
        dl = f - Nv * dt
        dx = s * (dl @ M + h) + lean * dt
        da, db, du, dw = dt - dx, dt + dx, ra - alpha * (dt - dx), rb - beta * (dt + dx)
        p, r = jnp.minimum(_room(a, da), _room(b, db)), jnp.minimum(_room(u, du), _room(w, dw))
        ahead = jnp.sum((a + p * da) * (u + r * du) + (b + p * db) * (w + r * dw))
        target = (ahead / gap) ** 3 * gap / (2 * q)
        return target - a * u - da * du, target - b * w - db * dw, dx, dt, dl, du, dw, p, r

    one = jnp.ones_like(t)
    *_, dx, dt, dl, du, dw, p, r = jax.lax.fori_loop(0, 2, newton, (-a * u, -b * w, x, t, l, u, w, one, one))
    p, r = 0.995 * p, 0.995 * r
    new = x + p * dx, t + p * dt, l + r * dl, u + r * du, w + r * dw
    keep = done | ~jnp.isfinite(jnp.sum(new[0]) + jnp.sum(new[2]) + new[1])
    x, t, l, u, w = (jnp.where(keep, old, now) for old, now in zip(state, new, strict=False))
    least, most = l @ d / jnp.maximum(jnp.sum(jnp.abs(l @ M)), eps), jnp.max(jnp.abs(x))
    settled = (most * size < 1 - enough) | (least * size > 1 + enough)
    return x, t, l, u, w, size, keep | settled | (most - least <= 2.0**-16 * eps**0.5 * most)


def _room(x: jax.Array, dx: jax.Array) -> jax.Array:
    """Return how far x + p dx stays positive, at most 1."""
    return jnp.min(jnp.where(dx < 0, jnp.minimum(-x / jnp.where(dx < 0, dx, 1), 1), 1))
