"""Factors in floats: those of linear programs."""

import numpy as np
import pytest
from scipy.optimize import linprog

import jaxbound as jb
from jaxbound.studies.identification.gauge import GaugeJudge, best_approximations, gauge_of, seen_slopes
from jaxbound.studies.identification.regression import scales_of

A, B, C, D = [[0.7, 0.3], [-0.2, 0.8]], [[1.0], [0.5]], [[1.0, 0], [0.4, 1]], [[0.2], [0]]
NOISE, OFFSET = np.array([0.1, 0.3]), {"y": [1.0, -2], "u": [0.5]}


def by_program(r, columns):
    """Return min over x of max_i |r_i - (columns x)_i|."""
    ones = np.ones((len(r), 1))
    upper = np.block([[columns, -ones], [-columns, -ones]])
    free = [(None, None)] * columns.shape[1] + [(0, None)]
    cost = np.append(np.zeros(columns.shape[1]), 1.0)
    return linprog(cost, upper, np.concatenate([r, -r]), bounds=free, method="highs").fun


@pytest.mark.parametrize("unknown", [1, 3, 6])
def test_the_best_approximation_is_that_of_a_linear_program(unknown, rng):
    free, _ = np.linalg.qr(rng.normal(size=(20, unknown)))
    free[:4, -1] = 0  # a direction that few samples show
    free, _ = np.linalg.qr(free)
    r = rng.normal(size=(10, 20)) * 10.0 ** rng.integers(-6, 6, 10)[:, None]
    expected = [by_program(row, free) for row in r]
    np.testing.assert_allclose(best_approximations(r, free), expected, rtol=1e-7)


def test_a_window_that_speaks_against_bounds_is_found(rng):
    u, y = rng.normal(size=(40, 1)), rng.normal(size=(40, 2))
    record = (u, y, np.zeros(0, int))
    model = jb.LinearSystem(A, B, C, D, noise=NOISE.tolist(), offset=OFFSET, horizon=7)
    (needs,) = GaugeJudge().needs(model, [record])
    worst, first = np.nanmax(needs), np.arange(33)
    wide = gauge_of(model.replace(noise=(1.001 * worst * NOISE).tolist()))
    assert len(wide.unexplained(record, first)) == 0
    narrow = gauge_of(model.replace(noise=(0.999 * worst * NOISE).tolist()))
    assert narrow.unexplained(record, first).tolist() == [np.nanargmax(needs) - 7]


def test_other_averages_count_as_if_they_were_the_model_s():
    model = jb.LinearSystem(A, B, C, D, noise=NOISE.tolist(), horizon=7, averages={"y1": {2: 0.5}})
    other = model.replace(averages={"y1": {3: 0.07}, "y2": [([1, -2, 4], 0.2)]})
    gauge, expected = gauge_of(model, other.averages), gauge_of(other)
    np.testing.assert_array_equal(gauge.over, expected.over)
    np.testing.assert_array_equal(gauge.free, expected.free)
    for j in range(6):
        np.testing.assert_allclose(gauge.over[22 + j].reshape(8, 2)[j : j + 3, 1], [5, -10, 20])


def test_what_the_first_state_explains_needs_nothing():
    free = np.eye(3)[:, :2]
    np.testing.assert_array_equal(best_approximations(np.array([[3.0, -1, 0], [0, 0, -2]]), free), [0, 2])


