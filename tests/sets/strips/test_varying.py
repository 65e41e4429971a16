"""Zonotopes that differ from window to window: margins against linear programs, proofs against exact
rationals.
"""

from fractions import Fraction

import highspy
import jax
import jax.numpy as jnp
import linear_programs
import numpy as np
import pytest

from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.strips import varying

searched, refutes, holds, right_inverse, strip = map(
    kernel,
    (varying.farthest, varying.refutes, varying.holds, varying.right_inverse, varying.strip),
)

COLUMNS = {
    1: 8,
    2: 10,
    3: 8,
    4: 12,
    5: 12,
}  # fewer generators are filled up with zeros, so that one shape is compiled


MANY = 2048


def draw(rng, r, q, count):
    """Draw zonotopes (N, r, q) and centres (N, r), a third of them degenerate: dependent rows, parallel, zero
    or too few generators.
    """
    G, c = (
        rng.normal(size=(count, r, q)),
        rng.normal(size=(count, r)) * rng.uniform(0.1, 1.5, (count, 1)) * np.sqrt(q),
    )
    for k in range(0, count, 3):
        kind = rng.integers(5)
        if kind == 0:
            G[k, :, 1:] = (
                np.outer(G[k, :, 0], rng.integers(-2, 3, q - 1)) if rng.random() < 0.3 else G[k, :, 1:]
            )
            G[k, :, 1] = -2 * G[k, :, 0]
        elif kind == 1:
            G[k] = rng.integers(-2, 3, (r, q))
            c[k] = rng.integers(-4, 5, r)
        elif kind == 2:
            G[k, :, rng.integers(1, q) :] = 0
        elif kind == 3 and r > 1:
            G[k, -1] = G[k, :-1].sum(0)
            c[k, -1] = c[k, :-1].sum() if rng.random() < 0.5 else c[k, -1]
        else:
            G[k] *= 10.0 ** rng.integers(-3, 4, (r, 1))
            c[k] *= abs(G[k]).max(1)
    return c, G


def gauges(c, G):
    """Return t (N,) by HiGHS: 1 / t is the largest s with G z = -s c for some |z| <= 1; infinite where only s
    = 0 will do.
    """
    solver = linear_programs.solver(primal_feasibility_tolerance=1e-10, dual_feasibility_tolerance=1e-10)
    out = np.empty(len(c))
    r, q = G.shape[1:]
    for k in range(len(c)):
        scale = np.maximum(abs(np.column_stack([G[k], c[k]])).max(1), 1e-300)
        model = highspy.HighsLp()
        model.num_col_, model.num_row_, model.sense_ = q + 1, r, highspy.ObjSense.kMaximize
        model.col_cost_, model.col_lower_, model.col_upper_ = (
            np.r_[np.zeros(q), 1],
            np.r_[-np.ones(q), 0],
            np.r_[np.ones(q), 1e6],
        )
        model.row_lower_ = model.row_upper_ = np.zeros(r)
        model.a_matrix_.start_, model.a_matrix_.index_ = np.arange(q + 2) * r, np.tile(np.arange(r), q + 1)
        model.a_matrix_.value_ = (np.column_stack([G[k], c[k]]) / scale[:, None]).T.ravel()
        solver.passModel(model)
        assert linear_programs.is_feasible(solver)
        s = solver.getInfo().objective_function_value
        out[k] = 1 / s if s > 1e-7 else np.inf
    return out


def columns_first(c, G):
    return np.ascontiguousarray(c.T), np.ascontiguousarray(np.moveaxis(G, 0, -1))


def strip_margins(c, G, error):
    """Return the margin (N,) of 0 by the strip that comes closest to refuting."""
    return np.asarray(refutes(c, G, error, strip(c, G, error)))


def margins(c, G, c_error=0.0, G_error=0.0):
    """Return the margin (N,) of 0 by the hints of a search: < 0 proved outside, > 0 proved inside, else 0."""
    c_error, G_error = np.zeros_like(c) + c_error, np.zeros_like(G) + G_error
    error = c_error + G_error.sum(1) * (1 + 1e-12)
    h, z = searched(c, G, error)
    z = np.clip(np.asarray(z), -1, 1)
    with np.errstate(all="ignore"):
        F = c + (G * z).sum(1)
        F_error = error + 4 * G.shape[1] * np.finfo(c.dtype).eps * (abs(c) + abs(G * z).sum(1))
    outside = np.asarray(refutes(c, G, error, h))
    inside = np.asarray(holds(F, F_error, G, G_error, z, right_inverse(G, z)))
    found = np.where(
        inside, np.maximum(outside, np.finfo(c.dtype).eps), np.where(np.isnan(outside), outside, 0)
    )
    return np.where(outside < 0, outside, found)


