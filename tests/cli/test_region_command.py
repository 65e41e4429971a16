"""The region of training in everything that commands write: one word, the same in each format."""

import csv
import json

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.cli import pipe as piped
from jaxbound.runs import journal
from jaxbound.runs.ask import Ask

T = 120
COLUMNS = ["outside", "outside_by", "outside_at"]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Leave models and a recording of two faults in a folder: one begins outside training, one is inside."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.setattr(journal, "SYNCHRONOUS", "OFF")
    u, x, y = np.sin(np.arange(T))[:, None].round(6) / 2, np.zeros(2), np.zeros((T, 2))
    u[70:75] = 0.875
    for k in range(T):
        y[k], x = (x[0], x[0] + x[1]), np.array([0.8 * x[0] + x[1], 0.2 * x[1] + u[k, 0]])
    y[72:80, 0] += 9
    y[100, 0] -= 9
    table = pd.DataFrame({"t": 0.01 * np.arange(T), "u1": u[:, 0], "y1": y[:, 0], "y2": y[:, 1]})
    for name in ("run", "again"):
        table.to_csv(f"{name}.csv", index=False)
    table.to_parquet("run.parquet", index=False)
    jb.save_model(paper(name="tank", ranges={"u1": ("-0.5", "0.5")}, units={"u1": "bar"}), "tank.toml")
    jb.save_model(paper(name="bare"), "bare.toml")
    (tmp_path / "fleet.csv").write_text("unit,model,recording\nA,tank.toml,run.csv\nB,tank.toml,again.csv\n")
    return tmp_path


def shell(capsys, *args, code=1):
    """Return what a command prints."""
    capsys.readouterr()
    assert main.main(list(args)) == code
    return capsys.readouterr().out


def rows_of(path):
    with open(path, newline="") as f:
        return list(csv.DictReader(f))


def result(**changes):
    model = jb.load_model("tank.toml")
    return jb.detect(jb.parity_relations(model), jb.read("run.csv", model), **changes)


def test_a_file_and_its_report_say_where_the_fault_lies(place, capsys):
    out = shell(capsys, "detect", "tank.toml", "run.csv", "--out", "out")
    res = result()
    beyond = res.beyond
    assert 0 < beyond.faults < res.counts["FAULT"] and beyond.faults <= beyond.windows
    lines = " ".join(out.split())
    some = (
        f"{beyond.faults} of the FAULT ones lie outside training, most by u1 at 0.875 bar, training up to 0.5"
    )
    assert some in lines
    assert (
        f"training {beyond.windows} of {T - 1} windows outside, {beyond.faults} of them FAULT; most by"
        in lines
    )
    rows = rows_of("out/verdicts.csv")
    assert list(rows[0])[1:] == ["status", "margin", *COLUMNS, "suspect"]
    for k, row in enumerate(rows):
        share = "" if np.isnan(res.outside[k]) else res.outside[k]
        assert (row["outside"] == share) or float(row["outside"]) == share
        assert row["outside_by"] == ("u1" if res.outside[k] > 0 else "")
        assert row["outside_at"] == ("0.875" if res.outside[k] > 0 else "")
    alarms = rows_of("out/alarms.csv")
    told = [(int(row["outside"]), row["outside_by"]) for row in alarms]
    assert told == [(a.outside, a.outside_by) for a in res.alarms()] and told[0][0] and not told[-1][0]
    page = (place / "out/report.html").read_text()
    assert "Region of training: " in page and beyond.words in page and "in training from" in page
    assert f"outside training: {told[0][0]} of its FAULT windows, by {beyond.words}" in page
    assert '"training": [-0.5, 0.5]' in page, "the charts of inputs are shaded there"


def test_certificates_say_it_of_their_window(place, capsys):
    shell(capsys, "detect", "tank.toml", "run.csv", "--out", "out")
    out = shell(capsys, "explain", "out", "--at", "73", code=0)
    assert "training outside it: u1 at 0.875 bar, training up to 0.5 bar" in " ".join(out.split())
    out = shell(capsys, "explain", "out", "--at", "101", code=0)
    assert "training its inputs are within the ranges of training" in " ".join(out.split())


