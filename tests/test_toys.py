"""A test of windows, an observer and a source that a user wrote go through every verb and every command."""

import contextlib
import csv
import io
import json
import os

import matplotlib.pyplot as plt
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from test_docs import ROOT, follow
from toys import MODEL, JsonLines, Spread, Steps, recorded

import jaxbound as jb
from jaxbound.cli.main import main
from jaxbound.consistency.interface import FAMILIES, family
from jaxbound.recordings import source as sources
from jaxbound.runs.ask import Ask
from jaxbound.runs.fleet import FleetTest, detect_fleet, read_manifest

TOYS = {"steps": Steps, "spread": Spread}


@pytest.fixture(autouse=True)
def registered():
    """Register the toys, and forget them again."""
    sources.register(JsonLines)
    for name, kind in TOYS.items():
        family(name)(lambda model, horizon, kind=kind: kind(model))
    yield
    sources.KINDS.remove(JsonLines)
    for name in TOYS:
        del FAMILIES[name]


@pytest.fixture(params=TOYS)
def toy(request):
    return TOYS[request.param](MODEL)


@pytest.fixture(params=TOYS)
def method(request):
    return request.param


@pytest.fixture
def folder(tmp_path):
    """Return a folder with a model and a recording as CSV, Parquet and JSON lines."""
    y = recorded()[:, 0]
    jb.save_model(MODEL, tmp_path / "model.toml")
    time = np.arange(len(y), dtype=float)
    cells = ["" if np.isnan(x) else repr(float(x)) for x in y]
    lines = "".join(f"{t:g},{x}\n" for t, x in zip(time, cells, strict=True))
    (tmp_path / "run.csv").write_text("time,y1\n" + lines)
    pq.write_table(pa.table({"time": time, "y1": pa.array(y, from_pandas=True)}), tmp_path / "run.parquet")
    rows = (json.dumps({"y1": None if np.isnan(x) else float(x)}) for x in y)
    (tmp_path / "run.jsonl").write_text("\n".join(rows))
    return tmp_path


def expected(toy):
    """Return the status that a toy gives the recording, by arithmetic of its own."""
    off = moves(toy)
    inside = jb.Status.CONSISTENT if isinstance(toy, Steps) else jb.Status.UNDECIDED
    return np.where(np.isnan(off), jb.Status.MISSING, np.where(off > 1, jb.Status.FAULT, inside))


def moves(toy):
    """Return the numbers that a toy hands over beside its verdicts."""
    y = recorded()[:, 0]
    if isinstance(toy, Steps):
        return np.abs(np.diff(y, prepend=np.nan))
    return np.append(np.nan, np.abs(y[1:] - y[0]))


def shell(*arguments):
    """Return (exit code, stdout, stderr) of a command."""
    out, err = io.BytesIO(), io.StringIO()
    with contextlib.redirect_stdout(io.TextIOWrapper(out, write_through=True)) as printed:
        with contextlib.redirect_stderr(err):
            code = main([str(x) for x in arguments])
        printed.flush()
    return code, out.getvalue().decode(), err.getvalue()


def test_detect(toy):
    res = jb.detect(toy, None, recorded())
    np.testing.assert_array_equal(res.status, expected(toy))
    assert res.alarms()[0].start == 30 and "FAULT" in repr(res) and res.hints is not None
    assert list(res.to_pandas().columns) == ["status", "margin", "suspect", "move"]
    np.testing.assert_allclose(res.columns["move"], moves(toy), atol=1e-6)


def test_detect_a_batch(toy):
    res = jb.detect(toy, None, np.stack([recorded(), recorded()[::-1]])[None])
    assert res.status.shape == (1, 2, 60) and res.margin.shape == res.status.shape
    np.testing.assert_array_equal(res.status[0, 0], expected(toy))


def test_a_gap(toy):
    status = jb.detect(toy, None, recorded(), starts=[30]).status
    assert jb.Status.FAULT not in status and status[30] == jb.Status.MISSING


def test_margins_are_refused_in_a_sentence(toy):
    with pytest.raises(NotImplementedError, match=r"detect\(.*\)\.margin has"):
        jb.margins(toy, None, recorded())


def test_a_monitor(toy):
    monitor = jb.Monitor(toy)
    state, found = monitor.init(), []
    for y in recorded():
        state, verdict = monitor.step(state, None, y)
        found.append((int(verdict.status), verdict.columns["move"]))
    status, move = np.transpose(found)
    np.testing.assert_array_equal(status, expected(toy))
    np.testing.assert_allclose(move, moves(toy), atol=1e-6)


@pytest.mark.parametrize("cut", [1, 20, 30, 45])
def test_a_monitor_of_pieces(toy, cut):
    monitor, y = jb.Monitor(toy), recorded()
    state, first = monitor.run(monitor.init(), None, y[:cut])
    _, second = monitor.run(state, None, y[cut:])
    np.testing.assert_array_equal(np.concatenate([first.status, second.status]), expected(toy))
    both = [first.columns["move"], second.columns["move"]]
    np.testing.assert_allclose(np.concatenate(both), moves(toy), atol=1e-6)


