"""Corners, volumes, samples and differences of small zonotopes, against exact values and strips."""

import itertools
from fractions import Fraction

import jax
import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from jaxbound import sets
from jaxbound.exact.linalg import transpose
from jaxbound.sets.zonotopes.facets import exact_strips


def along(normal, p):
    return sum((a * Fraction(float(b)) for a, b in zip(normal, p, strict=True)), Fraction(0))


def test_corners_are_the_published_ones(shared):
    import json

    cases = json.loads(shared("external/zonotope_cases.json").read_text())
    cases = [case for case in cases if case["kind"] == "vertices" and "A" not in case]
    assert cases
    for case in cases:
        found = sets.vertices(sets.zonotope(case["c"], case["G"]))
        assert sorted(map(tuple, found.round(9).tolist())) == sorted(map(tuple, case["vertices"]))


def test_corners_go_round_and_touch_two_strips_each(rng):
    Z = sets.zonotope(rng.normal(size=2), rng.normal(size=(2, 6)))
    corners = sets.vertices(Z)
    edges = np.roll(corners, -1, 0) - corners
    after = np.roll(edges, -1, 0)
    assert corners.shape == (12, 2) and (edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0] > 0).all()
    normals, widths = sets.strips(Z)
    touched = np.abs(np.abs((corners - np.asarray(Z.center)) @ normals.T) - widths) < 1e-12 * widths
    assert (touched.sum(1) == 2).all()


def test_volumes_are_the_published_ones_and_grow_with_the_cube_of_the_size(shared, rng):
    import json

    for case in json.loads(shared("external/zonotope_cases.json").read_text()):
        if case["kind"] == "volume":
            assert sets.volume(sets.zonotope(case["c"], case["G"])) == case["volume"]
    G = rng.normal(size=(3, 6))
    assert sets.volume(sets.zonotope(np.zeros(3), 2 * G)) == 8 * sets.volume(sets.zonotope(np.zeros(3), G))
    assert sets.volume(sets.zonotope(np.zeros(3), G[:, :2])) == 0
    assert (
        sets.volume(sets.zonotope([0.0, 0.0], [[2.0**-43, 0.0], [0.0, 2.0**-63]])) == 2.0**-104
    )  # whole numbers of 64 bits without sign
    with pytest.raises(ValueError, match="determinants"):
        sets.volume(sets.zonotope(np.zeros(10), np.ones((10, 30))))


def test_samples_lie_within_up_to_rounding(rng):
    Z = sets.zonotope(rng.normal(size=3), rng.normal(size=(3, 7)))
    points = sets.sample(Z, jax.random.key(1), 500)
    assert points.shape == (500, 3) and (sets.membership(Z, points) > -1e-12).all()


def test_corners_of_a_constrained_set_go_round_and_are_those_of_all_its_bases(rng):
    """Every corner has two coefficients free of 4, the others at an end: all such points, and their convex
    hull.
    """
    for _ in range(4):
        c, G, A = rng.normal(size=2), rng.normal(size=(2, 4)), rng.normal(size=(1, 4))
        b = A @ rng.uniform(-0.8, 0.8, 4)
        points = []
        for free in range(4):
            for ends in itertools.product((-1, 1), repeat=3):
                x = np.insert(np.array(ends, float), free, 0)
                x[free] = (b - A @ x)[0] / A[0, free]
                points += [c + G @ x] if abs(x[free]) <= 1 else []
        hull = ConvexHull(points)
        expected = np.array(points)[hull.vertices]  # counter-clockwise, from anywhere
        found = sets.vertices(sets.constrained_zonotope(c, G, A, b))
        start = np.argmin(abs(found - expected[0]).max(1))
        assert found.shape == expected.shape and abs(np.roll(found, -start, 0) - expected).max() <= 1e-9


