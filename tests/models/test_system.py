"""The model at its door: exact decimals in, sentences out."""

import copy
import pickle
from decimal import Decimal
from fractions import Fraction
from functools import partial

import jax
import numpy as np
import pytest
from systems import PAPER, paper

import jaxbound as jb


def test_a_float_means_its_shortest_decimal():
    m = jb.LinearSystem([[0.8]], [[0.1]], [[1e-3]], noise=0.7, tolerance=0.02)
    assert (m.A[0][0], m.B[0][0], m.C[0][0]) == (Fraction(4, 5), Fraction(1, 10), Fraction(1, 1000))
    assert (m.noise, m.tolerance) == ((Fraction(7, 10),), (Fraction(1, 50),))


def test_float32_means_its_own_shortest_decimal():
    assert jb.LinearSystem(np.array([[0.8]], np.float32), None, [[1]]).A[0][0] == Fraction(4, 5)


@pytest.mark.parametrize("number", [Fraction(1, 3), "1/3"])
def test_exact_numbers_are_taken_as_they_are(number):
    m = jb.LinearSystem([[number]], None, [[Decimal("0.25")]], noise=number, offset={"y": [number]})
    assert m.A[0][0] == m.noise[0] == m.offset["y"][0] == Fraction(1, 3) and m.C[0][0] == Fraction(1, 4)


def test_sizes_and_default_names():
    m = paper()
    assert (m.n, m.m, m.p, m.dt) == (2, 1, 2, 0.01)
    assert (m.inputs, m.outputs, m.states) == (("u1",), ("y1", "y2"), ("x1", "x2"))


def test_without_b_there_are_no_inputs():
    m = paper(B=None)
    assert m.m == 0 and m.inputs == () and not m.has_feedthrough


def test_feedthrough_is_a_d_that_is_not_zero():
    assert (
        not paper().has_feedthrough
        and not paper(D=[[0], [0]]).has_feedthrough
        and paper(D=[[0], [1]]).has_feedthrough
    )


def test_one_bound_serves_every_output():
    assert paper(noise=0.5, tolerance=0.1, resolution=0.01).noise == (Fraction(1, 2),) * 2


@pytest.mark.parametrize(
    "change, message",
    [
        (dict(A=[[1, 2, 3], [4, 5, 6]]), r"A must be square, one row per state: its shape is \(2, 3\)"),
        (dict(B=[[1], [2], [3]]), r"B must have shape \(2, 1\) .* its shape is \(3, 1\)"),
        (dict(C=[[1, 0, 0]]), r"C must have shape \(1, 2\) .* its shape is \(1, 3\)"),
        (dict(D=[[1]]), r"D must have shape \(2, 1\) .* its shape is \(1, 1\)"),
        (dict(C=[]), "the model has no output"),
        (dict(A=[[1, 2], [3]]), "A: rows have different lengths"),
        (dict(A=[[float("nan"), 0], [0, 1]]), "A: nan is not a finite number"),
        (dict(B=[["one"], [0]]), "B: 'one' is not a finite number"),
        (dict(noise=[0.1, -0.1]), "noise must be >= 0: output 'y2' has -0.1"),
        (dict(tolerance=[1, 0]), "tolerance is relative and must be below 1 .* 'y1' has 1"),
        (dict(noise=[0.1, 0.2, 0.3]), "noise needs one number, or one for each of y1, y2: 3 given"),
        (dict(resolution=float("inf")), "resolution: inf is not a finite number"),
        (dict(dt=0), "dt must be a positive number of seconds, not 0"),
        (dict(outputs=("a", "a")), "outputs must have different names"),
        (dict(outputs=("u1", "b")), "a signal name may stand for one signal only: 'u1' is used twice"),
        (dict(outputs=("a",)), "outputs needs 2 names, one for each: 1 given"),
        (dict(offset={"x": [1]}), r"offset has the fields 'u' and 'y', not \['x'\]"),
        (dict(offset={"y": [1]}), "offset y needs one number, or one for each of y1, y2: 1 given"),
        (dict(units={"y7": "K"}), "units speaks of 'y7', but the model knows only"),
        (dict(columns={"speed": "n"}), "columns speaks of 'speed', but the model knows only"),
    ],
)
def test_a_model_that_does_not_fit_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        jb.LinearSystem(**{**PAPER, **change})


