"""`jaxbound tune`: from recordings to a model file, interrupted and taken up again, and refusals in one
sentence.
"""

import json

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.cli import tune_summary as tuned
from jaxbound.cli.main import main
from tests import tuning_case
from tests.interruptions import interrupted_descend
from tests.oracles import Plant
from tests.systems import PAPER, paper

pytestmark = pytest.mark.compiled


@pytest.fixture
def plant(tmp_path, rng):
    """Write a model with rough bounds, two healthy recordings, one of them with a gap, and a faulty one."""
    jb.save_model(
        paper(dt=1.0, tolerance=[0.05, 0.05], noise=[0.05, 0.05], name="rig"), tmp_path / "rig.toml"
    )
    exact = Plant(**{k: PAPER[k] for k in ("A", "B", "C", "tolerance", "noise")})
    for name, bias in (("a", 0), ("b", 0), ("f", 0.9)):
        u, y = tuning_case.recording(exact, 300, rng)
        time = np.arange(300) + (np.arange(300) >= 120) * 55 * (name == "b")
        rows = np.column_stack([time, u, y + [bias, 0]])
        np.savetxt(
            tmp_path / f"{name}.csv", rows, delimiter=",", header="time,u1,y1,y2", comments="", fmt="%.17g"
        )
    return tmp_path


def tune(plant, *options, healthy=("a.csv", "b.csv")):
    files = [str(plant / name) for name in healthy]
    return main(["tune", str(plant / "rig.toml"), *files, "--out", str(plant / "out.toml"), *options])


def test_writes_a_model_under_which_no_healthy_window_is_faulty(plant, capsys):
    assert (
        tune(
            plant,
            "--steps",
            "20",
            "--safety",
            "1.2",
            "--plot",
            str(plant / "p.png"),
            "--json",
            "--faulty",
            str(plant / "f.csv"),
        )
        == 0
    )
    said = json.loads(capsys.readouterr().out)
    assert (
        said["healthy"]["FAULT"] == said["healthy"]["UNDECIDED"] == 0
        and said["healthy"]["CONSISTENT"] == 299 + 298
    )
    assert (
        said["caught"] == said["faulty"]["FAULT"] / 299 > 0.5
        and said["safety"] == 1.2
        and "not counted" in said["risk"]["text"]
    )
    model = jb.load_model(plant / "out.toml")
    assert list(map(float, model.noise)) == pytest.approx(said["bounds"]["noise"]) and model.horizon == 1
    assert (
        model.provenance["noise"]
        == "fitted to 597 healthy windows, factor 1.07 of what was left out, safety factor 1.2"
    )
    assert len(said["left_out"]) == 2 and max(said["left_out"]) == said["factor"]
    assert float(model.left_out) == pytest.approx(said["factor"], rel=1e-3)
    assert (plant / "p.png").read_bytes().startswith(b"\x89PNG")
    assert (
        main(["detect", str(plant / "out.toml"), str(plant / "a.csv"), "--out", str(plant / "r"), "--json"])
        == 0
    )
    assert sorted(p.name for p in plant.iterdir() if p.name.startswith("out")) == ["out.toml"]


