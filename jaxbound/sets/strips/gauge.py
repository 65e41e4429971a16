"""The gauge of zonotopes that differ from window to window, when their strips are too many to enumerate.

For c + G [-1, 1]^q with c (r, N), G (r, q, N), the factor t on all generators at which 0 just belongs to the set is

    t = min { max_j |z_j| : c + G z = 0 }                                          (primal)
      = max over h of |h c| / sum_j |h g_j|                                        (dual)

**Search** (`gauge_search`). The dual is a least-absolute-values problem, min sum_j |h g_j| with h c = 1, solved by descent along edges: a
vertex h makes r - 1 generators, the basis, vanish; the one whose multiplier exceeds 1 most leaves, and h moves along that edge to the best
point of all, a weighted median of the places where generators change sign. Source: Bloomfield, Steiger 1980; Barrodale, Roberts 1973. A
basis that generators cannot fill keeps unit vectors in the open places: flat sets and less than r - 1 generators need no other care. Plain
floats, no claim.

**Proof** is elsewhere: any h may refute (`varying.refutes`), any z may hold (`varying.holds`). They are arrays between two compiled
functions, since within one a compiler may round a number anew for each of its uses.

Everything is written for a block of N windows, the last axis.
"""

from functools import partial

import jax
import jax.numpy as jnp

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.unrolled import largest, total

__all__ = ["gauge_search"]


@partial(jax.jit, static_argnames="steps")
def gauge_search(c: jax.Array, G: jax.Array, one: jax.Array, steps: int = 60) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (h, z, done): candidates for the two problems, optimal up to rounding where done.

    Args:
        c (r, N), G (r, q, N): finite, rows scaled to a size of about 1. steps: at most so many vertices.
        one: N ones, traced; `/ one` is nothing but a sign to the compiler not to work out a number again for each of its uses.

    Returns:
        h (r, N), scaled so that h c = 1, or h = 0 where c = 0; z (q, N); done (N,).

    Example:
        >>> h, z, done = gauge_search(jnp.array([[1.0], [0.5]]), jnp.array([[[2.0], [0.0]], [[0.0], [1.0]]]), jnp.ones(1))
        >>> float(jnp.abs(z).max()), bool(done[0])
        (0.5, True)
    """
    r, q, N = G.shape
    dtype, many = c.dtype, one[None]
    _, top = largest(jnp.abs(c), one)
    P = _first_basis(c, top)
    T = jnp.stack([total(P[a, i][None] * G[i] for i in range(r)) for a in range(r)])
    places, columns, rows = (jnp.arange(n, dtype=jnp.int32)[:, None] for n in (r - 1, q, r))
    close, noise = 16 * rounding.unit(dtype) ** 0.75, 32 * rounding.unit(dtype)
    signs = jnp.where(T[0] < 0, -1, 1).astype(dtype)
    weight = jnp.zeros((r - 1, N), dtype)  # of a place in the basis: 0 as long as a unit vector holds it

    def step(carry):
        T, P, signs, weight, ids, done, count = carry
        slope = _slopes(T, signs) / many
        first = jnp.where(jnp.abs(slope) > q * noise, jnp.abs(slope) * 2.0**20, 0)  # unit vectors leave first
        worth = jnp.where(weight > 0, jnp.abs(slope) - (1 + close), first) / many
        best, s = largest(worth, one)
        edge, lean = _row(T, s + 1) / many, jnp.sign(_pick(slope, s)) / one
        need = 0.5 * (1 - close) * (jnp.abs(_pick(slope, s)) - _pick(weight, s)) / one
        size = jnp.abs(edge)
        crosses = (signs * edge * lean[None] > 0) & (size > noise)
        reach = jnp.where(crosses, jnp.abs(T[0]) / jnp.where(size > 0, size, 1), jnp.inf) / many
        share = jnp.where(crosses, size, 0) / many
        passed = total(jnp.where(reach[j][None] <= reach, share[j][None], 0) for j in range(q)) / many
        gain, j = largest(jnp.where(passed >= need[None], -reach, -jnp.inf) / many, one)
        moves = ~done & (best > 0) & (gain > -jnp.inf)
        column = jnp.take_along_axis(T, j[None, None], 1, mode="clip")[:, 0] / many
        pivot = _pick(column, s + 1)
        at_s = rows == s[None] + 1
        change = jnp.where(at_s, column - 1, column) * jnp.where(moves, 1 / jnp.where(pivot == 0, 1, pivot), 0)[None] / many
        left = _pick(ids, s)[None]
        signs = jnp.where(moves[None] & crosses & (reach < -gain[None]), -signs, signs)
        signs = jnp.where(moves[None] & (columns == left), -lean[None], signs)
        signs = jnp.where(moves[None] & (columns == j[None]), 0, signs)
        T = T - change[:, None] * edge[None]
        T = jnp.where(((columns == j[None]) & moves[None])[None], jnp.where(at_s, 1, 0).astype(dtype)[:, None], T)
        P = P - change[:, None] * (_row(P, s + 1) / many)[None]
        here = (places == s[None]) & moves[None]
        return T, P, signs, jnp.where(here, 1, weight), jnp.where(here, j[None], ids), ~moves, count + 1

    start = T, P, signs, weight, jnp.full((r - 1, N), -1, jnp.int32), (r == 1) | (_pick(c, top) == 0), jnp.int32(0)
    going = lambda carry: (carry[-1] < steps) & ~jnp.all(carry[-2])
    T, P, signs, weight, ids, done, count = jax.lax.while_loop(going, step, start) if r > 1 else start
    h = jnp.where(_pick(c, top)[None] == 0, 0, P[0])
    width = total(jnp.abs(total(h[i][None] * G[i] for i in range(r))))
    t = jnp.where(width > 0, 1 / jnp.where(width > 0, width, 1), 0)
    z = -t[None] * signs
    if r > 1:
        slope = _slopes(T, signs)
        for k in range(r - 1):
            z = jnp.where((columns == ids[k][None]) & (weight[k] > 0)[None], (t * slope[k])[None], z)
    return h, jnp.where(_pick(c, top)[None] == 0, 0, z), done


def _first_basis(c: jax.Array, top: jax.Array) -> jax.Array:
    """Return the inverse P (r, r, N) of the columns c and all unit vectors but the one along c's largest entry."""
    r = len(c)
    biggest = _pick(c, top)
    inverse = 1 / jnp.where(biggest == 0, 1, biggest)
    rows = jnp.arange(r, dtype=jnp.int32)[:, None]
    along = rows == top[None]
    basis = [jnp.where(along, inverse[None], 0)]
    for place in range(r - 1):
        i = jnp.where(place < top, place, place + 1)
        basis.append(jnp.where(rows == i[None], 1, 0) - jnp.where(along, (_pick(c, i) * inverse)[None], 0))
    return jnp.stack(basis).astype(c.dtype)


def _slopes(T: jax.Array, signs: jax.Array) -> jax.Array:
    """Return how fast sum_j |h g_j| over the generators outside the basis changes along each edge, (r - 1, N)."""
    return jnp.stack([total(signs[j] * T[s, j] for j in range(T.shape[1])) for s in range(1, len(T))])


def _row(T: jax.Array, number: jax.Array) -> jax.Array:
    return jnp.take_along_axis(T, number[None, None], 0, mode="clip")[0]


def _pick(rows: jax.Array, number: jax.Array) -> jax.Array:
    """Return for each window one of its rows."""
    return jnp.take_along_axis(rows, number[None], 0, mode="clip")[0]
