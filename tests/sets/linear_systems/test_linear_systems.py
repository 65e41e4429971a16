"""Interval linear systems: every box holds every solution; published enclosures are reproduced; no false
proof.
"""

import json
from fractions import Fraction

import jax
import numpy as np
import pytest

import jaxbound as jb
from jaxbound.sets.linear_systems.solve import BLOCK, Solvability, _solve, solve_interval

TABLE = {"gauss": "gauss", "gauss_seidel": "gs", "krawczyk": "krawczyk", "hbr": "hbr"}
COUNT = 64  # systems in a batch: one compilation for all tests of a method


@pytest.fixture(scope="module")
def published(shared):
    """Return the published systems."""
    return json.loads(shared("external/interval_linear.json").read_text())["systems"]


def _batch(systems):
    """Return COUNT systems of one size, the given ones again and again."""
    pick = np.resize(np.arange(len(systems)), COUNT)
    A, b = (np.array([s[key] for s in systems], float)[pick] for key in ("A", "b"))
    return jb.interval(A[..., 0], A[..., 1]), jb.interval(b[..., 0], b[..., 1])


def _compare(systems, method, precondition):
    """Check published systems of one size; return how many table values were compared."""
    found, compared = solve_interval(*_batch(systems), method, precondition=precondition), 0
    key = TABLE.get(method, "") + {"midpoint": "_midprecond", "none": "_noprecond"}[precondition]
    for k, s in enumerate(systems):
        box, status = np.stack([found.x.lo[k], found.x.hi[k]], -1), int(found.status[k])
        hull = np.array(s["computed"]["hull_LP"])
        room = 1e-8 * (1 + np.abs(np.where(np.isfinite(hull), hull, 0)))
        assert status != Solvability.INFEASIBLE
        assert (box[:, 0] <= hull[:, 0] + room[:, 0]).all() and (
            box[:, 1] >= hull[:, 1] - room[:, 1]
        ).all(), (s["name"], method)
        assert (status == Solvability.SOLVED) == bool(np.isfinite(box).all())
        if status != Solvability.SOLVED:
            continue
        if method == "hull":
            np.testing.assert_allclose(box, hull, rtol=1e-7, atol=1e-7)
        stated = s["computed"].get(key)
        stated = None if stated is None else np.array(stated)
        if stated is not None and method in ("gauss", "hbr"):
            np.testing.assert_allclose(box, stated, rtol=1e-6, atol=2e-6)
        if stated is not None:
            room = 2e-6 + 2e-3 * np.abs(stated)
            assert (box[:, 0] >= (stated - room)[:, 0]).all() and (box[:, 1] <= (stated + room)[:, 1]).all()
            compared += 1
    return compared


def _of_size(systems, n):
    return [s for s in systems if len(s["A"]) == n]


def test_published_2x2_systems_are_reproduced(published):
    assert sum(_compare(_of_size(published, 2), method, "midpoint") for method in ("gauss", "hbr")) == 8


@pytest.mark.parametrize("method", ["krawczyk", "gauss_seidel", "hull"])
def test_published_2x2_systems_are_no_wider_by_the_slower_methods(published, method):
    assert _compare(_of_size(published, 2), method, "midpoint") == (method != "hull") * 4


@pytest.mark.long(by_day="test_published_2x2_systems_are_reproduced")
@pytest.mark.parametrize("precondition", ["midpoint", "none"])
@pytest.mark.parametrize("n", [2, 3, 4])
def test_all_published_systems_are_reproduced(published, n, precondition):
    compared = sum(
        _compare(_of_size(published, n), method, precondition) for method in (*TABLE, "intersection", "hull")
    )
    assert compared >= {2: 10, 3: 3, 4: 2}[n]


@pytest.mark.parametrize(
    "methods",
    [{"gauss": "G", "hbr": "HBR"}, {"gauss_seidel": "GS", "krawczyk": "K"}],
    ids=["once", "repeated"],
)
def test_the_window_of_golden_is_reproduced_or_narrowed(shared, methods):
    g = json.loads(shared("golden/alhajdibo2004_multimodel.json").read_text())["p4_golden_window"]
    M = stacked_2004()
    h = jb.interval(np.array(g["H_lo"]), np.array(g["H_hi"]))
    rows = np.array(
        [np.array(step["rows_1based"]) - 1 for step in g["steps"]]
    )  # four square systems, one batch
    for method, key in methods.items():
        found = solve_interval(M[rows], h[rows], method)
        assert (found.status == Solvability.SOLVED).all()  # all four regular, proved
        stated = np.array([step[key] for step in g["steps"]])
        box = np.stack([found.x.lo, found.x.hi], -1)
        if method in ("gauss", "hbr"):
            np.testing.assert_allclose(box, stated, atol=1e-7)
        assert (box[..., 0] >= stated[..., 0] - 1e-7).all() and (box[..., 1] <= stated[..., 1] + 1e-7).all()


