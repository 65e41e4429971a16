"""Zonotopes that vary and are easy: a few projections in place of a search.

For c + G [-1, 1]^q with c (r, N), G (r, q, N), 0 is inside iff some z in the box has G z = -c. The shortest z
on that plane is one product with the projection G' (G G')^-1 of each window, and decides half of them. From
there z moves along the plane against what exceeds a smaller box,

    x = z - clip(z, -s, s),    y = (G G')^-1 G x,    z <- z - 2 (x - G' y) + m (z - z before),

a reflection with momentum m: nothing is factorised again, nothing is gathered, no row is looked for. Both
answers come with each step. A z in the box explains; and y, which tends to the normal of the plane that
separates, refutes where |y c| > sum_j |y g_j|. The quotient of these is never above the gauge: the smaller
box ends at the largest one so far.

Hints are plain floats. What proves is `explains` of any z here, and `varying.refutes` of any y, after these
hints were arrays. Everything is written for a block of N windows, the last axis, and a window that is decided
stays as it is: no window depends on another.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.unrolled import apart, summed

__all__ = ["Hints", "clipped_hints", "explains", "gram_inverse", "symmetric_inverse"]

WRITTEN_OUT = 32
"""Generators up to which the sum of their squares is written out: it takes half of the time of a loop."""
REFLECTED, MOMENTUM = 2.0, 0.7
"""Factors on what is moved: twice the way onto the smaller box is a reflection, which needs fewest steps; of
the step before most is kept, more and more of it.
"""


class Hints(NamedTuple):
    """Numbers of a block by which `explains` and `varying.refutes` may prove something.

    Fields: gram (r, r, N): G G'; inverse (r, r, N): nearly that of it; z (q, N): a point; h (r, N): a
    direction; low (N,): the gauge is at least about this.
    """

    gram: jax.Array
    inverse: jax.Array
    z: jax.Array
    h: jax.Array
    low: jax.Array


@kernel
def clipped_hints(c: jax.Array, G: jax.Array, steps: int | jax.Array) -> Hints:
    """Return the Hints of a block after at most so many steps.

    Args:
        c (r, N), G (r, q, N): any numbers; a window whose products overflow gets hints that prove nothing.
    """
    clear = rounding.unit(c.dtype) ** 0.5

    def decided(low: jax.Array, high: jax.Array) -> jax.Array:
        return (high < 1 - clear) | (low > 1 + clear)

    def move(carry: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        z, before, h, low, high, count = carry
        share, momentum = jnp.minimum(low, 1), MOMENTUM * count / (count + 2)
        y = _combined(inverse, _excess(G, z, share))
        along = _back(G, y)
        found, open_ = _quotient(y, along, c), ~decided(low, high)
        h = jnp.where((open_ & (found > low))[None], y, h)
        moved = _moved(z, before, along, share, momentum.astype(z.dtype), open_)
        low = jnp.where(open_, jnp.maximum(found, low), low)
        high = jnp.where(open_, jnp.max(jnp.abs(moved), 0), high)
        return moved, z, h, low, high, count + 1

    def going(carry: tuple[jax.Array, ...]) -> jax.Array:
        *_, low, high, count = carry
        return (count < steps) & ~jnp.all(decided(low, high))

    gram, inverse = gram_inverse(G)
    h = _combined(inverse, -c)
    z = _back(G, h)
    high = jnp.max(jnp.abs(z), 0)
    start: tuple[jax.Array, ...] = (z, z, h, _quotient(h, z, c), high, jnp.zeros((), jnp.int32))
    z, _, h, low, *_ = jax.lax.while_loop(going, move, start)
    return Hints(gram, inverse, z, h, low)


@kernel
def gram_inverse(G: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (G G', nearly its inverse), (r, r, N) each; the first as `explains` needs it."""
    gram = _gram(G)
    return gram, symmetric_inverse(gram)


def symmetric_inverse(A: jax.Array) -> jax.Array:
    """Return nearly the inverse (r, r, N) of symmetric positive matrices by Gauss and Jordan's elimination;
    no claim.
    """
    r = len(A)
    unit = jnp.broadcast_to(jnp.eye(r, dtype=A.dtype)[:, :, None], A.shape)
    rows = np.arange(r, dtype=np.int32)[:, None]

    def eliminate(k: int | jax.Array, A: jax.Array) -> jax.Array:
        column, row = A[:, k], A[k]
        pivot = 1 / jnp.where(column[k] > 0, column[k], jnp.inf)
        row = row * pivot[None]
        return jnp.where((rows == k)[:, None], row[None], A - column[:, None] * row[None])

    return jax.lax.fori_loop(0, r, eliminate, jnp.concatenate([A, unit], 1))[:, r:]


