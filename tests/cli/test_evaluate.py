"""The command `jaxbound evaluate`."""

import json

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main, window
from jaxbound.models import modelfile


@pytest.fixture
def plant(tmp_path, monkeypatch, rng):
    """Return a folder with a model, two healthy recordings and one with a jump from sample 20 on."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    model = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1, dt=1, inputs=["u"], outputs=["level"])
    jb.save_model(model, "plant.toml")
    jb.save_model(model.replace(noise=0.4), "wide.toml")
    for name in ("monday", "friday", "leak"):
        y = np.full(40, 2.0) + rng.uniform(-0.05, 0.05, 40)
        frame = pd.DataFrame({"time": range(40), "u": 1.0, "level": y, "bad": 0})
        if name == "leak":
            frame.loc[20:, ["level", "bad"]] += [1.0, 1]
        frame.to_csv(f"{name}.csv", index=False)
    return tmp_path


def evaluated(capsys, *words):
    """Return what --json prints."""
    code = main.main(["evaluate", "plant.toml", *words, "--json"])
    out, err = capsys.readouterr()
    assert code == 0, err
    return json.loads(out)


def at_one(scores, rule="1/1"):
    return next(score for score in scores if score["factor"] == 1 and score["alarm"] == rule)


def test_labels_in_a_column_tell_healthy_from_faulty_samples(plant, capsys):
    found = evaluated(capsys, "--healthy", "monday.csv", "--faulty", "leak.csv", "--labels", "bad")
    score = at_one(found["models"]["plant.toml"]["scores"])
    assert score["healthy_windows"] == 39 + 19
    assert (score["healthy_in_alarm"], score["faulty_windows"]) == (0, 20)
    assert score["delays"] == [0]


def test_without_labels_every_sample_is_faulty(plant, capsys):
    found = evaluated(capsys, "--faulty", "leak.csv", "--alarm", "1/1", "2/2")
    score = at_one(found["models"]["plant.toml"]["scores"])
    assert (score["healthy_windows"], score["faulty_windows"], score["delays"]) == (0, 39, [19])
    assert at_one(found["models"]["plant.toml"]["scores"], "2/2")["delays"] == [20]


def test_a_bank_is_said_to_be_one(plant, capsys):
    model = jb.load_model("plant.toml")
    jb.save_model(
        model.replace(tests=[{"name": n, "horizon": h} for n, h in (("a", 1), ("b", 3))]), "bank.toml"
    )
    assert main.main(["evaluate", "bank.toml", "--faulty", "leak.csv"]) == 0
    assert "faulty, tested by a bank: a, b" in " ".join(capsys.readouterr().out.split())


def test_a_file_of_labels_names_the_signal(plant, capsys):
    (plant / "labels.csv").write_text("sample,label\n0,0\n20,level\n")
    found = evaluated(capsys, "--faulty", "leak.csv", "--labels", "labels.csv")
    assert found["models"]["plant.toml"]["recordings"][0]["named"][0]["signal"] == "level"


def test_another_model_is_tested_on_the_same_recordings(plant, capsys):
    words = ("--faulty", "leak.csv", "--labels", "bad", "--compare", "wide.toml")
    found = evaluated(capsys, *words)["models"]
    assert at_one(found["plant.toml"]["scores"])["faulty_in_alarm"] == 20
    assert at_one(found["wide.toml"]["scores"])["faulty_in_alarm"] == 1
    assert found["wide.toml"]["scores"][0]["factor"] == 0.5


def test_a_folder_gets_a_picture_a_curve_and_the_counts(plant, capsys):
    words = ["--healthy", "monday.csv", "--faulty", "leak.csv", "--labels", "bad", "--out", "out"]
    code = main.main(["evaluate", "plant.toml", *words, "--peers", "friday.csv"])
    shown = capsys.readouterr().out
    assert code == 0
    assert shown.startswith("0 of 58 healthy windows in alarm (0 %); 20 of 20 faulty ones (100 %).")
    for name in ("PCA T2, Q", "forest, auto", "3 sigma", "CUSUM"):
        assert f"\n{name}" in shown
    assert (plant / "out" / "roc.png").read_bytes()[:4] == b"\x89PNG"
    curve = pd.read_csv(plant / "out" / "curve.csv")
    assert set(curve.detector) == {"plant.toml", "PCA T2, Q", "forest, auto", "3 sigma", "CUSUM"}
    assert json.loads((plant / "out" / "evaluation.json").read_text())["peers"]["CUSUM"]["note"]


def test_an_observer_is_evaluated_too(plant, capsys):
    words = ("--faulty", "leak.csv", "--labels", "bad", "--method", "observer", "--factors", "1")
    found = evaluated(capsys, *words)["models"]["plant.toml"]
    assert at_one(found["scores"])["faulty_in_alarm"] >= 1
    assert found["note"].startswith("an observer follows each recording once a factor")


@pytest.mark.parametrize(
    "words, sentence",
    [
        ([], "there is no recording to evaluate by"),
        (["--healthy", "monday.csv", "--labels", "bad"], "--labels are those of --faulty"),
        (["--faulty", "leak.csv", "--labels", "a", "b"], "for all of --faulty, or one each: 2 for 1"),
        (["--faulty", "leak.csv", "--labels", "nothing"], "has no column 'nothing'"),
        (["--faulty", "leak.csv", "--factors", "x"], "--factors needs numbers with commas"),
        (["--faulty", "leak.csv", "--factors", "-1"], "factors on bounds are > 0 and finite"),
        (["--healthy", "monday.csv", "--peers", "monday.csv"], "monday.csv is in --peers too"),
        (["--faulty", "leak.csv", "--method", "validation"], "method must be one of"),
        (["--faulty", "leak.csv", "--out", "."], "leak.csv"),
        (["--faulty", "none.csv"], "there is no data file none.csv"),
    ],
)
def test_what_cannot_be_evaluated_is_a_sentence_and_writes_nothing(plant, capsys, words, sentence):
    if words[-2:] == ["--out", "."]:
        (plant / "roc.png").write_text("mine")
        sentence = "roc.png"
    before = sorted(p.name for p in plant.iterdir())
    assert main.main(["evaluate", "plant.toml", *words]) == 2
    said = capsys.readouterr().err
    assert sentence in said and len(said.strip().splitlines()) == 1
    assert sorted(p.name for p in plant.iterdir()) == before


def test_the_model_is_read_once(plant, capsys, monkeypatch):
    """It was read once for its rule of alarms, and again for its tests."""
    reads, load = [], modelfile.load_model
    for module in (modelfile, window):
        monkeypatch.setattr(module, "load_model", lambda path: reads.append(path) or load(path))
    evaluated(capsys, "--faulty", "leak.csv", "--labels", "bad")
    assert list(map(str, reads)) == ["plant.toml"]


def test_alarms_latch_where_the_model_says_so_and_plain_ones_do_not(plant, capsys):
    model = jb.load_model("plant.toml")
    jb.save_model(model.replace(alarms={"latch": True}), "plant.toml")
    words = ("--faulty", "leak.csv", "--labels", "bad", "--factors", "4")
    (_, own) = evaluated(capsys, *words)["models"]["plant.toml"]["scores"]
    (_, plain) = evaluated(capsys, *words, "--alarm", "plain")["models"]["plant.toml"]["scores"]
    assert (own["alarm"], plain["alarm"]) == ("1/1 latched", "1/1")
    assert plain["faulty_in_alarm"] < own["faulty_in_alarm"] == 20 and own["delays"] == [0]
