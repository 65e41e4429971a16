"""The part of a zonotope that unknown inputs leave known, and how a sample takes them out of it:
`models.unknown_directions`, in floats.

A sample says m - C x - D v = delta, |delta| <= s, of the state x = x_0 + (anything of S). So x is M x_0 + H
(m - D v - delta) but for what no output shows: the errors of the outputs that are used up become generators,
and what other outputs say is met with them.
"""

from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from jaxbound.consistency.interface import Array
from jaxbound.estimation.set_rounding import SetRounding
from jaxbound.sets.floats.unrolled import summed


class Free(NamedTuple):
    """The ways to take unknown inputs out of a sample, on the last axis: see `models.unknown_directions`.

    Fields: M (n, n, k), H (n, p, k) and wide_M, wide_H, by which entries may be more or less; used (p, k):
    the outputs of a way; before, after (n,): states of which nothing is known before and after a sample;
    shown (p,): outputs that they act on; first (): whether a first state was given in bounds, all of it.
    """

    M: Array
    wide_M: Array
    H: Array
    wide_H: Array
    used: Array
    before: Array
    after: Array
    shown: Array
    first: Array


class Sets(NamedTuple):
    """Sets {c + G xi + diag(r) eta}, and at least the size of each state.

    Fields: c (n, N), G (n, q, N), r (n, N), size (n, N).
    """

    c: Array
    G: Array
    r: Array
    size: Array


Spanned: TypeAlias = tuple[Array, Array, Array]
"""c, G and r of `Sets`."""


class Reading(NamedTuple):
    """One sample of the p outputs: |mid - C x - through| <= rad.

    Fields: driven (p, N): no missing input acts on it; seen: it can be tested; through: of inputs; loose: by
    which that may be off; mid, rad: 0 where it is not seen.
    """

    driven: Array
    seen: Array
    through: Array
    loose: Array
    mid: Array
    rad: Array


def known_again(
    free: Free,
    g: SetRounding,
    sets: Sets,
    reading: Reading,
    whole: Array,
) -> tuple[Spanned, Array, Array]:
    """Return (the set of M x_0 + H m, the outputs (p, N) that are left to look at, where (N,) not all of S
    can be taken out), by the first way whose outputs are all there.

    Args:
        g: bounds of rounding, of sums of n + p terms. sets: of x_0, with p columns more in G, to be filled
            with errors of outputs. whole (N,): where x_0 is the state itself.
    """
    (c, G, r, size), (_, there, through, loose, mid, rad) = sets, reading
    (n, _, k), (p, N) = free.M.shape, mid.shape
    usable = jnp.all(there[:, None] | ~free.used[:, :, None], 0)
    way, taken = jnp.argmax(usable, 0), jnp.any(usable, 0) & ~whole

    def of_way(x: Array) -> jax.Array:
        """Return the numbers of the way that each of N samples takes."""
        if k == 1:
            return jnp.broadcast_to(x, (*x.shape[:-1], N))
        return jnp.take(x, way, axis=-1)

    M = jnp.where(taken[None, None], of_way(free.M), jnp.eye(n, dtype=c.dtype)[:, :, None])
    wide_M = jnp.where(taken[None, None], of_way(free.wide_M), 0)
    H = jnp.where(taken[None, None], of_way(free.H), 0)
    wide_H = jnp.where(taken[None, None], of_way(free.wide_H), 0)
    values = jnp.abs(mid) + jnp.abs(through) + rad
    off = times(wide_M + g.gamma * jnp.abs(M), size)
    off = off + times(wide_H + g.gamma * jnp.abs(H), values)
    r = g.up * (times(jnp.abs(M), r) + times(jnp.abs(H), loose) + off) + g.least
    c = times(M, c) + times(H, mid - through)
    moved = times(M, G[:, :-p])
    lost = ~(taken | whole)
    left = there & ~(taken[None] & of_way(free.used)) & ~(lost[None] & free.shown[:, None])
    return (c, jnp.concatenate([moved, H * rad[None]], 1), r), left, lost


def times(M: Array, X: Array) -> jax.Array:
    """Return M X for M (r, n, N) or (r, n, 1), X (n, N) or (n, q, N), recording by recording."""
    return summed(_outer, M, X, axes=(1, 0))


def _outer(column: jax.Array, row: jax.Array) -> jax.Array:
    """Return a column (r, N or 1) times a number (N,), or a row (q, N)."""
    return column[(slice(None), *[None] * (row.ndim - 1))] * row[None]
