"""Factors on noise from files and streams: the verdicts are those of a table in memory."""

import json
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli.main import main
from jaxbound.recordings.read import open_source

T = 300


@pytest.fixture
def unit(tmp_path):
    """Return (folder, model, table), with files of both: a factor of an input and one of a column."""
    rng = np.random.default_rng(0)
    fan, load, x, y = rng.uniform(0, 1.2, T), rng.normal(0, 1, T), 0.0, []
    for value in fan:
        y.append([x, 2 * x])
        x = 0.9 * x + 0.5 * value
    size = np.stack([0.4 * (1 + 0.5 * abs(fan - 0.6)), 0.3 * (1 + load**2)], 1)
    y = np.array(y) + 1.05 * size * rng.choice([-1, 1], (T, 2))
    y[200:215, 0] += 4
    times = pd.date_range("2026-01-01", periods=T, freq="1min")
    table = pd.DataFrame({"Time": times, "Fan": fan, "load": load, "T1": y[:, 0], "T2": y[:, 1]})
    table.loc[50, "load"] = np.nan
    table.loc[70, "T1"] = np.nan
    model = jb.LinearSystem(
        [[0.9]],
        [[0.5]],
        [[1], [2]],
        dt=60,
        noise=[0.4, 0.3],
        inputs="fan",
        outputs=["T1", "T2"],
        columns={"fan": "Fan"},
        times={"T1": "1 + 0.5*abs(fan - 0.6)", "T2": "1 + load**2"},
        horizon=3,
        name="ahu",
    )
    jb.save_model(model, tmp_path / "m.toml")
    table.to_csv(tmp_path / "run.csv", index=False)
    table.to_parquet(tmp_path / "run.parquet", index=False)
    return tmp_path, model, table


def test_files_and_chunks_are_judged_as_a_table_is(unit):
    folder, model, table = unit
    relations = jb.parity_relations(model)
    whole = jb.detect(relations, table)
    assert {1, 3} <= set(whole.status.tolist())
    for name in ("run.csv", "run.parquet"):
        read = jb.read(folder / name, model)
        np.testing.assert_array_equal(read.u, jb.Recording.of(model, table).u)
        np.testing.assert_array_equal(jb.detect(relations, read).margin, whole.margin)
    for chunk in (64, 1000):
        jb.detect_dataset(relations, folder / "run.parquet", folder / f"out{chunk}", chunk=chunk)
        judged = pd.read_parquet(folder / f"out{chunk}" / "verdicts.parquet")
        assert judged["status"].tolist() == [jb.Status(s).name for s in whole.status]
        np.testing.assert_array_equal(judged["margin"].to_numpy(), whole.margin)


def test_narrow_files_are_judged_as_a_narrow_table_is(unit):
    folder, model, table = unit
    numbers = {name: np.float32 for name in ("Fan", "load", "T1", "T2")}
    narrow = table.astype(numbers)
    narrow.to_parquet(folder / "narrow.parquet", index=False)
    relations = jb.parity_relations(model)
    whole = jb.detect(relations, narrow)
    assert whole.y.dtype == np.float32
    jb.detect_dataset(relations, folder / "narrow.parquet", folder / "out", chunk=64)
    judged = pd.read_parquet(folder / "out" / "verdicts.parquet")
    np.testing.assert_array_equal(judged["margin"].to_numpy(np.float32), whole.margin)


def test_a_pipe_is_judged_as_a_table_is(unit, kernels):
    folder, model, table = unit
    whole = jb.detect(jb.parity_relations(model), table)
    asked = [sys.executable, "-m", "jaxbound.cli", "detect", str(folder / "m.toml"), "-"]
    done = subprocess.run(asked, input=(folder / "run.csv").read_bytes(), capture_output=True, check=False)
    lines = done.stdout.decode().splitlines()
    judged = [line.split(",")[1] for line in lines if line.startswith("2026")]
    assert judged == [jb.Status(s).name for s in whole.status], done.stderr


def test_the_shell_confirms_its_certificates_with_the_factors(unit, capsys):
    folder, model, table = unit
    assert (
        main(["detect", str(folder / "m.toml"), str(folder / "run.csv"), "--out", str(folder / "rep")]) == 1
    )
    at = int(np.nanargmin(jb.detect(jb.parity_relations(model), table).margin))
    assert main(["explain", str(folder / "rep"), "--at", str(at)]) == 0
    certificate = folder / "rep" / f"certificate-{at}.json"
    assert json.loads(certificate.read_text())["names"]["times_noise"] == dict(model.times)
    for data in ("run.csv", "run.parquet"):
        asked = ["verify", str(certificate), "--model", str(folder / "m.toml"), "--data", str(folder / data)]
        assert main(asked) == 0
    other = model.replace(times={"T1": "1 + 0.5*abs(fan - 0.7)", "T2": "1 + load**2"})
    jb.save_model(other, folder / "other.toml")
    asked = [
        "verify",
        str(certificate),
        "--model",
        str(folder / "other.toml"),
        "--data",
        str(folder / "run.csv"),
    ]
    assert main(asked) != 0
    page = (folder / "rep" / "report.html").read_text()
    assert "times 1 + 0.5*abs(fan - 0.6)" in page
    assert main(["info", str(folder / "m.toml")]) == 0
    assert "times 1 + load**2" in capsys.readouterr().out


def test_units_of_a_fleet_have_the_verdicts_of_their_recordings(unit):
    folder, model, table = unit
    (folder / "fleet.csv").write_text("unit,model,recording\na,m.toml,run.csv\nb,m.toml,run.parquet\n")
    worst = float(np.nanmin(jb.detect(jb.parity_relations(model), table).margin))
    assert main(["fleet", str(folder / "fleet.csv"), "--out", str(folder / "fleet")]) == 1
    found = pd.read_csv(folder / "fleet" / "fleet.csv")
    np.testing.assert_allclose(found["margin"], worst, rtol=1e-3)


def test_a_factor_that_is_none_is_named_by_its_sample_in_any_chunk(unit):
    folder, model, table = unit
    table.loc[200:, "load"] = -1.0
    table.loc[:199, "load"] = 1.0
    table.to_parquet(folder / "bad.parquet", index=False)
    source = open_source(folder / "bad.parquet", model.replace(times={"T1": "load"}))
    with pytest.raises(ValueError, match="at sample 200 it is -1"):
        source.read(150, 250)
