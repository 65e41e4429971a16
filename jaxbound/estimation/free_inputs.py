"""The part of a zonotope that unknown inputs leave known, and how a sample takes them out of it:
`models.unknown_directions`, in floats.

A sample says m - C x - D v = delta, |delta| <= s, of the state x = x_0 + (anything of S). So x is M x_0 + H
(m - D v - delta) but for what no output shows: the errors of the outputs that are used up become generators,
and what other outputs say is met with them.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxbound.sets.floats.unrolled import summed

__all__ = ["Free", "known_again"]


class Free(NamedTuple):
    """The ways to take unknown inputs out of a sample, on the last axis: see `models.unknown_directions`.

    Fields: M (n, n, k), H (n, p, k) and wide_M, wide_H, by which entries may be more or less; used (p, k):
    the outputs of a way; before, after (n,): states of which nothing is known before and after a sample;
    shown (p,): outputs that they act on; first (): whether a first state was given in bounds, all of it.
    """

    M: Any
    wide_M: Any
    H: Any
    wide_H: Any
    used: Any
    before: Any
    after: Any
    shown: Any
    first: Any


def known_again(
    free: Free, g: Any, known: tuple, size: Any, sample: tuple, seen: Any, whole: Any
) -> tuple[tuple, Any, Any]:
    """Return (the set of M x_0 + H m, the outputs (p, N) that are left to look at, where not all of S can be
    taken out).

    Args:
        g: bounds of rounding, of sums of n + p terms. known: (c (n, N), G (n, q + p, N), r (n, N)) of x_0,
            the last p columns to be filled; size (n, N): bounds of |x_0|. sample: (m, s, D v, what that may
            be off by), each (p, N); seen (p, N): outputs that are there.
        whole (N,): where x_0 is the state itself.
    """
    (c, G, r), (mid, rad, through, loose) = known, sample
    (n, _, k), (p, N) = free.M.shape, mid.shape
    usable = jnp.all(seen[:, None] | ~free.used[:, :, None], 0)
    way, taken = jnp.argmax(usable, 0), jnp.any(usable, 0) & ~whole
    pick = lambda x: jnp.broadcast_to(x, (*x.shape[:-1], N)) if k == 1 else jnp.take(x, way, axis=-1)
    M = jnp.where(taken[None, None], pick(free.M), jnp.eye(n, dtype=c.dtype)[:, :, None])
    wide_M, H, wide_H = (jnp.where(taken[None, None], pick(x), 0) for x in (free.wide_M, free.H, free.wide_H))
    times = lambda M, x: summed(lambda a, b: a * b[None], M, x, axes=(1, 0))
    values = jnp.abs(mid) + jnp.abs(through) + rad
    off = times(wide_M + g.gamma * jnp.abs(M), size) + times(wide_H + g.gamma * jnp.abs(H), values)
    r = g.up * (times(jnp.abs(M), r) + times(jnp.abs(H), loose) + off) + g.least
    c = times(M, c) + times(H, mid - through)
    moved = summed(lambda a, b: a[:, None] * b[None], M, G[:, :-p], axes=(1, 0))
    lost = ~(taken | whole)
    left = seen & ~(taken[None] & pick(free.used)) & ~(lost[None] & free.shown[:, None])
    return (c, jnp.concatenate([moved, H * rad[None]], 1), r), left, lost
