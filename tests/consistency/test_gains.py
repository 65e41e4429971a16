"""Constant tolerances over long windows, against linear programs over states, disturbances and gains."""

from fractions import Fraction
from functools import cache

import jax
import numpy as np
import pytest
from agreement import certificates_hold, monitor_agrees
from scipy.optimize import linprog

import jaxbound as jb
from jaxbound.consistency.gains import GainsTest

PLANT = dict(
    A=[["0.9", "0.1"], [0, "0.8"]],
    B=[[0], [1]],
    C=[[1, 0], [1, 1]],
    noise=[0.05, 0.05],
    tolerance=[0.05, 0.02],
)
KINDS = ["plain", "disturbed"]
HORIZON = 20


@cache
def relations(kind):
    more = dict(disturbance=([[0], [1]], 0.02)) if kind == "disturbed" else {}
    return jb.parity_relations(
        jb.LinearSystem(**PLANT, **more, constant_tolerance=True), 8 if more else HORIZON
    )


@cache
def detected(kind):
    """Return u, y and the Result: a gain within its tolerance, then one that moves, then a bias."""
    model = relations(kind).model
    u = np.random.default_rng(3).uniform(-5, 5, (150, 1))
    y = np.array(jb.simulate(model, u, jax.random.key(1)).y)
    y[20:, 0] *= 1.01
    y[70:, 0] *= 1 + 0.02 * np.sin(np.arange(80))
    y[110:, 1] += 3
    y[40, 0] = y[41, 1] = np.nan
    return u, y, jb.detect(relations(kind), u, y, margins="exact")


def excess(model, u, y):
    """Return the least that all limits of a window must give way, by linear programming: > 0 where nothing
    explains it.
    """
    A, B, C, G = (
        np.array([[float(x) for x in row] for row in M]).reshape(len(M), -1)
        for M in (model.A, model.B, model.C, model.G)
    )
    n, p, g, s = len(A), len(C), model.g, len(y) - 1
    state, drive, upper, limit = np.hstack([np.eye(n), np.zeros((n, g * s))]), np.zeros(n), [], []
    for j in range(s + 1):
        for i in range(p):
            for sign in (1, -1):
                gain = np.zeros(p)
                gain[i] = sign * y[j, i] - float(model.noise[i])
                if not np.isnan(y[j, i]):
                    upper.append([*(-sign * C[i] @ state), *gain, -1])
                    limit.append(sign * C[i] @ drive)
        if j < s:
            state, drive = A @ state, A @ drive + B @ u[j]
            state[:, n + g * j : n + g * (j + 1)] += G
    inside = [(float(lo), float(hi)) for lo, hi in model.disturbance] * s
    gains = [(1 / (1 + float(t)), 1 / (1 - float(t))) for t in model.tolerance]
    free = [(None, None)]
    return linprog(
        [*np.zeros(n + g * s + p), 1], np.array(upper), limit, bounds=[*free * n, *inside, *gains, *free]
    ).fun


@pytest.mark.parametrize("kind", KINDS)
def test_verdicts_are_those_of_a_linear_program(kind):
    u, y, res = detected(kind)
    r = relations(kind)
    assert isinstance(r.test("joint", np.float64), GainsTest) and res.counts["UNDECIDED"] == 0
    told = {"FAULT": 0, "CONSISTENT": 0}
    for k in range(r.horizon, len(y), 2):
        part = slice(k - r.horizon, k + 1)
        off = excess(r.model, u[part], y[part])
        if abs(off) > 1e-8:
            expected = "FAULT" if off > 0 else "CONSISTENT"
            assert jb.Status(int(res.status[k])).name == expected
            told[expected] += 1
    assert min(told.values()) > 10


@pytest.mark.parametrize("noisy", [True, False])
def test_margins_are_of_bounds_under_which_a_linear_program_explains_the_window(noisy):
    """The bounds of the noise are what matters, or those of the gains."""
    u, y, res = detected("plain")
    r = relations("plain")
    if not noisy:
        clean = r.model.replace(noise=[0.001, 0.001], tolerance=[0, 0])
        y = np.array(jb.simulate(clean, u, jax.random.key(1)).y) * [1.045, 0.985]
        res = jb.detect(r, u, y)
    consistent = np.flatnonzero(res.status == jb.Status.CONSISTENT)
    assert len(consistent) > 15
    for k in consistent[::3]:
        part, share = slice(k - HORIZON, k + 1), Fraction(1 - res.margin[k])
        limits = {name: [x * share for x in getattr(r.model, name)] for name in ("noise", "tolerance")}
        assert excess(r.model.replace(**limits), u[part], y[part]) < 1e-9


def test_a_gain_that_moves_is_a_fault_that_free_gains_do_not_see():
    u, y, res = detected("plain")
    free = jb.detect(jb.parity_relations(jb.LinearSystem(**PLANT), HORIZON), u, y)
    assert ((free.status == jb.Status.FAULT) <= (res.status == jb.Status.FAULT)).all()
    assert ((free.status == jb.Status.CONSISTENT) & (res.status == jb.Status.FAULT)).sum() > 5


def test_a_monitor_says_the_same():
    monitor_agrees(relations("plain"), *detected("plain"))


@pytest.mark.parametrize("kind", KINDS)
def test_certificates_are_checked_by_fractions_alone(kind):
    certificates_hold(detected(kind)[2])


@pytest.mark.long(by_day="test_verdicts_are_those_of_a_linear_program")
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("kind", KINDS)
def test_no_healthy_window_is_a_fault(kind, dtype, module_seed):
    model, rng = relations(kind).model, np.random.default_rng(module_seed)
    for trial in range(4):
        u = rng.uniform(-1, 1, (200, 1)) * 100.0**trial
        y = np.array(
            jb.simulate(
                model, u, jax.random.key(module_seed + trial), at="vertices" if trial % 2 else "uniform"
            ).y
        )
        assert jb.detect(relations(kind), u.astype(dtype), y.astype(dtype)).counts["FAULT"] == 0
