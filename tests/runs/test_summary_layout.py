"""One Summary for every command: the same layout of JSON, the same words for the same verdicts."""

import json

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import evaluation, main, validation
from jaxbound.cli.pipe import LiveRun, judge_stream
from jaxbound.runs.summary import LAYOUT, Evidence, Summary, evidence, said, summarised

T = 40
MODEL = jb.LinearSystem([[0.5]], [[1]], [[1], [2]], noise=0.1, columns={"where": "y2 < 100"}, name="tank")
KEYS = [
    "layout",
    "verdict",
    "exit_code",
    "summary",
    "model",
    "method",
    "horizon",
    "samples",
    "counts",
    "decided",
    "margin",
    "worst",
    "alarms",
    "first_alarm",
    "last_ended",
    "hints",
]
LAST = ["ended", "always_seen", "margins", "outside"]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Leave a model, a recording with a gap, an excluded stretch and a fault, and a fleet of it in a folder;
    draw nothing.
    """
    for home, name in ((evaluation, "write_report"), (validation, "write_page")):
        monkeypatch.setattr(home, name, lambda *args, **options: None)
    monkeypatch.setattr(main, "_configure", lambda: None)
    u, x = np.sin(np.arange(T)), np.zeros(T)
    for k in range(1, T):
        x[k] = 0.5 * x[k - 1] + u[k - 1]
    y = np.stack([x, 2 * x], 1)
    y[30, 0] += 5
    y[[8, 9], 1] = 1e3
    time = np.arange(T) + np.where(
        np.arange(T) < 24, 0.0, 60.0
    )  # stretches of at most 16 samples: one compiled size
    frame = pd.DataFrame({"time": time, "u1": u, "y1": y[:, 0], "y2": y[:, 1]})
    frame.to_csv(tmp_path / "run.csv", index=False)
    frame.to_parquet(tmp_path / "run.parquet")
    jb.save_model(MODEL, tmp_path / "m.toml")
    (tmp_path / "fleet.csv").write_text("unit,model,recording\nA,m.toml,run.csv\nB,m.toml,none.csv\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def shell(capsys, *args):
    """Return (exit code, what --json printed)."""
    code = main.main([*args, "--out", "out", "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_every_command_has_one_layout(place, capsys):
    about = ["data", "seconds", "out"]
    code, whole = shell(capsys, "detect", "m.toml", "run.csv")
    assert (
        code == whole["exit_code"] == 1
        and list(whole) == [*KEYS, *about, *LAST]
        and whole["layout"] == LAYOUT == 1
    )
    _, parts = shell(capsys, "detect", "m.toml", "run.parquet")
    other = ("data", "seconds", "hints")  # rows of a CSV file are counted with the header
    assert {k: v for k, v in whole.items() if k not in other} == {
        k: v for k, v in parts.items() if k not in other
    }
    _, fleet = shell(capsys, "fleet", "fleet.csv")
    unit, untested = fleet["units"]
    assert fleet["layout"] == 1 and list(unit) == list(untested) == ["unit", *KEYS, *LAST, "recording"]
    alike = [k for k in (*KEYS, "ended") if k not in ("hints", "model")]
    assert {k: unit[k] for k in alike} == {k: whole[k] for k in alike}
    assert (
        untested["verdict"] == "not tested"
        and untested["counts"] == dict.fromkeys(whole["counts"], 0)
        and untested["worst"] is None
    )
    _, validated = shell(capsys, "detect", "m.toml", "run.csv", "--method", "validation")
    assert list(validated) == [*KEYS, "tested", "faulty", *about, *LAST] and validated["faulty"] == {"y1": 1}


def test_files_parquet_and_fleets_end_the_same_alarm_by_an_acknowledgement(place, capsys):
    (place / "seen.txt").write_text("95, J. Smith\n")
    rule = "--alarm", "latch=true", "--alarm", "acknowledged=seen.txt"
    for data in ("run.csv", "run.parquet"):
        assert shell(capsys, "detect", "m.toml", data, *rule)[1]["ended"] == {"acknowledged": 1}
    assert shell(capsys, "fleet", "fleet.csv", *rule)[1]["units"][0]["ended"] == {"acknowledged": 1}
    rows = "good,m.toml,run.csv,", "other,m.toml,run.csv,seen.txt"  # the file of one unit alone
    (place / "units.csv").write_text("\n".join(["unit,model,recording,acknowledged", *rows]) + "\n")
    units = {
        unit["unit"]: unit
        for unit in shell(capsys, "fleet", "units.csv", "--alarm", "latch=true")[1]["units"]
    }
    assert units["other"]["ended"] == {"acknowledged": 1} and "acknowledged" not in units["good"]["ended"]
    units = {unit["unit"]: unit for unit in shell(capsys, "fleet", "units.csv")[1]["units"]}
    assert "give latch, too" in units["other"]["summary"]
    assert main.main(["detect", "m.toml", "run.csv", "--out", "out", *rule[2:]]) == 2
    assert "give latch, too" in capsys.readouterr().err


def test_the_pipe_says_what_detect_says(place, capsys):
    _, whole = shell(capsys, "detect", "m.toml", "run.csv")
    assert judge_stream(LiveRun("m.toml"), [(place / "run.csv").read_bytes()]) == 1
    assert whole["summary"] in " ".join(capsys.readouterr().err.split())


def test_numbers_agree_with_the_verdicts(place):
    res = jb.detect(jb.parity_relations(MODEL), jb.read("run.csv", MODEL))
    found = evidence(res, alarms := res.alarms())
    assert (
        found.windows == T - res.relations.horizon - res.aside < T
        and found.counts == res.counts
        and found.alarms == len(alarms)
    )
    assert (
        found.at == np.nanargmin(np.where(res.status == jb.Status.FAULT, res.margin, np.nan))
        and found.first == 30
    )
    summary = summarised(res, alarms, "sample {}".format)
    assert (
        summary.verdict == "fault"
        and summary.exit_code == 1
        and summary.first_alarm == "sample 30"
        and summary.worst.sample == found.at
    )


def test_nothing_to_test_is_too_little_evidence_of_no_windows():
    nothing = dict.fromkeys(("MISSING", "CONSISTENT", "UNDECIDED", "FAULT"), 0)
    assert said(Evidence("joint", 3, 2, nothing | {"MISSING": 2}), str) == (
        "too little evidence",
        "Too little evidence: only 0 of 0 windows (0 %) could be decided, at least 50 % are asked for.",
    )
    assert json.dumps(Summary("not tested", "why").plain(), allow_nan=False)


@pytest.mark.parametrize(
    "margin, bounded, used",
    [
        (1.2e-4, False, "; the tightest, at sample 7, uses >99.9 % of them"),
        (1.2e-4, True, "; none uses more than 99.99 % of them"),
        (1.2e-7, True, ""),
    ],
)
def test_a_bound_on_the_margin_names_no_tightest_window(margin, bounded, used):
    counts = {"MISSING": 3, "CONSISTENT": 9, "UNDECIDED": 0, "FAULT": 0}
    found = Evidence("joint", 3, 12, counts, at=7, margin=margin, bounded=bounded)
    sentence = said(found, "sample {}".format)[1]
    assert sentence == f"No fault found: the model explains all 9 windows within its bounds{used}."
