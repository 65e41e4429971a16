"""Work spread by dask: the bytes of one process, whoever dies meanwhile; and a sentence where workers are of
no use.
"""

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from contextlib import nullcontext, suppress
from pathlib import Path

import numpy as np
import pytest
from streaming_case import parts_of, recording, write
from systems import paper

import jaxbound as jb
from jaxbound.cli import engine as engine_of_commands
from jaxbound.cli import fleet_table, main
from jaxbound.recordings import contents
from jaxbound.recordings.parquet import ParquetSource, open_parquet
from jaxbound.runs import streaming
from jaxbound.runs.digest import detect_dataset
from jaxbound.runs.parts import part_files
from jaxbound.workers import engine
from jaxbound.workers.engine import connected, spread

pytestmark = [pytest.mark.usefixtures("small"), pytest.mark.compiled]
WRITTEN = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d \+0000")  # when a page was written


@pytest.fixture(scope="module")
def client():
    pytest.importorskip(
        "distributed", reason="dask.distributed is not installed: pip install 'jaxbound[dask]'"
    )
    with connected(workers=2) as found:
        yield found


class Slow:
    """A job that takes its time."""

    def __init__(self, seconds=0.0):
        self.seconds = seconds

    def run(self, task):
        time.sleep(self.seconds)
        if task == "bad":
            raise ValueError("this one is bad")
        return task, os.getpid()


class TestSameBytes:
    def test_detect(self, case, one, client, tmp_path):
        r, folder, _, _ = case("section 5")
        shares = []
        found = detect_dataset(r, folder, tmp_path, chunk=900, client=client, progress=shares.append)
        assert parts_of(tmp_path / "verdicts.parquet") == parts_of(one[0] / "verdicts.parquet")
        assert {p.name for p in tmp_path.iterdir()} == {"verdicts.parquet", ".jaxbound.json"}
        for name in ("counts", "worst", "hints", "alarm_count", "alarms", "ended", "samples"):
            assert getattr(found, name) == getattr(one[1], name), name
        assert shares == sorted(shares) and shares[-1] == 1.0

    def test_what_workers_read_is_not_read_again_to_know_what_was_tested(
        self, case, client, tmp_path, monkeypatch
    ):
        r, folder, _, _ = case("section 5")
        held, source = open_parquet(folder, r.model).content, open_parquet(folder, r.model)
        streaming.write_parts(streaming.Asked(r), source, tmp_path, client=client)
        monkeypatch.setattr(contents, "_digest_of_block", None)
        assert source.content == held

    def test_what_one_process_left_is_finished_by_workers(self, case, one, client, tmp_path, monkeypatch):
        r, folder, _, _ = case("section 5")
        made = detect_dataset(r, folder, tmp_path, part=(2, 3))
        before = {p.name: p.stat().st_mtime_ns for p in made}
        detect_dataset(r, folder, tmp_path, client=client)
        assert parts_of(tmp_path / "verdicts.parquet") == parts_of(one[0] / "verdicts.parquet")
        assert before == {
            p.name: p.stat().st_mtime_ns
            for p in part_files(tmp_path / "verdicts.parquet")
            if p.name in before
        }

    def test_a_study_counts_the_same_and_keeps_the_same_rows(self, client, tmp_path):
        asked = {
            "faults": ["y1:bias", "y2:gain"],
            "n": 9000,
            "key": 0,
            "sizes": [0.5, 2.5],
            "samples": 30,
            "rows": True,
        }
        alone = jb.study(paper(), **asked, out=tmp_path / "alone")
        spread_out = jb.study(paper(), **asked, out=tmp_path / "spread", client=client)
        for a, b in zip(alone.tallies, spread_out.tallies, strict=True):
            for name, counts in a.arrays().items():
                np.testing.assert_array_equal(counts, b.arrays()[name], name)
        rows = lambda name: [p.read_bytes() for p in sorted((tmp_path / name / "scenarios").iterdir())]
        assert rows("alone") == rows("spread") != []

    def test_a_fleet_with_its_pages(self, client, tmp_path, monkeypatch):
        monkeypatch.setattr(main, "_configure", lambda: None)
        monkeypatch.setattr(fleet_table, "PAGES", 2)
        rng, lines = np.random.default_rng(3), ["unit,model,recording"]
        jb.save_model(paper(dt=1), tmp_path / "m.toml")
        for i in range(12):
            y = rng.uniform(-0.01, 0.01, (50, 2)) + (3.0 * (np.arange(50) > 20)[:, None] if i % 3 == 0 else 0)
            rows = [f"{k},0,{a!r},{b!r}" for k, (a, b) in enumerate(y.tolist())]
            (tmp_path / f"{i}.csv").write_text(
                "\n".join(["t,u1,y1,y2", *rows][: 1 if i == 5 else None]) + "\n"
            )
            lines.append(f"unit {i},m.toml,{i}.csv")
        (tmp_path / "fleet.csv").write_text("\n".join(lines) + "\n")
        argv = ["fleet", str(tmp_path / "fleet.csv"), "--out"]
        assert main.main([*argv, str(tmp_path / "alone")]) == 1
        monkeypatch.setattr(engine_of_commands, "engine", lambda *args: nullcontext(client))
        assert main.main([*argv, str(tmp_path / "spread")]) == 1
        files = lambda name: {
            str(p.relative_to(tmp_path / name)): WRITTEN.sub("", p.read_text())
            for p in (tmp_path / name).rglob("*.*ml")
        }
        assert files("alone") == files("spread") and sorted(files("alone")) == [
            "fleet.html",
            "units/1-unit_0.html",
            "units/2-unit_3.html",
        ]
        assert (tmp_path / "alone/fleet.csv").read_bytes() == (tmp_path / "spread/fleet.csv").read_bytes()

    def test_the_precision_of_the_caller_holds_on_workers(self, client):
        import jax

        asked = (paper(), "y1:bias", 300, 0)
        with jax.enable_x64(False):
            narrow = jb.study(*asked, sizes=[0.5], samples=20, client=client)
            alone = jb.study(*asked, sizes=[0.5], samples=20)
        assert (
            narrow.settings["dtype"] == "float32"
            and (narrow.tallies[0].delays == alone.tallies[0].delays).all()
        )


