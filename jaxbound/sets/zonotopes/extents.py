"""How far zonotopes and constrained zonotopes reach: support functions and boxes, rounded outward.

With constraints, max d'(c + G x) over A x = b is at most d'c + l'b + |G'd - A'l|_1 for every l (the dual
linear program), so that any l found by a search in plain floats gives a bound. The search goes through the
interior and solves k x k systems only; what it misses makes the bound wider, never wrong.
"""

import jax
import jax.numpy as jnp

from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals.interval import Interval, Operand, interval, mid, rad
from jaxbound.sets.zonotopes.constrained import AnySet, parts
from jaxbound.sets.zonotopes.intersections import cancelled
from jaxbound.sets.zonotopes.maps import dimension, mapped, product, reach, up
from jaxbound.sets.zonotopes.zonotope import Zonotope

__all__ = ["interval_hull", "support"]

STEPS = 25  # of the search: it halves its distance to the best bound, or better, in each


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
    return _support(S, d)


def interval_hull(S: AnySet) -> Interval:
    """Return a box around S, an Interval (n,): the smallest one but for rounding of a Zonotope, nearly so
    with constraints. Of a set that is proved empty on the way it is empty.

    Args:
        S: a Zonotope or ConstrainedZonotope of n coordinates.

    Example:
        >>> from jaxbound import sets
        >>> sets.interval_hull(sets.zonotope([1.0, 2.0], [[1.0, 3.0], [2.0, 4.0]])).hi
        Array([5., 8.], dtype=...)
    """
    dimension(S)
    return _interval_hull(S)


@jax.jit
def _interval_hull(S: AnySet) -> Interval:
    if isinstance(S, Zonotope):
        return S.hull()
    (S,) = rounding.one_dtype(S)
    axes = jnp.eye(len(S.center), dtype=S.center.dtype)
    far = _supports(S, Interval(axes := jnp.concatenate([-axes, axes]), axes))
    lo, hi = -far[: len(S.center)], far[len(S.center) :]
    empty = jnp.any(lo > hi)
    return Interval(jnp.where(empty, jnp.inf, lo), jnp.where(empty, -jnp.inf, hi))


@jax.jit
def _support(S: AnySet, direction: Interval) -> jax.Array:
    S, direction = rounding.one_dtype(S, direction)
    return _supports(S, direction[None])[0]


def _supports(S: AnySet, directions: Interval) -> jax.Array:
    """Return (r,) upper bounds of the support along the rows of `directions`, an Interval (r, n)."""
    c, G, A, b = parts(S)
    h, H, error = mapped(mid(directions), rad(directions), c, G)
    if len(b):
        h, H, more = cancelled(h, H, A, b, jax.vmap(_multipliers, (0, None, None))(H, A, b))
        error = up(error + more)
    return up(up(h + reach(jnp.zeros_like(h), H)) + error)


def _multipliers(g: jax.Array, A: jax.Array, b: jax.Array) -> jax.Array:
    """Return l (k,) with l'b + |g - A'l|_1 nearly least; no claim is made.

    Predictor and corrector steps (Mehrotra 1992) for max g'x over A x = b, |x| <= 1 with multipliers v, w >=
    0 of 1 + x and 1 - x: g = A'l + w - v. With D = v / (1 + x) + w / (1 - x), a step solves (A D^-1 A') dl =
    A D^-1 h - (b - A x).
    """
    size = jnp.max(jnp.abs(g))
    size = jnp.where(size > 0, size, 1)
    times = lambda M, x: product(M, x[:, None])[:, 0]
    value = lambda l: jnp.sum(l * b) + jnp.sum(jnp.abs(g - times(A.T, l)))
    zero = jnp.zeros_like(b)

    def step(_, carry):
        best, least, x, l, v, w = carry
        below, above = 1 + x, 1 - x
        D = v / below + w / above
        gram = product(A / D[None], A.T)
        room = (4 * len(b) * rounding.unit(g.dtype)) * jnp.trace(gram) + rounding.tiny(g.dtype)
        factor = jax.scipy.linalg.lu_factor(gram + room * jnp.eye(len(b), dtype=g.dtype))
        unmet, short = g - times(A.T, l) + v - w, b - times(A, x)

        def direction(to_v, to_w):
            h = unmet + to_v / below - to_w / above
            dl = jax.scipy.linalg.lu_solve(factor, times(A, h / D) - short)
            dx = (h - times(A.T, dl)) / D
            return dx, dl, (to_v - v * dx) / below, (to_w + w * dx) / above

        def stride(dx, dv, dw):
            ratio = lambda y, dy: jnp.min(jnp.where(dy < 0, -y / dy, jnp.inf))
            return jnp.minimum(ratio(below, dx), ratio(above, -dx)), jnp.minimum(ratio(v, dv), ratio(w, dw))

        mu = (jnp.sum(below * v) + jnp.sum(above * w)) / (2 * len(x))
        dx, _, dv, dw = direction(-below * v, -above * w)
        p, d = (jnp.minimum(s, 1) for s in stride(dx, dv, dw))
        after = (jnp.sum((below + p * dx) * (v + d * dv)) + jnp.sum((above - p * dx) * (w + d * dw))) / (
            2 * len(x)
        )
        target = mu * jnp.clip(after / mu, 0, 1) ** 3
        dx, dl, dv, dw = direction(target - below * v - dx * dv, target - above * w + dx * dw)
        p, d = (jnp.minimum(0.99 * s, 1) for s in stride(dx, dv, dw))
        found = (x + p * dx, l + d * dl, v + d * dv, w + d * dw)
        fine = jnp.all(jnp.stack([jnp.all(jnp.isfinite(y)) for y in found]))
        x, l, v, w = (jnp.where(fine, new, old) for new, old in zip(found, (x, l, v, w), strict=True))
        now = value(l)
        return jnp.where(now < least, l, best), jnp.minimum(now, least), x, l, v, w

    even = jnp.full_like(g, size)
    return jax.lax.fori_loop(0, STEPS, step, (zero, value(zero), jnp.zeros_like(g), zero, even, even))[0]
