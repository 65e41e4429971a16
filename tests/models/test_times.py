"""Factors on noise: what they may rest on, who knows them, and the numbers that recordings have for them."""

import jax
import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.models.modelfile import changed_text, model_text
from jaxbound.models.operating_point import at_factors
from jaxbound.recordings.factors import known
from jaxbound.runs.ask import Ask
from jaxbound.studies.tuning import tuning

TIMES = {"T": "1 + abs(fan)"}


def plant(**changes):
    given = dict(noise=[0.4, 0.1], inputs="fan", outputs=["T", "S"], times=TIMES)
    return jb.LinearSystem([[0.9]], [[1]], [[1], [2]], **(given | changes))


@pytest.mark.parametrize(
    "columns, text, used",
    [
        ({}, "1 + T**2", "T"),
        ({}, "1 + abs(S)", "S"),
        ({"T": "Temp"}, "abs(Temp)", "T"),
        ({"T": "Temp"}, "abs(T)", "T"),
        ({"T": "= Hot - Cold"}, "1 + Hot", "T"),
        ({"S": "= `Hot side` - Cold"}, "sqrt(`Hot side `)", "S"),
        ({"fan": "= T - Cold"}, "1 + fan**2", "T"),
        ({"fan": "T"}, "1 + fan**2", "T"),
    ],
)
def test_an_output_cannot_widen_its_own_bound(columns, text, used):
    with pytest.raises(ValueError, match=f"rests on the output {used}: a fault would widen its own bound"):
        plant(columns=columns, times={"T": text})


def test_an_input_from_which_an_output_is_computed_stays_an_input():
    columns = {"T": "= Fan*(Hot - Cold)", "fan": "Fan"}
    assert plant(columns=columns, times={"T": "1 + fan"}).times == {"T": "1 + fan"}
    with pytest.raises(ValueError, match="rests on the output T"):
        plant(columns=columns, times={"T": "1 + Hot"})


@pytest.mark.parametrize(
    "changes, sentence",
    [
        ({"times": {"X": "1 + fan"}}, "times speaks of 'X', but the model knows only 'T', 'S'"),
        ({"times": {"T": "1 +"}}, "cannot be read"),
        ({"times": {"T": "2"}}, "names no column"),
        ({"constant_tolerance": True}, "times and constant_tolerance do not go together"),
        ({"uncertainties": [jb.Uncertainty("a", A=[[0.1]])]}, "times and uncertainties do not go together"),
    ],
)
def test_what_does_not_go_together_is_refused(changes, sentence):
    with pytest.raises(ValueError, match=sentence):
        plant(**changes)


def test_a_mean_at_one_factor_is_times_that_factor():
    model = plant(averages={"T": {4: 0.1}, "S": {4: 0.05}})
    bounds = [one.bound for one in at_factors(model, dict.fromkeys(model.times, 3)).averages]
    assert bounds == [model.averages[0].bound * 3, model.averages[1].bound]


def test_averages_go_together_with_a_factor_of_the_same_output_and_of_another():
    model = plant(averages={"T": {4: 0.1}, "S": {4: 0.05}})
    relations = jb.parity_relations(model, 6)
    rng = np.random.default_rng(1)
    u, y = rng.normal(size=(60, 1)), rng.normal(size=(60, 2))
    found = jb.detect(relations, u, y)
    for k in range(6, 60):
        assert found.explain(k).proves == found.status[k]


def test_a_model_file_has_the_factor_beside_its_bound(tmp_path):
    model = plant()
    jb.save_model(model, tmp_path / "m.toml")
    text = (tmp_path / "m.toml").read_text()
    assert 'noise = {bound = 0.4, times = "1 + abs(fan)"}' in text
    assert jb.load_model(tmp_path / "m.toml") == model != plant(times=None)
    other = model.replace(noise=["1/3", 0.1])
    changed = changed_text(text.replace("[matrices]", "# mine\n[matrices]"), other)
    assert "# mine" in changed and 'noise = {bound = "1/3", times = "1 + abs(fan)"}' in changed
    plain = changed_text(text, plant(times=None))
    assert "times" not in plain
    for wrong, sentence in (
        ("noise = {bound = 0.4}", "noise of number 1 of outputs, 'T' needs times"),
        ('noise = {times = "fan"}', "noise of number 1 of outputs, 'T' needs bound"),
        ('noise = {bound = 0.4, time = "fan"}', "did you mean 'times'"),
        ("noise = {bound = 0.4, times = 2}", "must be text in quotes"),
    ):
        broken = text.replace('noise = {bound = 0.4, times = "1 + abs(fan)"}', wrong)
        (tmp_path / "broken.toml").write_text(broken)
        with pytest.raises(ValueError, match=sentence):
            jb.load_model(tmp_path / "broken.toml")
    assert model_text(model) == text


