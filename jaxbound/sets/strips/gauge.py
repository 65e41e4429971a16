"""The gauge of zonotopes that differ from window to window, when their strips are too many to enumerate.

For c + G [-1, 1]^q with c (r, N), G (r, q, N), the factor t on all generators at which 0 just belongs to the
set is

    t = min { max_j |z_j| : c + G z = 0 }                                          (primal)
      = max over h of |h c| / sum_j |h g_j|                                        (dual)

**Search** (`gauge_search`). The dual is a least-absolute-values problem, min sum_j |h g_j| with h c = 1,
solved by descent along edges: a vertex h makes r - 1 generators, the basis, vanish; the one whose multiplier
exceeds 1 most leaves, and h moves along that edge to the best point of all, a weighted median of the places
where generators change sign. Source: Bloomfield, Steiger 1980; Barrodale, Roberts 1973. A basis that
generators cannot fill keeps unit vectors in the open places: flat sets and less than r - 1 generators need no
other care. Plain floats, no claim.

**Proof** is elsewhere: any h may refute (`varying.refutes`), any z may hold (`varying.holds`). They are
arrays between two compiled functions, since within one a compiler may round a number anew for each of its
uses.

Everything is written for a block of N windows, the last axis.
"""

from functools import partial

import jax
import jax.numpy as jnp

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.unrolled import summed


