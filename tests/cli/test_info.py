"""What `jaxbound info` says of detection and isolation."""

import json

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.cli.model_summary import isolation_text

TANK = dict(
    A=[["9/10", 0], [0, "4/5"]],
    B=[[1], [0]],
    C=[[1, 0], [0, 1], [1, 1]],
    noise=0.1,
    unknown_inputs=[[0], [1]],
)


def test_info_lists_relations_signatures_and_sizes(tmp_path, capsys):
    path = tmp_path / "tank.toml"
    jb.save_model(jb.LinearSystem(**TANK, units={"u1": "%"}, outputs=("level", "flow", "sum")), path)
    assert main.main(["info", str(path)]) == 0
    text = capsys.readouterr().out
    assert "unknown inputs" in text and "1, of which nothing is known" in text
    assert "level + flow - sum = 0" in text and "(10 q - 9) level - 10 u1 = 0" in text
    assert "level flow sum u1" in text and "seen level flow sum u1" in text
    lines = dict(
        line.strip().split(": ", 1)
        for line in text.splitlines()
        if line.strip().startswith(("level: ", "u1: "))
    )
    size = jb.detectable(jb.load_model(path), "u1", 1)
    assert lines["u1"] == f"{float(size):.4g} %" and float(lines["level"]) > 0
    assert main.main(["info", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["guaranteed"]["u1"] == float(size) and list(told["guaranteed"]) == [
        "level",
        "flow",
        "sum",
        "u1",
    ]
    assert told["outputs"][1] == dict(
        name="flow", unit="", column="flow", offset=0.0, tolerance=0.0, noise=0.1, resolution=0.0
    )
    assert (
        told["unknown_inputs"] == 1
        and told["inputs"][0]["unit"] == "%"
        and len(told["relations"]) == jb.parity_relations(jb.load_model(path)).count
    )


def test_info_says_which_named_faults_windows_tell_apart(tmp_path, capsys):
    faults = jb.NamedFault("valve is off", input="u"), jb.NamedFault("y1 is off", output="y1")
    static = jb.LinearSystem(None, None, None, [[1], [1]], noise=0.1, inputs=["u"], faults=faults)
    jb.save_model(static, tmp_path / "plant.toml")
    assert main.main(["info", str(tmp_path / "plant.toml")]) == 0
    text = capsys.readouterr().out
    assert "valve is off: seen from +0.2 of u on; at 2 times that taken for: no other" in text
    assert "y1 is off: seen from +0.2 of y1 on; at 2 times that taken for: valve is off (+0.2 of u)" in text
    assert main.main(["info", str(tmp_path / "plant.toml"), "--json"]) == 0
    one, two = json.loads(capsys.readouterr().out)["named_faults"]
    assert one["taken_for"] == {} and list(two["taken_for"]) == ["valve is off"]


def test_sizes_that_nothing_guarantees_and_tolerances_are_named():
    alone = jb.LinearSystem([["1/2", 0], [0, 1]], [[1], [0]], [[1, 0], [0, 1]], noise=0.1)
    assert "y2: never guaranteed" in isolation_text(alone, 1)
    assert "operating range" in isolation_text(jb.LinearSystem(**(TANK | dict(tolerance=0.1))), 1)


def test_many_signals_are_left_to_the_user():
    unit = [[int(i == j) for j in range(13)] for i in range(13)]
    assert "more than 12 signals" in isolation_text(jb.LinearSystem(unit, None, unit, noise=1), 1)


def test_devices_are_examined(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert main.main(["info", "--device", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"devices": {"cpu (cpu)": ""}}
    assert main.main(["info", "--device", "--template"]) == 2 and main.main(["examine"]) == 2
    assert "jaxbound examine is jaxbound info --device now" in capsys.readouterr().err
