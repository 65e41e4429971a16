"""Zonotopes that differ from window to window: is 0 in c + G [-1, 1]^q ?

The set lies in a strip across every direction h, |h c| <= sum_j |h g_j|. Here the generators depend on the
data, so that h does too. Source: Ploix, Adrot 2006, (15)-(17).

**Hints.** A search (`gauge.gauge_search`) proposes one h and one z: `farthest`. Of one or two rows every
strip that matters is known without a search: `strip`.

**Proof.** Whatever h is, a strict |h c| > sum_j |h g_j| puts 0 outside. Given |true row i - computed row i|
<= E_i over the whole box, E_i including gamma M_i, M_i = |c_i| + sum_j |g_ij|, it is enough that

    |h c| - sum_j |h g_j| > sum_i |h_i| E_i    (refutes)

as computed: gamma is that of `rounding.product_error` for the longest chain of roundings.

That 0 is inside is proved by a point (`holds`): near z, with R a right inverse of G, w -> w - (c + G (z + R
w)) maps a box of w into itself, so that c + G x = 0 for some x = z + R w (Brouwer); x is in [-1, 1]^q if
there is room. The same for curved images, whose J is G at z.
"""

from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.unrolled import summed, total
from jaxbound.sets.strips.gauge import gauge_search

Strip: TypeAlias = tuple[jax.Array, jax.Array]
"""(h (r, N), margin (N,)): a direction and what it refutes by."""
Image: TypeAlias = tuple[jax.Array, jax.Array, jax.Array]
"""(c, G, error) of zonotopes."""
GENERATORS = {1: 1000, 2: 24, 3: 8}
"""Generators, by rows, up to which the normals of all strips are tried."""