def stacked_2004():
    """Return the 12 x 9 matrix of section 5 of Alhaj-Dibo, Maquin, Ragot 2004, s = 2."""
    A = jb.interval(
        [[0.45, -0.29, 0.19], [-0.084, 0.66, -0.08], [0.12, 0.114, 0.37]],
        [[0.45, -0.29, 0.21], [-0.076, 0.66, -0.08], [0.12, 0.126, 0.37]],
    )
    C = jb.interval([[-5.25, -1.576, 1.2], [0.949, 0.2, -5]], [[-5.25, -1.423, 1.2], [1.051, 0.2, -5]])
    out = []
    for part in ("lo", "hi"):
        M = np.zeros((12, 9))
        for j in range(3):
            M[6 + 2 * j : 8 + 2 * j, 3 * j : 3 * j + 3] = getattr(C, part)
            if j < 2:
                M[3 * j : 3 * j + 3, 3 * j : 3 * j + 3], M[3 * j : 3 * j + 3, 3 * j + 3 : 3 * j + 6] = (
                    getattr(A, part),
                    -np.eye(3),
                )
        out.append(M)
    return jb.interval(*out)


def _random_systems(rng, count, n, rows=None, dtype=np.float64):
    width = rng.uniform(0.001, 0.2, (count, 1, 1))
    A = np.concatenate([np.eye(n)] * 2)[: rows or n] * 3 + rng.normal(size=(count, rows or n, n))
    R, b = np.abs(A) * width * rng.uniform(0, 1, A.shape), rng.normal(size=(count, rows or n))
    r = np.abs(b) * width[..., 0]
    return jb.interval((A - R).astype(dtype), (A + R).astype(dtype)), jb.interval(
        (b - r).astype(dtype), (b + r).astype(dtype)
    )


def _draw(rng, X, vertex):
    lo, hi = np.asarray(X.lo, float), np.asarray(X.hi, float)
    return np.where(rng.random(lo.shape) < 0.5, lo, hi) if vertex else lo + rng.random(lo.shape) * (hi - lo)


def _misses(rng, M, h, x, draws, slack=1e-11):
    """Count solutions of drawn systems that lie outside; they are known to about 1e-12, hence the slack."""
    missed = 0
    for d in range(draws):
        solution = np.linalg.solve(_draw(rng, M, d % 2), _draw(rng, h, d % 2)[..., None])[..., 0]
        slip = slack * (1 + np.abs(solution).max(-1, keepdims=True)) ** 2
        missed += int(
            ((solution < np.asarray(x.lo) - slip) | (solution > np.asarray(x.hi) + slip)).any(-1).sum()
        )
    return missed


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_random_systems_are_enclosed(rng, dtype):
    M, h = _random_systems(rng, COUNT, 2, dtype=dtype)
    found = solve_interval(M, h, "gauss")
    assert found.x.dtype == dtype and (found.status != Solvability.INFEASIBLE).all()
    assert (found.status == Solvability.SOLVED).mean() > 0.5
    assert _misses(rng, M, h, found.x, 50) == 0


def _vertex_misses(M, h, x):
    """Count solutions with all of M and h at their ends, every combination for 2 unknowns."""
    missed = 0
    for bits in np.ndindex(*[2] * 6):
        end = lambda X, b: np.where(
            np.array(b).reshape(X.shape[1:]), np.asarray(X.hi, float), np.asarray(X.lo, float)
        )
        solution = np.linalg.solve(end(M, bits[:4]), end(h, bits[4:])[..., None])[..., 0]
        slip = 1e-11 * (1 + np.abs(solution).max(-1, keepdims=True)) ** 2
        missed += int(
            ((solution < np.asarray(x.lo) - slip) | (solution > np.asarray(x.hi) + slip)).any(-1).sum()
        )
    return missed


