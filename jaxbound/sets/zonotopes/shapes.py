"""What small zonotopes look like: corners, area and volume, points inside, and what is left when another set is taken off.

`volume` and `minkowski_difference` compute with exact rationals on the host, for small sets of concrete numbers; `vertices` and `sample`
are for pictures and experiments, and prove nothing.
"""

from fractions import Fraction
from itertools import combinations
from math import comb

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.exact import linalg
from jaxbound.sets.floats import rounding
from jaxbound.sets.zonotopes.facets import exact_strips
from jaxbound.sets.zonotopes.zonotope import Zonotope

__all__ = ["minkowski_difference", "sample", "vertices", "volume"]

DETERMINANTS = 20_000  # of exact numbers, above which `volume` would take more than a few seconds


def vertices(Z):
    """Return the corners of a Zonotope in the plane counter-clockwise, or of a parallelotope of any dimension.

    Args:
        Z: a Zonotope of concrete numbers in the plane, or one with linearly independent generators, at most 12.

    Returns:
        (v, n) NumPy array in plain floats, for pictures: not proved.

    Raises:
        ValueError: another Zonotope.

    Example:
        >>> from jaxbound import sets
        >>> vertices(sets.zonotope([0.0, 0.0], [[1.0, 0.0], [0.0, 1.0]])).tolist()
        [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]
    """
    c, G = (np.asarray(x, float) for x in (Z.center, Z.generators))
    G = G[:, np.abs(G).max(0, initial=0) > 1e-13 * np.abs(G).max(initial=0)]  # what only holds roundings is no edge
    if len(c) == 2:
        return _corners(c, G)
    if G.shape[1] > min(12, np.linalg.matrix_rank(G)):
        raise ValueError(
            f"corners are found in the plane, or of at most 12 independent generators: there are {G.shape[1]} in {len(c)} coordinates"
        )
    signs = 1 - 2.0 * (np.arange(2 ** G.shape[1])[:, None] >> np.arange(G.shape[1]) & 1)
    return c + signs @ G.T


def _corners(c, G):
    """Return the corners of a zonotope in the plane: its edges are its generators in the order of their angles."""
    G = np.where((G[1] < 0) | ((G[1] == 0) & (G[0] < 0)), -G, G)
    G = G[:, np.argsort(np.arctan2(G[1], G[0]), kind="stable")]
    edges = []
    for g in G.T:
        if edges and abs(edges[-1][0] * g[1] - edges[-1][1] * g[0]) <= 1e-13 * np.hypot(*edges[-1]) * np.hypot(*g):
            edges[-1] = edges[-1] + g
        else:
            edges.append(g)
    if not edges:
        return c[None]
    half = np.sum(edges, 0) - 2 * np.cumsum([np.zeros(2), *edges[:-1]], 0)  # from the corner where all are positive
    return c + np.concatenate([half, -half])


def volume(Z):
    """Return the volume 2^n sum |det(n generators)| of a small Zonotope, worked out exactly and rounded to nearest.

    Raises:
        ValueError: more than 20 000 determinants.

    Source: Gover, Krikorian 2010.

    Example:
        >>> from jaxbound import sets
        >>> volume(sets.zonotope([1.0, 2.0], [[1.0, 3.0], [2.0, 4.0]]))
        8.0
    """
    n, q = Z.generators.shape
    if comb(q, n) > DETERMINANTS:
        raise ValueError(f"{q} generators in {n} coordinates have {comb(q, n)} determinants, more than {DETERMINANTS}: reduce_order first")
    columns = [linalg.primitive_scale([Fraction(float(x)) for x in g]) for g in np.asarray(Z.generators).T]
    total = Fraction(0)
    for chosen in combinations(columns, n):
        total += abs(Fraction(linalg.determinant([g for g, _ in chosen]), np.prod([s for _, s in chosen], dtype=object)))
    return float(2**n * total)


def sample(Z, key, count):
    """Draw points of a Zonotope: every coefficient uniform in [-1, 1], so more points near the middle. Plain floats, not proved.

    Args:
        Z: a Zonotope. key: a jax random key. count: how many.

    Returns:
        (count, n) points.
    """
    x = jax.random.uniform(key, (count, Z.generators.shape[1]), Z.center.dtype, -1, 1)
    return Z.center[None] + x @ Z.generators.T


