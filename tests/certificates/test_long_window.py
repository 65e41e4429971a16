"""What contradicts all samples since an observer began, as one relation: fractions replay it, a linear
program agrees how clear it is.
"""

import json
from fractions import Fraction

import jax
import numpy as np
import pytest
from check_certificate import confirm
from scipy.optimize import linprog

import jaxbound as jb
from jaxbound.certificates.interface import certify
from jaxbound.certificates.long_window import LongCertificate, stretch

PLANT = jb.LinearSystem(
    [["0.98", "0.05"], ["-0.02", "0.97"]],
    [[0], ["0.1"]],
    [[1, 0]],
    [["0.2"]],
    noise="0.1",
    tolerance="0.01",
    disturbance=([[1], ["0.5"]], [["-0.002", "0.003"]]),
    offset={"u": 1, "y": 20},
)


def recorded(T, bias, seed=0):
    """Return u, y of a plant whose sensor goes wrong slowly from the middle on."""
    u = 1 + np.random.default_rng(seed).normal(size=(T, 1))
    y = np.array(jb.simulate(PLANT, u, jax.random.key(seed), at="uniform").y)
    y[T // 2 :, 0] += bias * np.arange(T - T // 2) / (T - T // 2)
    y[3] = np.nan
    return u, y


def needed(u, y, first=None):
    """Return the least factor on all bounds, by a linear program with all unknowns written out as a first
    state and disturbances.
    """
    A, B, C, D, G = (np.array(getattr(PLANT, name), float) for name in "ABCDG")
    s, (lo, hi) = len(y) - 1, map(float, PLANT.disturbance[0])
    X, f, rows, right, widths = np.eye(2, 2 + s), np.zeros(2), [], [], []
    for k in range(s + 1):
        if not np.isnan(y[k, 0]):
            ends = [(y[k, 0] - 20 + e) / (1 + t) for e in (-0.1, 0.1) for t in (-0.01, 0.01)]
            rows, widths = [*rows, C[0] @ X], [*widths, (max(ends) - min(ends)) / 2]
            right.append((max(ends) + min(ends)) / 2 - C[0] @ f - D[0, 0] * (u[k, 0] - 1))
        X, f = A @ X, A @ f + B[:, 0] * (u[k, 0] - 1)
        if k < s:
            X[:, 2 + k] += G[:, 0]
    for i, ends in enumerate(
        [*(first if first is not None else []), *[(lo, hi)] * s], 0 if first is not None else 2
    ):
        rows, right, widths = (
            [*rows, np.eye(2 + s)[i]],
            [*right, sum(ends) / 2],
            [*widths, (ends[1] - ends[0]) / 2],
        )
    rows, right, widths = map(np.array, (rows, right, widths))
    sides = np.concatenate([np.column_stack([sign * rows, -widths]) for sign in (1, -1)])
    return linprog(
        np.eye(3 + s)[-1],
        sides,
        np.concatenate([right, -right]),
        bounds=[(None, None)] * (3 + s),
        method="highs",
    ).fun


@pytest.mark.parametrize("first", [None, [(-3.0, 3.0), (-0.5, 0.5)]])
def test_one_relation_among_all_samples_proves_a_slow_fault(first):
    u, y = recorded(90, 1.5)
    about, t = stretch(PLANT, 89, first), needed(u, y, first)
    found = certify(about, u, y)
    assert (
        type(found) is LongCertificate
        and found.proves == jb.Status.FAULT
        and found.errors == {}
        and found.candidates == ()
    )
    assert 1 < found.factor < t * (1 + 1e-9) and float(found.factor) > t - 1e-4, (
        "short multipliers cost little"
    )
    document = json.loads(found.to_json())
    confirm(document)
    assert ("first_state" in document["numbers"]) == (first is not None)
    numbers = document["numbers"]
    old, numbers["relation"]["h"][0][0] = Fraction(numbers["relation"]["h"][0][0]), "0.5"
    numbers["sum"] = str(Fraction(numbers["sum"]) + Fraction("0.5") - old)
    with pytest.raises(
        ValueError,
        match="the relation leaves an unknown over|does not fit|is wrong",
    ):
        confirm(document)


def test_what_can_be_explained_has_no_such_certificate():
    u, y = recorded(60, 0.0)
    about = stretch(PLANT, 59)
    assert needed(u, y) < 1
    with pytest.raises(
        NotImplementedError,
        match="no relation of these 60 samples is found that proves the FAULT at 59 alone",
    ):
        certify(about, u, y)


def test_every_contradiction_of_an_observer_is_proved_by_samples_since_it_began():
    u, y = recorded(
        64, 1.0, seed=2
    )  # an observer of the sizes, and pieces of the length, that tests of observers compile
    for options in ({}, {"restart": False}, {"x0": jb.interval([-20, -20], [20, 20])}):
        res = jb.detect(jb.observer(PLANT, **options), u, y)
        wrong = np.flatnonzero(res.status == jb.Status.FAULT)
        assert len(wrong)
        for k in wrong[:: max(len(wrong) // 3, 1)]:
            found = res.explain(int(k))
            confirm(json.loads(found.to_json()))
            assert found.at == (k,) and found.window.horizon <= k - res.observation.since[k]
    unsure = PLANT.replace(uncertainties=[jb.Uncertainty("a", A=[["0.01", 0], [0, 0]])])
    res = jb.detect(jb.observer(unsure), np.ones((4, 1)), [[20.0], [20.0], [20.0], [25.0]])
    assert res.status[3] == jb.Status.FAULT and type(res.explain(3)).__name__ == "UncertainCertificate"


def test_gains_that_keep_their_value_are_no_contradiction_and_one_of_them_is_confirmed():
    sensors = dict(tolerance=["1/5"] * 2, noise=["1/100"] * 2, constant_tolerance=True)
    plant = jb.LinearSystem([["9/10"]], [[1]], [[1], [1]], **sensors)
    u, x = np.ones((13, 1)), 10 - 5 * 0.9 ** np.arange(13)
    healthy = np.stack([1.15 * x, 0.9 * x], 1)
    about = stretch(plant, 12)
    with pytest.raises(NotImplementedError, match="no relation of these 13 samples"):
        certify(about, u, healthy)
    apart = np.stack([1.9 * x, 0.9 * x], 1)
    document = json.loads(certify(about, u, apart).to_json())
    confirm(document)


def test_a_short_stretch_knows_averages_and_says_which_sensor_is_wrong():
    steady = jb.LinearSystem([[1]], None, [[1], [1]], noise=1, averages={"y1": {3: "0.1"}, "y2": {3: "0.1"}})
    y = np.tile([[0.0, 0.5]], (6, 1))
    found = certify(stretch(steady, 5), np.zeros((6, 0)), y)
    confirm(document := json.loads(found.to_json()))
    assert document["certificate"] == "FAULT" and document["numbers"]["averages"]
    assert set(found.candidates) == {"y1", "y2"}
    plain = certify(stretch(steady.replace(averages=None), 5), np.zeros((6, 0)), y)
    assert plain.proves == jb.Status.CONSISTENT
