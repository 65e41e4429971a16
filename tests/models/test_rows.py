"""Rows of a window: one description, and three evaluators of it that agree with the definition."""

import dataclasses
from fractions import Fraction

import jax
import numpy as np
import pytest

import jaxbound as jb
from jaxbound.certificates.checker.claim import claim_of
from jaxbound.certificates.checker.trajectories import limits as checker_limits
from jaxbound.certificates.plain import plain_model, plain_samples, plain_sums
from jaxbound.consistency.host_rows import HostRows
from jaxbound.models.rows import Kind, WeightedSum
from jaxbound.models.window import window_rows

# all of them floats, so that none is rounded up
NOISE, RESOLUTION, OFFSET = [Fraction(1, 2), Fraction(1, 4)], [Fraction(0), Fraction(1, 8)], [20, 0]
PLANT = dict(
    A=[["0.9", "0.1"], [0, "0.8"]],
    B=[["0.1"], ["0.2"]],
    C=[[1, 0], [0, 1]],
    noise=NOISE,
    resolution=RESOLUTION,
    offset={"y": OFFSET},
    disturbance=([[1], ["0.5"]], 0.1),
)
BOUND, HORIZON, WINDOWS = Fraction(1, 8), 3, 5
DIFFERENCE = WeightedSum(True, ((0, (Fraction(1),)), (1, (Fraction(-1),))))
STEADY = WeightedSum(False, ((0, (Fraction(1), Fraction(-2))),))
KINDS = {
    # of no model yet: errors of two sensors at one sample, and a change of a disturbance
    "two outputs": DIFFERENCE,
    "a disturbance": STEADY,
    "two outputs, two samples": WeightedSum(
        True, ((0, (Fraction(1, 3), Fraction(1))), (1, (Fraction(0), Fraction(-1, 7))))
    ),
}


def test_rows_stand_in_the_order_of_a_window():
    rows = window_rows(jb.LinearSystem(**PLANT, averages={"y2": {2: 0.1}, "w1": {2: 0.05}}), 2)
    found = [(row.kind, row.number, row.first, row.last) for row in rows]
    readings = [(Kind.READING, i, j, j) for j in range(3) for i in range(2)]
    assert found == [
        *readings,
        (Kind.DISTURBANCE, 0, 0, 0),
        (Kind.DISTURBANCE, 0, 1, 1),
        (Kind.SUM, 0, 0, 1),
        (Kind.SUM, 0, 1, 2),
        (Kind.SUM, 1, 0, 1),
    ]
    assert [len(rows), rows.readings, rows.single] == [11, 6, 8]


def test_a_sum_weighs_rows_of_single_samples():
    rows = window_rows(jb.LinearSystem(**PLANT, averages={"y2": {2: 0.1}, "w1": {2: 0.05}}), 2)
    measured, pushed = rows.of_sums[1], rows.of_sums[2]
    half = Fraction(1, 2)
    assert [(x.row, x.weight) for x in rows.terms(measured)] == [(3, half), (5, half)]
    assert [(x.row, x.weight) for x in rows.terms(pushed)] == [(6, half), (7, half)]


def test_with_lags_a_sum_is_looked_at_where_it_ends_at_a_sample_that_is():
    rows = window_rows(jb.LinearSystem(**PLANT, averages={"y1": {2: 0.1}}), 4, (0, 3))
    assert [row.seen for row in rows.of_sums] == [True, False, False, True]
    assert [rows.all[i].first for i in rows.seen if i < rows.readings] == [1, 1, 4, 4]


@pytest.mark.parametrize("times", [{}, {"y1": "abs(u1)"}], ids=["constant", "followed"])
@pytest.mark.parametrize("name", KINDS)
def test_three_evaluators_give_a_sum_of_any_signals_its_limits(name, times, rng):
    relations = jb.parity_relations(jb.LinearSystem(**PLANT, times=times), HORIZON)
    reading = relations.reading(np.float64)
    rows = dataclasses.replace(reading.window, sums=(KINDS[name],))
    reading = dataclasses.replace(reading, window=rows, average=np.array([float(BOUND)]))
    u, y = rng.uniform(-1, 1, (HORIZON, 1, WINDOWS)), rng.uniform(10, 30, (HORIZON + 1, 2, WINDOWS))
    factors = np.ones((HORIZON + 1, 2, WINDOWS))
    if times:
        factors[:, 0] = rng.uniform(0, 3, (HORIZON + 1, WINDOWS))
        u = np.concatenate([rng.uniform(-1, 1, (HORIZON + 1, 1, WINDOWS)), factors[:, :1]], 1)
    y[1, 1, 0] = np.nan
    mid, rad, scale, *_ = jax.jit(lambda u, y: reading.block(u, y))(u, y)
    whole = HostRows(reading, u, y, model=relations.model)
    ends = whole.ends()
    plain = plain_model(relations.model) | {"averages": plain_sums([KINDS[name]], [BOUND])}
    for n in range(WINDOWS):
        inputs, each = np.append(u[:HORIZON, :1, n], [[0]], 0), plain_samples(factors[..., n])
        claim = claim_of(plain, plain_samples(inputs), plain_samples(y[..., n]), factors=each)
        exact = checker_limits(claim)
        for number, row in enumerate(rows.of_sums, rows.single):
            wanted = limits(rows, row, y[..., n], factors[..., n])
            if wanted is None:
                assert whole.absent()[number, n] and np.isnan(mid[number, n])
                assert f"average{number - rows.single}" not in exact
                continue
            lo, hi = wanted
            assert tuple(Fraction(int(x[number, n]), whole.unit) for x in ends) == (lo, hi)
            floor = 10 * (row.values.terms + row.values.size) * claim["floor"]
            assert exact[f"average{number - rows.single}"] == (lo - floor, hi + floor)
            slip = 16 * Fraction(1, 2**53) * Fraction(float(scale[number, n]))
            assert abs(Fraction(float(mid[number, n])) - (lo + hi) / 2) <= slip
            assert abs(Fraction(float(rad[number, n])) - (hi - lo) / 2) <= slip


def limits(rows, row, y, factors):
    """Return (lo, hi) of a sum from the definition, without the floor; None where a sample is missing."""
    ulps = 4 * Fraction(1, 2**53)
    middle, rad = Fraction(0), Fraction(0)
    for i, weights in row.values.parts:
        for sample, weight in enumerate(weights, row.first):
            factor = Fraction(factors[sample, i]) if row.values.measured else 1
            rad += factor * BOUND * abs(weight) / row.values.size
            if not row.values.measured:
                continue
            if np.isnan(y[sample, i]):
                return None
            # of a window without lags every sample counts
            largest = max(abs(Fraction(v)) for v in y[:, i] if not np.isnan(v))
            middle += weight * (Fraction(y[sample, i]) - OFFSET[i])
            noise = NOISE[i] * Fraction(factors[:, i].max())
            rad += abs(weight) * (RESOLUTION[i] + ulps * (largest + noise))
    return middle - rad, middle + rad
