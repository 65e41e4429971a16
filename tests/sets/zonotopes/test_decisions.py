"""Decisions about zonotopes against linear programs and certificates in exact numbers."""

import json

import check_certificate
import numpy as np
import pytest
from zonotope_cases import FAR, KINDS, agree, build, degenerate, drawn, near, program

from jaxbound import sets
from jaxbound.sets import Answer, constrained_zonotope, contains, intersects, is_empty, separate, zonotope

SHAPES = [(2, 5), (5, 9)]


def points_near(rng, G, count):
    """Return (points, gauges): on rays drawn afresh, at factors near 1 of the boundary that a linear program
    finds.
    """
    d, t = rng.normal(size=(count, len(G))) @ np.diag(abs(G).sum(1)), near(rng, count)
    return np.array([v * f / program(G, v) for v, f in zip(d, t, strict=True)]), t


def wrong_and_open(rng, sizes, kinds, sets_each, points_each):
    wrong = left = 0
    for n, q in sizes:
        for kind in kinds:
            G = np.array([drawn(rng, n, q, kind) for _ in range(sets_each)])
            center = rng.normal(size=(sets_each, n))
            found = [points_near(rng, g, points_each) for g in G]
            points, t = (np.array(v) for v in zip(*found, strict=True))
            w, o = agree(contains(zonotope(center, G), center[:, None] + points), t, Answer.YES)
            wrong, left = wrong + w, left + o
    return wrong, left


def test_points_near_and_far_from_the_boundary_are_decided_as_by_linear_programs(rng):
    wrong, left = wrong_and_open(rng, SHAPES, KINDS, 3, 5)
    assert (wrong, left) == (0, 0)


def test_points_of_sets_with_many_rows_are_decided_as_by_linear_programs(rng):
    """Their equations are solved one by one, not side by side."""
    assert wrong_and_open(rng, [(70, 90)], ["general", "repeated"], 2, 2) == (0, 0)


@pytest.mark.long(by_day="test_points_near_and_far_from_the_boundary_are_decided_as_by_linear_programs")
def test_ten_thousand_points_are_decided_as_by_linear_programs(rng):
    wrong, left = wrong_and_open(
        rng, [(1, 3), (2, 5), (3, 8), (5, 9), (12, 24), (20, 40), (50, 100)], KINDS, 40, 9
    )
    print(f"10080 points: {wrong} wrong, {left} open")
    assert (
        wrong == 0 and left <= 3
    )  # lengths from 1e-3 to 1e3 in 20 dimensions: one in 50 000 was left open, 6e-8 from the boundary


def constrained(rng, n, q, k, t):
    """Return a constrained zonotope whose constraints can just be kept by max|x_i| = t."""
    A, b = rng.normal(size=(k, q)), rng.normal(size=k)
    return constrained_zonotope(rng.normal(size=n), rng.normal(size=(n, q)), A, b * t / program(A, b))


def stacked(each):
    return constrained_zonotope(
        *(np.array([getattr(C, f) for C in each]) for f in ("center", "generators", "constraints", "offsets"))
    )


def empty_and_open(rng, sizes, count):
    wrong = left = 0
    for n, q, k in sizes:
        t = near(rng, count)
        C = stacked([constrained(rng, n, q, k, factor) for factor in t])
        w, o = agree(is_empty(C), t, Answer.NO)
        wrong, left = wrong + w, left + o
    return wrong, left


def test_constrained_zonotopes_are_empty_where_linear_programs_say_so(rng):
    assert empty_and_open(rng, [(3, 12, 4), (20, 60, 20)], 12) == (0, 0)


@pytest.mark.long(by_day="test_constrained_zonotopes_are_empty_where_linear_programs_say_so")
def test_five_thousand_constrained_zonotopes_are_empty_where_linear_programs_say_so(rng):
    wrong, left = empty_and_open(rng, [(2, 6, 1), (3, 12, 4), (20, 60, 20)], 1700)
    print(f"5100 constrained zonotopes: {wrong} wrong, {left} open")
    assert (wrong, left) == (0, 0)