def farthest(c: jax.Array, G: jax.Array, error: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (h (r, N), z (q, N)), a direction and a point that may prove something.

    They are those of `gauge_search`; of few rows h is the best of all strips, which flat sets need.

    Args: as for `refutes`.
    """
    r, q = G.shape[:2]
    size = jnp.abs(c) + jnp.sum(jnp.abs(G), 1)
    # rows of one size: the search compares entries of different rows
    size = jnp.where(size > 0, size, 1)
    h, z, _ = gauge_search(c / size, G / size[:, None], jnp.ones_like(c[0]))
    h = h / size
    # a flat set has a strip without a width, which a search by vertices may miss
    if q <= GENERATORS.get(r, 0):
        other = strip(c, G, error)
        h = jnp.where(refutes(c, G, error, other) < refutes(c, G, error, h), other, h)
    return h, z


def strip(c: jax.Array, G: jax.Array, error: jax.Array) -> jax.Array:
    """Return the direction h (r, N) that comes closest to refuting, across r - 1 generators or axes; where
    all rows have too many of these, of two neighbouring rows or of one.

    Args: as for `refutes`.
    """
    r, q = G.shape[:2]
    rows = next((k for k in (r, 2) if q <= GENERATORS.get(k, 0)), 1)
    best, least = jnp.zeros_like(c), jnp.full_like(c[0], jnp.inf)
    for first in range(0, r, rows):
        part = slice(min(first, r - rows), min(first, r - rows) + rows)
        some, H = (c[part], G[part], error[part]), _normals(G[part])

        def nearer(k: jax.Array, found: Strip, some: Image = some, H: jax.Array = H) -> Strip:
            margin = refutes(*some, H[:, k])
            return jnp.where(margin < found[1], H[:, k], found[0]), jnp.minimum(margin, found[1])

        none = jnp.zeros_like(c[part]), jnp.full_like(least, jnp.inf)
        h, margin = jax.lax.fori_loop(0, H.shape[1], nearer, none)
        best = jnp.where(margin < least, jnp.zeros_like(c).at[part].set(h), best)
        least = jnp.minimum(least, margin)
    return best


def _normals(G: jax.Array) -> jax.Array:
    """Return directions (r, k, N) across r - 1 generators or axes, of up to three rows."""
    r, q, N = G.shape
    axes = jnp.broadcast_to(jnp.eye(r, dtype=G.dtype)[:, :, None], (r, r, N))
    if r == 1:
        return axes
    if r == 2:
        return jnp.concatenate([axes, jnp.stack([-G[1], G[0]])], 1)
    i, j = np.triu_indices(q + 3, 1)
    # axes too: of a flat set no generators span the plane
    vectors = jnp.concatenate([G, axes], 1)
    a, b = vectors[:, i], vectors[:, j]
    return jnp.stack([a[m - 2] * b[m - 1] - a[m - 1] * b[m - 2] for m in range(3)])


def few_strips(r: int, q: int) -> bool:
    """Return whether `strip` is the best direction for so many rows and generators.

    A zonotope of two dimensions has the strips that are orthogonal to a generator, or to an axis where it is
    flat.
    """
    return r < 3 and q <= GENERATORS[r]


def refutes(c: jax.Array, G: jax.Array, error: jax.Array, h: jax.Array) -> jax.Array:
    """Return 1 - |h c| / sum_j |h g_j| (N,): < 0 is proof that 0 is outside, for any finite h (r, N) that is
    an array, not an expression. NaN stays NaN.

    Args:
        c (r, N), G (r, q, N), error (r, N): at least |true row - computed row| over [-1, 1]^q.

    Example:
        >>> c, G = jnp.array([[1.0], [0.5]]), jnp.array([[[0.5], [0.0]], [[0.0], [1.0]]])
        >>> jax.jit(refutes)(c, G, 0 * c, jnp.array([[1.0], [0.0]]))
        Array([-1...], dtype=float...)
    """
    r, q = G.shape[:2]
    gamma, floor = rounding.product_error(q + 2 * r + 8, c.dtype)
    E = (1 + 2 * gamma) * error + gamma * (jnp.abs(c) + summed(jnp.abs, G, axes=(1,))) + floor
    # h, c and G may be tiny: products of them are 0 in floats, and something in truth
    flushed = (
        rounding.product_error((q + 1) * r * r, c.dtype)[1]
        * (1 + jnp.max(jnp.abs(h), 0))
        * (1 + jnp.max(jnp.abs(c), 0) + jnp.max(jnp.abs(G), (0, 1)))
    )
    residual = jnp.abs(summed(lambda x, row: x * row, h, c))
    width = summed(jnp.abs, summed(lambda x, row: x[None] * row, h, G))
    short = residual - (summed(lambda x, e: jnp.abs(x) * e, h, E) + flushed)
    margin = 1 - short / (width + flushed)
    least = jnp.finfo(margin.dtype).eps
    beyond = (short > width) & (residual < jnp.inf)  # a sum that overflows says nothing
    return jnp.where(beyond, jnp.minimum(margin, -least), jnp.clip(margin, 0, 1))


def right_inverse(J: jax.Array, z: jax.Array) -> jax.Array:
    """Return R (q, r, N), nearly J R = 1, that moves most the variables with most room in [-1, 1]; 0 where
    none was found. No claim.

    Args: J (r, q, N), z (q, N).
    """
    r, q = J.shape[:2]
    # a variable at its bound has nowhere to go, and takes no part
    room = jnp.maximum(1 - jnp.abs(z), 0)
    size = jnp.sum(jnp.abs(J) * room[None], 1)
    # rows of J of one size: the sum of products is then well conditioned
    scale = 1 / jnp.where(size > 0, size, 1)
    K = J * scale[:, None]
    gram = total((K[:, i] * room[i][None])[:, None] * K[:, i][None] for i in range(q))
    inverse = _symmetric_inverse(gram)
    R = room[:, None] * total(K[k][:, None] * inverse[k][None] for k in range(r)) * scale[None]
    return jnp.where(jnp.isfinite(R), R, 0)


def _symmetric_inverse(A: jax.Array) -> jax.Array:
    """Return nearly the inverse (r, r, N) of symmetric positive matrices, by Gauss and Jordan; no claim."""
    r = len(A)
    unit = jnp.broadcast_to(jnp.eye(r, dtype=A.dtype)[:, :, None], A.shape)
    rows = np.arange(r, dtype=np.int32)[:, None]

    def eliminate(k: int | jax.Array, A: jax.Array) -> jax.Array:
        column, row = A[:, k], A[k]
        pivot = 1 / jnp.where(column[k] > 0, column[k], jnp.inf)
        row = row * pivot[None]
        return jnp.where((rows == k)[:, None], row[None], A - column[:, None] * row[None])

    return jax.lax.fori_loop(0, r, eliminate, jnp.concatenate([A, unit], 1))[:, r:]


def holds(
    F: jax.Array,
    F_error: jax.Array,
    J: jax.Array,
    J_error: jax.Array,
    z: jax.Array,
    R: jax.Array,
    curvature: ArrayLike = 0.0,
) -> jax.Array:
    """Return whether an x in [-1, 1]^q near z with f(x) = 0 is proved to exist, (N,) bool.

    Args:
        F, F_error: f(z) and a bound on its error, (r, N). J, J_error: the derivative at z and a bound on its
            error, (r, q, N). z (q, N).
        R: from `right_inverse`; any will do. All these must be arrays, not expressions of the same function.
        curvature: (r, N) or a number, at least max_i |J(x) - J(z)|_i / max_i |x_i - z_i| on the box; 0 for an
            affine f.

    Proof: with w_k = 2 (size_k) max_l (|F_l| + F_error_l) / size_l, |x - z| <= |R| w and every mean
    derivative on the way from z to x is within J_error + curvature |R| w of J. If |F| + F_error + |1 - J R| w
    <= w row by row, w -> w - f(z + R w) maps the box into itself. All terms are positive: each sum is raised
    by its own relative rounding.
    """
    r, q = J.shape[:2]
    gamma, floor = rounding.product_error(q + r + 8, F.dtype)
    up = 1 + 4 * gamma
    size = jnp.sum(jnp.abs(J), 1) + jnp.abs(F) + floor
    bend = jnp.broadcast_to(jnp.asarray(curvature, F.dtype), F.shape)
    gap = (jnp.abs(F) + F_error) * up + floor
    w = jnp.max(gap / size, 0)[None] * 2 * up * size
    reach = jnp.sum(jnp.abs(R) * w[None], 1) * up + floor
    far = jnp.max(reach, 0)
    top = 1 + jnp.max(jnp.abs(R), (0, 1))
    inside = jnp.all(jnp.abs(z) + reach * up <= 1 - 4 * rounding.unit(F.dtype), 0)

    slack = gamma * jnp.abs(J) + J_error + (bend * far[None])[:, None]
    off = jnp.abs(jnp.sum(J[:, :, None] * R[None], 1) - jnp.eye(r, dtype=F.dtype)[:, :, None])
    spread = jnp.sum(slack[:, :, None] * jnp.abs(R)[None], 1)
    loss = gap + jnp.sum((off + spread + (floor * top[None] * (1 + size))[:, None]) * w[None], 1)
    return inside & jnp.all(loss * up <= w, 0)
