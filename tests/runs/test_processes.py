"""Several processes on one recording: the same files of verdicts whoever writes them, and an end in one sentence if one of them fails."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from streaming_case import Stop, cases, recording, shrink, stopped_after, verdicts, write
from systems import paper

import jaxbound as jb
from jaxbound import processes
from jaxbound.cli import detect
from jaxbound.processes import Lost, Team, join_others
from jaxbound.recordings.parquet import open_parquet
from jaxbound.runs import streaming
from jaxbound.runs.digest import detect_dataset
from jaxbound.runs.streaming import kept, part_files, write_parts


@pytest.fixture
def quick(monkeypatch):
    """Make parts of 1024 samples, and processes that look at each other often."""
    shrink(monkeypatch)
    monkeypatch.setattr(processes, "BEAT", 0.01)
    monkeypatch.setattr(processes, "SILENCE", 10.0)


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    return cases(tmp_path_factory)


def together(count, work):
    """Run work(i) for each of so many members in threads; return what they return or raise."""
    out = [None] * count

    def run(i):
        try:
            out[i] = work(i)
        except BaseException as e:
            out[i] = e

    threads = [threading.Thread(target=run, args=(i,), daemon=True) for i in range(count)]
    for t in threads:
        t.start()
    for t in threads:
        t.join(20)
        assert not t.is_alive()
    return out


def shared(monkeypatch, case, out, count, name="section 5", **options):
    """Let so many members make the same call of detect_dataset; return what each got."""
    r, folder, whole, _ = case(name)
    me = threading.local()
    monkeypatch.setattr(processes.jax, "process_index", lambda: me.number)
    monkeypatch.setattr(processes.jax, "process_count", lambda: count)

    def work(i):
        me.number = i
        return detect_dataset(r, folder, out, method=whole.method, **options)

    return together(count, work)


def parts_of(folder):
    return {p.name: p.read_bytes() for p in part_files(folder)}


class TestSameFiles:
    @pytest.mark.parametrize("name", ["section 5", pytest.param("box", marks=pytest.mark.long)])
    def test_whoever_writes_them(self, case, quick, tmp_path, monkeypatch, name):
        """Parts of 2 members, and of 7, more than there are parts, hold the bytes of those of one."""
        r, folder, whole, _ = case(name)
        one = detect_dataset(r, folder, tmp_path / "1", method=whole.method)
        for count in (2, 7):
            found = shared(monkeypatch, case, tmp_path / str(count), count, name, chunk=2000)
            assert parts_of(tmp_path / f"{count}/verdicts.parquet") == parts_of(tmp_path / "1/verdicts.parquet")
            assert {p.name for p in (tmp_path / str(count)).iterdir()} == {"verdicts.parquet", ".jaxbound.json"}
            for each in found:
                assert (each.counts, each.worst, each.hints, each.alarm_count) == (one.counts, one.worst, one.hints, one.alarm_count)
        np.testing.assert_array_equal(verdicts(tmp_path / "2")[0], whole.status)

    def test_what_some_of_them_left_is_finished_by_another_number_of_them(self, case, quick, tmp_path, monkeypatch):
        r, folder, whole, _ = case("section 5")
        source, written = open_parquet(folder, r.model), []

        def stopped(i):
            with Team(tmp_path, i, 2) as team:
                write_parts(r, source, tmp_path, chunk=300, progress=stopped_after(0.5), team=team)

        said = together(2, stopped)
        assert any(isinstance(e, Stop) for e in said) and all(isinstance(e, Stop | Lost) for e in said)
        left = parts_of(tmp_path / "verdicts.partial")
        assert 1 <= len(left) < 6 and kept(tmp_path / "verdicts.partial", source.samples) == 1024 * len(left)
        monkeypatch.setattr(streaming._Pending, "_write", lambda self, *x, f=streaming._Pending._write: written.append(1) or f(self, *x))
        assert shared(monkeypatch, case, tmp_path, 3)[0].counts == whole.counts
        assert len(written) == 6 - len(left) and left.items() <= parts_of(tmp_path / "verdicts.parquet").items()


class TestTeam:
    def test_what_one_cannot_read_ends_all(self, case, quick, tmp_path, monkeypatch):
        r, _, _, _ = case("section 5")
        t, u, y = recording()
        y[5500, 0] = np.inf
        folder = write(tmp_path / "run", t, u, y)
        monkeypatch.setattr(open_parquet.__globals__["ParquetSource"], "probe", lambda self: self.read(0, 1000))
        broken = lambda name: (r, folder, jb.Result, None)
        monkeypatch.setattr(jb.Result, "method", "joint", raising=False)
        said = shared(monkeypatch, broken, tmp_path / "out", 3, chunk=500)
        assert type(said[2]) is ValueError and "row 1001 of 3.parquet of column 'y1' is infinite" in str(said[2])
        assert [str(e) for e in said[:2]] == [f"process 2 stopped: {said[2]}"] * 2 and {type(e) for e in said[:2]} == {Lost}
        assert not (tmp_path / "out").exists()

    def test_one_that_falls_silent_ends_all(self, quick, tmp_path, monkeypatch):
        monkeypatch.setattr(processes, "SILENCE", 0.7)

        def work(i):
            team = Team(tmp_path, i, 3).__enter__()
            team.wait(lambda: all(team.said(j)[0] for j in team.others))
            if i == 1:
                team.over.set()  # its process is killed
                return None
            with team:
                team.wait(lambda: False)

        said = together(3, work)
        for e in said[::2]:
            assert isinstance(e, Lost) and e.silent and "process 1 has not been heard of for 0.7 s" in str(e)

    def test_what_an_earlier_run_left_behind_is_not_believed(self, quick, tmp_path):
        (tmp_path / ".jaxbound-processes").mkdir()
        for i in range(3):
            old = {"word": "old", "heard": {str(j): "older" for j in range(3)}, "state": "failed", "said": "long ago", "beats": 9}
            (tmp_path / ".jaxbound-processes" / str(i)).write_text(json.dumps(old))

        def work(i):
            with Team(tmp_path, i, 2) as team:
                assert team.said(1 - i) == (None, None)
                time.sleep(0.1 * i)
                team.say("works", f"by {i}")
                team.wait(lambda: team.said(1 - i)[0] in ("works", "published"))
                words = team.said(1 - i)[1]
                if i == 0:
                    team.say("published", words)
                else:
                    team.wait(lambda: team.said(0)[0] == "published")
                return words

        assert set(together(2, work)) <= {"by 1", "by 0"}
        assert not any(tmp_path.iterdir())

    def test_another_model_than_process_0_is_refused(self, case, quick, tmp_path):
        r, folder, _, _ = case("section 5")

        def work(i):
            with Team(tmp_path, i, 2) as team:
                other = r if i == 0 else jb.parity_relations(paper(noise=["0.1", "0.02"]))
                return write_parts(other, open_parquet(folder, r.model), tmp_path, chunk=200, team=team)

        said = together(2, work)
        assert "process 1 was started with another model than process 0" in str(said[1]) and isinstance(said[0], Lost)

    def test_alone_there_is_nobody_to_wait_for(self, tmp_path):
        with Team(tmp_path, 0, 1) as team:
            team.say("works")
            team.wait(lambda: True)
        assert not any(tmp_path.iterdir())


class TestEnvironment:
    @pytest.mark.parametrize("given, message", [
        ({"JAX_NUM_PROCESSES": "2", "JAX_PROCESS_ID": "0"}, "set JAX_COORDINATOR_ADDRESS too"),
        ({"JAX_COORDINATOR_ADDRESS": "localhost:1"}, "set JAX_NUM_PROCESSES and JAX_PROCESS_ID too"),
        ({"JAX_COORDINATOR_ADDRESS": "localhost:1", "JAX_NUM_PROCESSES": "2", "JAX_PROCESS_ID": "2"}, "below JAX_NUM_PROCESSES=2"),
        ({"JAX_COORDINATOR_ADDRESS": "localhost:1", "JAX_NUM_PROCESSES": "two", "JAX_PROCESS_ID": "0"}, "must be a whole number"),
    ])  # fmt: skip
    def test_half_of_it_is_refused(self, monkeypatch, given, message):
        for name in processes.ENVIRONMENT:
            monkeypatch.delenv(name, raising=False)
        join_others()
        for name, value in given.items():
            monkeypatch.setenv(name, value)
        with pytest.raises(ValueError, match=message):
            join_others()

    def test_what_is_read_as_a_whole_is_refused(self, monkeypatch, tmp_path, capsys):
        from jaxbound.cli import main

        monkeypatch.setattr(main, "_configure", lambda: None)
        monkeypatch.setattr(detect, "join_others", lambda: None)
        monkeypatch.setattr(processes.jax.distributed, "is_initialized", lambda: True)
        jb.save_model(paper(), tmp_path / "model.toml")
        (tmp_path / "run.csv").write_text("t,u1,y1,y2\n0,0,0,0\n0.01,0,0,0\n")
        assert main.main(["detect", str(tmp_path / "model.toml"), str(tmp_path / "run.csv"), "--out", str(tmp_path / "out")]) == 2
        assert "several processes share the work on Parquet only" in capsys.readouterr().err and not (tmp_path / "out").exists()


DRIVER = """
import os, signal, sys
from jaxbound import processes
from jaxbound.cli import detect as detecting, main as cli
from jaxbound.runs import streaming
streaming.PART, streaming.LEAST, processes.SILENCE = 1024, 1, 3.0
detecting.write_report = lambda *args, **options: None
test, tested = streaming.detect, []
def detect(*args, **options):
    tested.append(1)
    if len(tested) == 3 and os.environ.get("KILLED") == os.environ["JAX_PROCESS_ID"]:
        os.kill(os.getpid(), signal.SIGKILL)
    return test(*args, **options)
