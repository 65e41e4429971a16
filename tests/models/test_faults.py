"""Faults put into a simulation: what each kind does to the recording, and nothing else."""

import jax
import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.models import simulate as module

SENSOR = ("bias", "drift", "gain", "noise", "tolerance", "stuck", "dropout")
ACTUATOR = ("bias", "drift", "gain", "noise", "stuck", "dropout")
N, T, SIZE = 300, 40, 0.3
ON = {kind: slice(3 + 5 * i, 7 + 5 * i) for i, kind in enumerate(SENSOR)}  # four samples each, one healthy sample between
OFF = np.setdiff1d(np.arange(T), np.concatenate([np.arange(T)[on] for on in ON.values()]))
EFFECT = {
    "bias": lambda v: v + SIZE,
    "drift": lambda v: v + SIZE * np.arange(4),
    "gain": lambda v: v * (1 + SIZE),
    "stuck": lambda v: np.broadcast_to(v[:, :1], v.shape),
}


def every(kinds, signal):
    return [jb.Fault(signal, kind, SIZE, ON[kind].start, ON[kind].stop) for kind in kinds]


@pytest.fixture(scope="module")
def runs():
    """Simulations with the same draws: healthy, every sensor fault in turn, every actuator fault in turn."""
    seed = int(np.random.SeedSequence().entropy % 2**31)
    print(f"seed {seed}")
    u, key = np.random.default_rng(seed).uniform(-1, 1, (N, T, 1)), jax.random.key(seed)
    found = {name: jb.simulate(paper(), u, key, faults=f) for name, f in
             (("healthy", ()), ("sensor", every(SENSOR, "y2")), ("actuator", every(ACTUATOR, "u1")))}  # fmt: skip
    return {name: jax.tree.map(np.asarray, t) for name, t in found.items()}


@pytest.mark.parametrize("kind", EFFECT)
def test_sensor_fault_changes_its_samples_as_described(kind, runs):
    healthy, faulty = (runs[name].y[:, ON[kind], 1] for name in ("healthy", "sensor"))
    np.testing.assert_allclose(faulty, EFFECT[kind](healthy), rtol=1e-14, atol=1e-15)


def test_sensor_dropout_leaves_nan(runs):
    assert np.isnan(runs["sensor"].y[:, ON["dropout"], 1]).all()
    assert np.isnan(runs["sensor"].y).sum() == 4 * N


def test_sensor_noise_adds_a_value_of_its_own_to_each_sample(runs):
    added = (runs["sensor"].y - runs["healthy"].y)[:, ON["noise"], 1] / SIZE
    assert (abs(added) <= 1 + 1e-12).all() and abs(added).max() > 0.99
    assert abs(added.std() - 3**-0.5) < 0.05 and abs(added.mean()) < 0.1
    assert len(np.unique(added.round(12))) == added.size


def test_sensor_tolerance_draws_theta_within_its_size(runs):
    theta = runs["sensor"].theta[:, ON["tolerance"], 1] / SIZE
    assert (abs(theta) <= 1 + 1e-15).all() and abs(theta).max() > 0.99 and abs(theta.std() - 3**-0.5) < 0.05
    assert abs(np.delete(runs["sensor"].theta[..., 1], np.r_[ON["tolerance"]], 1)).max() <= 0.1


def test_sensor_tolerance_acts_on_the_recording(runs):
    t, on = runs["sensor"], ON["tolerance"]
    expected = (1 + t.theta[:, on, 1]) * t.x[:, on].sum(-1) + t.noise[:, on, 1]
    np.testing.assert_allclose(t.y[:, on, 1], expected, rtol=1e-13, atol=1e-14)


def test_sensor_faults_leave_the_other_samples_and_signals_alone(runs):
    healthy, faulty = runs["healthy"], runs["sensor"]
    np.testing.assert_array_equal(healthy.y[:, OFF], faulty.y[:, OFF])
    np.testing.assert_array_equal(healthy.y[..., 0], faulty.y[..., 0])
    np.testing.assert_array_equal(healthy.x, faulty.x)


