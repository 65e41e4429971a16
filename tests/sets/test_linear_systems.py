"""Interval linear systems: every box holds every solution; published enclosures are reproduced; no false proof."""

import json
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbound as jb
from jaxbound.sets.linear_systems import Solvability, _solve, solve_interval

METHODS = ("gauss", "gauss_seidel", "krawczyk", "hbr", "intersection")
TABLE = {"gauss": "gauss", "gauss_seidel": "gs", "krawczyk": "krawczyk", "hbr": "hbr"}


@pytest.fixture(scope="module")
def published(shared):
    """Return the published systems."""
    return json.loads(shared("external/interval_linear.json").read_text())["systems"]


def _system(s):
    A, b = np.array(s["A"], float), np.array(s["b"], float)
    return jb.interval(A[..., 0], A[..., 1]), jb.interval(b[..., 0], b[..., 1])


def _compare(s, method, precondition):
    """Check one published system; return whether a table value was compared."""
    found = solve_interval(*_system(s), method, precondition=precondition)
    lo, hi = np.asarray(found.x.lo), np.asarray(found.x.hi)
    hull = np.array(s["computed"]["hull_LP"])
    room = 1e-8 * (1 + np.abs(np.where(np.isfinite(hull), hull, 0)))
    assert found.status != Solvability.INFEASIBLE
    assert (lo <= hull[:, 0] + room[:, 0]).all() and (hi >= hull[:, 1] - room[:, 1]).all(), (s["name"], method)
    assert (found.status == Solvability.SOLVED) == bool(np.isfinite(lo).all() and np.isfinite(hi).all())
    if method == "hull" and found.status == Solvability.SOLVED:
        np.testing.assert_allclose(np.c_[lo, hi], hull, rtol=1e-7, atol=1e-7)
    key = TABLE.get(method, "") + {"midpoint": "_midprecond", "none": "_noprecond"}[precondition]
    stated = s["computed"].get(key)
    if stated is None or found.status != Solvability.SOLVED:
        return False
    np.testing.assert_allclose(np.c_[lo, hi], stated, rtol=2e-3 if "seidel" in method or method == "krawczyk" else 1e-6, atol=2e-6)
    return True


def test_published_2x2_systems_are_reproduced(published):
    small = [s for s in published if len(s["A"]) == 2]
    compared = [_compare(s, method, "midpoint") for s in small for method in ("gauss", "krawczyk", "hbr", "hull")]
    assert sum(compared) == 12


@pytest.mark.slow
@pytest.mark.parametrize("precondition", ["midpoint", "none"])
def test_all_published_systems_are_reproduced(published, precondition):
    compared = [_compare(s, method, precondition) for s in published for method in (*TABLE, "intersection", "hull")]
    assert sum(compared) >= 15


def test_the_window_of_golden_is_reproduced_by_every_method(shared):
    g = json.loads(shared("golden/alhajdibo2004_multimodel.json").read_text())["p4_golden_window"]
    M = stacked_2004()
    h = jb.interval(np.array(g["H_lo"]), np.array(g["H_hi"]))
    rows = np.array([np.array(step["rows_1based"]) - 1 for step in g["steps"]])  # four square systems, one batch
    for method, key in (("gauss", "G"), ("gauss_seidel", "GS"), ("krawczyk", "K"), ("hbr", "HBR")):
        found = solve_interval(M[rows], h[rows], method)
        assert (found.status == Solvability.SOLVED).all()  # all four regular, proved
        stated = np.array([step[key] for step in g["steps"]])
        np.testing.assert_allclose(np.stack([found.x.lo, found.x.hi], -1), stated, atol=1e-7)


def stacked_2004():
    """Return the 12 x 9 matrix of section 5 of Alhaj-Dibo, Maquin, Ragot 2004, s = 2."""
    A = jb.interval([[0.45, -0.29, 0.19], [-0.084, 0.66, -0.08], [0.12, 0.114, 0.37]], [[0.45, -0.29, 0.21], [-0.076, 0.66, -0.08], [0.12, 0.126, 0.37]])  # fmt: skip
    C = jb.interval([[-5.25, -1.576, 1.2], [0.949, 0.2, -5]], [[-5.25, -1.423, 1.2], [1.051, 0.2, -5]])
    out = []
    for part in ("lo", "hi"):
        M = np.zeros((12, 9))
        for j in range(3):
            M[6 + 2 * j : 8 + 2 * j, 3 * j : 3 * j + 3] = getattr(C, part)
            if j < 2:
                M[3 * j : 3 * j + 3, 3 * j : 3 * j + 3], M[3 * j : 3 * j + 3, 3 * j + 3 : 3 * j + 6] = getattr(A, part), -np.eye(3)
        out.append(M)
    return jb.interval(*out)


def _random_systems(rng, count, n, rows=None, dtype=np.float64):
    width = rng.uniform(0.001, 0.2, (count, 1, 1))
    A = np.concatenate([np.eye(n)] * 2)[: rows or n] * 3 + rng.normal(size=(count, rows or n, n))
    R, b = np.abs(A) * width * rng.uniform(0, 1, A.shape), rng.normal(size=(count, rows or n))
    r = np.abs(b) * width[..., 0]
    return jb.interval((A - R).astype(dtype), (A + R).astype(dtype)), jb.interval((b - r).astype(dtype), (b + r).astype(dtype))


def _draw(rng, X, vertex):
    lo, hi = np.asarray(X.lo, float), np.asarray(X.hi, float)
    return np.where(rng.random(lo.shape) < 0.5, lo, hi) if vertex else lo + rng.random(lo.shape) * (hi - lo)


