"""Recordings larger than memory at the command line: from a folder to a report, in parts, killed and
resumed.
"""

import json
import re
import signal
import subprocess
import sys
import time

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from streaming_case import N, Stop, recording, stopped_after, verdicts, write
from systems import paper

import jaxbound as jb
from jaxbound.cli import evaluation, main
from jaxbound.recordings.parquet import open_parquet
from jaxbound.runs import ask
from jaxbound.runs.parts import part_files
from jaxbound.runs.streaming import Asked, write_parts

pytestmark = pytest.mark.compiled


@pytest.fixture
def place(tmp_path, monkeypatch, tmp_path_factory):
    """Return a folder with model.toml and the folder run."""
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.setattr(main.tempfile, "tempdir", str(tmp_path_factory.mktemp("temp")))
    monkeypatch.chdir(tmp_path)
    jb.save_model(paper(name="paper"), tmp_path / "model.toml")
    write(tmp_path / "run", *recording())
    return tmp_path


@pytest.fixture
def unreported(monkeypatch):
    """Leave out the pictures and the page, which take longer than everything else."""
    monkeypatch.setattr(evaluation, "write_report", lambda *args, **options: None)


DETECT = ["detect", "model.toml", "run", "--out", "out"]
FILES = {"verdicts.parquet", "alarms.csv", "report.html", "run.json", "tested_model.toml", ".jaxbound.json"}


