"""Inputs that nobody knows, not even a bound: the verdict of the program in which they are free, for windows
short and long.
"""

from fractions import Fraction

import jax
import numpy as np
import pytest
from boundary import SIX, agree, last, prepared
from oracles import MODELS, Plant, Windows, draw
from systems import paper

import jaxbound as jb
from jaxbound.models import window
from jaxbound.sets.floats.status import Status

PLANTS = {
    "leak": (MODELS["three states"] | dict(unknown_inputs=([[1], [0], ["1/3"]],)), 3),
    "at the outputs": (MODELS["offsets"] | dict(unknown_inputs=([[1], ["1/3"]], [[0], [1], [2]])), 2),
    "with a disturbance": (
        MODELS["offsets"] | dict(unknown_inputs=([[1], [-2]],), disturbance=([[0], ["0.3"]], [[0, "0.2"]])),
        2,
    ),
    "long": (MODELS["paper"] | dict(unknown_inputs=([[0], [1]],)), 8),
    "two, long": (
        SIX
        | dict(unknown_inputs=([[0, 0], [1, 0], [0, 0], [0, 0], [0, 0], [0, 0]], [[0, 1], [0, 0], [0, 1]])),
        12,
    ),
}


def numbers(name):
    """Return the keywords of a model and its horizon; a lone F stands in a tuple of one for the oracle."""
    spec, horizon = PLANTS[name]
    F, D_v = (*spec["unknown_inputs"], None)[:2]
    return spec | dict(unknown_inputs=(F, D_v or [[0] * len(F[0])] * len(spec["C"]))), horizon


@pytest.mark.parametrize("name", PLANTS)
def test_the_static_form_is_the_response_of_the_plant(name):
    spec, s = numbers(name)
    E, K = window.unknowns(jb.LinearSystem(**spec), s)
    assert ([list(r) for r in E], [list(r) for r in K]) == Plant(**spec).equation(s)


@pytest.mark.parametrize("form", ["first", "second"])
@pytest.mark.parametrize("name", PLANTS)
def test_relations_annihilate_state_and_unknown_inputs(name, form):
    spec, s = numbers(name)
    E, _ = Plant(**spec).equation(s)
    r = jb.parity_relations(jb.LinearSystem(**spec), s, form)
    for h in r.W:
        assert not any(
            sum((a * b for a, b in zip(h, column, strict=True)), Fraction(0))
            for column in zip(*E, strict=True)
        )
    assert (
        r.count
        == r.model.p * (s + 1)
        - np.linalg.matrix_rank(np.array([[float(x) for x in row] for row in E]))
        + r.model.g * s
    )


@pytest.mark.parametrize(
    "name, count",
    [
        *((name, 300) for name in list(PLANTS)[:2]),
        *(pytest.param(n, 300, marks=pytest.mark.long) for n in list(PLANTS)[2:4]),
        *(pytest.param(name, 1500, marks=pytest.mark.long) for name in PLANTS),
    ],
)
def test_the_verdict_is_that_of_the_program_with_free_inputs(name, count, rng):
    spec, s = numbers(name)
    r, oracle, u, y = prepared(spec, s, count, rng)
    assert (r.frame is not None) == ("long" in name)
    assert 0.1 < agree(last(jb.detect(r, u, y).status), oracle.slack(u, y)) < 0.9


@pytest.mark.parametrize("name", ["at the outputs", pytest.param("long", marks=pytest.mark.long)])
def test_with_gaps_the_verdict_is_that_of_the_program_without_the_row(name, rng):
    spec, s = numbers(name)
    r, oracle = jb.parity_relations(jb.LinearSystem(**spec), s), Windows(Plant(**spec), s)
    u, _, y = draw(oracle.plant, s, 200, rng)
    y[rng.uniform(size=y.shape) < 0.08] = np.nan
    status, slack = last(jb.detect(r, u, y).status), oracle.slack(u, y)
    clear = (abs(slack) > 1e-9) & (status != Status.MISSING)
    np.testing.assert_array_equal(status[clear], np.where(slack > 0, Status.FAULT, Status.CONSISTENT)[clear])
    assert (slack[status == Status.MISSING] <= 1e-9).all() and clear.mean() > 0.9


