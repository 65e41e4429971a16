"""Disturbances without a width change no verdict."""

import numpy as np
import pytest

import jaxbound as jb

MODEL = jb.LinearSystem(
    [["0.661", "-5.78"], ["-0.0361", "-0.659"]],
    [["0.3"], ["0.045"]],
    [["-0.001", "-0.0061"], [920, 8700]],
    [[0], [-870]],
    noise=["0.000214", 59],
)
DIRECTION = [["0.5"], ["0.013"]]
SLOW = jb.LinearSystem(
    [["0.9", "0.2"], ["-0.1", "0.95"]],
    [[0], [1]],
    [[1, 0]],
    noise="0.1",
    disturbance=([[1], ["0.5"]], "0.02"),
)


def recorded(rng):
    """Return u, y of a recording with faults here and there."""
    u, x, y = rng.uniform(-1, 1, (30, 1)), np.zeros(2), np.zeros((30, 2))
    A, B, C, D = (np.array(getattr(MODEL, name), float) for name in "ABCD")
    for k in range(30):
        y[k] = C @ x + D @ u[k] + rng.uniform(-1, 1, 2) * [0.000214, 59]
        x = A @ x + B @ u[k]
    y[10:20:5, 0] += 0.002
    return u, y


@pytest.mark.parametrize("bound", [0, "1e-300"])
def test_verdicts_of_windows_are_those_without_it(bound, rng):
    u, y = recorded(rng)
    without = jb.detect(jb.parity_relations(MODEL, horizon=4), u, y)
    still = jb.parity_relations(MODEL.replace(disturbance=(DIRECTION, bound)), horizon=4)
    found = jb.detect(still, u, y)
    assert without.counts["UNDECIDED"] == 0 and without.counts["FAULT"] and without.counts["CONSISTENT"]
    np.testing.assert_array_equal(found.status, without.status)
    np.testing.assert_allclose(found.margin, without.margin, rtol=0 if bound == 0 else 1e-9)
    two = MODEL.replace(disturbance=([[*row, "0.1"] for row in DIRECTION], [(0, 0), ("-0.001", "0.001")]))
    one = MODEL.replace(disturbance=([["0.1"], ["0.1"]], "0.001"))
    a, b = (jb.detect(jb.parity_relations(m, horizon=4), u, y) for m in (two, one))
    np.testing.assert_array_equal(a.margin, b.margin)
    wider = still.with_bounds({"disturbance": 1e4})  # what is 0 in the model need not be 0 in other bounds
    assert jb.detect(wider, u, y).counts["FAULT"] < without.counts["FAULT"]


@pytest.mark.parametrize("method", ["zonotope", "joint"])
def test_verdicts_of_observers_are_those_without_it(method, rng):
    """One without a width beside one with a width: of the sizes that tests of observers compile."""
    u = rng.uniform(-1, 1, (60, 1))
    y = np.array(jb.simulate(SLOW, u, 3, at="uniform").y)
    y[40:] += 2
    more = {"window": 8, "order": 6} if method == "joint" else {}
    without = jb.detect(jb.observer(SLOW, method=method, **more), u, y)
    beside = SLOW.replace(disturbance=([["1", "0.3"], ["0.5", "0.1"]], ["0.02", 0]))
    found = jb.detect(jb.observer(beside, method=method, **more), u, y)
    assert without.counts["FAULT"] > 0
    np.testing.assert_array_equal(found.status, without.status)
