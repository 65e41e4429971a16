"""The hint on units costs less than what it is a hint on, and says the same."""

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

    def none(*about):
        raise AssertionError("a frame is made for windows that lack samples")

    monkeypatch.setattr(exchange, "reframe", none)
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
        return drive(test, recording, *more)

    drive = units.drive
    monkeypatch.setattr(units, "drive", counting)
    tries = len(units._tried(relations.model, np.zeros((1, 1, 3)), np.dtype(float))[0])
    assert units.unit_hints(result) == []
    assert tested[0] == tries * units.FEW
    assert sum(tested[1:]) <= 2 * units.STRETCHES * units.LONG  # dead outputs alone explain the rest
