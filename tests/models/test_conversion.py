"""Objects that users bring: python-control and scipy.signal."""

from fractions import Fraction

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.monitoring import monitor
from jaxbound.models.conversion import as_model, from_control, from_scipy

control = pytest.importorskip("control")
signal = pytest.importorskip("scipy.signal")

A, B, C, D = [[0.0, 1.0], [-2.0, -3.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]


def floats(a):
    return np.array([[float(x) for x in row] for row in a])


def test_a_model_passes_unchanged():
    m = jb.LinearSystem([[0.5]], None, [[1]])
    assert as_model(m) is m


def test_hold_equals_the_closed_form():
    m = from_scipy(signal.lti(A, B, C, D), dt=0.1)
    a, b = np.exp(-0.1), np.exp(-0.2)  # poles -1 and -2
    np.testing.assert_allclose(
        floats(m.A), [[2 * a - b, a - b], [2 * (b - a), 2 * b - a]], rtol=0, atol=1e-15
    )
    np.testing.assert_allclose(floats(m.B), [[0.5 - a + b / 2], [a - b]], rtol=0, atol=1e-15)


def test_hold_works_with_a_singular_matrix():
    m = from_control(control.ss([[0.0, 1.0], [0.0, 0.0]], B, C, D), dt=0.5)  # a double integrator
    np.testing.assert_allclose(floats(m.A), [[1, 0.5], [0, 1]], atol=1e-16)
    np.testing.assert_allclose(floats(m.B), [[0.125], [0.5]], atol=1e-16)


def test_control_and_scipy_give_the_same_model():
    one, other = (
        from_control(control.ss(A, B, C, D), dt=0.1),
        from_scipy(signal.StateSpace(A, B, C, D), dt=0.1),
    )
    assert (one.A, one.B, one.C, one.D, one.dt) == (other.A, other.B, other.C, other.D, other.dt)


@pytest.mark.parametrize(
    "convert, sys",
    [
        (from_control, lambda dt: control.ss(A, B, C, D, dt)),
        (from_scipy, lambda dt: signal.dlti(A, B, C, D, dt=dt)),
    ],
)
class TestDiscrete:
    def test_decimals_are_kept(self, convert, sys):
        m = convert(sys(0.1))
        assert m.A == ((0, 1), (-2, -3)) and m.dt == 0.1 and isinstance(m.A[0][0], Fraction)

    def test_same_dt_is_welcome(self, convert, sys):
        assert convert(sys(0.1), dt=0.1).dt == 0.1

    def test_contradicting_dt_is_refused(self, convert, sys):
        with pytest.raises(ValueError, match="contradicts the sampling period of sys, 0.1 s"):
            convert(sys(0.1), dt=0.2)

    def test_unknown_period_needs_dt(self, convert, sys):
        with pytest.raises(ValueError, match="does not say its sampling period"):
            convert(sys(True))
        assert convert(sys(True), dt=2.0).dt == 2.0

    def test_door_takes_it(self, convert, sys):
        assert as_model(sys(0.1)).dt == 0.1


@pytest.mark.parametrize("sys", [control.ss(A, B, C, D), signal.lti(A, B, C, D)])
def test_continuous_needs_dt(sys):
    with pytest.raises(ValueError, match="sys is continuous: give the sampling period as dt="):
        as_model(sys)


@pytest.mark.parametrize("dt", [0, -1, float("inf")])
def test_dt_must_be_a_period(dt):
    with pytest.raises(ValueError, match="positive number of seconds"):
        from_control(control.ss(A, B, C, D), dt=dt)


def test_no_time_base_is_refused():
    with pytest.raises(ValueError, match="no time base"):
        from_control(control.ss(A, B, C, D, None), dt=0.1)


def test_labels_are_kept_and_made_up_ones_are_not():
    named = control.ss(A, B, C, D, 0.1, inputs=["heater"], outputs=["T"], states=["T", "flow"], name="oven")
    m = from_control(named, noise=0.1)
    assert (m.name, m.inputs, m.outputs, m.states) == ("oven", ("heater",), ("T",), ("T", "flow"))
    plain = from_control(control.ss(A, B, C, D, 0.1))
    assert (plain.name, plain.inputs, plain.outputs, plain.states) == (
        "model",
        ("u1",),
        ("y1",),
        ("x1", "x2"),
    )


def test_bounds_and_names_of_the_caller_win():
    m = from_control(
        control.ss(A, B, C, D, 0.1, outputs=["T"]),
        tolerance=0.02,
        noise="1/3",
        outputs=["temperature"],
        units={"u1": "%"},
    )
    assert (
        m.outputs == ("temperature",)
        and m.noise == (Fraction(1, 3),)
        and m.tolerance == (Fraction(1, 50),)
        and m.unit("u1") == "%"
    )


@pytest.mark.parametrize(
    "convert, sys, advice",
    [
        (from_control, control.tf([1], [1, 1]), r"control\.ss\(sys\)"),
        (from_scipy, signal.lti([1], [1, 1]), r"sys\.to_ss\(\)"),
        (from_scipy, signal.ZerosPolesGain([], [-1], 1), r"sys\.to_ss\(\)"),
    ],
)
def test_transfer_functions_are_sent_to_be_converted(convert, sys, advice):
    for door in (convert, as_model):
        with pytest.raises(TypeError, match=f"convert it first, {advice}"):
            door(sys)


@pytest.mark.parametrize("thing", [None, 3, [[1.0]], "model", np.eye(2)])
def test_other_things_are_refused(thing):
    with pytest.raises(TypeError, match="a model is a LinearSystem"):
        as_model(thing)
    for convert in (from_control, from_scipy):
        with pytest.raises(TypeError, match="state-space object"):
            convert(thing)


def test_a_nonlinear_system_is_refused():
    sys = control.nlsys(lambda t, x, u, p: -x, lambda t, x, u, p: x, inputs=1, outputs=1, states=1)
    with pytest.raises(
        TypeError, match="state-space object of python-control is needed, not NonlinearIOSystem"
    ):
        as_model(sys)


def test_a_converted_system_is_tested_end_to_end():
    import jax

    m = from_control(control.ss(A, B, C, D), dt=0.1, noise=0.01)
    u = np.sign(np.sin(np.arange(300.0) / 20))[:, None]
    run = jb.simulate(m, u, jax.random.key(0), faults=[jb.Fault("y1", "bias", 1.0, 200)])
    status = jb.detect(jb.parity_relations(m), run.u, run.y).status
    assert not (status[:200] == jb.Status.FAULT).any() and (status[200:203] == jb.Status.FAULT).any()


def test_a_state_space_object_is_a_model_for_a_monitor_and_names_its_door_elsewhere():
    from scipy.signal import dlti

    for package, sys in (
        ("control", control.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], 1.0)),
        ("scipy", dlti([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=1.0)),
    ):
        with pytest.raises(
            TypeError, match=rf"takes matrices, .*: jaxbound\.from_{package}\(system, dt, noise"
        ):
            jb.LinearSystem(sys, noise=0.1)
        assert monitor(sys).plant.A == as_model(sys).A
        assert detect(sys, [[0.0]] * 3, [[0.0]] * 3).status.tolist() == [0, 1, 1]
        with pytest.raises(TypeError, match=r"Monitor\(jaxbound\.monitor\(model\)\)"):
            jb.Monitor(sys)
    with pytest.raises(TypeError, match="a model is a LinearSystem, or a state-space object .*, not dict"):
        monitor({"A": 1})
