"""An input that a controller makes of past outputs is named, one that moves by itself is not."""

import numpy as np

import jaxbound as jb
from jaxbound.studies.identification.closed_loop import closed_loops


def recorded(rng, gain, T=400):
    """Return (u (T, 2), y (T, 1)): a valve, fed back by a gain or free, and weather that nobody sets."""
    u, y = np.zeros((T, 2)), np.zeros((T, 1))
    u[:, 1] = np.cumsum(rng.normal(size=T)) / 10
    for k in range(1, T):
        y[k] = 0.9 * y[k - 1] + 0.3 * u[k - 1, 0] + 0.2 * u[k - 1, 1] + rng.uniform(-0.05, 0.05)
        u[k, 0] = -gain * y[k - 1, 0] + 0.01 * rng.normal()
        if not gain:
            u[k, 0] = u[k - 1, 0] if k % 20 else rng.normal()
    return u, y


def test_the_input_of_a_controller_is_named(rng):
    sentences = jb.fit(
        recorded(rng, 2.0),
        order=1,
        horizon=4,
        inputs=["valve", "weather"],
        outputs="T",
        method="least squares",
    ).check.sentences
    (sentence,) = [s for s in sentences if "closed loop" in s]
    assert sentence.startswith("valve follows T: the past of T leaves 0.")
    assert sentence.endswith("fit again with valve in --outputs, outputs=['T', 'valve']")


def test_inputs_that_move_by_themselves_are_not(rng):
    u, y = recorded(rng, 0.0)
    assert list(closed_loops([(u, y, np.zeros(0, int))], ["valve", "weather"], ["T"])) == []


def test_little_is_said_of_few_samples(rng):
    u, y = recorded(rng, 2.0, 60)
    assert list(closed_loops([(u, y, np.zeros(0, int))], ["valve", "weather"], ["T"])) == []
