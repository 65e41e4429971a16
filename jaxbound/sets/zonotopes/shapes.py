"""Shapes of small zonotopes: corners, area and volume, points inside, and what is left when another set is
taken off.

`volume` and `minkowski_difference` compute with exact rationals on the host, for small sets of concrete
numbers; `vertices` and `sample` are for pictures and experiments, and prove nothing.
"""

from collections.abc import Sequence
from fractions import Fraction
from functools import partial
from itertools import combinations
from math import comb, prod
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.exact import linalg
from jaxbound.random.keys import key_of
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.equations import is_traced
from jaxbound.sets.zonotopes import kernels
from jaxbound.sets.zonotopes.constrained import AnySet, exact, parts
from jaxbound.sets.zonotopes.facets import exact_strips, exactly
from jaxbound.sets.zonotopes.zonotope import Zonotope, refuse_infinite

DETERMINANTS = 20_000  # of exact numbers, above which `volume` would take more than a few seconds


def vertices(Z: AnySet) -> np.ndarray:
    """Return the corners of a set in the plane counter-clockwise, or of a parallelotope of any dimension.

    Args:
        Z: a Zonotope or ConstrainedZonotope of concrete numbers in the plane, or a Zonotope with linearly
            independent generators, at most 12. With constraints, a linear program a corner and one a side
            find them all.

    Returns:
        (v, n) NumPy array in plain floats, for pictures: not proved. No rows where the set is empty.

    Raises:
        ValueError: another set. TypeError: inside jit.

    Example:
        >>> from jaxbound import sets
        >>> vertices(sets.zonotope([0.0, 0.0], [[1.0, 0.0], [0.0, 1.0]])).tolist()
        [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]
    """
    if is_traced(Z):
        raise TypeError(
            "corners need concrete numbers, since their number depends on them: ask outside jit, grad and "
            "vmap"
        )
    c, G, A, b = (np.asarray(x, float) for x in parts(Z))
    refuse_infinite(center=c, generators=G, A=A, b=b)
    if len(b):
        return _touched(c, G, A, b)
    G = G[
        :, np.abs(G).max(0, initial=0) > 1e-13 * np.abs(G).max(initial=0)
    ]  # what only holds roundings is no edge
    if len(c) == 2:
        return _corners(c, G)
    if G.shape[1] > min(12, np.linalg.matrix_rank(G)):
        raise ValueError(
            f"corners are found in the plane, or of at most 12 independent generators: there are "
            f"{G.shape[1]} in {len(c)} coordinates"
        )
    signs = 1 - 2.0 * (np.arange(2 ** G.shape[1])[:, None] >> np.arange(G.shape[1]) & 1)
    return c + signs @ G.T


def _corners(c: np.ndarray, G: np.ndarray) -> np.ndarray:
    """Return the corners of a zonotope in the plane: its edges are its generators in the order of their
    angles.
    """
    G = np.where((G[1] < 0) | ((G[1] == 0) & (G[0] < 0)), -G, G)
    G = G[:, np.argsort(np.arctan2(G[1], G[0]), kind="stable")]
    edges: list[np.ndarray] = []
    for g in G.T:
        if edges and abs(edges[-1][0] * g[1] - edges[-1][1] * g[0]) <= 1e-13 * np.hypot(
            *edges[-1]
        ) * np.hypot(*g):
            edges[-1] = edges[-1] + g
        else:
            edges.append(g)
    if not edges:
        return c[None]
    half = np.sum(edges, 0) - 2 * np.cumsum(
        [np.zeros(2), *edges[:-1]], 0
    )  # from the corner where all are positive
    return c + np.concatenate([half, -half])


