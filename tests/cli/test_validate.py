"""`jaxbound detect --method validation`: columns and verdict; what it refuses."""

import json

import numpy as np
import pytest
from validated_case import MODEL, Status, found_in, recording_of

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.runs.summary import summarised
from jaxbound.runs.verdictfiles import write_verdicts


@pytest.fixture(autouse=True)
def unconfigured(monkeypatch, tmp_path_factory):
    """Leave jax's configuration as conftest set it; keep tracebacks of internal errors out of the way."""
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.setattr(main.tempfile, "tempdir", str(tmp_path_factory.mktemp("temp")))


def record(T=40, faulty=()):
    x = 2 * (1 - 0.5 ** np.arange(T))
    y = np.stack([x, 2 * x], 1)
    y[list(faulty), 0] += 3
    return np.ones((T, 1)), y


@pytest.fixture
def place(tmp_path):
    """Return a function of (lines dropped, faulty) that writes model and recording and returns their
    paths.
    """
    jb.save_model(MODEL, tmp_path / "model.toml")

    def write(faulty=(), drop=(), blank=()):
        u, y = record(faulty=faulty)
        text = [[str(v) for v in (k, u[k, 0], *y[k])] for k in range(len(u))]
        for k, column in blank:
            text[k][column] = ""
        rows = [",".join(row) for k, row in enumerate(text) if k not in drop]
        (tmp_path / "run.csv").write_text("\n".join(["t,u1,y1,y2", *rows, ""]))
        return [str(tmp_path / "model.toml"), str(tmp_path / "run.csv"), "--out", str(tmp_path / "out")]

    return write


LABEL = "{} s".format


class TestVerdict:
    def test_a_fault_names_the_sensor_and_the_first_window(self):
        res = found_in()
        found = summarised(res, res.alarms(), LABEL, 0.5)
        verdict, sentence = found.verdict, found.sentence
        assert (
            verdict == "fault"
            and "4 of 59 windows (6.78 %)" in sentence
            and "in 2 alarms; the first FAULT is at 20 s" in sentence
        )
        assert sentence.endswith("faulty: y1 in 4 samples.")
        assert res.stretches() == [(0, 20, 22), (0, 40, 40)] and res.blamed == {"y1": 4}

    @pytest.mark.parametrize(
        ("missing", "verdict"),
        [(0, "no fault"), (29, "no fault"), (31, "too little evidence"), (59, "too little evidence")],
    )
    def test_evidence_is_the_share_of_windows_with_data(self, missing, verdict):
        res = found_in(faulty=(), missing=missing)
        summary = summarised(res, [], LABEL, 0.5)
        assert summary.verdict == verdict and abs(summary.found.tested - (59 - missing) / 59) < 1e-12

    def test_a_model_that_never_fits_is_said_to(self):
        res = found_in(faulty=range(1, 60))
        assert "do not fit this recording" in summarised(res, res.alarms(), LABEL, 0.5).sentence

    def test_one_window_cannot_be_explained(self):
        with pytest.raises(NotImplementedError, match="rests on all samples"):
            found_in().explain(20)


class TestFiles:
    def test_columns_hold_every_bound_to_the_last_digit(self, tmp_path):
        res = found_in()
        write_verdicts(tmp_path / "v.csv", res, recording_of(res))
        head, *lines = (tmp_path / "v.csv").read_text().splitlines()
        columns = dict(
            zip(head.split(","), zip(*(line.split(",") for line in lines), strict=True), strict=True)
        )
        assert list(columns)[:8] == [
            "time",
            "status",
            "faulty.y1",
            "output.y1.lo",
            "output.y1.hi",
            "corrected.y1",
            "corrected.y1.lo",
            "corrected.y1.hi",
        ]
        assert (
            list(columns)[-2:] == ["state.x1.lo", "state.x1.hi"]
            and columns["status"][0] == "MISSING"
            and columns["output.y2.hi"][0] == ""
        )
        for name, x in (
            ("output.y2.hi", res.found.output.hi[:, 1]),
            ("corrected.y1.lo", res.found.corrected.lo[:, 0]),
        ):
            np.testing.assert_array_equal(np.array(columns[name][1:], float), x[1:])
        assert set(columns["corrected.y1"][1:]) == {"1"} or {
            float(c) for c in columns["corrected.y1"][1:]
        } == {1.0}
        assert [k for k, v in enumerate(columns["faulty.y1"]) if v == "true"] == [20, 21, 22, 40]