@pytest.mark.parametrize(
    "bound, pairs",
    [
        (0.1, [("-1/10", "1/10")] * 2),
        ([0.1, "1/3"], [("-1/10", "1/10"), ("-1/3", "1/3")]),
        ([[0, 0.2], [-1, 0]], [("0", "1/5"), ("-1", "0")]),
    ],
)
def test_a_disturbance_has_a_pair_of_exact_bounds_a_column(bound, pairs):
    m = paper(disturbance=([[1, 0], [0.5, 2]], bound))
    assert [tuple(map(str, pair)) for pair in m.disturbance] == pairs
    assert (m.g, m.G) == (2, ((1, 0), (Fraction(1, 2), 2)))


@pytest.mark.parametrize(
    "disturbance, message",
    [
        ([[1], [0]], "G of the disturbance needs one row per state"),
        (3, "disturbance needs a pair"),
        (([[1]], 0.1), "G of the disturbance needs one row per state"),
        (([[1], [0]], [0.1, 0.2]), "needs one number, or one .* for each of 1 columns of G, not 2"),
        (([[1], [0]], -0.1), "disturbance 1: the bound must be >= 0, not -0.1"),
        (([[1], [0]], [[0.2, 0.1]]), r"disturbance 1: lo must be <= hi, not \[0.2, 0.1\]"),
        (([[1], [0]], [[0, 1, 2]]), "disturbance 1: a bound is one number or a pair"),
        (([[1], [0]], float("inf")), "disturbance 1: .*not a finite number"),
    ],
)
def test_a_disturbance_that_does_not_fit_is_refused(disturbance, message):
    with pytest.raises(ValueError, match=message):
        paper(disturbance=disturbance)


def test_units_and_columns_are_found_by_name():
    m = paper(units={"y1": "K"}, columns={"u1": "valve"})
    assert (m.unit("y1"), m.unit("y2"), m.column("u1"), m.column("y1")) == ("K", "", "valve", "y1")


HEATER = dict(
    A=[[0.9, "1/3"], [0, 0.2]],
    B=[[0], [1]],
    C=[[1, 0], [1, 1]],
    D=[[0], [0.5]],
    dt="1/3",
    tolerance=[0.02, 0.1],
    noise=[0.1, "1e-7"],
    resolution=0.005,
    unknown_inputs=([[0], [1]], [[1], [0]]),
    disturbance=([[1], [0]], [[0, 0.2]]),
    inputs=["power"],
    outputs=["air", "wall"],
    states=["air", "core"],
    units={"air": "K", "power": "W", "core": "K"},
    offset={"y": [20, "1/3"]},
    uncertainties=[
        jb.Uncertainty("loss", A=[[1, 0], [0, 0]], between=("0.1", "0.3")),
        jb.Uncertainty("gain", B=[[0], [1]], varying=False),
    ],
    columns={"wall": "= `Wall (F)` * 5 / 9", "where": "fan > 0", "time": "t"},
    provenance={"noise": "datasheet", "model": "assumed"},
    name="heater",
    horizon=7,
)
MODELS = {
    "paper": PAPER,
    "heater": HEATER,
    "without inputs": {**PAPER, "B": None, "constant_tolerance": True},
    "without states": dict(A=None, B=None, C=None, D=[[1, 2], [0.5, 0]], noise=0.1, units={"u1": "A"}),
    "descriptor": dict(A=[[1, 0], [0, 1]], B=[[0], [1]], C=[[1, 1]], E=[[1, 0], [0, 0]], states=["a", "b"]),
    "not trusted": {**HEATER, "decouple": "loss", "unknown_inputs": None},
}


def reloaded(model, path):
    jb.save_model(model, path / "model.toml")
    return jb.load_model(path / "model.toml")


@pytest.fixture(params=MODELS)
def given(request):
    return MODELS[request.param]


