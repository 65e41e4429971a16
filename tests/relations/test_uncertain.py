"""Uncertain parity relations against the paper's example, the golden sizes, exact plants and python-flint."""

from fractions import Fraction
from itertools import product
from math import comb

import flint
import numpy as np
import pytest
from oracles import rational_matrix
from uncertain_systems import EXAMPLE, SYSTEMS, entry, model, relations, trajectory

import jaxbound as jb
from jaxbound.relations.annihilator import rank_over_box
from jaxbound.relations.polynomial import PolynomialMatrix, constant, monomials
from jaxbound.relations.uncertain_window import uncertain_window

FAST = [name for name in SYSTEMS if name != "n3p2_var3_h3"]


def draw(rng, *shape):
    """Return random Fractions in [-1, 1]."""
    return np.vectorize(lambda k: Fraction(int(k), 2**12), otypes=[object])(
        rng.integers(-(2**12), 2**12 + 1, shape)
    )


def test_o3_of_the_example_has_the_golden_monomials(golden):
    variables, E, _, _ = uncertain_window(model("n2p1_paper_h3"), 2)
    assert variables == (("th", 0), ("th", 1), ("vt", None))
    expected = {
        tuple(eval(k)): tuple(tuple(map(Fraction, row)) for row in m)
        for k, m in golden["p1"]["example"]["O3"].items()
    }
    assert {a: E.coefficient(a) for a in E.terms} == expected


def test_gamma_of_the_example_is_the_golden_one(golden):
    _, _, H, _ = uncertain_window(model("n2p1_paper_h3"), 2)
    expected = {
        tuple(eval(k)): tuple(tuple(map(Fraction, row)) for row in m)
        for k, m in golden["p1"]["example"]["Gamma3"].items()
    }
    assert {a: H.coefficient(a) for a in H.terms} == {
        a: tuple(row[:2] for row in m) for a, m in expected.items()
    }  # no u_{k+2}


def test_relation_of_the_example_is_the_corrected_printed_one():
    r = jb.parity_relations(model("n2p1_paper_h3"))
    assert (r.horizon, r.count, r.order, r.complete) == (2, 1, 1, "proved")
    assert r.N.coefficient((0, 0, 0)) == ((Fraction(16, 100), -1, 1),)
    assert r.N.coefficient((1, 0, 0)) == ((Fraction(2, 100), 0, 0),)
    assert r.N.coefficient((0, 1, 0)) == ((0, Fraction(-1, 10), 0),)
    assert r.K.coefficient((0, 0, 0)) == ((1, 0),) and r.K.coefficient((0, 0, 1)) == ((Fraction(1, 10), 0),)
    assert (
        r.text()
        == "r1: (0.16 + 0.02 th[k-2]) y1[k-2] - (1 + 0.1 th[k-1]) y1[k-1] + y1[k] - (1 + 0.1 vt) u1[k-2] = 0"
    )


def test_second_order_term_of_btwo_is_the_golden_one(golden):
    r, known = relations("n2p1_Btwo_h3"), golden["p1"]["generator_choice_and_bounds"]["Btwo"]
    for alpha, p, q in zip(known["keys"], known["P"], known["Q"], strict=True):
        np.testing.assert_allclose(np.array(r.N.coefficient(tuple(alpha)), float)[0], p, atol=1e-15)
        np.testing.assert_allclose(np.array(r.K.coefficient(tuple(alpha)), float)[0], q[:2], atol=1e-15)


KERNELS = [(0, (3, 16), 0), (1, (12, 40), 1), (2, (30, 76), 4), (3, (60, 126), 10), (4, (105, 192), 20)]