def test_parquet_says_the_same(place, capsys):
    whole = json.loads(shell(capsys, "detect", "tank.toml", "run.csv", "--out", "out", "--json"))
    parts = json.loads(shell(capsys, "detect", "tank.toml", "run.parquet", "--out", "parts", "--json"))
    assert parts["outside"] == whole["outside"] and whole["outside"]["words"].startswith("u1 at 0.875 bar")
    assert whole["outside"]["inputs"] == {"u1": whole["outside"]["faults"]} and whole["outside"]["windows"]
    assert parts["summary"] == whole["summary"]
    table = pq.read_table("parts/verdicts.parquet")
    assert table.column_names == ["time", "status", "margin", *COLUMNS, "suspect"]
    np.testing.assert_array_equal(table["outside"].to_numpy(), result().outside)
    assert rows_of("parts/alarms.csv")[0]["outside"] == rows_of("out/alarms.csv")[0]["outside"]
    page = (place / "parts/report.html").read_text()
    assert "Region of training: " in page and whole["outside"]["words"] in page


@pytest.mark.parametrize("options", [{}, {"method": "observer"}, {"outside": "undecided"}])
def test_a_pipe_says_the_same_line_by_line(options, place, capsysbinary):
    args = [part for name, value in options.items() for part in (f"--{name}", value)]
    main.main(["detect", "tank.toml", "run.csv", "--out", "whole", *args])
    expected = (place / "whole/verdicts.csv").read_bytes()
    data = (place / "run.csv").read_bytes()
    for cuts, name in (([], "pipe"), (range(0, len(data), 97), "cut")):
        capsysbinary.readouterr()
        ends = [0, *cuts, len(data)]
        pieces = [data[a:b] for a, b in zip(ends, ends[1:], strict=False)]
        piped.judge_stream(piped.LiveRun("tank.toml", ask=Ask(**options), out=place / name), pieces)
        out, err = capsysbinary.readouterr()
        assert (place / name / "verdicts.csv").read_bytes() == expected.replace(
            b"t,status", b"time,status", 1
        )
        assert out.splitlines() == [row.rpartition(b",")[0] for row in expected.splitlines()]
        assert b"training: " in err
    piped.judge_stream(piped.LiveRun("tank.toml", ask=Ask(**options), json=True), [data])
    lines = [json.loads(line) for line in capsysbinary.readouterr().out.splitlines()]
    rows = rows_of("whole/verdicts.csv")
    for line, row in zip(lines, rows, strict=True):
        assert list(line) == ["time", "status", "margin", "ended", *COLUMNS]
        assert line["outside"] == (float(row["outside"]) if row["outside"] else None)
        assert (line["outside_by"] or "", line["status"]) == (row["outside_by"], row["status"])
    assert any(line["outside"] for line in lines)


@pytest.mark.parametrize("method", ["joint", "observer"])
def test_a_pipe_that_was_stopped_goes_on_with_what_it_knows(method, place, capsysbinary):
    """The window behind the cut reads inputs from before it, and so does an observer's step."""
    text = (place / "run.csv").read_bytes().splitlines(keepends=True)
    ask = Ask(method)
    piped.judge_stream(piped.LiveRun("tank.toml", ask=ask, out=place / "one"), [b"".join(text)])
    whole = capsysbinary.readouterr().err.splitlines()
    counted = [line for line in whole if line.startswith(b"jaxbound: training: ")]
    for cut in (75, 76):
        out = place / f"out{cut}"
        piped.judge_stream(piped.LiveRun("tank.toml", ask=ask, out=out), [b"".join(text[:cut])])
        piped.judge_stream(piped.LiveRun("tank.toml", ask=ask, out=out), [b"".join(text)])
        assert (out / "verdicts.csv").read_bytes() == (place / "one/verdicts.csv").read_bytes()
        assert counted[0] == counted[-1] in capsysbinary.readouterr().err.splitlines()


@pytest.mark.parametrize(
    ("factor", "said"),
    [("1", "as wide as inside"), ("1.5", "1.5 times as wide, and more")],
)
def test_info_says_how_wide_bounds_are_outside(place, capsys, factor, said):
    jb.save_model(paper(name="tank", ranges={"u1": (0, 1)}, extrapolation=factor), "wide.toml")
    text = shell(capsys, "info", "wide.toml", code=0)
    assert f"outside training  bounds {said}" in " ".join(text.split("\n")).replace("   ", "  ")


