"""The facets of a zonotope: its strips, exactly, and membership with a guaranteed sign."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.exact import linalg
from jaxbound.exact.circuits import circuits
from jaxbound.exact.price import refuse_or_say
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.strips.strips import UNROLLED, Strips, strip_verdict
from jaxbound.sets.zonotopes import kernels, proof
from jaxbound.sets.zonotopes.gauges import gauge_bounds
from jaxbound.sets.zonotopes.questions import numbers, traced
from jaxbound.sets.zonotopes.zonotope import Zonotope, refuse_infinite

__all__ = ["FEW", "exact_strips", "membership", "strips"]

FEW = 500
"""How many subsets of n - 1 generators are looked through for facets: a second or so in exact numbers."""

AT_ONCE = 64
"""Points that are worked out together where there are no more."""


def strips(Z: Zonotope) -> tuple[np.ndarray, np.ndarray]:
    """Return the strip representation: p is in Z iff |normal . (p - center)| <= half-width for every strip.

    Computed exactly from the generators' floats, so zero, parallel and dependent generators need no care;
    directions in which Z is flat come last with half-width 0.

    Args:
        Z: a Zonotope of concrete numbers (not inside jit).

    Returns:
        normals (k, n), largest entry 1, and half-widths (k,), as NumPy arrays rounded to nearest.

    Raises:
        ValueError: so many generators in so many coordinates that it would take more than ten minutes.
            TypeError: inside jit.

    Example:
        >>> from jaxbound.sets import zonotope
        >>> normals, widths = strips(zonotope([0.0, 0.0], [[1.0, 1.0], [0.0, 1.0]]))
        >>> sorted(zip(normals.tolist(), widths.tolist()))
        [([0.0, 1.0], 1.0), ([1.0, -1.0], 1.0)]
    """
    found = exact_strips(Z)
    n = Z.center.shape[0]
    normals = np.array([[float(x) for x in normal] for normal, _ in found]).reshape(-1, n)
    return normals, np.array([float(w) for _, w in found])


def exact_strips(Z: Zonotope) -> list[tuple[list[Fraction], Fraction]]:
    """Return [(normal, half-width)] as exact numbers."""
    if isinstance(Z.generators, jax.core.Tracer):
        raise TypeError("strips need concrete generators: build them outside jit, grad and vmap")
    refuse_infinite(center=Z.center, generators=Z.generators)
    G = [[Fraction(x) for x in row] for row in _floats(Z.generators).tolist()]
    n, q = np.shape(Z.generators)
    flat = (
        linalg.left_null_space(G) if q else tuple(tuple(Fraction(i == j) for j in range(n)) for i in range(n))
    )
    out: list[tuple[list[Fraction], Fraction]] = []
    if q and any(any(row) for row in G):
        kernel = linalg.transpose(linalg.left_null_space(linalg.transpose(G)))  # G kernel = 0
        _price(q, q - len(kernel[0]) if kernel else q)
        shadows = (
            circuits(kernel) if kernel else tuple(tuple(Fraction(i == j) for j in range(q)) for i in range(q))
        )
        basis, pivots = linalg.row_reduce(
            [(*row, *(Fraction(i == j) for j in range(n))) for i, row in enumerate(G)]
        )
        for g in shadows:  # normal' G = g: combine the reduced rows with the entries of g at their pivots
            normal = [
                sum((g[p] * row[q + j] for row, p in zip(basis, pivots, strict=True) if p < q), Fraction(0))
                for j in range(n)
            ]
            out.append((normal, sum(map(abs, g), Fraction(0))))
    out = [([x / s for x in normal], w / s) for normal, w in out if (s := max(map(abs, normal)))]
    return out + [([x / max(map(abs, normal)) for x in normal], Fraction(0)) for normal in flat]


def _price(q: int, rank: int) -> None:
    """Refuse the strips of a set of q generators that would take too long, or say how long they take."""
    subsets = math.comb(q, rank - 1)
    seconds = 3e-4 * subsets * min(rank, q - rank + 1)
    do = "ask `membership` or `contains`, which search, or let `reduce_order` leave fewer generators"
    refuse_or_say(seconds, f"strips by {subsets} subsets of {q} generators", do)


def _floats(x: ArrayLike) -> np.ndarray:
    return np.asarray(x, float)


def membership(Z: Zonotope, points: ArrayLike) -> np.ndarray | jax.Array:
    """Return the margin 1 - gauge of each point: > 0 proved inside, < 0 proved outside, 0 where rounding
    cannot tell.

    By all facets where they are few, in any dimension by a search for the two points or directions that prove
    it (see `contains`, which stops at the answer).

    The gauge is the factor on all generators at which the point just belongs to Z. A flat Z: -inf proved
    outside its plane, never > 0. Inside jit and vmap by the search, in the dtype of what is given; a flat Z
    then has some number < 0 for what is proved outside.

    Args:
        Z: a Zonotope.
        points: (N, n).

    Returns:
        (N,) margins.

    Raises:
        ValueError: points of another dimension, NaN or infinity.

    Example:
        >>> from jaxbound.sets import zonotope
        >>> membership(zonotope([0.0], [[2.0]]), [[1.0], [3.0]])
        array([ 0.5, -0.5]...)
    """
    refuse_unverified(Z, points)
    points = points if isinstance(points, jax.Array) else np.asarray(points)
    n = Z.center.shape[0]
    if points.ndim != 2 or points.shape[1] != n:
        raise ValueError(f"points must have shape (N, {n}): their shape is {points.shape}")
    if traced((Z, points)):
        return _traced(Z, points)
    points = np.asarray(points)
    refuse_infinite(center=Z.center, generators=Z.generators, points=points)
    if math.comb(Z.generators.shape[1], n - 1) > FEW:
        return _searched(Z, points)
    found = exact_strips(Z)
    margin = _margins([row for row in found if row[1]], Z, points)
    return _beside_the_plane([row for row in found if not row[1]], Z, points, margin)


def _traced(Z: Zonotope, points: ArrayLike) -> jax.Array:
    ((c, G, _, _),) = numbers(Z, points=points)
    (points,) = kernels.settled(rounding.widened(jnp.asarray(points), c.dtype))
    lower, upper, *_ = kernels.bounds(G[None], (points - c[None])[None], 0.0, True)
    return jnp.where(lower > 1, 1 - lower, jnp.maximum(1 - upper, 0))[0]


def _searched(Z: Zonotope, points: np.ndarray) -> np.ndarray:
    """Return the margins by the search for the gauge; where a set is flat, its plane is found in exact
    numbers.
    """
    c, G = (_floats(x)[None] for x in (Z.center, Z.generators))
    image = proof.image(G)
    with np.errstate(over="ignore"):
        found = gauge_bounds(image, image.scaled(points.astype(float)[None] - c[:, None]), tight=True)
    margin = np.where(found.lower > 1, 1 - found.lower, np.maximum(1 - found.upper, 0))[0].astype(
        Z.center.dtype
    )
    if np.isfinite(image.loss[0]):
        return margin
    flat = linalg.left_null_space([[Fraction(x) for x in row] for row in G[0].tolist()])
    return _beside_the_plane([(normal, Fraction(0)) for normal in flat], Z, points, margin)


def _beside_the_plane(
    flat: Sequence[tuple[Sequence[Fraction], Fraction]], Z: Zonotope, points: np.ndarray, margin: np.ndarray
) -> np.ndarray:
    """Return the margins, -inf for points proved to be beside one of the strips without width, and no margin
    above 0 if there are any.
    """
    return np.where(_margins(flat, Z, points) < 0, -np.inf, np.minimum(margin, 0)) if flat else margin


def _margins(
    rows: Sequence[tuple[Sequence[Fraction], Fraction]], Z: Zonotope, points: np.ndarray
) -> np.ndarray:
    given, count = np.asarray(points, Z.center.dtype), len(points)
    if not rows:
        return np.ones(count, given.dtype)
    if count <= AT_ONCE:  # little to work out: few sizes are compiled
        given = np.concatenate([given, np.zeros((AT_ONCE - count, given.shape[1]), given.dtype)])
        rows = [*rows, *[rows[-1]] * (power(len(rows)) - len(rows))]
    table = _table([(*normal, width) for normal, width in rows]).astype(given.dtype)
    return np.asarray(_membership(table, Z.center, given))[:count]


def _table(exact_rows: Sequence[Sequence[Fraction]]) -> Strips:
    """Return strips over all of (p, 1), zero coefficients included: zonotopes of one shape then share one
    compilation.
    """
    scaled = [[x / max(map(abs, row)) for x in row] for row in exact_rows]
    h = np.array([[rounding.fraction_to_float(x) for x in row] for row in scaled])
    rows = np.tile(np.arange(h.shape[1], dtype=np.int32), (len(h), 1))
    return Strips(
        rows, h, np.zeros((len(h), 0)), tuple(map(tuple, rows.tolist())) if len(h) <= UNROLLED else None
    )


@jax.jit
def _membership(table: Strips, center: jax.Array, points: jax.Array) -> jax.Array:
    zero, one = jnp.zeros_like(points[:, 0]), jnp.ones_like(points[:, 0])
    mid = [points[:, i] - center[i] for i in range(points.shape[1])] + [zero]
    scale = [abs(points[:, i]) + abs(center[i]) for i in range(points.shape[1])] + [one]
    return strip_verdict(table, mid, [zero] * points.shape[1] + [one], scale, [], [], 1)
