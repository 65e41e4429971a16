"""Intervals of unknown inputs: they contain the truth, are as tight as a linear program allows, and say where
nothing is known.
"""

import jax
import numpy as np
import pytest
from oracles import MODELS, Plant, Program, Windows
from scipy.optimize import linprog

import jaxbound as jb

TANKS = dict(
    A=[["0.96", "0.03"], ["0.03", "0.95"]],
    B=[["0.5"], [0]],
    C=[[1, 0], [0, 1]],
    noise=[0.02, 0.01],
    tolerance=[0.005, 0],
    resolution=0.0005,
    unknown_inputs=([[0], [-1]], [[0], [0]]),
)


def recording(T, rng, leak, batch=(), dtype=np.float64):
    m = jb.LinearSystem(**TANKS)
    u = rng.uniform(0, 2, (*batch, T, 1)).astype(dtype)
    t = jb.simulate(
        m,
        u,
        jax.random.key(int(rng.integers(2**31))),
        x0=np.array([30.0, 20.0]),
        at="vertices",
        unknown_input=leak,
    )
    return m, u, np.array(t.y)


@pytest.mark.parametrize(
    "batch, dtype",
    [
        (4, np.float64),
        pytest.param(250, np.float64, marks=pytest.mark.long),
        pytest.param(40, np.float32, marks=pytest.mark.long),
    ],
)
def test_a_leak_of_a_two_tank_rig_is_always_inside(batch, dtype, rng):
    T, w = 4100, 0.4
    leak = (rng.uniform(0, w, (batch, T, 1)) * (rng.uniform(size=(batch, T, 1)) < 0.5)).astype(dtype)
    m, u, y = recording(T, rng, leak, (batch,), dtype)
    found = jb.unknown_inputs(m, u, y)
    assert found.values.lo.dtype == dtype and found.lags == (1,)
    lo, hi = found.values.lo, found.values.hi
    known = np.isfinite(lo)
    assert known[:, found.horizon - 1 : T - 1].all() and known.sum() >= batch * 4000
    assert ((lo <= leak) & (leak <= hi)).all()
    width = (hi - lo)[known]
    print(f"{known.sum()} windows, width {np.median(width):.4f}")
    assert np.median(width) < 0.1


@pytest.mark.parametrize(
    "spec, s, position",
    [
        (TANKS, 2, 0),
        (TANKS, 3, 1),
        (
            MODELS["three states"]
            | dict(unknown_inputs=([[1], [0], [0]], [[0], [0]]), disturbance=([[0], [0], [1]], [[0, "0.1"]])),
            3,
            None,
        ),
    ],
)
def test_the_interval_is_that_of_the_program(spec, s, position, rng):
    """Minimise and maximise v over all behaviours that give the samples. HiGHS."""
    plant, m = Plant(**spec), jb.LinearSystem(**spec)
    oracle = Windows(plant, s)
    N, E = 60, oracle.O
    z = rng.normal(size=(N, E.shape[1]))
    z[:, plant.n : plant.n + plant.g * s] = rng.uniform(0, 0.1, (N, plant.g * s))
    rows = (s + 1) * plant.p
    y = (z @ E.T)[:, :rows].reshape(N, s + 1, plant.p)
    y += 0.7 * rng.uniform(-1, 1, y.shape) * np.array([float(x) for x in plant.noise])
    u = np.zeros((N, s + 1, plant.m))
    found = jb.unknown_inputs(m, u, y, horizon=s)
    t = s - found.lags[0]
    assert position is None or t >= position
    lo, hi = oracle.limits(u, y)
    column = plant.n + plant.g * s + t
    for sign, side in ((1, found.values.lo), (-1, found.values.hi)):
        cost = np.zeros(E.shape[1])
        cost[column] = sign
        best = sign * Program(E, cost).solve(lo, hi)
        np.testing.assert_allclose(side[:, t, 0], best, rtol=1e-7, atol=1e-9)
        assert (sign * (best - side[:, t, 0]) > -1e-9).all()