def check_against_programs(rng, r, q, count):
    c, G = draw(rng, r, q, count)
    margin, wanted = margins(*columns_first(c, G)), 1 - gauges(c, G)
    clear = abs(wanted) > 1e-9
    assert not (clear & (margin * wanted < 0)).any()
    assert not (clear & (margin == 0) & (wanted < 0)).any()  # what is outside is refuted, degenerate or not
    flat = np.array([np.linalg.matrix_rank(g) < r for g in G])
    assert not (clear & (margin == 0) & ~flat).any() and (margin[flat] <= 0).all()
    decided = (margin != 0) & np.isfinite(wanted) & (wanted > -1e3)
    assert np.allclose(margin[decided], wanted[decided], rtol=1e-6, atol=1e-6)
    return int((margin < 0).sum()), int((margin > 0).sum())


@pytest.mark.parametrize(
    "r", [2, *(pytest.param(r, marks=(pytest.mark.long, pytest.mark.compiled)) for r in (1, 3))]
)
def test_margins_have_the_sign_and_size_of_linear_programs(rng, r):
    outside, inside = check_against_programs(rng, r, COLUMNS[r], 300)
    assert outside > 10 and inside > 30


@pytest.mark.long(by_day="test_margins_have_the_sign_and_size_of_linear_programs")
@pytest.mark.compiled
@pytest.mark.parametrize(("r", "q"), [(1, 20), (2, 20), (3, 12), (4, 20), (5, 20)])
def test_margins_have_the_sign_of_linear_programs_on_20000_zonotopes(rng, r, q):
    for fewest in (5, 10):
        c, G = draw(rng, r, q, 2000)
        for k, some in enumerate(rng.integers(fewest, q + 1, 2000)):
            G[k, :, some:] = 0
        margin, wanted = margins(*columns_first(c, G)), 1 - gauges(c, G)
        assert not ((abs(wanted) > 1e-9) & (margin * wanted < 0)).any()
        assert not ((abs(wanted) > 1e-9) & (margin == 0) & (wanted < 0)).any()


@pytest.mark.compiled
@pytest.mark.parametrize(
    "r", [2, pytest.param(3, marks=pytest.mark.long), pytest.param(4, marks=pytest.mark.long)]
)
def test_a_set_whose_boundary_goes_through_0_is_never_refuted_nor_held(rng, r):
    """Integers: c = -G z with z at the vertex that h selects is exactly on the boundary; a hair further is
    outside.
    """
    q, count = COLUMNS[r], MANY
    G = rng.integers(-9, 10, (count, r, q)).astype(float)
    h = rng.integers(-9, 10, (count, r)).astype(float)
    side = np.sign(np.einsum("ni,nij->nj", h, G)) + (np.einsum("ni,nij->nj", h, G) == 0) * rng.choice(
        [-1, 1], (count, q)
    )
    c = -np.einsum("nij,nj->ni", G, side)
    on_it = margins(*columns_first(c, G))
    assert not (on_it < 0).any()
    assert not (on_it[(abs(h) @ np.ones(r)) > 0] > 0).any()
    inside = margins(*columns_first(c * (1 - 1e-9), G))
    assert not (inside < 0).any() and (inside > 0).mean() > 0.9
    outside = margins(*columns_first(c * (1 + 1e-9), G))
    real = (abs(np.einsum("ni,nij->nj", h, G)).sum(1)) > 0
    assert not (outside[real] > 0).any() and (outside[real] < 0).mean() > 0.9


@pytest.mark.parametrize("r", [2, pytest.param(3, marks=(pytest.mark.long, pytest.mark.compiled))])
def test_errors_of_the_entries_count(rng, r):
    """A set that holds 0 for some entries within their errors is never refuted: here c is moved out by all
    that the errors allow.
    """
    q, count = COLUMNS[r], 500
    G, z = rng.normal(size=(count, r, q)), rng.choice([-1.0, 1.0], (count, q))
    true_c = -np.einsum("nij,nj->ni", G, z)  # 0 is a vertex, or inside
    wrong_G, wrong_c = abs(rng.normal(size=G.shape)) * 0.01, abs(rng.normal(size=true_c.shape)) * 0.01
    shifted = true_c + wrong_c * np.sign(true_c), G * 1.0
    shifted[1][:] -= np.sign(G) * np.minimum(wrong_G, abs(G))
    errors = columns_first(wrong_c * (1 + 1e-12), wrong_G * (1 + 1e-12))
    plain, counted = (margins(*columns_first(*shifted), *e) for e in ((), errors))
    assert (plain < 0).any() and not (counted < 0).any()


def test_a_refuting_direction_is_a_proof_in_exact_rationals(rng):
    c, G = draw(rng, 4, COLUMNS[4], 60)
    block = columns_first(c, G)
    h, _ = searched(*block, 0 * block[0])
    refuted = np.asarray(refutes(*block, 0 * block[0], h)) < 0
    assert refuted.sum() > 10
    for k in np.flatnonzero(refuted):
        direction = [Fraction(float(x)) for x in h[:, k]]
        dot = lambda column, d=direction: sum(
            (x * Fraction(float(y)) for x, y in zip(d, column, strict=True)), Fraction(0)
        )
        assert abs(dot(c[k])) > sum(abs(dot(column)) for column in G[k].T)