def _touched(c: np.ndarray, G: np.ndarray, A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the corners of a constrained set in the plane: beyond a side there is another corner, or
    none.
    """
    from scipy.optimize import linprog

    if len(c) != 2:
        raise ValueError(
            f"corners of a set with constraints are found in the plane: it has {len(c)} coordinates, choose "
            f"two with linear_map"
        )

    def farthest(l):
        found = linprog(-l @ G, A_eq=A, b_eq=b, bounds=(-1, 1))
        return c + G @ found.x if found.status == 0 else None

    first, last = (farthest(np.array([s, 0.0])) for s in (1, -1))
    if first is None or last is None:
        return np.zeros((0, 2))
    # below this two corners are one: a linear program is right to about that
    size = 1e-9 * (abs(c).max() + abs(G).sum())

    def between(p, r):
        """Return the corners after p and up to r, where the set lies to the left of the way from p to r, or
        beyond it.
        """
        along = r - p
        normal = (
            np.array([along[1], -along[0]])
            if abs(along).max() > size
            else np.array([0.0, 1.0 if p is first else -1.0])
        )
        q = farthest(normal / abs(normal).max())
        if (
            q is None
            or normal @ (q - p) <= size * abs(normal).max()
            or min(abs(q - p).max(), abs(q - r).max()) <= size
        ):
            return [r]
        return between(p, q) + between(q, r)

    round_trip = between(first, last) + between(last, first)
    return np.array(
        [
            p
            for p, before in zip(round_trip, round_trip[-1:] + round_trip, strict=False)
            if abs(p - before).max() > size
        ]
        or [first]
    )


def volume(Z: Zonotope) -> float:
    """Return the volume 2^n sum |det(n generators)| of a small Zonotope, worked out exactly and rounded to
    nearest.

    Args:
        Z: a Zonotope of n coordinates; q generators have (q over n) determinants.

    Raises:
        ValueError: more than 20 000 determinants. TypeError: inside jit.

    Source: Gover, Krikorian 2010.

    Example:
        >>> from jaxbound import sets
        >>> volume(sets.zonotope([1.0, 2.0], [[1.0, 3.0], [2.0, 4.0]]))
        8.0
    """
    if is_traced(Z):
        raise TypeError("a volume is worked out from concrete numbers: ask outside jit, grad and vmap")
    Z = cast(Zonotope, exact(Z))
    refuse_infinite(center=Z.center, generators=Z.generators)
    n, q = Z.generators.shape
    if comb(q, n) > DETERMINANTS:
        raise ValueError(
            f"{q} generators in {n} coordinates have {comb(q, n)} determinants, more than {DETERMINANTS}: "
            f"reduce_order first"
        )
    columns = [linalg.integers(g) for g in linalg.transpose(exactly(Z.generators))]
    total = Fraction(0)
    for chosen in combinations(columns, n):
        total += abs(Fraction(linalg.determinant([g for g, _ in chosen]), prod(s for _, s in chosen)))
    return float(2**n * total)


def sample(Z: AnySet, key: jax.Array | int, count: int) -> jax.Array:
    """Draw points of a set, so more near the middle. Plain floats, not proved.

    The coefficients are uniform in [-1, 1]; with constraints nearly uniform among those that keep them: each
    point ends a walk of its own of 10 steps a generator, each uniform on a line through the last place in a
    direction drawn afresh (hit and run), from the coefficients with most room.

    Args:
        Z: a Zonotope or ConstrainedZonotope. key: a jax.random key, or a whole number. count: how many.

    Returns:
        (count, n) points; NaN if the constraints cannot be kept.

    Source: Smith 1984 (hit and run).
    """
    (c, G, A, b), key = parts(Z), key_of(key)
    if not len(b):
        return c[None] + jax.random.uniform(key, (count, G.shape[1]), c.dtype, -1, 1) @ G.T
    return c[None] + _walked(A, b, key, count) @ G.T


@partial(jax.jit, static_argnames="count")
def _walked(A: jax.Array, b: jax.Array, key: jax.Array, count: int) -> jax.Array:
    R = jnp.linalg.pinv(A)
    image = kernels.image(A[None])
    _, x = kernels.candidates(image, image.scaled(b[None, None]))
    x = x[0, 0] + R @ (b - A @ x[0, 0])
    noise, eps = 64 * jnp.finfo(A.dtype).eps, jnp.finfo(A.dtype).eps ** 0.5
    feasible = (jnp.max(jnp.abs(b - A @ x)) <= eps * jnp.max(jnp.abs(b) + jnp.sum(jnp.abs(A), 1))) & (
        jnp.max(jnp.abs(x)) <= 1 + eps
    )

    def step(_, carry):
        x, key = carry
        key, one, two = jax.random.split(key, 3)
        g = jax.random.normal(one, x.shape, x.dtype)
        v = g - R @ (A @ g)
        # an entry that is rounding alone would stop the walk at a side of the box
        v = jnp.where(jnp.abs(v) > noise * jnp.max(jnp.abs(g)), v, 0)
        to = lambda end: jnp.where(v != 0, (end * jnp.sign(v) - x) / jnp.where(v != 0, v, 1), end * jnp.inf)
        most, least = jnp.min(to(1)), jnp.max(to(-1))
        t = least + (most - least) * jax.random.uniform(two, (), x.dtype)
        return jnp.clip(x + jnp.where(jnp.isfinite(t), t, 0) * v, -1, 1), key

    walk = lambda key: jax.lax.fori_loop(0, 10 * len(x), step, (x, key))[0]
    walked = jax.vmap(walk)(jax.random.split(key, count))
    return jnp.where(feasible, walked, jnp.nan)


def minkowski_difference(Z: Zonotope, Y: Zonotope) -> Zonotope | None:
    """Return a Zonotope inside {p : p + r in Z for every r in Y}, equal to it but for rounding; None if Y
    does not fit into Z.

    Args:
        Z: a Zonotope of concrete numbers in the plane, or a parallelotope (at most n independent generators)
            in n dimensions, where the difference is a zonotope again. Y: any Zonotope of concrete numbers of
            the same dimension.

    Raises:
        ValueError: sets of different dimension; a Z of neither kind, whose difference need not be a zonotope.
            TypeError: inside jit.

    Source: strips that move inward by the support of Y: Kolmanovsky, Gilbert 1998; for zonotopes Althoff
    2015.

    Example:
        >>> from jaxbound import sets
        >>> minkowski_difference(sets.zonotope([0.0], [[3.0]]), sets.zonotope([0.0], [[1.0]])).generators
        Array([[2.]], dtype=...)
    """
    Z, Y = (cast(Zonotope, exact(S)) for S in (Z, Y))
    (n,), (m,) = Z.center.shape, Y.center.shape
    if n != m:
        raise ValueError(f"the sets must have one dimension: they have {n} and {m} coordinates")
    if is_traced(Z, Y):
        raise TypeError("a difference is worked out from concrete numbers: ask outside jit, grad and vmap")
    refuse_infinite(center=Y.center, generators=Y.generators)
    directions = _directions(Z)
    if n != 2 and len(directions) > linalg.rank(directions):
        raise ValueError(
            f"the difference is a zonotope in the plane and for parallelotopes: this set has generators in "
            f"{len(directions)} directions, "
            f"in {n} dimensions"
        )
    found = exact_strips(Z)
    H = linalg.transpose(exactly(Y.generators))
    left = [
        (normal, width - sum((abs(linalg.dot(normal, h)) for h in H), Fraction(0))) for normal, width in found
    ]
    if any(width < 0 for _, width in left):
        return None
    middle = [x - y for x, y in exactly(np.stack([Z.center, Y.center], 1))]
    edges = _edges(left) if n == 2 else _columns(left)
    return _rounded_inward(middle, edges, left, Z.center.dtype)


def _directions(Z: Zonotope) -> list[tuple[Fraction, ...]]:
    """Return the directions of the generators, each once."""
    refuse_infinite(center=Z.center, generators=Z.generators)
    columns = linalg.transpose(exactly(Z.generators))
    return sorted({linalg.primitive(g) for g in columns if any(g)})


def _columns(strips: Sequence[tuple[Sequence[Fraction], Fraction]]) -> list[list[Fraction]]:
    """Return the generators of a parallelotope from its n strips."""
    inverse = linalg.inverse([normal for normal, _ in strips])
    return [[row[j] * width for row in inverse] for j, (_, width) in enumerate(strips)]


def _edges(strips: Sequence[tuple[Sequence[Fraction], Fraction]]) -> list[list[Fraction]]:
    """Return the generators of the polygon |normal . p| <= width: half its edges, between neighbouring
    corners on each line.
    """
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


def _rounded_inward(
    middle: Sequence[Fraction],
    edges: list[list[Fraction]],
    strips: Sequence[tuple[Sequence[Fraction], Fraction]],
    dtype: DTypeLike,
) -> Zonotope | None:
    """Return the Zonotope of floats near (middle, edges), shrunk until it lies within the strips; None if no
    float lies within.
    """
    # the middle is off by its rounding, and strips are that much narrower
    center = np.array([rounding.fraction_to_float(x, dtype) for x in middle])
    off = [Fraction(float(x)) - y for x, y in zip(center, middle, strict=True)]
    room = [width - abs(linalg.dot(normal, off)) for normal, width in strips]
    if any(x < 0 for x in room):
        return None
    shrink = Fraction(1)
    while True:
        G = (
            np.array([[float(x * shrink) for x in edge] for edge in edges])
            .T.astype(dtype)
            .reshape(len(center), -1)
        )
        taken = [sum((abs(linalg.dot(normal, g)) for g in exactly(G.T)), Fraction(0)) for normal, _ in strips]
        if all(t <= r for t, r in zip(taken, room, strict=True)):
            return Zonotope(jnp.asarray(center), jnp.asarray(G))
        worst = min((r / t for t, r in zip(taken, room, strict=True) if t > r))
        # a little more than what is asked for, so that the loop ends
        shrink *= worst * (1 - Fraction(1, 2**20 if dtype == np.float32 else 2**49))
