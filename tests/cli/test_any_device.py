"""Commands beside a card that nobody examined: text, page and JSON say what its verdicts are worth."""

import json

import jax
import numpy as np
import pandas as pd
import pytest
from lying_device import lying, unexamined
from systems import paper

import jaxbound as jb
from jaxbound.cli import evaluation, main
from jaxbound.cli.pipe import LiveRun, judge_stream
from jaxbound.consistency.searched import NOT_REFUTED

pytestmark = pytest.mark.compiled

FOLLOWED = "followed on the CPU, since what an observer carries has to be proved, and NVIDIA 99.0 was"


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return a folder with a model, a faulty recording as CSV and as Parquet, and a fleet of both."""
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.chdir(tmp_path)
    jb.save_model(paper(name="paper"), "model.toml")
    u = np.repeat([0.5, -0.5, 0.5], 20)[:, None]
    y = np.array(jb.simulate(paper(), u, 0, at="uniform").y)
    y[40:, 0] += 1
    table = pd.DataFrame({"t": np.arange(60) / 100, "u1": u[:, 0], "y1": y[:, 0], "y2": y[:, 1]})
    table.to_csv("run.csv", index=False)
    table[:40].to_csv("healthy.csv", index=False)
    (tmp_path / "run").mkdir()
    table.to_parquet("run/0.parquet")
    (tmp_path / "fleet.csv").write_text("unit,model,recording\na,model.toml,run.csv\n")
    return tmp_path


def summary(capsys, *command):
    """Return (exit code, the JSON that a command prints) where the device lies."""
    with unexamined(), lying(0.02):
        code = main.main([*command, "--json"])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.filterwarnings("ignore::jaxbound.consistency.twice.Doubtful")
@pytest.mark.parametrize("data", ["run.csv", "run"])
def test_a_fault_is_found_and_the_summary_says_who_judged(place, data, capsys):
    code, found = summary(capsys, "detect", "model.toml", data, "--out", "out")
    assert code == 1 and found["counts"]["FAULT"] and not found["counts"]["CONSISTENT"]
    (hint,) = (hint for hint in found["hints"] if hint.startswith(NOT_REFUTED))
    assert "NVIDIA 99.0" in hint and NOT_REFUTED in (place / "out" / "report.html").read_text()


def test_without_a_fault_the_evidence_is_too_little(place, capsys, monkeypatch):
    monkeypatch.setattr(evaluation, "write_report", lambda *args, **options: None)
    with unexamined():
        assert main.main(["detect", "model.toml", "healthy.csv", "--out", "out"]) == 3
    shown = " ".join(capsys.readouterr().out.split())
    assert "Too little evidence: only 0 of" in shown and NOT_REFUTED in shown


@pytest.mark.parametrize("method", ["observer", pytest.param("validation", marks=pytest.mark.long)])
def test_what_carries_a_set_is_followed_on_the_cpu(place, method, capsys, monkeypatch):
    monkeypatch.setattr(evaluation, "write_report", lambda *args, **options: None)
    data = "run" if method == "observer" else "run.csv"
    code, found = summary(capsys, "detect", "model.toml", data, "--out", "out", "--method", method)
    assert code == 1 and any(hint.startswith(FOLLOWED) for hint in found["hints"])


@pytest.mark.filterwarnings("ignore::jaxbound.consistency.twice.Doubtful")
def test_a_fleet_and_a_pipe_say_so_too(place, capsys):
    code, _ = summary(capsys, "fleet", "fleet.csv", "--out", "units")
    assert code == 1 and NOT_REFUTED in (place / "units" / "fleet.html").read_text()
    with unexamined(), lying(0.02):
        assert judge_stream(LiveRun("model.toml"), [(place / "run.csv").read_bytes()]) == 1
    out, err = capsys.readouterr()
    assert NOT_REFUTED in err and "CONSISTENT" not in out


@pytest.mark.parametrize("failure", [RuntimeError, AssertionError])  # jax has both, by what is installed
@pytest.mark.parametrize("command", ["demo --out out", "example heater"])
def test_a_platform_that_is_not_there_is_refused_in_one_sentence(
    command, failure, capsys, monkeypatch, tmp_path
):
    def nothing():
        raise failure

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    monkeypatch.setattr(jax, "default_backend", nothing)
    assert main.main(command.split()) == 2
    said = capsys.readouterr().err
    assert "JAX_PLATFORMS=cuda names no device of this machine: unset it, or use cpu" in said
    assert not list(tmp_path.iterdir())
