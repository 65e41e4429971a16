"""The benchmark of real plants: its way by the commands, and the scores of rows."""

import numpy as np
import pandas as pd
import pytest

from benchmarks import plants, timing
from jaxbound.cli import main

FLOW = "Volume Flow RateRMS"


@pytest.fixture
def measured(monkeypatch):
    """Return a function that runs the benchmark and returns its figures; nothing is kept."""
    monkeypatch.setattr(main, "_configure", lambda: None)
    kept = {}
    monkeypatch.setattr(timing, "save", lambda name, figures: kept.update(figures))
    return lambda *words: plants.main([str(word) for word in words]) or kept


def experiment(path, rng, labelled, wrong):
    """Write 77 rows, 6 of them two seconds after the one before: from row 40 on, where an interval of five
    seconds begins, labels say so and the flow is wrong as asked. Those with labels have half of the noise.
    """
    count, noise = np.arange(77), 0.005 if labelled else 0.01
    late, seconds = count >= 40, count + count // 12
    voltage = rng.uniform(0, 1, 77)
    flow = 2 * voltage + rng.uniform(-noise, noise, 77) + wrong * late * rng.uniform(1, 2, 77)
    time = pd.Timestamp("2020-03-09 10:00:02") + pd.to_timedelta(seconds, unit="s")
    frame = pd.DataFrame({"datetime": time, "Voltage": voltage, FLOW: flow})
    if labelled:
        frame = frame.assign(anomaly=late.astype(float), changepoint=0.0)
    path.parent.mkdir(exist_ok=True)
    frame.to_csv(path, sep=";", index=False)


def test_rows_of_a_folder_in_the_layout_of_skab_are_scored(tmp_path, measured, rng, capsys):
    """All wrong rows of one file are seen, none of the other, whose flow is right: half is missed."""
    experiment(tmp_path / "anomaly-free/anomaly-free.csv", rng, False, 0)
    experiment(tmp_path / "valve1/0.csv", rng, True, 100)
    experiment(tmp_path / "other/1.csv", rng, True, 0)
    words = "--inputs", "Voltage", "--outputs", f"`{FLOW}`", "--order", 0, "--horizon", 1
    figures = measured("skab", "--data", tmp_path, *words)
    assert (figures["MAR"], figures["FAR"], figures["F1"]) == (0.5, 0, pytest.approx(2 / 3))
    assert {row["recording"]: row["faults seen"] for row in figures["rows"]} == {
        "other": "0 of 1",
        "valve1": "1 of 1",
    }
    assert capsys.readouterr().out.endswith("F1 0.667\nFAR 0 %\nMAR 50 %\n")


def test_scores_are_those_of_counted_rows():
    truth = np.array([1, 1, 1, 1, 0, 0, 0, 0, 0, 0], bool)
    alarms = np.array([1, 1, 1, 0, 1, 1, 0, 0, 0, 0], bool)
    assert plants.outlier_scores(truth, alarms) == {"F1": 6 / 9, "FAR": 2 / 6, "MAR": 1 / 4}


def test_a_verdict_counts_for_the_rows_of_its_interval_only():
    time = "2020-03-09 10:00:0{}".format
    times = pd.Series(pd.to_datetime([time(second) for second in (1, 2, 3, 4, 8)]))
    statuses = {2: "FAULT", 4: "CONSISTENT", 6: "FAULT"}
    verdicts = [{"time": time(second), "status": status} for second, status in statuses.items()]
    assert plants.alarm_rows(times, verdicts, 2).tolist() == [False, True, True, False, False]


def test_a_folder_without_healthy_files_is_refused_in_a_sentence(tmp_path, measured):
    with pytest.raises(SystemExit, match="needs a folder anomaly-free"):
        measured("skab", "--data", tmp_path)


@pytest.mark.long(by_day="test_rows_of_a_folder_in_the_layout_of_skab_are_scored")
def test_the_heater_has_no_false_alarm_and_every_large_bias_is_seen(measured, shared):
    figures = measured("heater", "--data", shared("data/tclab/mimo_prbs_3s.csv").parent)
    rows = {row["recording"]: row for row in figures["rows"]}
    assert rows["second half, healthy"]["alarms"] == "0 %"
    assert rows["T1 + 3 degC"]["faults seen"] == rows["T2 + 3 degC"]["faults seen"] == "7 of 7"


def test_the_engine_is_judged_as_its_own_study_has_it(measured, shared):
    figures = measured("engine", "--data", shared("data/engine/residuals.npz").parent)
    rows = {row["mode"]: row for row in figures["rows"]}
    assert rows["NF"]["FAULT"] == "0.649 %"
    assert rows["fp_af"]["FAULT"] == "6.19 %"
    assert rows["fw_th"]["ambiguous"] == "17.9 %"


def test_a_fault_is_isolated_where_it_is_the_only_candidate():
    candidates = np.array([[1, 0], [1, 1], [0, 1], [0, 0]], bool)
    assert plants.isolated(candidates, 0, 8) == ["12.5 %", "12.5 %", "25 %"]
    assert plants.isolated(candidates, -1, 8) == ["", "", "37.5 %"]
