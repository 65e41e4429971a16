"""Data validation of fault-free recordings: the state is always inside, and no sensor is ever blamed."""

import jax
import numpy as np
import pytest
from validation_case import faulty, inside, paper, record, reference_width, width

import jaxbound as jb
from jaxbound.estimation.validation_windows import slide

BATCH = 1024


def check(rng, method, kind, recordings):
    """Validate recordings in batches; return how many windows there were."""
    m, windows, wide = paper(), 0, []
    for _ in range(0, recordings, BATCH):
        u, x, y = record(rng, m, min(BATCH, recordings), kind=kind)
        found = jb.validate(m, u, y, method=method)
        status = np.asarray(found.status)[:, 2:]
        assert inside(found, x).all()
        assert not found.faulty.any() and not (status == jb.Status.FAULT).any()
        windows += status.size
        wide.append(width(found))
    print(f"{method}, {kind}: {windows} windows, state inside all, 0 FAULT, mean width {np.mean(wide):.4f}")
    return windows


@pytest.mark.parametrize("kind", ["steps", "random"])
@pytest.mark.parametrize("method", ["joint", "sequential"])
def test_fault_free_recordings_give_no_alarm(rng, method, kind):
    assert check(rng, method, kind, 16) > 1000


@pytest.mark.parametrize("method", ["joint", "sequential"])
def test_a_first_state_that_is_given_is_that_of_the_first_sample(rng, method):
    m = paper()
    u, x, y = record(rng, m, 16)
    found = jb.validate(m, u, y, method=method, x0=jb.interval(x[:, 0] - 1e-3, x[:, 0] + 1e-3))
    assert inside(found, x).all() and not found.faulty.any()


@pytest.mark.compiled
@pytest.mark.parametrize("method", [pytest.param("joint", marks=pytest.mark.long), "sequential"])
def test_a_recording_is_judged_alike_in_any_company_and_nothing_is_traced_again(rng, method):
    m = paper()
    u, _, y = record(rng, m, 16)
    y[3:, 20:25, 0] += 5
    whole = jb.validate(m, u, y, method=method)
    traced = slide._cache_size()
    some = jb.validate(m, u[2:13], y[2:13], method=method)
    assert slide._cache_size() == traced
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(some), strict=True):
        np.testing.assert_array_equal(a[2:13], b)


@pytest.mark.long(by_day="test_fault_free_recordings_give_no_alarm")
@pytest.mark.parametrize("kind", ["steps", "random"])
@pytest.mark.parametrize("method", ["joint", "sequential"])
def test_a_million_fault_free_windows_give_no_alarm(rng, method, kind):
    """Half of a million for each kind of input."""
    assert check(rng, method, kind, 6 * BATCH) > 500_000


@pytest.mark.parametrize("count", [16, pytest.param(64, marks=pytest.mark.long)])
def test_the_paper_s_correction_by_the_centre_loses_the_state_and_never_calls_it_a_proof(rng, count):
    """Golden: all faults of 6 are found, and the true state is outside in 1 to 5 % of the windows."""
    m = paper()
    u, x, y = record(rng, m, count)
    bad, truth = faulty(y, 6.0 * reference_width(m, u, y) / 0.573)
    sound, centre = (
        jb.validate(m, u, bad, method="sequential", correction=c) for c in ("interval", "centre")
    )
    assert inside(sound, x).all() and 0.85 < inside(centre, x).mean() < 1
    assert (
        np.asarray(centre.faulty)[truth].mean() > 0.95
        and not (np.asarray(centre.status) == jb.Status.FAULT).any()
    )
    assert width(centre) < width(sound)


def three_sensors(rng, count, T=60):
    """Return (model, u, x, y): an uncertain parameter, one disturbance that pushes all states together,
    sensors with noise.
    """
    A, dA, B, G = (
        np.array([[0.7, 0.2, 0], [-0.1, 0.6, 0.3], [0, 0.1, 0.5]]),
        np.diag([0.05, 0, 0]),
        np.ones((3, 1)),
        [[1], [-2], [0.5]],
    )
    model = jb.LinearSystem(
        A,
        B,
        np.eye(3),
        noise=0.05,
        disturbance=(G, [[-0.1, 0.2]]),
        uncertainties=[jb.Uncertainty("a", A=dA, varying=True)],
    )
    edge = lambda shape: np.where(
        rng.random(shape) < 0.5, rng.uniform(-1, 1, shape), rng.choice([-1, 1], shape)
    )
    u, x = rng.uniform(-1, 1, (count, T, 1)), np.zeros((count, T, 3))
    x[:, 0] = rng.uniform(-1, 1, (count, 3))
    for k in range(T - 1):
        moved = np.einsum("kij,kj->ki", A + dA * edge((count, 1, 1)), x[:, k])
        x[:, k + 1] = moved + u[:, k] @ B.T + (0.05 + 0.15 * edge((count, 1))) @ np.transpose(G)
    return model, u, x, x + 0.05 * edge(x.shape)


@pytest.mark.long(by_day="test_fault_free_recordings_give_no_alarm")
def test_gaps_and_two_of_three_sensors_at_once_with_a_disturbance_of_one_direction(rng):
    model, u, x, y = three_sensors(rng, 32)
    gaps = y.copy()
    gaps[:, 5:][rng.random(gaps[:, 5:].shape) < 0.2] = np.nan
    gaps[:, 30:33] = np.nan
    found = jb.validate(model, u, gaps, horizon=2)
    assert inside(found, x).all() and not found.faulty.any()
    assert (np.asarray(found.status)[:, 30:33] == jb.Status.MISSING).all()
    assert np.isnan(np.asarray(found.residual.lo)[np.isnan(gaps)][6:]).all()

    bad, truth = y.copy(), np.zeros(y.shape, bool)
    truth[:, 20:26, :2] = True
    bad[truth] += 5
    found = jb.validate(model, u, bad, horizon=2)
    assert (np.asarray(found.faulty) == truth).all() and inside(found, x).all()
