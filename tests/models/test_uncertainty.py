"""Uncertain parameters in a model, its file and its simulation."""

from fractions import Fraction

import jax
import numpy as np
import pytest
from systems import PAPER
from uncertain_systems import SYSTEMS, model, trajectory

import jaxbound as jb
from jaxbound.models.modelfile import model_text

GAIN = dict(name="gain", B=[[1], [0]], D=[[0.5], [0]], between=(2, 6))
ALL = [
    dict(GAIN, name="k", varying=True),
    dict(name="r", A=[["1/3", 0], [0, 0]], C=[[0.1, 0], [0, 0]], between=("-1/7", 0.3), varying=False),
]


def build(*parameters, **changes):
    return jb.LinearSystem(**{**PAPER, **changes}, uncertainties=[jb.Uncertainty(**p) for p in parameters])


def test_the_model_is_kept_at_the_middle_of_its_parameters():
    m = build(GAIN, D=[[1], [0]])
    assert m.B == ((4,), (1,)) and m.D == ((3,), (0,)) and m.A == build().A
    (u,) = m.uncertainties
    assert (u.centre, u.radius, u.between) == (4, 2, (2, 6))
    assert u.on("B") == ((2,), (0,)) and u.on("A") is None


def test_numbers_are_exact_decimals():
    m = build(dict(name="a", A=[[0.1, 0], [0, "1/3"]], between=("-0.1", "0.3")))
    assert m.A[0][0] == Fraction("0.8") + Fraction("0.01") and m.A[1][1] == Fraction("0.2") + Fraction(1, 30)


def test_a_parameter_in_d_makes_the_newest_input_matter():
    assert not build().has_feedthrough
    assert build(dict(name="d", D=[[1], [0]])).has_feedthrough


@pytest.mark.parametrize(
    "given, message",
    [
        (dict(name="a"), "uncertainty 'a' acts on nothing"),
        (dict(name="a", A=[[0, 0], [0, 0]]), "acts on nothing"),
        (dict(name="", A=[[1]]), "needs a name"),
        (dict(name="a", A=[[1, 2], [3]]), "A of uncertainty 'a': rows have different lengths"),
        (dict(name="a", A=[[np.nan, 0], [0, 0]]), "A of uncertainty 'a': nan is not a finite number"),
        (dict(name="a", A=[[1]], between=(6, 2)), r"between of uncertainty 'a' needs lo < hi, not \[6, 2\]"),
        (dict(name="a", A=[[1]], between=3), "needs two numbers"),
        (dict(name="a", A=[[1]], varying="no"), "varying of uncertainty 'a' must be True or False"),
    ],
)
def test_an_uncertainty_that_means_nothing_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        jb.Uncertainty(**given)


@pytest.mark.parametrize(
    "parameters, message",
    [
        (
            [dict(name="a", A=[[1]])],
            r"A of uncertainty 'a' must have the shape of the model's A, \(2, 2\): its shape is \(1, 1\)",
        ),
        ([GAIN, GAIN], "'gain' is used twice"),
    ],
)
def test_uncertainties_that_do_not_fit_are_refused(parameters, message):
    with pytest.raises(ValueError, match=message):
        build(*parameters)


def test_what_is_no_uncertainty_is_refused():
    with pytest.raises(
        TypeError, match=r"uncertainties must be jb.Uncertainty\(name, A=..., ...\), not dict"
    ):
        jb.LinearSystem(**PAPER, uncertainties=[GAIN])


@pytest.mark.parametrize(
    "m",
    [
        build(*ALL),
        jb.LinearSystem(None, None, None, [[1, 2]], uncertainties=[jb.Uncertainty("k", D=[[0, 0.1]])]),
    ],
)
def test_a_model_file_keeps_every_number(m, tmp_path):
    jb.save_model(m, tmp_path / "m.toml")
    again = jb.load_model(tmp_path / "m.toml")
    for name in ("A", "B", "C", "D", "n", "m", "p"):
        assert getattr(again, name) == getattr(m, name)
    for a, b in zip(again.uncertainties, m.uncertainties, strict=True):
        assert (a.name, a.A, a.B, a.C, a.D, a.varying, a.between) == (
            b.name,
            b.A,
            b.B,
            b.C,
            b.D,
            b.varying,
            b.between,
        )
    assert model_text(again) == model_text(m)


@pytest.mark.parametrize(
    "block, message",
    [
        ("varying = 1\nA = [[1]]", "varying of number 1 of uncertainty, 'a' must be true or false"),
        ("between = 3\nA = [[1]]", r"between of number 1 of uncertainty, 'a' must be \[lowest, highest\]"),
        ("A = [1]", "A of number 1 of uncertainty, 'a' must be a list of rows"),
        ("a = [[1]]", "has the unknown field 'a'; known fields are name, varying, between, A, B, C, D"),
        ("", "uncertainty 'a' acts on nothing"),
    ],
)
def test_a_block_of_a_file_that_means_nothing_is_refused(block, message, tmp_path):
    path = tmp_path / "m.toml"
    path.write_text(f'dt = 1\n[[uncertainty]]\nname = "a"\n{block}\n[matrices]\nA = [[0.5]]\nC = [[1]]\n')
    with pytest.raises(ValueError, match=message):
        jb.load_model(path)


@pytest.mark.parametrize("at", [pytest.param("uniform", marks=pytest.mark.long), "vertices"])
def test_parameters_are_drawn_within_the_box_each_as_it_varies(at):
    m = model("n2p1_paper_h3")
    drawn = np.asarray(jb.simulate(m, np.zeros((20, 100, 1)), jax.random.key(3), at=at).parameters)
    assert drawn.shape == (20, 100, 2) and (abs(drawn) <= 1).all()
    assert (np.ptp(drawn, axis=1)[:, 1] == 0).all() and (np.ptp(drawn, axis=1)[:, 0] > 1.5).all()
    assert np.ptp(drawn[:, 0, 1]) > 1 and (at == "uniform" or (abs(drawn) == 1).all())


def test_a_simulation_is_the_exact_trajectory_to_the_last_digit(rng):
    name = "n3p2_mixed3_h3"
    matrices, parameters, _ = SYSTEMS[name]
    u = np.round(rng.uniform(0, 2, (25, 1)), 3)
    t = jb.simulate(model(name), u, jax.random.key(int(rng.integers(99))), at="uniform")
    exact = lambda a: [[Fraction(float(x)) for x in row] for row in np.asarray(a)]
    v = np.vectorize(lambda x: Fraction(float(x)), otypes=[object])(np.asarray(t.parameters))
    values = {(p["name"], k): v[k or 0, i] for i, p in enumerate(parameters) for k in (*range(25), None)}
    y = np.array(
        trajectory(matrices, parameters, values, [Fraction(0)] * len(matrices["A"]), exact(u)), float
    ).reshape(25, -1)
    assert (abs(np.asarray(t.y) - y) <= np.spacing(abs(y).max())).all()


def test_a_static_model_is_simulated_and_detected():
    m = jb.LinearSystem(None, None, None, [[1, 2], [3, 4]], noise=0.1)
    t = jb.simulate(m, np.ones((5, 2)), jax.random.key(0), faults=[jb.Fault("y1", size=1, start=4)])
    assert np.array_equal(jb.detect(jb.parity_relations(m), t.u, t.y).status, [1, 1, 1, 1, 3])


def test_a_model_without_states_needs_its_equation():
    with pytest.raises(ValueError, match=r"a model without states needs D \(y = D u\)"):
        jb.LinearSystem(None, None, [[1]])