@pytest.mark.parametrize("order, size, kernel", KERNELS)
def test_kernels_of_the_example_by_flint_are_multiples_of_one_relation(order, size, kernel, golden):
    O = {tuple(eval(k)): m for k, m in golden["p1"]["example"]["O3"].items()}
    betas = monomials(3, order)
    gammas = sorted({tuple(map(sum, zip(a, b, strict=True))) for a in O for b in betas})
    big = flint.fmpq_mat(3 * len(betas), 2 * len(gammas))
    for (b, beta), (a, m), i, c in product(enumerate(betas), O.items(), range(3), range(2)):
        column = 2 * gammas.index(tuple(map(sum, zip(a, beta, strict=True)))) + c
        big[3 * b + i, column] += flint.fmpq(*map(int, f"{m[i][c]}/1".split("/")[:2]))
    assert (big.nrows(), big.ncols()) == size
    assert big.nrows() - big.rank() == kernel == (comb(3 + order - 1, 3) if order else 0)
    if order == 1:
        r = relations("n2p1_paper_h3")
        omega = flint.fmpq_mat(
            1, 12, [flint.fmpq(x.numerator, x.denominator) for b in betas for x in r.N.coefficient(b)[0]]
        )
        assert (omega * big).rank() == 0


@pytest.mark.parametrize("name", [*FAST, "n3p2_var3_h3"])
def test_search_has_the_golden_orders_and_kernels(name, golden):
    known = golden["p1"]["n3p2_var3_h3_to_r4"] if name == "n3p2_var3_h3" else golden["p1"]["systems"][name]
    r = relations(name)
    sizes = lambda step: (
        step["r"],
        step["rows"],
        step["cols"],
        step["kernel_dim"],
        step["multiples_dim"],
        step["new"],
    )
    ours = [(s.order, s.unknowns, s.equations, s.kernel, s.kernel - s.new, s.new) for s in r.steps]
    expected = [sizes(step) for step in known["log"]]
    if name == "n2p1_Btwo_h3":  # golden also tries monomials of b, which does not act on the state
        ours, expected = ([(s[0], *s[3:]) for s in steps] for steps in (ours, expected))
    assert ours == expected
    assert r.count == known["log"][-1]["target"]


@pytest.mark.parametrize("name", ["n3p2_var2_h3", "n3p2_inv3_h3", "n3p2_mixed3_h3"])
def test_relations_are_golden_ones(name, golden):
    r = relations(name)
    known = []
    for _, _, g in golden["p1"]["rank_at_zero_trap"][name]["gens"]:
        g = {tuple(eval(k)): tuple(map(Fraction, row)) for k, row in g.items()}
        largest = max(abs(x) for x in g[(0,) * len(r.variables)])
        known.append({a: tuple(x / largest for x in row) for a, row in g.items()})
    for i in range(r.count):
        ours = {a: r.N.coefficient(a)[i] for a in r.N.terms if any(r.N.coefficient(a)[i])}
        assert ours in known or {a: tuple(-x for x in row) for a, row in ours.items()} in known


def test_no_relation_is_lost_at_the_nominal_model():
    r = relations("n3p2_var2_h3")  # its first three relations have generic rank 3, but 2 at v = 0
    assert r.steps[-1].new == 3 and sum(s.new for s in r.steps) == 4
    assert rational_matrix(r.N.at((Fraction(0),) * 5)).rank() == 3


@pytest.mark.parametrize("name", FAST)
def test_relations_hold_exactly_for_every_plant_in_the_box(name, rng):
    matrices, parameters, h = SYSTEMS[name]
    r = relations(name)
    for _ in range(5):
        values = {
            (p["name"], k): draw(rng)
            for p in parameters
            for k in ([None] if not p.get("varying", True) else range(h))
        }
        values = {k: x.item() if hasattr(x, "item") else x for k, x in values.items()}
        u = draw(rng, h, 1)
        y = trajectory(matrices, parameters, values, list(draw(rng, r.model.n)), [list(row) for row in u])
        v = [values[name] for name in r.variables]
        U = [x for row in u for x in row][: r.K.columns]
        dot = lambda a, b: sum((p * q for p, q in zip(a, b, strict=True)), Fraction(0))
        assert [dot(n, y) for n in r.N.at(v)] == [dot(k, U) for k in r.K.at(v)]
        assert any(dot(n, [y[0] + 1, *y[1:]]) != dot(k, U) for n, k in zip(r.N.at(v), r.K.at(v), strict=True))