def test_parts(toy, folder):
    found = jb.detect_dataset(toy, folder / "run.parquet", folder / "out", method=toy.methods[0])
    kept = pq.read_table(folder / "out" / "verdicts.parquet")
    assert kept.column("status").to_pylist() == [jb.Status(s).name for s in expected(toy)]
    np.testing.assert_allclose(kept.column("move").to_numpy(), moves(toy), atol=1e-6)
    assert found.alarm_count == 1 and found.label(30) and repr(found)


def test_parts_of_what_has_no_name_are_refused(toy, folder):
    toy.made = None
    with pytest.raises(TypeError, match="whose verdicts can be kept, not"):
        jb.detect_dataset(toy, folder / "run.parquet", folder / "out")


def test_a_study(toy):
    found = jb.study(MODEL, "y1:bias", 40, 0, toy, sizes=[0.1, 20.0], samples=20, onset=10)
    assert found.tallies[0].detected[0] == 0 < found.tallies[0].detected[1]


def test_tune_is_refused_in_a_sentence(toy):
    with pytest.raises(TypeError, match="tune needs relations from parity_relations, not"):
        jb.tune(toy, None, recorded())


def test_explain_is_refused_in_a_sentence(toy):
    with pytest.raises(NotImplementedError, match="certificates are given for relations that detect knows"):
        jb.detect(toy, None, recorded()).explain(30)


def test_a_picture(toy):
    figure = jb.plot(jb.detect(toy, None, recorded()))
    assert figure.axes
    plt.close("all")


@pytest.mark.parametrize("data", ["run.csv", "run.parquet", "run.jsonl"])
def test_the_shell_detects_and_reports(method, folder, data):
    code, out, err = shell(
        "detect", folder / "model.toml", folder / data, "--method", method, "--out", folder / "out"
    )
    assert code == 1 and "FAULT" in out, err
    page = (folder / "out" / "report.html").read_text()
    assert "FAULT" in page and method in page and '"name": "move"' in page


def test_the_shell_judges_a_pipe(method, folder):
    before = os.dup(0)
    with (folder / "run.csv").open("rb") as given:
        os.dup2(given.fileno(), 0)
        try:
            code, out, err = shell(
                "detect", folder / "model.toml", "-", "--method", method, "--out", folder / "out"
            )
        finally:
            os.dup2(before, 0)
            os.close(before)
    assert code == 1, err
    rows = list(csv.DictReader((folder / "out" / "verdicts.csv").read_text().splitlines()))
    toy = TOYS[method](MODEL)
    assert [row["status"] for row in rows] == [jb.Status(s).name for s in expected(toy)]
    np.testing.assert_allclose([float(row["move"] or "nan") for row in rows], moves(toy), atol=1e-6)


def test_the_shell_refuses_to_explain_in_a_sentence(method, folder):
    about = folder / "model.toml", folder / "run.csv", "--method", method, "--out", folder / "out"
    shell("detect", *about)
    code, out, err = shell("explain", folder / "out", "--at", "30")
    assert code not in (0, 1) and "certificates are given for relations that detect knows" in err


@pytest.mark.parametrize("data", ["run.csv", "run.jsonl"])
def test_a_fleet(method, folder, data):
    rows = f"unit,model,recording\none,model.toml,{data}\ntwo,model.toml,{data}\n"
    (folder / "fleet.csv").write_text(rows)
    found = list(detect_fleet(read_manifest(folder / "fleet.csv"), FleetTest(Ask(method))))
    assert [unit.verdict for unit in found] == ["fault", "fault"]


def test_a_fleet_goes_on(method, folder):
    rows = "unit,model,recording\none,model.toml,run.csv\ntwo,model.toml,run.csv\n"
    (folder / "fleet.csv").write_text(rows)
    units = read_manifest(folder / "fleet.csv")
    how = FleetTest(Ask(method), state=folder / "state")
    first, again = (list(detect_fleet(units, how)) for _ in range(2))
    healthy = "".join(f"{t},0\n" for t in range(60, 80))
    (folder / "run.csv").write_text("time,y1\n" + healthy)
    after = list(detect_fleet(units, how))
    assert [unit.verdict for unit in (*first, *again)] == ["fault"] * 4
    counts = [unit.summary.counts for unit in after]
    assert counts[0] == counts[1] and sum(counts[0].values()) == 20 + 1
    assert counts[0]["FAULT"] == (1 if method == "steps" else 0)


def test_the_page_on_extending_runs_as_it_stands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = dict(FAMILIES)
    follow(ROOT / "docs" / "api" / "extending.md", tmp_path)
    assert set(FAMILIES) - set(before) == {"jumps"}
    FAMILIES.pop("jumps")


def test_the_shell_studies(method, folder):
    about = (
        "--method",
        method,
        "--faults",
        "y1:bias",
        "--sizes",
        "0.1,20",
        "--n",
        "20",
        "--scenario",
        "samples=20",
    )
    code, out, err = shell("study", folder / "model.toml", *about, "--out", folder / "out")
    assert code == 0, err
