"""Windows that lack samples or inputs, against linear programs of plant and bounds by SciPy."""

import numpy as np
import pytest
from scipy.optimize import linprog

import jaxbound as jb
from jaxbound.consistency import check, exchange, search_on_host
from jaxbound.sets.floats.status import Status

A, B, C = [["0.9", "0.2"], ["-0.3", "0.8"]], [["0.2", "0.1"], ["0.5", "-0.4"]], [[1, 0], ["0.5", 1]]
NOISE = 0.1, 0.2
S = 15


@pytest.fixture(scope="module")
def relations():
    return jb.parity_relations(jb.LinearSystem(A, B, C, noise=NOISE), horizon=S)


def recording(rng, T, share, fault=0.0, errors="uniform"):
    """Return u (T, 2), y (T, 2) within the bounds, with a step of y1 in the middle and a share of holes."""
    a, b, c = (np.array(M, float) for M in (A, B, C))
    x, u, y = 5 * rng.normal(size=2), rng.uniform(-1, 1, (T, 2)), np.empty((T, 2))
    for k in range(T):
        e = rng.uniform(-1, 1, 2) if errors == "uniform" else rng.choice([-1, 1], 2)
        y[k] = c @ x + np.array(NOISE) * e
        x = a @ x + b @ u[k]
    y[T // 2 :, 0] += fault
    u[rng.random(u.shape) < share], y[rng.random(y.shape) < share] = np.nan, np.nan
    return u, y


def factor(u, y):
    """Return the least t with |y - O x - H u| <= t noise for some x and missing inputs; None: no row is left
    that tells anything.
    """
    a, b, c = (np.array(M, float) for M in (A, B, C))
    O = np.concatenate([c @ np.linalg.matrix_power(a, k) for k in range(S + 1)])
    H = np.zeros((2 * (S + 1), 2 * (S + 1)))
    for k in range(S + 1):
        for j in range(k):
            H[2 * k : 2 * k + 2, 2 * j : 2 * j + 2] = c @ np.linalg.matrix_power(a, k - 1 - j) @ b
    there, lost = ~np.isnan(y.ravel()), np.isnan(u.ravel())
    E, r = np.concatenate([O, H[:, lost]], 1)[there], np.tile(NOISE, S + 1)[there]
    if np.linalg.matrix_rank(E) == len(E):
        return None
    z = (y.ravel() - H @ np.nan_to_num(u.ravel()))[there]
    rows = np.block([[E, -r[:, None]], [-E, -r[:, None]]])
    least = linprog(
        [0] * E.shape[1] + [1], rows, np.r_[z, -z], bounds=[(None, None)] * E.shape[1] + [(0, None)]
    )
    assert least.status == 0
    return least.fun


def agree(relations, u, y, tight=1e-6):
    """Compare every window that lacks something with the program; return the statuses."""
    res = jb.detect(relations, u, y)
    seen = []
    for end in range(S, len(y)):
        own_u, own_y = u[end - S : end + 1], y[end - S : end + 1]
        if not (np.isnan(own_u).any() or np.isnan(own_y).any()):
            continue
        t, status = factor(own_u.astype(float), own_y.astype(float)), res.status[end]
        seen.append(status)
        if t is None:
            assert status == Status.MISSING
        elif abs(t - 1) > tight:
            assert status == (Status.FAULT if t > 1 else Status.CONSISTENT), (end, t)
            if y.dtype == np.float64:  # the search of windows that lack outer rows is in the type of samples
                np.testing.assert_allclose(res.margin[end], 1 - t, rtol=tight, atol=tight)
    return np.array(seen)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("share", [0.03, 0.3])
def test_verdicts_are_those_of_the_program_of_what_is_there(relations, share, dtype, rng):
    seen = []
    for fault in (0.0, 1.0):
        u, y = recording(rng, 45, share, fault)
        seen.append(agree(relations, u.astype(dtype), y.astype(dtype), 1e-6 if dtype == np.float64 else 1e-3))
    assert {Status.CONSISTENT, Status.FAULT} <= set(np.concatenate(seen).tolist())


def test_what_a_gap_of_everything_hides_is_told_together(relations, rng):
    """Inputs in a gap of all outputs move two states: no row tells them apart, and none needs to."""
    u, y = recording(rng, 40, 0.0, fault=1.5)
    u[14:21], y[15:21] = np.nan, np.nan
    assert (agree(relations, u, y) == Status.FAULT).any()


def test_inputs_that_do_the_same_are_told_together(rng):
    """Two inputs of one state are lost at once: only their sum matters."""
    model = jb.LinearSystem([["0.6"]], [["-0.45", "-1.62"]], [["0.28"], ["2.44"]], noise=["0.2", "0.3"])
    r = jb.parity_relations(model, horizon=27)
    assert r.frame is not None
    u, y = rng.uniform(-1, 1, (40, 2)), np.zeros((40, 2))
    for k, x in enumerate(np.cumsum(rng.uniform(-1, 1, 40))):
        y[k] = 0.28 * x, 2.44 * x + 5 * (k > 20)
    u[::3] = np.nan
    y[5, 1] = np.nan
    assert (jb.detect(r, u, y).status[30:] == Status.FAULT).all()


def test_no_healthy_window_at_its_bounds_is_a_fault(relations, rng):
    for share in (0.02, 0.2, 0.5):
        u, y = recording(rng, 150, share, errors="vertices")
        status = jb.detect(relations, u, y).status
        assert not (status == Status.FAULT).any()
        assert (status == Status.CONSISTENT).sum() > 50


def test_whatever_a_search_finds_no_false_verdict_follows(relations, rng, monkeypatch):
    """Hints are data: with wrong ones verdicts are UNDECIDED, never others than those of the program."""
    u, y = recording(rng, 60, 0.1, fault=0.35)
    right, found, exact = jb.detect(relations, u, y).status, search_on_host.fitted, 0
    assert {Status.CONSISTENT, Status.FAULT} <= set(right.tolist())

    def wrong(*given):
        fit = found(*given)
        h = fit.h * rng.uniform(0.3, 1.7, fit.h.shape) + (rng.random(fit.h.shape) < 0.1)
        x = fit.x + rng.normal(size=fit.x.shape) * rng.choice([0, 0.5], (len(fit.x), 1))
        telling = np.where(rng.random(fit.telling.shape) < 0.3, -1, fit.telling)
        return fit._replace(t=np.full_like(fit.t, rng.choice([0.5, 2.0])), x=x, h=h, telling=telling)

    monkeypatch.setattr(search_on_host, "fitted", wrong)
    for _ in range(8):
        status = jb.detect(relations, u, y).status
        decided = status != Status.UNDECIDED
        np.testing.assert_array_equal(status[decided], right[decided])
        exact += (status == Status.FAULT).sum()
    assert exact, "some hints are still good"


def test_holes_under_constant_gains_are_decided(rng):
    model = jb.LinearSystem(A, B, C, noise=NOISE, tolerance=["0.02", "0.02"], constant_tolerance=True)
    r = jb.parity_relations(model, horizon=S)
    seen = set()
    for fault, gain in ((0.0, 0.98), (0.0, 0.99), (2.5, 1.0)):
        u, y = recording(rng, 60, 0.05, fault, errors="vertices")
        status = jb.detect(r, u, y * gain).status
        if not fault:
            assert not (status == Status.FAULT).any()
        seen |= set(status.tolist())
    assert {Status.CONSISTENT, Status.FAULT} <= seen


def test_a_sample_says_nothing_of_windows_without_it(relations, rng, monkeypatch):
    """Rounding errors are those of each window: else a spike would open all that are judged beside it."""
    monkeypatch.setattr(exchange, "whole_margins", lambda *given: np.zeros(given[-1].shape[2]))
    u, y = recording(rng, 60, 0.1, fault=1.5)
    alone = jb.detect(relations, u[:-1], y[:-1]).status
    assert {Status.CONSISTENT, Status.FAULT} <= set(alone.tolist())
    for x in (u[:, 0], y[:, 1]):
        x[-1] = 1e19
    np.testing.assert_array_equal(jb.detect(relations, u, y).status[:-1], alone)


@pytest.mark.parametrize("value", [np.inf, -np.inf])
def test_an_infinite_sample_beside_holes_is_refused(relations, rng, value):
    for i in range(2):
        u, y = recording(rng, 40, 0.1)
        (u, y)[i][20, 0] = value
        with pytest.raises(ValueError, match="finite"):
            jb.detect(relations, u, y)


def test_a_coefficient_that_floats_cannot_hold_proves_nothing():
    """What is left of the first state after six samples is below any float: it is read as the smallest."""
    model = jb.LinearSystem([["1e-60"]], None, [[1], [1]], noise=["1e-9", "1e-9"])
    relations = jb.parity_relations(model, horizon=20)
    assert relations.frame is not None
    y = np.full((21, 2), np.nan)
    y[5:8, 0] = 1, 0, 0
    assert jb.detect(relations, None, y).status[-1] != Status.FAULT


@pytest.mark.parametrize("kind", [float, object])
def test_a_product_of_the_check_is_worked_out_by_one_thread(kind, rng, monkeypatch):
    def counted(A, x, out):
        assert x.shape[1] == 1 or A.size * x.shape[1] <= 100, "the library starts threads for more"
        assert x.strides[1] == x.itemsize or x.size < 2, "and for rows that lie apart sooner"
        return matmul(A, x, out=out)

    matmul = np.matmul
    monkeypatch.setattr(check, "ALONE", 100)
    monkeypatch.setattr(np, "matmul", counted)
    for shape, columns in (((6, 5), 20), ((20, 7), 3), ((0, 4), 5), ((4, 0), 5)):
        A, x = (
            rng.integers(-9, 9, shape).astype(kind),
            rng.integers(-9, 9, (columns, shape[1])).astype(kind).T,
        )
        np.testing.assert_array_equal(check._times(A, x), A @ x)
