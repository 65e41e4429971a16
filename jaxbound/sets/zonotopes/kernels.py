"""Decisions about zonotopes inside jit, vmap and scan: a search of few steps, then its proof, rounded outward
in the dtype of the sets.

The stages are those of `gauges`: projections for all points, interior points and their vertex while some are
open. What needs exact numbers, the boundary and flat sets, stays open here; float32 proves nothing within
some 1e-4 of the boundary.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxbound.sets.floats import rounding
from jaxbound.sets.zonotopes import proof, search
from jaxbound.sets.zonotopes.proof import Array

__all__ = ["bounds", "contained", "farthest", "image", "settled", "starts"]

STEPS = 24
"""Of projections."""
STARTS, CLIMBS = 16, 6
"""Directions along the axes, and others as many; how often they change."""
CHUNK, CHUNKS = 16, 21
"""Projections of a matrix between two looks at it, and how many of them."""


def settled(*arrays: jax.Array) -> tuple[jax.Array, ...]:
    """Return arrays that have one value for all their uses, NaN made infinite: the carry of a loop, whose
    length no compiler knows.
    """
    again = lambda carry: (carry[0] - 1, *(jnp.where(jnp.isnan(x), jnp.inf, x) for x in carry[1:]))
    rounds = jnp.any(jnp.isnan(jnp.concatenate([x.ravel() for x in arrays]))).astype(jnp.int32)
    return jax.lax.while_loop(lambda carry: carry[0] > 0, again, (rounds, *arrays))[1:]


def image(M: jax.Array) -> proof.Image[jax.Array]:
    """Build the Image of matrices M (S, m, q), finite floats."""
    top = jnp.max(jnp.abs(M), 2, initial=0)
    usual = (top > 0) & jnp.isfinite(top)
    powers = -rounding.mantissa_exponent(jnp.where(usual, top, 1))[1]
    M = rounding.scale(M, powers[..., None])
    return proof.measured(M, powers, settled(_right_inverse(M))[0])


def _right_inverse(M: jax.Array) -> jax.Array:
    """Return R (S, q, m) with M R nearly 1 of least norm; 0 where there is none."""
    S, m, q = M.shape
    if not 0 < m <= q:
        return jnp.zeros((S, q, m), M.dtype)
    Q, U = jnp.linalg.qr(M.swapaxes(1, 2))
    R = jax.scipy.linalg.solve_triangular(U, Q.swapaxes(1, 2)).swapaxes(1, 2)
    R = jnp.where(jnp.all(jnp.isfinite(R), (1, 2), keepdims=True), R, 0)
    return jnp.where(jnp.abs(R) < 4 * rounding.tiny(M.dtype), 0, R)


@jax.jit
def bounds(
    M: jax.Array, d: jax.Array, off: ArrayLike, tight: ArrayLike
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return (lower, upper, l, x): proved bounds (S, N) of the gauges of d (S, N, m) in M [-1, 1]^q, and what
    proves them.

    Args:
        M: (S, m, q). d: (S, N, m), rounded once and off by at most `off` beyond that.
        tight: work out both bounds up to rounding; otherwise stop where one is on its side of 1.

    Returns:
        The direction l (S, N, m) is that of the rows as they are given.
    """
    (S, m, q), N = M.shape, d.shape[1]
    if not m:  # no equation: x = 0
        zero = jnp.zeros((S, N), M.dtype)
        return zero, zero, d, jnp.zeros((S, N, q), M.dtype)
    body = image(M)
    d, off = _scaled(body, d), _scaled(body, jnp.broadcast_to(jnp.asarray(off, M.dtype), d.shape))
    lower, upper, l, x = gauge_bounds(body, d, off, tight)
    return lower, upper, _given(l, body.powers), x