def test_two_sets_meet_where_a_linear_program_says_so_and_are_separated_where_not(rng):
    n, q, count = 5, 9, 24
    G = rng.normal(size=(2, count, n, q))
    t, shift = near(rng, count), rng.normal(size=(count, n))
    shift *= np.array([f / program(np.hstack([g, -h]), s) for f, g, h, s in zip(t, *G, shift, strict=True)])[
        :, None
    ]
    X, Y = zonotope(np.zeros((count, n)), G[0]), zonotope(shift, G[1])
    assert agree(intersects(X, Y), t, Answer.YES) == (0, 0)
    found = separate(X, Y)
    assert (found.apart.yes == (t > 1)).all() and (np.isnan(found.normal[:, 0]) == (t < 1)).all()
    reach = lambda normal, G: abs(normal @ G).sum()
    for i in np.nonzero(t > 1)[0]:
        normal, offset = found.normal[i], found.offset[i]
        assert reach(normal, G[0, i]) < offset < normal @ shift[i] - reach(normal, G[1, i])
    for i in np.nonzero(t < 1)[0]:
        assert max(program(G[0, i], found.point[i]), program(G[1, i], found.point[i] - shift[i])) <= 1 + FAR


@pytest.mark.parametrize(
    ("n", "q", "kind"), [(2, 5, "integer"), (2, 5, "repeated"), (5, 9, "general"), (5, 9, "uneven")]
)
def test_every_certificate_is_confirmed_by_fractions_alone(rng, n, q, kind):
    G = drawn(rng, n, q, kind)
    points, _ = points_near(rng, G, 6)
    Z, other = zonotope(np.zeros(n), G), zonotope(points[0] * 2, drawn(rng, n, q, kind))
    A = rng.normal(size=(2, q))
    C = constrained_zonotope(np.zeros(n), G, A, rng.normal(size=2) * 3)
    small = zonotope(points[0] * 0.1, G[:, :3] * 0.1)
    decisions = [
        contains(Z, points),
        intersects(Z, other),
        is_empty(C),
        contains(C, points),
        contains(Z, other),
        contains(Z, small),
        intersects(C, other),
    ]
    decided = [
        (decision, at)
        for decision in decisions
        for at in np.ndindex(decision.answer.shape)
        if decision.answer[at]
    ]
    print(len(decided), "answered")
    assert len(decided) > 5
    for decision, at in decided:
        check_certificate.confirm(json.loads(json.dumps(decision.certificate(at))))


def test_a_certificate_with_a_wrong_digit_or_the_other_answer_is_refused(rng):
    Z = zonotope([0.0, 0.0], rng.normal(size=(2, 5)))
    for point in ([0.1, 0.2], [30.0, 1.0]):
        document = contains(Z, point).certificate()
        other = {"YES": "NO", "NO": "YES"}[document["certificate"]]
        with pytest.raises((ValueError, LookupError)):
            check_certificate.confirm(document | {"certificate": other})
        moved = json.loads(json.dumps(document).replace('"point": ["', '"point": ["1'))
        with pytest.raises(ValueError):
            check_certificate.confirm(moved)


def test_points_on_the_boundary_are_decided_one_at_a_time(rng):
    for n, q in ((2, 5), (10, 20)):
        G = rng.integers(-4, 5, (n, q)) * 1.0
        vertex = np.where(rng.normal(size=n) @ G < 0, -1, 1) @ G.T
        Z = zonotope(np.zeros(n), G)
        outside = vertex * (1 + 2.0**-50)
        assert contains(Z, vertex).yes and contains(Z, outside).no
        assert contains(Z, np.array([vertex, 0 * vertex, outside * 2])).answer.tolist() in (
            [0, 1, -1],
            [1, 1, -1],
        )


def test_points_of_flat_sets_are_decided_one_at_a_time(rng):
    G = rng.integers(-4, 5, (4, 6)) * 1.0
    G[3] = G[0] - 2 * G[1]
    Z, x = zonotope(np.zeros(4), G), rng.integers(-2, 3, 6) / 4
    inside, beside, far = G @ x, G @ x + 2.0**-40 * np.eye(4)[3], G @ x * 100
    assert contains(Z, inside).yes and contains(Z, beside).no and contains(Z, far).no
    assert contains(Z, np.array([inside, inside + np.eye(4)[3], far])).answer.tolist() == [0, -1, -1]


def test_batches_of_points_and_of_sets_with_fewer_generators_than_equations_are_answered():
    line = zonotope(np.zeros(3), np.ones((3, 1)))
    assert contains(line, [[0.5, 0.5, 0.5], [1.0, 1.0, 1.0], [1.0, 0.0, 0.0]]).answer.tolist() == [0, 0, -1]
    sets_ = constrained_zonotope(
        np.zeros((2, 1)), np.ones((2, 1, 1)), np.ones((2, 3, 1)), [[0.5, 0.5, 0.5], [0.5, 0.5, 0.0]]
    )
    assert is_empty(sets_).answer.tolist() == [0, 1]


