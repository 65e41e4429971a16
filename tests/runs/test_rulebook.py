"""Alarms by a rule of a recording in parts are those of the same recording in memory."""

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.runs import streaming
from jaxbound.runs.digest import detect_dataset

RULES = (
    AlarmRule(2, 3, hold=1, clear=2),
    AlarmRule(merge=6),
    AlarmRule(latch=True),
    AlarmRule(latch=True, acknowledged=[52, 60.2, 101, 101.3, 200]),
    AlarmRule(suspects=True, least={"y1": 0.25}),
)


@pytest.fixture(scope="module")
def recording():
    """Return (t, u, y) of the paper's plant: its first sensor is wrong twice, its second once."""
    rng, x, N = np.random.default_rng(1), np.zeros(2), 260
    u, y = np.repeat(rng.uniform(-1, 1, (N // 20, 1)), 20, 0), np.empty((N, 2))
    for k in range(N):
        y[k], x = (x[0], x[0] + x[1]), np.array([0.8 * x[0] + x[1], 0.2 * x[1] + u[k, 0]])
    y += rng.uniform(-0.9, 0.9, y.shape) * (abs(y) * [0.018, 0.09] + [0.1, 0.01])
    y[90:110, 0] += 0.6
    y[150:153, 0] += 0.6
    y[200:, 1] += 0.9
    return 0.5 * np.arange(N), u, y


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_alarms_of_parts_are_those_of_the_whole(recording, rule, tmp_path, monkeypatch):
    t, u, y = recording
    pd.DataFrame({"t": t, "u1": u[:, 0], "y1": y[:, 0], "y2": y[:, 1]}).to_parquet(tmp_path / "run.parquet")
    model = jb.LinearSystem(
        [[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]], tolerance=[0.02, 0.1], noise=[0.1, 0.01], dt=0.5
    )
    r = jb.parity_relations(model)
    res = jb.detect(r, jb.read(tmp_path / "run.parquet", model))
    expected = res.alarms(rule=rule)
    assert expected and any(a.suspects for a in expected) == rule.names
    monkeypatch.setattr(streaming, "PART", 37)
    found = detect_dataset(r, tmp_path / "run.parquet", tmp_path / "out", alarm=rule)
    assert found.alarms == expected and found.alarm_count == len(expected)
    assert [a.ended for a in found.alarms] == [a.ended for a in expected]
    np.testing.assert_equal([a.size for a in found.alarms], [a.size for a in expected])
    assert found.alarms[0].errors == expected[0].errors
    assert len(list((tmp_path / "out/verdicts.parquet").iterdir())) == 8


@pytest.mark.parametrize("options", [[], ["--alarm", "suspects=true"]])
def test_times_in_alarms_are_written_one_way_in_csv_and_parquet(recording, tmp_path, monkeypatch, options):
    """Time stamps came with six or nine digits behind each second."""
    _, u, y = recording
    stamps = np.datetime64("2026-01-01", "ns") + (500 * np.arange(len(u))).astype("timedelta64[ms]")
    table = pd.DataFrame({"time": stamps, "u1": u[:, 0], "y1": y[:, 0], "y2": y[:, 1]})
    written = {"run.csv": table, "run.parquet": table, "zoned.parquet": table}
    written["run.csv"] = table.assign(time=[str(x).removesuffix(".000000") for x in table["time"]])
    written["zoned.parquet"] = table.assign(time=table["time"].dt.tz_localize("Europe/Berlin"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    model = jb.LinearSystem(
        [[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]], tolerance=[0.02, 0.1], noise=[0.1, 0.01], dt=0.5
    )
    jb.save_model(model, "m.toml")
    found = {}
    for name, frame in written.items():
        if name.endswith("csv"):
            frame.to_csv(name, index=False)
        else:
            frame.to_parquet(name, index=False)
        assert main.main(["detect", "m.toml", name, "--out", "out", "-q", *options]) == 1
        found[name] = pd.read_csv("out/alarms.csv", dtype=str)[["start", "end", "worst"]]
    moments = found["run.parquet"].to_numpy().ravel().tolist()
    assert {len(text) for text in moments} == {len("2026-01-01 00:00:45"), len("2026-01-01 00:00:45.500")}
    shorter = found["run.csv"].replace(r"(\.\d{3})0+$", r"\1", regex=True)
    pd.testing.assert_frame_equal(shorter, found["run.parquet"])
    pd.testing.assert_frame_equal(shorter + "+01:00", found["zoned.parquet"])
    # written last; numpy warns of offsets, and warnings are errors
    assert main.main(["explain", "out", "--at", found["zoned.parquet"]["start"][0]]) == 0