CALLS = {
    "validate": lambda m, u, y: jb.validate(m, u, y),
    "MultiModel": lambda m, u, y: jb.MultiModel([m, m], lambda u: u),
    "redundancy": lambda m, u, y: jb.redundancy(m),
    "structured_relations": lambda m, u, y: jb.structured_relations(m),
    "isolability": lambda m, u, y: jb.isolability(m),
    "suggest_lags": lambda m, u, y: jb.suggest_lags(m),
}
KNOWN = """
    parity_relations detect margins Monitor detect_dataset tune detectable save_model load_model plot read
    LinearSystem Recording simulate with_faults observer observe
    study assess monitor unknown_inputs
""".split()
"""Public names that know factors; their tests are here and in consistency/test_windows_times.py,
estimation/test_observer_times.py, estimation/test_unknown_input_estimates.py,
studies/montecarlo/test_study_times.py."""
WITHOUT_A_MODEL = """
    AlarmRule Fault NamedFault Recipe Result Status Uncertainty compile evaluate fit from_control
    from_scipy inclusion interval interval_system linearize look membership parameters pave residual sets
    signatures solve_interval strips use_cache zonotope
""".split()


@pytest.mark.parametrize("call", CALLS)
def test_who_does_not_know_factors_refuses_them(call):
    u, y = np.zeros((30, 1)), np.zeros((30, 2))
    with pytest.raises(ValueError, match="the noise of 'T' is times a factor, which only windows of samples"):
        CALLS[call](plant(), u, y)


def test_every_public_name_knows_factors_or_refuses_them():
    refused = {name for name in jb.__all__ if name in CALLS}
    assert refused | set(KNOWN) | set(WITHOUT_A_MODEL) == set(jb.__all__)


def test_a_family_of_a_user_is_not_handed_a_factor():
    from jaxbound.consistency.interface import FAMILIES, family

    @family("own")
    def build(model, horizon):
        return jb.parity_relations(model, horizon)

    try:
        assert Ask("own").relations(plant(times=None)).count
        with pytest.raises(ValueError, match="is times a factor"):
            Ask("own").relations(plant())
    finally:
        del FAMILIES["own"]


def test_linearize_takes_no_factor():
    with pytest.raises(ValueError, match="linearize takes no times"):
        jb.linearize(lambda x, u: -x * x, [1.0], region={"x": 0.1}, times={"y1": "load"})


def test_columns_behind_the_inputs_are_the_factors():
    model = plant(times={"T": "1 + abs(fan)", "S": "maximum(load, 1)"}, columns={"fan": "Fan"})
    table = pd.DataFrame({"Fan": [0.5, -1.0], "load": [0.25, 3.0], "T": [1.0, 2.0], "S": [3.0, 4.0]})
    given = jb.Recording.of(model, table)
    np.testing.assert_array_equal(given.u, [[0.5, 1.5, 1.0], [-1.0, 2.0, 3.0]])
    assert given.inputs == known(model)
    again = jb.Recording.of(model, given)
    np.testing.assert_array_equal(again.u, given.u)
    # of another model with other factors nothing is taken by place
    other = jb.Recording.of(model.replace(times={"T": "3 + abs(fan)"}), given)
    np.testing.assert_array_equal(other.u, [[0.5, 3.5], [-1.0, 4.0]])
    with pytest.raises(ValueError, match="arrays have no column 'load'"):
        jb.Recording.of(model, table[["Fan"]].to_numpy(), table[["T", "S"]].to_numpy())
    with pytest.raises(ValueError, match="arrays have no column 'load'"):
        jb.Recording.of(model, jb.Recording.of(model.replace(times=TIMES), table))
    by_hand = jb.Recording.of(model, given.u, given.y)
    np.testing.assert_array_equal(by_hand.u, given.u)


