"""Bounds of gauges inside jit, vmap and scan: a search of few steps, then its proof, rounded outward
in the dtype of the sets.

What needs exact numbers, the boundary and flat sets, stays
open here; float32 proves nothing within some 1e-4 of the boundary.
"""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxbound.sets.floats import rounding
from jaxbound.sets.zonotopes import containment, proof, search


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
def bounds(M: jax.Array, d: jax.Array, off: ArrayLike) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return (lower, upper, l, x): proved bounds (S, N) of the gauges of d (S, N, m) in M [-1, 1]^q, and what
    proves them.

    Args:
        M: (S, m, q). d: (S, N, m), rounded once and off by at most `off` beyond that.

    Returns:
        The direction l (S, N, m) is that of the rows as they are given.
    """
    (S, m, q), N = M.shape, d.shape[1]
    if not m:  # no equation: x = 0
        zero = jnp.zeros((S, N), M.dtype)
        return zero, zero, d, jnp.zeros((S, N, q), M.dtype)
    body = image(M)
    d, off = (body.scaled(jnp.broadcast_to(jnp.asarray(v, M.dtype), d.shape)) for v in (d, off))
    l, x = settled(*candidates(body, d))
    lower, upper = proof.gauge_above(body, d, l, off), proof.gauge_below(body, d, x, off)
    return lower, upper, proof.unscaled(l, body.powers), x


@jax.jit
def contained(M: jax.Array, D: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return (lower, upper, l, X) of zonotopes in sets: as `containment.contained` does."""
    body = image(M)
    return containment.contained(body, D, lambda far: candidates(body, far)[0], settled)


def candidates(body: proof.Image[jax.Array], d: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (l, x): the best directions and points for d (S, N, m), by `search.exchanged`; no
    claim is made.
    """
    (S, m, q), N = body.M.shape, d.shape[1]
    l, x = search.exchanged(jnp.repeat(body.M, N, 0), d.reshape(S * N, m))
    l, x = proof.in_largest_entry(l.reshape(S, N, m)), x.reshape(S, N, q)
    x = x + (d - x @ body.M.swapaxes(1, 2)) @ body.R.swapaxes(1, 2)
    return _without_subnormals(l), _without_subnormals(x)


def _without_subnormals(x: jax.Array) -> jax.Array:
    """Return candidates without subnormal numbers, which some operations read as 0 and others do not."""
    return jnp.where(jnp.abs(x) < 4 * rounding.tiny(x.dtype), 0, x)