def test_corners_of_a_segment_a_point_and_nothing_with_constraints():
    corners = lambda A, b: sets.vertices(sets.constrained_zonotope([1.0, 0.0], np.eye(2, 3), A, b)).tolist()
    assert sorted(corners([[1.0, 0, 0]], [0.5])) == [[1.5, -1.0], [1.5, 1.0]]
    assert corners(np.eye(2, 3), [0.5, 0.25]) == [[1.5, 0.25]]
    assert corners([[1.0, 0, 0]], [2.0]) == []


def test_samples_keep_the_constraints_spread_and_are_not_there_where_nothing_is(rng):
    A, G = rng.normal(size=(1, 3)), np.eye(3)
    C = sets.constrained_zonotope(np.zeros(3), G, A, A @ rng.uniform(-0.5, 0.5, 3))
    x = np.asarray(sets.sample(C, jax.random.key(0), 400))
    assert np.abs(x).max() <= 1 and np.abs(x @ A.T - np.asarray(C.offsets)).max() <= 1e-12
    box = np.array(
        [[linprog(s * g, A_eq=A, b_eq=C.offsets, bounds=(-1, 1)).fun * s for s in (1, -1)] for g in G]
    )
    assert (np.ptp(x, axis=0) >= 0.5 * (box[:, 1] - box[:, 0])).all()
    nothing = sets.constrained_zonotope(np.zeros(3), G, A, 100 * np.ones(1))
    assert np.isnan(sets.sample(nothing, jax.random.key(0), 400)).all()


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("n, q", [(1, 3), (2, 5), (2, 2), (3, 3), (4, 4)])
def test_a_difference_and_what_was_taken_off_fit_inside_and_fill_it(n, q, dtype, rng):
    Z = sets.zonotope(rng.normal(size=n).astype(dtype), rng.normal(size=(n, q)).astype(dtype))
    Y = sets.zonotope(rng.normal(size=n).astype(dtype), (0.01 * rng.normal(size=(n, 3))).astype(dtype))
    Z, Y, D = (jax.tree.map(np.asarray, S) for S in (Z, Y, sets.minkowski_difference(Z, Y)))
    c = [
        Fraction(float(a)) + Fraction(float(b)) - Fraction(float(z))
        for a, b, z in zip(D.center, Y.center, Z.center, strict=True)
    ]
    G = [[Fraction(float(x)) for x in row] for row in np.concatenate([D.generators, Y.generators], 1)]
    for normal, width in exact_strips(Z):
        reached = sum(
            (abs(sum(a * b for a, b in zip(normal, g, strict=True))) for g in transpose(G)), Fraction(0)
        )
        reached += abs(sum(a * b for a, b in zip(normal, c, strict=True)))
        assert reached <= width
        assert n > 2 or q > 2 or reached >= width * (1 - 100 * Fraction(float(np.finfo(dtype).eps)))
    corners = exact_corners(D) if n == 2 else []
    for p in corners:  # a hair further out is too far: the difference is all of it
        assert any(
            abs(along(normal, p)) + taken(normal, Y) >= width * (1 - Fraction(1, 10**4))
            for normal, width in exact_strips(Z)
        )


def exact_corners(D):
    return sets.vertices(D) - np.asarray(D.center, float)


def taken(normal, Y):
    return sum((abs(along(normal, g)) for g in np.asarray(Y.generators).T), Fraction(0))


def test_differences_are_the_published_ones():
    Z, Y = (
        sets.zonotope([0.0, 0.0], [[1.0, 3.0], [2.0, 4.0]]),
        sets.zonotope([0.0, 0.0], [[4.0, 0.0], [0.0, 6.0]]),
    )
    assert sets.minkowski_difference(Z, Y) is None
    assert not np.asarray(sets.minkowski_difference(Z, Z).generators).any()


def test_a_difference_that_need_be_no_zonotope_is_refused(rng):
    Z = sets.zonotope(np.zeros(3), rng.normal(size=(3, 5)))
    with pytest.raises(ValueError, match="parallelotopes"):
        sets.minkowski_difference(Z, Z)
    with pytest.raises(ValueError, match="one dimension"):
        sets.minkowski_difference(Z, sets.zonotope([0.0], [[1.0]]))
