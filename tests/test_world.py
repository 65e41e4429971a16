"""Faults of the world: what recordings suffer on their way to us. Each has one clear sentence; none makes a
healthy plant a faulty one.
"""

import json

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import evaluation, main
from jaxbound.models.modelfile import load_model, save_model
from jaxbound.recordings.read import read, read_signals
from jaxbound.runs import fleet

A, B = np.array([[0.9, 0.05], [0.05, 0.85]]), np.array([[0.1, 0.0], [0.0, 0.08]])
N = 400


def thermal(**changes):
    """Return a plant with two heaters [%] and two temperatures [degC] around 20 degC."""
    known = dict(
        A=A,
        B=B,
        C=np.eye(2),
        dt=1,
        noise=0.2,
        resolution=0.005,
        inputs=["Q1", "Q2"],
        outputs=["T1", "T2"],
        name="thermal",
        offset={"y": [20, 20]},
    )
    return jb.LinearSystem(**{**known, **changes})


@pytest.fixture
def healthy(rng):
    """Return (t, u, y) of a healthy run whose sensors use half of their noise."""
    u = np.repeat(rng.integers(0, 101, (N // 20, 2)), 20, 0).astype(float)
    x, y = np.zeros(2), np.zeros((N, 2))
    for k in range(N):
        y[k] = 20 + x + rng.uniform(-0.1, 0.1, 2)
        x = A @ x + B @ u[k]
    return np.arange(N) * 1.0, u, np.round(y, 2)


@pytest.fixture
def detect(tmp_path, monkeypatch, capsys):
    """Return a function that writes a recording, runs `jaxbound detect` on it and returns (exit code, what
    --json prints or stderr).
    """
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.setattr(evaluation, "write_report", lambda *args, **options: None)

    def run(t, u, y, model=None, name="run.csv"):
        model, _ = model or thermal(), capsys.readouterr()
        save_model(model, tmp_path / "model.toml")
        frame = pd.DataFrame(np.column_stack([t, u, y]), columns=["time", *model.inputs, *model.outputs])
        path = tmp_path / name
        frame.to_csv(path, index=False) if path.suffix == ".csv" else frame.to_parquet(path)
        code = main.main(
            ["detect", str(tmp_path / "model.toml"), str(path), "--out", str(tmp_path / "out"), "--json"]
        )
        out, err = capsys.readouterr()
        return code, err if code == 2 else json.loads(out)

    return run


def said(found, *words):
    """Return how many hints hold all these words."""
    return sum(all(word in hint for word in words) for hint in found["hints"])


class TestSamples:
    @pytest.mark.parametrize("name", ["run.csv", "run.parquet"])
    def test_five_percent_missing(self, healthy, detect, rng, name):
        t, u, y = healthy
        gone = rng.random((N, 4)) < 0.05
        u, y = np.where(gone[:, :2], np.nan, u), np.where(gone[:, 2:], np.nan, y)
        code, found = detect(t, u, y, name=name)
        assert code == 0 and found["counts"]["FAULT"] == 0 and found["decided"] > 0.8
        for i, signal in enumerate(("Q1", "Q2", "T1", "T2")):
            assert said(found, f"{gone[:, i].sum()} of 400 samples of {signal} are missing") == 1

    def test_five_percent_missing_hide_no_fault(self, healthy, detect, rng):
        t, u, y = healthy
        gone = rng.random((N, 2)) < 0.05
        gone[199:201] = False
        y[200:, 0] += 1.0
        y[gone] = np.nan
        code, found = detect(t, u, y)
        assert code == 1 and found["worst"]["sample"] == 200

    def test_a_number_that_stands_for_a_missing_sample(self, healthy, detect):
        t, u, y = healthy
        y[300:306, 1] = -9999
        code, found = detect(t, u, y)
        assert (
            code == 1
            and said(
                found,
                "T2 is exactly -9999 somewhere: if that stands for a missing sample, leave the cell blank",
            )
            == 1
        )
        y[300:306, 1] = np.nan
        assert detect(t, u, y)[0] == 0

    @pytest.mark.parametrize("name", ["run.csv", "run.parquet"])
    def test_a_stuck_sensor(self, healthy, detect, name):
        t, u, y = healthy
        y[150:250, 0] = y[150, 0]
        _, found = detect(t, u, y, name=name)
        assert (
            said(
                found,
                "T1 stays at exactly",
                "for 100 samples from 150 s to 249 s",
                "frozen sensor can look consistent",
            )
            == 1
        )

    def test_a_sensor_that_never_moves(self, healthy, detect):
        t, u, y = healthy
        model = thermal(C=[[0, 0], [0, 1]])  # which nothing that it should show contradicts
        code, found = detect(t, u, np.column_stack([np.full(N, 20.1), y[:, 1]]), model)
        assert (
            code == 0
            and said(
                found, "T1 is 20.1 in every sample: if its sensor is frozen, it can still look consistent"
            )
            == 1
        )

    @pytest.mark.parametrize("name", ["run.csv", "run.parquet"])
    def test_ten_samples_at_the_end_of_the_range(self, healthy, detect, name):
        t, u, y = healthy
        top = int(np.argmax(y[:-10, 0]))
        y[top : top + 10, 0] = y[top, 0] = np.max(y[:, 0]) + 0.05
        _, found = detect(t, u, y, name=name)
        assert (
            said(
                found,
                "T1 rests at exactly",
                "its largest value, for 10 samples",
                "a saturated sensor can look consistent",
            )
            == 1
        )

    def test_healthy_data_have_no_hint(self, healthy, detect):
        code, found = detect(*healthy)
        assert code == 0 and found["hints"] == []


class TestClock:
    def test_gaps(self, healthy, detect):
        kept = np.r_[0:100, 130:250, 251:N]
        code, found = detect(*(x[kept] for x in healthy))
        assert code == 0 and found["counts"]["MISSING"] == 3
        assert (
            said(found, "has 2 gaps, the longest, 31 s, before row 102 (130", "windows across are MISSING")
            == 1
        )

    def test_rows_that_are_there_twice(self, healthy, detect):
        twice = np.sort(np.r_[0:N, 50, 120, 121])
        code, found = detect(*(x[twice] for x in healthy))
        assert code == 0 and found["counts"]["FAULT"] == 0
        assert said(found, "3 rows repeat the row before, the first is row 53: left out") == 1

    def test_a_clock_that_goes_back(self, healthy, detect):
        t, u, y = healthy
        t[200:] -= 50
        code, found = detect(t, u, y)
        assert (
            code == 0
            and found["counts"]["MISSING"] == 2
            and said(found, "the clock goes back by 49 s before row 202 (150") == 1
        )

    def test_rows_out_of_order(self, healthy, detect, rng):
        mixed = rng.permutation(N)
        code, err = detect(*(x[mixed] for x in healthy))
        assert code == 2 and "rows go back in time: sort them by time" in err
        assert "run backwards in time, the newest first" in detect(*(x[::-1] for x in healthy))[1]

    @pytest.mark.parametrize(
        "step, sentence",
        [
            (
                3,
                "the model has dt = 1 s, but the rows of the recording are 3 s apart: fit again, "
                "with healthy recordings 3 s apart",
            ),
            (
                1 / 3,
                "are 0.333333 s apart: keep one of every 3 rows, "
                "let samples be means (--every 1s), or fit again, with healthy recordings 0.333 s apart",
            ),
            (1000, "are 1000 s apart: is its time in ms?"),
        ],
    )
    def test_another_period(self, healthy, detect, step, sentence):
        t, u, y = healthy
        code, err = detect(t * step, u, y)
        assert code == 2 and sentence in err and err.count("\n") == 1

    def test_another_period_in_the_index_of_a_frame(self, healthy):
        _, u, y = healthy
        frame = pd.DataFrame(
            np.column_stack([u, y]),
            pd.date_range("2024-01-01", periods=N, freq="3s"),
            ["Q1", "Q2", "T1", "T2"],
        )
        with pytest.raises(
            ValueError,
            match="the model has dt = 1 s, but the rows of the recording are 3 s apart: fit again",
        ):
            jb.detect(jb.parity_relations(thermal()), frame, frame)
        assert jb.detect(jb.parity_relations(thermal(dt=3)), frame, frame).hints == ()

    def test_two_recordings_of_different_periods(self, shared):
        three, one = shared("data/tclab/mimo_prbs_3s.csv"), shared("data/tclab/mimo_energy_1s.csv")
        names = {"Q1": "Heater 1", "T1": "Temperature 1"}
        table = pd.read_csv(one, skipinitialspace=True)
        assert read_signals([three], ["Q1"], ["T1"], names)[0].dt == 3 and "Heater 1 (%)" in table
        model = jb.LinearSystem(
            [[0.9]], [[0.1]], [[1]], dt=3, noise=1, inputs=["Heater 1 (%)"], outputs=["Temperature 1 (degC)"]
        )
        with pytest.raises(
            ValueError,
            match="energy_1s.csv: the model has dt = 3 s, but .* 1.00[0-9]* s apart: keep one of every 3",
        ):
            read(one, model)


class TestUnits:
    @pytest.mark.parametrize(
        "kind, sentence",
        [
            (
                "kelvin",
                "T1 and T2 look like kelvin where the model has degC: with T1 - 273.15 and T2 - 273.15, 100 "
                "% of the windows are",
            ),
            (
                "one in kelvin",
                "T2 looks like kelvin where the model has degC: with T2 - 273.15, 100 % of the windows are "
                "consistent,",
            ),
            ("fahrenheit", "T1 and T2 look like degF where the model has degC: with (T1 - 32) * 5 / 9 and"),
            ("fractions", "Q1 and Q2 look like a fraction where the model has percent"),
            (
                "permille",
                "Q2 looks like Pa where the model has kPa, or another factor of 1000: with Q2 / 1000",
            ),
        ],
    )
    def test_a_mistake_of_units_is_a_hint_and_no_verdict(self, healthy, detect, kind, sentence):
        t, u, y = healthy
        u, y = {
            "kelvin": (u, y + 273.15),
            "one in kelvin": (u, y + [0, 273.15]),
            "fahrenheit": (u, y * 1.8 + 32),
            "fractions": (u / 100, y),
            "permille": (u * [1, 1000], y),
        }[kind]
        code, found = detect(t, u, y)
        assert code == 1 and said(found, sentence) == 1 and found["counts"]["FAULT"] > 0.9 * N
        res = jb.detect(jb.parity_relations(thermal()), u, y)
        assert (
            sum(sentence in hint for hint in res.hints) == 1
            and res.counts["FAULT"] == found["counts"]["FAULT"]
        )

    def test_pressures(self, detect, rng):
        model = jb.LinearSystem(
            [[0.5]],
            None,
            [[1]],
            dt=1,
            noise=0.02,
            offset={"y": [3]},
            outputs=["p"],
            units={"p": "bar"},
            name="tank",
        )
        y = 3 + rng.uniform(-0.01, 0.01, (100, 1))
        for factor, words in (
            (100, "another factor of 100, as kPa for bar"),
            (1e5, "Pa where the model has bar"),
        ):
            code, found = detect(np.arange(100.0), np.zeros((100, 0)), y * factor, model)
            assert code == 1 and said(found, "p looks like", words) == 1

    def test_from_parquet_and_in_a_fleet(self, healthy, detect, tmp_path):
        t, u, y = healthy
        _, found = detect(t, u, y + 273.15, name="run.parquet")
        assert said(found, "look like kelvin") == 1
        unit = fleet.Unit("unit", tmp_path / "model.toml", tmp_path / "run.parquet")
        (result,) = fleet.detect_fleet([unit])
        assert any("look like kelvin" in hint for hint in result.summary.hints)

    def test_units_that_the_model_states_rule_conversions_out(self, healthy):
        _, u, y = healthy
        for unit, count in (("K", 0), ("degC", 1)):
            hints = jb.detect(
                jb.parity_relations(thermal(units={"T1": unit, "T2": unit})), u, y + 273.15
            ).hints
            assert (
                sum("kelvin where the model has degC" in hint for hint in hints)
                == sum("look" in hint for hint in hints)
                == count
            )

    def test_other_faults_are_none_of_units(self, healthy):
        _, u, y = healthy
        relations = jb.parity_relations(thermal(), 3)
        dead, leak, late = u * 0 + 50, y.copy(), y.copy()
        leak[40:] -= (
            np.array([3.0, 0]) * (1 - 0.9 ** np.arange(N - 40))[:, None] + np.sin(np.arange(N - 40))[:, None]
        )
        late[300:] += 273.15
        for us, ys in ((dead, y), (u, leak), (u, late), (u[::-1], y)):
            res = jb.detect(relations, us, ys)
            assert res.counts["FAULT"] and not any("look" in hint and "like" in hint for hint in res.hints)

    def test_a_dead_actuator_is_not_explained_by_a_small_number(self, healthy):
        _, u, y = healthy
        still = 20 + np.random.default_rng(0).uniform(-0.1, 0.1, y.shape)
        res = jb.detect(jb.parity_relations(thermal(), 3), u, still)
        assert res.counts["FAULT"] > N / 2 and not any("look" in hint for hint in res.hints)


class TestTclab:
    def test_kelvin_without_a_header(self, shared):
        with pytest.raises(
            ValueError,
            match="first row must hold the names of the columns.*Put a line above it, such as: time, a, b$",
        ):
            read_signals(shared("data/tclab/siso_step_1s_kelvin.csv"), ["a"], ["b"])

    def test_kelvin_with_a_header(self, shared, tmp_path, detect):
        spec = json.loads(shared("data/tclab/model.json").read_text())
        table = pd.read_csv(shared("data/tclab/mimo_hybrid_3s.csv"), skipinitialspace=True).to_numpy()
        model = jb.LinearSystem(
            spec["A"],
            spec["B"],
            spec["C"],
            noise=spec["noise_bound"]["s4"],
            dt=3,
            offset={"y": table[0, 3:].tolist()},
            inputs=["Q1", "Q2"],
            outputs=["T1", "T2"],
        )
        code, found = detect(table[:, 0], table[:, 1:3], table[:, 3:] + 273.15, model)
        assert code == 1 and said(found, "T1 and T2 look like kelvin where the model has degC") == 1
        assert load_model(tmp_path / "model.toml").outputs == ("T1", "T2")
