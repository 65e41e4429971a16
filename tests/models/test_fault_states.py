"""Faults as states: an observer encloses a bias that is there, and says that the others are not."""

from fractions import Fraction

import jax
import numpy as np
import pytest

import jaxbound as jb

PLANT = jb.LinearSystem([["0.9", "0.1"], [0, "0.8"]], [[0], [1]], [[1, 0], [1, 0]], [[0], [0]], noise="0.1",
                        outputs=["T1", "T2"], inputs=["heat"], disturbance=([[1], [0]], "0.01"))  # fmt: skip


def test_a_bias_is_enclosed_and_zero_is_not():
    faulty = [jb.Fault("T2", "bias", 0.8, start=60)]
    u = np.ones((200, 1))
    found = jb.simulate(PLANT, u, jax.random.key(0), faults=faulty)
    model = jb.with_faults(PLANT, "T2:drift", rate=0.02)
    told = jb.observe(model, found.u, found.y, order=10, x0=jb.interval([-50, -50, -5], [50, 50, 5]))
    lo, hi = np.asarray(told.state.lo)[:, 2], np.asarray(told.state.hi)[:, 2]
    jump = told.status[60:65] == jb.Status.FAULT  # a jump is no drift of 0.02 a sample
    assert (lo[5:60] < 0).all() and (hi[5:60] > 0).all() and jump.any()
    slow = np.array(jb.simulate(PLANT, u, jax.random.key(1)).y)
    truth = np.clip(0.015 * (np.arange(200) - 60), 0, 0.9)
    slow[:, 1] += truth
    told = jb.observe(model, u, slow, order=10, x0=jb.interval([-50, -50, -5], [50, 50, 5]))
    lo, hi = np.asarray(told.state.lo)[:, 2], np.asarray(told.state.hi)[:, 2]
    assert not (told.status == jb.Status.FAULT).any()
    assert ((lo <= truth) & (truth <= hi)).all()
    assert (lo[150:] > 0).all() and not (lo[:60] > 0).any() and (hi[150:] - lo[150:] < 1).all()


def test_an_actuator_and_uncertain_parameters_keep_their_faults():
    model = PLANT.replace(uncertainties=[jb.Uncertainty("gain", B=[[0], ["0.1"]])])
    grown = jb.with_faults(model, "heat:bias", "T1:bias")
    assert grown.A[1] == (0, Fraction(8, 10), 1, 0) and grown.A[2] == (0, 0, 1, 0) and grown.C[0] == (1, 0, 0, 1)
    (gain,) = grown.uncertainties
    assert gain.A[1] == (0, 0, Fraction(1, 10), 0) and gain.B[1] == (Fraction(1, 10),) and gain.C is None
    assert grown.states == ("x1", "x2", "heat:bias", "T1:bias") and grown.disturbance == model.disturbance
    # it is the model itself, with the fault in its input
    u = np.ones((50, 1))
    plain, key = PLANT.replace(noise=0, disturbance=None), jax.random.key(0)
    want = jb.simulate(plain, u + 0.5, key).y
    got = jb.simulate(jb.with_faults(plain, "heat:bias"), u, key, x0=[0, 0, 0.5]).y
    np.testing.assert_allclose(got, want, rtol=1e-12)


@pytest.mark.parametrize(
    "match, faults, more",
    [
        ("no 'T3'|T3", ["T3:bias"], {}),
        ("'signal:bias' or 'signal:drift'", ["T1:stuck"], {}),
        ("named twice", ["T1:bias", "T1:bias"], {}),
        ("at least", [], {}),
        ("needs a rate", ["T1:drift"], {}),
        ("rate is for drifts", ["T1:bias"], {"rate": 1}),
        ("rate is for drifts, and T2", ["T1:drift"], {"rate": {"T1": 1, "T2": 1}}),
        ("must be >= 0", ["T1:drift"], {"rate": -1}),
    ],
)
def test_what_is_no_fault_is_said(match, faults, more):
    with pytest.raises(ValueError, match=match):
        jb.with_faults(PLANT, *faults, **more)
