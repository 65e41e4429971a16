"""Parity relations against the paper, the golden values and exact linear algebra by python-flint."""

from fractions import Fraction
from math import comb, gcd

import numpy as np
import pytest
from oracles import MODELS, Plant, draw, rational_matrix
from systems import paper

import jaxbound as jb
from jaxbound.models import window

EVERY = [(name, s) for name in MODELS for s in (1, 2, 3)]


def build(name, s, form="first"):
    return jb.parity_relations(jb.LinearSystem(**MODELS[name]), horizon=s, form=form)


def mat(a):
    return rational_matrix([list(r) for r in a])


def known_action(W, H):
    """Return W H by flint, as rows of Fractions."""
    product = mat(W) * mat(H)
    return tuple(tuple(Fraction(int(x.p), int(x.q)) for x in row) for row in product.tolist())


def test_relations_of_section_5_are_the_papers(golden):
    static, r = golden["p0"]["static"]["value"], jb.parity_relations(paper(), horizon=1)
    assert [list(map(int, row)) for row in r.W] == static["W_paper"]
    assert [[-x for x in row] for row in r.K] == [[Fraction(x)] for x in static["u_coeff_paper"]]


def test_circuits_of_section_5_are_the_four_golden_ones(golden):
    static, r = golden["p0"]["static"]["value"], jb.parity_relations(paper(), horizon=1)
    signed = lambda h, u: tuple(x * (1 if next(v for v in h if v) > 0 else -1) for x in (*h, u))
    expected = {
        signed(h, Fraction(u))
        for h, u in zip(static["circuits_s1_drop_col"], static["circuits_u_coeff"], strict=True)
    }
    assert {signed(h, -k[0]) for h, k in zip(r.circuits, r.circuits_known, strict=True)} == expected


@pytest.mark.parametrize("s, count", [(1, 4), (2, 20), (3, 56), (4, 120), (5, 220), (6, 364)])
def test_number_of_circuits_grows_as_golden(s, count):
    assert len(jb.parity_relations(paper(), horizon=s).circuits) == count == comb(2 * (s + 1), 3)


@pytest.mark.parametrize("name, s", EVERY)
def test_circuits_are_all_vectors_of_minimal_support(name, s):
    normal = lambda h: tuple(x / next(v for v in h if v) for x in h)
    r = build(name, s)
    expected = {normal(h) for h in Plant(**MODELS[name]).circuits(s)}
    assert {normal(h) for h in r.circuits} == expected
    assert len(r.circuits) == len(expected)


@pytest.mark.parametrize("form", ["first", "second"])
@pytest.mark.parametrize("name, s", EVERY)
def test_relations_annihilate_the_state_and_keep_the_inputs(name, s, form):
    O, H = Plant(**MODELS[name]).window(s)
    r = build(name, s, form)
    assert all(x == 0 for x in (mat(r.W) * mat(O)).entries())
    assert r.K == (known_action(r.W, H) if H[0] else tuple(() for _ in r.W))
    assert r.circuits_known == (known_action(r.circuits, H) if H[0] else tuple(() for _ in r.circuits))


@pytest.mark.parametrize("form", ["first", "second"])
@pytest.mark.parametrize("name, s", [*EVERY, ("paper", 6)])
def test_relations_are_independent_and_complete(name, s, form):
    O, _ = Plant(**MODELS[name]).window(s)
    r = build(name, s, form)
    assert r.count == mat(r.W).rank() == len(O) - mat(O).rank()


@pytest.mark.parametrize("name, s", EVERY)
def test_second_form_is_a_regular_combination_of_the_first(name, s):
    first, second = build(name, s), build(name, s, "second")
    W, other = mat(first.W), mat(second.W)
    Q = other * W.transpose() * (W * W.transpose()).inv()
    assert Q * W == other
    assert Q.det() != 0
    assert not first.K[0] or Q * mat(first.K) == mat(second.K)


@pytest.mark.parametrize("name, s", [c for c in EVERY if c[1] < 4])
def test_first_form_extends_to_the_second_by_the_papers_formula(name, s):
    L, M, _, _ = (
        mat(a) if a and a[0] else None for a in window.second_form(jb.LinearSystem(**MODELS[name]), s)
    )
    W = mat(build(name, s).W)
    W_M = -1 * (W * L * M.transpose() * (M * M.transpose()).inv())
    assert all(x == 0 for x in (W * L + W_M * M).entries())


@pytest.mark.parametrize("s", [1, 2, 3])
def test_relations_span_the_golden_row_space(s, golden):
    static = golden["p0"]["static"]["value"][f"s{s}"]
    expected = mat([[Fraction(x) for x in row] for row in static["W"]])
    ours = mat(build("paper", s).W)
    assert (
        static["n_relations"]
        == ours.nrows()
        == mat(build("paper", s).W + tuple(tuple(map(Fraction, r)) for r in static["W"])).rank()
    )
    assert expected.rank() == ours.rank()


