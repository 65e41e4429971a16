"""Decisions inside jit and vmap: never another answer than outside, where linear programs and exact numbers
judge them; else UNDECIDED.
"""

import json
from fractions import Fraction

import jax
import numpy as np
import pytest
from zonotope_cases import each_dtype, padded, program

from jaxbound import sets
from jaxbound.sets import Zonotope, constrained_zonotope, contains, intersects, is_empty, separate, zonotope

N, Q, COUNT, MANY = 3, 6, 64, 300
"""Every question of COUNT sets is put as N equations of Q unknowns, and with vmap alone: then one compiled
search answers all of them.
"""
of_points, of_sets, together = jax.vmap(contains), jax.jit(jax.vmap(contains)), jax.jit(contains)


def points_of_one_set(Z, points):
    """Ask of as many points as every test here does, so that the question is compiled once."""
    return jax.tree.map(lambda x: np.asarray(x)[: len(points)], together(Z, np.resize(points, (MANY, N))))


def agree(inside, outside):
    """Return the share left open of answers that must be the same where given."""
    inside = np.asarray(inside)
    assert ((inside == outside.answer) | (inside == 0)).all()
    return (inside == 0).mean()


def drawn(rng, dtype, count=COUNT):
    """Return (centers, generators, points at known factors of the boundary, half of them far from it, the
    factors).
    """
    G = rng.normal(size=(count, N, Q)).astype(dtype)
    center, d = rng.normal(size=(count, N)).astype(dtype), rng.normal(size=(count, N))
    away = np.where(np.arange(count) % 2, rng.uniform(0.05, 0.9, count), 10.0 ** rng.uniform(-9, -3, count))
    t = 1 + rng.choice([-1, 1], count) * away
    points = (
        center
        + d * np.array([f / program(g.astype(float), v) for f, g, v in zip(t, G, d, strict=True)])[:, None]
    )
    return center, G, points.astype(dtype), t


@pytest.mark.parametrize("dtype", [pytest.param(np.float32, marks=pytest.mark.long), np.float64])
def test_points_are_decided_as_outside_of_jit(rng, dtype):
    center, G, points, t = drawn(rng, dtype)
    Z = zonotope(center, G)
    answer = of_points(Z, points[:, None]).answer
    far = np.abs(t - 1) > 0.01
    assert agree(answer, contains(Z, points[:, None])) <= (0 if dtype == np.float64 else 0.5)
    assert (np.asarray(answer)[far, 0] == np.where(t < 1, 1, -1)[far]).all()


@each_dtype
def test_points_of_one_set_are_decided_as_outside_of_jit(rng, dtype):
    center, G, points, _ = drawn(rng, dtype)
    one, many = zonotope(center[0], G[0]), np.resize(points, (MANY, N))
    assert agree(together(one, many).answer, contains(one, many)) <= 0.1


def test_margins_inside_jit_do_not_overstate(rng):
    center, G, points, t = drawn(rng, np.float64)
    found = of_points(zonotope(center, G), points[:, None])
    margin = np.asarray(found.margin)[:, 0]
    assert (np.sign(margin) == np.asarray(found.answer)[:, 0]).all() and (
        np.abs(margin) <= np.abs(1 - t) + 1e-9
    ).all()


@pytest.mark.parametrize("dtype", [pytest.param(np.float32, marks=pytest.mark.long), np.float64])
def test_emptiness_inside_jit_is_that_outside(rng, dtype):
    A, b = rng.normal(size=(COUNT, N, Q)), rng.normal(size=(COUNT, N))
    t = 1 + rng.choice([-1, 1], COUNT) * 10.0 ** rng.uniform(-6, -1, COUNT)
    b = b * np.array([f / program(a, v) for f, a, v in zip(t, A, b, strict=True)])[:, None]
    C = constrained_zonotope(
        *(v.astype(dtype) for v in (np.zeros((COUNT, 1)), rng.normal(size=(COUNT, 1, Q)), A, b))
    )
    answer, far = np.asarray(jax.vmap(is_empty)(C).answer), np.abs(t - 1) > 1e-3
    assert agree(answer, is_empty(C)) <= (0 if dtype == np.float64 else 0.5)
    assert (answer[far] == np.where(t > 1, 1, -1)[far]).all()


