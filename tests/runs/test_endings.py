"""A fault that lasts after its alarm is over: page, table, JSON and terminal say that this cannot be told
from a repair.
"""

import csv
import html
import json
from collections import Counter

import jax
import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.cli import evaluation, main
from jaxbound.diagnosis import detectability
from jaxbound.diagnosis.alarms import ENDINGS, NO_LONGER, ONSET_LEFT
from jaxbound.diagnosis.detectability import always_seen
from jaxbound.runs.endings import ending_hints, sizes_seen, sizes_text

N, ONSET = 100, 50
HEATER = jb.LinearSystem(
    [["0.98", "0.01"], ["0.013", "0.97"]],
    [["0.02"], ["0"]],
    [[1, 0], [0, 1]],
    noise=0.2,
    disturbance=([[1, 0], [0, 1]], [0.05, 0.05]),
    units={"y1": "degC"},
    horizon=3,
)


def recorded(model, *faults):
    """Return (u, y) of a plant at work with faults that begin at ONSET and last."""
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, (N // 10, 1)), 10, 0)
    return u, np.asarray(jb.simulate(model, u, jax.random.key(0), faults=faults).y)


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return a folder with the README's plant: a bias and a gain fault of its sensors, both of which last."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    jb.save_model(paper(units={"y1": "<bar>"}), "model.toml")
    for name, fault in (
        ("bias", jb.Fault("y1", "bias", 0.2, ONSET)),
        ("gain", jb.Fault("y2", "gain", 1.0, ONSET)),
    ):
        u, y = recorded(paper(), fault)
        lines = [f"{k / 100},{float(u[k, 0])},{float(y[k, 0])},{float(y[k, 1])}\n" for k in range(N)]
        (tmp_path / f"{name}.csv").write_text("time,u1,y1,y2\n" + "".join(lines))
    return tmp_path


def test_page_table_and_json_of_a_lasting_bias_say_repaired_or_lasting(place, capsys):
    assert main.main(["detect", "model.toml", "bias.csv", "--out", "out", "--json"]) == 1
    found, rows = (
        json.loads(capsys.readouterr().out),
        list(csv.DictReader((place / "out/alarms.csv").read_text().splitlines())),
    )
    ended = Counter(row["ended"] for row in rows)
    assert (
        found["counts"]["CONSISTENT"] > found["counts"]["FAULT"] and rows[-1]["ended"] == ONSET_LEFT
    )  # it turned green
    assert (
        found["ended"] == ended
        and sum(ended.values()) == found["alarms"]
        and list(found)[-4:] == ["ended", "always_seen", "margins", "outside"]
    )
    (hint,) = found["hints"]
    assert (
        f"{ended[ONSET_LEFT]} of 4 alarms may have ended because the onset left the window: repaired or "
        f"lasting; " in hint
    )
    assert (
        f"{ended[NO_LONGER]} of 4 alarms ended after windows without the onset: repaired, or hidden within "
        f"the bounds" in hint
    )
    page = (place / "out/report.html").read_text()
    sizes = f"to show a constant error that lasts from y1 {found['always_seen']['y1']:.3g} &lt;bar&gt;"
    assert found["always_seen"]["y1"] > 0.2 and "sure" not in hint and sizes in page
    assert html.escape(hint) in page and page.count(ONSET_LEFT) == ended[ONSET_LEFT] and "<bar>" not in page
    assert "that is no proof that a fault before it is repaired" in page


def test_the_terminal_says_so_too_and_not_where_the_fault_is_seen_while_it_lasts(place, monkeypatch, capsys):
    monkeypatch.setattr(evaluation, "write_report", lambda *args, **options: None)
    assert main.main(["detect", "model.toml", "bias.csv", "--out", "out"]) == 1
    assert "may have ended because the onset left the window: repaired or lasting" in capsys.readouterr().out
    assert main.main(["detect", "model.toml", "gain.csv", "--out", "out"]) == 1
    assert (
        "repaired" not in capsys.readouterr().out and "repaired" not in (place / "out/alarms.csv").read_text()
    )
    assert main.main(["detect", "model.toml", "gain.csv", "--out", "out", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["ended"] == {"still on at the last sample": 1}


def test_parquet_says_the_same(place, monkeypatch, capsys):
    import pandas as pd

    monkeypatch.setattr(evaluation, "write_report", lambda *args, **options: None)
    pd.read_csv("bias.csv", dtype=str).map(float).to_parquet("bias.parquet")
    found = {}
    for name in ("bias.csv", "bias.parquet"):
        assert main.main(["detect", "model.toml", name, "--out", name[-3:], "--json"]) == 1
        found[name] = json.loads(capsys.readouterr().out)
    one, other = found.values()
    assert (
        other["ended"] == one["ended"]
        and other["hints"] == one["hints"]
        and other["always_seen"] == one["always_seen"]
    )
    assert (place / "csv/alarms.csv").read_bytes() == (place / "uet/alarms.csv").read_bytes()


def test_a_fleet_says_why_the_last_alarm_is_over(place, capsys):
    (place / "units.csv").write_text("unit,model,recording\nA,model.toml,bias.csv\nB,model.toml,gain.csv\n")
    assert main.main(["fleet", "units.csv", "--out", "fleet", "--json"]) == 1
    units = {unit["unit"]: unit for unit in json.loads(capsys.readouterr().out)["units"]}
    assert units["A"]["last_ended"] == ONSET_LEFT and units["B"]["last_ended"] == ENDINGS[0]
    assert sum(units["A"]["ended"].values()) == units["A"]["alarms"] and ONSET_LEFT in units["A"]["ended"]
    assert units["A"]["hints"][-1].endswith("repaired, or hidden within the bounds")
    rows = {row["unit"]: row for row in csv.DictReader((place / "fleet/fleet.csv").read_text().splitlines())}
    assert rows["A"]["ended"] == ONSET_LEFT and list(rows["A"])[16] == "ended"
    assert f"The last alarm: {ONSET_LEFT}." in (place / "fleet/fleet.html").read_text()


def test_a_slow_plant_shows_the_onset_alone():
    u, y = recorded(HEATER, jb.Fault("y1", "bias", 1.5, ONSET))
    res = jb.detect(jb.parity_relations(HEATER), u, y)
    (alarm,) = res.alarms()
    assert (alarm.start, alarm.end, alarm.ended) == (ONSET, ONSET + 2, ONSET_LEFT)
    sizes = always_seen(res.relations)
    assert sizes["y1"] > 1.5 and sizes["y1"] == jb.detectable(HEATER, "y1", 3)
    assert ending_hints(res, [alarm]) == [
        "the alarm may have ended because the onset left the window: repaired or lasting"
    ]
    assert sizes_text(res, sizes) == (
        "windows of 4 samples are sure to show a constant error that lasts from "
        f"y1 {sizes['y1']:.3g} degC, y2 {sizes['y2']:.3g}, u1 {sizes['u1']:.3g} on; "
        "smaller ones may show in a longer horizon, or with the lags of jb.suggest_lags(model); "
        "bounds from data must be fitted for these again"
    )
    u, y = recorded(HEATER, jb.Fault("y1", "bias", 1.01 * sizes["y1"], ONSET))  # what is sure to be seen is
    (alarm,) = jb.detect(jb.parity_relations(HEATER), u, y).alarms()
    assert (alarm.start, alarm.end, alarm.ended) == (ONSET, N - 1, ENDINGS[0])


def test_sizes_that_are_not_known_and_those_that_no_size_is(rng):
    u, y = recorded(HEATER)
    long = jb.parity_relations(HEATER, 40)
    assert always_seen(long) is None and always_seen(jb.parity_relations(HEATER), "box") is None
    assert (
        always_seen(jb.parity_relations(paper())) is None
    )  # with a tolerance it depends on how large the readings are
    res = jb.detect(jb.parity_relations(HEATER), u, y)
    assert sizes_text(res, None) == "windows of 4 samples alone cannot tell"
    assert (
        sizes_text(res, {"y1": np.inf})
        == "windows of 4 samples may miss a constant error that lasts, whatever its size"
    )
    lasting = "that lasts from y1 2 degC on; one of u1 they may miss, whatever its size"
    assert lasting in sizes_text(res, {"y1": 2.0, "u1": np.inf})
    assert ending_hints(res, []) == []


def test_sizes_of_a_monitor_name_the_tests_that_may_see_less(monkeypatch):
    """A long test sees smaller errors; its sizes are not worked out while somebody waits."""
    u, y = recorded(HEATER, jb.Fault("y1", "bias", 5, ONSET))
    tests = [{"name": "short", "horizon": 3}, {"name": "long", "horizon": 12}]
    res = jb.detect(jb.monitor(HEATER, tests), u, y)
    both = sizes_seen(res, res.alarms())
    assert sizes_text(res, both).endswith(" on") and "long" not in sizes_text(res, both)
    monkeypatch.setattr(detectability, "EFFORT", 20_000)
    short = sizes_seen(res, res.alarms())
    assert short["y1"] > both["y1"] and short == always_seen(res.relations.parts["short"])
    assert sizes_text(res, short).endswith(
        " on; 'long' may show smaller ones: jaxbound info tells from which size on"
    )
