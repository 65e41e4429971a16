"""Windows that look at their outputs at some samples only: long memory, few rows, every verdict exact."""

from functools import cache

import jax
import numpy as np
import pytest
from agreement import certificates_hold, monitor_agrees
from scipy.optimize import linprog

import jaxbound as jb
from jaxbound.relations.identity import identity

HEATER = dict(
    A=[["0.97", "0.01", 0], ["0.01", "0.98", 0], ["0.13", 0, "0.87"]],
    B=[["0.011"], [0], [0]],
    C=[[0, 0, 1], [0, 1, 0]],
    noise=[0.5, 0.25],
)
LAGS = (0, 1, 3, 9)
KINDS = ["plain", "disturbed"]


@cache
def relations(kind):
    more = dict(disturbance=([[1, 0], [0, 1], [0, 0]], [0.05, 0.05])) if kind == "disturbed" else {}
    return jb.parity_relations(jb.LinearSystem(**HEATER, **more), lags=LAGS)


@cache
def detected(kind):
    r = relations(kind)
    u = np.random.default_rng(5).uniform(0, 80, (60, 1))
    y = np.array(jb.simulate(r.model, u, jax.random.key(0)).y)
    y[40:, 0] += 2.0
    return u, y, jb.detect(r, u, y, margins="exact")


def factor(model, s, lags, u, y):
    """Return the factor on all bounds at which a window becomes consistent, by linear programming over states
    and disturbances.
    """
    A, B, C, G = (
        np.array([[float(x) for x in row] for row in M]).reshape(len(M), -1)
        for M in (model.A, model.B, model.C, model.G)
    )
    n, g = len(A), model.g
    state, drive = (
        np.hstack([np.eye(n), np.zeros((n, g * s + 1))]),
        np.zeros(n),
    )  # x_j = state (x_0, w, t) + drive
    upper, limit = [], []
    for j in range(s + 1):
        if s - j in lags:
            for i, b in enumerate(model.noise):
                for sign in (1, -1):
                    row = sign * C[i] @ state
                    row[-1] -= float(b)
                    upper.append(row)
                    limit.append(sign * (y[j, i] - C[i] @ drive))
        if j < s:
            state, drive = A @ state, A @ drive + B @ u[j]
            if g:
                state[:, n + g * j : n + g * (j + 1)] += G
    for c, (_, hi) in enumerate(model.disturbance):
        for k in range(s):
            for sign in (1, -1):
                row = np.zeros(n + g * s + 1)
                row[n + g * k + c], row[-1] = sign, -float(hi)
                upper.append(row)
                limit.append(0.0)
    free = [(None, None)] * (n + g * s) + [(0, None)]
    return linprog([*np.zeros(n + g * s), 1], np.array(upper), limit, bounds=free).fun


@pytest.mark.parametrize("kind", KINDS)
def test_margins_are_those_of_a_linear_program_over_the_samples_looked_at(kind):
    u, y, res = detected(kind)
    r = relations(kind)
    for k in range(r.horizon, len(y), 4):
        part = slice(k - r.horizon, k + 1)
        assert abs(1 - res.margin[k] - factor(r.model, r.horizon, LAGS, u[part], y[part])) < 1e-8
    assert (
        res.counts["MISSING"] == r.horizon
        and res.counts["UNDECIDED"] == 0
        and (res.status[40:43] == jb.Status.FAULT).any()
    )
    np.testing.assert_allclose(
        np.asarray(jb.margins(r, u, y))[r.horizon :], res.margin[r.horizon :], atol=1e-9
    )


def test_all_lags_are_the_window_of_that_horizon():
    u, y, _ = detected("plain")
    model = relations("plain").model
    found = [
        jb.detect(r, u, y, margins="exact")
        for r in (jb.parity_relations(model, 2), jb.parity_relations(model, lags=(0, 1, 2)))
    ]
    np.testing.assert_array_equal(found[0].status, found[1].status)
    np.testing.assert_allclose(found[0].margin, found[1].margin, atol=1e-12)


def test_a_sample_that_nobody_looks_at_may_be_missing_or_mad_and_an_input_between_may_not_be_missing():
    u, y, res = detected("plain")
    other = y.copy()
    k = 30
    for lag in range(relations("plain").horizon + 1):
        if lag not in LAGS:
            other[k - lag] = (np.nan, 1e6)[lag % 2]
    again = jb.detect(relations("plain"), u, other, margins="exact")
    assert again.status[k] == res.status[k] and again.margin[k] == res.margin[k]
    assert again.explain(k).proves == res.status[k] == jb.Status.CONSISTENT
    gone = u.copy()
    gone[k - 5] = np.nan
    assert jb.detect(relations("plain"), gone, y).status[k] != jb.Status.CONSISTENT
    assert jb.detect(relations("plain"), gone, y).status[k - 5] == res.status[k - 5]


@pytest.mark.parametrize("kind", KINDS)
def test_a_monitor_says_the_same(kind):
    monitor_agrees(relations(kind), *detected(kind))


@pytest.mark.parametrize("kind", KINDS)
def test_certificates_are_checked_by_fractions_alone(kind):
    certificates_hold(detected(kind)[2])


def test_the_guaranteed_size_needs_twice_the_bounds():
    """Once for the noise that hides the fault, once for the one that is supposed to explain it."""
    r = relations("plain")
    size = jb.detectable(r.model, "y1", lags=LAGS)
    assert size.horizon == r.horizon and "y1[k-2]" not in size.relation
    assert (
        abs(
            factor(
                r.model, r.horizon, LAGS, np.zeros((10, 1)), np.array([float(size), 0.0]) * np.ones((10, 1))
            )
            - 2
        )
        < 1e-6
    )


def test_what_is_kept_of_lags_is_not_taken_for_that_of_a_window():
    model = relations("plain").model
    assert (
        identity(relations("plain"))
        != identity(jb.parity_relations(model, 9))
        != identity(jb.parity_relations(model, lags=(0, 2, 9)))
    )


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (dict(lags=(1, 2)), "0 among them"),
        (dict(lags=(0, 2, 2)), "different whole numbers"),
        (dict(lags=(0, -1)), "whole numbers >= 0"),
        (dict(lags=(0, 4), horizon=4), "leave horizon out"),
        (dict(lags=(0, 4), form="second"), "leave form out"),
        (dict(lags=(0,)), "2 samples do not outnumber"),
    ],
)
def test_what_are_no_lags_is_refused(more, said):
    with pytest.raises(ValueError, match=said):
        jb.parity_relations(relations("plain").model, **more)


def test_lags_of_an_uncertain_model_are_refused():
    model = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, uncertainties=[jb.Uncertainty("a", A=[[0.1]])])
    with pytest.raises(ValueError, match="too many"):
        jb.parity_relations(model, lags=(0, 4))
