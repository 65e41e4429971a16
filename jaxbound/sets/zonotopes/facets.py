"""The facets of a zonotope: its strips, exactly, and membership with a guaranteed sign."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.exact import linalg
from jaxbound.exact.circuits import circuits
from jaxbound.exact.price import refuse_or_say
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.equations import is_traced
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.zonotopes import gauges, kernels
from jaxbound.sets.zonotopes.constrained import exact
from jaxbound.sets.zonotopes.questions import numbers
from jaxbound.sets.zonotopes.zonotope import Zonotope, refuse_infinite

FEW = 500
"""How many subsets of n - 1 generators are looked through for facets: a second or so in exact numbers."""

BLOCK = 2**15
"""Products of points and strips that are worked out at a time."""


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
    n = len(found[0][0])
    normals = np.array([[float(x) for x in normal] for normal, _ in found]).reshape(-1, n)
    return normals, np.array([float(w) for _, w in found])


def exact_strips(Z: Zonotope) -> list[tuple[list[Fraction], Fraction]]:
    """Return [(normal, half-width)] as exact numbers."""
    Z = cast(Zonotope, exact(Z))
    if isinstance(Z.generators, jax.core.Tracer):
        raise TypeError("strips need concrete generators: build them outside jit, grad and vmap")
    refuse_infinite(center=Z.center, generators=Z.generators)
    G = exactly(Z.generators)
    n, q = np.shape(Z.generators)
    flat = linalg.left_null_space(G) if q else linalg.identity(n)
    out: list[tuple[Sequence[Fraction], Fraction]] = []
    if q and any(any(row) for row in G):
        kernel = linalg.transpose(linalg.left_null_space(linalg.transpose(G)))  # G kernel = 0
        _price(q, q - len(kernel[0]) if kernel else q)
        shadows = circuits(kernel) if kernel else linalg.identity(q)
        basis, pivots = linalg.row_reduce(linalg.beside(G, linalg.identity(n)))
        steps = [(p, row[q:]) for p, row in zip(pivots, basis, strict=True) if p < q]
        turned = linalg.transpose([row for _, row in steps])
        for g in shadows:  # normal' G = g: combine the reduced rows with the entries of g at their pivots
            normal = linalg.multiply(turned, [g[p] for p, _ in steps])
            out.append((normal, sum(map(abs, g), Fraction(0))))
    found = [([x / s for x in normal], w / s) for normal, w in out if (s := max(map(abs, normal)))]
    return found + [([x / max(map(abs, normal)) for x in normal], Fraction(0)) for normal in flat]


def _price(q: int, rank: int) -> None:
    """Refuse the strips of a set of q generators that would take too long, or say how long they take."""
    subsets = math.comb(q, rank - 1)
    seconds = 3e-4 * subsets * min(rank, q - rank + 1)
    do = "ask `membership` or `contains`, which search, or let `reduce_order` leave fewer generators"
    refuse_or_say(seconds, f"strips by {subsets} subsets of {q} generators", do)


def exactly(G: ArrayLike) -> list[list[Fraction]]:
    """Return the rows of a matrix of floats as Fractions."""
    return [[Fraction(x) for x in row] for row in np.asarray(G, float).tolist()]


def by_facets(outer: Sequence[np.ndarray], inner: Sequence[np.ndarray]) -> tuple[bool, float, np.ndarray]:
    """Return (whether it is held, margin, direction) by all facets of the outer zonotope, in exact
    numbers.
    """
    (c, G, _, _), (c2, G2, _, _) = outer, inner
    shift = [a - b for a, b in exactly(np.stack([c2, c], 1))]
    columns = exactly(G2.T)
    dot = linalg.dot
    worst, direction = Fraction(0), np.zeros(len(c))
    for normal, width in exact_strips(Zonotope(cast(jax.Array, c), cast(jax.Array, G))):
        reach = abs(dot(normal, shift)) + sum((abs(dot(normal, g)) for g in columns), Fraction(0))
        sign = -1 if dot(normal, shift) < 0 else 1
        if reach > width and not width:
            return False, -np.inf, np.array([float(sign * v) for v in normal])
        if width and reach / width > worst:
            worst, direction = reach / width, np.array([float(sign * v) for v in normal])
    return worst <= 1, float(1 - worst), direction


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
    Z = cast(Zonotope, exact(Z))
    points = points if isinstance(points, jax.Array) else np.asarray(points)
    n = Z.center.shape[0]
    if points.ndim != 2 or points.shape[1] != n:
        raise ValueError(f"points must have shape (N, {n}): their shape is {points.shape}")
    if is_traced(Z, points):
        ((c, G, _, _),) = numbers(Z, points=points)
        (away,) = kernels.settled(rounding.widened(jnp.asarray(points), c.dtype))
        lower, upper, *_ = kernels.bounds(G[None], (away - c[None])[None], 0.0)
        return jnp.where(lower > 1, 1 - lower, jnp.maximum(1 - upper, 0))[0]
    points = np.asarray(points)
    refuse_infinite(center=Z.center, generators=Z.generators, points=points)
    with np.errstate(all="ignore"):
        away, G = points.astype(float) - np.asarray(Z.center, float), np.asarray(Z.generators, float)
        if math.comb(G.shape[1], n - 1) > FEW:
            lower, upper, *_ = gauges.bounds(G[None], away[None], tight=True)
            margin = np.where(lower > 1, 1 - lower, np.maximum(1 - upper, 0))[0]
            solid = ((upper > 0) & (upper < np.inf)).all()  # no flat set has such a bound
            flat = () if solid else linalg.left_null_space(exactly(G))
        else:
            found = exact_strips(Z)
            far, slack = _farthest([[x / width for x in normal] for normal, width in found if width], away)
            margin = np.where((far + slack <= 1) | (far - slack > 1), 1 - far, 0)
            flat = tuple(tuple(normal) for normal, width in found if not width)
        if flat:
            far, slack = _farthest(flat, away)
            margin = np.where(far > slack, -np.inf, np.minimum(margin, 0))
    return margin.astype(Z.center.dtype)


def _farthest(rows: Sequence[Sequence[Fraction]], d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return max_k |h_k d| (N,) for exact rows h and points d (N, n), and more than it may be off by and a
    few roundings of 1: by `rounding.product_error`, whose gamma holds that h and d were rounded once.
    """
    H = np.array([[rounding.fraction_to_float(x) for x in row] for row in rows]).reshape(-1, d.shape[1])
    gamma, floor = rounding.product_error(d.shape[1] + 4, float)
    far, size, high, turned = np.zeros(len(d)), np.zeros(len(d)), abs(d).max(1), np.ascontiguousarray(d.T)
    block = BLOCK // max(len(H), 1)
    for part in (slice(i, i + block) for i in range(0, len(d), block)):  # points side by side in memory
        far[part] = abs(H @ turned[:, part]).max(0, initial=0)
        size[part] = (abs(H) @ abs(turned[:, part])).max(0, initial=0)
    return far, gamma * (1 + size) + floor * (1 + abs(H).max(initial=0)) * (1 + high)
