"""Outputs: a new one is one small class, which every command that tests a recording writes."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main, pipe
from jaxbound.runs.runfile import load_run
from jaxbound.runs.sink import REGISTERED, Sink, register
from jaxbound.runs.sinks import file_names

MODEL = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)
COMMANDS = {
    "csv": ["run.csv"],
    "parquet": ["run.parquet"],
    "validation": ["run.csv", "--method", "validation"],
}


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    jb.save_model(MODEL, tmp_path / "model.toml")
    run = pd.DataFrame({"time": np.arange(8.0), "y1": [1.0, 0.5, 0.26, 0.9, 0.4, 0.2, 0.1, 0.05]})
    run.to_csv("run.csv", index=False)
    run.to_parquet("run.parquet")
    yield tmp_path
    REGISTERED.clear()


@pytest.fixture
def plain():
    """Register an output."""

    @register
    class Plain(Sink):
        names = ("summary.json",)

        def close(self, outcome):
            (self.folder / self.names[0]).write_text(json.dumps(outcome.summary.plain()))


@pytest.mark.parametrize("options", COMMANDS.values(), ids=COMMANDS)
def test_a_new_output_is_one_small_class(place, plain, options):
    codes = [
        main.main(["detect", "model.toml", *options, "--out", "out"]) for _ in range(2)
    ]  # the second replaces what the first wrote
    assert codes[0] == codes[1] in (0, 1)
    assert sum(json.loads((place / "out/summary.json").read_text())["counts"].values()) == 8
    assert "summary.json" in (place / "out/.jaxbound.json").read_text()


def test_a_pipe_writes_a_new_output_where_it_ends(place, plain):
    head, *rows = (place / "run.csv").read_bytes().splitlines(True)
    for part, samples in ((rows[:5], 5), (rows[5:], 8)):  # the second process goes on behind the first
        assert pipe.judge_stream(pipe.LiveRun("model.toml", out=Path("out")), [head, *part]) == 1
        found = json.loads((place / "out/summary.json").read_text())
        assert sum(found["counts"].values()) == found["samples"] == samples and found["worst"]["sample"] == 3
    assert "summary.json" in (place / "out/.jaxbound.json").read_text()
    with pytest.raises(ValueError, match="it came through a pipe"):
        load_run(place / "out")


def test_the_outputs_of_a_run_are_known_by_name():
    assert set(file_names()) >= {"verdicts.csv", "alarms.csv", "run.json"}
    assert "alarms.csv" not in file_names(whole=False)
