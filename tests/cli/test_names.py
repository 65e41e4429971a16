"""Names as plants have them, with colons, commas, equal signs, blanks and brackets: by every door."""

import json

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.cli.fit_summary import signal_columns
from jaxbound.cli.names import parted

VALVE, HEATER, SUPPLY, MODE = "AHU: Valve, Signal", "Q1=Heater 1", "AHU: Supply Air [degC]", "Mode (on/off)"


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    """Return a folder with recordings of such names, and a model fitted to them by the shell."""
    path = tmp_path_factory.mktemp("names")
    for seed, name in enumerate(("a.csv", "b.csv", "faulty.csv")):
        rng = np.random.default_rng(seed)
        u, q = (np.repeat(rng.integers(0, 3, 30), 8).astype(float) for _ in range(2))
        x = np.zeros(240)
        for k in range(1, 240):
            x[k] = 0.8 * x[k - 1] + u[k - 1] + 0.5 * q[k - 1]
        x += rng.uniform(-0.05, 0.05, 240) + 3 * ((seed == 2) & (np.arange(240) > 160))
        time = pd.date_range("2024-03-01", periods=240, freq="min")
        frame = pd.DataFrame({"time": time, VALVE: u, HEATER: q, SUPPLY: x, MODE: (np.arange(240) > 20) * 1})
        frame.to_csv(path / name, index=False)
    signals = ["--inputs", f"`{VALVE}`,`{HEATER}`", "--outputs", SUPPLY, "--where", f"`{MODE}` == 1"]
    files = [str(path / "a.csv"), str(path / "b.csv")]
    assert (
        main.main(["fit", *files, *signals, "--recipe", "horizon=6", "--out", str(path / "m.toml"), "-q"])
        == 0
    )
    return path


def run(capsys, *words):
    """Return (exit code, standard output, standard error) of a command."""
    code = main.main([str(word) for word in words])
    return code, *capsys.readouterr()


def test_the_model_has_the_names_and_reads_itself(plant):
    model = jb.load_model(plant / "m.toml")
    assert model.inputs == (VALVE, HEATER) and model.outputs == ("AHU: Supply Air",)
    assert model.column("AHU: Supply Air") == SUPPLY and model.unit("AHU: Supply Air") == "degC"


def test_detect_explain_and_verify(plant, capsys):
    out = plant / "out"
    assert run(capsys, "detect", plant / "m.toml", plant / "faulty.csv", "--out", out, "--json")[0] == 1
    worst = pd.read_csv(out / "alarms.csv")["worst"][0]
    assert "] + ... = 0" in run(capsys, "explain", out, "--at", worst)[1].replace("\n" + 32 * " ", " ")
    code, text, _ = run(capsys, "explain", out, "--at", worst, "--all")
    assert code == 0 and f"{HEATER}[k-" in text and "AHU: Supply Air wrong?" in text
    (proof,) = out.glob("certificate-*.json")
    assert json.loads(proof.read_text())["certificate"] == "FAULT"
    words = "verify", proof, "--model", plant / "m.toml", "--data", plant / "faulty.csv"
    assert run(capsys, *words)[0] == 0
    page = (out / "report.html").read_text()
    assert "AHU: Supply Air" in page and "AHU: Valve, Signal" in page


@pytest.mark.parametrize("method", ["observer", pytest.param("validation", marks=pytest.mark.long)])
def test_other_methods(plant, capsys, method):
    words = "detect", plant / "m.toml", plant / "faulty.csv", "--out", plant / method, "--method", method
    code, out, err = run(capsys, *words)
    assert code in (1, 3) and not err
    if method == "validation":
        assert "faulty: AHU: Supply Air" in out