@pytest.mark.parametrize("name, s", EVERY)
def test_external_form_is_the_internal_form_exactly(name, s, rng):
    plant, r = Plant(**MODELS[name]), build(name, s)
    draw = lambda count: [Fraction(int(v), 2**20) for v in rng.integers(-(2**20), 2**20 + 1, count)]
    for _ in range(20):
        x, u = [8 * v for v in draw(plant.n)], [draw(plant.m) for _ in range(s + 1)]
        true = [v for row in plant.trajectory(x, u) for v in row]
        theta = [a * b for a, b in zip(draw(len(true)), plant.tolerance * (s + 1), strict=True)]
        noise = [a * b for a, b in zip(draw(len(true)), plant.noise * (s + 1), strict=True)]
        y = [(1 + t) * v + e for t, v, e in zip(theta, true, noise, strict=True)]
        mu = [(t * v + e) / (1 + t) for t, v, e in zip(theta, y, noise, strict=True)]
        U = [v for row in u[: plant.lags(s)] for v in row]
        for h, k in zip(r.W, r.K, strict=True):
            external = sum(a * b for a, b in zip(h, y, strict=True)) - sum(
                (a * b for a, b in zip(k, U, strict=True)), Fraction(0)
            )
            assert external == sum(a * b for a, b in zip(h, mu, strict=True))


@pytest.mark.parametrize(
    "name, s", [("paper", 1), ("paper", 3), ("feedthrough", 2), ("offsets", 1), ("three states", 2)]
)
def test_external_evaluates_the_exact_relations_to_rounding(name, s, rng):
    plant, r = Plant(**MODELS[name]), build(name, s)
    u, y = rng.normal(size=(30, plant.m)) * 3, rng.normal(size=(30, plant.p)) * 10
    out = np.asarray(r.external(u, y))
    assert out.shape == (30, r.count) and np.isnan(out[:s]).all()
    for k in range(s, 30):
        Y = [Fraction(v) - plant.offset_y[i] for row in y[k - s : k + 1] for i, v in enumerate(row)]
        U = [
            Fraction(v) - plant.offset_u[i]
            for row in u[k - s : k - s + plant.lags(s)]
            for i, v in enumerate(row)
        ]
        dot = lambda a, b: sum((x * v for x, v in zip(a, b, strict=True)), Fraction(0))
        exact = np.array([float(dot(h, Y) - dot(g, U)) for h, g in zip(r.W, r.K, strict=True)])  # noqa: B023
        size = np.array([float(sum(abs(a * b) for a, b in zip(h, Y, strict=True))) for h in r.W]) + 10
        assert (abs(out[k] - exact) < 1e-14 * size).all()


@pytest.mark.parametrize("name, s", [("paper", 1), ("paper", 2), ("offsets", 1)])
def test_internal_form_contains_the_external_form_of_healthy_data(name, s, rng):
    u, _, y = draw(Plant(**MODELS[name]), s, 500, rng, spread=0.9)
    r = build(name, s)
    external, internal = np.asarray(r.external(u, y))[:, s], r.internal(u, y)
    lo, hi = np.asarray(internal.lo)[:, s], np.asarray(internal.hi)[:, s]
    assert ((lo <= external) & (external <= hi)).all()
    assert not (
        abs(external - (lo + hi) / 2) <= (hi - lo) / 4
    ).all()  # the bounds bite: half of them would not do


@pytest.mark.parametrize(
    "name, s", [("paper", 1), ("three states", 1), ("feedthrough", 2), ("offsets", 1), ("no input", 1)]
)
def test_first_form_has_coprime_integers_and_starts_and_ends_apart(name, s):
    W = build(name, s).W
    assert all(x.denominator == 1 for row in W for x in row)
    assert all(gcd(*(int(x) for x in row)) == 1 for row in W)
    starts = [next(i for i, x in enumerate(row) if x) for row in W]
    ends = [max(i for i, x in enumerate(row) if x) for row in W]
    assert len(set(starts)) == len(set(ends)) == len(W)


def test_a_longer_window_repeats_the_short_relations_at_each_sample():
    short, long = build("paper", 1), build("paper", 2)
    zero = (Fraction(0),) * 2
    assert set(long.W) == {w for row in short.W for w in (row + zero, zero + row)}


def test_offsets_shift_the_signals_and_nothing_else(rng):
    u, y = rng.normal(size=(40, 1)), rng.normal(size=(40, 2))
    shifted = paper(offset={"u": [0.5], "y": [3, -0.25]})
    plain, moved = jb.parity_relations(paper(), horizon=2), jb.parity_relations(shifted, horizon=2)
    assert plain.W == moved.W and plain.K == moved.K
    np.testing.assert_allclose(
        moved.external(u + 0.5, y + [3, -0.25]), plain.external(u, y), rtol=0, atol=1e-12
    )


def test_bounds_of_the_relation_are_never_below_the_models_decimals():
    r = jb.parity_relations(paper(tolerance=["1/3", "0.1"], noise=["0.7", "1/10"]), horizon=1)
    for field, exact in (("tolerance", ("1/3", "1/10")), ("noise", ("7/10", "1/10"))):
        assert all(Fraction(float(b)) >= Fraction(e) for b, e in zip(r.bounds[field], exact, strict=True))
        np.testing.assert_allclose(r.bounds[field], [float(Fraction(e)) for e in exact], rtol=3e-16)