def gauge_bounds(
    body: proof.Image[jax.Array], d: jax.Array, off: jax.Array | float = 0.0, tight: ArrayLike = False
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return (lower, upper, l, x) as `bounds` does, for an Image and points in its own scale."""
    l, x = settled(*map(_clean, _candidates(body, d, tight)))
    return proof.gauge_above(body, d, l, off), proof.gauge_below(body, d, x, off), l, x


def _candidates(body: proof.Image[jax.Array], d: jax.Array, tight: ArrayLike) -> tuple[jax.Array, jax.Array]:
    """Return (l, x): the best directions and points found, in plain floats; no claim is made."""
    (S, m, q), N = body.M.shape, d.shape[1]
    turned, back = body.M.swapaxes(1, 2), body.R.swapaxes(1, 2)
    enough = jnp.where(tight, np.inf, rounding.unit(d.dtype) ** 0.5)

    def rated(l, x):
        l, x = proof.unit(l), x + (d - x @ turned) @ back
        ahead = jnp.sum(l * d, 2) / jnp.sum(jnp.abs(l @ body.M), 2)
        return jnp.where(ahead > 0, ahead, 0), proof.largest(x, 2), l, x

    def better(found, candidate):
        ahead, size, l, x = rated(*candidate)
        above, below = ahead > found[0], size < found[1]
        ahead, size = jnp.where(above, ahead, found[0]), jnp.where(below, size, found[1])
        return (
            ahead,
            size,
            jnp.where(above[..., None], l, found[2]),
            jnp.where(below[..., None], x, found[3]),
        ), None

    def unsettled(found):
        return ~(found[0] > 1 + enough) & ~(found[1] < 1 - enough) & jnp.all(jnp.isfinite(d), 2)

    def near(found):
        hidden = jnp.where(unsettled(found)[..., None], d, jnp.nan)
        x, l, s = search.interior_point(body.M, body.R, hidden, enough)
        if m > q:
            return better(found, (l, x))[0]
        flat = lambda v: v.reshape(S * N, -1)
        M = body.M[0] if S == 1 else jnp.repeat(body.M, N, 0)
        corner, normal = proof.vertices(M, flat(d), flat(x), flat(s))
        both = jnp.stack([l, normal.reshape(l.shape)]), jnp.stack([x, corner.reshape(x.shape)])
        return jax.lax.scan(better, found, both)[0]

    z = d @ back
    x, l, _ = search.project(body.M, body.R, d, z, STEPS)
    beside = d - z @ turned  # points may be beside the plane of a flat set
    flat = jnp.max(jnp.abs(beside), 2) > rounding.unit(d.dtype) ** 0.5 * jnp.max(jnp.abs(d), 2)
    found = rated(jnp.where(flat[..., None], beside, l), x)
    return _once(lambda found: jnp.any(unsettled(found)), near, found)[2:]


@jax.jit
def contained(M: jax.Array, D: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return (l, X, least, most) for zonotopes D [1, z], D (S, m, 1 + p), in sets M (S, m, q): not held if
    least > 1, held if most <= 1.
    """
    body = image(M)
    D = _scaled(body, D.swapaxes(1, 2)).swapaxes(1, 2)
    l, reach = _climbed(body, D)
    X = _encoded(body, D, ~(reach > 1))
    l, X = settled(_clean(l), _clean(X))
    return _given(l, body.powers)[:, 0], X, proof.reach_above(body, D, l)[:, 0], proof.rows_below(body, D, X)


def starts(R: Array) -> Array:
    """Return directions (S, N, m) to start from: any will do, the same ones each time."""
    S, _, m = R.shape
    xp = proof.library(R)
    fixed: np.ndarray = np.concatenate(
        [np.eye(m)[:STARTS], np.random.default_rng(0).normal(size=(STARTS, m))]
    ).astype(R.dtype)
    return xp.concatenate([xp.broadcast_to(fixed[None], (S, *fixed.shape)), R.sum(1)[:, None]], 1)


def farthest(D: Array, l: Array) -> tuple[Array, Array]:
    """Return (l (S, N, m), points (S, N, m)): directions, turned round where D [1, z] is farther that way,
    and its corners there.
    """
    xp = proof.library(D)
    l = xp.where((l @ D)[..., :1] < 0, -l, l)
    along = l @ D
    return l, D[:, None, :, 0] + xp.where(along[..., 1:] < 0, -1, 1) @ D[..., 1:].swapaxes(1, 2)


def _climbed(body: proof.Image[jax.Array], D: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (l (S, 1, m), how far D [1, z] reaches along it in terms of M x, about)."""
    S, m, _ = D.shape

    def climb(carry):
        count, l, best, reach, going = carry
        l = proof.unit(_candidates(body, farthest(D, l)[1], True)[0])
        along = l @ D
        now = (jnp.abs(along[..., 0]) + jnp.sum(jnp.abs(along[..., 1:]), 2)) / jnp.sum(jnp.abs(l @ body.M), 2)
        now = jnp.where(jnp.isfinite(now), now, 0)
        l = jnp.where(along[..., :1] < 0, -l, l)
        at = jnp.argmax(now, 1)[:, None]
        top, chosen = jnp.take_along_axis(now, at, 1)[:, 0], jnp.take_along_axis(l, at[..., None], 1)
        better = going & (top > reach * (1 + rounding.unit(D.dtype) ** 0.5))
        best, reach = jnp.where(better[:, None, None], chosen, best), jnp.where(better, top, reach)
        return count + 1, l, best, reach, better & ~(reach > 1 + rounding.unit(D.dtype) ** 0.5)

    none = jnp.zeros((S, 1, m), D.dtype), jnp.zeros(S, D.dtype), jnp.ones(S, bool)
    going = lambda carry: (carry[0] < CLIMBS) & jnp.any(carry[-1])
    return jax.lax.while_loop(going, climb, (jnp.int32(0), starts(body.R), *none))[2:4]


def _encoded(body: proof.Image[jax.Array], D: jax.Array, wanted: jax.Array) -> jax.Array:
    """Return X (S, q, 1 + p) with M X = D nearly, and rows with sums of |X| of at most 1 where they were
    found; only where wanted.
    """

    def more(carry):
        count, Z, best, least = carry
        X, Z = search.project_rows(body.M, body.R, D, Z, CHUNK)
        X = X + body.R @ (D - body.M @ X)
        sums = proof.largest(jnp.sum(jnp.abs(X), 2), 1)
        better = sums < least
        return count + 1, Z, jnp.where(better[:, None, None], X, best), jnp.where(better, sums, least)

    X = body.R @ D
    least = proof.largest(jnp.sum(jnp.abs(X), 2), 1)
    open_at = lambda least: wanted & (least > 1 - rounding.unit(D.dtype) ** 0.5) & jnp.isfinite(body.loss)
    going = lambda carry: (carry[0] < CHUNKS) & jnp.any(open_at(carry[-1]))
    return jax.lax.while_loop(going, more, (jnp.int32(0), X, X, least))[2]


def _scaled(body: proof.Image[jax.Array], d: jax.Array) -> jax.Array:
    return rounding.scale(d, jnp.broadcast_to(body.powers[:, None], d.shape))


def _once(wanted, stage, found):
    """Run a stage if it is wanted; under vmap too it does not run where nothing in the batch wants it, as it
    would with cond.
    """
    going = lambda carry: carry[0] & wanted(carry[1])
    return jax.lax.while_loop(
        going, lambda carry: (jnp.zeros_like(carry[0]), stage(carry[1])), (jnp.ones((), bool), found)
    )[1]


def _clean(x: jax.Array) -> jax.Array:
    """Return candidates without subnormal numbers, which some operations read as 0 and others do not."""
    return jnp.where(jnp.abs(x) < 4 * rounding.tiny(x.dtype), 0, x)


def _given(l: jax.Array, powers: jax.Array) -> jax.Array:
    """Return directions (S, N, m) for the rows as they were given, of a size near 1."""
    exponent = rounding.mantissa_exponent(jnp.where(jnp.abs(l) > 0, jnp.abs(l), 1))[1] + powers[:, None]
    top = jnp.max(jnp.where(l != 0, exponent, -jnp.inf), 2, keepdims=True)
    shift = jnp.where(l != 0, powers[:, None] - top, 0)
    return jnp.where(l != 0, rounding.scale(l, shift), 0)