class TestCost:
    @pytest.mark.posix("counts of pages")
    def test_workers_keep_their_memory_for_the_next_chunk(self, client):
        """Else the system clears the same pages again and again, which takes as long as the tests of
        windows.
        """
        assert max(client.run(_pages_of_a_chunk_after_another).values()) < 1000


def _pages_of_a_chunk_after_another():
    """Return how many pages the system gives for an array as large as one that was there before."""
    import resource

    for _ in range(2):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        np.ones(2_000_000)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


class TestTrouble:
    def test_bad_data_are_refused_in_the_sentence_of_one_process(self, case, client, tmp_path, monkeypatch):
        r = case("section 5")[0]
        t, u, y = recording()
        y[5500, 0] = np.inf
        folder = write(tmp_path / "run", t, u, y)
        monkeypatch.setattr(ParquetSource, "probe", lambda self: self.read(0, 1000))
        said = []
        for out, who in (("alone", None), ("spread", client)):
            with pytest.raises(ValueError, match="row 1001 of 3.parquet") as e:
                detect_dataset(r, folder, tmp_path / out, client=who)
            said.append(str(e.value))
        assert said[0] == said[1]

    def test_a_task_that_refuses_is_not_tried_again(self, client):
        with pytest.raises(ValueError, match="this one is bad"):
            dict(spread(client, Slow(), [1, "bad", 2]))
        assert sorted(number for number, _ in spread(client, Slow(), range(30))) == list(
            range(30)
        )  # workers are as before

    @pytest.mark.posix("signals between processes")
    def test_a_worker_that_dies_costs_its_task_alone(self, case, one, client, tmp_path):
        r, folder, _, _ = case("section 5")
        killed = []

        def kill(share):
            if not killed:
                killed.append(max(client.run(os.getpid).values()))
                os.kill(killed[0], signal.SIGKILL)

        detect_dataset(r, folder, tmp_path, client=client, progress=kill)
        assert killed and parts_of(tmp_path / "verdicts.parquet") == parts_of(one[0] / "verdicts.parquet")

    @pytest.mark.parametrize(
        "answers, sentence",
        [
            (
                {"tcp://a": ModuleNotFoundError("no", name="jaxbound")},
                "the worker tcp://a cannot import jaxbound: it needs jaxbound",
            ),
            (
                {"tcp://a": {"jax": "0.1"}},
                r"the worker tcp://a has jax 0\.1, not .*the same kind of processor and the same versions",
            ),
            (
                {"tcp://a": {"processor": "left"}, "tcp://b": {"processor": "right"}},
                "the worker tcp://b has processor right, not left",
            ),
            (
                {"tcp://a": RuntimeError("no space")},
                "the worker tcp://a is of no use: RuntimeError: no space",
            ),
        ],
    )
    def test_workers_that_would_write_other_bytes_are_refused(self, answers, sentence):
        class Scheduler:
            def wait_for_workers(self, n, timeout):
                pass

            def run(self, function, on_error):
                return {
                    a: x if isinstance(x, Exception) else (engine._kind() | x, 1, False)
                    for a, x in answers.items()
                }

        with pytest.raises(ConnectionError, match=sentence):
            engine._alike(Scheduler())

    def test_what_is_done_stays_where_the_engine_fails(self, case, tmp_path):
        """Unlike what was found in data that must be changed."""

        class Gone:
            def wait_for_workers(self, n, timeout):
                raise ConnectionError("nobody is there")

            def nthreads(self):
                return {}

        r, folder, _, _ = case("section 5")
        made = {p.name: p.read_bytes() for p in detect_dataset(r, folder, tmp_path, part=(2, 3))}
        with pytest.raises(ConnectionError, match="nobody is there"):
            detect_dataset(r, folder, tmp_path, client=Gone())
        assert parts_of(tmp_path / "verdicts.partial") == made

    def test_one_that_joins_later_is_refused_too(self):
        other = engine._kind() | {"processor": "another"}
        refused, found = engine._attempt(engine.pickle.dumps((Slow(), other, True)), 1)
        assert found is None and "a worker that joined has processor" in str(refused)

    def test_without_dask_it_says_how_to_get_it(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "distributed", None)
        with pytest.raises(ValueError, match=r"pip install 'jaxbound\[dask\]'"), connected(workers=1):
            pass

    def test_a_scheduler_that_is_not_there(self, monkeypatch):
        pytest.importorskip("distributed", reason="dask.distributed is not installed")
        monkeypatch.setattr(engine, "WAIT", 1)
        with (
            pytest.raises(ConnectionError, match=r"no dask scheduler answers at tcp://127.0.0.1:9"),
            connected("tcp://127.0.0.1:9"),
        ):
            pass