@pytest.mark.parametrize(
    ("recording", "options", "says"),
    [
        ({}, ("--chunk", "70000"), "--chunk is for other methods"),
        ({}, ("--test", "horizon=0"), "horizon must be a whole number >= 1"),
        ({"blank": [(0, 2)]}, (), "y1 is missing at 0 s, and for validation the first 2 samples say"),
        (
            {"blank": [(9, 1)]},
            (),
            "u1 is missing at 9 s, and for validation every sample of every input is needed",
        ),
    ],
)
def test_bad_input_gets_a_sentence(place, capsys, recording, options, says):
    assert main.main(["detect", *place(**recording), "--method", "validation", *options]) == 2
    out, err = capsys.readouterr()
    assert out == "" and says in " ".join(err.split()) and err.count("jaxbound:") == 1


def test_the_shell_validates_across_a_gap_and_an_excluded_stretch_as_python_does(place, capsys, tmp_path):
    model, run, *rest = place(drop=(10, 11))
    plant = dict(A=[["0.5"]], B=[[1]], C=[[1], [2]], noise="0.1", uncertainties=MODEL.uncertainties)
    jb.save_model(jb.LinearSystem(**plant, columns={"where": "t < 25 or t > 28"}), model)
    assert main.main(["detect", model, run, *rest, "--method", "validation", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    status = np.asarray(jb.validate(loaded := jb.load_model(model), jb.read(run, loaded)).status)
    assert (
        found["counts"] == {s.name: int((status == s).sum()) for s in Status}
        and found["counts"]["MISSING"] == 1 + 1 + 4 + 1
    )
    rows = (tmp_path / "out" / "verdicts.csv").read_text().splitlines()[1:]
    assert [row.split(",")[1] for row in rows] == [Status(s).name for s in status]
    assert any("gap of 3 s" in h for h in found["hints"]) and any(
        "behind each gap" in h for h in found["hints"]
    )
    assert found["summary"] == (
        "No fault proved: every sample of 31 windows fits what the samples before it allow; a fault that "
        "grows slowly may hide, which "
        "windows (no --method) may show."
    )


def test_other_commands_name_what_they_can_do(place, capsys, tmp_path):
    assert main.main(["detect", *place(), "--method", "validate"]) == 2
    assert "windows, box, observer, validation, not 'validate'" in " ".join(capsys.readouterr().err.split())
    (tmp_path / "fleet.csv").write_text("name,model,recording\na,model.toml,run.csv\n")
    assert (
        main.main(
            ["fleet", str(tmp_path / "fleet.csv"), "--out", str(tmp_path / "f"), "--method", "validation"]
        )
        == 2
    )


def test_a_recording_from_the_shell(place, capsys, tmp_path):
    """One compiled shape for all: no fault is 0, a fault is 1, the columns are those of the library, no
    certificate is invented.
    """
    assert main.main(["detect", *place(), "--method", "validation"]) == 0
    assert capsys.readouterr().out.startswith("No fault proved: every sample of 39 windows")
    assert main.main(["detect", *place(faulty=range(20, 25)), "--method", "validation", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert (
        found["verdict"] == "fault"
        and found["faulty"] == {"y1": 5}
        and found["horizon"] == 1
        and found["counts"]["FAULT"] == 5
    )
    files = {"verdicts.csv", "alarms.csv", "report.html", "run.json", "tested_model.toml", ".jaxbound.json"}
    assert {f.name for f in (tmp_path / "out").iterdir()} == files
    u, y = record(faulty=range(20, 25))
    library = jb.validate(MODEL, u, y)
    written = np.genfromtxt(
        tmp_path / "out/verdicts.csv", delimiter=",", names=True, deletechars="", replace_space=" "
    )
    for column, x in (
        ("state.x1.hi", library.state.hi[:, 0]),
        ("corrected.y1.lo", library.corrected.lo[:, 0]),
    ):
        np.testing.assert_array_equal(written[column][1:], np.asarray(x)[1:])
    assert main.main(["explain", str(tmp_path / "out"), "--at", "20"]) == 2
    assert "was validated" in " ".join(capsys.readouterr().err.split())


def test_validation_by_bounds_for_shorter_windows_proves_no_fault(place, tmp_path, capsys):
    """It carries a box from the first sample on; and from the first FAULT on it says what the bands mean."""
    arguments = place(faulty=(20, 21))
    jb.save_model(
        MODEL.replace(horizon=3, provenance={"noise": "fitted to 2 recordings"}), tmp_path / "model.toml"
    )
    assert main.main(["detect", *arguments, "--method", "validation", "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert found["verdict"] == "outside the bounds as fitted" and found["summary"].startswith(
        "Outside the bounds as fitted: "
    )
    for said in (
        "validation looks back on all samples",
        "from 20 s on, the first FAULT, bands hold the true values only if",
    ):
        assert any(said in hint for hint in found["hints"])
