"""The checkpoint of a live run: killed at any point, or without power, no row is lost, doubled or another."""

import contextlib
import json
import os
import random
import sqlite3
import subprocess
import sys
import time

import numpy as np
import pytest

from jaxbound.consistency.interface import Judged
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.runs import journal, rows
from jaxbound.runs.journal import Journal, LiveCheckpoint
from jaxbound.runs.loop import follow
from jaxbound.runs.refusals import Refused
from jaxbound.runs.rows import RowFile, RowText

COUNT = 1000


class Counting:
    """A source of numbered samples, and the judge that adds them up: its verdicts rest on all before."""

    replaying = False

    def __init__(self, before=None):
        self.position, self.total = (0, 0) if before is None else (before["source"], before["judge"])

    def __iter__(self):
        draw = random.Random(os.getpid())
        while self.position < COUNT:
            stop = min(self.position + draw.randint(1, 40), COUNT)
            y = np.arange(self.position, stop, dtype=float)[:, None]
            self.position = stop
            yield Recording(y[:, :0], y, NOWHERE, time=y[:, 0])

    def __call__(self, piece):
        totals = self.total + np.cumsum(piece.y[:, 0])
        self.total = int(totals[-1])
        yield piece, Judged((piece.y[:, 0] % 4).astype(np.int8), totals)

    def memory(self):
        return self.position


class Total:
    """The judge's side of `Counting`."""

    def __init__(self, counting):
        self.counting = counting

    def __call__(self, piece):
        return self.counting(piece)

    def memory(self):
        return self.counting.total

    def resume(self, memory):
        self.counting.total = memory


def run(folder, slowly=0.0):
    """Count to the end, from where the last process was."""
    file = RowFile(folder / "verdicts.csv", RowText(), folder / "state")
    with Journal(folder / "state", {"what": "numbers"}) as kept, contextlib.closing(file):
        source = Counting(kept.before)
        checkpoint = LiveCheckpoint(kept, source, Total(source), {"file": file})
        if kept.before is not None:
            checkpoint.resume()
        for _ in follow(source, Total(source), [file], checkpoint):
            time.sleep(slowly)
        file.force()
        checkpoint.finish()


@pytest.fixture
def expected(tmp_path, monkeypatch):
    monkeypatch.setattr(journal, "SYNCHRONOUS", "OFF")
    (tmp_path / "whole").mkdir()
    run(tmp_path / "whole")
    data = (tmp_path / "whole/verdicts.csv").read_bytes()
    assert data.count(b"\n") == COUNT + 1
    return data


HARNESS = """
import os, pathlib, random, sys, time
import pyarrow.csv  # before the forks, or each child dies while it imports
import test_journal
from jaxbound.runs import journal
journal.SYNCHRONOUS = "OFF"  # what a killed process wrote is there; only power cuts need more
folder, draw, kills = pathlib.Path(sys.argv[1]), random.Random(int(sys.argv[2])), 0
patience = 0.05
while True:
    ready, here = os.pipe()
    child = os.fork()
    if not child:
        os.write(here, b"x")
        test_journal.run(folder, 0.002)
        os._exit(0)
    os.read(ready, 1)
    time.sleep(draw.uniform(0.0, patience))
    os.kill(child, 9)
    _, status = os.waitpid(child, 0)
    os.close(ready), os.close(here)
    if status == 0:
        break
    kills += 1
    patience *= 1.02  # a machine with much else to do comes to the end, too
print(kills)
"""


