"""Verdicts on means over intervals, as their samples come: those of the same recording as a file."""

import io
import itertools
import sys

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.cli import pipe as piped
from jaxbound.runs import journal
from jaxbound.sets.floats.status import Status


@pytest.mark.parametrize("kill", [False, True])
def test_verdicts_of_a_pipe_are_those_of_the_file(tmp_path, monkeypatch, rng, kill):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.setattr(journal, "SYNCHRONOUS", "OFF")
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO()))
    model = jb.LinearSystem(
        [[0.5]], [[1]], [[1]], noise=0.3, dt=60, columns={"every": "1min"}, name="plant", horizon=2
    )
    jb.save_model(model, "m.toml")
    u, y = rng.uniform(-1, 1, 40), np.zeros(40)
    for k in range(1, 40):
        y[k] = 0.5 * y[k - 1] + u[k - 1]
    y[25:30] += 3
    seconds = pd.date_range("2024-03-01 08:00", periods=240, freq="10s")
    frame = pd.DataFrame({"time": seconds, "u1": np.repeat(u, 6), "y1": np.repeat(y, 6)})
    frame = frame.drop(index=[70, *range(130, 133)])
    frame.to_csv("run.csv", index=False)
    text = frame.to_csv(index=False).encode()
    cuts = sorted(rng.choice(np.arange(700, len(text)), 5, replace=False).tolist())
    chunks = [text[a:b] for a, b in itertools.pairwise([0, *cuts, len(text)])]
    runs = [[chunk, None] for chunk in chunks] if kill else [chunks]
    for run in runs:
        piped.judge_stream(piped.LiveRun("m.toml", out=tmp_path / "out"), iter(run))
    found = pd.read_csv("out/verdicts.csv")
    result = jb.detect(jb.parity_relations(jb.load_model("m.toml")), jb.read("run.csv", model))
    assert found["status"].tolist() == [Status(s).name for s in result.status[: len(found)]]
    assert len(found) == len(result.status) - 1  # behind the last interval nothing begins
    assert {"FAULT", "CONSISTENT", "MISSING"} <= set(found["status"])
    assert found["time"][1] == "2024-03-01 08:01:00"
