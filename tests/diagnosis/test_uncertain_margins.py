"""Margins of models with uncertain parameters."""

import jax
import numpy as np
import pytest
from ploix_experiment import record
from uncertain_systems import TWO, relations

import jaxbound as jb
from jaxbound.sets.floats.status import Status

long = lambda *x: pytest.param(*x, marks=pytest.mark.long)


def noisy(rng, name, runs=2, **changes):
    """Return (relations, u, y) with faults and gaps."""
    u, y = record(rng, name, runs, "uniform", **changes)
    y[:, 50] += rng.choice([-1, 1], (runs, y.shape[-1])) * rng.uniform(4, 8, (runs, y.shape[-1]))
    return relations(name, **changes), u, y


def check_margins(r, u, y):
    res, found = jb.detect(r, u, y), np.asarray(jb.margins(r, u, y))
    assert np.array_equal(np.isnan(found), res.status == Status.MISSING)
    assert {Status.FAULT, Status.CONSISTENT} <= set(res.status.ravel().tolist())
    np.testing.assert_allclose(found, res.margin, rtol=1e-5, atol=1e-5)
    return found


def check_slopes(rng, r, u, y, ends):
    """Compare the derivatives at some windows with quotients of differences."""
    bounds, step, weights = jax.tree.map(np.asarray, r.bounds), 1e-6, rng.normal(size=len(ends))
    f = lambda bounds, y: jb.margins(r.with_bounds(bounds), u, y)[ends] @ weights
    by_bounds = {k: rng.normal(size=v.shape) * (np.asarray(v) > 0) for k, v in bounds.items()}
    by_y = rng.normal(size=y.shape)
    compiled = jax.jit(
        jax.value_and_grad(f, (0, 1))
    )  # finer than `detect`, whose margin of a single relation is good to 1e-6
    moved = lambda d: jax.tree.map(
        np.asarray, compiled({k: v + d * by_bounds[k] for k, v in bounds.items()}, y + d * by_y)
    )
    value, (of_bounds, of_y) = moved(0)
    assert float(value) == pytest.approx(
        float(np.asarray(jb.margins(r, u, y))[ends] @ weights), rel=1e-5, abs=1e-5
    )
    slope = sum((of_bounds[k] * by_bounds[k]).sum() for k in bounds) + (of_y * by_y).sum()
    quotient = float(moved(step)[0] - moved(-step)[0]) / (2 * step)
    assert np.isfinite(of_y).all() and float(slope) == pytest.approx(quotient, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("samples", [30, long(100)])
def test_margins_change_with_bounds_and_data(rng, samples):
    r, u, y = noisy(rng, "n2p1_paper_h3", noise=0.01)
    part = slice(100 - samples, None)
    check_slopes(rng, r, u[0, part], y[0, part], np.r_[10:20] if samples < 100 else np.r_[20:30, 49:53])


@pytest.mark.parametrize("name, changes", [(TWO, {}), long("n3p2_mixed3_h3", dict(noise=[0.02, 0.05]))])
def test_margins_of_several_relations_are_those_of_detect(rng, name, changes):
    check_margins(*noisy(rng, name, **changes))


@pytest.mark.long(by_day="test_margins_change_with_bounds_and_data")
def test_margins_of_several_relations_change_with_bounds_and_data(rng):
    r, u, y = noisy(rng, "n3p2_mixed3_h3", noise=[0.02, 0.05])
    check_slopes(rng, r, u[0], y[0], np.r_[50:53])


def test_margins_are_those_of_detect_with_lost_samples_too(rng):
    r, u, y = noisy(rng, "n2p1_paper_h3", noise=0.01)
    y[0, 30] = np.nan
    u[0, 60] = np.nan
    check_margins(r, u, y)