def test_prints_scale_safety_and_statement_apart(plant, capsys):
    assert tune(plant, "--steps", "0", "--bounds", "noise", healthy=["b.csv"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "tolerance of y1" not in out and "noise of y2" in out
    for words in (
        "scale ",
        "safety 1.25 times these bounds",
        "298 CONSISTENT",
        "If blocks of healthy operation are exchangeable",
        "gap of 56 s",
    ):
        assert words in out


def test_interrupted_writes_the_best_and_goes_on(plant, capsys, monkeypatch):
    options = ("--steps", "20", "--json")
    assert tune(plant, *options) == 0
    whole = json.loads(capsys.readouterr().out)
    (plant / "out.toml").unlink()
    with monkeypatch.context() as patch:
        interrupted_descend(patch)
        assert tune(plant, *options) == 130
    said = capsys.readouterr()
    assert json.loads(said.out)["steps"] == 10 and "the same command goes on" in said.err
    assert (
        jb.load_model(plant / "out.toml").provenance["noise"].startswith("fitted")
        and (plant / "out.toml.state.npz").exists()
    )
    assert tune(plant, *options) == 0
    assert json.loads(capsys.readouterr().out)["smallest"] == whole["smallest"]
    assert not (plant / "out.toml.state.npz").exists()


WRONG = [
    (("--bounds", "noises"), "there is no bound 'noises' to move"),
    (("--optimizer", "newton"), "--optimizer must be one of adam"),
    (("--safety", "0.5"), "factor >= 1"),
    (("--safety", "x"), "--safety invalid decimal value"),
    (("--steps", "-3"), "--steps needs a whole"),
    (("--faulty", "a.csv"), "faulty recording 1 is the same as healthy recording 1"),
    (("--out", "no/where.toml"), "in a folder that exists"),
    (("--faulty", "none.csv"), "there is no data file"),
]


@pytest.mark.parametrize("options, sentence", WRONG)
def test_refuses_in_one_sentence_and_writes_nothing(plant, options, sentence, capsys, monkeypatch):
    monkeypatch.chdir(plant)
    assert tune(plant, *options) == 2
    said = capsys.readouterr().err
    assert sentence in said.replace("\n", " ") and said.startswith("jaxbound: ")
    assert not [p for p in plant.iterdir() if p.name.startswith("out")]


def test_a_number_for_a_missing_sample_is_refused_by_its_time(plant, capsys):
    lines = (plant / "a.csv").read_text().splitlines()
    for k in (80, 200):
        cells = lines[k + 1].split(",")
        lines[k + 1] = ",".join([*cells[:2], "-999", cells[3]])
    (plant / "a.csv").write_text("\n".join([*lines, ""]))
    assert tune(plant, "--steps", "0") == 2
    sentence = capsys.readouterr().err
    assert "y1 is -999 in 2 of 600 samples" in sentence and '"y1 != -999"' in sentence
    assert not (plant / "out.toml").exists()
    model = (plant / "rig.toml").read_text()
    (plant / "rig.toml").write_text(f'where = "y1 != -999"\n{model}')
    assert tune(plant, "--steps", "0") == 0


def test_optimisers_are_those_of_optax():
    import optax

    assert all(callable(getattr(optax, name)) for name in tuned.OPTIMIZERS)


WRITTEN = """# Rig of the cellar, measured on 3 March.
name = "rig"
dt = 1.0   # s, as the logger says

[[inputs]]
name = "u1"

[[outputs]]
noise = 0.05      # data sheet of the upper sensor
tolerance = 0.05
name = "y1"  # above

# The lower one was replaced in May.
[[outputs]]
name = "y2"
tolerance = 0.05
noise = "1/20"

[provenance]
noise = "data sheet"

[matrices]
A = [[0.8, 1], [0, "1/5"]]  # heat flows
B = [[0], [1]]
C = [
  [1, 0],
  [1, 1],
]
"""


def test_comments_order_and_spacing_of_a_model_file_stay(plant, capsys):
    (plant / "rig.toml").write_text(WRITTEN)
    assert tune(plant, "--steps", "0", "--bounds", "noise") == 0
    old, new = WRITTEN.splitlines(), (plant / "out.toml").read_text().splitlines()
    assert [line for line in old if line not in new] == [
        "noise = 0.05      # data sheet of the upper sensor",
        'noise = "1/20"',
        'noise = "data sheet"',
    ]
    assert any(line.endswith("# data sheet of the upper sensor") for line in new)
    assert [line for line in new if line in old] == [line for line in old if line in new]
    model = jb.load_model(plant / "out.toml")
    assert model.provenance["noise"].startswith("fitted")
    assert model.tolerance == jb.load_model(plant / "rig.toml").tolerance


def test_windows_that_an_option_asks_for_stand_above_the_tables(plant, capsys):
    (plant / "rig.toml").write_text(WRITTEN)
    assert tune(plant, "--steps", "0", "--test", "lags=0,1,3") == 0
    assert jb.load_model(plant / "out.toml").lags == (0, 1, 3)
    text = (plant / "out.toml").read_text()
    assert text.startswith("# Rig of the cellar") and text.index("lags") < text.index("[[inputs]]")
