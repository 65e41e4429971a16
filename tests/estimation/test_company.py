"""What an observer says of a recording does not depend on what stands beside it, or on how its samples come:
the same bits.
"""

import jax
import numpy as np
import pytest
from observer_case import PLANT

import jaxbound as jb
from jaxbound.recordings.recording import Recording

METHODS = {"zonotope": {}, "strips": {}, "joint": {"window": 8, "order": 6}}
"""The plant and the sizes of the other tests of observers, which compile them too."""
COUNT, LENGTH = 35, 24
"""More recordings than a block has."""


@pytest.fixture(scope="module")
def recordings():
    """Return u, y of recordings, most with a fault of some size somewhere, some with samples that are
    missing.
    """
    rng = np.random.default_rng(26)
    u = rng.normal(size=(COUNT, LENGTH, 1))
    found = jb.simulate(PLANT, u, jax.random.key(26), x0=rng.normal(size=(COUNT, 2)), at="vertices")
    y = np.array(found.y)
    for i in range(COUNT):
        y[i, 10 + i % 11 :, 0] += (0, 0.1, 0.15, 0.3, 0.6, 3)[i % 6]
    y[rng.random(y.shape) < 0.02] = np.nan
    return np.array(found.u), y


TWO_OUTPUTS = jb.LinearSystem(
    PLANT.A,
    PLANT.B,
    [[1, 0], ["0.3", "0.5"]],
    noise=["0.1", "0.05"],
    tolerance=["0.01", 0],
    disturbance=([[1], ["0.5"]], "0.02"),
)


def same(a, b):
    for x, y in zip(a, b, strict=True):
        np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("restart", [True, False])
@pytest.mark.parametrize("method", METHODS)
def test_alone_beside_others_in_pieces_and_by_a_monitor(method, restart, recordings, rng):
    u, y = recordings
    watch = jb.observer(PLANT, method=method, restart=restart, **METHODS[method])
    whole = jb.detect(watch, u, y)
    assert 1 < (whole.status == jb.Status.FAULT).any(1).sum() < COUNT
    judge = watch.test()
    for i in (4, 5, 33):
        said = whole.status[i], whole.margin[i]
        alone = jb.detect(watch, u[i], y[i])
        same(said, (alone.status, alone.margin))
        carry, first, pieces = judge.init(), 0, []
        while first < LENGTH:
            stop = first + int(rng.choice([1, 3, 7, 17]))
            carry, judged = judge.fold(carry, Recording.of(PLANT, u[i, first:stop], y[i, first:stop]))
            pieces.append((judged.status, judged.margin))
            first = stop
        same(said, map(np.concatenate, zip(*pieces, strict=True)))
    monitor = jb.Monitor(watch)
    state, steps = monitor.init(), []
    for k in range(LENGTH):
        state, verdict = monitor.step(state, u[5, k], y[5, k])
        steps.append((verdict.status, verdict.margin))
    same((whole.status[5], whole.margin[5]), map(np.array, zip(*steps, strict=True)))


@pytest.mark.parametrize("method", METHODS)
def test_enclosures_are_the_same_beside_others(method, recordings):
    u, y = recordings
    how = {"method": method, **METHODS[method]}
    whole, few = jb.observe(PLANT, u, y, **how), jb.observe(PLANT, u[:3], y[:3], **how)
    alone = jb.observe(PLANT, u[2], y[2], **how)
    for a, b, c in zip(*map(jax.tree.leaves, (whole, few, alone)), strict=True):
        same((a[:3], b[2]), (b, c))


@pytest.mark.parametrize("method", METHODS)
def test_outputs_that_are_met_one_after_the_other_are_the_same_beside_others(method, rng):
    u = rng.normal(size=(COUNT, 20, 1))
    y = np.array(jb.simulate(TWO_OUTPUTS, u, jax.random.key(27), at="vertices").y)
    y[np.arange(COUNT), 12:, np.arange(COUNT) % 2] += np.linspace(0, 1, COUNT)[:, None]
    watch = jb.observer(TWO_OUTPUTS, method=method, **METHODS[method])
    whole = jb.detect(watch, u, y)
    assert 1 < (whole.status == jb.Status.FAULT).any(1).sum() < COUNT
    for i in (4, 17, 33):
        alone = jb.detect(watch, u[i], y[i])
        same((whole.status[i], whole.margin[i]), (alone.status, alone.margin))