def test_noise_that_follows_the_operating_point_widens_it_sample_by_sample(rng):
    """Minimise and maximise v over all behaviours whose noise is times the factor of each sample. HiGHS."""
    model = jb.LinearSystem(**TANKS | {"tolerance": 0, "resolution": 0}, times={"y1": "1 + 2 * u1"})
    A, B, G = np.array([[0.96, 0.03], [0.03, 0.95]]), np.array([0.5, 0]), np.array([0.0, -1])
    u, states = rng.uniform(0, 2, (8, 1)), [np.array([30.0, 20])]
    for k in range(7):
        states.append(A @ states[-1] + B * u[k, 0] + G * rng.uniform(0, 0.4))
    noise = np.array([0.02, 0.01]) * np.stack([1 + 2 * u[:, 0], np.ones(8)], 1)
    y = np.array(states) + rng.uniform(-0.7, 0.7, (8, 2)) * noise
    found = jb.unknown_inputs(model, u, y, horizon=2)
    (lag,) = found.lags
    for first in range(6):
        rows, left, x = [np.eye(2, 4)], [y[first]], np.zeros(2)  # over x0, v0, v1
        for k in (0, 1):
            x = A @ x + B * u[first + k, 0]
            rows.append(A @ rows[-1] + np.outer(G, np.eye(4)[2 + k]))
            left.append(y[first + k + 1] - x)
        rows, left, wide = np.vstack(rows), np.concatenate(left), noise[first : first + 3].ravel()
        place = 2 - lag
        below, ends = np.vstack([rows, -rows]), np.concatenate([left + wide, wide - left])
        aim = np.eye(4)[2 + place]
        free = [(None, None)] * 4
        low, high = (sign * linprog(sign * aim, below, ends, bounds=free).fun for sign in (1, -1))
        got = found.values.lo[first + place, 0], found.values.hi[first + place, 0]
        np.testing.assert_allclose(got, (low, high), rtol=1e-7, atol=1e-9)


def test_missing_samples_widen_it_and_samples_that_nothing_explains_empty_it(rng):
    leak = rng.uniform(0, 0.4, (60, 1))
    m, u, y = recording(60, rng, leak)
    whole = jb.unknown_inputs(m, u, y).values
    y[20, 1], u[40] = np.nan, np.nan
    part = jb.unknown_inputs(m, u, y).values
    lo, hi = part.lo[:, 0], part.hi[:, 0]
    assert ((lo <= leak[:, 0]) & (leak[:, 0] <= hi)).all()
    below, above = whole.lo[1:-1, 0] - lo[1:-1], hi[1:-1] - whole.hi[1:-1, 0]
    assert min(below.min(), above.min()) > -1e-12 and (below + above > 1e-9).sum() > 1
    y[30, 0] += 50
    broken = jb.unknown_inputs(m, u, y, horizon=3).values
    assert (broken.lo > broken.hi).any()


def test_an_input_that_acts_at_once_has_no_lag():
    m = jb.LinearSystem([[0.5]], None, [[1], [1]], noise=0.1, unknown_inputs=([[0]], [[0], [1]]))
    found = jb.unknown_inputs(m, None, [[1.0, 4.0], [0.5, 0.5], [0.2, 0.3]])
    assert (
        found.lags == (0,)
        and found.values.lo[0, 0] == -np.inf
        and found.values.lo[1, 0] > -0.21
        and found.values.hi[1, 0] < 0.21
    )


def test_a_recording_shorter_than_the_lag_says_nothing():
    chain = jb.LinearSystem(
        [[0, 1, 0], [0, 0, 1], [0, 0, "0.5"]], None, [[1, 0, 0]], noise=1, unknown_inputs=[[0], [0], [1]]
    )
    found = jb.unknown_inputs(chain, None, np.zeros((2, 1)), horizon=3)
    assert np.isinf(found.values.lo).all() and found.values.lo.shape == (2, 1)


def test_one_of_two_may_be_known():
    m = jb.LinearSystem([[0.5, 0], [0, 0.2]], None, [[1, 0]], noise=0.1, unknown_inputs=[[1, 0], [0, 1]])
    found = jb.unknown_inputs(m, None, np.zeros((6, 1)))
    assert (
        found.lags == (1, None)
        and np.isinf(found.values.lo[:, 1]).all()
        and np.isfinite(found.values.lo[1:-1, 0]).all()
    )


@pytest.mark.parametrize(
    "change, args, said",
    [
        (dict(unknown_inputs=None), {}, "the model has no unknown inputs"),
        (dict(unknown_inputs=[[1, 0], [0, 1]], C=[[0, 0], [0, 0]]), {}, "determines an unknown input"),
        ({}, dict(horizon=1.5), "horizon must be a whole number >= 0, not 1.5"),
        ({}, dict(horizon=0), "no window of horizon 0 determines an unknown input"),
        ({}, dict(horizon=40), "windows of horizon 40 are too long to work out the unknown inputs"),
    ],
)
def test_what_cannot_be_estimated_is_refused(change, args, said):
    with pytest.raises(ValueError, match=said):
        jb.unknown_inputs(jb.LinearSystem(**(TANKS | change)), np.zeros((9, 1)), np.zeros((9, 2)), **args)


def test_progress_rises_to_one(rng):
    m, u, y = recording(60, rng, np.zeros((60, 1)))
    seen = []
    jb.unknown_inputs(m, u, y, progress=seen.append)
    assert seen == sorted(seen) and seen[-1] == pytest.approx(1)