@pytest.mark.parametrize(
    "size, T",
    [
        (1e6, 400),
        pytest.param(1.0, 4000, marks=pytest.mark.long),
        pytest.param(1e6, 4000, marks=pytest.mark.long),
    ],
)
def test_no_unknown_input_raises_an_alarm_and_a_bias_does(size, T):
    m = jb.LinearSystem(
        [[0.9, 0.1], [0, 0.8]], [[0], [1]], [[1, 0], [0, 1], [1, 1]], noise=0.01, unknown_inputs=[[1], [0]]
    )
    u, v = np.sin(np.arange(T) / 9)[:, None], size * np.random.default_rng(3).normal(size=(T, 1))
    r, key = jb.parity_relations(m, 2), jax.random.key(5)
    healthy = jb.simulate(m, u, key, at="vertices", unknown_input=v)
    np.testing.assert_array_equal(healthy.unknown_input, v)
    assert not (jb.detect(r, u, healthy.y).status == Status.FAULT).any()
    ill = jb.simulate(
        m, u, key, at="vertices", unknown_input=v, faults=[jb.Fault("y2", size=1.0, start=T // 4)]
    )
    assert jb.detect(r, u, ill.y).status[T // 4] == Status.FAULT


def test_an_unknown_input_is_drawn_where_none_is_given():
    m = paper(unknown_inputs=[[0], [1]])
    t = jb.simulate(m, np.zeros((3, 500, 1)), jax.random.key(0))
    assert t.unknown_input.shape == (3, 500, 1) and 0.9 < float(t.unknown_input.std()) < 1.1
    assert jb.simulate(paper(), np.zeros((5, 1)), jax.random.key(0)).unknown_input.shape == (5, 0)


def test_a_witness_tells_the_unknown_inputs():
    m = jb.LinearSystem([[1]], None, [[1]], noise="1/10", unknown_inputs=([[1]], [[0]]))
    with pytest.raises(
        ValueError, match="no horizon gives a relation: 1 unknown inputs can explain whatever 1 outputs show"
    ):
        jb.parity_relations(m)
    m = jb.LinearSystem([[1]], None, [[1], [1]], noise="1/10", unknown_inputs=[[1]])
    c = jb.detect(jb.parity_relations(m, 2), None, [[0.0, 0.1], [5.0, 5.0], [3.0, 3.1]]).explain(2)
    assert len(c.unknown_inputs) == 2 and abs(float(c.unknown_inputs[0][0]) - 5) < 0.3 and c.inputs == ()


@pytest.mark.parametrize(
    "given, said",
    [
        ([[1]], "F of the unknown inputs needs one row per state .2.: it has 1"),
        (
            ([[1], [0]], [[1]]),
            "D_v of the unknown inputs must have shape .2, 1. to fit C and F: its shape is .1, 1.",
        ),
        (([[1], ["x"]]), "F of the unknown inputs: 'x' is not a finite number"),
    ],
)
def test_what_does_not_fit_is_refused(given, said):
    with pytest.raises(ValueError, match=said):
        paper(unknown_inputs=given)


def test_a_horizon_without_a_relation_names_the_first_that_has_one():
    with pytest.raises(
        ValueError,
        match="horizon 0 gives no relation: 2 samples do not outnumber 2 states and unknown inputs; .* is 1",
    ):
        jb.parity_relations(paper(unknown_inputs=[[0], [1]]), 0)
    with pytest.raises(ValueError, match=r"unknown_input must have shape \(5, 1\): its shape is \(4, 1\)"):
        jb.simulate(
            paper(unknown_inputs=[[0], [1]]),
            np.zeros((5, 1)),
            jax.random.key(0),
            unknown_input=np.zeros((4, 1)),
        )


def test_a_model_file_keeps_the_unknown_inputs(tmp_path):
    for given in ([[0], ["1/3"]], ([[0], [1]], [[1], [0]])):
        m = paper(unknown_inputs=given)
        jb.save_model(m, tmp_path / "m.toml")
        again = jb.load_model(tmp_path / "m.toml")
        assert (again.F, again.D_v, again.d) == (m.F, m.D_v, 1)
    text = (tmp_path / "m.toml").read_text()
    (tmp_path / "m.toml").write_text(text[: text.index("F = ")] + text[text.index("D_v = ") :])
    with pytest.raises(
        ValueError, match="D_v says how unknown inputs act on the outputs: it needs F beside it"
    ):
        jb.load_model(tmp_path / "m.toml")


@pytest.mark.parametrize(
    "change, method",
    [({}, "box"), pytest.param({"constant_tolerance": True}, "joint", marks=pytest.mark.long)],
)
def test_other_methods_are_silent_about_unknown_inputs_too(change, method, rng):
    m = jb.LinearSystem(
        [[0.9, 0.1], [0, 0.8]],
        [[0], [1]],
        [[1, 0], [0, 1], [1, 1]],
        noise=0.01,
        tolerance=0.02,
        unknown_inputs=[[1], [0]],
        **change,
    )
    x, y, u = np.array([1.0, 0.5]), [], rng.normal(size=(12, 1))
    theta = 0.019 * rng.choice([-1, 1], 3)
    for now in u:
        y.append(np.array([x[0], x[1], x.sum()]) * (1 + theta) + 0.009 * rng.choice([-1, 1], 3))
        x = np.array([0.9 * x[0] + 0.1 * x[1] + 5 * rng.normal(), 0.8 * x[1] + now[0]])
    y = np.array(y)
    r = jb.parity_relations(m, 2)
    assert not (jb.detect(r, u, y, method=method).status == Status.FAULT).any()
    y[6:, 1] += 3
    assert (jb.detect(r, u, y, method=method).status[6:9] == Status.FAULT).any()