def test_naive_strips_miss_what_rank_aware_ones_see(rng):
    """Six generators in a plane of R^3 (golden "Degeneracy"): all normals of pairs are the plane's, which
    says nothing within it.
    """
    count = 400
    basis, inner = (
        rng.integers(-4, 5, (count, 3, 2)).astype(float),
        rng.integers(-4, 5, (count, 2, 6)).astype(float),
    )
    G, x = (
        np.pad(basis @ inner, ((0, 0), (0, 0), (0, COLUMNS[3] - 6))),
        rng.integers(-40, 41, (count, 2)).astype(float),
    )
    c = np.einsum("nij,nj->ni", basis, x)
    normal = np.cross(G[:, :, 0], G[:, :, 1])
    naive_accepts = abs(np.einsum("ni,ni->n", normal, c)) <= 1e-9
    margin, wanted = margins(*columns_first(c, G)), 1 - gauges(c, G)
    assert (naive_accepts & (wanted < -1e-9)).sum() > 50
    assert ((margin < 0) == (wanted < -1e-9)).all()


@pytest.mark.parametrize("r", [1, 2])
def test_strips_of_few_rows_tell_what_is_outside_and_how_far(rng, r):
    """Nine generators, in some sets parallel, zero or in a plane; then sets whose boundary goes through 0, in
    integers.
    """
    c, G = draw(rng, r, 9, 300)
    G[::7, :, 3:] = 0
    margin, wanted = (
        strip_margins(*columns_first(c, G), np.zeros((r, 300))),
        1 - gauges(c, G),
    )
    assert ((margin < 0) == (wanted < 0))[abs(wanted) > 1e-9].all() and 20 < (margin < 0).sum() < 280
    sized = np.isfinite(wanted) & (wanted > -1e3)
    np.testing.assert_allclose(margin[sized], wanted[sized], rtol=1e-6, atol=1e-6)
    G, h = rng.integers(-9, 10, (300, r, 9)).astype(float), rng.integers(-9, 10, (300, r)).astype(float)
    c = -np.einsum("nij,nj->ni", G, np.where(np.einsum("ni,nij->nj", h, G) >= 0, 1, -1))
    assert not (strip_margins(*columns_first(c, G), np.zeros((r, 300))) < 0).any()


def test_a_window_with_nan_stays_nan_and_disturbs_no_other():
    c, G = np.array([[1.0, np.nan, 0.5], [0.0, 0.0, 0.0]]), np.ones((2, COLUMNS[2], 3)) / 4
    G[1, ::2] *= -1
    assert np.isnan(margins(c, G)).tolist() == [False, True, False]
    assert margins(c, G)[[0, 2]].tolist() == pytest.approx([0.6, 0.8])  # along the first row G reaches 10 / 4


@pytest.mark.compiled
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e308])
def test_many_windows_with_numbers_that_say_nothing_prove_nothing(rng, bad):
    """Enough of them for a reduction that overlooks NaN."""
    r, N = 2, MANY
    c, G = rng.normal(size=(r, N)), rng.normal(size=(r, COLUMNS[r], N))
    usual = margins(c, G)
    at = np.arange(0, N, 3)
    G[rng.integers(0, r, len(at)), rng.integers(0, COLUMNS[r], len(at)), at] = bad
    margin = margins(c, G)
    assert not (margin[at] < 0).any() and (np.isfinite(bad) or not (margin[at] > 0).any())
    assert np.array_equal(np.delete(margin, at), np.delete(usual, at))


@pytest.mark.long(by_day="test_margins_have_the_sign_and_size_of_linear_programs")
@pytest.mark.compiled
def test_float32_and_uncompiled_code_prove_the_same(rng):
    c, G = (x.astype(np.float32) for x in columns_first(*draw(rng, 2, COLUMNS[2], 64)))
    single, double = (
        margins(c, G),
        margins(c.astype(float), G.astype(float)),
    )
    assert (
        single.dtype == np.float32
        and not (np.sign(single) * np.sign(double) < 0).any()
        and (single != 0).mean() > 0.5
    )
    with jax.disable_jit():
        few = [jnp.asarray(x[..., :4]) for x in (c, G, 0 * c)]
        refuted = strip_margins(*few) < 0
        assert not (refuted & (double[:4] > 0)).any()


def test_a_direction_whose_sum_overflows_refutes_nothing():
    """0 = c - G 1 / 1.01 is in the set."""
    c, h = np.full((3, 1), 1e6), np.array([[1.0], [1.0], [-1.0]]) * 1.2e302
    G = np.repeat(c[:, None] * 1.01 / 10, 10, 1)
    with np.errstate(over="ignore"):
        assert not (np.asarray(refutes(c, G, np.zeros((3, 1)), h)) < 0).any()