@pytest.mark.parametrize(
    "window, mean", [(dict(horizon=7), 4), (dict(lags=[0, 1, 3, 7]), None)], ids=["means", "lags"]
)
def test_the_largest_factor_is_that_of_a_linear_program(window, mean, rng):
    averages = {"y2": {mean: 0.05}} if mean else {}
    model = jb.LinearSystem(A, B, C, D, noise=NOISE.tolist(), offset=OFFSET, averages=averages, **window)
    u, y = rng.normal(size=(25, 1)), rng.normal(size=(25, 2))
    y[20, 0] = np.nan
    looked = range(8) if mean else [0, 4, 6, 7]
    on_state = np.concatenate([np.array(C) @ np.linalg.matrix_power(np.array(A), k) for k in range(8)])
    factors = []
    for first in range(12):  # windows that no missing sample or seam touches
        x, r = np.zeros(2), np.zeros((8, 2))
        for k in range(8):
            du = u[first + k] - OFFSET["u"]
            r[k] = y[first + k] - OFFSET["y"] - np.array(C) @ x - np.array(D) @ du
            x = np.array(A) @ x + np.array(B) @ du
        rows = [(2 * k + i, 1 / NOISE[i]) for k in looked for i in range(2)]
        weights = np.zeros((len(rows), 16))
        for number, (at, weight) in enumerate(rows):
            weights[number, at] = weight
        for begin in range(5) if mean else ():
            run = np.zeros(16)
            run[[2 * (begin + j) + 1 for j in range(4)]] = 1 / 4 / 0.05
            weights = np.vstack([weights, run])
        if first + 7 < 15 or first >= 15:
            factors.append(by_program(weights @ r.ravel(), weights @ on_state))
    need = gauge_of(model).largest((u, y, np.array([15])))
    counted = np.flatnonzero(np.isfinite(need))
    assert counted.tolist() == list(range(7, 15))
    assert np.nanmax(need) == pytest.approx(max(factors), rel=1e-7)
    assert np.nanargmax(need) == 7 + np.argmax(factors)
    assert (need[counted] <= np.array(factors) * (1 + 1e-9)).all()
    (each,) = GaugeJudge(every=True).needs(model, [(u, y, np.array([15]))])
    np.testing.assert_allclose(each[counted], factors, rtol=1e-7)


@pytest.mark.parametrize(
    "about",
    [dict(horizon=7, averages={"y1": {3: 0.05}, "y2": {3: 0.07}}), dict(lags=[0, 1, 3, 7])],
    ids=["means", "lags"],
)
def test_bounds_that_follow_count_as_wide_as_they_are_at_each_sample(about, rng):
    from jaxbound.studies.identification.judging import WindowJudge

    model = jb.LinearSystem(A, B, C, D, noise=NOISE.tolist(), offset=OFFSET, resolution=[0.02, 0], **about)
    model = model.replace(times={"y1": "0.5 + abs(u1)"})
    part = (rng.normal(size=(40, 1)), rng.normal(size=(40, 2)), np.array([15]))
    (proved,) = WindowJudge().needs(model, [part])
    (each,) = GaugeJudge(every=True).needs(model, [part])
    np.testing.assert_allclose(each, proved, rtol=1e-6)
    (largest,) = GaugeJudge().needs(model, [part])
    assert np.nanmax(largest) == pytest.approx(np.nanmax(proved), rel=1e-6)
    assert (largest <= proved * (1 + 1e-9))[np.isfinite(proved)].all()
    assert np.isnan(proved).sum() == 14


def test_sizes_are_those_of_the_proved_test(rng):
    from jaxbound.studies.identification.judging import WindowJudge
    from jaxbound.studies.identification.regression import Scales

    model = jb.LinearSystem(A, B, C, D, noise=NOISE.tolist(), offset=OFFSET, horizon=5)
    scales = Scales(np.zeros(1), np.ones(1), np.zeros(2), np.array([0.7, 2.0]))
    for found, proved in zip(
        GaugeJudge().sizes(model, scales), WindowJudge().sizes(model, scales), strict=True
    ):
        assert found == pytest.approx(proved, rel=1e-6)


def test_the_slope_of_a_ramp_that_no_constant_and_no_noise_hides():
    # f, 2 f, 3 f: within f of a constant, which noise of .5 hides twice
    model = jb.LinearSystem([[1]], None, [[1]], noise=0.5, horizon=2)
    scales = scales_of([(np.zeros((4, 0)), np.array([[0.0], [1], [0], [1]]), np.zeros(0, int))])
    assert seen_slopes(model, scales)["y1"] == pytest.approx(1)