def test_an_input_goes_before_a_column_of_its_name():
    model = plant(columns={"fan": "Fan"})
    table = pd.DataFrame({"Fan": [0.5], "fan": [7.0], "T": [1.0], "S": [3.0]})
    assert jb.Recording.of(model, table).u.tolist() == [[0.5, 1.5]]


def test_a_narrower_type_rounds_a_factor_up():
    model, fan = plant(times={"T": "abs(fan) / 3"}), np.linspace(-1, 1, 101)
    table = pd.DataFrame({"fan": fan, "T": 0 * fan, "S": 0 * fan})
    exact = jb.Recording.of(model, table).u[:, 1]
    narrow = jb.Recording.of(model, table.astype({"T": np.float32, "S": np.float32})).u[:, 1]
    assert narrow.dtype == np.float32
    assert (narrow >= exact).all() and (np.nextafter(narrow, np.float32(0)) <= exact).all()
    monitor = jb.Monitor(jb.parity_relations(model, 2), dtype=np.float32)
    state, _ = monitor.run(monitor.init(), table)
    np.testing.assert_array_equal(state.u[:, 1], narrow[-2:])
    tiny = jb.Recording.of(model.replace(times={"T": "1e-320 + 0*fan"}), table).u[:, 1]
    assert (tiny == np.finfo(float).tiny).all(), "a kernel would take less for 0"


@pytest.mark.parametrize("text, value", [("fan", "-1"), ("1e30 * (fan < 0)", "1e")])
def test_what_is_no_factor_is_refused_with_its_sample(text, value, tmp_path):
    table = pd.DataFrame({"fan": [0.5, 1.0, -1.0], "T": 0.0, "S": 0.0})
    model = plant(times={"T": text})
    sentence = rf"the noise of 'T' is times .* at sample 2 it is {value}"
    with pytest.raises(ValueError, match=sentence):
        jb.detect(jb.parity_relations(model, 1), table)
    u = table[["fan"]].to_numpy()
    with pytest.raises(ValueError, match=sentence):
        jb.Recording.of(model, u, np.zeros((3, 2)))
    table.to_csv(tmp_path / "run.csv", index=False)
    with pytest.raises(ValueError, match=sentence):
        jb.read(tmp_path / "run.csv", model)
    table.to_parquet(tmp_path / "run.parquet")
    with pytest.raises(ValueError, match=sentence):
        jb.read(tmp_path / "run.parquet", model)
    with pytest.raises(ValueError, match="must be >= 0"):
        jb.Recording.of(model, np.array([[0.5, -1.0]]), np.zeros((1, 2)))


def test_samples_that_do_not_count_need_no_factor():
    table = pd.DataFrame({"fan": [0.5, -1.0, 0.25], "T": 0.0, "S": 0.0})
    given = jb.Recording.of(plant(times={"T": "fan"}, columns={"where": "fan > 0"}), table)
    assert given.excluded.tolist() == [False, True, False]
    np.testing.assert_array_equal(given.u[:, 1], [0.5, np.nan, 0.25])


def test_a_factor_without_a_value_takes_the_sample_with_it():
    table = pd.DataFrame({"fan": [0.5, np.nan, 0.0], "T": 1.0, "S": 2.0})
    given = jb.Recording.of(plant(times={"T": "1 / fan"}), table)  # 1 / 0 is no number
    np.testing.assert_array_equal(given.y, [[1.0, 2.0], [np.nan, 2.0], [np.nan, 2.0]])


def test_tuned_bounds_are_those_that_factors_leave():
    rng = np.random.default_rng(3)
    fan = rng.uniform(-1, 1, 100)
    x, y = 0.0, []
    for value in fan:
        y.append([x, 2 * x])
        x = 0.9 * x + value
    y = np.array(y) + rng.choice([-1, 1], (100, 2)) * np.stack([0.4 * (1 + abs(fan)), 0.1 + 0 * fan], 1)
    table = pd.DataFrame({"fan": fan, "T": y[:, 0], "S": y[:, 1]})
    relations = jb.parity_relations(plant(noise=[0.6, 0.2]), 2)
    tuned = tuning.tune(relations, table, safety=1.0, steps=10)
    assert tuned.counts["FAULT"] == 0
    assert tuned.model.times == TIMES
    assert float(tuned.model.noise[0]) < 0.45
    plain = tuning.tune(
        jb.parity_relations(plant(noise=[0.6, 0.2], times=None), 2), table, safety=1.0, steps=10
    )
    assert float(plain.model.noise[0]) > 0.6


