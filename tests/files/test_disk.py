"""Files where POSIX is not: no locks, no flag against links, no folder to force to the disk."""

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

from jaxbound.files import disk, locks
from jaxbound.files.checkpoint import Checkpoint
from jaxbound.files.folders import cache_folder
from jaxbound.files.locks import lock, locked, unshared
from jaxbound.files.whole import UNFINISHED, whole
from jaxbound.runs.outputs import output_folder
from jaxbound.runs.refusals import Refused


@pytest.fixture
def windows(monkeypatch):
    """Take away the calls that Windows lacks, and refuse to move or remove an open file as Windows does."""
    open_files = {}

    def opened(path, *args):
        file = disk_open(path, *args)
        open_files[os.path.realpath(path)] = file
        return file

    def free(path):
        file = open_files.get(os.path.realpath(path))
        if file is not None and not file.closed:
            raise PermissionError(13, "The process cannot access the file", str(path))

    def checked(call):
        def checking(path, *args, **options):
            free(path)
            return call(path, *args, **options)

        return checking

    disk_open = disk.open_unlinked
    monkeypatch.setattr(locks, "fcntl", None)
    monkeypatch.setattr(disk, "NO_LINKS", None)
    monkeypatch.setattr(disk, "FOLDERS", None)
    monkeypatch.setattr(locks, "open_unlinked", opened)
    monkeypatch.setattr(os, "replace", checked(os.replace))
    monkeypatch.setattr(os, "unlink", checked(os.unlink))


def test_a_file_is_written_whole_where_open_files_cannot_be_moved(windows, tmp_path):
    path = tmp_path / "a"
    for text in (b"one", b"two"):
        with whole(path) as file:
            file.write(text)
        assert path.read_bytes() == text
    with pytest.raises(ZeroDivisionError), whole(path) as file:
        file.write(b"three")
        raise ZeroDivisionError
    assert path.read_bytes() == b"two" and [p.name for p in tmp_path.iterdir()] == ["a"]


def test_an_output_folder_and_a_checkpoint_work_without_locks(windows, tmp_path):
    with output_folder(tmp_path / "out", ["a.txt"]) as folder, folder.work() as work:
        (work / "a.txt").write_text("found")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [".jaxbound.json", "a.txt"]
    kept = Checkpoint(tmp_path / "state.npz", {"model": "one"})
    kept.save(x=np.arange(3))
    assert kept.load()["x"].tolist() == [0, 1, 2]


def test_without_locks_nobody_is_kept_away_and_with_them_one_is(tmp_path, monkeypatch):
    with locked(tmp_path / "a"), pytest.raises(BlockingIOError):
        locked(tmp_path / "a")
    with locked(tmp_path / "a", shared=True) as one, locked(tmp_path / "a", shared=True):
        assert not unshared(one)
    monkeypatch.setattr(locks, "fcntl", None)
    with locked(tmp_path / "a") as one, locked(tmp_path / "a") as other:
        lock(other)
        assert unshared(one)


def test_a_folder_is_forced_to_the_disk_behind_a_renamed_file(tmp_path, monkeypatch):
    forced, numbers, real = [], [], os.fsync

    def fsync(number):
        forced.append(os.path.samestat(os.fstat(number), os.stat(tmp_path)))
        numbers.append(number)
        real(number)

    monkeypatch.setattr(os, "fsync", fsync)
    with whole(tmp_path / "a") as file:
        file.write(json.dumps(1).encode())
    assert forced == [False, True]
    for number in numbers:
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(number)


def test_nothing_of_what_a_killed_process_left_is_in_a_file(tmp_path):
    (tmp_path / f".a{UNFINISHED}").write_bytes(b"left")
    with whole(tmp_path / "a"):
        pass
    assert (tmp_path / "a").read_bytes() == b""


def test_a_link_made_meanwhile_is_looked_at_again_and_another_trouble_is_said(tmp_path, monkeypatch):
    troubles, real = [errno.EACCES, errno.ELOOP], locks.open_unlinked

    def opened(path):
        if troubles:
            raise OSError(troubles.pop(), "trouble")
        return real(path)

    monkeypatch.setattr(locks, "open_unlinked", opened)
    with pytest.raises(PermissionError, match="trouble"):
        locked(tmp_path / "a")
    locked(tmp_path / "a").close()


def test_what_may_be_thrown_away_lies_where_the_user_says_or_at_home(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "jaxbound"
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    assert cache_folder() == Path.home() / ".cache" / "jaxbound"


def test_two_commands_do_not_write_one_folder(tmp_path):
    with output_folder(tmp_path / "out"), pytest.raises(Refused, match="another jaxbound, process"):
        with output_folder(tmp_path / "out"):
            pass
