"""How far zonotopes and constrained zonotopes reach: support functions and boxes, rounded outward.

With constraints, max d'(c + G x) over A x = b is at most d'c + l'b + |G'd - A'l|_1 for every l (the dual
linear program), so that any l found by a search in plain floats gives a bound. What a search
misses makes the bound wider, never wrong.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.intervals.interval import Interval, Operand, interval, mid, rad
from jaxbound.sets.strips.gauge import gauge_search
from jaxbound.sets.zonotopes.constrained import AnySet, parts
from jaxbound.sets.zonotopes.intersections import cancelled
from jaxbound.sets.zonotopes.maps import dimension, mapped, product, reach, up
from jaxbound.sets.zonotopes.search import STEPS
from jaxbound.sets.zonotopes.zonotope import Zonotope

ROUNDS, LEAST = 8, 2.0**-20
"""Points beyond the set that are asked for, each nearer than the one before; the least share of a direction
in what separates one: less of it says that there is no set.
"""


def support(S: AnySet, direction: Operand) -> jax.Array:
    """Return an upper bound of max direction . p over S: tight to rounding for a Zonotope, nearly so with
    constraints.

    Args:
        S: a Zonotope or ConstrainedZonotope. direction: (n,).

    Returns:
        A scalar. Along direction 0 it is below 0 only if the set is proved empty: an `is_empty` for jit, scan
        and vmap.

    Raises:
        ValueError: a direction of another dimension, NaN or infinity.

    Example:
        >>> from jaxbound import sets
        >>> float(sets.support(sets.zonotope([1.0, 2.0], [[1.0, 3.0], [2.0, 4.0]]), [1.0, 1.0]))
        13.0000...
    """
    n, d = dimension(S), interval(direction)
    if d.shape != (n,):
        raise ValueError(f"direction must have shape ({n},): its shape is {d.shape}")
    return _support_along(S, d)


def interval_hull(S: AnySet | Interval) -> Interval:
    """Return a box around S, an Interval (n,): the smallest one but for rounding of a Zonotope, nearly so
    with constraints. Of a set that is proved empty on the way it is empty.

    Args:
        S: a Zonotope or ConstrainedZonotope of n coordinates; an Interval is its own.

    Example:
        >>> from jaxbound import sets
        >>> sets.interval_hull(sets.zonotope([1.0, 2.0], [[1.0, 3.0], [2.0, 4.0]])).hi
        Array([5., 8.], dtype=...)
    """
    if isinstance(S, Interval):
        return S
    dimension(S)
    return _interval_hull(S)


@kernel
def _interval_hull(S: AnySet) -> Interval:
    if isinstance(S, Zonotope):
        return S.hull()
    (S,) = rounding.one_dtype(S)
    axes = jnp.eye(len(S.center), dtype=S.center.dtype)
    far = _supports(S, Interval(axes := jnp.concatenate([-axes, axes]), axes))
    lo, hi = -far[: len(S.center)], far[len(S.center) :]
    empty = jnp.any(lo > hi)
    return Interval(jnp.where(empty, jnp.inf, lo), jnp.where(empty, -jnp.inf, hi))


@kernel
def _support_along(S: AnySet, direction: Interval) -> jax.Array:
    S, direction = rounding.one_dtype(S, direction)
    return _supports(S, direction[None])[0]


def _supports(S: AnySet, directions: Interval) -> jax.Array:
    """Return (r,) upper bounds of the support along the rows of `directions`, an Interval (r, n)."""
    c, G, A, b = parts(S)
    h, H, error = mapped(mid(directions), rad(directions), c, G)
    if len(b):
        h, H, more = cancelled(h, H, A, b, _multipliers(H, A, b))
        error = up(error + more)
    return up(up(h + reach(jnp.zeros_like(h), H)) + error)


def _multipliers(H: jax.Array, A: jax.Array, b: jax.Array) -> jax.Array:
    """Return l (r, k) with l'b + |g - A'l|_1 nearly least for each row g of H (r, q); no claim is made.

    No x in the box has A x = b and g x = far, for a bound far that is not the least; directions (l, -1) that
    show it best give a nearer one (Dinkelbach 1967).
    """
    r, k = len(H), len(b)
    size = jnp.abs(b) + jnp.sum(jnp.abs(A), 1)
    size = jnp.where(size > 0, size, 1)
    width = jnp.sum(jnp.abs(H), 1)
    scale = jnp.where(width > 0, width, 1)
    A, b, rows = A / size[:, None], b / size, (H / scale[:, None]).T
    G = jnp.concatenate([jnp.broadcast_to(A[:, :, None], (k, len(rows), r)), rows[None]])
    b = jnp.broadcast_to(b[:, None], (k, r))

    def nearer(_: int | jax.Array, carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        best, far = carry
        h, _, _ = gauge_search(-jnp.concatenate([b, far[None]]), G, jnp.ones_like(far), STEPS * (k + 1))
        share = jnp.maximum(-h[k], LEAST * jnp.max(jnp.abs(h), 0))
        l = h[:k] / jnp.where(share > 0, share, 1)[None]
        now = jnp.sum(l * b, 0) + jnp.sum(jnp.abs(rows - product(A.T, l)), 0)
        return jnp.where(now < far, l, best), jnp.where(now < far, now, far)

    l, _ = jax.lax.fori_loop(0, ROUNDS, nearer, (jnp.zeros_like(b), width / scale))
    return (l * (scale[None] / size[:, None])).T
