"""What a study keeps in a folder while it runs: enough to go on after a kill, and to tell whether it is the same study.

Here is also the one way to write a file completely or not at all, for the floors above too.
"""

import os
import shutil
from contextlib import contextmanager
from pathlib import Path

import numpy as np

__all__ = ["UNFINISHED", "Keeper", "locked", "save_arrays", "unshared", "whole"]

STATE, ROWS = "study.npz", "scenarios"
UNFINISHED = ".jaxbound-part"  # ends the name of a file that is being written


def locked(path, shared=False):
    """Open a file that no other process writes meanwhile; a lock dies with its process, so a killed one leaves none.

    Args:
        path: of the file. shared: others may have it too if they share it.

    Returns:
        A binary file, to be closed. Where the system has no locks, nobody is kept away.

    Raises:
        BlockingIOError: another process has it.
    """
    opened = lambda: open(os.open(path, os.O_RDWR | os.O_CREAT, 0o666), "r+b")
    try:
        import fcntl
    except ImportError:
        return opened()
    while True:
        file = opened()
        try:
            fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            raise
        except OSError:  # a file system without locks
            return file
        if os.path.exists(path) and os.path.samestat(os.stat(path), os.fstat(file.fileno())):
            return file
        file.close()  # whoever had it has taken it away in between


def unshared(file):
    """Return whether nobody else shares a file from `locked` any more; no other can then have it before it is closed."""
    try:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):  # there are no locks
        pass
    return True


@contextmanager
def whole(path, sync=True):
    """Give a binary file whose bytes are found at `path` once the block has ended well; else what was there stays.

    They are written beside it: what a killed process leaves there is taken over by the next one. Links are followed; a pipe or a device
    is no file to replace, and is written as it is.

    Args:
        path: of the file. sync: force it to the disk first.

    Raises:
        ValueError: another process is writing it.
    """
    if os.path.exists(path) and not os.path.isfile(path):
        with open(path, "wb") as file:
            yield file
        return
    path = Path(os.path.realpath(path))
    part = path.with_name(f".{path.name}{UNFINISHED}")
    try:
        file = locked(part)
    except BlockingIOError:
        raise ValueError(f"another process is writing {path}") from None
    with file:
        try:
            file.truncate(0)
            yield file
            file.flush()
            if sync:
                os.fsync(file.fileno())
            if path.exists():
                shutil.copymode(path, part)
            os.replace(part, path)
        except BaseException as e:
            part.unlink(missing_ok=True)
            if isinstance(e, OSError) and e.errno and e.filename is None:
                raise OSError(e.errno, os.strerror(e.errno), str(path)) from e
            raise


def save_arrays(path, **arrays):
    """Write arrays as `np.savez` does, completely or not at all."""
    with whole(path) as f:
        np.savez(f, **arrays)


class Keeper:
    """The state of a study in a folder: counts, how many tasks they hold, and the rows of single scenarios if they are wanted."""

    def __init__(self, folder, mark, tallies, rows):
        """Open a folder; take up the counts that a study with the same mark left there.

        Raises:
            ValueError: the folder holds another study.
        """
        self.folder, self.mark, self.tallies, self.rows = Path(folder), mark, tallies, rows
        self.done, self.parts, self.pending = 0, 0, []
        self.folder.mkdir(parents=True, exist_ok=True)
        if (self.folder / STATE).exists():
            self._take_up()
        if rows:
            (self.folder / ROWS).mkdir(exist_ok=True)
            if not (self.folder / STATE).exists() and (there := sorted(os.listdir(self.folder / ROWS))):
                raise ValueError(f"{self.folder / ROWS} holds {there[0]}, which is not of this study: choose another folder")
            self._next_rows().unlink(missing_ok=True)  # written after the last state
            self.first = self._arrays()

    def _take_up(self):
        try:
            with np.load(self.folder / STATE) as kept:
                mark, arrays = str(kept["mark"]), {name: kept[name] for name in kept.files}
        except (OSError, ValueError, KeyError) as e:
            raise ValueError(f"{self.folder / STATE} is damaged ({type(e).__name__}): delete the folder or choose another") from None
        if mark != self.mark:
            raise ValueError(
                f"{self.folder} holds another study (model, faults, sizes, n, key, options or version of jaxbound differ): "
                "choose another folder"
            )
        self.done, self.parts = int(arrays["done"]), int(arrays["parts"])
        for i, tally in enumerate(self.tallies):
            tally.load({name.split(".")[1]: x for name, x in arrays.items() if name.startswith(f"{i}.")})

    def save(self, done):
        """Write the counts of the first `done` tasks, and the rows since the last time: completely or not at all."""
        if self.rows and self.pending:
            if not (self.folder / STATE).exists():  # rows without a state would be nobody's
                save_arrays(self.folder / STATE, mark=np.array(self.mark), done=0, parts=0, **self.first)
            self._write_rows()
        save_arrays(self.folder / STATE, mark=np.array(self.mark), done=done, parts=self.parts, **self._arrays())
        self.done = done

    def _arrays(self):
        return {f"{i}.{name}": np.array(x) for i, tally in enumerate(self.tallies) for name, x in tally.arrays().items()}

    def add_rows(self, label, sizes, number, onset, hits, false, delay):
        """Keep the rows of single scenarios until the next `save`."""
        if self.rows:
            self.pending.append((label, sizes, number, onset, hits, false, delay))

    def _next_rows(self):
        return self.folder / ROWS / f"part-{self.parts:05d}.parquet"

    def _write_rows(self):
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = list(zip(*self.pending, strict=True))
        labels = [label for label, number in zip(columns[0], columns[2], strict=True) for _ in range(len(number))]
        join = lambda parts: np.concatenate(parts)
        delay = join(columns[6])
        table = {
            "fault": pa.array(labels).dictionary_encode(), "size": pa.array(join(columns[1])), "scenario": pa.array(join(columns[2])),
            "onset": pa.array(join(columns[3])), "fault_windows": pa.array(join(columns[4])), "false_alarms": pa.array(join(columns[5])),
            "delay": pa.array(delay, mask=delay < 0)}  # fmt: skip
        with whole(self._next_rows()) as f:
            pq.write_table(pa.table(table), f)
        self.parts, self.pending = self.parts + 1, []
