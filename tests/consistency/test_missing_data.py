"""Missing samples: the verdict is the one of the linear program without those rows; gradients survive."""

from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import MODELS, Plant, Windows, draw
from systems import paper

import jaxbound as jb
from jaxbound.sets.floats.status import Status


def prepared(name, horizon, count, rng):
    """Return relations, oracle, u, y of windows near the boundary."""
    oracle = Windows(Plant(**MODELS[name]), horizon)
    u, centre, y = draw(oracle.plant, horizon, count, rng, spread=8.0)
    return jb.parity_relations(jb.LinearSystem(**MODELS[name]), horizon=horizon), oracle, u, y


@pytest.mark.parametrize(
    "horizon, count",
    [
        *((s, 200) for s in (1, 2, 3, 4)),
        *(pytest.param(s, 1800, marks=pytest.mark.long) for s in (1, 2, 3, 4)),
    ],
)
def test_one_missing_output_gives_the_verdict_of_the_program_without_its_row(horizon, count, rng):
    """The long run removes each of 28 rows from 1800 windows: 50 400 in all."""
    r, oracle, u, full = prepared("paper", horizon, count, rng)
    for sample in range(horizon + 1):
        for output in range(2):
            y = full.copy()
            y[:, sample, output] = np.nan
            status, slack = jb.detect(r, u, y).status[:, -1], oracle.slack(u, y)
            sure = abs(slack) > 1e-8
            assert sure.mean() > 0.99
            np.testing.assert_array_equal(
                status[sure], np.where(slack > 0, Status.FAULT, Status.CONSISTENT)[sure]
            )
            assert 0.1 < (slack > 0).mean() < 0.9


@pytest.mark.parametrize(
    "name, horizon, gone", [("paper", 2, 2), ("paper", 3, 3), ("three states", 2, 2), ("offsets", 2, 3)]
)
def test_several_missing_outputs_give_the_verdict_of_the_program_without_them(name, horizon, gone, rng):
    r, oracle, u, y = prepared(name, horizon, 600, rng)
    rows = np.argsort(rng.random((len(y), oracle.O.shape[0])), 1)[:, :gone]
    y.reshape(len(y), -1)[np.arange(len(y))[:, None], rows] = np.nan
    status, slack = jb.detect(r, u, y).status[:, -1], oracle.slack(u, y)
    known = np.array(
        [any(set(np.flatnonzero(h)).isdisjoint(gone_rows) for h in oracle.circuits) for gone_rows in rows]
    )
    np.testing.assert_array_equal(status[~known], Status.MISSING)
    sure = known & (abs(slack) > 1e-8)
    assert sure.sum() > 400
    np.testing.assert_array_equal(status[sure], np.where(slack > 0, Status.FAULT, Status.CONSISTENT)[sure])


def test_margin_with_a_missing_output_is_the_gauge_without_its_row(rng):
    r, oracle, u, y = prepared("paper", 2, 100, rng)
    y[:, 1, 0] = np.nan
    np.testing.assert_allclose(
        jb.detect(r, u, y).margin[:, -1], 1 - oracle.gauge_by_program(u, y), rtol=1e-7, atol=1e-9
    )


def test_a_missing_sample_touches_only_the_windows_that_hold_it(rng):
    r, u, y = jb.parity_relations(paper(), horizon=2), rng.uniform(-1, 1, (60, 1)), rng.normal(size=(60, 2))
    whole, holes = jb.detect(r, u, y), y.copy()
    holes[30] = np.nan
    res = jb.detect(r, u, holes)
    same = np.r_[0:30, 33:60]
    np.testing.assert_array_equal(res.status[same], whole.status[same])
    np.testing.assert_array_equal(res.margin[same], whole.margin[same])
    assert not np.array_equal(res.margin[30:33], whole.margin[30:33])


