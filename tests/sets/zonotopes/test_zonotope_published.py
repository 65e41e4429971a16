"""Zonotope facts that others published; what can be compiled eagerly, under jit and under vmap, decisions in
test_decisions_inside_jit.
"""

import json
from fractions import Fraction

import jax
import numpy as np
import pytest
from corners import MODES
from scipy.spatial import ConvexHull
from zonotope_cases import build, margin, padded, polytope, widths_along

from jaxbound import sets
from jaxbound.sets import zonotope as factory

KINDS = [
    "point_in",
    "interval_hull",
    "volume",
    "vertices",
    "support",
    "norm2",
    "diameter2",
    "merge_parallel",
    "linear_map",
    "minkowski_sum",
    "intersects",
    "zonotope_in",
    "minkowski_difference",
]


@pytest.fixture(scope="module")
def cases(shared):
    """Return the published cases by kind."""
    by_kind = {}
    for case in json.loads(shared("external/zonotope_cases.json").read_text()):
        by_kind.setdefault(case["kind"], []).append(case)
    return by_kind


each_mode = pytest.mark.parametrize("mode", MODES)


def run(mode, f, *cases):
    """Return what f gives for each of the cases, tuples of trees of NumPy arrays, all of one shape."""
    stacked = jax.tree.map(lambda *rows: np.stack(rows), *cases)
    one = lambda tree, i: jax.tree.map(lambda x: x[i], tree)
    if mode == "vmap":
        found = MODES[mode](f)(*stacked)
        return [one(found, i) for i in range(len(cases))]
    return [MODES[mode](f)(*one(stacked, i)) for i in range(len(cases))]


def reaches_as_far(found, center, G, n):
    """Assert that the set's first n coordinates reach as far as those of another, and no farther than
    rounding asks.
    """
    exact = lambda v: [Fraction(float(x)) for x in v]
    dot = lambda v, w: sum(a * b for a, b in zip(v, w, strict=True))
    far = lambda d, c, G: dot(d, exact(c)) + sum(abs(dot(d, exact(g))) for g in np.transpose(G))
    for d in np.random.default_rng(0).integers(-5, 6, (8, n)).tolist():
        more = far(d, found.center[:n], found.generators[:n]) - far(d, center, G)
        assert 0 <= more < 1e-12


# published cases


def test_every_published_case_is_of_a_kind_tested_here(cases):
    assert sorted(cases) == sorted(KINDS) and sum(map(len, cases.values())) == 32


def test_published_points_are_in_or_out_with_the_published_gauge(cases):
    for case in cases["point_in"]:
        m = margin(build(case), case["point"])
        assert m >= 0 if case["inside"] else m < 0
        assert abs(1 - m - case["min_inf_norm"]) < 1e-12


@each_mode
def test_published_interval_hulls_are_enclosed_tightly(mode, cases):
    for case, box in zip(
        cases["interval_hull"],
        run(mode, sets.interval_hull, *((build(c),) for c in cases["interval_hull"])),
        strict=True,
    ):
        assert (box.lo <= np.array(case["lo"])).all() and (np.array(case["hi"]) <= box.hi).all()
        assert (box.lo >= np.array(case["lo"]) - 1e-14).all() and (
            box.hi <= np.array(case["hi"]) + 1e-14
        ).all()


def test_published_volumes_are_those_of_the_strips(cases):
    for case in cases["volume"]:
        assert abs(ConvexHull(polytope(build(case))).volume - case["volume"]) < 1e-9


def test_published_vertices_are_on_the_boundary_and_a_hair_decides(cases):
    for case in cases["vertices"]:
        Z, center = build(case), np.array(case["c"], float)
        flat = 0 in sets.strips(Z)[1]
        for v in np.array(case["vertices"], float):
            if "A" in case:  # vertices of a part of the zonotope
                assert margin(Z, v) >= 0
                continue
            assert margin(Z, v) == 0 and margin(Z, center + (v - center) * (1 + 1e-9)) < 0
            assert flat or margin(Z, center + (v - center) * (1 - 1e-9)) > 0


@each_mode
def test_published_supports_are_bounded_tightly(mode, cases):
    asked = [(build(case), np.array(case["direction"], float)) for case in cases["support"]]
    for case, found in zip(cases["support"], run(mode, sets.support, *asked), strict=True):
        assert case["value"] <= float(found) <= case["value"] + 1e-13