@pytest.mark.posix("forks and kills")
@pytest.mark.parametrize("seed", [0, *(pytest.param(i, marks=pytest.mark.long) for i in range(1, 6))])
def test_killed_at_any_time_no_row_is_lost_doubled_or_another(tmp_path, expected, seed):
    """SIGKILL at a time that the seed draws, again and again, until a process comes to the end."""
    place = {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", HARNESS, str(tmp_path), str(seed)],
        capture_output=True,
        text=True,
        env=os.environ | place,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 2, "nobody was killed"
    assert (tmp_path / "verdicts.csv").read_bytes() == expected


def test_without_power_the_rows_that_were_not_on_the_disk_are_written_again(
    tmp_path, expected, monkeypatch, rng
):
    """A disk without power holds verdicts.csv as far as it was forced there, and anything behind that."""
    path, cuts = tmp_path / "verdicts.csv", 0
    forced, sync = [0], rows.sync

    def remembering(file):
        sync(file)
        forced[0] = os.fstat(file.fileno()).st_size

    class PowerCut(Exception):
        pass

    def until(self, memory, save=Journal.save):
        save(self, memory)
        if rng.random() < 0.15:
            raise PowerCut

    monkeypatch.setattr(rows, "sync", remembering)
    monkeypatch.setattr(rows, "UNFORCED", 300)
    monkeypatch.setattr(Journal, "save", until)
    while True:
        try:
            run(tmp_path)
            break
        except PowerCut:
            cuts += 1
        size = path.stat().st_size if path.exists() else 0
        left = int(rng.integers(min(forced[0], size), size + 1))
        with contextlib.suppress(FileNotFoundError), open(path, "r+b") as file:
            file.truncate(left)
            file.seek(forced[0])
            file.write(b"\0" * int(rng.integers(0, 50)))
    assert cuts > 3 and path.read_bytes() == expected


def test_each_checkpoint_is_forced_to_the_disk(tmp_path):
    with Journal(tmp_path / "state", {}) as kept:
        kept.save({"a": 1})
        assert kept.database.execute("PRAGMA synchronous").fetchone() == (2,), "FULL"
        assert kept.database.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    with contextlib.closing(sqlite3.connect(tmp_path / "state")) as database:
        ((memory,),) = database.execute("SELECT memory FROM checkpoint")
    assert json.loads(memory) == {"a": 1}


def test_a_file_system_without_locks_has_a_checkpoint_all_the_same(tmp_path, monkeypatch):
    connect, refused = sqlite3.connect, []

    def unlocked(path, **options):
        if not options.get("uri"):
            refused.append(path)
            error = sqlite3.OperationalError("disk I/O error")
            error.sqlite_errorname = "SQLITE_IOERR_LOCK"
            raise error
        return connect(path, **options)

    monkeypatch.setattr(sqlite3, "connect", unlocked)
    for _ in range(2):
        with Journal(tmp_path / "state", {}) as kept:
            kept.save(1)
    with Journal(tmp_path / "state", {}) as kept:
        assert kept.before == 1 and len(refused) == 3


@pytest.mark.parametrize("content", [b"x", b"SQLite format 3\0" + b"\0" * 200])
def test_what_is_no_checkpoint_of_ours_is_refused_and_left_alone(tmp_path, content):
    (tmp_path / "state").write_bytes(content)
    with pytest.raises(Refused, match="is no state of jaxbound detect"), Journal(tmp_path / "state", {}):
        pass
    assert (tmp_path / "state").read_bytes() == content


def test_a_process_that_was_killed_before_its_first_checkpoint_left_nothing_to_refuse(tmp_path):
    (tmp_path / "state").touch()
    with Journal(tmp_path / "state", {}) as kept:
        assert kept.before is None
        kept.save(1)


def test_the_state_of_a_long_run_stays_small(tmp_path, monkeypatch):
    """In WAL mode each checkpoint is appended to a second file, which has to be emptied again and again."""
    monkeypatch.setattr(journal, "SYNCHRONOUS", "OFF")
    count, largest = 5000, 0
    verdicts = RowFile(tmp_path / "verdicts.csv", RowText(), tmp_path / "state")
    with Journal(tmp_path / "state", {"what": "numbers"}) as kept, contextlib.closing(verdicts):
        source = Counting()
        checkpoint = LiveCheckpoint(kept, source, Total(source), {"file": verdicts})
        for k in range(count):
            y = np.full((1, 1), float(k))
            verdicts.add(Recording(y[:, :0], y, NOWHERE, time=y[:, 0]), Judged(np.ones(1, np.int8), y[:, 0]))
            checkpoint.save()
            verdicts.flush()
            largest = max(largest, sum(file.stat().st_size for file in tmp_path.glob("state*")))
    appended = count * 4096  # at the least, a page for each checkpoint
    assert largest < 6 << 20 < appended
    assert [file.name for file in sorted(tmp_path.iterdir())] == ["state", "verdicts.csv"]
    assert (tmp_path / "state").stat().st_size < 1 << 18
