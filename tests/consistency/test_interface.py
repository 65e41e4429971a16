"""A new way to decide windows is one class of tests and one of relations: every verb takes them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbound as jb
from jaxbound.consistency import Judged, WindowTest
from jaxbound.consistency.interface import Relations, refuse_options

MODEL = jb.LinearSystem(None, None, None, D=[[1]], noise=1.0)  # names of signals


@jax.jit
def steps(limit, u, y):
    """Say whether the output moved by more than a limit from one sample to the next."""
    margin = 1 - abs(y[1, 0] - y[0, 0]) / limit
    return jnp.where(jnp.isnan(margin), 0, jnp.where(margin < 0, 3, 1)).astype(jnp.int8), margin


class StepTest(WindowTest):
    block, short, lags = 256, 16, 2

    @property
    def constants(self):
        return jnp.asarray(self.relations.limit, self.dtype)

    def judge(self, run, blocks):
        return run(steps, blocks)


class Steps(Relations):
    """The output moves by at most a limit from one sample to the next."""

    model, horizon = MODEL, 1

    def __init__(self, limit):
        self.limit = limit

    def test(self, method, dtype, budget=None):
        refuse_options(method, budget)
        return StepTest(self, method, dtype)


def recorded(rng, samples=700):
    y = np.cumsum(rng.uniform(-1, 1, (samples, 1)), 0)
    y[300] += 5
    y[500] = np.nan
    return np.zeros((samples, 1)), y


def test_detect_and_a_monitor_take_a_new_test(rng):
    u, y = recorded(rng)
    res = jb.detect(Steps(1.0), u, y, starts=[100])
    moved = abs(np.diff(y[:, 0], prepend=np.nan))
    want = np.where(np.isnan(moved), 0, np.where(moved > 1, 3, 1))
    want[100] = 0
    np.testing.assert_array_equal(res.status, want)
    assert {alarm.start for alarm in res.alarms()} == {300} and set(res.counts) == {
        "MISSING",
        "CONSISTENT",
        "UNDECIDED",
        "FAULT",
    }
    mon = jb.Monitor(Steps(1.0))
    _, verdict = mon.run(mon.init(), u, y, starts=[100])
    np.testing.assert_array_equal(verdict.status, res.status)
    state = mon.init()
    for k in range(3):
        state, verdict = mon.step(state, u[k], y[k])
    assert verdict.status == want[2]


def test_batches_and_frames_too(rng):
    u, y = recorded(rng)
    several = jb.detect(Steps(1.0), np.stack([u, u]), np.stack([y, y[::-1]]))
    np.testing.assert_array_equal(several.status[0], jb.detect(Steps(1.0), u, y).status)
    assert several.status[1, 0] == jb.Status.MISSING


def test_what_it_does_not_have_is_a_sentence(rng):
    u, y = recorded(rng)
    with pytest.raises(NotImplementedError, match="margins has no fast path for these relations"):
        jb.margins(Steps(1.0), u, y)
    with pytest.raises(
        NotImplementedError, match="certificates are given for relations that detect knows, not Steps"
    ):
        jb.detect(Steps(1.0), u, y).explain(300)
    with pytest.raises(ValueError, match="budget belongs to residuals and uncertain parameters"):
        jb.detect(Steps(1.0), u, y, budget=3)
    assert isinstance(Steps(1.0).test("joint", float).judged([np.zeros(1, np.int8), np.zeros(1)]), Judged)