def minkowski_difference(Z, Y):
    """Return a Zonotope inside {p : p + r in Z for every r in Y}, equal to it but for rounding; None if Y does not fit into Z.

    Args:
        Z: a Zonotope of concrete numbers in the plane, or a parallelotope (at most n independent generators) in n dimensions, where the
            difference is a zonotope again. Y: any Zonotope of concrete numbers of the same dimension.

    Raises:
        ValueError: sets of different dimension; a Z of neither kind, whose difference need not be a zonotope.

    Source: strips that move inward by the support of Y: Kolmanovsky, Gilbert 1998; for zonotopes Althoff 2015.

    Example:
        >>> from jaxbound import sets
        >>> minkowski_difference(sets.zonotope([0.0], [[3.0]]), sets.zonotope([0.0], [[1.0]])).generators
        Array([[2.]], dtype=...)
    """
    (n,), (m,) = Z.center.shape, Y.center.shape
    if n != m:
        raise ValueError(f"the sets must have one dimension: they have {n} and {m} coordinates")
    found = exact_strips(Z)
    if n != 2 and len(found) != n:
        raise ValueError(
            f"the difference is a zonotope in the plane and for parallelotopes: this set has {len(found)} strips in {n} dimensions"
        )
    H = linalg.transpose([[Fraction(float(x)) for x in row] for row in np.asarray(Y.generators)])
    along = lambda normal, p: sum((a * b for a, b in zip(normal, p, strict=True)), Fraction(0))
    left = [(normal, width - sum((abs(along(normal, h)) for h in H), Fraction(0))) for normal, width in found]
    if any(width < 0 for _, width in left):
        return None
    middle = [Fraction(float(x)) - Fraction(float(y)) for x, y in zip(np.asarray(Z.center), np.asarray(Y.center), strict=True)]
    edges = _edges(left) if n == 2 else _columns(left)
    return _rounded_inward(middle, edges, left, along, Z.center.dtype)


def _columns(strips):
    """Return the generators of a parallelotope from its n strips."""
    inverse = linalg.inverse([normal for normal, _ in strips])
    return [[row[j] * width for row in inverse] for j, (_, width) in enumerate(strips)]


def _edges(strips):
    """Return the generators of the polygon |normal . p| <= width: half its edges, between neighbouring corners on each line."""
    corners = set()
    for (a, w), (b, v) in combinations(strips, 2):
        if det := a[0] * b[1] - a[1] * b[0]:
            for s, t in ((w, v), (w, -v), (-w, v), (-w, -v)):
                p = ((s * b[1] - t * a[1]) / det, (a[0] * t - b[0] * s) / det)
                if all(abs(n[0] * p[0] + n[1] * p[1]) <= width for n, width in strips):
                    corners.add(p)
    edges = []
    for normal, width in strips:
        on = sorted(p for p in corners if normal[0] * p[0] + normal[1] * p[1] == width)
        if len(on) > 1:
            edges.append([(x - y) / 2 for x, y in zip(on[-1], on[0], strict=True)])
    return edges or [[Fraction(0), Fraction(0)]]


def _rounded_inward(middle, edges, strips, along, dtype):
    """Return the Zonotope of floats near (middle, edges), shrunk until it lies within the strips; None if no float lies within."""
    center = np.array([rounding.fraction_to_float(x, dtype) for x in middle])
    off = [Fraction(float(x)) - y for x, y in zip(center, middle, strict=True)]
    room = [width - abs(along(normal, off)) for normal, width in strips]
    if any(x < 0 for x in room):
        return None
    shrink = Fraction(1)
    while True:
        G = np.array([[float(x * shrink) for x in edge] for edge in edges]).T.astype(dtype).reshape(len(center), -1)
        taken = [sum((abs(along(normal, [Fraction(float(x)) for x in g])) for g in G.T), Fraction(0)) for normal, _ in strips]
        if all(t <= r for t, r in zip(taken, room, strict=True)):
            return Zonotope(jnp.asarray(center), jnp.asarray(G))
        worst = min((r / t for t, r in zip(taken, room, strict=True) if t > r))
        shrink *= worst * (1 - Fraction(1, 2**20 if dtype == np.float32 else 2**49))
