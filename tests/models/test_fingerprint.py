"""One fingerprint of a model: every field of it counts, exactly, and so does everything else that decides
verdicts.
"""

import inspect
from fractions import Fraction

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.files.checkpoint import differences
from jaxbound.models.fingerprint import fingerprint
from jaxbound.relations.identity import identity

FEW = jb.Uncertainty("k", B=[[1], [0]])
BASE = dict(
    A=[["1/2", 1], [0, "0.2"]],
    B=[[0], [1]],
    C=[[1, 0], [1, 1]],
    D=[[0], [0]],
    dt=0.01,
    tolerance=[0.02, 0.1],
    noise=[0.1, 0.01],
    times=None,
    constant_tolerance=False,
    resolution=None,
    E=None,
    unknown_inputs=[[0], [1]],
    disturbance=([[1], [0]], [0.01]),
    uncertainties=[FEW],
    decouple=(),
    inputs=["u"],
    outputs=["a", "b"],
    states=["p", "q"],
    units={"a": "bar"},
    offset={"y": [1, 0]},
    columns={"a": "A"},
    ranges=None,
    provenance={"noise": "datasheet"},
    name="plant",
    horizon=3,
)
CHANGES = dict(
    times={"a": "1 + abs(load)"},
    A=[["0.5", 1], [0, "0.20000000000000000001"]],
    B=[[0], [2]],
    C=[[1, 0], [1, 2]],
    D=[[0], [1]],
    dt=0.02,
    tolerance=[0.02, 0.11],
    noise=["0.1", "0.010000000000000000001"],
    constant_tolerance=True,
    resolution=0.001,
    E=[[2, 0], [0, 1]],
    unknown_inputs=[[1], [1]],
    disturbance=([[1], [0]], [[0, 0.01]]),
    uncertainties=[jb.Uncertainty("k", B=[[1], [0]], varying=False)],
    decouple=("k",),
    inputs=["v"],
    outputs=["a", "c"],
    states=["p", "r"],
    units={"a": "Pa"},
    offset={"y": [1, 2]},
    columns={"a": "B"},
    ranges={"u": ("0", "1.5")},
    provenance={"noise": "fitted"},
    name="other",
    horizon=4,
    lags=(0, 1, 3),
    left_out="1.3",
    extrapolation="1.4",
    averages={"w1": {2: 0.005}},
    tests=[{"name": "slow", "horizon": 5, "factor": 1.2}],
    faults=[jb.NamedFault("valve leaks", input="u", kind="offset", sign="+")],
    alarms={"rule": "3/5"},
)
WITHOUT = ("E", "averages", "times")
FIELDS = [name for name in inspect.signature(jb.LinearSystem.__init__).parameters if name != "self"]


def model(field=None):
    given = dict(BASE, **({} if field is None else {field: CHANGES[field]}))
    if field in WITHOUT:  # not together with uncertainties: compared with the same model without it
        given["uncertainties"] = ()
    return jb.LinearSystem(**given)


@pytest.mark.parametrize("field", FIELDS)
def test_every_argument_of_a_model_changes_it(field):
    before = jb.LinearSystem(**dict(BASE, uncertainties=())) if field in WITHOUT else model()
    assert fingerprint(model(field)) != fingerprint(before)
    assert model(field) != before and model(field) == model(field)


@pytest.mark.parametrize(
    "change",
    [
        dict(name="j"),
        dict(B=[[2], [0]]),
        dict(A=[[0, 1], [0, 0]]),
        dict(C=[[0, 1], [0, 0]]),
        dict(D=[[1], [0]]),
        dict(varying=False),
        dict(between=(-1, "1.00000000000000000001")),
    ],
)
def test_every_field_of_an_uncertainty_changes_it(change):
    assert set(inspect.signature(jb.Uncertainty).parameters) == {
        "name",
        "A",
        "B",
        "C",
        "D",
        "varying",
        "between",
    }
    other = jb.Uncertainty(**{**dict(name="k", B=[[1], [0]]), **change})
    assert fingerprint(jb.LinearSystem(**dict(BASE, uncertainties=[other]))) != fingerprint(model())
    assert (
        other != FEW
        and other == jb.Uncertainty(**{**dict(name="k", B=[[1], [0]]), **change})
        and hash(other) != hash(FEW)
    )


def test_a_model_through_its_file_keeps_it(tmp_path):
    jb.save_model(model(), tmp_path / "plant.toml")
    assert fingerprint(jb.load_model(tmp_path / "plant.toml")) == fingerprint(model())


@pytest.mark.parametrize(
    "one, other",
    [
        ((1, "1"), (1, 1)),
        (("ab", "c"), ("a", "bc")),
        (((1,), 2), ((1, 2),)),
        (({"a": 1},), ({"a": 2},)),
        ((True,), (1,)),
        ((1.0,), (1,)),
        ((0.0,), (-0.0,)),
        ((Fraction(1, 3),), (1 / 3,)),
        ((np.zeros(2),), (np.zeros(2, np.float32),)),
        ((np.zeros((2, 1)),), (np.zeros(2),)),
        ((np.array([0.0]),), (np.array([-0.0]),)),
        ((None,), ()),
    ],
)
def test_things_that_differ_do(one, other):
    assert fingerprint(*one) != fingerprint(*other) and fingerprint(*one) == fingerprint(*one)


def test_what_nobody_knows_is_refused():
    with pytest.raises(TypeError, match="no fingerprint of a function"):
        fingerprint(lambda x: x)


def test_what_verdicts_depend_on_has_a_name():
    plain = jb.LinearSystem([["1/2"]], None, [[1]], noise=0.1)
    r = jb.parity_relations(plain, 1)
    now = identity(r, method="joint")
    assert differences(now, identity(r, method="joint")) == ""
    assert differences(now, identity(r, method="box")) == "method"
    assert differences(now, identity(r.with_bounds({"noise": 0.2}), method="joint")) == "model"
    assert differences(now, identity(jb.parity_relations(plain, 2), method="joint")) == "horizon"
    assert differences(now | {"version of jaxbound": "0"}, now) == "version of jaxbound"
    assert differences(now | {"precision": "float32"}, now) == "precision"
    assert differences("nothing", now) == "version of jaxbound and model and horizon and precision and method"