def test_repeated_constraints_are_decided_one_at_a_time():
    for b, empty in ((1.0, False), (2.0, False), (2.5, True)):
        assert bool(is_empty(constrained_zonotope([0.0], [[1.0, 0.0]], [[1.0, 1.0]] * 2, [b, b]))) == empty
    assert is_empty(constrained_zonotope([0.0], [[1.0, 0.0]], [[1.0, 1.0]] * 2, [1.0, 1.0 + 2.0**-40])).yes


def test_a_set_without_generators_holds_its_center_alone():
    Z = zonotope([1.0, 2.0], np.zeros((2, 0)))
    assert contains(Z, [1.0, 2.0]).yes and contains(Z, [1.0, 2.5]).no
    assert contains(Z, np.array([[1.0, 2.0], [1.0, 2.5]])).answer.tolist() == [1, -1]


def test_a_set_without_constraints_is_not_empty_and_one_that_is_holds_nothing():
    assert is_empty(zonotope([0.0], [[1.0]])).no
    nothing = constrained_zonotope([0.0], [[1.0, 0.0]], [[1.0, 1.0]], [3.0])
    assert (
        is_empty(nothing).yes
        and contains(nothing, [0.0]).no
        and intersects(nothing, zonotope([0.0], [[9.0]])).no
    )


def test_a_batch_gives_the_answers_of_its_sets_one_by_one(rng):
    center, G = rng.normal(size=(2, 3, 4)), rng.normal(size=(2, 3, 4, 7))
    points = rng.normal(size=(2, 3, 5, 4)) * 2
    together = contains(zonotope(center, G), points)
    assert together.answer.shape == (2, 3, 5)
    for at in np.ndindex(2, 3):
        assert (contains(zonotope(center[at], G[at]), points[at]).answer == together.answer[at]).all()


def test_float32_sets_and_points_are_decided(rng):
    G = rng.normal(size=(5, 9)).astype(np.float32)
    points, t = points_near(rng, G.astype(float), 12)
    assert agree(contains(zonotope(np.zeros(5, np.float32), G), points), t, Answer.YES) == (0, 0)


def test_rows_of_very_different_units_are_decided(rng):
    units = 10.0 ** np.array([-200, -3, 0, 5, 250])
    G = rng.normal(size=(5, 9))
    points, t = points_near(rng, G, 12)
    assert agree(contains(zonotope(np.zeros(5), G * units[:, None]), points * units), t, Answer.YES) == (0, 0)


def test_points_beyond_the_range_of_floats_are_never_inside():
    Z = zonotope([-1e308, 0.0], [[1.0, 0.0], [0.0, 1.0]])
    assert not contains(Z, np.array([[1.7e308, 0.0], [0.0, 0.0]])).yes.any()


# a set in a set


def test_a_zonotope_shrunk_is_held_and_one_that_reaches_out_is_not(rng):
    for n, q in ((2, 5), (12, 24)):
        G, M = rng.normal(size=(n, q)), rng.normal(size=(q, 6))
        M /= abs(M).sum(1, keepdims=True)  # rows add up to 1: G M is held
        Z = zonotope(np.zeros(n), G)
        assert contains(Z, zonotope(np.zeros(n), G @ M * 0.999)).yes
        vertex = np.sign(rng.normal(size=n) @ G) @ G.T
        assert contains(Z, zonotope(vertex * 0.75, np.c_[vertex * 0.26, G[:, 0] * 0.001])).no


def test_few_facets_decide_containment_in_exact_numbers(rng):
    for trial in range(12):
        G = degenerate(rng, 3, 5) * 1.0
        Z = zonotope(np.zeros(3), G)
        inner = zonotope(np.zeros(3), G @ rng.integers(-1, 2, (5, 4)) * 2.0 ** -rng.integers(0, 3))
        normals, widths = sets.strips(Z)
        reach, size = abs(normals @ np.asarray(inner.generators)).sum(1), 1 + abs(normals).sum(1)
        answer = contains(Z, inner)
        assert answer.yes | answer.no
        if (abs(reach - widths) > 1e-12 * size).all():
            assert answer.yes == (reach <= widths).all(), trial


