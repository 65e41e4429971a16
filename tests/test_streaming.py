"""Recordings larger than memory: the verdicts of one piece, whatever the chunks, and again after any interruption."""

import functools
import json
import re
import shutil
import signal
import subprocess
import sys
import time

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from systems import paper

import jaxbound as jb
from jaxbound import cli, detecting, parquet, streaming
from jaxbound.digest import detect_dataset, digest
from jaxbound.files import read_recording, write_alarms
from jaxbound.models.stillness import Runs, follow
from jaxbound.parquet import open_parquet
from jaxbound.plots import Timeline
from jaxbound.report import worst
from jaxbound.streaming import part_files, publish, read_runs, write_parts

N = 6000
MODELS = {
    "section 5": lambda: (paper(), None, "joint"),
    "box": lambda: (paper(), 2, "box"),
    "long windows": lambda: (paper(), 20, "joint"),
    "disturbance": lambda: (paper(disturbance=([[1], [0]], [0.01])), 3, "joint"),
}


@functools.cache
def simulated():
    """Return (u, y): N samples of the paper's plant with two faults."""
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, (N // 20, 1)), 20, 0)
    faults = [jb.Fault("y1", "bias", 0.4, 1500, 2600), jb.Fault("y2", "bias", -1.0, 4990, 5010)]
    return u, np.asarray(jb.simulate(paper(), u, jax.random.key(0), faults=faults).y)


def recording(dtype=np.float64, holes=60):
    """Return (t, u, y): N samples with two faults, a stuck sensor, missing samples, a gap and a clock that goes back."""
    rng = np.random.default_rng(0)
    u, y = map(np.array, simulated())
    y[700:800, 0] = y[700, 0]
    y[rng.integers(0, N, holes), rng.integers(0, 2, holes)] = np.nan
    u[rng.integers(0, N, holes // 6)] = np.nan
    t = 0.01 * np.arange(N)
    t[3000:] += 1.0
    t[4000:] -= 0.5
    return t, u.astype(dtype), y.astype(dtype)


def write(folder, t, u, y, cuts=(1000, 1003, 4500), groups=700):
    """Write a recording as files that end at `cuts`."""
    folder.mkdir(parents=True)
    for i, (a, b) in enumerate(zip((0, *cuts), (*cuts, N), strict=True)):
        columns = {"t": t[a:b], "u1": u[a:b, 0], "y1": y[a:b, 0], "y2": y[a:b, 1]}
        pq.write_table(
            pa.table({k: pa.array(x, from_pandas=True) for k, x in columns.items()}), folder / f"{i}.parquet", row_group_size=groups
        )
    return folder


def verdicts(out):
    """Return (status, margin) of the verdicts in a folder."""
    table = pq.read_table(out / "verdicts.parquet")
    status = np.array([jb.Status[name] for name in table["status"].to_pylist()], np.int8)
    return status, table["margin"].to_numpy()


@pytest.fixture
def small(monkeypatch):
    """Make parts of 1024 samples and let chunks be of any size."""
    monkeypatch.setattr(streaming, "PART", 1024)
    monkeypatch.setattr(streaming, "LEAST", 1)


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Return a function that gives (relations, folder of Parquet, Result in one piece, Recording) of a model; each is made once."""
    made = {}

    def get(name, dtype=np.float64):
        if (name, dtype) not in made:
            model, horizon, method = MODELS[name]()
            r = jb.parity_relations(model, horizon)
            folder = write(tmp_path_factory.mktemp("data") / "run", *recording(dtype, 2 if horizon == 20 else 60))
            whole = read_recording(folder, model)
            made[name, dtype] = r, folder, jb.detect(r, whole.u, whole.y, method=method, starts=whole.starts), whole
        return made[name, dtype]

    return get


class TestSameVerdicts:
    @pytest.mark.parametrize("name", MODELS)
    def test_one_piece_has_something_to_compare(self, case, name):
        whole = case(name)[2]
        expected = {jb.Status.MISSING, jb.Status.FAULT, jb.Status.UNDECIDED if whole.method == "box" else jb.Status.CONSISTENT}
        assert expected <= set(whole.status)

    @pytest.mark.parametrize("name", MODELS)
    def test_whatever_the_chunks(self, case, name, small, tmp_path, rng):
        r, folder, whole, _ = case(name)
        for chunk in (int(rng.integers(150, 500)), 1000, N) if name == "section 5" else (int(rng.integers(700, 2000)),):
            found = detect_dataset(r, folder, tmp_path / str(chunk), method=whole.method, chunk=chunk)
            status, margin = verdicts(tmp_path / str(chunk))
            assert status.tobytes() == whole.status.tobytes() and found.counts == whole.counts
            np.testing.assert_array_equal(margin, whole.margin)

    def test_float32(self, case, small, tmp_path):
        r, folder, whole, _ = case("section 5", np.float32)
        assert whole.margin.dtype == np.float32
        detect_dataset(r, folder, tmp_path / "out", chunk=333)
        status, margin = verdicts(tmp_path / "out")
        np.testing.assert_array_equal(status, whole.status)
        np.testing.assert_array_equal(margin, whole.margin)

    def test_windows_across_a_gap_at_the_border_of_chunks_and_files_are_missing(self, small, tmp_path):
        model = paper()
        t, u, y = 0.01 * np.arange(N), np.zeros((N, 1)), np.zeros((N, 2))
        t[1000:] += 5
        t[2048:] += 5
        folder = write(tmp_path / "run", t, u, y, cuts=(1000,))
        for chunk in (1000, 512):
            detect_dataset(jb.parity_relations(model, 2), folder, tmp_path / f"out{chunk}", chunk=chunk)
            status = verdicts(tmp_path / f"out{chunk}")[0]
            assert list(np.flatnonzero(status == jb.Status.MISSING)) == [0, 1, 1000, 1001, 2048, 2049]

    def test_the_default_chunk_takes_a_whole_block_of_the_kernel(self, case, tmp_path):
        r, folder, whole, _ = case("section 5")
        detect_dataset(r, folder, tmp_path / "out", chunk=1)
        np.testing.assert_array_equal(verdicts(tmp_path / "out")[1], whole.margin)
        assert len(part_files(tmp_path / "out/verdicts.parquet")) == 1

    def test_time_is_written_as_it_was_read(self, case, small, tmp_path):
        r, folder, _, whole = case("section 5")
        detect_dataset(r, folder, tmp_path / "out")
        np.testing.assert_array_equal(pq.read_table(tmp_path / "out/verdicts.parquet")["time"].to_numpy(), whole.time)


class TestDigest:
    @pytest.mark.parametrize("k, n", [(1, 1), (2, 3), (3, 3), (5, 40), (1, 1500)])
    def test_alarms_are_those_of_one_piece(self, case, small, tmp_path, k, n):
        r, folder, whole, rec = case("section 5")
        partial, _ = write_parts(r, open_parquet(folder, r.model), tmp_path)
        found = digest(r, open_parquet(folder, r.model), partial, alarm=(k, n), alarms_csv=tmp_path / "streamed.csv")
        alarms = whole.alarms(k, n)
        write_alarms(tmp_path / "whole.csv", alarms, rec, r.model.dt)
        assert (tmp_path / "streamed.csv").read_text() == (tmp_path / "whole.csv").read_text()
        assert found.alarm_count == len(alarms) and all(a in alarms for a in found.alarms) and found.alarms[0] == alarms[0]
        deepest = sorted(a.depth for a in alarms)[:200]
        assert sorted(a.depth for a in found.alarms)[: len(deepest)] == deepest and len(found.alarms) <= 201

    def test_everything_else_too(self, case, small, tmp_path):
        r, folder, whole, rec = case("section 5")
        found = detect_dataset(r, folder, tmp_path / "out", chunk=777)
        assert found.worst == worst(whole) and found.counts == whole.counts and found.samples == N
        assert found.hints == rec.hints and any("stays at exactly" in h for h in found.hints) and any("gap" in h for h in found.hints)
        assert [found.label(k) for k in (0, 2999, 3000, 4321, N - 1)] == [rec.label(k) for k in (0, 2999, 3000, 4321, N - 1)]
        line = Timeline(N)
        line.add(0, rec.axis, whole.status, whole.margin)
        line.mark([a.worst for a in whole.alarms()])
        for field in ("x", "status", "low", "high", "marked"):
            np.testing.assert_array_equal(getattr(found.line, field), getattr(line, field))
        k = found.worst[0]
        assert found.explain(k).factor == whole.explain(k).factor
        part, near = found.around(k, 500)
        at = int(np.flatnonzero(near.time == rec.time[k])[0])
        assert part.margin[at] == whole.margin[k] and len(part.status) <= 501

    def test_alarms_name_the_sensors_that_could_be_wrong(self, case, small, tmp_path):
        r, folder, whole, _ = case("section 5")
        found = detect_dataset(r, folder, tmp_path, alarm=(2, 3))
        assert found.alarms[0].candidates == whole.alarms(2, 3)[0].candidates and found.alarms[0].errors
        with pytest.raises(ValueError, match="k of n needs k <= n: 3 of 2"):
            detect_dataset(r, folder, tmp_path, alarm=(3, 2))

    def test_all_fault_is_one_alarm_and_none_is_none(self, small, tmp_path):
        model = paper()
        for name, y in (("healthy", np.zeros((N, 2))), ("wild", np.tile([[9.0, -9.0], [-9.0, 9.0]], (N // 2, 1)))):
            folder = write(tmp_path / name, 0.01 * np.arange(N), np.zeros((N, 1)), y)
            found = detect_dataset(jb.parity_relations(model), folder, tmp_path / f"{name} out", chunk=999)
            assert [(a.start, a.end, a.windows) for a in found.alarms] == ([(1, N - 1, N - 1)] if name == "wild" else [])

    def test_runs_survive_their_way_through_a_file(self, case, small, tmp_path):
        r, folder, _, rec = case("section 5")
        partial, _ = write_parts(r, open_parquet(folder, r.model), tmp_path, chunk=500)
        last = read_runs(part_files(partial)[-1])
        for runs, x in zip(last, (rec.u[:, 0], rec.y[:, 0], rec.y[:, 1]), strict=True):
            once = follow(Runs(), x)
            assert (runs.samples, runs.present, runs.longest, runs.last) == (once.samples, once.present, once.longest, once.last)
            np.testing.assert_array_equal(runs.counts, once.counts)


class Stop(Exception):
    pass


def stopped_after(share):
    """Return a progress callback that stops the run once this share is done."""

    def progress(done):
        if done >= share:
            raise Stop

    return progress


class TestResume:
    def test_stopped_anywhere_it_goes_on_without_losing_or_repeating_a_window(self, case, small, tmp_path, rng, monkeypatch):
        r, folder, whole, _ = case("section 5")
        tested = []
        monkeypatch.setattr(streaming, "detect", lambda r, u, y, **k: tested.append(len(y)) or jb.detect(r, u, y, **k))
        source, out = open_parquet(folder, r.model), tmp_path / "out"
        for share in np.sort(rng.uniform(0.1, 0.95, 3)):
            before = len(part_files(out / "verdicts.partial"))
            tested.clear()
            with pytest.raises(Stop):
                write_parts(r, source, out, chunk=int(rng.integers(200, 900)), progress=stopped_after(share))
            assert len(part_files(out / "verdicts.partial")) >= before
            assert sum(tested) < (share + 0.3) * N - 1024 * before + len(tested) * 2  # parts that are there are not tested again
        write_parts(r, source, out, chunk=400)
        parts = part_files(out / "verdicts.partial")
        assert [pq.read_metadata(p).num_rows for p in parts] == [1024] * 5 + [N - 5 * 1024]
        found = digest(r, source, out / "verdicts.partial")
        publish(out)
        status, margin = verdicts(out)
        np.testing.assert_array_equal(status, whole.status)
        np.testing.assert_array_equal(margin, whole.margin)
        assert found.hints == read_recording(folder, r.model).hints

    def test_a_part_that_was_being_written_is_no_part(self, case, small, tmp_path):
        r, folder, whole, _ = case("section 5")
        with pytest.raises(Stop):
            write_parts(r, open_parquet(folder, r.model), tmp_path, chunk=500, progress=stopped_after(0.5))
        (tmp_path / "verdicts.partial/part-00003.4711").write_bytes(b"PAR1 and half of the rest")
        detect_dataset(r, folder, tmp_path)
        np.testing.assert_array_equal(verdicts(tmp_path)[0], whole.status)
        assert {p.suffix for p in (tmp_path / "verdicts.parquet").iterdir()} == {".parquet"}

    def test_all_parts_there_and_the_report_missing(self, case, small, tmp_path):
        r, folder, whole, _ = case("section 5")
        write_parts(r, open_parquet(folder, r.model), tmp_path)
        assert detect_dataset(r, folder, tmp_path).counts == whole.counts

    @pytest.mark.parametrize("change, what", [
        ("matrix", "another model"), ("offset", "another model"),
        ("horizon", "another horizon"), ("bounds", "another model"), ("method", "another method"),
        ("content", "another data"), ("another file", "another data"),
    ])  # fmt: skip
    def test_another_run_is_not_continued(self, case, small, tmp_path, change, what):
        r, folder, _, _ = case("section 5")
        folder = shutil.copytree(folder, tmp_path / "copy")
        with pytest.raises(Stop):
            write_parts(r, open_parquet(folder, r.model), tmp_path, chunk=500, progress=stopped_after(0.5))
        kept = part_files(tmp_path / "verdicts.partial")
        method = "box" if change == "method" else "joint"
        if change == "matrix":
            r = jb.parity_relations(paper(A=[["0.8", 1], [0, "0.2000001"]]))
        elif change == "offset":
            r = jb.parity_relations(paper(offset={"y": [0, "0.001"]}))
        elif change == "horizon":
            r = jb.parity_relations(paper(), 2)
        elif change == "bounds":
            r = r.with_bounds({"noise": 0.5})
        elif change == "content":
            shutil.copyfile(folder / "1.parquet", folder / "spare")
            (folder / "spare").replace(folder / "1.parquet")
        elif change == "another file":
            t, u, y = recording()
            write(tmp_path / "more", t[-1] + 0.01 + t, u, y, cuts=())
            shutil.copyfile(tmp_path / "more/0.parquet", folder / "9.parquet")
        with pytest.raises(ValueError, match=f"verdicts.partial holds an unfinished run with {what}: choose another folder, or delete"):
            detect_dataset(r, folder, tmp_path, method=method)
        assert part_files(tmp_path / "verdicts.partial") == kept != []

    def test_a_finished_run_is_replaced(self, case, small, tmp_path):
        r, folder, whole, _ = case("section 5")
        detect_dataset(r, folder, tmp_path, method="box")
        detect_dataset(r, folder, tmp_path)
        np.testing.assert_array_equal(verdicts(tmp_path)[0], whole.status)
        assert [p.name for p in tmp_path.iterdir()] == ["verdicts.parquet"]

    def test_bad_data_leave_nothing(self, case, small, tmp_path, monkeypatch):
        monkeypatch.setattr(parquet, "PROBE", 1000)
        r, _, _, _ = case("section 5")
        t, u, y = recording()
        y[5500, 0] = np.inf
        folder = write(tmp_path / "run", t, u, y)
        with pytest.raises(ValueError, match="row 1001 of 3.parquet of column 'y1' is infinite"):
            detect_dataset(r, folder, tmp_path / "out", chunk=500)
        assert not any((tmp_path / "out").iterdir())

    def test_irregular_data_leave_nothing(self, small, tmp_path, monkeypatch):
        monkeypatch.setattr(parquet, "PROBE", 1000)
        t, u, y = recording()
        t[1100:] = 20 + np.cumsum(np.tile([0.005, 0.015], (N - 1100) // 2))
        with pytest.raises(ValueError, match="the recording is not regular"):
            detect_dataset(jb.parity_relations(paper()), write(tmp_path / "run", t, u, y), tmp_path / "out")
        assert not any((tmp_path / "out").iterdir())

    def test_a_full_disk_keeps_what_is_there(self, case, small, tmp_path, monkeypatch):
        r, folder, whole, _ = case("section 5")
        replace, count = streaming.os.replace, []

        def full(a, b):
            count.append(b)
            if len(count) == 4:
                raise OSError(28, "No space left on device", str(b))
            replace(a, b)

        monkeypatch.setattr(streaming.os, "replace", full)
        with pytest.raises(OSError, match="No space left"):
            detect_dataset(r, folder, tmp_path, chunk=500)
        assert len(part_files(tmp_path / "verdicts.partial")) == 2
        assert detect_dataset(r, folder, tmp_path, chunk=500).counts == whole.counts

    def test_other_relations_are_refused(self, case, tmp_path):
        with pytest.raises(TypeError, match="needs parity relations, not LinearSystem"):
            detect_dataset(paper(), case("section 5")[1], tmp_path)

    @pytest.mark.parametrize("method", ["paving", "linearised"])
    def test_methods_that_share_a_budget_are_refused(self, case, tmp_path, method):
        r, folder, _, _ = case("section 5")
        with pytest.raises(ValueError, match=f"Parquet is tested by method joint or box, not '{method}'"):
            detect_dataset(r, folder, tmp_path, method=method)


@pytest.fixture
def place(tmp_path, monkeypatch, tmp_path_factory):
    """Return a folder with model.toml and the folder run."""
    monkeypatch.setattr(cli, "_configure", lambda: None)
    monkeypatch.setattr(cli.tempfile, "tempdir", str(tmp_path_factory.mktemp("temp")))
    monkeypatch.chdir(tmp_path)
    jb.save_model(paper(name="paper"), tmp_path / "model.toml")
    write(tmp_path / "run", *recording())
    return tmp_path


@pytest.fixture
def unreported(monkeypatch):
    """Leave out the pictures and the page, which take longer than everything else."""
    monkeypatch.setattr(detecting, "write_report", lambda *args, **options: None)


DETECT = ["detect", "model.toml", "run", "--out", "out"]
FILES = {"verdicts.parquet", "alarms.csv", "report.html", "margin.png", "residuals.png", "run.json", "tested_model.toml"}


class TestCommand:
    def test_a_folder_from_model_to_report(self, place, small, case, capsys):
        assert cli.main([*DETECT, "--chunk", "1000", "--alarm", "2/3", "--json"]) == 1
        found = json.loads(capsys.readouterr().out)
        _, _, whole, rec = case("section 5")
        assert found["counts"] == whole.counts and found["alarms"] == len(whole.alarms(2, 3)) and found["samples"] == N
        assert list(found["seconds"]) == ["read", "transfer", "compute", "write", "report"] and all(
            s > 0 for s in found["seconds"].values()
        )
        assert {p.name for p in (place / "out").iterdir()} == FILES and found["hints"] == list(rec.hints)
        page = (place / "out/report.html").read_text()
        assert (
            f"run: {N} samples from 0 s to 60.49 s" in page and "Residuals, around the worst window" in page and "stays at exactly" in page
        )

    def test_a_file_in_the_place_of_a_folder(self, place, small, unreported, capsys):
        for data in ("run", "run/0.parquet"):
            assert cli.main([*DETECT[:2], data, *DETECT[3:]]) == 1
        assert "seconds       read " in capsys.readouterr().out and len(verdicts(place / "out")[0]) == 1000

    def test_csv_in_the_place_of_parquet(self, place, small, unreported, capsys):
        cli.main(DETECT)
        rows = "\n".join(f"{k / 100},0,0,0" for k in range(50))
        (place / "healthy.csv").write_text(f"t,u1,y1,y2\n{rows}\n")
        assert cli.main([*DETECT[:2], "healthy.csv", *DETECT[3:]]) == 0
        assert [p.name for p in (place / "out").glob("verdicts*")] == ["verdicts.csv"]
        cli.main(DETECT)
        assert [p.name for p in (place / "out").glob("verdicts*")] == ["verdicts.parquet"]

    def test_interrupted_is_130_and_says_how_to_go_on(self, place, small, unreported, case, capsys, monkeypatch):
        calls = []

        def detect(*args, **options):
            calls.append(1)
            if len(calls) == 8:
                raise KeyboardInterrupt
            return jb.detect(*args, **options)

        monkeypatch.setattr(streaming, "detect", detect)
        assert cli.main([*DETECT, "--chunk", "500"]) == 130
        out, err = capsys.readouterr()
        assert out == "" and err == (
            "jaxbound: interrupted: 51.2 % of the verdicts are kept in out/verdicts.partial; the same command goes on from there\n"
        )
        assert [p.name for p in (place / "out").iterdir()] == ["verdicts.partial"]
        calls[:] = [1] * 8
        assert cli.main([*DETECT, "--chunk", "500"]) == 1 and len(calls) == 8 + 6
        np.testing.assert_array_equal(verdicts(place / "out")[1], case("section 5")[2].margin)

    def test_interrupted_before_the_first_part_leaves_nothing(self, place, small, capsys, monkeypatch):
        def stop(*args, **options):
            raise KeyboardInterrupt

        monkeypatch.setattr(streaming, "detect", stop)
        assert cli.main(DETECT) == 130
        assert capsys.readouterr().err == "jaxbound: interrupted: nothing was written\n" and not (place / "out").exists()

    @pytest.mark.parametrize("name, spoil, message", [
        ("truncated", lambda run: (run / "2.parquet").write_bytes((run / "2.parquet").read_bytes()[:-9]),
         "2.parquet is a truncated Parquet file: its end is missing"),
        ("mixed", lambda run: pq.write_table(pq.read_table(run / "2.parquet").drop(["y2"]), run / "2.parquet"),
         "run/2.parquet: the recording has no column 'y2'"),
        ("backwards", lambda run: (run / "3.parquet").rename(run / "00.parquet"),
         "run: 0.parquet begins at 0 s, before the end of 00.parquet at 60.49 s: files follow each other by name"),
        ("text", lambda run: pq.write_table(pa.table({"t": [0.0], "u1": [0.0], "y1": ["x"], "y2": [0.0]}), run / "0.parquet"),
         "run/0.parquet: column 'y1' holds text"),
        ("empty", lambda run: [p.unlink() for p in run.iterdir()], "run is a folder without Parquet files: it is empty"),
    ])  # fmt: skip
    def test_bad_data_is_2_and_one_sentence(self, place, name, spoil, message, capsys):
        spoil(place / "run")
        assert cli.main(DETECT) == 2
        out, err = capsys.readouterr()
        assert out == "" and message in err and err.startswith("jaxbound: ") and err.count("\n") == 1
        assert {p.name for p in place.iterdir()} == {"model.toml", "run"}

    def test_a_report_inside_the_folder_of_the_data_is_no_data(self, place, small, unreported, capsys):
        for _ in range(2):
            assert cli.main(["detect", "model.toml", "run", "--out", "run/report", "--json"]) == 1
            assert json.loads(capsys.readouterr().out)["samples"] == N

    def test_no_data_at_all_is_too_little_evidence(self, place, small, capsys):
        for file in (place / "run").iterdir():
            table = pq.read_table(file)
            for name in ("y1", "y2"):
                table = table.set_column(table.column_names.index(name), name, pa.nulls(len(table), pa.float64()))
            pq.write_table(table, file)
        assert cli.main(DETECT) == 3
        assert f"{N} of {N} samples of y1 are missing" in capsys.readouterr().out

    def test_interrupted_while_the_report_is_written_keeps_the_verdicts(self, place, small, unreported, capsys, monkeypatch):
        def stop(*args, **options):
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(detecting, "write_report", stop)
            assert cli.main(DETECT) == 130
        assert "interrupted: 100 % of the verdicts are kept in out/verdicts.partial" in capsys.readouterr().err
        monkeypatch.setattr(streaming, "detect", None)  # nothing is tested again
        assert cli.main(DETECT) == 1 and [p.name for p in (place / "out").glob("verdicts*")] == ["verdicts.parquet"]

    def test_another_model_is_refused_and_nothing_is_lost(self, place, small, capsys, monkeypatch):
        r = jb.parity_relations(paper(name="paper"))
        with pytest.raises(Stop):
            write_parts(r, open_parquet(place / "run", r.model), place / "out", chunk=500, progress=stopped_after(0.5))
        jb.save_model(paper(name="paper", noise=["0.2", "0.01"]), place / "model.toml")
        assert cli.main(DETECT) == 2
        assert re.search("out/verdicts.partial holds an unfinished run with another model", capsys.readouterr().err)
        assert len(part_files(place / "out/verdicts.partial")) == 2


@pytest.mark.slow
def test_killed_at_half_and_resumed_in_little_memory(tmp_path):
    """3 million samples in another process: killed without a warning, run again, the verdicts of one piece, less than 1 GB."""
    model, rows = paper(), 3_000_000
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, (rows // 20, 1)), 20, 0)
    y = np.asarray(jb.simulate(model, u, jax.random.key(0), faults=[jb.Fault("y1", "bias", 0.3, rows // 2, rows // 2 + 5000)]).y)
    (tmp_path / "run").mkdir()
    for i in range(3):
        a, b = i * rows // 3, (i + 1) * rows // 3
        t = 0.01 * np.arange(a, b)
        pq.write_table(pa.table({"t": t, "u1": u[a:b, 0], "y1": y[a:b, 0], "y2": y[a:b, 1]}), tmp_path / f"run/{i}.parquet")
    jb.save_model(model, tmp_path / "model.toml")
    start = lambda: subprocess.Popen([sys.executable, "-m", "jaxbound.cli", *DETECT, "--chunk", "300000"], cwd=tmp_path)
    partial, process = tmp_path / "out/verdicts.partial", start()
    while not part_files(partial) and process.poll() is None:
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = [p.stat().st_mtime_ns for p in part_files(partial)]
    assert 1 <= len(kept) < 3
    process, peak = start(), 0
    while process.poll() is None:
        with open(f"/proc/{process.pid}/status") as f:
            peak = max([peak, *(int(line.split()[1]) for line in f if line.startswith("VmHWM"))])
        time.sleep(0.02)
    assert process.returncode == 1 and 0 < peak < 1e6  # kB
    assert [p.stat().st_mtime_ns for p in part_files(tmp_path / "out/verdicts.parquet")][: len(kept)] == kept
    whole = jb.detect(jb.parity_relations(model), u, y)
    status, margin = verdicts(tmp_path / "out")
    np.testing.assert_array_equal(status, whole.status)
    np.testing.assert_array_equal(margin, whole.margin)