def test_solutions_at_every_combination_of_ends_are_enclosed(rng):
    M, h = _random_systems(rng, COUNT, 2)
    for method in ("gauss", "hbr"):
        assert _vertex_misses(M, h, solve_interval(M, h, method).x) == 0


@pytest.mark.long(by_day="test_random_systems_are_enclosed")
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("n", range(2, 13))
def test_twenty_thousand_random_systems_are_enclosed(rng, dtype, n):
    """The intersection lies in what Gauss and Hansen-Bliek-Rohn give, so that its solutions lie in theirs."""
    M, h = _random_systems(rng, 910, n, dtype=dtype)
    found = solve_interval(M, h, "intersection")
    assert (found.status != Solvability.INFEASIBLE).all()
    assert (found.status == Solvability.SOLVED).mean() > 0.3
    assert _misses(rng, M, h, found.x, 40) == 0
    if n == 2:
        assert _vertex_misses(M, h, found.x) == 0


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_point_systems_enclose_the_exact_rational_solution(rng, dtype):
    M, h = rng.normal(size=(COUNT, 2, 2)).astype(dtype), rng.normal(size=(COUNT, 2)).astype(dtype)
    found = solve_interval(M, h, "gauss")
    solved = np.asarray(found.status) == Solvability.SOLVED
    assert solved.mean() > 0.9
    for k in np.flatnonzero(solved):
        (a, b), (c, d) = [[Fraction(float(v)) for v in row] for row in M[k]]
        e, f = (Fraction(float(v)) for v in h[k])
        for i, x in enumerate(((e * d - b * f) / (a * d - b * c), (a * f - e * c) / (a * d - b * c))):
            assert Fraction(float(found.x.lo[k, i])) <= x <= Fraction(float(found.x.hi[k, i]))
    width = np.asarray(found.x.wid)[solved]
    assert np.median(width) < 1e3 * np.finfo(dtype).eps


