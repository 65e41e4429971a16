"""Sources: every kind gives the same recording, in one piece or in many, and a new kind is one small
class.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.recordings.read import kind_of, open_source
from jaxbound.recordings.source import KINDS, Source, register

T, GAP = 40, 17
MODEL = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1, columns={"where": "mode == 'on'"})
TIME = pd.date_range("2024-01-01", periods=T, freq="s") + pd.to_timedelta(
    np.where(np.arange(T) < GAP, 0, 60), "s"
)


def table():
    """Return a recording with a gap, an excluded stretch, a missing sample and a fault."""
    u, x = np.sin(np.arange(T)), np.zeros(T)
    for k in range(1, T):
        x[k] = 0.5 * x[k - 1] + u[k - 1]
    y = np.where(np.arange(T) == 30, x + 5, x)
    y[35] = np.nan
    return pd.DataFrame(
        {"time": TIME, "u1": u, "y1": y, "mode": np.where(np.isin(np.arange(T), [5, 6, 7]), "off", "on")}
    )


class JsonLines(Source):
    """A line of JSON a sample."""

    @classmethod
    def takes(cls, data):
        return str(data).endswith(".jsonl")

    def whole(self, progress=None):
        rows = [json.loads(line) for line in Path(self.data).read_text().splitlines()]
        found = pd.DataFrame(rows)
        return jb.Recording.of(self.model, found.assign(time=pd.to_datetime(found["time"])))


@pytest.fixture
def lines():
    register(JsonLines)
    yield
    KINDS.remove(JsonLines)


@pytest.fixture(params=["csv", "parquet", "folder", "arrays", "jsonl"])
def source(request, tmp_path, lines):
    frame = table()
    if request.param == "arrays":
        return open_source(frame, MODEL)
    path = tmp_path / f"run.{request.param}"
    if request.param == "csv":
        frame.to_csv(path, index=False)
    elif request.param == "parquet":
        frame.to_parquet(path)
    elif request.param == "folder":
        path.mkdir()
        frame[:13].to_parquet(path / "a.parquet")
        frame[13:].to_parquet(path / "b.parquet")
    else:
        path.write_text(frame.to_json(orient="records", lines=True, date_format="iso", double_precision=15))
    return open_source(path, MODEL)


def test_every_kind_of_source_gives_one_recording(source):
    r, expected = source.read(), jb.Recording.of(MODEL, table())
    np.testing.assert_allclose(r.y, expected.y, rtol=0, atol=1e-14)
    np.testing.assert_allclose(r.u, expected.u, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(r.starts, [5, 8, GAP])
    np.testing.assert_array_equal(r.stamps, TIME.to_numpy())
    assert (
        r.excluded.nonzero()[0].tolist() == [5, 6, 7]
        and source.samples == T
        and r.label(GAP) == "2024-01-01 00:01:17"
    )
    assert str(r.column[GAP].as_py())[:19] == "2024-01-01 00:01:17"


@pytest.mark.parametrize(
    ("size", "overlap", "first", "stop"), [(7, 2, 0, T), (T, 3, 0, T), (5, 0, 4, 33), (3, 4, 10, 20)]
)
def test_pieces_are_the_whole_cut_behind_their_overlap(source, size, overlap, first, stop):
    whole, at = source.read(), first
    for begin, piece in source.pieces(size, overlap, first, stop):
        assert begin == max(at - overlap, first) and begin + piece.samples == min(at + size, stop)
        expected, reach = whole.cut(begin, begin + piece.samples), slice(1, None)
        for name in ("u", "y", "stamps", "excluded"):
            np.testing.assert_array_equal(getattr(piece, name), getattr(expected, name))
        np.testing.assert_array_equal(piece.across(1)[reach], expected.across(1)[reach])
        at = begin + piece.samples
    assert at == stop


def test_a_source_knows_whether_its_data_are_the_same(source, tmp_path):
    if str(source.data if hasattr(source, "data") else source.path).startswith(str(tmp_path)):
        path = next(p for p in tmp_path.rglob("*") if p.is_file())
        before, kind = source.content, type(source)
        path.write_bytes(path.read_bytes()[:-1] + b"x")
        assert (
            len(before) == 64
            and kind.digest(source.data if hasattr(source, "data") else source.path) != before
        )
    else:
        assert source.content is None


def test_a_new_source_is_one_small_class_for_python_and_the_shell(lines, tmp_path, capsys):
    path, model, out = tmp_path / "run.jsonl", tmp_path / "m.toml", tmp_path / "out"
    path.write_text(table().to_json(orient="records", lines=True, date_format="iso", double_precision=15))
    jb.save_model(MODEL, model)
    res = jb.detect(jb.parity_relations(MODEL), jb.read(path, MODEL))
    assert np.flatnonzero(res.status == jb.Status.FAULT).tolist() == [30, 31]
    assert main.main(["detect", str(model), str(path), "--out", str(out), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["counts"] == res.counts
    rows = (out / "verdicts.csv").read_text().splitlines()[1:]
    assert [row.split(",")[1] for row in rows] == [jb.Status(s).name for s in res.status]
    assert main.main(["explain", str(out), "--at", "2024-01-01 00:01:30"]) == 0
    assert "FAULT proved" in capsys.readouterr().out


@pytest.mark.parametrize("first", ["parquet", "csvfiles", "read"])
def test_what_takes_any_path_is_asked_last_whatever_is_imported_first(first, tmp_path):
    table().to_parquet(tmp_path / "run.parquet")
    asked = f"kind_of({str(tmp_path / 'run.parquet')!r})"
    code = f"import jaxbound.recordings.{first}; from jaxbound.recordings.read import kind_of; print({asked})"
    assert (
        "ParquetSource"
        in subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    )


def test_the_kind_registered_last_takes_the_data(lines, tmp_path):
    (tmp_path / "run.jsonl").touch()
    assert kind_of(tmp_path / "run.jsonl") is JsonLines
    KINDS.remove(JsonLines)
    assert kind_of(tmp_path / "run.jsonl").__name__ == "CsvFile"
    register(JsonLines)


@pytest.mark.parametrize("family", [jb.parity_relations, jb.observer, jb.monitor])
def test_what_is_built_of_a_model_reads_its_signals(tmp_path, family):
    model = MODEL.replace(tests=[{"name": "one", "horizon": 1}])
    path = tmp_path / "run.csv"
    table().to_csv(path, index=False)
    mine, whole = jb.read(path, family(model)), jb.read(path, MODEL)
    assert np.array_equal(mine.y, whole.y, equal_nan=True) and np.array_equal(mine.starts, whole.starts)
