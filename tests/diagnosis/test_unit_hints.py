"""The hint on units costs less than what it is a hint on, and says the same."""

import copy

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.consistency import exchange, interface
from jaxbound.diagnosis import units

HORIZON, NIGHT = 20, 60


@pytest.fixture(scope="module")
def relations():
    """Return relations over windows whose combinations are too many to list: a search decides them."""
    model = jb.LinearSystem(
        [[0.9, 0.1], [0, 0.8]],
        [[0], [1]],
        np.eye(2),
        noise=0.1,
        inputs=["u"],
        outputs=["T1", "T2"],
        units={"T1": "degC", "T2": "degC"},
    )
    found = jb.parity_relations(model, HORIZON)
    assert found.frame is not None
    return found


def day(rng, relations, shift):
    """Return (u, y) of a day after a night without samples, T1 and T2 shown with a shift."""
    model, samples = relations.model, 220
    u, x, y = rng.uniform(0, 1, (samples, 1)), np.zeros(2), np.zeros((samples, 2))
    A, B = (np.array(matrix, float) for matrix in (model.A, model.B))
    for k in range(samples):
        y[k] = x + rng.uniform(-0.05, 0.05, 2)
        x = A @ x + B @ u[k]
    y += shift
    u[:NIGHT], y[:NIGHT] = np.nan, np.nan
    return u, y


def test_windows_without_a_sample_are_not_tested_again(relations, rng, monkeypatch):
    result = jb.detect(relations, *day(rng, relations, 273.15), starts=[NIGHT])
    assert result.counts["FAULT"] > 50

    def whole(test, recording):
        assert not np.isnan(recording.y).any()
        return as_stated(test, recording)

    as_stated = units.as_stated
    monkeypatch.setattr(units, "as_stated", whole)
    (hint,) = units.unit_hints(result)
    assert "T1 and T2 look like kelvin where the model has degC" in hint


def test_a_hint_compiles_nothing_that_the_verdicts_did_not_need(relations, rng, monkeypatch):
    def none(*about):
        raise AssertionError("easy windows have kernels of their own")

    monkeypatch.setattr(interface, "MANY", 2**17)  # tests have it lower
    monkeypatch.setattr(exchange, "easy_by", none)
    result = jb.detect(relations, *day(rng, relations, 273.15), starts=[NIGHT])
    assert len(units.unit_hints(result)) == 1


def test_a_wrong_conversion_costs_a_few_windows(relations, rng, monkeypatch):
    u, y = day(rng, relations, 0.0)
    y[:, 0] += rng.choice([-3.0, 3.0], len(y))  # no unit explains it
    result = jb.detect(relations, u, y, starts=[NIGHT])
    tested = []

    def counting(test, recording, *more):
        tested.append(recording.y[..., 0].size / recording.y.shape[-2] * (recording.y.shape[-2] - HORIZON))
        return as_stated(test, recording, *more)

    as_stated = units.as_stated
    monkeypatch.setattr(units, "as_stated", counting)
    tries = len(units._tries(relations.model))
    assert units.unit_hints(result) == []
    assert tested[0] == tries * 8  # one more than 5 % of 140
    assert sum(tested[1:]) <= 2 * units.MANY  # dead outputs alone explain the rest


@pytest.mark.parametrize("weight, said", [(1, 1), (30, 1), (1000, 0)])
def test_windows_that_are_searched_long_are_fewer(relations, rng, monkeypatch, weight, said):
    """The work is bounded: where a window costs as much as many small ones, fewer are judged, or none."""
    result = jb.detect(relations, *day(rng, relations, 273.15), starts=[NIGHT])
    heavy, tries = copy.copy(relations.test("joint", float)), len(units._tries(relations.model))
    heavy.weight = weight
    monkeypatch.setattr(type(relations), "test", lambda *given: heavy)
    work = []

    def counting(relations, windows):
        work.append(windows.shape[0] * windows.shape[1] * weight)
        return consistent(relations, windows)

    consistent = units._consistent
    monkeypatch.setattr(units, "_consistent", counting)
    assert len(units.unit_hints(result)) == said
    assert max(work, default=0) <= 2**13 and (weight * tries > 2**13 or work)