streaming.detect = detect
sys.exit(cli.main(["detect", "model.toml", "run", "--out", sys.argv[1], "--chunk", "400", "--json"]))
"""


def commands(folder, out, count, **environment):
    """Run the command in so many processes that find each other at a port of this machine; return [(exit code, stdout, stderr)]."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    start = lambda i: subprocess.Popen(
        [sys.executable, "-c", DRIVER, out], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "JAX_COORDINATOR_ADDRESS": f"127.0.0.1:{port}", "JAX_NUM_PROCESSES": str(count), "JAX_PROCESS_ID": str(i),
             "JAX_PLATFORMS": "cpu", **environment})  # fmt: skip
    started = [start(i) for i in range(count)]
    ended = [(*p.communicate(timeout=120), p.returncode) for p in started]
    return [(code, out, err) for out, err, code in ended]


@pytest.mark.parametrize("count, killed", [
    pytest.param(2, False, marks=pytest.mark.slow), pytest.param(2, True, marks=pytest.mark.long),
    pytest.param(4, True, marks=pytest.mark.long),
])  # fmt: skip
def test_processes_of_jax_distributed(case, quick, tmp_path, count, killed):
    """One is killed, all end; started again they finish: the bytes of one process, one summary, the same exit code from all."""
    r, folder, whole, _ = case("section 5")
    detect_dataset(r, folder, tmp_path / "one")
    jb.save_model(r.model, tmp_path / "model.toml")
    (tmp_path / "run").symlink_to(folder)
    if killed:
        ended = commands(tmp_path, "out", count, KILLED="1")
        assert ended[1][0] == -signal.SIGKILL
        for code, said, err in ended[:1] + ended[2:]:
            assert code == 2 and not said and "process 1 has not been heard of for 3 s" in err
    ended = commands(tmp_path, "out", count)
    assert [code for code, _, _ in ended] == [1] * count and not any(said for _, said, _ in ended[1:])
    assert json.loads(ended[0][1])["counts"] == whole.counts
    assert parts_of(tmp_path / "out/verdicts.parquet") == parts_of(tmp_path / "one/verdicts.parquet")
    assert not (tmp_path / "out/.jaxbound-processes").exists()
