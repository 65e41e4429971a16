"""Zonotope facts that others published."""

import json

import jax
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from zonotope_cases import build, margin, polytope, widths_along

from jaxbound import sets
from jaxbound.sets import zonotope as factory

KINDS = ["point_in", "interval_hull", "volume", "vertices", "support", "norm2", "diameter2", "merge_parallel", "linear_map",
         "minkowski_sum", "intersects", "zonotope_in", "minkowski_difference"]  # fmt: skip


@pytest.fixture(scope="module")
def cases(shared):
    """Return the published cases by kind."""
    by_kind = {}
    for case in json.loads(shared("external/zonotope_cases.json").read_text()):
        by_kind.setdefault(case["kind"], []).append(case)
    return by_kind


support = jax.jit(sets.support)


# published cases


def test_every_published_case_is_of_a_kind_tested_here(cases):
    assert sorted(cases) == sorted(KINDS) and sum(map(len, cases.values())) == 32


def test_published_points_are_in_or_out_with_the_published_gauge(cases):
    for case in cases["point_in"]:
        m = margin(build(case), case["point"])
        assert m >= 0 if case["inside"] else m < 0
        assert abs(1 - m - case["min_inf_norm"]) < 1e-12


def test_published_interval_hulls_are_enclosed_tightly(cases):
    for case in cases["interval_hull"]:
        box = build(case).hull()
        assert (box.lo <= np.array(case["lo"])).all() and (np.array(case["hi"]) <= box.hi).all()
        assert (box.lo >= np.array(case["lo"]) - 1e-14).all() and (box.hi <= np.array(case["hi"]) + 1e-14).all()


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


def test_published_supports_are_bounded_tightly(cases):
    for case in cases["support"]:
        assert case["value"] <= float(sets.support(build(case), case["direction"])) <= case["value"] + 1e-13


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


def test_the_support_of_a_published_linear_map_is_that_of_its_result(rng, cases):
    for case in cases["linear_map"]:
        Z, out = build(case), factory(np.array(case["c_out"], float), np.array(case["G_out"], float))
        for d in rng.integers(-5, 6, (5, len(case["c_out"]))):
            assert abs(support(Z, np.array(case["M"]).T @ d * 1.0) - support(out, d * 1.0)) < 1e-12


def test_the_supports_of_a_published_minkowski_sum_add(rng, cases):
    for case in cases["minkowski_sum"]:
        Z1, Z2, out = (build(case[k]) for k in ("Z1", "Z2", "result"))
        for d in rng.integers(-5, 6, (5, 2)) * 1.0:
            assert abs(support(Z1, d) + support(Z2, d) - support(out, d)) < 1e-12


def test_published_pairs_meet_when_one_center_is_in_the_sum_of_the_other(cases):
    for case in cases["intersects"]:
        Z1, Z2 = case["Z1"], case["Z2"]
        m = margin(factory(np.array(Z1["c"], float), np.hstack([Z1["G"], Z2["G"]]) * 1.0), Z2["c"])
        assert (m > 0) == case["meet"] and (m < 0) == (not case["meet"]) and abs(1 - m - case["scale_to_touch"]) < 1e-12


def test_published_inclusions_hold_strip_by_strip(cases):
    for case in cases["zonotope_in"]:
        outer, inner = build(case["outer"]), build(case["inner"])
        normals, widths = sets.strips(outer)
        reach = abs(normals @ (np.asarray(inner.center) - np.asarray(outer.center))) + widths_along(inner, normals)
        assert (reach <= widths + 1e-12).all() == case["inside"]


def test_published_minkowski_differences_follow_from_the_strips(cases):
    for case in cases["minkowski_difference"]:
        Z1, Z2 = (build({"G": case[k]}) for k in ("G1", "G2"))
        normals, widths = sets.strips(Z1)
        left = widths - widths_along(Z2, normals)
        assert (left < -1e-12).any() if case["result"] == "empty" else (abs(left) < 1e-12).all()
