"""Bounds of gauges inside jit, vmap and scan: a search of few steps, then its proof, rounded outward
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
from jaxbound.sets.zonotopes import containment, proof, search

__all__ = ["bounds", "contained", "image", "settled"]

STEPS = 24
"""Of projections."""


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
    d, off = (body.scaled(jnp.broadcast_to(jnp.asarray(v, M.dtype), d.shape)) for v in (d, off))
    l, x = settled(*_candidates(body, d, tight))
    lower, upper = proof.gauge_above(body, d, l, off), proof.gauge_below(body, d, x, off)
    return lower, upper, proof.unscaled(l, body.powers), x


@jax.jit
def contained(M: jax.Array, D: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return (lower, upper, l, X) of zonotopes in sets: as `containment.contained` does."""
    body = image(M)
    return containment.contained(body, D, lambda far: _candidates(body, far, True)[0], settled)


def _candidates(body: proof.Image[jax.Array], d: jax.Array, tight: ArrayLike) -> tuple[jax.Array, jax.Array]:
    """Return (l, x): the best directions and points found, in plain floats; no claim is made."""
    m, q = body.M.shape[1:]
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
        corner, normal = search.vertices(body.M, d, x, s)
        return jax.lax.scan(better, found, (jnp.stack([l, normal]), jnp.stack([x, corner])))[0]

    z = d @ back
    x, l, _ = search.project(body.M, body.R, d, z, STEPS)
    found = rated(search.beside(body.M, d, z, l), x)
    # under vmap, too, the stage does not run where nothing in the batch wants it, as it would with cond
    found = search.repeated(near, found, 1, lambda found: jnp.any(unsettled(found)))
    return _clean(found[2]), _clean(found[3])


def _clean(x: jax.Array) -> jax.Array:
    """Return candidates without subnormal numbers, which some operations read as 0 and others do not."""
    return jnp.where(jnp.abs(x) < 4 * rounding.tiny(x.dtype), 0, x)
