"""The command `jaxbound study`."""

import json

import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.cli import study as command
from jaxbound.studies.montecarlo import montecarlo


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "plant.toml"
    jb.save_model(
        jb.LinearSystem(
            [[0.8]],
            [[1]],
            [[1]],
            noise=0.1,
            tolerance=0.005,
            name="tank <1>",
            units={"y1": "bar"},
            columns={"y1": "Level 1"},
        ),
        path,
    )
    return path


def run(model, out, *more):
    return main.main(
        [
            "study",
            str(model),
            "--faults",
            "y1:bias",
            "--sizes",
            "0.1:5:3",
            "--n",
            "9000",
            "--scenario",
            "samples=60",
            "--seed",
            "3",
            "--out",
            str(out),
            *more,
        ]
    )


def test_a_study_writes_tables_and_a_page_and_prints_what_it_found(model, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(model, out, "--scenario", "onset=20:25,input_range=-2:2,hold=7", "--rows") == 0
    said = capsys.readouterr()
    assert "detected: share of scenarios with a FAULT" in " ".join(said.out.split())
    assert "0 false alarms in" in said.out and "y1:bias" in said.out and said.err == ""
    summary, delays = pd.read_csv(out / "summary.csv"), pd.read_parquet(out / "delays.parquet")
    assert (
        summary.scenarios.tolist() == [3000] * 3
        and summary.false_alarms.sum() == 0
        and delays.scenarios.sum() == 9000
    )
    pd.testing.assert_frame_equal(summary, pd.read_parquet(out / "summary.parquet"), check_dtype=False)
    rows = pd.read_parquet(out / "scenarios")
    assert len(rows) == 9000 and rows.onset.between(20, 24).all() and rows.onset.nunique() == 5
    page = (out / "report.html").read_text()
    assert "of a drift per sample" in page and "<th" in page
    assert "tank &lt;1&gt;" in page and "size of the fault" not in page and "What is guaranteed" in page
    expected = jb.study(
        jb.load_model(model),
        "y1:bias",
        9000,
        3,
        sizes=[0.1, 2.55, 5.0],
        samples=60,
        onset=(20, 25),
        input_range=(-2, 2),
        hold=7,
    )
    assert summary.detected.tolist() == expected.tallies[0].detected.tolist()


def test_an_interrupted_command_goes_on_and_says_so(model, tmp_path, capsys, monkeypatch):
    out, whole = tmp_path / "out", tmp_path / "whole"
    monkeypatch.setattr(montecarlo, "EVERY", 0.0)
    work = montecarlo.Keeper.save

    def stop(keeper, done):
        work(keeper, done)
        if done == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(montecarlo.Keeper, "save", stop)
    assert run(model, out) == 130
    assert (
        "2 of 3 blocks of scenarios are kept" in capsys.readouterr().err
        and not (out / "summary.csv").exists()
    )
    monkeypatch.setattr(montecarlo.Keeper, "save", work)
    assert run(model, out, "--json") == 0 and run(model, whole) == 0
    told = json.loads(capsys.readouterr().out.split("\n}")[0] + "\n}")
    assert told["false_alarms"] == 0 and told["scenarios"] == 9000 and told["cells"][0]["fault"] == "y1:bias"
    assert (out / "summary.csv").read_text() == (whole / "summary.csv").read_text()
    assert run(model, out, "--scenario", "at=vertices") == 2
    assert "study.npz is of another at" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("sentence", "more"),
    [
        ("'Level 1' is the column of the signal y1", ["--faults", "Level 1:bias"]),
        ("--sizes needs lo:hi:count", ["--sizes", "a:b"]),
        ("input_range of --scenario needs lo:hi", ["--scenario", "input_range=3"]),
        ("onset of --scenario needs", ["--scenario", "onset=1.5:3"]),
        ("unknown field 'smples'; did you mean 'samples'?", ["--scenario", "smples=30"]),
        ("at must be one of", ["--scenario", "at=corners"]),
        ("the model has no signal", ["--faults", "y9:bias"]),
        ("needs a whole number >= 1", ["--n", "0"]),
    ],
)
def test_wrong_usage_is_one_sentence_and_nothing_is_written(sentence, more, model, tmp_path, capsys):
    assert run(model, tmp_path / "out", *more) == 2
    said = capsys.readouterr().err
    assert sentence in said and said.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "first, said", [(2.0, "100000 scenarios of 200 samples: about 5 minutes to go"), (0.1, "")]
)
def test_a_long_study_says_beforehand_how_long_it_takes(first, said, monkeypatch, capsys):
    now = iter(
        [8.0, 8.0 + first, 8.0 + 3 * first, 8.0 + 4 * first]
    )  # the first of a hundred and fifty parts is compiled before
    monkeypatch.setattr(command.time, "monotonic", lambda: next(now))
    announced = command._Announced(100_000, 200, lambda share: None)
    for part in (1, 2, 4, 5):
        announced(part / 150)
    err = capsys.readouterr().err
    assert err.count("\n") == bool(said) and said in err