@pytest.mark.parametrize(
    ("faults", "signals"),
    [
        ("AHU: Supply Air:bias", ["AHU: Supply Air"]),
        ("AHU: Supply Air", ["AHU: Supply Air"]),
        (f"`{VALVE}`:bias,{HEATER}:gain", [VALVE, HEATER]),
        (f'"{VALVE}:bias",`{HEATER}`:drift', [VALVE, HEATER]),
    ],
)
def test_faults_of_a_study(plant, capsys, faults, signals):
    words = [
        "study",
        plant / "m.toml",
        "--faults",
        faults,
        "--sizes",
        "1",
        "--n",
        "8",
        "--scenario",
        "samples=40",
    ]
    code, _, err = run(capsys, *words, "--out", plant / f"study {len(faults)}", "--json")
    assert code == 0, err
    summary = pd.read_csv(plant / f"study {len(faults)}" / "summary.csv")
    assert [fault.rpartition(":")[0] for fault in summary["fault"]] == signals


def test_tune_and_info(plant, capsys):
    words = "tune", plant / "m.toml", plant / "a.csv", "--out", plant / "t.toml", "--steps", "0"
    code, out, _ = run(capsys, *words)
    assert code == 0 and "noise of AHU: Supply Air" in out
    assert run(capsys, "info", plant / "m.toml")[0] == 0


@pytest.mark.parametrize(
    ("text", "signals"),
    [
        (f"`{VALVE}`,`{HEATER}`", [VALVE, HEATER]),
        (f'"{VALVE}","{HEATER}"', [VALVE, HEATER]),
        (f"v=`{VALVE}`,q={HEATER}", [("v", VALVE), ("q", HEATER)]),
        (f'v="{VALVE}", q = "{HEATER}"', [("v", VALVE), ("q", HEATER)]),
        (f"v=2*`{VALVE}`+arctan2(a, b),q", [("v", f"= 2*`{VALVE}`+arctan2(a, b)"), "q"]),
        ("AHU: Supply,b (c, d),e", ["AHU: Supply", "b (c, d)", "e"]),
        ('b,a 5" pipe,c', ["b", 'a 5" pipe', "c"]),
        (f"x=arctan2(a, `{VALVE}`),`{MODE}`,b", [("x", f"= arctan2(a, `{VALVE}`)"), MODE, "b"]),
        ("x=mode == 'on',y", [("x", "= mode == 'on'"), "y"]),
    ],
)
def test_signals_of_an_option(text, signals):
    assert signal_columns("--inputs", text) == signals


@pytest.mark.parametrize(
    ("inputs", "sentence"),
    [
        (
            VALVE,
            f"has no column 'AHU: Valve'; did you mean {VALVE!r}? In the shell a name with a comma or an ",
        ),
        (
            HEATER,
            f"has no column 'Heater 1'; did you mean {HEATER!r}? In the shell a name with a comma or an ",
        ),
        (f"v={VALVE}", "equal sign stands in backticks."),
    ],
)
def test_a_name_that_is_torn_apart_is_said(plant, capsys, inputs, sentence):
    words = "fit", plant / "a.csv", "--inputs", inputs, "--outputs", SUPPLY, "--out", plant / "x.toml"
    code, _, err = run(capsys, *words)
    assert code == 2 and sentence in err and err.count("\n") == 1


def test_a_condition_without_backticks_is_said(plant, capsys):
    words = "fit", plant / "a.csv", "--outputs", SUPPLY, "--out", plant / "x.toml", "--where", f"{MODE} == 1"
    code, _, err = run(capsys, *words)
    assert code == 2 and "names with brackets, points or other signs stand in backticks" in err


def test_python_takes_names_as_they_are(plant):
    frames = [pd.read_csv(plant / name, parse_dates=["time"]) for name in ("a.csv", "b.csv")]
    model = jb.fit(
        frames, inputs=[VALVE, HEATER], outputs=SUPPLY, horizon=6, columns={"where": f"`{MODE}` > 0"}
    )
    res = jb.detect(jb.parity_relations(model), jb.read(plant / "faulty.csv", model))
    assert res.counts["FAULT"] and SUPPLY in str(res.explain(res.worst[0]))


def test_entries_are_parted_at_commas_outside_of_names():
    assert parted("a,`b,c`,f(x, y)") == ["a", "`b,c`", "f(x, y)"]
