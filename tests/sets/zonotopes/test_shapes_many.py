"""Ten thousand random sets for what works in exact numbers or for pictures: volume, corners, Minkowski
difference.
"""

from fractions import Fraction
from functools import cmp_to_key
from itertools import combinations

import flint
import numpy as np
import pytest
from test_algebra_many import dot, draw, exact

from jaxbound import sets

SHAPES = {(1, 3): 1000, (2, 5): 3000, (2, 2): 1000}  # twice, once in each dtype
PARALLELOTOPES = {(3, 3): 1000, (3, 2): 400, (5, 5): 300, (8, 8): 100}


def each_set(rng, share):
    """Yield (center, generators) as exact numbers, the Zonotope and its dtype."""
    for (n, q), count in {**SHAPES, **PARALLELOTOPES}.items():
        for dtype in (np.float64, np.float32):
            many = count // share or 1
            Z = draw(rng, many, n, q, dtype)
            for c, G in zip(np.asarray(Z.center), np.asarray(Z.generators), strict=True):
                if (n, q) in PARALLELOTOPES:  # of generators that no one doubts are independent
                    G = np.asarray(rng.normal(size=(n, q)) * 10.0 ** rng.integers(-3, 4, q), dtype)
                yield exact(c), exact(G), sets.zonotope(c, G)


def columns(G):
    return [list(g) for g in zip(*G, strict=True)]


def polygon(c, G):
    """Return the corners in the plane, exactly, counter-clockwise: edges in the order of their angles,
    parallel ones together.
    """
    up = [g if (g[1], g[0]) > (0, 0) else [-v for v in g] for g in columns(G) if any(g)]
    cross = lambda a, b: a[0] * b[1] - a[1] * b[0]
    merged = []
    for g in sorted(up, key=cmp_to_key(lambda a, b: -1 if cross(a, b) > 0 else int(cross(a, b) < 0))):
        if merged and not cross(merged[-1], g):
            merged[-1] = [a + b for a, b in zip(merged[-1], g, strict=True)]
        else:
            merged.append(g)
    p = [v - sum((g[i] for g in merged), Fraction(0)) for i, v in enumerate(c)]
    corners = [p]
    for g in [*merged, *([-v for v in g] for g in merged)]:
        p = [a + 2 * b for a, b in zip(p, g, strict=True)]
        corners.append(p)
    return corners[:-1] or [p]


def rational(G):
    return flint.fmpq_mat(
        len(G), len(G[0]), [flint.fmpq(v.numerator, v.denominator) for row in G for v in row]
    )


def to_fraction(v):
    return Fraction(int(v.p), int(v.q))


def content(c, G):
    """Return the volume: of a polygon by its corners, otherwise by determinants of another library."""
    if len(c) == 2:
        p = polygon(c, G)
        return (
            abs(sum((a[0] * b[1] - a[1] * b[0] for a, b in zip(p, [*p[1:], p[0]], strict=True)), Fraction(0)))
            / 2
        )
    return 2 ** len(c) * sum(
        (abs(to_fraction(rational(list(chosen)).det())) for chosen in combinations(columns(G), len(c))),
        Fraction(0),
    )


def volumes(rng, share):
    """Return (sets looked at, volumes that are not the nearest float)."""
    found = [sets.volume(Z) == float(content(c, G)) for c, G, Z in each_set(rng, share)]
    return len(found), found.count(False)


def corners(rng, share):
    """Return (sets looked at, those with a corner that is none, or without one that is, beyond 1e-12 of their
    size).
    """
    found = []
    for c, G, Z in each_set(rng, share):
        n, q = len(c), len(G[0])
        if n == 2:
            expected = polygon(c, G)
        elif q > n:
            G, q = [[sum(map(abs, G[0]))]], 1  # on a line
            Z = sets.zonotope(np.array([float(c[0])]), np.array([[float(G[0][0])]]))
            c, G = exact(Z.center), exact(Z.generators)
        if n != 2:
            signs = [[1 - 2 * (k >> j & 1) for j in range(q)] for k in range(2**q)]
            expected = [[a + dot(row, map(Fraction, s)) for a, row in zip(c, G, strict=True)] for s in signs]
        expected, ours = np.array([[float(v) for v in p] for p in expected]), sets.vertices(Z)
        size = 1e-12 * (abs(expected).max() + 1)
        gap = abs(expected[:, None] - ours[None]).max(2)
        found.append(gap.min(0).max() <= size and gap.min(1).max() <= size)
    return len(found), found.count(False)


