"""Faults as states: an observer encloses a bias that is there, and says that the others are not."""

from fractions import Fraction

import jax
import numpy as np
import pytest

import jaxbound as jb
from jaxbound.models.uncertainty import centred

PLANT = jb.LinearSystem(
    [["0.9", "0.1"], [0, "0.8"]],
    [[0], [1]],
    [[1, 0], [1, 0]],
    [[0], [0]],
    noise="0.1",
    outputs=["T1", "T2"],
    inputs=["heat"],
    disturbance=([[1], [0]], "0.01"),
)


def test_a_bias_is_enclosed_and_zero_is_not():
    faulty = [jb.Fault("T2", "bias", 0.8, start=60)]
    u = np.ones((200, 1))
    found = jb.simulate(PLANT, u, jax.random.key(0), faults=faulty)
    model = jb.with_faults(PLANT, "T2:drift", rate=0.02)
    told = jb.observe(model, found.u, found.y, order=10, x0=jb.interval([-50, -50, -5], [50, 50, 5]))
    lo, hi = np.asarray(told.state.lo)[:, 2], np.asarray(told.state.hi)[:, 2]
    jump = told.status[60:65] == jb.Status.FAULT  # a jump is no drift of 0.02 a sample
    assert (lo[5:60] < 0).all() and (hi[5:60] > 0).all() and jump.any()
    slow = np.array(jb.simulate(PLANT, u, jax.random.key(1)).y)
    truth = np.clip(0.015 * (np.arange(200) - 60), 0, 0.9)
    slow[:, 1] += truth
    told = jb.observe(model, u, slow, order=10, x0=jb.interval([-50, -50, -5], [50, 50, 5]))
    lo, hi = np.asarray(told.state.lo)[:, 2], np.asarray(told.state.hi)[:, 2]
    assert not (told.status == jb.Status.FAULT).any()
    assert ((lo <= truth) & (truth <= hi)).all()
    assert (lo[150:] > 0).all() and not (lo[:60] > 0).any() and (hi[150:] - lo[150:] < 1).all()


def test_an_actuator_and_uncertain_parameters_keep_their_faults():
    model = PLANT.replace(uncertainties=[jb.Uncertainty("gain", B=[[0], ["0.1"]])])
    grown = jb.with_faults(model, "heat:bias", "T1:bias")
    assert (
        grown.A[1] == (0, Fraction(8, 10), 1, 0) and grown.A[2] == (0, 0, 1, 0) and grown.C[0] == (1, 0, 0, 1)
    )
    (gain,) = grown.uncertainties
    assert gain.A[1] == (0, 0, Fraction(1, 10), 0) and gain.B[1] == (Fraction(1, 10),) and gain.C is None
    assert grown.states == ("x1", "x2", "heat:bias", "T1:bias") and grown.disturbance == model.disturbance
    # it is the model itself, with the fault in its input
    u = np.ones((50, 1))
    plain, key = PLANT.replace(noise=0, disturbance=None), jax.random.key(0)
    want = jb.simulate(plain, u + 0.5, key).y
    got = jb.simulate(jb.with_faults(plain, "heat:bias"), u, key, x0=[0, 0, 0.5]).y
    np.testing.assert_allclose(got, want, rtol=1e-12)


def test_the_bounds_of_parameters_stay_what_they_are():
    gain = jb.Uncertainty("gain", B=[[0], ["0.1"]], between=("0.5", "0.9"))
    (kept,) = jb.with_faults(PLANT.replace(uncertainties=gain), "T1:bias").uncertainties
    assert kept.between == gain.between and kept.B[:2] == gain.B


def stepped(model, theta, values, x, u):
    """Return (x+, y less its noise) at values of the parameters and at relative errors, exact."""

    def times(letter, z):
        rows = [list(row) for row in centred(getattr(model, letter), model.uncertainties, letter, -1)]
        for p in model.uncertainties:
            for i, row in enumerate(getattr(p, letter) or ()):
                rows[i] = [a + values[p.name] * b for a, b in zip(rows[i], row, strict=True)]
        return [sum((a * b for a, b in zip(row, z, strict=True)), Fraction(0)) for row in rows]

    added = lambda *parts: [sum(each) for each in zip(*parts, strict=True)]
    true = added(times("C", x), times("D", u))
    return added(times("A", x), times("B", u)), [
        (1 + share) * t for share, t in zip(theta, true, strict=True)
    ]