def test_a_missing_input_silences_the_circuits_that_use_it_and_no_other(rng):
    r, oracle, u, y = prepared("paper", 2, 400, rng)
    u[:, 0] = np.nan  # u_k reaches y2 of sample k + 1 and everything later
    used = oracle.circuits @ oracle.H
    free = abs(used[:, 0]) < 1e-12
    assert 0 < free.sum() < len(free)
    lo, hi = oracle.limits(np.nan_to_num(u), y)
    gauge = (
        abs((lo + hi) / 2 @ oracle.circuits[free].T) / ((hi - lo) / 2 @ abs(oracle.circuits[free]).T)
    ).max(1)
    res = jb.detect(r, u, y)
    np.testing.assert_allclose(res.margin[:, -1], 1 - gauge, rtol=1e-9, atol=1e-11)
    np.testing.assert_array_equal(res.status[:, -1] == Status.FAULT, gauge > 1)


@pytest.mark.parametrize("name, horizon", [("paper", 2), ("offsets", 2), ("feedthrough", 2)])
def test_a_fault_with_a_missing_input_is_one_for_every_value_of_that_input(name, horizon, rng):
    r, oracle, u, y = prepared(name, horizon, 600, rng)
    slack = oracle.slack(np.where(np.arange(horizon + 1)[:, None] == 0, 0, u), y, free=range(oracle.plant.m))
    u[:, 0] = np.nan
    fault = jb.detect(r, u, y).status[:, -1] == Status.FAULT
    assert fault.sum() > 100
    assert (slack[fault] > -1e-8).all()


@pytest.mark.parametrize("name, horizon", [("paper", 2), ("offsets", 1)])
def test_consistent_with_a_missing_input_is_so_for_some_value_of_that_input(name, horizon, rng):
    """A combination of circuits that cancels the input can be violated where no single circuit without it
    is.
    """
    r, oracle, u, y = prepared(name, horizon, 1500, rng)
    slack = oracle.slack(np.where(np.arange(horizon + 1)[:, None] == 0, 0, u), y, free=range(oracle.plant.m))
    u[:, 0] = np.nan
    consistent = jb.detect(r, u, y).status[:, -1] == Status.CONSISTENT
    assert (slack[consistent] < 1e-8).all()


def test_a_missing_newest_input_does_not_matter_without_feedthrough(rng):
    r, u, y = (
        jb.parity_relations(paper(), horizon=1),
        rng.uniform(-1, 1, (50, 2, 1)),
        rng.normal(size=(50, 2, 2)),
    )
    holes = u.copy()
    holes[:, 1] = np.nan
    np.testing.assert_array_equal(jb.detect(r, u, y).margin, jb.detect(r, holes, y).margin)


@pytest.mark.parametrize("method", ["joint", "box"])
def test_windows_without_any_output_are_missing(method, rng):
    u, y = rng.uniform(-1, 1, (9, 1)), rng.normal(size=(9, 2)) / 100
    y[3:6] = np.nan
    res = jb.detect(jb.parity_relations(paper()), u, y, method=method)
    assert (res.status[[0, 4, 5]] == Status.MISSING).all() and np.isnan(res.margin[[0, 4, 5]]).all()
    assert (res.status[[1, 2, 7, 8]] != Status.MISSING).all()


@pytest.mark.parametrize(
    "horizon, method",
    [
        (1, "joint"),
        (1, "box"),
        (3, "joint"),
        (3, "box"),
    ],
)
def test_the_first_samples_are_missing(horizon, method, rng):
    u, y = rng.uniform(-1, 1, (2, 8, 1)), rng.normal(size=(2, 8, 2)) / 100
    res = jb.detect(
        jb.parity_relations(paper(), horizon=horizon),
        u,
        y,
        method=method,
    )
    assert (res.status[:, :horizon] == Status.MISSING).all() and np.isnan(res.margin[:, :horizon]).all()
    assert (res.status[:, horizon:] != Status.MISSING).all()


@pytest.mark.parametrize("samples", [0, 1, 2])
def test_a_recording_shorter_than_a_window_is_missing(samples):
    res = jb.detect(jb.parity_relations(paper(), horizon=2), np.zeros((samples, 1)), np.zeros((samples, 2)))
    assert res.status.shape == (samples,) and (res.status == Status.MISSING).all()