def test_a_zonotope_is_held_by_a_constrained_one_and_not_by_one_that_is_smaller():
    C = constrained_zonotope([0.0, 0.0], [[1.0, 0.0, 0.5], [0.0, 1.0, 0.25]], [[1.0, 1.0, 1.0]], [0.5])
    assert contains(C, zonotope([0.25, 0.25], [[0.05, 0.0], [0.0, 0.05]])).yes
    assert contains(C, zonotope([0.25, 0.25], [[2.0, 0.0], [0.0, 0.05]])).no


# published cases


@pytest.fixture(scope="module")
def cases(shared):
    return json.loads(shared("external/zonotope_cases.json").read_text())


def test_published_points_pairs_and_inclusions_are_decided_as_published(cases):
    count = 0
    for case in cases:
        if case["kind"] == "point_in":
            answer, expected = contains(build(case), np.array(case["point"], float)), case["inside"]
        elif case["kind"] == "intersects":
            answer, expected = intersects(build(case["Z1"]), build(case["Z2"])), case["meet"]
        elif case["kind"] == "zonotope_in":
            answer, expected = contains(build(case["outer"]), build(case["inner"])), case["inside"]
        else:
            continue
        assert bool(answer) == expected
        check_certificate.confirm(answer.certificate())
        count += 1
    assert count == 10


# doors


def test_a_decision_is_true_or_false_only_where_it_is_one_and_proved():
    Z = zonotope([0.0, 0.0], [[1.0, 0.0], [0.0, 1.0]])
    assert contains(Z, [0.5, 0.5]) and not contains(Z, [2.0, 0.0])
    with pytest.raises(ValueError, match="neither yes nor no"):
        bool(contains(Z, [[0.5, 0.5], [2.0, 0.0]]))


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([0.0], r"shape \(\.\.\., 2\): their shape is \(1,\)"),
        ([[np.nan, 0.0]], r"1 of 2 entries are not, first at \(0, 0\)"),
    ],
)
def test_contains_refuses_points_that_do_not_fit(points, message):
    with pytest.raises(ValueError, match=message):
        contains(zonotope([0.0, 0.0], np.eye(2)), points)


def test_sets_that_do_not_fit_are_refused_in_one_sentence():
    Z = zonotope([0.0], [[1.0]])
    with pytest.raises(ValueError, match="one dimension: they have 1 and 2"):
        intersects(Z, zonotope([0.0, 0.0], np.eye(2)))
    with pytest.raises(ValueError, match="inner set must be a zonotope"):
        contains(Z, constrained_zonotope([0.0], [[1.0]], [[1.0]], [0.0]))
    with pytest.raises(TypeError, match="constrained zonotope is needed: this is list"):
        is_empty([0.0])
    with pytest.raises(TypeError, match="zonotope is needed: this is int"):
        contains(3, 4)


def test_an_undecided_answer_has_no_certificate():
    Z = zonotope([0.0, 0.0], [[1.0], [1.0]])
    with pytest.raises(ValueError, match="UNDECIDED"):
        contains(Z, np.array([[0.5, 0.5], [0.1, 0.1]])).certificate(0)


# what is no number


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("field", range(4), ids=["center", "generators", "constraints", "offsets"])
def test_a_set_with_a_number_that_is_none_decides_nothing_and_its_neighbours_everything(bad, field):
    arrays = [np.zeros((2, 2)), np.ones((2, 1, 1)) * np.eye(2, 3), np.ones((2, 1, 3)), np.full((2, 1), 0.5)]
    arrays[field][(0,) * arrays[field].ndim] = bad
    C, other = sets.ConstrainedZonotope(*arrays), zonotope(np.zeros((2, 2)), np.full((2, 2, 1), 0.1))
    one = sets.ConstrainedZonotope(*(v[0] for v in arrays))
    assert is_empty(C).answer.tolist() == [0, -1] and intersects(C, other).answer.tolist() == [0, 1]
    assert (
        contains(C, np.zeros((2, 1, 2))).answer.tolist() == [[0], [1]]
        and contains(one, zonotope([0.0, 0.0], np.eye(2))).answer == 0
    )
    assert (
        is_empty(one).answer == 0
        and contains(one, [0.0, 0.0]).answer == 0
        and np.isnan(separate(one, one).point).all()
    )
    with pytest.raises(ValueError, match="neither yes nor no"):
        bool(contains(one, [0.0, 0.0]))