def sides(G):
    """Return [(normal, width)], all facets of the set and perhaps more: in the plane across all generators,
    else rows of the inverse.
    """
    n = len(G)
    if n == 2:
        normals = (
            [[-g[1], g[0]] for g in columns(G)]
            + columns(G)
            + [[Fraction(1), Fraction(0)], [Fraction(0), Fraction(1)]]
        )
    elif n == 1:
        normals = [[Fraction(1)]]
    else:
        inverse = rational(G).inv()
        normals = [[to_fraction(inverse[i, j]) for j in range(n)] for i in range(n)]
    return [(normal, sum((abs(dot(normal, g)) for g in columns(G)), Fraction(0))) for normal in normals]


def thin(G, taken, dtype):
    """Return whether the rounding of its longest generators is as much as a thousandth of what is left of the
    set somewhere.
    """
    size = max(abs(v) for row in G for v in row) * Fraction(float(np.finfo(dtype).eps))
    return any(width - less <= 1000 * size * sum(map(abs, normal)) for normal, width, less in taken)


def differences(rng, share):
    """Return (sets looked at, differences that reach out, leave room on all sides, or are said not to be
    there where they are).
    """
    wrong = total = 0
    for c, G, Z in each_set(rng, share):
        n, q = len(c), len(G[0])
        if n > 2 and q < n:
            continue
        total += 1
        dtype = Z.center.dtype
        size = np.asarray(Z.generators)[:, : min(q, 3)] * rng.choice([0.01, 0.3, 2.0])
        Y = sets.zonotope(np.zeros(n, dtype), (size * rng.uniform(-0.5, 0.5, size.shape[1])).astype(dtype))
        H, D = exact(Y.generators), sets.minkowski_difference(Z, Y)
        taken = [
            (normal, width, sum((abs(dot(normal, h)) for h in columns(H)), Fraction(0)))
            for normal, width in sides(G)
        ]
        if D is None:
            eps = Fraction(
                float(np.finfo(dtype).eps)
            )  # a difference without inside may hold no float near its middle
            wrong += all(less <= width * (1 - 1000 * eps) for _, width, less in taken)
            continue
        shift = [a - b for a, b in zip(exact(D.center), c, strict=True)]
        reach = [
            (
                width,
                less
                + abs(dot(normal, shift))
                + sum((abs(dot(normal, g)) for g in columns(exact(D.generators))), Fraction(0)),
            )
            for normal, width, less in taken
        ]
        out, close = (
            any(r > width for width, r in reach),
            any(r >= width * (1 - Fraction(1, 1000)) for width, r in reach),
        )
        wrong += out or not (close or thin(G, taken, dtype))
    return total, wrong


CHECKS = [volumes, corners, differences]


@pytest.mark.parametrize("check", CHECKS, ids=lambda f: f.__name__)
def test_some_random_sets_are_as_in_exact_numbers(check, rng):
    total, wrong = check(rng, 100)
    assert total >= 100 and wrong == 0


@pytest.mark.long(by_day="test_some_random_sets_are_as_in_exact_numbers")
@pytest.mark.parametrize("check", CHECKS, ids=lambda f: f.__name__)
def test_ten_thousand_random_sets_are_as_in_exact_numbers(check, rng):
    total, wrong = check(rng, 1)
    print(f"{check.__name__}: {total} sets, {wrong} wrong")
    assert total >= 10_000 and wrong == 0