def test_undecided_claims_nothing_outside(place, capsys):
    args = ["tank.toml", "run.csv", "--test", "outside=undecided", "--json"]
    found = json.loads(shell(capsys, "detect", *args, "--out", "out"))
    plain = result()
    assert found["counts"]["FAULT"] == plain.counts["FAULT"] - plain.beyond.faults > 0
    assert found["outside"]["unclaimed"] == plain.beyond.faults and found["outside"]["faults"] == 0
    assert found["counts"] == result(outside="undecided").counts
    table = pd.read_csv("run.csv")
    table.iloc[:76].to_csv("run.csv", index=False)
    out = shell(capsys, "detect", *args[:-1], "--out", "out", code=0)
    lines = " ".join(out.split())
    assert (
        "that the model does not explain lie outside training, where no FAULT is claimed, most by u1" in lines
    )
    assert lines.startswith("No fault found: ") and "uses" not in lines.partition(" windows ")[0]
    few = shell(capsys, "detect", *args[:-1], "--out", "out", "--min-coverage", "0.99", code=3)
    assert few.startswith("Too little evidence: ") and "where no FAULT is claimed" in " ".join(few.split())


def test_what_was_begun_with_one_word_is_not_gone_on_with_by_another(place, capsys):
    text = (place / "run.csv").read_bytes()
    piped.judge_stream(piped.LiveRun("tank.toml", out=place / "live"), [text])
    with pytest.raises(Exception, match="is of another word outside training"):
        other = Ask(outside="undecided")
        piped.judge_stream(piped.LiveRun("tank.toml", ask=other, out=place / "live"), [text])


def test_validation_takes_no_such_word(place, capsys):
    args = ["detect", "tank.toml", "run.csv", "--out", "out", "--method", "validation"]
    assert main.main([*args, "--test", "outside=undecided"]) == 2
    assert "outside is for other methods: validation does not ask" in capsys.readouterr().err


def test_without_ranges_no_word_is_said(place, capsys):
    out = shell(capsys, "detect", "bare.toml", "run.csv", "--out", "out")
    assert "training" not in out and list(rows_of("out/verdicts.csv")[0])[1:] == [
        "status",
        "margin",
        "suspect",
    ]
    assert "outside" not in rows_of("out/alarms.csv")[0]
    assert "Region of training" not in (place / "out/report.html").read_text()
    assert "training" not in shell(capsys, "explain", "out", "--at", "73", code=0)
    found = json.loads(shell(capsys, "detect", "bare.toml", "run.csv", "--out", "out", "--json"))
    assert found["outside"] is None


@pytest.mark.parametrize(
    "args", [[], ["--method", "observer"], ["--state", "kept"], ["--method", "observer", "--state", "kept"]]
)
def test_a_fleet_says_it_of_each_unit(args, place, capsys):
    found = json.loads(shell(capsys, "fleet", "fleet.csv", "--out", "out", "--json", *args))
    one = json.loads(
        shell(
            capsys,
            "detect",
            "tank.toml",
            "run.csv",
            "--out",
            "one",
            "--json",
            *args[: 2 * ("--m" in str(args))],
        )
    )
    for unit, row in zip(found["units"], rows_of("out/fleet.csv"), strict=True):
        assert unit["outside"] == one["outside"]
        assert (row["outside"], row["FAULT_outside"]) == tuple(
            str(one["outside"][name]) for name in ("windows", "faults")
        )
        assert row["outside_by"] == one["outside"]["words"]
    assert f"{one['outside']['windows']} windows outside training" in (place / "out/fleet.html").read_text()
    assert "outside" in shell(capsys, "fleet", "fleet.csv", "--out", "again", *args)
    args = ["--test", "outside=undecided", *args]
    claimed = json.loads(shell(capsys, "fleet", "fleet.csv", "--out", "third", "--json", *args))
    assert all(unit["outside"]["faults"] == 0 < unit["outside"]["unclaimed"] for unit in claimed["units"])


def test_fit_writes_where_each_input_was(place, capsys):
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1, 1, 30), 10)
    y = np.zeros(300)
    for k in range(1, 300):
        y[k] = 0.8 * y[k - 1] + 0.2 * u[k - 1]
    table = pd.DataFrame({"u": u, "lamp": 2.0, "y": y + rng.uniform(-0.01, 0.01, 300)})
    fitted = jb.fit(table, inputs=["u", "lamp"], outputs=["y"], dt=1.0, horizon=15)
    assert {name: tuple(map(float, ends)) for name, ends in fitted.ranges.items()} == {
        "u": (u.min(), u.max()),
        "lamp": (2.0, 2.0),
    }
    jb.save_model(fitted, "fitted.toml")
    again = jb.load_model("fitted.toml")
    assert again.ranges == fitted.ranges
    relations = jb.parity_relations(again)
    assert jb.detect(relations, table).beyond.windows == 0, "training lies in its own region"
    lit = jb.detect(relations, table.assign(lamp=2.5))
    assert (
        lit.outside[relations.horizon :] == np.inf
    ).all() and lit.beyond.words == "lamp at 2.5, training always at 2, where bounds are 3.38 times as wide"