def test_many_systems_are_solved_like_few_and_stay_in_order(rng):
    """Blocks, of which the last overlaps with the one before it, change nothing."""
    M, h = _random_systems(rng, 2 * BLOCK + 5, 2)
    many = solve_interval(M, h, "gauss", precondition="none")
    assert many.x.shape == (2 * BLOCK + 5, 2)
    across = slice(BLOCK - COUNT // 2, BLOCK + COUNT // 2)
    few = solve_interval(M[across], h[across], "gauss", precondition="none")
    np.testing.assert_allclose(few.x.lo, many.x.lo[across], rtol=1e-12)


def test_a_matrix_that_all_systems_share_is_prepared_once_and_gives_the_same(rng):
    M, h = _random_systems(rng, 2 * BLOCK + 5, 2)
    shared = solve_interval(M[3], h, "hbr")
    np.testing.assert_allclose(shared.x.hi[3], solve_interval(M[:4], h[:4], "hbr").x.hi[3], rtol=1e-12)
    assert (
        _misses(
            rng,
            jb.interval(*(np.broadcast_to(end, (len(h), 2, 2)) for end in (M.lo[3], M.hi[3]))),
            h,
            shared.x,
            20,
        )
        == 0
    )


def test_a_matrix_that_may_be_singular_gets_a_status_and_no_box():
    _check_singular(["gauss", "hbr"])


def test_a_matrix_that_may_be_singular_gets_a_status_and_no_box_by_the_slower_methods():
    _check_singular(["krawczyk", "hull"])


def _check_singular(methods):
    ends = (
        {"A": [[[-1, 3], [1, 1]], [[1, 1], [1, 1]]], "b": [[1, 1], [1, 1]]},
        {"A": [[[0, 0]] * 2] * 2, "b": [[1, 1], [1, 1]]},
    )
    for method in methods:
        found = solve_interval(*_batch(ends), method)
        assert (found.status == Solvability.NOT_REGULAR).all()
        assert (found.x.lo == -np.inf).all() and (found.x.hi == np.inf).all()


def _overdetermined(rng):
    """Return M, h of 4 rows and 2 unknowns, solutions, and h with a last row that contradicts the others."""
    M, _ = _random_systems(rng, COUNT, 2, rows=4)
    x = rng.normal(size=(COUNT, 2))
    product = (np.asarray(M.mid) @ x[..., None])[..., 0]
    spread = 1e-9 + np.abs(product) * 0.01
    right = jb.interval(product - spread, product + spread)
    return M, right, x, jb.interval(right.lo.at[:, 3].add(50.0), right.hi.at[:, 3].add(50.0))


def test_more_rows_than_unknowns_hold_at_once_and_a_contradiction_is_a_proof(rng):
    M, right, x, shifted = _overdetermined(rng)
    found = solve_interval(M, right, "gauss")
    assert (found.status != Solvability.INFEASIBLE).all()
    assert ((found.x.lo <= x) & (x <= found.x.hi)).all()
    assert (solve_interval(M, shifted, "gauss").status == Solvability.INFEASIBLE).mean() > 0.8


@pytest.mark.long(by_day="test_more_rows_than_unknowns_hold_at_once_and_a_contradiction_is_a_proof")
def test_the_hull_of_more_rows_than_unknowns_is_narrower(rng):
    M, right, x, shifted = _overdetermined(rng)
    found = solve_interval(M, right, "hull")
    assert ((found.x.lo <= x) & (x <= found.x.hi)).all()
    assert (found.x.wid <= solve_interval(M, right, "hbr").x.wid * (1 + 1e-9)).all()
    assert (solve_interval(M, shifted, "hull").status == Solvability.INFEASIBLE).mean() > 0.8


def test_a_start_box_asks_for_the_solutions_inside():
    M, h = _batch([{"A": [[[2, 2], [0, 0]], [[0, 0], [2, 2]]], "b": [[2, 2], [2, 2]]}])
    assert (
        solve_interval(M, h, "hbr", x0=jb.interval([0.0, 0.0], [3.0, 3.0])).status == Solvability.SOLVED
    ).all()
    assert (
        solve_interval(M, h, "hbr", x0=jb.interval([2.0, 0.0], [3.0, 3.0])).status == Solvability.INFEASIBLE
    ).all()


@pytest.mark.compiled
def test_a_second_call_does_not_trace(rng):
    solve_interval(*_random_systems(rng, COUNT, 2), "hbr")
    before = _solve._cache_size()
    solve_interval(*_random_systems(rng, COUNT, 2), "hbr")
    assert _solve._cache_size() == before


@pytest.mark.long(by_day="test_random_systems_are_enclosed")
def test_eager_boxes_hold_the_solutions(rng):
    M, h = _random_systems(rng, 3, 2)
    with jax.disable_jit():
        found = solve_interval(M, h, "gauss")
    assert _misses(rng, M, h, found.x, 20) == 0


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: solve_interval(np.eye(2), np.ones(3)), "the shapes are"),
        (lambda: solve_interval(np.ones((1, 2)), np.ones(1)), "at least as many rows"),
        (lambda: solve_interval(np.eye(2), np.ones(2), "lu"), "method must be one of"),
        (lambda: solve_interval(np.eye(2), np.ones(2), precondition="best"), "precondition must be one of"),
        (
            lambda: solve_interval(np.ones((3, 2)), np.ones(3), precondition="none"),
            "needs precondition='midpoint'",
        ),
        (lambda: solve_interval(np.eye(9), np.ones(9), "hull"), "at most 8 unknowns"),
        (lambda: solve_interval(np.eye(2), np.ones(2), x0=jb.interval(np.ones(3))), "x0 needs one interval"),
        (lambda: solve_interval(np.eye(2) * np.nan, np.ones(2)), "not NaN"),
    ],
)
def test_bad_input_gets_a_sentence(call, says):
    with pytest.raises(ValueError, match=says):
        call()


def test_an_infinite_entry_gives_no_box():
    M, h = _batch([{"A": [[[1, np.inf], [0, 0]], [[0, 0], [1, 1]]], "b": [[1, 1], [1, 1]]}])
    for method in ("gauss", "hbr"):
        assert (solve_interval(M, h, method).status == Solvability.NOT_REGULAR).all()


@pytest.mark.parametrize("size", [1e-300, 1e-160, 1e160, 1e300])
def test_overflow_and_underflow_widen_the_box(size):
    """x = (1, 1) solves every system, whatever its scale."""
    a = size * np.array([[1.5, 1.0], [0.5, 2.0]])
    M, h = _batch([{"A": np.stack([a, a], -1), "b": np.stack([a.sum(1) * 0.999, a.sum(1) * 1.001], -1)}])
    for method, precondition in (("gauss", "midpoint"), ("hbr", "midpoint"), ("gauss", "none")):
        found = solve_interval(M, h, method, precondition=precondition)
        assert (found.status != Solvability.INFEASIBLE).all()
        assert ((found.x.lo <= 1) & (found.x.hi >= 1)).all()
