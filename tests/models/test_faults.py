"""Faults put into a simulation: what each kind does to the recording, and nothing else."""

import jax
import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.models import simulate as module

pytestmark = pytest.mark.usefixtures("simulated_by_xla")

SENSOR = ("bias", "drift", "gain", "noise", "tolerance", "stuck", "dropout")
ACTUATOR = ("bias", "drift", "gain", "noise", "stuck", "dropout")
N, T, SIZE = 300, 40, 0.3
ON = {
    kind: slice(3 + 5 * i, 7 + 5 * i) for i, kind in enumerate(SENSOR)
}  # four samples each, one healthy sample between
OFF = np.setdiff1d(np.arange(T), np.concatenate([np.arange(T)[on] for on in ON.values()]))
EFFECT = {
    "bias": lambda v, noise: v + SIZE,
    "drift": lambda v, noise: v + SIZE * np.arange(4),
    "gain": lambda v, noise: (v - noise) * (1 + SIZE) + noise,
    "stuck": lambda v, noise: np.broadcast_to(v[:, :1], v.shape),
}


@pytest.fixture(scope="module")
def run(module_seed):
    """One simulation with every sensor fault of y2 in turn, and every actuator fault at the same times."""
    u = np.random.default_rng(module_seed).uniform(-1, 1, (N, T, 1))
    each = [("y2", kind) for kind in SENSOR] + [("u1", kind) for kind in ACTUATOR]
    faults = [jb.Fault(signal, kind, SIZE, ON[kind].start, ON[kind].stop) for signal, kind in each]
    t = jax.tree.map(np.asarray, jb.simulate(paper(), u, jax.random.key(module_seed), faults=faults))
    np.testing.assert_array_equal(t.u, u)  # an actuator's fault is not recorded
    return t


def healthy(t):
    """Return what the sensors of the simulated plant would have read, (N, T, 2)."""
    return (1 + t.theta) * np.stack([t.x[..., 0], t.x.sum(-1)], -1) + t.noise


def received(t):
    """Return what the plant got from its actuator, (N, T - 1): x2+ = 0.2 x2 + u."""
    return t.x[:, 1:, 1] - 0.2 * t.x[:, :-1, 1]


@pytest.mark.parametrize("kind", EFFECT)
def test_sensor_fault_changes_its_samples_as_described(kind, run):
    faultless, noise = healthy(run)[:, ON[kind], 1], run.noise[:, ON[kind], 1]
    np.testing.assert_allclose(run.y[:, ON[kind], 1], EFFECT[kind](faultless, noise), rtol=1e-13, atol=1e-14)


def test_sensor_dropout_leaves_nan(run):
    assert np.isnan(run.y[:, ON["dropout"], 1]).all()
    assert np.isnan(run.y).sum() == 4 * N


def test_sensor_noise_adds_a_value_of_its_own_to_each_sample(run):
    added = (run.y - healthy(run))[:, ON["noise"], 1] / SIZE
    assert (abs(added) <= 1 + 1e-12).all() and abs(added).max() > 0.99
    assert abs(added.std() - 3**-0.5) < 0.05 and abs(added.mean()) < 0.1
    assert len(np.unique(added.round(12))) == added.size


def test_sensor_tolerance_draws_theta_within_its_size(run):
    theta = run.theta[:, ON["tolerance"], 1] / SIZE
    assert (abs(theta) <= 1 + 1e-15).all() and abs(theta).max() > 0.99 and abs(theta.std() - 3**-0.5) < 0.05
    assert abs(np.delete(run.theta[..., 1], np.r_[ON["tolerance"]], 1)).max() <= 0.1


def test_sensor_tolerance_acts_on_the_recording(run):
    np.testing.assert_allclose(
        run.y[:, ON["tolerance"], 1], healthy(run)[:, ON["tolerance"], 1], rtol=1e-13, atol=1e-14
    )