@pytest.fixture(scope="module")
def gradients(module_seed):
    """Return r, u, y with holes, and the compiled sum of margins with its gradients by bounds, y and u."""
    rng = np.random.default_rng([module_seed, 2])
    r, u, y = jb.parity_relations(paper(), horizon=2), rng.uniform(-1, 1, (64, 1)), rng.normal(size=(64, 2))
    y[rng.random(y.shape) < 0.15] = np.nan
    u[rng.random(u.shape) < 0.05] = np.nan
    y[20:25] = np.nan

    def total(bounds, y, u, keep):
        margins = jb.margins(r.with_bounds(bounds), u, y)
        return jnp.nansum(jnp.where(keep, margins, 0)), margins

    both = jax.jit(jax.value_and_grad(total, (0, 1, 2), has_aux=True))
    bounds = {name: jnp.asarray(b) for name, b in r.bounds.items()}
    return (
        bounds,
        u,
        y,
        lambda bounds, y, u, keep=True: both(bounds, *map(jnp.asarray, (y, u)), np.broadcast_to(keep, 64)),
    )


def test_gradient_of_margins_is_finite_with_missing_samples(gradients):
    bounds, u, y, both = gradients
    by_bounds, by_y, by_u = both(bounds, y, u)[1]
    for g in (*by_bounds.values(), by_y, by_u):
        assert np.isfinite(g).all()
    assert all((np.asarray(g) > 0).all() for g in by_bounds.values())  # wider bounds, larger margins


STEP = 1e-6


def smooth(here, up, down):
    """Return which windows have no kink within a step to either side, where another relation takes over:
    there the differences agree.
    """
    bend, slope = abs(np.asarray(up - 2 * here + down)), abs(np.asarray(up - down))
    keep = ~(
        bend > 1e-3 * slope + 1e-11
    )  # of a smooth margin it is 1e-4, of a kink 1; NaN is not counted anyway
    assert keep.mean() > 0.9
    return keep


def test_gradient_by_the_bounds_equals_finite_differences(gradients):
    bounds, u, y, both = gradients
    here = both(bounds, y, u)[0][1]
    for field, i in [(f, i) for f in ("tolerance", "noise") for i in range(2)]:
        up, down = ({**bounds, field: bounds[field] + sign * STEP * np.eye(2)[i]} for sign in (1, -1))
        keep = smooth(here, *(both(b, y, u)[0][1] for b in (up, down)))
        got = both(bounds, y, u, keep)[1][0][field][i]
        difference = both(up, y, u, keep)[0][0] - both(down, y, u, keep)[0][0]
        np.testing.assert_allclose(got, difference / (2 * STEP), rtol=1e-5)


def test_gradient_by_the_samples_equals_finite_differences(gradients):
    bounds, u, y, both = gradients
    here = both(bounds, y, u)[0][1]
    for k in (5, 10, 30, 40, 50):
        for which in range(2):
            moved = [
                [v + sign * STEP * (np.arange(64)[:, None] == k) * (n == which) for n, v in enumerate((y, u))]
                for sign in (1, -1)
            ]
            keep = smooth(here, *(both(bounds, *data)[0][1] for data in moved))
            got = both(bounds, y, u, keep)[1][1 + which][k].sum()
            up, down = (both(bounds, *data, keep)[0][0] for data in moved)
            np.testing.assert_allclose(got, (up - down) / (2 * STEP), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("rows", list(combinations(range(4), 2)))
def test_two_of_four_samples_say_nothing_about_two_states(rows, rng):
    u, y = rng.uniform(-1, 1, (20, 2, 1)), rng.normal(size=(20, 2, 2)) * 1e3
    y.reshape(20, 4)[:, rows] = np.nan
    assert (jb.detect(jb.parity_relations(paper(), horizon=1), u, y).status == Status.MISSING).all()