def test_guaranteed_sizes_are_those_of_the_largest_factors():
    model = plant()
    with pytest.raises(ValueError, match="factors on the noise of 'T': give factors"):
        jb.detectable(model, "T", horizon=2)
    size = jb.detectable(model, "T", horizon=2, factors={"T": "3/2"})
    assert size == jb.detectable(plant(noise=[0.6, 0.1], times=None), "T", horizon=2)
    with pytest.raises(ValueError, match="no output"):
        jb.detectable(plant(times=None), "T", horizon=2, factors={"T": 1})
    relations = jb.parity_relations(model, 2)
    rng = np.random.default_rng(5)
    u = rng.uniform(-0.5, 0.5, (60, 1))
    x, y = 0.0, []
    for value in u[:, 0]:
        y.append([x, 2 * x])
        x = 0.9 * x + value
    y = np.array(y) + rng.uniform(-1, 1, (60, 2)) * np.stack([0.4 * (1 + abs(u[:, 0])), 0.1 + 0 * u[:, 0]], 1)
    y[:, 0] += size
    assert (jb.detect(relations, u, y).status[2:] == jb.Status.FAULT).all()


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("at", ["uniform", "vertices"])
def test_simulated_noise_lies_within_its_factor(at, dtype):
    rng = np.random.default_rng(9)
    model = plant(times={"T": "1 + abs(fan)", "S": "fan > 0"}, tolerance=[0.05, 0])
    u = rng.uniform(-1, 1, (20, 60, 1)).astype(dtype)
    run = jb.simulate(model, u, jax.random.key(1), at=at)
    bound = np.stack([0.4 * (1 + abs(u[..., 0])), 0.1 * (u[..., 0] > 0)], -1)
    assert run.y.dtype == dtype and (abs(run.noise) <= bound * (1 + 1e-6)).all()
    assert abs(run.noise[..., 0]).max() > 0.4 * 1.5
    for horizon in (1, 8):
        relations = jb.parity_relations(model, horizon)
        assert not (jb.detect(relations, run).status == jb.Status.FAULT).any()
        assert (jb.detect(relations, u, run.y).status[..., horizon:] != jb.Status.FAULT).all()
    same = jb.simulate(model.replace(times={"T": "1 + 0*fan"}), u, jax.random.key(1), at=at)
    plain = jb.simulate(plant(times=None, tolerance=[0.05, 0]), u, jax.random.key(1), at=at)
    np.testing.assert_allclose(same.y, plain.y, rtol=4 * np.finfo(dtype).eps, atol=4 * np.finfo(dtype).eps)
    with pytest.raises(ValueError, match="arrays have no column 'load'"):
        jb.simulate(plant(times={"T": "load"}), u, jax.random.key(1))
    behind = np.concatenate([u, 2 + 0 * u], -1)
    double = jb.simulate(plant(times={"T": "load"}), behind, jax.random.key(1), at="vertices")
    np.testing.assert_allclose(abs(double.noise[..., 0]), 0.8, rtol=1e-6)


def test_with_faults_keeps_the_factors():
    assert jb.with_faults(plant(), "S:bias").times == TIMES


def test_the_region_of_training_is_that_of_the_inputs_alone():
    model = plant(ranges={"fan": (0, 1)}, times={"T": "9 + 0*fan"})
    relations = jb.parity_relations(model, 2)
    u, y = np.array([[0.5], [0.5], [0.5], [2.0], [0.5]]), np.zeros((5, 2))
    found = jb.detect(relations, u, y)
    plain = jb.detect(jb.parity_relations(model.replace(times=None), 2), u, y)
    np.testing.assert_array_equal(found.outside, plain.outside)
    monitor = jb.Monitor(relations)
    np.testing.assert_array_equal(monitor.run(monitor.init(), u, y)[1].outside, plain.outside)