@pytest.mark.parametrize(
    "way", [pytest.param(jax.jit, marks=pytest.mark.long), lambda f: f], ids=["jit", "vmap"]
)
def test_two_sets_are_separated_inside_jit_as_outside(rng, way):
    G, H = (rng.normal(size=(COUNT, N, Q // 2)) for _ in range(2))
    shift = rng.normal(size=(COUNT, N))
    t = 1 + rng.choice([-1, 1], COUNT) * 10.0 ** rng.uniform(-6, 0, COUNT)
    shift *= np.array(
        [f / program(np.hstack([g, -h]), s) for f, g, h, s in zip(t, G, H, shift, strict=True)]
    )[:, None]
    X, Y = zonotope(np.zeros((COUNT, N)), G), zonotope(shift, H)
    found = way(jax.vmap(separate))(X, Y)
    assert agree(-found.apart.answer, intersects(X, Y)) == 0
    exact = lambda v: [Fraction(float(x)) for x in v]
    for i in np.nonzero(t > 1)[0]:
        l, offset = exact(found.normal[i]), Fraction(float(found.offset[i]))
        reach = lambda W, l=l: sum(abs(sum(a * b for a, b in zip(l, exact(g), strict=True))) for g in W.T)
        assert (
            reach(G[i]) < offset < sum(a * b for a, b in zip(l, exact(shift[i]), strict=True)) - reach(H[i])
        )
    assert (np.isnan(np.asarray(found.point)[:, 0]) == (t > 1)).all()


def test_a_segment_in_a_segment_is_decided_inside_jit():
    outer = zonotope(np.zeros((3, 1)), [[[1.0, 0.5]]] * 3)
    inner = zonotope([[0.25], [0.25], [0.5]], [[[0.5]], [[1.5]], [[1.0]]])
    assert of_sets(outer, inner).answer.tolist() == [1, -1, 0]  # the last touches an end


@pytest.mark.long(by_day="test_a_segment_in_a_segment_is_decided_inside_jit")
def test_a_zonotope_in_a_set_is_decided_inside_jit_as_outside(rng):
    G = rng.normal(size=(COUNT, N, Q))
    shape = rng.normal(size=(COUNT, Q, 4)) * rng.uniform(0.05, 0.4, (COUNT, 1, 1))
    outer, inner = zonotope(np.zeros((COUNT, N)), G), zonotope(0.1 * rng.normal(size=(COUNT, N)), G @ shape)
    outside = contains(outer, inner)
    inside = of_sets(outer, inner).answer
    assert agree(inside, outside) <= 0.3 and {-1, 1} <= set(np.asarray(inside).tolist())


def test_the_boundary_and_flat_sets_stay_open_inside_jit_and_what_is_clear_does_not():
    box, flat = zonotope(np.zeros(N), np.eye(N, Q)), zonotope(np.zeros(N), np.eye(N, Q) * [[1], [1], [0]])
    points = np.array([[1.0, 0, 0], [0.5, 0, 0], [0.5, 0, 1], [2, 0, 0]])
    assert points_of_one_set(box, points).answer.tolist() == [0, 1, 0, -1]
    assert points_of_one_set(flat, points).answer.tolist() == [0, 0, -1, -1]


def test_numbers_that_overflow_or_are_not_numbers_decide_nothing_inside_jit():
    box = zonotope(np.zeros(N), np.eye(N, Q))
    points = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [0.5, 0, 0], [0, 0, -np.inf], [9, np.nan, 0]])
    assert points_of_one_set(box, points).answer.tolist() == [0, 0, 1, 0, 0]
    for hole in (np.nan, np.inf):
        broken = Zonotope(box.center, box.generators.at[1, 1].set(hole))
        assert not np.any(np.asarray(together(broken, np.zeros((MANY, N))).answer))


def test_many_points_with_one_that_is_not_a_number_are_decided_but_for_it(rng):
    """Compiled maxima of many numbers overlook NaN."""
    center, G, points, _ = drawn(rng, np.float64, MANY)
    one = zonotope(center[0], G[0])
    points[7, 1] = np.nan
    answer = np.array(together(one, points).answer)
    points[7, 1] = 0
    assert answer[7] == 0 and (np.delete(answer, 7) == np.delete(contains(one, points).answer, 7)).all()


def test_points_of_float64_among_sets_of_float32_are_not_rounded(rng):
    with jax.enable_x64(False):
        box = zonotope(np.zeros(1, np.float32), np.ones((1, 1), np.float32))
        points = np.array([[1 + 2.0**-30], [1 - 2.0**-30], [0.5], [1.5]])
        assert jax.jit(lambda Z: contains(Z, points))(box).answer.tolist() == [0, 0, 1, -1]


def test_differences_below_the_smallest_number_are_not_taken_for_none(rng):
    tiny = np.finfo(float).smallest_subnormal
    Z = zonotope(np.zeros(N), np.zeros((N, Q)))
    points = np.array([[tiny, 0, 0], [0, 0, 0], [-1e-310, 0, 1e-310]])
    assert not np.any(np.asarray(points_of_one_set(Z, points).answer) == 1)


def test_a_decision_taken_inside_jit_says_why_it_has_no_certificate():
    found = jax.tree.map(
        lambda x: np.asarray(x)[0], together(zonotope(np.zeros(N), np.eye(N, Q)), np.zeros((MANY, N)))
    )
    assert found.yes and repr(found) == "Decision(YES, margin=1)"
    with pytest.raises(ValueError, match="inside jit or vmap keeps no sets: ask again outside"):
        found.certificate()


def test_decisions_are_trees_of_arrays():
    Z = zonotope(np.zeros(N), np.eye(N, Q))
    for thing in (contains(Z, np.zeros((2, N))), separate(Z, Z)):
        assert all(isinstance(leaf, np.ndarray | np.generic) for leaf in jax.tree.leaves(thing))


def test_margins_of_membership_inside_jit_are_those_outside(rng):
    center, G, points, t = drawn(rng, np.float64)
    inside = jax.vmap(sets.membership)(zonotope(center, G), points[:, None])[:, 0]
    assert np.abs(inside - (1 - t)).max() <= 1e-7 * np.abs(t).max()


def test_what_needs_concrete_numbers_says_so_inside_jit():
    Z = zonotope(np.zeros(2), np.eye(2))
    for call in (sets.vertices, sets.volume, sets.strips):
        with pytest.raises(TypeError, match="outside jit, grad and vmap"):
            jax.jit(call)(Z)


# published cases


@pytest.fixture(scope="module")
def cases(shared):
    return json.loads(shared("external/zonotope_cases.json").read_text())


def fill(rows):
    """Return a batch of COUNT, the rows over and over again."""
    return jax.tree.map(lambda *x: np.resize(np.stack(x), (COUNT, *x[0].shape)), *rows)


def published_points(cases):
    """Return (sets, points, gauges): published points, and published corners a hair inside and outside."""
    found = []
    for case in cases:
        if case["kind"] == "point_in":
            found.append((case, case["point"], case["min_inf_norm"]))
        if (
            case["kind"] == "vertices"
            and "A" not in case
            and np.linalg.matrix_rank(case["G"]) == len(case["G"])
        ):
            c = np.array(case["c"], float)
            found += [
                (case, c + t * (np.array(v) - c), t) for v in case["vertices"] for t in (1 - 1e-8, 1 + 1e-8)
            ]
    Z = [padded(case, N, Q, 1.0) for case, _, _ in found]
    return (
        Z,
        np.array([np.resize(np.append(p, 0.0), N) if len(p) < N else p for _, p, _ in found]),
        np.array([t for *_, t in found]),
    )


def test_published_points_and_corners_are_decided_under_jit_and_vmap(cases):
    Z, points, t = published_points(cases)
    expected = np.where(t == 1, 0, np.where(t < 1, 1, -1))  # the boundary stays open
    assert len(t) == 39 and (t == 1).sum() == 1
    assert (np.asarray(of_points(fill(Z), fill(points[:, None])).answer)[: len(t), 0] == expected).all()
    for i in (0, 3, len(t) - 1):  # all points, on one set
        mine = [j for j in range(len(t)) if np.array_equal(Z[j].generators, Z[i].generators)]
        assert (points_of_one_set(Z[i], points[mine]).answer == expected[mine]).all()


@pytest.mark.long(by_day="test_a_segment_in_a_segment_is_decided_inside_jit")
def test_published_inclusions_are_decided_under_vmap(cases):
    """The one that holds touches the boundary, which stays open: a thousandth smaller, it is decided."""
    asked = [
        (padded(c["outer"], N, Q, 1.0), padded(c["inner"], N, 4), c["inside"])
        for c in cases
        if c["kind"] == "zonotope_in"
    ]
    outer, inner, inside = zip(*asked, strict=True)
    smaller = Zonotope(inner[0].center, 0.999 * inner[0].generators)
    answer = np.asarray(of_sets(fill([*outer, outer[0]]), fill([*inner, smaller])).answer)
    assert inside == (True, False, False) and answer[:4].tolist() == [0, -1, -1, 1]


@pytest.mark.long(by_day="test_two_sets_are_separated_inside_jit_as_outside")
def test_published_pairs_meet_or_not_under_vmap(cases):
    asked = [
        (padded(c["Z1"], N, 3, 1.0), padded(c["Z2"], N, 3), c["meet"])
        for c in cases
        if c["kind"] == "intersects"
    ]
    X, Y, meet = zip(*asked, strict=True)
    assert np.asarray(jax.vmap(intersects)(fill(X), fill(Y)).answer)[:4].tolist() == [
        1 if x else -1 for x in meet
    ]


@pytest.mark.long(by_day="test_a_segment_in_a_segment_is_decided_inside_jit")
def test_an_observer_may_ask_in_a_scan():
    Z = zonotope([0.0], [[1.0]])

    def step(S, y):
        S = sets.linear_map([[0.5]], S)
        S = Zonotope(S.center, sets.reduce_order(S, 1).generators)
        return S, contains(S, y[None]).answer

    assert jax.lax.scan(step, Z, np.array([0.25, 0.1, 0.25]))[1].tolist() == [1, 1, -1]
