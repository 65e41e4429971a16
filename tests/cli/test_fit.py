"""The command `jaxbound fit`: from a CSV file to a model file, or one sentence."""

import dataclasses
import inspect
import json
import re
from fractions import Fraction
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import jaxbound as jb
from jaxbound.cli import fields, fit_summary, main
from jaxbound.cli.fit_summary import signal_columns
from jaxbound.recordings.read import read_signals
from jaxbound.studies.identification import window_tests
from jaxbound.studies.identification.window_tests import WindowChoice


@pytest.fixture
def place(tmp_path, monkeypatch, rng):
    """Return a folder with a recording of a heated tank, on in all but its last samples; commands run in
    it.
    """
    u = np.repeat(rng.uniform(0, 50, (20, 1)), 6, 0)[:, 0]
    x = np.zeros(120)
    for k in range(119):
        x[k + 1] = 0.8 * x[k] + 0.1 * u[k]
    room = rng.uniform(18, 22, 120)
    rows = np.column_stack(
        [2.0 * np.arange(120), u, room + x + rng.uniform(-0.1, 0.1, 120), room, np.arange(120) < 110]
    )
    header = "Time (s),Heater (%),T out,T room,on\n"
    (tmp_path / "run.csv").write_text(
        header + "\n".join(",".join(f"{v:.4f}" for v in row) for row in rows) + "\n"
    )
    (tmp_path / "still.csv").write_text(header + "\n".join(f"{2 * k},1,20,20,1" for k in range(50)) + "\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    return tmp_path


FIT = [
    "fit",
    "run.csv",
    "--inputs",
    "heat=Heater (%)",
    "--outputs",
    "lift=`T out`-`T room`",
    "--recipe",
    "order=1,horizon=4",
    "--where",
    "on == 1",
    "--out",
    "tank.toml",
]


def test_fit_writes_a_model_file(place, capsys):
    assert main.main([*FIT, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    model = jb.load_model("tank.toml")
    assert (model.horizon, model.dt, model.name) == (4, 2.0, "tank")
    assert model.columns == {"heat": "Heater (%)", "lift": "= `T out`-`T room`", "where": "on == 1"}
    assert (
        said["noise"] == {"lift": float(model.noise[0])}
        and said["resolution"] == {"lift": 5e-05}
        and model.resolution == (Fraction("5e-05"),)
    )
    assert said["noise"]["lift"] + 5e-05 >= 1.25 * said["smallest"]["lift"]
    assert not any("multiple of" in hint for hint in jb.read("run.csv", model).hints)
    heat = np.loadtxt("run.csv", delimiter=",", skiprows=1)[:110, 1]
    assert tuple(map(float, model.ranges["heat"])) == (heat.min(), heat.max())
    assert said["widest"]["share"] == said["recordings"][0]["used"]
    assert said["recordings"][0]["windows"] == 106 and said["held_out"]["windows"] > 20
    assert model.provenance["model"] == "fitted to 110 samples in 1 recording", "10 of 120 are set aside"


def test_a_plain_command_chooses_what_is_tested(place, capsys, monkeypatch):
    monkeypatch.setattr(window_tests, "WINDOWS", (WindowChoice(4), WindowChoice(7)))
    command = [word.replace("horizon=4", "method=least squares") for word in FIT]
    assert main.main([*command, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [(test["name"], test["horizon"]) for test in said["tests"]] == [("5 samples", 4), ("8 samples", 7)]
    assert jb.load_model("tank.toml").horizon in (4, 7)


def test_time_stamps_without_separators_are_no_seconds(place, capsys):
    header, *rows = (place / "run.csv").read_text().splitlines()
    stamps = np.datetime64("2024-01-01T08:00", "h") + np.arange(len(rows))
    digits = [str(t).replace("-", "").replace("T", "").replace(":", "") + "0000" for t in stamps]
    assert digits[0] == "20240101080000"
    lines = [digit + row[row.index(",") :] for digit, row in zip(digits, rows, strict=True)]
    (place / "run.csv").write_text("\n".join([header, *lines, ""]))
    assert main.main(FIT) == 0
    assert jb.load_model("tank.toml").dt == 3600.0, "it was 10000"


def test_fit_writes_bounds_of_means(place, capsys):
    assert main.main([*FIT, "--recipe", "average=4", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    (one,) = jb.load_model("tank.toml").averages
    assert said["average"] == 4 == len(one.weights) and said["means"] == {"lift": float(one.bound)}
    assert said["smallest_mean"]["lift"] < float(one.bound) + 5e-05 < said["noise"]["lift"]
    assert main.main([*FIT, "--recipe", "average=4", "--force"]) == 0
    assert "mean of 4 samples of lift within" in capsys.readouterr().out


def test_fit_and_detect_agree_and_draw(place, capsys):
    assert main.main([*FIT, "--plot", "fit.png"]) == 0
    assert (place / "fit.png").read_bytes().startswith(b"\x89PNG")
    capsys.readouterr()
    assert main.main(["detect", "tank.toml", "run.csv", "--out", "report", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["counts"]["CONSISTENT"] == 106


def test_the_summary_names_bounds_shares_and_cautions(place, capsys):
    assert main.main([*FIT, "--recipe", "held_out=0"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    for text in (
        "tank: fitted to 1 recording",
        "run.csv 106 windows, ",
        "widest bounds run.csv, the window that ends at ",
        "safety 1.25 times these bounds",
        "caution nothing was left out",
        "10 of 120 samples are set aside",
    ):
        assert text in out, out


@pytest.mark.parametrize(
    "change, message",
    [
        (["--outputs", "T  in"], "run.csv: .*has no column 'T  in'"),
        (["--inputs", "heat=Heater (%),"], "--inputs needs names, or name=column or name=expression"),
        (["--recipe", "order=-1"], "order must be a whole number >= 0, or auto, not -1"),
        (["--recipe", "order=1,horizon=1"], r"horizon must be a whole number above the order \(1\), not 1"),
        (["--recipe", "order=1,safety=0.5"], "safety must be a factor >= 1"),
        (["--recipe", "order=1,held_out=1"], "held_out must be a share from 0 to below 1"),
        (["--where", "on == 7"], "run.csv: the condition 'on == 7' holds for none of its 120 samples"),
        (["--out", "no/tank.toml"], "--out no/tank.toml must be a file to write, in a folder that exists"),
        (
            ["--recipe", "order=1,horizon=300"],
            "too few samples: 110, in 1 recording, hold 0 complete windows of 301 samples",
        ),
    ],
)
def test_bad_input_is_one_sentence_and_writes_nothing(place, capsys, change, message):
    (place / "tank.toml").write_text("kept")
    args = FIT[:]
    if change[0] in args:
        args[args.index(change[0]) + 1] = change[1]
        change = []
    assert main.main([*args, *change, "--force"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and re.search(message, err) and err.count("\n") == 1, err
    assert (place / "tank.toml").read_text() == "kept" and sorted(p.name for p in place.iterdir()) == [
        "run.csv",
        "still.csv",
        "tank.toml",
    ]


def test_a_sensor_that_stands_still_is_named(place, capsys):
    assert (
        main.main(["fit", "still.csv", "--outputs", "T out", "--recipe", "horizon=4", "--out", "tank.toml"])
        == 2
    )
    assert "T out stands still in all recordings: nothing can be learnt of it" in capsys.readouterr().err


def test_a_number_for_a_missing_sample_is_refused_by_its_time(place, capsys):
    """Nothing is written; the condition that the sentence offers leaves the row out."""
    lines = (place / "run.csv").read_text().splitlines()
    cells = lines[41].split(",")
    lines[41] = ",".join([*cells[:3], "-999", cells[4]])
    (place / "run.csv").write_text("\n".join([*lines, ""]))
    assert main.main(FIT) == 2
    sentence = capsys.readouterr().err
    assert f"run.csv: {cells[0]}" in sentence or f"({float(cells[0]):g} s)" in sentence
    assert "lift is 10" in sentence and "in 1 of 110 samples" in sentence
    assert not (place / "tank.toml").exists()
    command = [*FIT]
    command[command.index("on == 1")] = re.findall('"([^"]+)"', sentence)[0]
    assert main.main(command) == 0
    assert float(jb.load_model("tank.toml").noise[0]) < 0.3


def test_a_fit_in_python_takes_paths(place):
    """As it takes what was read of them; without names of columns the sentence is the next call."""
    about = {"inputs": ["heat"], "outputs": ["lift"], "order": 1, "horizon": 4}
    columns = {"heat": "Heater (%)", "lift": "= `T out` - `T room`", "where": "on == 1"}
    model = jb.fit("run.csv", columns=columns, **about)
    (read,) = read_signals("run.csv", about["inputs"], about["outputs"], columns)
    assert model == jb.fit([read], columns=columns, **about) and model.dt == 2.0
    assert jb.fit([place / "run.csv"], columns=columns, **about) == model
    with pytest.raises(ValueError, match=r"run.csv is a file: .*, fit\('run.csv', inputs="):
        jb.fit("run.csv")
    with pytest.raises(FileNotFoundError, match="there is no data file gone.csv"):
        jb.fit("gone.csv", **about)


def test_signals_are_columns_or_expressions_with_names():
    assert signal_columns("--inputs", "a, b=2*a, c=arctan2(a, `d, e`), `d, e`, T1=Temperature 1, f=a==1") == [
        "a",
        ("b", "= 2*a"),
        ("c", "= arctan2(a, `d, e`)"),
        "d, e",
        ("T1", "Temperature 1"),
        ("f", "= a==1"),
    ]


def test_units_of_columns_reach_the_model_and_its_report(tmp_path, monkeypatch, capsys, rng):
    monkeypatch.chdir(tmp_path)
    true = jb.LinearSystem([["0.8"]], [[1]], [[1]], noise=0.1)
    u = rng.uniform(-1, 1, (200, 1))
    y = np.asarray(jb.simulate(true, u, jax.random.key(1)).y)
    rows = np.column_stack([np.arange(200), u, y])
    np.savetxt("run.csv", rows, delimiter=",", header="time,Pump (bar),T_room [degC]", comments="")
    files = [
        "run.csv",
        "--inputs",
        "Pump (bar)",
        "--outputs",
        "T_room [degC]",
        "--recipe",
        "order=1,horizon=3",
    ]
    assert main.main(["fit", *files, "--out", "m.toml"]) == 0
    assert "degC" in capsys.readouterr().out
    model = jb.load_model("m.toml")
    assert model.inputs + model.outputs == ("Pump", "T_room")
    assert dict(model.units) == {"Pump": "bar", "T_room": "degC"}
    assert model.column("T_room") == "T_room [degC]"
    assert main.main(["detect", "m.toml", "run.csv", "--out", "out"]) == 0
    assert "degC" in (tmp_path / "out/report.html").read_text()


@pytest.mark.long(
    by_day="studies/identification/test_fitting::test_bounds_are_those_at_which_it_follows_every_recording"
)
def test_bounds_for_an_observer(place, capsys):
    command = [word.replace("horizon=4", "observer=zonotope,method=least squares") for word in FIT]
    assert main.main(command) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "lasting jump always seen" in said and "`detect --test observer=zonotope`" in said
    assert jb.load_model("tank.toml").horizon is None
    observed = ["--test", "observer=zonotope"]
    assert main.main(["detect", "tank.toml", "run.csv", "--out", "report", *observed]) == 0
    assert main.main(["tune", "tank.toml", "run.csv", "--out", "tuned.toml", *observed]) == 0
    assert "for an observer" in jb.load_model("tuned.toml").provenance["noise"]
    capsys.readouterr()
    assert main.main([*command, "--force", "--recipe", "average=3"]) == 2
    assert "average is for windows" in capsys.readouterr().err


def test_fit_with_disturbances_says_what_is_seen_under_which_bounds(place, capsys):
    options = ["--recipe", "disturbances=auto,see=lift:drift:1,method=least squares"]
    assert main.main([*FIT, *options, "--plot", "fit.png", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    model = jb.load_model("tank.toml")
    assert said["disturbance"] == [float(high) for _, high in model.disturbance]
    assert [row["chosen"] for row in said["tradeoff"]].count(True) == 1
    assert "lift:drift" in said["tradeoff"][0]["sizes"]
    assert (place / "fit.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("see", "sentence"),
    [("lift:bias", "signal:kind:size"), ("lift:bend:1", "kind of fault"), ("flow:bias:1", "'flow'")],
)
def test_a_fault_to_see_that_is_none_is_refused(place, capsys, see, sentence):
    assert main.main([*FIT, "--recipe", f"disturbances=auto,see={see}"]) == 2
    assert sentence in capsys.readouterr().err
    assert not (place / "tank.toml").exists()


def test_a_recipe_says_what_options_said_and_a_model_file_repeats_it(place, capsys):
    at = FIT.index("--recipe")
    command = [*FIT[:at], *FIT[at + 2 :]]
    assert main.main([*command, "--recipe", "order=1,horizon=4"]) == 0
    assert "the next version" not in capsys.readouterr().out
    written = (place / "tank.toml").read_text()
    assert written.endswith("\n[fit]\norder = 1\nhorizon = 4\n")
    half = ["fit", "run.csv", "--recipe", "tank.toml", "--inputs", "nosuch", "--out", "none.toml"]
    assert main.main(half) == 2 and "--inputs without --outputs" in capsys.readouterr().err
    assert main.main(["fit", "run.csv", "--recipe", "tank.toml", "--out", "again.toml"]) == 0
    assert (place / "again.toml").read_text() == written
    old = ["--order", "1", "--horizon", "4", "--out", "old.toml", "--name", "tank"]
    assert main.main([*command, *old]) == 0
    assert capsys.readouterr().err.startswith(
        "jaxbound: --order, --horizon: the next version takes only --recipe order=1,horizon=4\n"
    )
    assert (place / "old.toml").read_text() == written
    assert main.main([*command, "--recipe", "order=1,height=4", "--force"]) == 2
    assert "fit has no height" in capsys.readouterr().err
    assert main.main([*command, "--recipe", "order=1,order=2", "--force"]) == 2
    assert "--recipe says order twice" in capsys.readouterr().err


def test_the_fields_of_a_recipe_are_those_of_the_command():
    recipe = [word.partition(":")[0].replace("-", "_") for word in fields.OLD["recipe"].split()]
    assert recipe == [field.name for field in dataclasses.fields(jb.Recipe)]
    assert list(inspect.signature(jb.fit).parameters)[-len(recipe) :] == recipe


def test_a_healthy_day_is_added_to_a_model_file(place, capsys):
    """Its comments, order and recipe stay; a day that is held leaves it as it is."""
    assert main.main(FIT) == 0
    model = place / "tank.toml"
    before = "# of the old tank\n" + model.read_text()
    model.write_text(before)
    header, *rows = (place / "run.csv").read_text().splitlines()
    cells = rows[60].split(",")
    rows[60] = ",".join([*cells[:2], f"{float(cells[2]) + 0.3:.4f}", *cells[3:]])
    (place / "monday.csv").write_text("\n".join([header, *rows, ""]))
    capsys.readouterr()
    assert main.main(["fit", "--add", "run.csv", "tank.toml"]) == 0
    assert model.read_text() == before
    assert "tank: its bounds hold, nothing changes" in capsys.readouterr().out
    assert main.main(["detect", "tank.toml", "monday.csv", "--out", "before"]) == 1
    capsys.readouterr()
    assert main.main(["fit", "--add", "monday.csv", "tank.toml", "--out", "wide.toml", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert model.read_text() == before and said["tests"]["windows"]["factor"] > 1
    assert said["sizes"]["after"]["jump"]["lift"] > said["sizes"]["before"]["jump"]["lift"]
    assert main.main(["fit", "--add", "monday.csv", "tank.toml"]) == 0
    out = capsys.readouterr().out
    assert "bounds up to" in out and "for monday.csv at" in out
    assert model.read_text() == (place / "wide.toml").read_text()
    lines = dict(zip(before.splitlines(), model.read_text().splitlines(), strict=True))
    changed = [line.split(" = ")[0] for line, now in lines.items() if line != now]
    assert changed == ["noise", "noise"], "the bound, and where it comes from"
    assert "; widened by monday.csv" in model.read_text()
    assert main.main(["detect", "tank.toml", "monday.csv", "--out", "after"]) == 0


@pytest.mark.parametrize(
    "options, sentence",
    [
        (["--add", "run.csv"], "--add needs one model file and recordings"),
        (["--add", "tank.toml"], "--add needs one model file and recordings"),
        (["--add", "run.csv", "tank.toml", "--where", "on == 1"], "--where is for a new model"),
        (["--add", "run.csv", "tank.toml", "--out", "tank.toml", "--force"], "an input is never an output"),
        (["run.csv", "--outputs", "on", "--out", "a.toml", "--most", "4"], "--most is for --add"),
        (["run.csv", "--outputs", "on"], "--out is needed"),
    ],
)
def test_what_does_not_go_with_add_is_refused(place, capsys, options, sentence):
    (place / "tank.toml").write_text("")
    assert main.main(["fit", *options]) == 2
    assert sentence in capsys.readouterr().err


def test_a_size_beyond_all_that_an_output_moved_is_none_to_expect():
    check = SimpleNamespace(moved={"T": 10.0, "SAT": 60.0, "F": 1.0})
    model = SimpleNamespace(outputs=("T", "SAT", "F"), check=check, unit={"T": "K", "SAT": "K", "F": ""}.get)
    said = fit_summary._each_size(model, {"T": 0.5, "SAT": 494.0, "F": np.inf})
    assert said == "T from 0.5 K, SAT beyond all that it moved, F beyond all that it moved"