@pytest.mark.parametrize(
    "again",
    [copy.copy, copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m)), lambda m: m.replace()],
    ids=["copy", "deep copy", "pickle", "replace"],
)
def test_a_model_equals_its_copies(given, again):
    model = jb.LinearSystem(**given)
    other = again(model)
    assert other == model and hash(other) == hash(model) and len({model, other}) == 1


def test_a_model_equals_its_reloaded_file(given, tmp_path):
    model = jb.LinearSystem(**given)
    other = reloaded(model, tmp_path)
    assert other == model and hash(other) == hash(model)


def test_a_model_equals_one_from_the_same_numbers_written_otherwise():
    exact = paper(
        A=[["8/10", Fraction(1)], [0, Decimal("0.20")]],
        noise=np.array([0.1, 0.01]),
        tolerance=["0.02", "1/10"],
        D=np.zeros((2, 1)),
    )
    assert exact == paper() and hash(exact) == hash(paper())


def test_the_order_in_which_a_model_is_told_does_not_matter():
    backwards = {
        k: dict(reversed(v.items())) if isinstance(v, dict) else v for k, v in reversed(HEATER.items())
    }
    one, other = jb.LinearSystem(**HEATER), jb.LinearSystem(**backwards)
    assert one == other and hash(one) == hash(other)


def test_a_model_is_not_what_it_is_not():
    nothing = None
    assert paper() != paper(noise=["0.1", "0.010000000000000000001"])
    assert paper() != "model" and paper() != nothing


@pytest.mark.parametrize(
    "name", ["A", "noise", "offset", "units", "n", "name", "plant", "sensors", "signals", "anything"]
)
def test_nothing_of_a_model_is_set(name):
    model = paper()
    with pytest.raises(
        AttributeError,
        match=rf"^a LinearSystem is a value: {name} cannot be set; model.replace\(noise=..\) makes a changed "
        rf"copy$",
    ):
        setattr(model, name, 1)
    with pytest.raises(AttributeError, match="is a value"):
        delattr(model, name)
    assert model == paper()


@pytest.mark.parametrize(
    "change",
    [
        lambda m: m.offset.update(u=(1,)),
        lambda m: m.units.__setitem__("air", "degC"),
        lambda m: m.columns.clear(),
        lambda m: m.provenance.__setitem__("noise", "fitted"),
        lambda m: m.A[0].__setitem__(0, 1),
        lambda m: setattr(m.plant, "A", ()),
        lambda m: setattr(m.sensors, "noise", ()),
        lambda m: setattr(m.signals, "inputs", ()),
        lambda m: setattr(m.uncertainties[0], "name", "k"),
    ],
)
def test_nothing_inside_a_model_is_written(change):
    model = jb.LinearSystem(**HEATER)
    with pytest.raises((TypeError, AttributeError)):
        change(model)
    assert model == jb.LinearSystem(**HEATER)


def test_a_changed_copy_is_the_model_of_the_changed_arguments():
    changes = dict(
        A=[[0.7, 0], [0, 0.1]],
        noise=0.3,
        uncertainties=[jb.Uncertainty("loss", A=[[1, 0], [0, 0]], between=(2, 3))],
        provenance={"noise": "fitted"},
        horizon=None,
        offset={"u": 3},
    )
    for name, value in changes.items():
        changed = jb.LinearSystem(**HEATER).replace(**{name: value})
        assert changed == jb.LinearSystem(**{**HEATER, name: value}), name


def test_a_changed_copy_is_checked_like_any_model():
    with pytest.raises(ValueError, match="noise must be >= 0: output 'y2' has -1"):
        paper().replace(noise=[1, -1])
    with pytest.raises(TypeError, match="noize"):
        paper().replace(noize=1)


def test_an_equal_model_as_static_argument_is_not_traced_again():
    traced = []

    @partial(jax.jit, static_argnums=0)
    def first_bound(model, x):
        traced.append(model)
        return x + float(model.noise[0])

    for model in (paper(), paper(), copy.deepcopy(paper()), paper(noise=[0.2, 0.01])):
        assert float(first_bound(model, 0.0)) == float(model.noise[0])
    assert len(traced) == 2