class TestCommand:
    @pytest.mark.parametrize(
        "data, option, sentence",
        [
            ("run.csv", (), "--workers is for Parquet and other methods: .*run.csv is read as a whole"),
            ("run", ("--part", "1/2"), "--workers spreads the work itself: leave out --part and --merge"),
            ("-", (), "--workers is for Parquet: samples through a pipe are judged as they come"),
        ],
    )
    def test_what_cannot_be_spread_is_refused(self, tmp_path, monkeypatch, capsys, data, option, sentence):
        monkeypatch.setattr(main, "_configure", lambda: None)
        jb.save_model(paper(), tmp_path / "model.toml")
        (tmp_path / "run.csv").write_text("t,u1,y1,y2\n0,0,0,0\n")
        write(tmp_path / "run", *recording())
        where = data if data == "-" else str(tmp_path / data)
        argv = [
            "detect",
            str(tmp_path / "model.toml"),
            where,
            "--out",
            str(tmp_path / "out"),
            "--workers",
            "2",
            *option,
        ]
        assert main.main(argv) == 2
        assert re.search(sentence, capsys.readouterr().err)


class TestMany:
    @pytest.mark.long(by_day="test_a_worker_that_dies_costs_its_task_alone")
    def test_twenty_kills(self, case, one, client, tmp_path, monkeypatch):
        """Workers are killed at random while a recording is judged again and again; each run ends with the
        same bytes.
        """
        r, folder, _, _ = case("section 5")
        monkeypatch.setattr(streaming, "PART", 64)
        detect_dataset(r, folder, tmp_path / "alone")
        choose, killed, runs = random.Random(18), [], 0

        def reap(share):
            if share and choose.random() < 0.3:  # work is done between two kills, else it never ends
                with suppress(OSError, ValueError):  # it has just died, or comes up
                    pid = choose.choice(list(client.run(os.getpid).values()))
                    os.kill(pid, signal.SIGKILL)
                    killed.append(pid)

        while len(killed) < 20:
            detect_dataset(r, folder, tmp_path / str(runs), client=client, progress=reap)
            assert parts_of(tmp_path / str(runs) / "verdicts.parquet") == parts_of(
                tmp_path / "alone/verdicts.parquet"
            )
            runs += 1
        assert len(set(killed)) > 10 and runs < 20

    @pytest.mark.long(by_day="test_a_worker_that_dies_costs_its_task_alone")
    def test_a_scheduler_that_dies_and_the_same_call_with_another(self, case, tmp_path, monkeypatch):
        pytest.importorskip("distributed", reason="dask.distributed is not installed")
        r, folder, _, _ = case("section 5")
        monkeypatch.setattr(streaming, "PART", 64)
        detect_dataset(r, folder, tmp_path / "alone")
        whole = parts_of(tmp_path / "alone/verdicts.parquet")
        with _scheduler(tmp_path / "first") as (process, address), connected(address) as first:

            def kill(share):
                if share > 0.3:
                    process.kill()

            with pytest.raises(
                ConnectionError, match=f"the scheduler {address} is gone: what is done is kept"
            ):
                detect_dataset(r, folder, tmp_path / "out", client=first, progress=kill)
        # workers may still finish all that they hold: whatever is there, one part of it was never written
        sorted(part_files(tmp_path / "out/verdicts.partial"))[-1].unlink()
        made = {p.name: p.stat().st_mtime_ns for p in part_files(tmp_path / "out/verdicts.partial")}
        assert 0.3 * len(whole) <= len(made) + 1 <= len(whole)
        with connected(workers=2) as second:
            detect_dataset(r, folder, tmp_path / "out", client=second)
        assert parts_of(tmp_path / "out/verdicts.parquet") == whole
        after = {p.name: p.stat().st_mtime_ns for p in part_files(tmp_path / "out/verdicts.parquet")}
        assert made.items() <= after.items()  # they were not made again


class _scheduler:
    """A dask scheduler with two workers, each a process of its own."""

    def __init__(self, folder):
        self.folder = Path(folder)

    def __enter__(self):
        self.folder.mkdir()
        file = self.folder / "scheduler.json"
        dask = [sys.executable, "-m", "dask"]
        told = {"cwd": self.folder, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self.processes = [
            subprocess.Popen(
                [*dask, "scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)], **told
            )
        ]
        worker = [
            *dask,
            "worker",
            "--scheduler-file",
            str(file),
            "--nthreads",
            "1",
            "--no-dashboard",
            "--death-timeout",
            "60",
        ]
        self.processes += [subprocess.Popen(worker, **told) for _ in range(2)]
        for _ in range(600):
            if file.exists() and (text := file.read_text()):
                return self.processes[0], json.loads(text)["address"]
            time.sleep(0.1)
        raise TimeoutError("no scheduler")

    def __exit__(self, *about):
        for p in self.processes:
            p.terminate()
        for p in self.processes:
            p.wait(30)
