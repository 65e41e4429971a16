"""Tests of a model file at the command line: detect, explain, JSON and files say which of them speaks."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.certificates.checker.command import main as checker
from jaxbound.cli import main
from jaxbound.cli.pipe import LiveRun, judge_stream
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.recordings.read import open_source
from jaxbound.runs import streaming
from jaxbound.runs.contradiction import refuted_again
from jaxbound.runs.fleet import Unit, detect_fleet
from jaxbound.runs.summary import summarised

MODEL = """
dt = 1
[[inputs]]
name = "pump"
[[outputs]]
name = "height"
noise = 0.1
[matrices]
A = [[0.5]]
B = [[1]]
C = [[1]]
[[test]]
name = "jumps"
horizon = 1
when = "mode == 1"
[[test]]
name = "drifts"
horizon = 2
factor = 3
"""


@pytest.fixture
def plant(tmp_path):
    """Return (model file, recording): a sensor jumps at sample 20, in mode 1, and at 40, in mode 2."""
    u = np.tile([0.0, 1.0], 30)
    x = np.zeros(60)
    for k in range(59):
        x[k + 1] = 0.5 * x[k] + u[k]
    y = x.copy()
    y[20] += 0.3
    y[40] += 3
    rows = ["time,pump,height,mode"]
    rows += [f"{k},{u[k]},{y[k]:.9f},{1 if k < 30 else 2}" for k in range(60)]
    model, data = tmp_path / "plant.toml", tmp_path / "run.csv"
    model.write_text(MODEL)
    data.write_text("\n".join(rows) + "\n")
    return model, data


def detect(plant, out, *more):
    model, data = plant
    return main.main(["detect", str(model), str(data), "--out", str(out), *more])


def test_a_file_with_tests_is_judged_by_all_of_them(plant, tmp_path, capsys):
    assert detect(plant, tmp_path / "r", "--json") == 1
    summary = json.loads(capsys.readouterr().out)
    assert summary["method"] == "monitor"
    assert summary["tests"]["jumps"]["first_fault"] == 20
    assert summary["tests"]["drifts"]["first_fault"] == 40
    assert summary["worst"]["test"] == "drifts"
    with open(tmp_path / "r" / "verdicts.csv") as file:
        rows = list(csv.DictReader(file))
    assert rows[20]["status"] == "FAULT" and rows[20]["test"] == "jumps"
    assert rows[40]["status"] == "FAULT" and rows[40]["test"] == "drifts"
    assert rows[0]["test"] == ""
    with open(tmp_path / "r" / "alarms.csv") as file:
        assert [row["test"] for row in csv.DictReader(file)] == ["jumps", "drifts"]
    page = (tmp_path / "r" / "report.html").read_text()
    assert "Who watched when" in page and "mode == 1 does not hold" in page


def test_bounds_that_one_test_has_outgrown_are_no_headline_where_another_proves_a_fault(
    plant, tmp_path, capsys
):
    model, data = plant
    fitted = MODEL.replace("dt = 1", "dt = 1\nhorizon = 1").replace("factor = 3", "")
    model.write_text(f'{fitted}[provenance]\nnoise = "fitted to 3 recordings"\n')
    assert detect(plant, tmp_path / "both") == 1
    assert "Fault proved" in capsys.readouterr().out
    pd.read_csv(data).to_parquet(tmp_path / "run.parquet")
    assert detect((model, tmp_path / "run.parquet"), tmp_path / "parts") == 1
    assert "Fault proved" in capsys.readouterr().out
    assert judge_stream(LiveRun(model), [data.read_bytes()]) == 1
    assert "Fault proved" in capsys.readouterr().err
    assert main.main(["explain", str(tmp_path / "both"), "--at", "40"]) == 0
    assert "FAULT outside the bounds as fitted" in capsys.readouterr().out, (
        "its bounds are of shorter windows"
    )
    rows = data.read_text().splitlines()
    rows[21] = rows[19].replace("18,", "20,", 1)  # no jump: drifts alone, of longer windows, is FAULT
    data.write_text("\n".join(rows) + "\n")
    assert detect(plant, tmp_path / "one") == 3
    assert "Outside the bounds as fitted" in capsys.readouterr().out


def test_a_mode_that_nobody_knows_needs_the_bounds_of_every_test_that_refutes_it(plant, tmp_path, capsys):
    model, data = plant
    fitted = MODEL.replace("dt = 1", "dt = 1\nhorizon = 1").replace("factor = 3", 'when = "otherwise"')
    model.write_text(f'{fitted}[provenance]\nnoise = "fitted to 3 recordings"\n')
    header, *rows = data.read_text().splitlines()
    rows[20] = rows[18].replace("18,", "20,", 1)  # no jump while the mode is known
    unknown = [f"{row[:-1]}" if k >= 30 else row for k, row in enumerate(rows)]
    data.write_text("\n".join([header, *unknown]) + "\n")
    assert detect(plant, tmp_path / "whole") == 3
    assert "Outside the bounds as fitted" in capsys.readouterr().out, "drifts has outgrown its bounds"
    pd.read_csv(data).to_parquet(tmp_path / "run.parquet")
    assert detect((model, tmp_path / "run.parquet"), tmp_path / "parts") == 3
    assert "Outside the bounds as fitted" in capsys.readouterr().out
    assert judge_stream(LiveRun(model), [data.read_bytes()]) == 3
    assert "Outside the bounds as fitted" in capsys.readouterr().err


def test_its_windows_are_explained_by_the_test_that_speaks(plant, tmp_path, capsys):
    detect(plant, tmp_path / "r", "-q")
    capsys.readouterr()
    assert main.main(["explain", str(tmp_path / "r"), "--at", "20", "--json"]) == 0
    of_jumps = json.loads(capsys.readouterr().out)
    assert main.main(["explain", str(tmp_path / "r"), "--at", "40", "--json"]) == 0
    of_drifts = json.loads(capsys.readouterr().out)
    samples = [len(one["numbers"]["relation"]["h"]) for one in (of_jumps, of_drifts)]
    assert samples == [2, 3], "the windows of jumps, and of drifts"
    assert [of_jumps["test"], of_drifts["test"]] == ["jumps", "drifts"]


def test_a_certificate_is_verified_by_the_bounds_of_the_test_that_it_names(plant, tmp_path, capsys):
    model, data = plant
    detect(plant, tmp_path / "r", "-q")
    assert main.main(["explain", str(tmp_path / "r"), "--at", "40"]) == 0
    assert "drifts" in capsys.readouterr().out
    file = tmp_path / "r" / "certificate-40.json"
    verify = ["verify", str(file), "--model", str(model), "--data", str(data)]
    assert main.main(verify) == 0
    for other, why in (("jumps", "mode == 1, which does not hold"), ("rest", "does not state")):
        changed = json.loads(file.read_text()) | {"test": other}
        file.write_text(json.dumps(changed))
        assert main.main(verify) == 1
        assert why in capsys.readouterr().err


def test_the_checker_beside_jaxbound_takes_a_test_with_the_bounds_of_the_file_alone(plant, tmp_path, capsys):
    model, data = plant
    detect(plant, tmp_path / "r", "-q")
    codes = []
    for k in (20, 40):
        main.main(["explain", str(tmp_path / "r"), "--at", str(k)])
        file = str(tmp_path / "r" / f"certificate-{k}.json")
        codes.append(checker([file, "--model", str(model), "--data", str(data), "--time", "time"]))
    assert codes == [0, 1]
    assert "factor of a test is more than this script reads" in capsys.readouterr().err


@pytest.fixture
def observed(plant):
    """Return (model file, recording) with an observer among the tests, without faults up to sample 20."""
    model, data = plant
    model.write_text(MODEL + '[[test]]\nname = "slow"\nobserver = "zonotope"\n')
    data.write_text("\n".join(data.read_text().splitlines()[:20]) + "\n")
    return model, data


def test_a_healthy_day_of_an_observer_among_the_tests_is_evidence_enough(observed, tmp_path, capsys):
    assert detect(observed, tmp_path / "r", "--json", "--min-coverage", "0.9") == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["verdict"] == "no fault" and summary["decided"] > 0.9
    assert summary["counts"]["CONSISTENT"] < 3, "the verdict of its samples is UNDECIDED"
    page = (tmp_path / "r" / "report.html").read_text()
    assert '<i class="UNDECIDED"></i>UNDECIDED (not refuted)</span>' in page
    assert ":root { --UNDECIDED: var(--allowed)" in page


def test_samples_that_no_test_decides_are_too_little_evidence(plant):
    model, data = plant
    bank = jb.monitor(model)
    recording = jb.read(data, bank.model)
    res = jb.detect(bank, recording)
    healthy = np.where(res.statuses == jb.Status.MISSING, res.statuses, np.int8(jb.Status.UNDECIDED))
    open_ = np.where(res.status == jb.Status.MISSING, res.status, np.int8(jb.Status.UNDECIDED))
    one = healthy.copy()
    one[2:, 1] = jb.Status.CONSISTENT
    verdicts = []
    for statuses in (healthy, one):
        changed = replace(res, status=open_, statuses=statuses)
        verdicts.append(summarised(changed, [], recording.label).verdict)
    assert verdicts == ["too little evidence", "no fault"]


def test_a_page_of_windows_alone_warns_of_what_is_undecided(plant, tmp_path):
    detect(plant, tmp_path / "r", "-q")
    page = (tmp_path / "r" / "report.html").read_text()
    assert "not refuted" not in page and "--UNDECIDED: var(--allowed)" not in page
    assert "<p>test: jumps</p>" in page


def test_a_horizon_asks_for_windows_alone(plant, tmp_path, capsys):
    assert detect(plant, tmp_path / "r", "--json", "--test", "horizon=1") == 1
    summary = json.loads(capsys.readouterr().out)
    assert summary["method"] == "joint" and "tests" not in summary


def test_a_condition_on_a_column_that_is_not_there_is_refused(plant, tmp_path, capsys):
    model, data = plant
    data.write_text(data.read_text().replace("mode", "state"))
    assert detect(plant, tmp_path / "r") == 2
    assert "has no column 'mode'" in capsys.readouterr().err
    assert not (tmp_path / "r").exists()


def test_alarms_of_a_monitor_are_those_of_its_verdicts(plant):
    model, data = plant
    bank = jb.monitor(model)
    res = jb.detect(bank, jb.read(data, bank.model))
    assert [(alarm.start, res.test_at(alarm.start)) for alarm in res.alarms()][0] == (20, "jumps")


def test_a_pipe_names_the_test_that_speaks_in_each_line(plant, tmp_path, capsysbinary):
    model, data = plant
    code = judge_stream(LiveRun(model, json=True), [data.read_bytes()])
    lines = [json.loads(line) for line in capsysbinary.readouterr().out.splitlines()]
    assert code == 1
    faults = [(k, line["test"]) for k, line in enumerate(lines) if line["status"] == "FAULT"]
    assert faults[0] == (20, "jumps")
    assert lines[40]["status"] == "FAULT" and lines[40]["test"] == "drifts"
    assert lines[0]["test"] is None


def test_a_pipe_counts_by_test(plant, capfd):
    model, data = plant
    text = data.read_bytes()
    judge_stream(LiveRun(model), [text[:400], text[400:]])
    said = capfd.readouterr().err
    assert "test jumps: 31 MISSING, " in said, "in mode 2, and at the first sample"
    assert "test drifts: 2 MISSING, 55 CONSISTENT, 3 FAULT" in said, "the windows that hold sample 40"


def test_a_pipe_names_the_test_by_which_an_alarm_begins(plant, capsysbinary):
    model, data = plant
    judge_stream(LiveRun(model, json=True, alarm=AlarmRule()), [data.read_bytes()])
    lines = [json.loads(line) for line in capsysbinary.readouterr().out.splitlines()]
    begun = [(line["sample"], line["test"]) for line in lines if line.get("alarm") == "begin"]
    assert begun == [(20, "jumps"), (40, "drifts")]


def test_a_parquet_recording_is_judged_as_one_in_memory(plant, tmp_path, capsys):
    model, data = plant
    pd.read_csv(data).to_parquet(tmp_path / "run.parquet")
    assert detect((model, tmp_path / "run.parquet"), tmp_path / "r", "-q") == 1
    table = pd.read_parquet(tmp_path / "r" / "verdicts.parquet")
    bank = jb.monitor(model)
    res = jb.detect(bank, jb.read(data, bank.model))
    assert table["status"].tolist() == [jb.Status(s).name for s in res.status]
    assert [name or "" for name in table["test"]] == [res.test_at(k) for k in range(60)]


def test_the_page_of_a_parquet_recording_has_the_sections_of_one_in_memory(plant, tmp_path, monkeypatch):
    model, data = plant
    pd.read_csv(data).to_parquet(tmp_path / "run.parquet")
    monkeypatch.setattr(streaming, "PART", 17)  # tests are counted over the ends of parts
    tables = []
    for name, recording in (("parts", tmp_path / "run.parquet"), ("whole", data)):
        assert detect((model, recording), tmp_path / name, "-q") == 1
        page = (tmp_path / name / "report.html").read_text()
        found = re.findall("<table.*?</table>", page, re.DOTALL)
        tables.append([table for table in found if "looks back over" in table or "does not hold" in table])
    assert tables[0] == tables[1] and len(tables[0]) == 2


def test_shares_of_a_monitor_of_windows_are_the_whole(plant, tmp_path, monkeypatch, capsys):
    """It is cut where a test has a FAULT and looks back into the share before."""
    model, run = plant[0], tmp_path / "run.parquet"
    pd.read_csv(plant[1]).to_parquet(run)
    monkeypatch.setattr(streaming, "PART", 21)
    assert detect((model, run), tmp_path / "r", "-q", "--part", "1/2") == 2
    assert "give an overlap" in capsys.readouterr().err, "who is asked when mode == 1 holds at the cut?"
    model.write_text(MODEL.replace('when = "mode == 1"\n', ""))
    assert detect((model, run), tmp_path / "whole", "-q") == 1
    assert detect((model, run), tmp_path / "r", "-q", "--overlap", "1") == 2
    assert "windows know how far they reach back" in capsys.readouterr().err
    for share in ("2/2", "1/2"):
        assert detect((model, run), tmp_path / "r", "-q", "--part", share) == 0
    assert detect((model, run), tmp_path / "r", "-q", "--merge") == 1
    whole, merged = (pd.read_parquet(tmp_path / name / "verdicts.parquet") for name in ("whole", "r"))
    pd.testing.assert_frame_equal(merged, whole)
    bank = jb.monitor(model)
    pd.testing.assert_series_equal(
        merged["margin"].astype(float), pd.Series(jb.detect(bank, jb.read(run, bank)).margin, name="margin")
    )


@pytest.mark.parametrize(
    ("rule", "tests"),
    [
        ((), ["jumps", "drifts"]),
        (
            (
                "--alarm",
                "latch=true",
            ),
            ["drifts"],
        ),
    ],
)
def test_alarms_of_a_parquet_recording_name_their_test(rule, tests, plant, tmp_path, monkeypatch):
    model, data = plant
    pd.read_csv(data).to_parquet(tmp_path / "run.parquet")
    monkeypatch.setattr(streaming, "PART", 41)  # the second alarm goes over the end of a part
    assert detect((model, tmp_path / "run.parquet"), tmp_path / "r", "-q", *rule) == 1
    assert detect(plant, tmp_path / "whole", "-q", *rule) == 1
    of_parts, of_whole = (pd.read_csv(tmp_path / name / "alarms.csv") for name in ("r", "whole"))
    assert of_parts["test"].tolist() == of_whole["test"].tolist() == tests


def test_alarms_of_a_monitor_name_suspects_in_parts_and_through_a_pipe(plant, tmp_path, monkeypatch):
    model, data = plant
    model.write_text(MODEL + '[[fault]]\nname = "float sticks"\noutput = "height"\n')
    pd.read_csv(data).to_parquet(tmp_path / "run.parquet")
    monkeypatch.setattr(streaming, "PART", 41)
    rule = ("--alarm", "suspects=true,least.height=0.01")
    assert detect(plant, tmp_path / "whole", "-q", *rule) == 1
    assert detect((model, tmp_path / "run.parquet"), tmp_path / "parts", "-q", *rule) == 1
    lines = data.read_bytes().splitlines(keepends=True)
    given = AlarmRule(suspects=True, least={"height": 0.01})
    for size in (7, 60):  # resumed once, in the middle of the second alarm
        half = [b"".join(lines[k : k + size]) for k in range(0, 42, size)]
        judge_stream(LiveRun(model, out=tmp_path / f"pipe{size}", alarm=given), half)
        judge_stream(LiveRun(model, out=tmp_path / f"pipe{size}", alarm=given), [b"".join(lines)])
    tables = []
    for name in ("whole", "parts", "pipe7", "pipe60"):
        tables.append(pd.read_csv(tmp_path / name / "alarms.csv"))
    assert tables[0]["suspect"].tolist() == ["height"] * 2
    assert tables[0]["cause"].str.startswith("float sticks: +").all()
    for found in tables[1:]:
        same = ["first_sample", "last_sample", "windows", "test", "suspect", "size", "cause", "ended"]
        pd.testing.assert_frame_equal(found[same], tables[0][same])


def test_a_fleet_judges_by_the_tests_of_each_model(plant):
    (result,) = detect_fleet([Unit("a", *plant)])
    assert result.summary.found.tests["jumps"].first == 20


def test_a_study_refuses_a_condition_that_its_scenarios_do_not_have(plant, tmp_path, capsys):
    out = ["--faults", "height", "--out", str(tmp_path / "study")]
    assert main.main(["study", str(plant[0]), *out]) == 2
    assert "test 'jumps' watches when 'mode == 1'" in capsys.readouterr().err


def test_info_lists_the_tests(plant, capsys):
    assert main.main(["info", str(plant[0])]) == 0
    text = capsys.readouterr().out
    assert "test drifts" in text and "when mode == 1" in text


LEVEL = """
dt = 1
[[outputs]]
name = "level"
noise = 0.1
[matrices]
A = [[1]]
C = [[1]]
[[test]]
name = "jumps"
horizon = 1
factor = 0.5
[[test]]
name = "state"
observer = "zonotope"
"""


def test_the_test_that_a_run_names_is_the_one_that_is_explained(tmp_path, capsys):
    """A level creeps for 190 samples, then jumps: who remembers all of it is off by more than a window, who
    begins 64 samples earlier by less.
    """
    y = 0.001 * np.arange(192.0)
    y[191] = 0.35
    model, data = tmp_path / "level.toml", tmp_path / "run.csv"
    model.write_text(LEVEL)
    pd.DataFrame({"level": y}).to_csv(data, index_label="time")
    assert detect((model, data), tmp_path / "r", "-q") == 1
    with open(tmp_path / "r" / "verdicts.csv") as file:
        last = list(csv.DictReader(file))[191]
    capsys.readouterr()
    assert main.main(["explain", str(tmp_path / "r"), "--at", "191", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["test"] == last["test"] == "state"
    bank = jb.monitor(model)
    assert refuted_again(bank, open_source(data, bank.model), 191).certificate.test == "jumps", (
        "the case bites"
    )
