"""`jaxbound parameters`: bounds of constant parameters, narrowed by a recording."""

import json

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.consistency import parameter_boxes


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return a folder with a model of two constant parameters and a healthy recording of it."""
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.chdir(tmp_path)
    pole = jb.Uncertainty("pole", A=[[1]], between=("0.5", "0.9"), varying=False)
    gain = jb.Uncertainty("gain", B=[[1]], between=("0.5", "2"), varying=False)
    jb.save_model(jb.LinearSystem([[0]], [[0]], [[1]], noise="0.1", uncertainties=[pole, gain]), "plant.toml")
    rng, x, rows = np.random.default_rng(0), 0.0, []
    for k in range(80):
        u = float(rng.choice([-1, 1]))
        rows.append((float(k), u, x + rng.uniform(-0.1, 0.1)))
        x = 0.7 * x + 1.3 * u
    pd.DataFrame(rows, columns=["t", "u1", "y1"]).to_csv("run.csv", index=False)
    return tmp_path


def test_the_narrowed_model_is_that_of_the_verb(place, capsys):
    command = ["parameters", "plant.toml", "run.csv", "--out", "narrowed.toml", "--plot", "set.png"]
    assert main.main(command) == 0
    shown = capsys.readouterr().out
    r = jb.parity_relations(jb.load_model("plant.toml"))
    found = jb.parameters(r, jb.read("run.csv", r.model))
    assert jb.load_model("narrowed.toml") == found.model
    assert (place / "set.png").read_bytes()[:4] == b"\x89PNG"
    assert "every value that explains all 79 windows is in these bounds" in shown
    lo, hi = found.hull["pole"]
    row = next(line.split() for line in shown.splitlines() if line.startswith("pole "))
    assert row == ["pole", f"{lo:.6g}", f"{hi:.6g}", "0.5", "to", "0.9"]
    assert main.main(command) == 2 and "--force" in capsys.readouterr().err
    assert main.main(["detect", "narrowed.toml", "run.csv", "--out", "out"]) in (0, 3)


def test_no_values_are_a_fault_and_no_model_is_written(place, capsys):
    table = pd.read_csv("run.csv")
    table["y1"] += 2
    table.to_csv("biased.csv", index=False)
    command = ["parameters", "plant.toml", "biased.csv", "--out", "narrowed.toml"]
    assert main.main(command) == 1
    assert capsys.readouterr().out.startswith("FAULT proved: no values of pole, gain explain all 79 windows")
    assert main.main([*command, "--json"]) == 1 and not (place / "narrowed.toml").exists()
    summary = json.loads(capsys.readouterr().out)
    assert summary["status"] == "FAULT" and summary["parameters"]["pole"]["hull"] is None
    assert summary["written"] == [] and summary["boxes"] == 0 < len(summary["refuted"])


def test_interrupted_is_130_and_shows_what_is_left(place, capsys, monkeypatch):
    def interrupted(*given):
        raise KeyboardInterrupt

    monkeypatch.setattr(parameter_boxes.PolynomialBoxes, "looked", interrupted)
    assert main.main(["parameters", "plant.toml", "run.csv", "--json"]) == 130
    summary = json.loads(capsys.readouterr().out)
    assert summary["status"] == "interrupted" and summary["share"] == 1


def test_a_model_without_constant_parameters_is_refused_in_a_sentence(place, capsys):
    jb.save_model(jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1), "certain.toml")
    assert main.main(["parameters", "certain.toml", "run.csv"]) == 2
    assert "varying=False" in capsys.readouterr().err
