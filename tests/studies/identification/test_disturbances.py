"""A fit with disturbances: bounds of trajectories, and the choice among them."""

import numpy as np
import pytest
from scipy.optimize import linprog

import jaxbound as jb
from jaxbound.diagnosis.hints import outgrown
from jaxbound.studies.identification.disturbances import Setting, structured

T = 60
WANTED = jb.Fault("y", "bias", 1.0, start=30)


def wandering(rng, moves=0.05):
    """Return two recordings (u, y) of a plant whose reading has an offset that moves."""
    recordings = []
    for _ in range(2):
        u, x, offset = np.repeat(rng.uniform(-1, 1, T // 5), 5)[:, None], 0.0, 0.0
        y = np.zeros((T, 1))
        for k in range(T):
            y[k] = x + offset + rng.uniform(-0.05, 0.05)
            x, offset = 0.7 * x + u[k, 0], offset + moves
        recordings.append((u, y))
    return recordings


@pytest.fixture
def fitted(rng):
    """Return (recordings, a Fitted with disturbances)."""
    recordings = wandering(rng)
    model = jb.fit(
        recordings,
        order=1,
        horizon=6,
        method="least squares",
        observer="zonotope",
        disturbances="auto",
        see=WANTED,
        outputs="y",
        safety=1,
    )
    return recordings, model


def scaled_need(model, u, y):
    """Return the least factor on all bounds of a fitted model of one output, by a program in the first state
    and the disturbances, which the model's matrices are powers of.
    """
    A, B, C, G = (np.array(getattr(model, letter), float) for letter in "ABCG")
    walks = np.array([float(high) for _, high in model.disturbance])
    u, y = u - np.array(model.offset["u"], float), y - np.array(model.offset["y"], float)
    noise, g = float(model.noise[0] + model.resolution[0]), len(walks)
    state, free, rows, left = np.zeros((model.n, model.n + g * T)), np.zeros(model.n), [], []
    state[:, : model.n] = np.eye(model.n)
    for k in range(T):
        rows.append((C @ state)[0])
        left.append(float(y[k, 0] - C[0] @ free))
        state, free = A @ state, A @ free + B @ u[k]
        state[:, model.n + g * k : model.n + g * k + g] += G * walks
    rows, left = np.array(rows), np.array(left)
    within = np.hstack([np.zeros((g * T, model.n)), np.eye(g * T), -np.ones((g * T, 1))])
    opposite = within * np.append(-np.ones(model.n + g * T), 1.0)
    wide = np.full((T, 1), -noise)
    upper = np.vstack([np.hstack([rows, wide]), np.hstack([-rows, wide]), within, opposite])
    target = np.concatenate([left, -left, np.zeros(2 * g * T)])
    count = model.n + g * T
    return linprog(
        np.append(np.zeros(count), 1), upper, target, bounds=[(None, None)] * count + [(0, None)]
    ).fun


def test_the_bounds_explain_each_recording_and_no_smaller_ones_would(fitted):
    recordings, model = fitted
    needs = [scaled_need(model, u, y) for u, y in recordings]
    assert max(needs) <= 1 + 1e-9
    assert max(needs) * model.check.factor > 0.99  # rounded up to three digits


def test_no_observer_contradicts_a_recording_of_the_training(fitted):
    recordings, model = fitted
    for u, y in recordings:
        assert not jb.detect(jb.observer(model), u, y).counts["FAULT"]


def test_an_offset_that_moves_gets_a_state_and_a_rate(fitted):
    _, model = fitted
    assert model.A[-1][-1] == 1
    assert max(high for _, high in model.disturbance) > 0


def test_the_chosen_disturbances_see_the_smallest_of_the_wanted_fault(fitted):
    _, model = fitted
    (chosen,) = [row for row in model.check.tradeoff if row.chosen]
    asked = [row for row in model.check.tradeoff if row.safety == 1]
    best = min(asked, key=lambda row: row.sizes["y:bias from sample 30 on"])
    assert (chosen.method, chosen.process, chosen.drift) == (best.method, best.process, best.drift)


def test_provenance_says_where_the_disturbances_come_from(fitted):
    _, model = fitted
    assert model.provenance["disturbance"].startswith("fitted to 120 samples")


@pytest.mark.parametrize("horizon", [None, 6])
def test_bounds_of_whole_recordings_are_for_windows_and_observers(fitted, horizon):
    _, model = fitted
    model = model.replace(horizon=horizon)
    assert outgrown(model, jb.parity_relations(model, 8)) == []
    assert outgrown(model, jb.observer(model)) == []


def test_outputs_of_one_unit_share_an_offset():
    spec = {"A": [[0.5]], "B": [[1.0]], "C": [[1.0], [2.0]], "inputs": ("u",), "outputs": ("a", "b")}
    shared, _, walks = structured(spec, np.array([1.0, 3.0]), Setting(0, 0.5))
    assert shared["C"].tolist() == [[1, 1], [2, 1]]
    assert walks.tolist() == [1]
    own, G, walks = structured(
        spec | {"units": {"a": "K", "b": "bar"}}, np.array([1.0, 3.0]), Setting(0.25, 0.5)
    )
    assert own["C"].tolist() == [[1, 1, 0], [2, 0, 1]]
    assert walks.tolist() == [0.25, 0.75, 0.5, 1.5]
    assert G.shape == (3, 4)


def test_a_fault_that_no_bounds_see_is_named_with_the_size_that_is_seen(rng):
    recordings = wandering(rng)
    tiny = jb.Fault("y", "drift", 1e-9)
    model = jb.fit(
        recordings,
        order=1,
        horizon=6,
        method="least squares",
        disturbances="auto",
        see=tiny,
        outputs="y",
        safety=1,
    )
    sentence = next(text for text in model.check.sentences if "not sure to be seen" in text)
    assert sentence.startswith("a drift of 1e-09 of y is not sure to be seen under any bounds")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"see": WANTED}, "give disturbances='auto'"),
        ({"disturbances": "all"}, "must be None or auto"),
        ({"disturbances": "auto", "average": 3}, "average is for bounds of sensors alone"),
        ({"disturbances": "auto", "follow": 0.1}, "follow widens bounds of sensors alone"),
        ({"disturbances": "auto", "test": "auto", "horizon": None}, "'auto' compares windows"),
        ({"disturbances": "auto", "see": jb.Fault("y", "gain", 0.1)}, "not for y:gain"),
        ({"disturbances": "auto", "see": jb.Fault("z", "bias", 1)}, "no signal 'z'"),
    ],
)
def test_what_does_not_go_together_is_refused(rng, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        jb.fit(wandering(rng), **({"order": 1, "horizon": 6, "outputs": "y"} | options))


def test_wanted_biases_of_two_outputs_share_the_bounds_of_their_sensors(rng):
    u = rng.uniform(-1, 1, (80, 1))
    errors = rng.uniform(-1, 1, (80, 2)) * [0.1, 0.4]
    see = [jb.Fault("a", "bias", 3), jb.Fault("b", "bias", -4), jb.Fault("b", "bias", 3)]
    options = dict(order=0, outputs=["a", "b"], safety=1, held_out=0)
    y = u * [1, 2] + errors
    line = np.hstack([u, np.ones((80, 1))])
    largest = np.abs(y - line @ np.linalg.lstsq(line, y)[0]).max(0)
    usual, shared = (jb.fit((u, y), **options, see=wanted).check.smallest for wanted in ((), see))
    assert usual["b"] > 2 * usual["a"]
    assert shared == {"a": pytest.approx(largest.max(), rel=1e-3), "b": pytest.approx(shared["a"])}


def limited(monkeypatch, gives_up):
    """Give up linear programs of so many columns that gives_up(columns)."""

    def reached(**program):
        answer = linprog(**program)
        if gives_up(program["A_eq"].shape[1]):
            answer.status = 1  # a limit was reached
        return answer

    monkeypatch.setattr("scipy.optimize.linprog", reached)


def test_disturbances_whose_program_is_given_up_are_named(rng, monkeypatch):
    recordings = wandering(rng)
    options = dict(order=1, horizon=6, method="least squares", disturbances="auto", outputs="y", see=WANTED)
    limited(monkeypatch, lambda columns: columns == 3 * T)  # a state, a push, an error: process noise alone
    model = jb.fit(recordings, **options)
    (sentence,) = [text for text in model.check.sentences if "not compared" in text]
    assert sentence.startswith("3 of 10 disturbances were not compared, first process 0.01 and drift 0 by")
    assert sentence.endswith("give shorter recordings, or --recording every=1min")
    assert not any(row.process and not row.drift for row in model.check.tradeoff)
    limited(monkeypatch, lambda columns: True)
    with pytest.raises(ValueError, match="no disturbances could be judged, process 0 .* reached its limits"):
        jb.fit(recordings, **options)


def test_bounds_are_as_wide_as_the_wanted_fault_allows(rng):
    recordings = wandering(rng)
    large = jb.Fault("y", "drift", 5.0)
    options = dict(order=1, horizon=6, method="least squares", disturbances="auto", outputs="y")
    model = jb.fit(recordings, see=large, **options)
    (used,) = [row for row in model.check.tradeoff if row.chosen]
    assert model.check.safety == used.safety > 2 * 1.25
    assert used.noise["y"] == pytest.approx(float(model.noise[0] + model.resolution[0]), rel=0.01)
    assert 5.0 / 1.06 < used.sizes["y:drift"] <= 5.0
    assert any(f"safety is {used.safety:g} in place of 1.25" in text for text in model.check.sentences)
    assert jb.fit(recordings, **options).check.safety == 1.25