@pytest.mark.parametrize("kind", ACTUATOR)
def test_actuator_fault_changes_what_the_plant_receives(kind, runs):
    x, on = runs["actuator"].x, ON[kind]
    received = (x[:, 1:, 1] - 0.2 * x[:, :-1, 1])[:, on]  # x2+ = 0.2 x2 + u
    commanded = runs["healthy"].u[:, on, 0]
    if kind == "noise":
        assert (abs(received - commanded) <= SIZE + 1e-12).all() and abs(received - commanded).max() > 0.9 * SIZE
    else:
        expected = np.zeros_like(commanded) if kind == "dropout" else EFFECT[kind](commanded)
        np.testing.assert_allclose(received, expected, atol=1e-14)


def test_actuator_faults_are_not_recorded(runs):
    np.testing.assert_array_equal(runs["actuator"].u, runs["healthy"].u)


def test_actuator_faults_leave_the_plant_alone_at_other_samples(runs):
    x = runs["actuator"].x
    received = x[:, 1:, 1] - 0.2 * x[:, :-1, 1]
    quiet = np.setdiff1d(np.arange(T - 1), np.concatenate([np.arange(T)[ON[kind]] for kind in ACTUATOR]))
    np.testing.assert_allclose(received[:, quiet], runs["healthy"].u[:, quiet, 0], atol=1e-14)


def test_the_outputs_of_a_plant_with_a_faulty_actuator_are_recorded_without_fault(runs):
    t = runs["actuator"]
    np.testing.assert_allclose(t.y, (1 + t.theta) * np.stack([t.x[..., 0], t.x.sum(-1)], -1) + t.noise, rtol=1e-13, atol=1e-14)


def test_faults_of_one_signal_act_in_the_order_given(rng):
    u, key = rng.uniform(-1, 1, (3, T, 1)), jax.random.key(int(rng.integers(2**31)))
    three = lambda first, last: [jb.Fault("y2", "bias", first, 5), jb.Fault("y2", "gain", 1.0, 5), jb.Fault("y2", "bias", last, 5)]
    before, after, none = (np.asarray(jb.simulate(paper(), u, key, faults=three(*sizes)).y)[:, 5:, 1] for sizes in ((1, 0), (0, 1), (0, 0)))
    np.testing.assert_allclose(before - none, 2, atol=1e-12)
    np.testing.assert_allclose(after - none, 1, atol=1e-12)


def test_a_fault_without_stop_lasts_to_the_end_and_its_size_and_time_do_not_trace(rng):
    u, key = rng.uniform(-1, 1, (3, T, 1)), jax.random.key(int(rng.integers(2**31)))
    y = [np.asarray(jb.simulate(paper(), u, key, faults=[jb.Fault("y1", "bias", 0.0)]).y)]
    traced = module._simulate._cache_size()
    y += [np.asarray(jb.simulate(paper(), u, key, faults=[jb.Fault("y1", "bias", 1.0, *when)]).y) for when in ((12,), (12, 20))]
    k = np.arange(T)
    np.testing.assert_allclose((y[1] - y[0])[0, :, 0], k >= 12, atol=1e-12)
    np.testing.assert_allclose((y[2] - y[0])[0, :, 0], (k >= 12) & (k < 20), atol=1e-12)
    assert module._simulate._cache_size() == traced


@pytest.mark.parametrize("given, message", [
    (dict(kind="offset"), "kind of fault must be one of bias, drift, gain, noise, tolerance, stuck, dropout, not 'offset'"),
    (dict(size=float("nan")), "size of a fault must be a finite number, not nan"),
    (dict(size=float("inf")), "size of a fault must be a finite number, not inf"),
    (dict(start=-1), "a fault needs 0 <= start < stop: start -1, stop None"),
    (dict(start=5, stop=5), "a fault needs 0 <= start < stop: start 5, stop 5"),
])  # fmt: skip
def test_a_fault_that_makes_no_sense_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        jb.Fault("y1", **given)


@pytest.mark.parametrize("given, message", [
    (jb.Fault("y9"), "the model has no column 'y9'; did you mean 'y"),
    (jb.Fault("u1", "tolerance", 0.1), "a tolerance fault needs an output, 'u1' is an input"),
    (jb.Fault("y1", start=40), "the fault of 'y1' starts at sample 40, but there are 40 samples"),
])  # fmt: skip
def test_a_fault_that_does_not_fit_the_simulation_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        jb.simulate(paper(), np.zeros((40, 1)), jax.random.key(0), faults=[given])
