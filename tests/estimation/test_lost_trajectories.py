"""A search of method "joint" may lose its trajectory where samples differ by many digits: it is searched
again.

Which windows are feasible is asked of HiGHS, which knows nothing of the observer.
"""

import jax
import numpy as np
import pytest
from scipy.optimize import linprog

import jaxbound as jb
from jaxbound.estimation import Joint, window_programs

WINDOW = 16
NOISE, DISTURBANCE, FIRST = 1e-6, 0.5, 5.0
"""Disturbances move the states by a million times the error of a sensor."""
PLANT = jb.LinearSystem(
    [["0.93", "0.12"], ["-0.08", "0.97"]],
    [[0], [1]],
    [[1, 0], [0, 1]],
    noise=str(NOISE),
    disturbance=([[1], ["0.5"]], str(DISTURBANCE)),
)


def gauge(u, y):
    """Return the factor on all bounds at which a linear program first explains a window, by HiGHS.

    One variable a first state and a disturbance, as a share of its bound, and the factor t. Bounds are |z| <=
    t, and |y - C x| / noise <= t of each sample.
    """
    A, B, C, G = (np.array(getattr(PLANT, name), float) for name in "ABCG")
    T, n = len(y), PLANT.n
    X, f = np.zeros((n, n + T)), np.zeros(n)
    X[:, :n] = FIRST * np.eye(n)
    rows, right = [], []
    for k in range(T):
        for i in range(PLANT.p):
            for sign in (1, -1):
                rows.append(np.append(sign * C[i] @ X / NOISE, -1))
                right.append(sign * (y[k, i] - C[i] @ f) / NOISE)
        X, f = A @ X, A @ f + B @ u[k]
        X[:, n + k] += DISTURBANCE * G[:, 0]
    for z in np.eye(n + T):
        for sign in (1, -1):
            rows.append(np.append(sign * z, -1))
            right.append(0)
    cost = np.append(np.zeros(n + T), 1)
    found = linprog(cost, np.array(rows), right, bounds=(None, None), method="highs")
    assert found.status == 0
    return found.fun


def recordings(N):
    """Return u, y of windows that are explained, and of windows whose last samples are more and more off."""
    rng = np.random.default_rng(13)
    u, first = rng.normal(size=(N, WINDOW, 1)), rng.uniform(-1, 1, (N, 2))
    y = np.array(jb.simulate(PLANT, u, jax.random.key(13), x0=first, at="uniform").y)
    y[:, WINDOW // 2 :, 0] += np.linspace(0, 6, N)[:, None] * NOISE
    return u, y


def verdicts(u, y):
    """Return the statuses of the last samples: of windows over all of them."""
    first = jb.interval([-FIRST] * 2, [FIRST] * 2)
    found = jb.observe(PLANT, u, y, x0=first, restart=False, method=Joint(WINDOW), order=6)
    return np.asarray(found.status)[:, -1]


@pytest.fixture(scope="module")
def windows():
    """Return (u, y, gauges) of recordings of one window each."""
    u, y = recordings(24)
    return u, y, np.array([gauge(*pair) for pair in zip(u, y, strict=True)])


def test_every_window_that_highs_refutes_by_two_hundredths_is_a_fault_and_no_feasible_one(windows):
    u, y, t = windows
    status = verdicts(u, y)
    print(np.c_[t, status].round(3).tolist())
    assert ((t > 1.02) & (t < 1.1)).sum() > 2 and (t < 1).sum() > 5
    assert (status[t > 1.02] == jb.Status.FAULT).all()
    assert (status[t < 1] != jb.Status.FAULT).all()
    assert (t[status == jb.Status.CONSISTENT] < 1).all() and (status == jb.Status.CONSISTENT).sum() > 2


def test_without_a_second_search_refuted_windows_stay_undecided(windows, monkeypatch):
    """The recordings above are such that a first search loses trajectories: else the test above shows
    nothing.
    """
    u, y, t = windows
    monkeypatch.setattr(window_programs, "AGAIN", 0)
    status = verdicts(u, y)
    assert (status[t > 1.02] == jb.Status.UNDECIDED).any()
    assert not (status == jb.Status.CONSISTENT).any()
