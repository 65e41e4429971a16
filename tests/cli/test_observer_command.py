"""--method observer: the same verdicts in memory, in parts and through a pipe; a report with bands, proofs
that fractions replay.
"""

import contextlib
import json
import sqlite3
from functools import partial

import numpy as np
import pandas as pd
import pytest
from check_certificate import confirm

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.cli import pipe as piped
from jaxbound.diagnosis.alarms import BEGAN_ANEW, ENDINGS
from jaxbound.recordings.parquet import ParquetSource
from jaxbound.recordings.read import open_source
from jaxbound.runs import parts, streaming
from jaxbound.runs.ask import Ask

T, ONSET = 110, 60


@pytest.fixture(scope="module")
def signals():
    """Return u, y of a slow plant whose first sensor drifts from sample 60 on; some samples are missing,
    there is a gap behind 40.
    """
    rng, x, u = (
        np.random.default_rng(3),
        np.zeros(2),
        np.repeat(np.random.default_rng(4).uniform(0, 2, T // 10), 10).round(3),
    )
    y = np.zeros((T, 2))
    for k in range(T):
        y[k], x = (
            x,
            np.array([0.9 * x[0] + 0.05 * x[1], 0.9 * x[1] + 0.1 * u[k]]) + rng.uniform(-0.004, 0.004, 2),
        )
    y = (y + rng.uniform(-0.09, 0.09, y.shape)).round(6)
    y[ONSET:, 0] += 0.02 * np.arange(T - ONSET)
    y[[20, 60], [0, 1]] = np.nan
    return u, y


@pytest.fixture
def place(tmp_path, monkeypatch, signals):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    plant = jb.LinearSystem(
        [["0.9", "0.05"], [0, "0.9"]],
        [[0], ["0.1"]],
        [[1, 0], [0, 1]],
        noise="0.1",
        disturbance=([[1, 0], [0, 1]], "0.005"),
        inputs="heat",
        outputs=["T1", "T2"],
    )
    jb.save_model(plant, "plant.toml")
    u, y = signals
    t = np.arange(T) + 5.0 * (np.arange(T) >= 40)
    table = pd.DataFrame({"time": t, "heat": u, "T1": y[:, 0], "T2": y[:, 1]})
    table.to_csv("run.csv", index=False)
    table.to_parquet("run.parquet")
    return tmp_path


def told(folder):
    """Return {time: (status, margin)} of a folder's verdicts."""
    if (folder / "verdicts.csv").exists():
        table = pd.read_csv(folder / "verdicts.csv")
    else:
        table = pd.read_parquet(folder / "verdicts.parquet")
    return list(
        zip(
            table["time"].astype(float),
            table["status"].astype(str),
            table["margin"].round(12).fillna(9),
            strict=True,
        )
    )


def detect(*more, out, data="run.csv"):
    return main.main(["detect", "plant.toml", data, "--out", out, "--method", "observer", *more])


def test_a_report_shows_bands_and_says_when_the_observer_began_anew(place, capsys):
    assert detect("--json", out="out") == 1
    found, page = json.loads(capsys.readouterr().out), (place / "out/report.html").read_text()
    assert (
        found["method"] == "observer"
        and found["exit_code"] == 1
        and set(found["ended"]) <= {BEGAN_ANEW, ENDINGS[0]}
    )
    assert (
        "contradict the model and the samples before them" in found["summary"]
        and found["counts"]["CONSISTENT"] == 0
    )
    assert "while a fault lasts, they may" in page, "what bands still mean"
    model = jb.load_model("plant.toml")
    res = jb.detect(jb.observer(model), jb.read("run.csv", model))
    assert (
        res.counts == found["counts"]
        and res.status[:ONSET].max() == jb.Status.UNDECIDED
        and res.status[40] == jb.Status.MISSING
    )
    bands = json.loads(page.split('id="numbers">')[1].split("</script>")[0])["whole"]["series"]
    assert {"s0:band", "s1:band", "x0:band", "x1:band"} <= set(bands) and "x0" not in bands
    outside = (res.y < res.readings.lo) | (res.y > res.readings.hi)
    assert not outside[res.status == jb.Status.UNDECIDED].any(), (
        "what leaves the band of healthy readings is FAULT"
    )
    assert "contradicts all samples since" in page and "behind a contradiction it begins anew" in page
    assert detect("--json", "--test", "latched=true", out="latched") == 1
    found = json.loads(capsys.readouterr().out)
    assert found["alarms"] == 1 and found["last_ended"] == ENDINGS[0] and found["counts"]["FAULT"] > 20


def test_a_healthy_recording_is_no_fault_though_nothing_is_proved_consistent(place, capsys):
    pd.read_csv("run.csv").iloc[:ONSET].to_csv("healthy.csv", index=False)
    assert detect("-q", out="out", data="healthy.csv") == 0
    assert capsys.readouterr().out.startswith(
        "No fault found: none of 58 samples is proved to contradict the model and the samples before"
    )


def test_explain_proves_a_contradiction_by_the_shortest_window_that_shows_it(place, capsys):
    detect("-q", out="out")
    first = next(i for i, row in enumerate(told(place / "out")) if row[1] == "FAULT")
    capsys.readouterr()
    assert main.main(["explain", "out", "--at", str(first), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    confirm(document)
    assert document["certificate"] == "FAULT" and document["names"]["sample"] == first
    assert len(document["names"]["times"]) == len(document["numbers"]["y"]) >= 3
    assert (
        main.main(["explain", "out", "--at", "10"]) == 2
        and "an observer exhibits no behaviour" in capsys.readouterr().err
    )


def test_a_pipe_says_what_the_file_says_and_goes_on_behind_a_kill(place, capsysbinary):
    detect("-q", out="out")
    lines = (place / "run.csv").read_bytes().splitlines(keepends=True)
    follow = partial(piped.judge_stream, piped.LiveRun("plant.toml", Ask("observer"), out=place / "pipe"))
    assert follow([b"".join(lines[:55]), None]) == 0
    with contextlib.closing(sqlite3.connect(place / "pipe/monitor.sqlite")) as database:
        ((memory,),) = database.execute("SELECT memory FROM checkpoint")
    assert follow([b"".join(lines[55:70]), *lines[70:]]) == 1
    assert told(place / "pipe") == told(place / "out"), "the carry is in the state"
    assert len(json.loads(memory)["judge"]) > 5
    assert b"contradict the model and the samples before them" in capsysbinary.readouterr().err


@pytest.mark.parametrize(
    "method",
    [("--test", "latched=true"), ()],
)
def test_parts_carry_on_and_are_made_again_where_they_are_lost(place, capsys, monkeypatch, method):
    detect("-q", *method, out="out")
    monkeypatch.setattr(streaming, "PART", 30)
    monkeypatch.setattr(streaming, "LEAST", 1)
    assert detect("-q", *method, "--chunk", "33", out="parts", data="run.parquet") == 1
    assert told(place / "parts") == told(place / "out")
    observer = jb.observer(jb.load_model("plant.toml"), restart=not method)
    source = open_source(place / "run.parquet", observer.model)
    folder, _ = streaming.write_parts(streaming.Asked(observer, Ask("observer")), source, place / "again")
    read = lambda: [pd.read_parquet(p).to_csv() for p in parts.part_files(folder)]
    before = read()
    parts.part_files(folder)[2].unlink()
    streaming.write_parts(streaming.Asked(observer, Ask("observer")), source, place / "again")
    assert len(before) == 4 and read() == before
    with pytest.raises(ValueError, match="carries what it knows from each part to the next"):
        streaming.write_parts(
            streaming.Asked(observer, Ask("observer")), source, place / "shared", part=(1, 2)
        )


@pytest.mark.long(by_day="test_parts_carry_on_and_are_made_again_where_they_are_lost")
def test_parts_with_an_observer_of_their_own_can_be_shared_and_say_what_one_says_that_begins_there(
    place, capsys, monkeypatch
):
    monkeypatch.setattr(streaming, "PART", 50)
    monkeypatch.setattr(streaming, "LEAST", 1)
    more = ("-q", "--overlap", "20")
    for i in (4, 2, 1, 3):
        assert detect(*more, "--part", f"{i}/4", out="shared", data="run.parquet") == 0
    assert (
        detect("-q", "--merge", "--overlap", "21", out="shared", data="run.parquet") == 2
        and "of another overlap" in capsys.readouterr().err
    )
    assert detect(*more, "--merge", out="shared", data="run.parquet") == 1
    assert detect(*more, "--chunk", "21", out="one", data="run.parquet") == 1
    assert told(place / "shared") == told(place / "one")
    model = jb.load_model("plant.toml")
    r = open_source(place / "run.parquet", model).read()
    found = [jb.detect(jb.observer(model), r.cut(max(i - 20, 0), min(i + 50, T))) for i in range(0, T, 50)]
    each = [
        jb.Status(s).name
        for i, part in zip(range(0, T, 50), found, strict=True)
        for s in part.status[min(i, 20) :]
    ]
    assert [row[1] for row in told(place / "one")] == each and "FAULT" in each


JOINT = "--test", "observer=joint", "--test", "window=8"


@pytest.mark.long(by_day="test_a_pipe_says_what_the_file_says_and_goes_on_behind_a_kill")
def test_windows_that_remember_say_the_same_in_memory_in_parts_through_a_pipe_and_in_a_fleet(
    place, capsysbinary, monkeypatch
):
    assert detect("--json", *JOINT, out="out") == 1
    found = json.loads(capsysbinary.readouterr().out)
    model = jb.load_model("plant.toml")
    res = jb.detect(jb.observer(model, method="joint", window=8), jb.read("run.csv", model))
    assert res.counts == found["counts"] and [row[1] for row in told(place / "out")] == [
        jb.Status(s).name for s in res.status
    ]
    assert (res.margin < jb.detect(jb.observer(model), jb.read("run.csv", model)).margin).any(), (
        "sharper than without observer=joint"
    )
    first = int((res.status == jb.Status.FAULT).argmax())
    assert main.main(["explain", "out", "--at", str(first), "--json"]) == 0
    confirm(json.loads(capsysbinary.readouterr().out))
    monkeypatch.setattr(streaming, "PART", 50)
    monkeypatch.setattr(streaming, "LEAST", 1)
    assert detect("-q", *JOINT, "--chunk", "33", out="parts", data="run.parquet") == 1
    lines = (place / "run.csv").read_bytes().splitlines(keepends=True)
    ask = Ask.of_fields({"observer": "joint", "window": 8})
    follow = partial(piped.judge_stream, piped.LiveRun("plant.toml", ask, out=place / "pipe"))
    assert follow([b"".join(lines[:55]), None]) == 0
    assert follow([b"".join(lines[55:70]), *lines[70:]]) == 1
    assert told(place / "pipe") == told(place / "parts") == told(place / "out")
    (place / "units.csv").write_text(
        "unit,model,recording\n" + "".join(f"{unit},plant.toml,run.csv\n" for unit in "abc")
    )
    capsysbinary.readouterr()
    assert main.main(["fleet", "units.csv", "--out", "fleet", "--method", "observer", *JOINT, "--json"]) == 1
    assert [unit["counts"] for unit in json.loads(capsysbinary.readouterr().out)["units"]] == [
        found["counts"]
    ] * 3


def test_an_observer_has_the_order_that_is_asked_for(place, capsys, monkeypatch):
    def run(observer, *more, **options):
        raise ValueError(f"an observer of order {observer.order}")

    monkeypatch.setattr("jaxbound.runs.ask.detect", run)
    assert detect("--test", "order=8", out="out") == 2
    assert "an observer of order 8" in capsys.readouterr().err


def test_a_study_is_given_the_observer_that_is_asked_for(place, capsys, monkeypatch):
    def study(model, faults, n, seed, relations, **more):
        raise ValueError(f"{type(relations).__name__} of {relations.window}, {relations.restart}")

    monkeypatch.setattr("jaxbound.studies.montecarlo.montecarlo.study", study)
    assert (
        main.main(
            [
                "study",
                "plant.toml",
                "--faults",
                "T1:bias",
                "--out",
                "study",
                "--method",
                "observer",
                *JOINT,
                "--test",
                "latched=true",
            ]
        )
        == 2
    )
    assert "JointObserver of 8, False" in capsys.readouterr().err


def test_what_a_part_of_an_observer_depends_on_is_read_once(place, monkeypatch):
    monkeypatch.setattr(streaming, "PART", 8)
    read, content_of = [], ParquetSource.content_of
    monkeypatch.setattr(
        ParquetSource, "content_of", lambda self, a, b: read.append(b - a) or content_of(self, a, b)
    )
    observer = jb.observer(jb.load_model("plant.toml"))
    streaming.write_parts(
        streaming.Asked(observer, Ask("observer")),
        open_source(place / "run.parquet", observer.model),
        place / "out",
    )
    assert sum(read) == T


def test_a_digest_proves_a_contradiction_from_few_samples(place, monkeypatch):
    model, read, chunk = jb.load_model("plant.toml"), [], ParquetSource.read
    found = jb.detect_dataset(jb.observer(model), "run.parquet", "out", "observer")
    monkeypatch.setattr(ParquetSource, "read", lambda self, a, b: read.append(b - a) or chunk(self, a, b))
    certificate = found.explain(found.alarms[0].start)
    assert certificate.proves == jb.Status.FAULT and read == [1, 64]


@pytest.mark.parametrize(
    "more, says",
    [
        (("--overlap", "3"), "--overlap is for Parquet: run.csv is read as a whole"),
        (("--method", "joint", "--overlap", "3"), "overlap is for observers: windows know how far"),
        (("--test", "lags=0,1"), "--test has lags and observer: a test looks back in one way"),
        (
            ("--method", "joint", "--test", "order=3"),
            'order of --test is for an observer: it has none, like observer = "joint"',
        ),
        (("--method", "box", "--test", "latched=true"), "latched of --test is for an observer"),
        (("--method", "box", "--test", "observer=joint"), "method=box takes no observer"),
        (("--test", "window=8"), "window is no option of the observer"),
        (("--test", "observer=strips", "--test", "window=8"), "window is no option of the observer"),
        (
            ("--test", "observer=constrained"),
            '"joint" sees at least as much: observer(model, method="joint")',
        ),
        (("--method", "box", "--test", "window=8"), "window of --test is for an observer"),
        (
            ("--test", "observer=joint", "--test", "window=9"),
            "window must be an even number of samples >= 4",
        ),
        (("--part", "1/2"), "--part is for windows: an observer carries what it knows from sample to sample"),
    ],
)
def test_what_does_not_go_together_is_said_in_a_sentence(place, capsys, more, says):
    assert detect(*more, out="out", data="run.csv" if more == ("--overlap", "3") else "run.parquet") == 2
    assert says in capsys.readouterr().err


def test_a_fleet_is_followed_side_by_side_and_says_what_each_unit_says_alone(place, capsys, monkeypatch):
    detect("-q", out="out")
    table = pd.read_csv("run.csv")
    table.assign(T1=table["T1"] - 0.02 * np.maximum(np.arange(T) - ONSET, 0)).to_csv(
        "healthy.csv", index=False
    )
    table.iloc[:60].to_csv("short.csv", index=False)
    (place / "text.csv").write_text("time,heat,T1,T2\n0,a,b,c\n")
    names = {
        "drifts": "run.csv",
        "healthy": "healthy.csv",
        "short": "short.csv",
        "text": "text.csv",
        "gone": "gone.csv",
        "too": "run.csv",
    }
    (place / "units.csv").write_text(
        "unit,model,recording\n" + "".join(f"{unit},plant.toml,{file}\n" for unit, file in names.items())
    )
    capsys.readouterr()
    batches, fold = [], jb.estimation.observer.SetObserver.fold
    monkeypatch.setattr(
        "jaxbound.estimation.observer.SetObserver.fold",
        lambda self, carry, piece: batches.append(np.shape(piece.y)) or fold(self, carry, piece),
    )
    assert main.main(["fleet", "units.csv", "--out", "fleet", "--method", "observer", "--json"]) == 1
    found = {unit["unit"]: unit for unit in json.loads(capsys.readouterr().out)["units"]}
    beside = [samples for units, samples, *_ in batches if units == 3]
    assert sum(beside) == T, "units of one length are one batch"
    alone = [row[1] for row in told(place / "out")]
    assert (
        found["drifts"]["counts"]
        == found["too"]["counts"]
        == {s.name: alone.count(s.name) for s in jb.Status}
    )
    assert (
        found["healthy"]["verdict"] == "no fault"
        and found["text"]["verdict"] == found["gone"]["verdict"] == "not tested"
    )
    assert found["short"]["samples"] == 60 and (place / "fleet/units").is_dir()
    assert (
        main.main(["fleet", "units.csv", "--out", "fleet", "--method", "observer", "--test", "lags=0,1"]) == 2
    )


def test_an_alarm_that_stays_ends_at_a_gap(place, capsys):
    table = pd.read_csv("run.csv")
    table.loc[table.index >= 90, "time"] += 7.0
    table.to_csv("gap.csv", index=False)
    assert detect("--json", "--test", "latched=true", out="latched", data="gap.csv") == 1
    found, page = json.loads(capsys.readouterr().out), (place / "latched/report.html").read_text()
    ended = pd.read_csv("latched/alarms.csv")["ended"]
    assert ended[0].startswith("a gap ended it") and found["ended"][ended[0]] == 1
    assert not [
        said
        for said in (page, *ended, *found["hints"])
        if "began anew behind" in said or "latched=true" in said
    ]
    assert any("ended at a gap" in hint for hint in found["hints"])


@pytest.mark.parametrize("fitted", [True, False])
def test_bounds_found_for_shorter_windows_prove_no_fault(place, capsys, monkeypatch, fitted):
    """What an observer of all samples refutes may be no more than an error that lasts longer than those
    windows.
    """
    plant = jb.load_model("plant.toml").replace(horizon=15, provenance={"noise": "fitted to 3 recordings"})
    jb.save_model(plant if fitted else plant.replace(provenance={"noise": "data sheet"}), "plant.toml")
    code, verdict = (3, "outside the bounds as fitted") if fitted else (1, "fault")
    title = "Outside the bounds as fitted" if fitted else "Fault proved"
    assert detect("--json", out="out") == code
    found, page = json.loads(capsys.readouterr().out), (place / "out/report.html").read_text()
    assert (found["verdict"], found["exit_code"]) == (verdict, code) and found["counts"]["FAULT"]
    assert found["summary"].startswith(f"{title}: ") and f"<h2>{title}</h2>" in page
    assert (
        fitted
        == ("Fault proved" not in page)
        == any("found from data for windows of 16" in hint for hint in found["hints"])
    )
    with open("fleet.csv", "w") as f:
        f.write("unit,model,recording\nP-101,plant.toml,run.csv\n")
    assert main.main(["fleet", "fleet.csv", "--out", "fleet", "--method", "observer", "--json"]) == code
    (unit,) = json.loads(capsys.readouterr().out)["units"]
    assert unit["verdict"] == verdict and unit["summary"] == found["summary"]
    assert detect("--json", out="parts", data="run.parquet") == code
    assert json.loads(capsys.readouterr().out)["verdict"] == verdict
    ask = Ask("observer")
    assert (
        piped.judge_stream(piped.LiveRun("plant.toml", ask=ask), [(place / "run.csv").read_bytes()]) == code
    )
    assert f"{title}: " in capsys.readouterr().err