@partial(jax.jit, static_argnames="steps")
def gauge_search(
    c: jax.Array, G: jax.Array, one: jax.Array, steps: int = 60
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (h, z, done): candidates for the two problems, optimal up to rounding where done.

    Args:
        c (r, N), G (r, q, N): finite, rows scaled to a size of about 1. steps: at most so many vertices.
        one: N ones, traced; `/ one` is nothing but a sign to the compiler not to work out a number again for
            each of its uses.

    Returns:
        h (r, N), scaled so that h c = 1, or h = 0 where c = 0; z (q, N); done (N,).

    Example:
        >>> G = jnp.array([[[2.0], [0.0]], [[0.0], [1.0]]])
        >>> h, z, done = gauge_search(jnp.array([[1.0], [0.5]]), G, jnp.ones(1))
        >>> float(jnp.abs(z).max()), bool(done[0])
        (0.5, True)
    """
    r, q, N = G.shape
    dtype, many = c.dtype, one[None]
    top = jnp.argmax(jnp.abs(c), 0).astype(jnp.int32)
    flat = _pick(c, top) == 0
    T = _first_tableau(
        c, G, top
    )  # P G, and P: the inverse of the columns c and the generators or unit vectors of the basis
    places, columns, rows = (jnp.arange(n, dtype=jnp.int32)[:, None] for n in (r - 1, q + r, r))
    close, noise = 16 * rounding.unit(dtype) ** 0.75, 32 * rounding.unit(dtype)
    # of h g_j: the side of the box at which each generator is largest
    signs = jnp.where(T[0, :q] < 0, -1, 1).astype(dtype)
    weight = jnp.zeros((r - 1, N), dtype)  # of a place in the basis: 0 as long as a unit vector holds it

    def step(carry):
        T, signs, weight, _, ids, done, count = carry
        # how fast sum_j |h g_j| over the generators outside the basis changes along each edge
        slope = summed(lambda sign, column: sign[None] * column[1:], signs, T[:, :q], axes=(0, 1))
        steep = jnp.abs(slope)
        first = jnp.where(steep > q * noise, steep * 2.0**20, 0)  # unit vectors leave first
        worth = jnp.where(weight > 0, steep - (1 + close), first) / many
        s, best = jnp.argmax(worth, 0).astype(jnp.int32), jnp.max(worth, 0)
        row, turn = _row(T, s + 1) / many, _pick(slope, s) / one
        # the slope along the edge is used up by generators whose sign turns on the way
        need = 0.5 * (1 - close) * (jnp.abs(turn) - _pick(weight, s)) / one
        edge, size = row[:q], jnp.abs(row[:q])
        crosses = (signs * edge * turn[None] > 0) & (size > noise)
        reach = jnp.where(crosses, jnp.abs(T[0, :q]) / jnp.where(size > 0, size, 1), jnp.inf) / many
        share = jnp.where(crosses, size, 0) / many
        passed = summed(lambda far, size: jnp.where(far[None] <= reach, size[None], 0), reach, share)
        worth = jnp.where(passed >= need[None], -reach, -jnp.inf) / many
        j, gain = jnp.argmax(worth, 0).astype(jnp.int32), jnp.max(worth, 0)
        moves = (~done & (best > 0) & (gain > -jnp.inf))[None]
        column = jnp.take_along_axis(T, j[None, None], 1, mode="clip")[:, 0] / many
        pivot, at_s = _pick(column, s + 1)[None], rows == s[None] + 1
        change = (
            jnp.where(at_s, column - 1, column)
            * jnp.where(moves, 1 / jnp.where(pivot == 0, 1, pivot), 0)
            / many
        )
        signs = jnp.where(moves & crosses & (reach < -gain[None]), -signs, signs)
        signs = jnp.where(moves & (columns[:q] == _pick(ids, s)[None]), -jnp.sign(turn)[None], signs)
        signs = jnp.where(moves & (columns[:q] == j[None]), 0, signs)
        T = T - change[:, None] * row[None]
        T = jnp.where(((columns == j[None]) & moves)[None], jnp.where(at_s, 1, 0).astype(dtype)[:, None], T)
        here = (places == s[None]) & moves
        return (
            T,
            signs,
            jnp.where(here, 1, weight),
            slope,
            jnp.where(here, j[None], ids),
            ~moves[0],
            count + 1,
        )

    start = T, signs, weight, weight, jnp.full((r - 1, N), -1, jnp.int32), flat, jnp.int32(0)
    going = lambda carry: (carry[-1] < steps) & ~jnp.all(carry[-2])
    T, signs, weight, slope, ids, done, _ = jax.lax.while_loop(going, step, start) if r > 1 else start
    h = jnp.where(flat[None], 0, T[0, q:])
    width = summed(jnp.abs, summed(lambda x, row: x[None] * row, h, G) / many)
    t = jnp.where(width > 0, 1 / jnp.where(width > 0, width, 1), 0)[None]
    # where nothing is gained any more, signs times t give the point of the gauge
    z = -t * signs
    for k in range(r - 1):  # slopes are those of where the last step began: what is done did not move in it
        z = jnp.where((columns[:q] == ids[k][None]) & (weight[k] > 0)[None], t * slope[k][None], z)
    return h, jnp.where(flat[None], 0, z), done | (r == 1)


def _first_tableau(c: jax.Array, G: jax.Array, top: jax.Array) -> jax.Array:
    """Return P G, and P after it, for the basis of c and all unit vectors but the one along c's largest
    entry.
    """
    r, N = c.shape
    whole = jnp.concatenate([G, jnp.broadcast_to(jnp.eye(r, dtype=c.dtype)[:, :, None], (r, r, N))], 1)
    biggest = _pick(c, top)
    lead = _row(whole, top) * (1 / jnp.where(biggest == 0, 1, biggest))[None]
    later = jnp.arange(r - 1, dtype=jnp.int32)[:, None] >= top[None]
    rest = (
        jnp.where(later[:, None], whole[1:], whole[:-1])
        - jnp.where(later, c[1:], c[:-1])[:, None] * lead[None]
    )
    return jnp.concatenate([lead[None], rest])


def _row(T: jax.Array, number: jax.Array) -> jax.Array:
    return jnp.take_along_axis(T, number[None, None], 0, mode="clip")[0]


def _pick(rows: jax.Array, number: jax.Array) -> jax.Array:
    """Return for each window one of its rows."""
    return jnp.take_along_axis(rows, number[None], 0, mode="clip")[0]