def _misses(rng, M, h, x, draws, slack=1e-11):
    """Count solutions of drawn systems that lie outside; they are known to about 1e-12, hence the slack."""
    missed = 0
    for d in range(draws):
        solution = np.linalg.solve(_draw(rng, M, d % 2), _draw(rng, h, d % 2)[..., None])[..., 0]
        slip = slack * (1 + np.abs(solution).max(-1, keepdims=True)) ** 2
        missed += int(((solution < np.asarray(x.lo) - slip) | (solution > np.asarray(x.hi) + slip)).any(-1).sum())
    return missed


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_random_systems_are_enclosed(rng, dtype):
    M, h = _random_systems(rng, 1000, 3, dtype=dtype)
    found = solve_interval(M, h, "intersection")
    assert found.x.dtype == dtype and (found.status != Solvability.INFEASIBLE).all()
    assert (found.status == Solvability.SOLVED).mean() > 0.5
    assert _misses(rng, M, h, found.x, 20) == 0


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("n", [2, 4, 6, 9, 12])
def test_twenty_thousand_random_systems_are_enclosed(rng, dtype, n):
    M, h = _random_systems(rng, 2000, n, dtype=dtype)
    for method in METHODS:
        found = solve_interval(M, h, method)
        assert (found.status != Solvability.INFEASIBLE).all()
        assert _misses(rng, M, h, found.x, 10) == 0


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_point_systems_enclose_the_exact_rational_solution(rng, dtype):
    n = 3
    M, h = rng.normal(size=(50, n, n)).astype(dtype), rng.normal(size=(50, n)).astype(dtype)
    found = solve_interval(M, h, "intersection")
    solved = np.asarray(found.status) == Solvability.SOLVED
    assert solved.mean() > 0.9
    for k in np.flatnonzero(solved):
        for i, x in enumerate(_cramer([[Fraction(float(v)) for v in row] for row in M[k]], [Fraction(float(v)) for v in h[k]])):
            assert Fraction(float(found.x.lo[k, i])) <= x <= Fraction(float(found.x.hi[k, i]))
    width = np.asarray(found.x.wid)[solved]
    assert np.median(width) < 1e3 * np.finfo(dtype).eps


def _cramer(A, b):
    det = lambda m: sum(m[0][i] * (m[1][(i + 1) % 3] * m[2][(i + 2) % 3] - m[1][(i + 2) % 3] * m[2][(i + 1) % 3]) for i in range(3))
    return [det([[b[r] if c == i else A[r][c] for c in range(3)] for r in range(3)]) / det(A) for i in range(3)]


def test_a_matrix_that_may_be_singular_gets_a_status_and_no_box():
    M = jb.interval([[[-1.0, 1.0], [1.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]]], [[[3.0, 1.0], [1.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]]])
    for method in ("gauss", "krawczyk", "hbr", "hull"):
        found = solve_interval(M, np.ones((2, 2)), method)
        assert (found.status == Solvability.NOT_REGULAR).all()
        assert (found.x.lo == -np.inf).all() and (found.x.hi == np.inf).all()


def test_more_rows_than_unknowns_hold_at_once_and_a_contradiction_is_a_proof(rng):
    M, h = _random_systems(rng, 300, 2, rows=4)
    x = rng.normal(size=(300, 2))
    product = np.asarray(M.mid) @ x[..., None]
    spread = 1e-9 + np.abs(product[..., 0]) * 0.01
    right = jb.interval(product[..., 0] - spread, product[..., 0] + spread)
    for method in ("hbr", "hull"):
        found = solve_interval(M, right, method)
        assert (found.status != Solvability.INFEASIBLE).all()
        assert ((found.x.lo <= x) & (x <= found.x.hi)).all()
        shifted = jb.interval(right.lo.at[:, 3].add(50.0), right.hi.at[:, 3].add(50.0))
        assert (solve_interval(M, shifted, method).status == Solvability.INFEASIBLE).mean() > 0.9
    narrow = solve_interval(M, right, "hull")
    assert (narrow.x.wid <= solve_interval(M, right, "hbr").x.wid * (1 + 1e-9)).all()


def test_a_start_box_asks_for_the_solutions_inside():
    M, h = jb.interval([[2.0, 0.0], [0.0, 2.0]]), jb.interval([2.0, 2.0])
    assert solve_interval(M, h, "hbr", x0=jb.interval([0.0, 0.0], [3.0, 3.0])).status == Solvability.SOLVED
    assert solve_interval(M, h, "hbr", x0=jb.interval([2.0, 0.0], [3.0, 3.0])).status == Solvability.INFEASIBLE


def test_a_second_call_does_not_trace(rng):
    M, h = _random_systems(rng, 7, 2)
    solve_interval(M, h, "hbr")
    before = _solve._cache_size()
    solve_interval(*_random_systems(rng, 7, 2), "hbr")
    assert _solve._cache_size() == before


def test_eager_and_compiled_boxes_both_hold_the_solution(rng):
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
        (lambda: solve_interval(np.ones((3, 2)), np.ones(3), precondition="none"), "needs precondition='midpoint'"),
        (lambda: solve_interval(np.eye(9), np.ones(9), "hull"), "at most 8 unknowns"),
        (lambda: solve_interval(np.eye(2), np.ones(2), x0=jb.interval(np.ones(3))), "x0 needs one interval"),
        (lambda: solve_interval(np.eye(2) * np.nan, np.ones(2)), "not NaN"),
    ],
)
def test_bad_input_gets_a_sentence(call, says):
    with pytest.raises(ValueError, match=says):
        call()


def test_an_infinite_entry_gives_no_box():
    M = jb.interval(jnp.array([[1.0, 0.0], [0.0, 1.0]]), jnp.array([[jnp.inf, 0.0], [0.0, 1.0]]))
    assert solve_interval(M, np.ones(2), "hbr").status != Solvability.INFEASIBLE
