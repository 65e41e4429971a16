"""Linear programs over whole recordings: the least factor, and the faults that stay hidden."""

import signal
import threading

import numpy as np
import pytest
from scipy.optimize import linprog

import jaxbound as jb
from jaxbound.studies.identification import trajectories
from jaxbound.studies.identification.trajectories import (
    added_fault,
    hidden_jumps,
    hidden_sizes,
    least_factor,
    sure_sizes,
)

NONE = np.zeros(0, int)


def part(y, u=None, starts=NONE):
    y = np.array(y, float)
    if y.ndim == 1:
        y = y[:, None]
    if u is None:
        u = np.zeros((len(y), 0))
    return np.array(u, float), y, np.array(starts, int)


def hidden_size(model, record, fault):
    (size,) = hidden_sizes(model, record, [fault])
    return size


def constant(drift=0.0, noise=1.0):
    return jb.LinearSystem([[1]], None, [[1]], noise=noise, disturbance=([[1]], drift))


def test_a_ramp_asks_for_what_noise_and_drift_together_explain():
    # x0 <= t, x2 >= 2 - t, x2 - x0 <= 2 t / 4: t = 2 / 2.5
    assert least_factor(constant(drift=0.25), part([0, 1, 2])) == pytest.approx(0.8)


def test_a_state_begins_anew_behind_a_start():
    assert least_factor(constant(), part([0, 0, 5, 5], starts=[2])) == pytest.approx(0)
    assert least_factor(constant(), part([0, 0, 5, 5])) == pytest.approx(2.5)


def test_a_missing_sample_asks_for_nothing():
    assert least_factor(constant(), part([0, np.nan, 3])) == pytest.approx(1.5)
    assert least_factor(constant(), part([np.nan, np.nan])) == 0


def test_a_missing_input_cuts_a_trajectory():
    model = jb.LinearSystem([[1]], [[1]], [[1]], noise=1)
    assert least_factor(model, part([0, 0, 7], u=[[0], [np.nan], [0]])) == pytest.approx(0)
    assert least_factor(model, part([0, 0, 7], u=[[0], [7], [0]])) == pytest.approx(0)


def test_a_factor_is_that_of_a_dense_program_in_the_first_state(rng):
    A, B, C = np.array([[0.9, 0.1], [0, 0.8]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0], [0.5, 1.0]])
    G, noise, walk = np.array([[1.0], [0.0]]), np.array([0.5, 0.25]), 0.1
    u, y = rng.normal(size=(12, 1)), rng.normal(size=(12, 2))
    model = jb.LinearSystem(A, B, C, noise=noise, disturbance=(G, walk))
    rows, left, wide = [], [], []
    for k in range(12):
        reach = [np.linalg.matrix_power(A, k)]
        pushes, free = np.zeros((2, 11)), np.zeros(2)
        for j in range(k):
            power = np.linalg.matrix_power(A, k - 1 - j)
            pushes[:, j], free = (power @ G)[:, 0], free + power @ B @ u[j]
        rows.append(C @ np.hstack([*reach, walk * pushes]))
        left.append(y[k] - C @ free)
        wide.append(noise)
    rows, left, wide = np.vstack(rows), np.concatenate(left), np.concatenate(wide)[:, None]
    within, one = np.hstack([np.zeros((11, 2)), np.eye(11)]), np.ones((11, 1))
    upper = np.vstack(
        [
            np.hstack([rows, -wide]),
            np.hstack([-rows, -wide]),
            np.hstack([within, -one]),
            np.hstack([-within, -one]),
        ]
    )
    target = np.concatenate([left, -left, np.zeros(22)])
    dense = linprog(np.append(np.zeros(13), 1), upper, target, bounds=[(None, None)] * 13 + [(0, None)])
    assert least_factor(model, part(y, u)) == pytest.approx(dense.fun, rel=1e-6)


def test_a_bias_hides_as_far_as_noise_and_a_known_input_let_it():
    # y = u + v, |v| <= 1, y = u: a bias of 1 is the noise itself
    model = jb.LinearSystem([[0]], [[1]], [[0]], [[1]], noise=1)
    assert hidden_size(model, part([1, 2, 3], u=[[1], [2], [3]]), jb.Fault("y1", "bias", 1)) == pytest.approx(
        1
    )


def test_a_bias_hides_in_a_constant_that_nobody_knows():
    assert hidden_size(constant(), part([0, 0, 0]), jb.Fault("y1", "bias", 1)) == np.inf