@pytest.mark.parametrize(
    "mode", [pytest.param(m, marks=pytest.mark.long) if m == "jit" else m for m in MODES]
)  # "eager" is compiled too
def test_published_corners_of_a_set_with_constraints_are_as_far_as_it_reaches(mode, cases):
    (case,) = (c for c in cases["vertices"] if "A" in c)
    Z = sets.constrained_zonotope(*(np.array(case[k], float) for k in ("c", "G", "A", "b")))
    directions = np.array([[1, 0], [0, -1], [2, 1], [-3, 2]], float)
    for d, found in zip(directions, run(mode, sets.support, *((Z, d) for d in directions)), strict=True):
        assert 0 <= float(found) - (np.array(case["vertices"]) @ d).max() <= 1e-9


def test_published_norms_are_those_of_the_vertices_of_the_strips(cases):
    for case in cases["norm2"]:
        assert abs(np.linalg.norm(polytope(build(case)), axis=1).max() - case["norm"]) < 1e-12


def test_published_diameters_are_those_of_the_hull(cases):
    for case in cases["diameter2"]:
        assert abs(np.linalg.norm(build(case).hull().wid) - case["diameter"]) < 1e-12


def test_parallel_generators_merge_into_the_same_strips(cases):
    for case in cases["merge_parallel"]:
        ours, theirs = (sets.strips(build({"G": case[name]})) for name in ("G", "G_merged"))
        rows = [{(*map(float, n), float(w)) for n, w in zip(*each, strict=True)} for each in (ours, theirs)]
        assert rows[0] == rows[1]


@each_mode
def test_parallel_generators_merge_into_sets_that_reach_as_far(mode, cases):
    asked = [padded({"G": c[k]}, 3, 8) for c in cases["merge_parallel"] for k in ("G", "G_merged")]
    directions = np.array([[1, 2, -3], [-2, 1, 1]], float)
    found = [[float(x) for x in run(mode, sets.support, *((Z, d) for Z in asked))] for d in directions]
    assert np.abs(np.subtract(*np.reshape(found, (2, -1, 2)).transpose(2, 0, 1))).max() < 1e-12


@each_mode
def test_published_linear_maps_are_enclosed_tightly(mode, cases):
    asked = [(np.eye(2)[:, : len(c["M"])] @ np.array(c["M"], float), build(c)) for c in cases["linear_map"]]
    for case, found in zip(cases["linear_map"], run(mode, sets.linear_map, *asked), strict=True):
        reaches_as_far(found, case["c_out"], case["G_out"], len(case["c_out"]))


@each_mode
def test_published_minkowski_sums_are_enclosed_tightly(mode, cases):
    asked = [(build(c["Z1"]), build(c["Z2"])) for c in cases["minkowski_sum"]]
    for case, found in zip(cases["minkowski_sum"], run(mode, sets.minkowski_sum, *asked), strict=True):
        reaches_as_far(found, case["result"]["c"], case["result"]["G"], 2)


def test_published_pairs_meet_when_one_center_is_in_the_sum_of_the_other(cases):
    for case in cases["intersects"]:
        Z1, Z2 = case["Z1"], case["Z2"]
        m = margin(factory(np.array(Z1["c"], float), np.hstack([Z1["G"], Z2["G"]]) * 1.0), Z2["c"])
        assert (
            (m > 0) == case["meet"]
            and (m < 0) == (not case["meet"])
            and abs(1 - m - case["scale_to_touch"]) < 1e-12
        )


def test_published_inclusions_hold_strip_by_strip(cases):
    for case in cases["zonotope_in"]:
        outer, inner = build(case["outer"]), build(case["inner"])
        normals, widths = sets.strips(outer)
        reach = abs(normals @ (np.asarray(inner.center) - np.asarray(outer.center))) + widths_along(
            inner, normals
        )
        assert (reach <= widths + 1e-12).all() == case["inside"]


def test_published_minkowski_differences_follow_from_the_strips(cases):
    for case in cases["minkowski_difference"]:
        Z1, Z2 = (build({"G": case[k]}) for k in ("G1", "G2"))
        normals, widths = sets.strips(Z1)
        left = widths - widths_along(Z2, normals)
        assert (left < -1e-12).any() if case["result"] == "empty" else (abs(left) < 1e-12).all()