@pytest.mark.parametrize("name", FAST)
def test_relations_are_complete_over_the_box(name, rng):
    r = relations(name)
    _, E, _, _ = uncertain_window(r.model, r.horizon)
    points = [
        (Fraction(0),) * len(r.variables),
        *(tuple(map(Fraction, rng.choice([-1, 1], len(r.variables)).tolist())) for _ in range(6)),
    ]
    for v in [*points, *(tuple(draw(rng, len(r.variables))) for _ in range(6))]:
        O, N = rational_matrix(E.at(v)), rational_matrix(r.N.at(v))
        assert (N * O).rank() == 0
        assert N.rank() == O.nrows() - O.rank() == r.count


def test_disturbances_unknown_inputs_intervals_and_feedthrough_hold_exactly(rng):
    matrices = dict(
        A=[[0.5, 1, 0], [-0.3, 0.9, 0.1], [0, 0, 0.4]],
        B=[[1], [0.5], [0]],
        C=np.eye(3).tolist(),
        D=[[0.7], [0], [0]],
    )
    parameters = [
        dict(name="gain", B=[[1], [0], [0]], D=[[0.5], [0], [0]], between=(2, 6)),
        dict(name="decay", A=entry((3, 3), (2, 2, 1)), between=(-0.2, "1/3"), varying=False),
    ]
    G, F, D_v = [[0, 1], [1, 0], [0, 0.5]], [[1], [0], [0.2]], [[0], [0], [1]]
    m = jb.LinearSystem(
        **matrices,
        uncertainties=[jb.Uncertainty(**p) for p in parameters],
        disturbance=(G, 0.1),
        unknown_inputs=(F, D_v),
    )
    r = jb.parity_relations(m, horizon=2)
    assert r.count > 0 and r.N.columns == 9 + 4
    for _ in range(5):
        v = [x for x in draw(rng, len(r.variables))]
        by = dict(zip(r.variables, v, strict=True))
        values = {("gain", k): 4 + 2 * by.get(("gain", k), Fraction(0)) for k in range(3)}
        values["decay", None] = Fraction(1, 15) + Fraction(4, 15) * by["decay", None]
        u, w, d = draw(rng, 3, 1), draw(rng, 3, 2), draw(rng, 3, 1)
        y = trajectory(
            matrices, parameters, values, list(draw(rng, 3)), u.tolist(), w.tolist(), G, d.tolist(), F, D_v
        )
        z, U = [*y, *w[:2].ravel()], list(u.ravel())
        dot = lambda a, b: sum((p * q for p, q in zip(a, b, strict=True)), Fraction(0))
        assert [dot(n, z) for n in r.N.at(v)] == [dot(k, U) for k in r.K.at(v)]


def test_default_horizon_is_the_papers_smallest():
    assert [
        jb.parity_relations(model(name)).horizon for name in ("n2p1_paper_h3", "n3p2_var3_h2", "n3p1_inv2_h4")
    ] == [2, 1, 3]


@pytest.mark.parametrize("s", range(2, 8))
def test_relations_of_longer_windows_grow_as_golden(s, golden):
    known = golden["p1"]["growth_with_horizon"].get(str(s + 1), {"n_res": s - 1, "nv": s + 1})
    r = jb.parity_relations(model("n2p1_paper_h3"), horizon=s)
    assert (r.count, len(r.exponents) - 1, r.order) == (known["n_res"], known["nv"], 1)


def test_a_parameter_that_hides_the_state_is_named():
    m = jb.LinearSystem(
        [[0.5, 1], [0, 0.5]],
        None,
        [[1, 0]],
        uncertainties=[jb.Uncertainty("gain", C=[[1, 0]], between=(-1, "0.5"))],
    )
    with pytest.raises(
        ValueError,
        match=r"not regularly observable: at gain = -1 \(sample \d of the window\).*a window of 3 samples",
    ):
        jb.parity_relations(m)


