"""Lags: the windows of every command, kept with the model and with what was found."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.cli.window import windowed
from jaxbound.models.modelfile import load_model, save_model

LAGS = (0, 1, 3)


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return a folder with model.toml and run.csv, a fault in it."""
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.chdir(tmp_path)
    save_model(paper(name="paper"), "model.toml")
    u = np.where(np.arange(60) // 20 % 2, 1.0, -0.5)[:, None]
    x, y = np.zeros(2), []
    for k in range(60):
        y.append([x[0] + (30 <= k < 33), x[0] + x[1]])
        x = np.array([0.8 * x[0] + x[1], 0.2 * x[1] + u[k, 0]])
    data = np.column_stack([np.arange(60) / 100, u, y])
    np.savetxt("run.csv", data, delimiter=",", header="t,u1,y1,y2", comments="", fmt="%.17g")
    return u, np.array(y)


def test_detect_tests_windows_with_lags_and_explain_finds_them_again(place, capsys):
    assert main.main(["detect", "model.toml", "run.csv", "--test", "lags=3,1,0", "--out", "out"]) == 1
    res = jb.detect(jb.parity_relations(paper(), lags=LAGS), *place)
    with open("out/verdicts.csv") as f:
        assert [line.split(",")[1] for line in f][1:] == [jb.Status(int(s)).name for s in res.status]
    assert load_model("out/tested_model.toml").lags == LAGS
    capsys.readouterr()
    assert main.main(["explain", "out", "--at", "30", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["certificate"] == "FAULT" and found["numbers"]["relation"]["h"][1] == ["0", "0"]


def test_the_lags_of_a_model_file_are_taken_and_a_horizon_takes_their_place(place):
    save_model(paper(name="paper", lags=LAGS), "lags.toml")
    model = load_model("lags.toml")
    assert (
        model == paper(name="paper", lags=LAGS)
        and model.horizon == 3
        and "horizon" not in Path("lags.toml").read_text()
    )
    assert main.main(["detect", "lags.toml", "run.csv", "--out", "out"]) == 1
    assert load_model("out/tested_model.toml").lags == LAGS
    assert main.main(["detect", "lags.toml", "run.csv", "--test", "horizon=3", "--out", "out"]) == 1
    assert load_model("out/tested_model.toml").lags is None
    assert windowed(model, None, (0, 2)).lags == (0, 2) and windowed(model, None, None) is model


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--test", "lags=0,1", "--test", "horizon=3"], "--test has horizon and lags"),
        (["--test", "lags=1,2"], "0 among them"),
        (["--test", "lags=0,x"], "whole numbers"),
        (["--test", "lags=0"], "do not outnumber"),
        (["--test", "lags=0,70"], "one window needs 71"),
        (["--test", "lags=0,1", "--method", "validation"], "lags are for other methods"),
    ],
)
def test_what_is_wrong_with_lags_is_one_sentence(place, more, said, capsys):
    assert main.main(["detect", "model.toml", "run.csv", "--out", "out", *more]) == 2
    err = capsys.readouterr().err
    assert said in err and len(err.strip().splitlines()) == 1


def test_fit_keeps_lags_tune_moves_bounds_under_them_and_a_fleet_takes_them(place, capsys):
    rng = np.random.default_rng(0)
    u = rng.uniform(-1, 1, (200, 1))
    y, x = np.zeros((200, 1)), 0.0
    for k in range(200):
        y[k], x = x + rng.uniform(-0.1, 0.1), 0.9 * x + 0.1 * u[k, 0]
    np.savetxt(
        "healthy.csv", np.column_stack([np.arange(200), u, y]), delimiter=",", header="t,u,y", comments=""
    )
    fit = ["fit", "healthy.csv", "--inputs", "u", "--outputs", "y"]
    fit += ["--out", "fit.toml", "--recipe"]
    assert main.main([*fit, "order=1,lags=0,2,5,method=least squares"]) == 0
    assert "3 of 6 samples" in capsys.readouterr().out
    model = load_model("fit.toml")
    assert model.lags == (0, 2, 5) and jb.parity_relations(model).lags == (0, 2, 5)
    res = jb.detect(jb.parity_relations(model), u, y)
    assert res.counts["FAULT"] == res.counts["UNDECIDED"] == 0
    assert (
        main.main(
            ["tune", "fit.toml", "healthy.csv", "--steps", "0", "--test", "lags=0,1,4", "--out", "tuned.toml"]
        )
        == 0
    )
    assert load_model("tuned.toml").lags == (0, 1, 4)
    with open("fleet.csv", "w") as f:
        f.write("unit,model,recording\nA,tuned.toml,healthy.csv\n")
    assert main.main(["fleet", "fleet.csv", "--test", "lags=0,1,4", "--out", "fleet"]) == 0


def test_fit_says_that_a_plant_remembers_longer_than_its_windows():
    from jaxbound.cli.fit_summary import _memory

    slow = jb.LinearSystem([["0.98"]], [[1]], [[1]], noise=0.1, outputs="T", horizon=8)
    ((_, text),) = _memory(slow)
    assert "--recipe lags=0,1," in text and "T 0." in text
    assert [*_memory(slow.replace(horizon=60)), *_memory(slow.replace(lags=(0, 1)))] == []


OBSERVES = "--test observer=joint,window=16,order=5,horizon=4,latched=true --overlap 20"


@pytest.mark.parametrize("options", ["--test lags=0,4", "--test method=box,horizon=3", OBSERVES])
def test_the_command_that_reports_on_all_shares_makes_the_same_test(options):
    from jaxbound.cli.main import commands
    from jaxbound.cli.share import same_test

    parse = lambda *more: commands()["detect"].parse_args(
        [*more, "m.toml", "d", "--out", "o", *options.split()]
    )
    told = shlex.split(same_test(parse("--part", "1/2").words))
    assert same_test(["--part", "1/2", "--", "-m", "--part"]) == "jaxbound detect --merge -- -m --part"
    assert told[:2] == ["jaxbound", "detect"] and commands()["detect"].parse_args(told[2:]) == parse(
        "--merge"
    )