@pytest.fixture(scope="module")
def plant():
    """Return a plant of two inputs and two outputs that its monitor watches by windows and lags."""
    return jb.LinearSystem(
        [["0.9", "0.05"], [0, "0.8"]],
        [["0.2", 0], [0, "0.5"]],
        np.eye(2),
        noise=0.1,
        inputs=["Q1", "Q2"],
        outputs=["T1", "T2"],
        units={"T1": "degC", "T2": "degC"},
        offset={"u": [40, 60], "y": [30, 45]},
        tests=[{"name": "short", "horizon": 3}, {"name": "slow", "lags": [0, 1, 2, 4, 8]}],
    )


def recorded(plant, rng, samples=150):
    u = np.repeat(rng.uniform(20, 80, (samples // 10, 2)), 10, 0)
    x, y = np.zeros(2), np.zeros((samples, 2))
    A, B = (np.array(matrix, float) for matrix in (plant.A, plant.B))
    rest_u, rest_y = (np.array(plant.offset[side], float) for side in "uy")
    for k in range(samples):
        y[k] = rest_y + x + rng.uniform(-0.05, 0.05, 2)
        x = A @ x + B @ (u[k] - rest_u)
    return u, y


@pytest.mark.parametrize(
    "mistake, sentence",
    [
        (lambda u, y: (u, y + 273.15), "T1 and T2 look like kelvin where the model has degC"),
        (lambda u, y: (u, y * 9 / 5 + 32), "T1 and T2 look like degF where the model has degC"),
        (lambda u, y: (u[:, ::-1], y), "the columns of Q1 and of Q2 look exchanged"),
        (lambda u, y: (u, y[:, ::-1]), "the columns of T1 and of T2 look exchanged"),
        (lambda u, y: (y, u), "the columns of Q1, Q2 and of T1, T2 look exchanged"),
        (lambda u, y: (np.c_[y[:, 0], u[:, 1]], np.c_[u[:, 0], y[:, 1]]), "of Q1 and of T1 look exchanged"),
    ],
)
def test_a_monitor_has_the_hints_of_one_test(plant, rng, mistake, sentence):
    u, y = mistake(*recorded(plant, rng))
    for relations in (jb.parity_relations(plant, 3), jb.monitor(plant)):
        hints = [hint for hint in jb.detect(relations, u, y).hints if sentence in hint]
        assert len(hints) == 1 and "100 % of the windows are consistent" in hints[0]


def test_all_fault_names_units_and_columns_as_a_cause(plant, rng):
    """A healthy recording has no such hint, and neither has one that a fault explains best."""
    u, y = recorded(plant, rng)
    assert not any("exchanged" in hint for hint in jb.detect(jb.monitor(plant), u, y).hints)
    result = jb.detect(jb.monitor(plant), u, y + rng.uniform(5, 40, y.shape))
    (hint,) = [hint for hint in result.hints if "samples with data" in hint]
    assert "another unit, or another signal" in hint and "jaxbound info" in hint


def test_a_difference_of_columns_has_no_zero_that_a_unit_moves():
    """32 degF less of a lift is no lift in degC: a fault that looks like it is none of units."""
    model = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1, outputs=["lift"])
    lift = model.replace(columns={"lift": "= `supply` - `mixed`"})
    shifted = [[bool(way.shift) for way in units._conversions(m, (1,))] for m in (model, lift)]
    assert any(shifted[0]) and shifted[1] and not any(shifted[1])


def test_a_conversion_that_only_the_wider_bounds_outside_explain_is_no_hint(rng):
    """As percent the input is far outside of training, where bounds are four times as wide."""
    model = jb.LinearSystem([[0]], [[1]], [[1]], noise=1, inputs=["u"], ranges={"u": (0, 0.01)})
    relations = jb.parity_relations(model.replace(extrapolation=2), 1)
    u = rng.uniform(0.002, 0.01, (80, 1))
    result = jb.detect(relations, u, np.full((80, 1), 2.5))
    assert result.counts["FAULT"] > 70
    assert jb.detect(relations, 100 * u, np.full((80, 1), 2.5)).counts["FAULT"] == 0
    assert units.unit_hints(result) == []