@pytest.mark.parametrize("constant", [False, True])
def test_faults_as_states_are_those_that_a_fault_simulates(constant, rng):
    """y = (1 + theta) (C x + D (u + a)) + b: a sensor's bias b behind its relative error, an actuator's a
    before it.
    """
    loss = jb.Uncertainty("loss", A=[["0.1", 0], [0, "0.3"]], B=[[0], [1]], between=("-0.2", "0.6"))
    model = PLANT.replace(
        D=[["0.5"], [2]], tolerance=["0.1", "0.3"], constant_tolerance=constant, uncertainties=loss
    )
    grown = jb.with_faults(model, "T1:bias", "heat:bias")
    assert {p.name: p.between for p in grown.uncertainties}["loss"] == loss.between
    assert all(p.varying is not constant for p in grown.uncertainties[1:])
    for _ in range(8):
        *x, b, a, u = (Fraction(int(v), 7) for v in rng.integers(-70, 71, 5))
        values = {p.name: p.centre + p.radius * int(rng.integers(-8, 9)) / 8 for p in grown.uncertainties}
        theta = [values.get(f"tolerance of {name}", Fraction(3, 16)) for name in model.outputs]
        left = [share if grown.tolerance[i] else 0 for i, share in enumerate(theta)]
        after, (first, second) = stepped(model, theta, values, x, [u + a])
        assert stepped(grown, left, values, [*x, b, a], [u]) == ([*after, b, a], [first + b, second])


def test_the_fault_of_a_sensor_with_a_tolerance_is_enclosed(rng):
    """Exact recordings of such a fault, errors at their bounds: no FAULT, and the truth is in every
    interval.
    """
    model = PLANT.replace(tolerance=["0.1", "0.02"])
    watch = jb.with_faults(model, "T1:drift", rate="0.001")
    x, b, y, truth = [Fraction(30), Fraction(40)], Fraction(-25), [], []
    for _ in range(200):
        theta = [int(rng.choice([-1, 1])) * t for t in model.tolerance]
        noise = [int(rng.choice([-1, 1])) * e for e in model.noise]
        after, (first, second) = stepped(model, theta, {}, x, [Fraction(1)])
        y.append([float(first + b + noise[0]), float(second + noise[1])])
        truth.append([float(v) for v in (*x, b)])
        x, b = (
            [after[0] + int(rng.choice([-1, 1])) * Fraction(1, 100), after[1]],
            b + Fraction(int(rng.choice([-1, 1])), 1000),
        )
    told = jb.observe(watch, np.ones((200, 1)), y, order=10, x0=jb.interval([-50, -50, -50], [50, 50, 50]))
    assert not (told.status == jb.Status.FAULT).any()
    assert ((told.state.lo <= truth) & (np.array(truth) <= told.state.hi)).all()
    assert told.state.hi[-1, 2] < 0  # and it says that there is one


def test_simulated_faults_of_a_sensor_with_a_tolerance_fit_windows():
    model = jb.LinearSystem([[1]], None, [[1], [1]], noise="0.01", tolerance=["0.1", 0], outputs=["T1", "T2"])
    found = jb.simulate(
        model, np.zeros((60, 0)), 3, x0=[100.0], at="vertices", faults=[jb.Fault("T1", "bias", size=-100.0)]
    )
    verdicts = jb.detect(jb.parity_relations(jb.with_faults(model, "T1:bias"), horizon=1), found.u, found.y)
    assert verdicts.counts["FAULT"] == 0 and verdicts.counts["MISSING"] == 1


@pytest.mark.parametrize(
    "match, more",
    [
        ("an unknown input acts on the same output", dict(unknown_inputs=([[0], [0]], [[1], [0]]))),
        (
            "a parameter acts on the same output",
            dict(uncertainties=jb.Uncertainty("span", C=[["0.1", 0], [0, 0]])),
        ),
        ("the model has averages", dict(averages={"T2": {4: "0.1"}})),
    ],
)
def test_a_tolerance_that_cannot_become_a_parameter_is_refused(match, more):
    with pytest.raises(ValueError, match=f"{match}: give the tolerance of 'T1' as noise"):
        jb.with_faults(PLANT.replace(tolerance=["0.1", 0], **more), "T1:bias")
    assert jb.with_faults(PLANT.replace(tolerance=["0.1", 0], **more), "T2:bias").tolerance == (
        Fraction(1, 10),
        0,
    )


@pytest.mark.parametrize(
    "match, faults, more",
    [
        ("no 'T3'|T3", ["T3:bias"], {}),
        ("'signal:bias' or 'signal:drift'", ["T1:stuck"], {}),
        ("named twice", ["T1:bias", "T1:bias"], {}),
        ("at least", [], {}),
        ("needs a rate", ["T1:drift"], {}),
        ("rate is for drifts", ["T1:bias"], {"rate": 1}),
        ("rate is for drifts, and T2", ["T1:drift"], {"rate": {"T1": 1, "T2": 1}}),
        ("must be >= 0", ["T1:drift"], {"rate": -1}),
    ],
)
def test_what_is_no_fault_is_said(match, faults, more):
    with pytest.raises(ValueError, match=match):
        jb.with_faults(PLANT, *faults, **more)