def test_a_rank_that_drops_inside_the_box_is_found_or_said():
    hidden = jb.Uncertainty("b", A=[[0, 1], [0, 0]], between=(-1, 3), varying=False)
    for coupling, message in ((0, "not regularly observable: at b = 0 a window"), ("1/3", None)):
        m = jb.LinearSystem([[0.5, coupling], [0, 0.25]], None, [[1, 0]], uncertainties=[hidden])
        if message:
            with pytest.raises(ValueError, match=message):
                jb.parity_relations(m, horizon=2)
        else:
            assert any("not proved" in note for note in jb.parity_relations(m, horizon=2).notes)


def test_rank_over_a_box_is_proved_refuted_or_open():
    v = PolynomialMatrix(1, 1, 1, {(1,): {(0, 0): Fraction(1)}})
    line = lambda a, b: constant(((a,),), 1) + constant(((b,),), 1) @ v
    assert rank_over_box(line(Fraction(1), Fraction(99, 100)), 1)[0] == "proved"
    assert rank_over_box(line(Fraction(1), Fraction(2)), 1) == ("drops", (Fraction(-1, 2),))
    assert rank_over_box(line(Fraction(1), Fraction(3)), 1)[0] == "open"


def test_an_unseen_state_is_left_out_and_noted(rng):
    bigger = dict(EXAMPLE, A=[[0.8, 1, 0], [0, 0.2, 0], [0.3, 0, 0.9]], B=[[0], [1], [1]], C=[[1, 0, 0]])
    parameters = [
        jb.Uncertainty("th", A=entry((3, 3), (0, 0, 0.1))),
        jb.Uncertainty("vt", C=[[0.1, 0, 0]], varying=False),
    ]
    r, small = (
        jb.parity_relations(jb.LinearSystem(**bigger, uncertainties=parameters)),
        relations("n2p1_paper_h3"),
    )
    assert len(r.notes) == 1 and r.notes[0].startswith("1 of 3 states acts on no output within the horizon")
    assert r.horizon == 2 and r.N.terms == small.N.terms and r.K.terms == small.K.terms


def test_a_static_model_has_its_equations_as_relations():
    k = jb.Uncertainty("k", D=[[1, 0], [2, 0]], between=(0, "0.2"))
    m = jb.LinearSystem(None, None, None, [[1, 2], [3, 4]], noise=0.1, uncertainties=[k])
    r = jb.parity_relations(m)
    assert (r.horizon, r.count, r.complete) == (0, 2, "proved")
    assert r.text().splitlines() == [
        "r1: y1[k] - (1.1 + 0.1 k[k]) u1[k] - 2 u2[k] = 0",
        "r2: y2[k] - (3.2 + 0.2 k[k]) u1[k] - 4 u2[k] = 0",
    ]


@pytest.mark.parametrize(
    "change, message",
    [
        (dict(horizon=1), "horizon 1 gives no relation: 2 samples do not outnumber the 2 unknowns"),
        (dict(form="second"), "form 'second' is for models without uncertainties"),
        (dict(horizon=1.5), "horizon must be a whole number"),
    ],
)
def test_what_gives_no_relation_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        jb.parity_relations(model("n2p1_paper_h3"), **change)


def test_a_constant_sensor_gain_is_told_to_become_an_uncertainty():
    with pytest.raises(NotImplementedError, match="varying=False"):
        jb.parity_relations(model("n2p1_paper_h3", tolerance=0.1, constant_tolerance=True))


def test_relations_of_one_sample_that_no_parameter_touches_are_found_and_test_windows():
    twice = jb.LinearSystem(
        [["0.5"]], [[1]], [[1], [1]], noise="0.1", uncertainties=[jb.Uncertainty("a", A=[["0.05"]])]
    )
    r = jb.parity_relations(twice)
    assert (r.horizon, r.text()) == (0, "r1: y1[k] - y2[k] = 0")
    assert jb.detect(r, np.zeros((2, 1)), [[1, 1.1], [0, 0.5]]).status.tolist() == [
        jb.Status.CONSISTENT,
        jb.Status.FAULT,
    ]
