"""Membership beyond the few facets that can be enumerated."""

from fractions import Fraction

import numpy as np
import pytest
from zonotope_cases import program

from jaxbound import sets


@pytest.mark.parametrize(("n", "q"), [(10, 20), (50, 100)])
def test_margins_are_worked_out_where_facets_cannot_be_enumerated(rng, n, q):
    G, center = rng.normal(size=(n, q)), rng.normal(size=n)
    points = rng.normal(size=(6, n)) * 2
    got = sets.membership(sets.zonotope(center, G), center + points)
    for m, p in zip(got, points, strict=True):
        assert abs(1 - m - program(G, p)) <= 1e-7 * (2 - m)


def test_vertices_of_a_large_zonotope_are_on_the_boundary_and_a_hair_decides(rng):
    G = rng.integers(-4, 5, (10, 20)) * 1.0
    x = np.sign(rng.normal(size=(8, 10)) @ G)
    vertices = np.where(x == 0, 1, x) @ G.T
    Z = sets.zonotope(np.zeros(10), G)
    assert (abs(sets.membership(Z, vertices)) <= 1e-10).all()  # or inside, where a sign was free: never here
    assert (sets.membership(Z, vertices * (1 - 1e-9)) > 0).all() and (
        sets.membership(Z, vertices * (1 + 1e-9)) < 0
    ).all()


def test_a_large_flat_zonotope_is_infinitely_far_from_points_beside_its_plane(rng):
    G = rng.integers(-4, 5, (10, 20)) * 1.0
    G[-1] = G[0] - 2 * G[1]
    inside = np.r_[G[:9, 0], G[0, 0] - 2 * G[1, 0]] / 2
    beside, far = inside + 1e-6 * np.eye(10)[9], inside * 40
    got = sets.membership(sets.zonotope(np.zeros(10), G), np.array([inside, beside, far]))
    assert got[0] == 0 and got[1] == -np.inf and -np.inf < got[2] < 0


def test_float32_sets_are_decided_too(rng):
    G = rng.normal(size=(10, 20)).astype(np.float32)
    points = (rng.normal(size=(5, 10)) * 2).astype(np.float32)
    got = sets.membership(sets.zonotope(np.zeros(10, np.float32), G), points)
    assert got.dtype == np.float32
    for m, p in zip(got, points, strict=True):
        assert abs(1 - m - program(G.astype(float), p.astype(float))) <= 1e-6 * (2 - m)


def test_the_sign_of_a_large_margin_is_that_of_exact_numbers(rng):
    """A point at a vertex, moved by single floats: proof in rationals by the direction whose face it is."""
    G = rng.normal(size=(10, 20))
    exact = [[Fraction(v) for v in row] for row in G.tolist()]
    outside = []
    for l in rng.normal(size=(4, 10)):
        vertex = np.sign(l @ G) @ G.T
        points = vertex * (1 + np.array([-1e-14, 0, 1e-14, 1e-13, 1e-12]))[:, None]
        along = [Fraction(v) for v in l.tolist()]
        width = sum(abs(sum(a * row[j] for a, row in zip(along, exact, strict=True))) for j in range(20))
        for m, p in zip(sets.membership(sets.zonotope(np.zeros(10), G), points), points, strict=True):
            if sum(a * Fraction(v) for a, v in zip(along, p.tolist(), strict=True)) > width:
                outside.append(m)
    assert len(outside) >= 8 and max(outside) <= 0  # two of five are farther out than any rounding