@kernel
def explains(
    c: jax.Array, G: jax.Array, error: jax.Array, gram: jax.Array, inverse: jax.Array, z: jax.Array
) -> jax.Array:
    """Return a proved lower bound (N,) of 1 - gauge > 0 where z, moved onto G x = -c, lies in the box; else
    0.

    Args:
        c (r, N), G (r, q, N), error (r, N): as of `varying.strip_margins`. gram, inverse, z: from
            `clipped_hints`; any finite inverse and z will do. All must be arrays, not expressions of the same
            function.

    Proof: let s_i >= |c_i| + sum_j |g_ij|, X the inverse, and x = z + G' X w for w with |w_i| <= t s_i.
    Divided by s_i, row i of w - f(x), f the true function, is at most g_i + t sum_l |1 - G G' X|_il s_l /
    s_i, with g_i the share of s_i that |c + G z|_i and all errors over the box take. With t = 2 sum_i g_i,
    and the second sum at most 1/2, w -> w - f(x) maps the box of w into itself: f(x) = 0 for one of them
    (Brouwer), and |x - z| <= t S with S = sum_kl s_k |X_kl| s_l. The sum is taken over i as well, which a NaN
    does not pass. As gram is off by gamma s_i s_k at most, the sum with all its roundings is within 4 gamma r
    (1 + S). Where every s_i is within the fourth root of the range of floats, what underflows is less than
    that.
    """
    r, q = G.shape[:2]
    gamma, floor = rounding.product_error(q + 2 * r + 8, c.dtype)
    size = jnp.abs(c) + summed(jnp.abs, G, axes=(1,)) + error
    gap = jnp.abs(c + summed(lambda g, x: g * x[None], G, z, axes=(1, 0))) + error
    shift = 2.1 * summed(lambda x: x, gap / size + gamma + floor * (2 + 2 / size))
    far = summed(lambda row, s: summed(lambda x, t: s * jnp.abs(x) * t, row, size), inverse, size)
    unit = jnp.eye(r, dtype=c.dtype)[:, :, None]
    product = summed(lambda g, x: g[:, None] * x[None], gram, inverse, axes=(1, 0))
    off = jnp.abs(unit - product) * size[None] / size[:, None]
    off = summed(lambda row: summed(lambda x: x, row), off) + 4 * gamma * r * (1 + far)
    reach = 1.1 * shift * (1 + far)
    unit_error, least = 4 * rounding.unit(c.dtype), rounding.tiny(c.dtype) ** 0.25
    usual = jnp.all((size >= least) & (size <= 1 / least), 0)
    within = jnp.all(jnp.abs(z) + reach[None] <= 1 - unit_error, 0)
    room = 1 - (jnp.max(jnp.abs(z), 0) + reach) - unit_error
    inside = usual & within & (off <= 0.25)
    return jnp.where(inside, jnp.maximum(room, jnp.finfo(c.dtype).eps), 0)


@apart
def _gram(G: jax.Array) -> jax.Array:
    return summed(lambda g: g[:, None] * g[None], G, axes=(1,), few=WRITTEN_OUT)


@apart
def _excess(G: jax.Array, z: jax.Array, share: jax.Array) -> jax.Array:
    """Return G x (r, N) of what of z exceeds a share of the box."""
    return summed(lambda g, x: g * (x - jnp.clip(x, -share, share))[None], G, z, axes=(1, 0))


@apart
def _back(G: jax.Array, y: jax.Array) -> jax.Array:
    """Return G' y (q, N)."""
    return summed(lambda g, x: g * x[None], G, y)


@apart
def _combined(A: jax.Array, y: jax.Array) -> jax.Array:
    """Return A y (r, N)."""
    return summed(lambda a, x: a * x[None], A, y, axes=(1, 0))


@apart
def _moved(
    z: jax.Array,
    before: jax.Array,
    along: jax.Array,
    share: jax.Array,
    momentum: jax.Array,
    open_: jax.Array,
) -> jax.Array:
    excess = z - jnp.clip(z, -share[None], share[None])
    moved = z - REFLECTED * (excess - along) + momentum * (z - before)
    return jnp.where(open_[None], moved, z)


def _quotient(h: jax.Array, through: jax.Array, c: jax.Array) -> jax.Array:
    """Return |h c| / sum_j |h g_j| (N,)."""
    width = summed(jnp.abs, through)
    return jnp.abs(summed(lambda x, y: x * y, h, c)) / jnp.where(width > 0, width, 1)