def test_a_drift_shows_by_its_last_sample():
    # 0.2, 0.4, 0.6 within 1 of a constant: 2 f <= 2
    hidden = hidden_size(constant(), part([0, 0, 0]), jb.Fault("y1", "drift", 1))
    assert hidden == pytest.approx(1)


def test_a_bias_of_an_actuator_shows_in_the_states():
    model = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=1)
    hidden = hidden_size(model, part([0, 0, 0, 0], u=np.zeros((4, 1))), jb.Fault("u1", "bias", 1))
    # x_k = x0 / 2^k + 2 f (1 - 2^-k): from x0 = -1 to 1 at k = 3
    assert hidden == pytest.approx((1 + 1 / 8) / (2 * (1 - 1 / 8)))


def test_a_fault_that_is_added_asks_for_the_bounds_that_would_hide_it():
    bias = jb.Fault("y1", "bias", 3.0, start=2)
    assert least_factor(constant(), added_fault(part([0] * 4), constant(), bias, -1)) == pytest.approx(1.5)
    moved = jb.LinearSystem([[0]], [[1]], [[1]], noise=1)
    pushed = added_fault(part([0] * 4, u=np.zeros((4, 1))), moved, jb.Fault("u1", "bias", 3.0), 1)
    assert least_factor(moved, pushed) == pytest.approx(3)


def test_no_noise_hides_twice_what_a_recording_without_noise_hides():
    # a constant lies between 0 and f: f = 2 hides; the ramp's 4 f within 2 of a constant, too
    jump, lasting, ramp = sure_sizes(constant(), 2, 1, 4)
    assert (jump["y1"], lasting["y1"], ramp["y1"]) == pytest.approx((4, 4, 4))


def test_a_jump_of_twice_the_noise_hides_where_nothing_remembers():
    assert hidden_jumps(jb.LinearSystem([[0]], None, [[0]], noise=1), 2, 3) == {"y1": pytest.approx(2)}


def test_the_program_of_an_unlimited_size_says_so_with_and_without_presolve(monkeypatch):
    asked = []

    def undecided(options, **named):
        asked.append(options["presolve"])
        answer = linprog(options=options, **named)
        if options["presolve"]:
            answer.status = 4
        return answer

    monkeypatch.setattr("scipy.optimize.linprog", undecided)
    assert hidden_size(constant(), part([0, 0, 0]), jb.Fault("y1", "bias", 1)) == np.inf
    assert least_factor(constant(), part([0, 0, 5, 5])) == pytest.approx(2.5)
    assert set(asked) == {True, False}


def test_a_program_that_goes_round_in_a_circle_is_given_to_another_method(monkeypatch):
    tried = []

    def endless(method, options, **named):
        tried.append((method, options["presolve"]))
        assert options["maxiter"] and options["time_limit"]
        answer = linprog(method=method, options=options, **named)
        if method == "highs-ipm":
            answer.status = 1  # a limit was reached
        return answer

    monkeypatch.setattr(trajectories, "LONG", 2)
    monkeypatch.setattr("scipy.optimize.linprog", endless)
    assert least_factor(constant(), part([0, 0, 5, 3, 5, -1])) == pytest.approx(3)
    assert tried == [("highs-ipm", True), ("highs-ipm", False), ("highs", True)]


def test_a_program_that_no_method_ends_is_no_factor(monkeypatch, rng):
    monkeypatch.setattr(trajectories, "PATIENCE", 0)
    bias = jb.Fault("y1", "bias", 1)
    record = part(rng.uniform(-1, 1, 40))
    with pytest.raises(trajectories.GivenUp, match="40 readings reached its limits"):
        least_factor(constant(drift=0.1), record)
    with pytest.raises(trajectories.GivenUp):
        hidden_size(constant(drift=0.1), record, bias)


def test_a_signal_does_not_wait_for_a_program_that_does_not_end(monkeypatch):
    begun, ended = threading.Event(), threading.Event()

    def endless(**named):
        begun.set()
        ended.wait(60)

    def interrupt():
        begun.wait(60)
        signal.raise_signal(signal.SIGINT)
        while not ended.wait(10):  # Python drops an interrupt that meets it collecting garbage
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(trajectories, "AWAKE", 0.01)
    monkeypatch.setattr("scipy.optimize.linprog", endless)
    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        least_factor(constant(), part([0, 0, 5, 5]))
    ended.set()
