"""What NumPy says on its own of a window: never against the linear program, and nearly all of what can be
said.
"""

import numpy as np
import pytest
from boundary import GUST, LEAK, prepared
from oracles import MODELS

import jaxbound as jb
from jaxbound.consistency.check import HostImage, contradicted_by, explained
from jaxbound.consistency.strips_on_host import host_strips

SHORT = {
    "paper": (MODELS["paper"], 1),
    "offsets": (MODELS["offsets"], 2),
    "gust": (GUST, 2),
    "leak": (LEAK, 1),
}
SLACK = {np.float64: 1e-9, np.float32: 1e-4}


def agrees(contradicted, slack, dtype):
    """What is contradicted has no solution, in the program's digits; what has none by more than these is
    contradicted.
    """
    assert not (contradicted & (slack < -SLACK[dtype])).any()
    clear = slack > 100 * SLACK[dtype]
    assert clear.any() and contradicted[clear].mean() > 0.9 and (slack < -SLACK[dtype]).any()


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", SHORT)
def test_strips_say_what_the_program_says(name, dtype, rng):
    """Windows as one long recording: all of them, and few of them."""
    model, horizon = SHORT[name]
    r, oracle, u, y = prepared(model, horizon, 120, rng, dtype)
    assert r.frame is None
    host = host_strips(r.reading(np.float64), r.circuits, r.circuits_known)
    starts = np.arange(120) * (horizon + 1)
    ends = (u.reshape(-1, u.shape[2]), y.reshape(-1, y.shape[2]))
    found = host.contradicted(*ends, starts)
    agrees(found.any(0), oracle.slack(u, y), dtype)
    np.testing.assert_array_equal(host.contradicted(*ends, np.arange(starts[-1] + 1))[:, starts], found)
    few = host.contradicted(*ends, starts[::9])  # of windows alone, whose largest samples are no larger
    assert (few >= found[:, ::9]).all()
    agrees(few.any(0), oracle.slack(u, y)[::9], dtype)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_combinations_say_what_the_program_says_whatever_they_are(dtype, rng):
    """Those that a search found see what can be seen; any others are never wrong."""
    r, oracle, u, y = prepared(MODELS["paper"], 20, 90, rng, dtype)
    slack = oracle.slack(u, y)
    test = r.test("joint", np.dtype(dtype))
    samples = np.moveaxis(u, 0, -1)[: test.lags], np.moveaxis(y, 0, -1)
    block = [x[..., np.arange(1024) % 90] for x in samples]  # as many as `detect` has: compiled once
    run = lambda kernel, blocks: [kernel(test.constants, *block) for block in blocks]
    ((_, _, found),) = test.judge(run, [block])
    agrees(test.refuted(*samples, np.asarray(found)[:, :90]), slack, dtype)
    frame = test.reading.shape
    for _ in range(20):
        h = rng.normal(size=(len(frame.outer), 90)) * (rng.random((len(frame.outer), 90)) < 0.2)
        assert not (contradicted_by(test.reading, *samples, h) & (slack < -SLACK[dtype])).any()


def test_missing_samples_contradict_nothing_that_needs_them(rng):
    r, _, u, y = prepared(MODELS["paper"], 1, 60, rng)
    host = host_strips(r.reading(np.float64), r.circuits, r.circuits_known)
    ends, starts = [u.reshape(-1, 1), 50 + y.reshape(-1, 2)], np.arange(60) * 2
    assert host.contradicted(*ends, starts).any(0).mean() > 0.8
    ends[1][:] = np.nan
    assert not host.contradicted(*ends, starts).any()


def test_means_and_lags_are_rows_like_others(rng):
    """A mean that is out by more than its bound, where no sample alone is."""
    model = jb.LinearSystem([["0.5"]], [[1]], [[1]], noise=1, averages={"y1": {3: "0.1"}})
    for r in (jb.parity_relations(model, 4), jb.parity_relations(model, lags=(4, 2, 0))):
        assert r.frame is None
        u = rng.normal(size=(400, 1))
        y = np.array(jb.simulate(model.replace(noise="0.05", averages={}), u, 3).y)
        y[200:] += 0.6
        res = jb.detect(r, u, y)
        host = host_strips(r.reading(np.float64), r.circuits, r.circuits_known)
        found = host.contradicted(u, y, np.arange(396)).any(0)
        assert found.any() and (found == (res.status[4:] == jb.Status.FAULT)).all() and not found[:190].any()


def test_multipliers_whose_sums_overflow_prove_nothing(rng):
    """x = 1, w = 0 explains the window."""
    model = jb.LinearSystem([[1]], None, [["1e9"], ["1e9"]], noise=["1", "1"], disturbance=([["1"]], "1"))
    reading = jb.parity_relations(model, 6).reading(np.float64)
    u, y = np.zeros((6, 0, 1)), np.full((7, 2, 1), 1e9)
    for _ in range(200):
        h = 1e299 * rng.normal(size=(len(reading.frame.R), 1))
        with np.errstate(all="ignore"):
            assert not contradicted_by(reading, u, y, h).any()


def test_no_window_is_explained_nearer_to_a_bound_than_rounding_reaches():
    """|d + u| <= 1 at d = 5, and what rounding takes of either term adds up: 1e-3 (5 + |u|)."""
    one, zero, no = np.ones((1, 1)), np.zeros((1, 1)), np.zeros((1, 1), bool)
    lo, hi = np.array([[-1.0], [4.0]]), np.array([[1.0], [6.0]])
    sizes = dict(off=zero, size=zero, magnitude=zero, gamma=1e-3, floor=zero[0])
    for u, inside in ((-5.5, True), (-5.985, True), (-5.995, False), (-4.005, False)):
        image = HostImage(one, one, lo, hi, ~np.vstack([no, no]), known=u * one, lost=no, most=0, **sizes)
        assert explained(image, zero) == inside