def test_sensor_faults_leave_the_other_samples_and_signals_alone(run):
    np.testing.assert_allclose(run.y[:, OFF], healthy(run)[:, OFF], rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(run.y[..., 0], healthy(run)[..., 0], rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("kind", ACTUATOR)
def test_actuator_fault_changes_what_the_plant_receives(kind, run):
    got, commanded = received(run)[:, ON[kind]], run.u[:, ON[kind], 0]
    if kind == "noise":
        assert (abs(got - commanded) <= SIZE + 1e-12).all() and abs(got - commanded).max() > 0.9 * SIZE
    else:
        expected = np.zeros_like(commanded) if kind == "dropout" else EFFECT[kind](commanded, 0)
        np.testing.assert_allclose(got, expected, atol=1e-14)


def test_actuator_faults_leave_the_plant_alone_at_other_samples(run):
    quiet = np.setdiff1d(np.arange(T - 1), np.concatenate([np.arange(T)[ON[kind]] for kind in ACTUATOR]))
    np.testing.assert_allclose(received(run)[:, quiet], run.u[:, quiet, 0], atol=1e-14)


@pytest.fixture
def three(rng):
    """Return a function of three faults (bias, gain, bias) of y2 and their times that gives y2 (3, T), always
    with the same draws.
    """
    u, key = rng.uniform(-1, 1, (3, T, 1)), jax.random.key(int(rng.integers(2**31)))

    def simulate(sizes, when=((5,),) * 3):
        faults = [
            jb.Fault("y2", kind, size, *at)
            for kind, size, at in zip(("bias", "gain", "bias"), sizes, when, strict=True)
        ]
        return np.asarray(jb.simulate(paper(), u, key, faults=faults).y)[..., 1]

    return simulate


def test_faults_of_one_signal_act_in_the_order_given(three):
    none, before, after = three((0, 1, 0)), three((1, 1, 0)), three((0, 1, 1))
    np.testing.assert_allclose((before - none)[:, 5:], 2, atol=1e-12)
    np.testing.assert_allclose((after - none)[:, 5:], 1, atol=1e-12)


def test_a_fault_lasts_until_its_stop_or_to_the_end(three):
    k, none = np.arange(T), three((0, 0, 0))
    np.testing.assert_allclose((three((1, 0, 0), ((12,), (5,), (5,))) - none)[0], k >= 12, atol=1e-12)
    np.testing.assert_allclose(
        (three((1, 0, 0), ((12, 20), (5,), (5,))) - none)[0], (k >= 12) & (k < 20), atol=1e-12
    )


def test_size_and_time_of_a_fault_do_not_trace_again(three):
    three((0, 0, 0))
    traced = module._trajectory._cache_size()
    three((1, 2, 3), ((12, 20), (1, 3), (9,)))
    assert module._trajectory._cache_size() == traced


@pytest.mark.parametrize(
    "given, message",
    [
        (
            dict(kind="offset"),
            "kind of fault must be one of bias, drift, gain, noise, tolerance, stuck, dropout, not 'offset'",
        ),
        (dict(size=float("nan")), "size of a fault must be a finite number, not nan"),
        (dict(size=float("inf")), "size of a fault must be a finite number, not inf"),
        (dict(start=-1), "a fault needs 0 <= start < stop: start -1, stop None"),
        (dict(start=5, stop=5), "a fault needs 0 <= start < stop: start 5, stop 5"),
    ],
)
def test_a_fault_that_makes_no_sense_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        jb.Fault("y1", **given)


@pytest.mark.parametrize(
    "given, message",
    [
        (jb.Fault("y9"), "the model has no signal 'y9'; did you mean 'y"),
        (jb.Fault("u1", "tolerance", 0.1), "a tolerance fault needs an output, 'u1' is an input"),
        (jb.Fault("y1", start=40), "the fault of 'y1' starts at sample 40, but there are 40 samples"),
    ],
)
def test_a_fault_that_does_not_fit_the_simulation_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        jb.simulate(paper(), np.zeros((40, 1)), jax.random.key(0), faults=[given])