class TestCommand:
    def test_a_folder_from_model_to_report(self, place, small, case, capsys):
        assert main.main([*DETECT, "--chunk", "1000", "--alarm", "2/3", "--json"]) == 1
        found = json.loads(capsys.readouterr().out)
        _, _, whole, rec = case("section 5")
        assert (
            found["counts"] == whole.counts
            and found["alarms"] == len(whole.alarms(2, 3))
            and found["samples"] == N
        )
        assert list(found["seconds"]) == ["read", "transfer", "compute", "write", "report"] and all(
            s > 0 for s in found["seconds"].values()
        )
        assert {p.name for p in (place / "out").iterdir()} == FILES and found["hints"][
            : len(rec.hints)
        ] == list(rec.hints)
        assert (
            "alarms ended after windows without the onset" in found["hints"][-1]
            and sum(found["ended"].values()) == found["alarms"]
        )
        page = (place / "out/report.html").read_text()
        assert (
            f"run: {N} samples from 0 s to 60.49 s" in page
            and "The signals are in the recording's files" in page
            and "stays at exactly" in page
        )

    def test_a_file_in_the_place_of_a_folder(self, place, small, unreported, capsys):
        for data in ("run", "run/0.parquet"):
            assert main.main([*DETECT[:2], data, *DETECT[3:]]) == 1
        assert "seconds       read " in capsys.readouterr().out and len(verdicts(place / "out")[0]) == 1000

    def test_csv_in_the_place_of_parquet(self, place, small, unreported, capsys):
        main.main(DETECT)
        rows = "\n".join(f"{k / 100},0,0,0" for k in range(50))
        (place / "healthy.csv").write_text(f"t,u1,y1,y2\n{rows}\n")
        assert main.main([*DETECT[:2], "healthy.csv", *DETECT[3:]]) == 0
        assert [p.name for p in (place / "out").glob("verdicts*")] == ["verdicts.csv"]
        main.main(DETECT)
        assert [p.name for p in (place / "out").glob("verdicts*")] == ["verdicts.parquet"]

    def test_interrupted_is_130_and_says_how_to_go_on(
        self, place, small, unreported, case, capsys, monkeypatch
    ):
        calls = []

        def detect(*args, **options):
            calls.append(1)
            if len(calls) == 8:
                raise KeyboardInterrupt
            return jb.detect(*args, **options)

        monkeypatch.setattr(ask, "detect", detect)
        assert main.main([*DETECT, "--chunk", "500"]) == 130
        out, err = capsys.readouterr()
        assert out == "" and err == (
            "jaxbound: interrupted: 51.2 % of the verdicts are kept in out/verdicts.partial; the same "
            "command goes on from there\n"
        )
        assert [p.name for p in (place / "out").iterdir()] == ["verdicts.partial"]
        calls[:] = [1] * 8
        assert main.main([*DETECT, "--chunk", "500"]) == 1 and len(calls) == 8 + 6
        np.testing.assert_array_equal(verdicts(place / "out")[1], case("section 5")[2].margin)

    def test_interrupted_before_the_first_part_leaves_nothing(self, place, small, capsys, monkeypatch):
        def stop(*args, **options):
            raise KeyboardInterrupt

        monkeypatch.setattr(ask, "detect", stop)
        assert main.main(DETECT) == 130
        assert (
            capsys.readouterr().err == "jaxbound: interrupted: nothing was written\n"
            and not (place / "out").exists()
        )

    @pytest.mark.parametrize(
        "name, spoil, message",
        [
            (
                "truncated",
                lambda run: (run / "2.parquet").write_bytes((run / "2.parquet").read_bytes()[:-9]),
                "2.parquet is a truncated Parquet file: its end is missing",
            ),
            (
                "mixed",
                lambda run: pq.write_table(pq.read_table(run / "2.parquet").drop(["y2"]), run / "2.parquet"),
                "run/2.parquet: the recording has no column 'y2'",
            ),
            (
                "backwards",
                lambda run: (run / "3.parquet").rename(run / "00.parquet"),
                "run: 0.parquet begins at 0 s, before the end of 00.parquet at 60.49 s: files follow each "
                "other by name",
            ),
            (
                "text",
                lambda run: pq.write_table(
                    pa.table({"t": [0.0], "u1": [0.0], "y1": ["x"], "y2": [0.0]}), run / "0.parquet"
                ),
                "run/0.parquet: column 'y1' holds text",
            ),
            (
                "empty",
                lambda run: [p.unlink() for p in run.iterdir()],
                "run is a folder without Parquet files: it is empty",
            ),
        ],
    )
    def test_bad_data_is_2_and_one_sentence(self, place, name, spoil, message, capsys):
        spoil(place / "run")
        assert main.main(DETECT) == 2
        out, err = capsys.readouterr()
        assert out == "" and message in err and err.startswith("jaxbound: ") and err.count("\n") == 1
        assert {p.name for p in place.iterdir()} == {"model.toml", "run"}

    def test_a_report_inside_the_folder_of_the_data_is_no_data(self, place, small, unreported, capsys):
        for _ in range(2):
            assert main.main(["detect", "model.toml", "run", "--out", "run/report", "--json"]) == 1
            assert json.loads(capsys.readouterr().out)["samples"] == N

    def test_no_data_at_all_is_too_little_evidence(self, place, small, capsys):
        for file in (place / "run").iterdir():
            table = pq.read_table(file)
            for name in ("y1", "y2"):
                table = table.set_column(
                    table.column_names.index(name), name, pa.nulls(len(table), pa.float64())
                )
            pq.write_table(table, file)
        assert main.main(DETECT) == 3
        assert f"{N} of {N} samples of y1 are missing" in capsys.readouterr().out

    def test_interrupted_while_the_report_is_written_keeps_the_verdicts(
        self, place, small, unreported, capsys, monkeypatch
    ):
        def stop(*args, **options):
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(evaluation, "write_report", stop)
            assert main.main(DETECT) == 130
        assert (
            "interrupted: 100 % of the verdicts are kept in out/verdicts.partial" in capsys.readouterr().err
        )
        monkeypatch.setattr(ask, "detect", None)  # nothing is tested again
        assert main.main(DETECT) == 1 and [p.name for p in (place / "out").glob("verdicts*")] == [
            "verdicts.parquet"
        ]

    def test_another_model_is_refused_and_nothing_is_lost(self, place, small, capsys, monkeypatch):
        r = jb.parity_relations(paper(name="paper"))
        with pytest.raises(Stop):
            write_parts(
                Asked(r, chunk=500),
                open_parquet(place / "run", r.model),
                place / "out",
                progress=stopped_after(0.5),
            )
        jb.save_model(paper(name="paper", noise=["0.2", "0.01"]), place / "model.toml")
        assert main.main(DETECT) == 2
        assert re.search(
            "out/verdicts.partial/part-00000.parquet is of another model", capsys.readouterr().err
        )
        assert len(part_files(place / "out/verdicts.partial")) == 2


@pytest.mark.posix("signals between processes, and /proc")
@pytest.mark.long(by_day="test_interrupted_is_130_and_says_how_to_go_on")
def test_killed_at_half_and_resumed_in_little_memory(tmp_path):
    """3 million samples in another process: killed without a warning, run again, the verdicts of one piece,
    less than 1 GB.
    """
    model, rows = paper(), 3_000_000
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, (rows // 20, 1)), 20, 0)
    y = np.asarray(
        jb.simulate(
            model, u, jax.random.key(0), faults=[jb.Fault("y1", "bias", 0.3, rows // 2, rows // 2 + 5000)]
        ).y
    )
    (tmp_path / "run").mkdir()
    for i in range(3):
        a, b = i * rows // 3, (i + 1) * rows // 3
        t = 0.01 * np.arange(a, b)
        pq.write_table(
            pa.table({"t": t, "u1": u[a:b, 0], "y1": y[a:b, 0], "y2": y[a:b, 1]}),
            tmp_path / f"run/{i}.parquet",
        )
    jb.save_model(model, tmp_path / "model.toml")
    start = lambda: subprocess.Popen(
        [sys.executable, "-m", "jaxbound.cli", *DETECT, "--chunk", "300000"], cwd=tmp_path
    )
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
