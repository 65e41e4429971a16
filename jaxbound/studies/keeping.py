"""What a study keeps in a folder while it runs: enough to go on after a kill, and to tell whether it is the same study."""

import os
from pathlib import Path

import numpy as np

__all__ = ["Keeper", "save_arrays"]

STATE, ROWS = "study.npz", "scenarios"


def save_arrays(path, **arrays):
    """Write arrays as `np.savez` does, completely or not at all."""
    partial = path.with_name(path.name + ".partial")
    with open(partial, "wb") as f:
        np.savez(f, **arrays)
        f.flush()
        os.fsync(f.fileno())
    os.replace(partial, path)


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
            for path in (self.folder / ROWS).glob("part-*"):
                if int(path.stem.split("-")[1].split(".")[0]) >= self.parts:
                    path.unlink()  # written after the last state

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
            self._write_rows()
        arrays = {f"{i}.{name}": x for i, tally in enumerate(self.tallies) for name, x in tally.arrays().items()}
        save_arrays(self.folder / STATE, mark=np.array(self.mark), done=done, parts=self.parts, **arrays)
        self.done = done

    def add_rows(self, label, sizes, number, onset, hits, false, delay):
        """Keep the rows of single scenarios until the next `save`."""
        if self.rows:
            self.pending.append((label, sizes, number, onset, hits, false, delay))

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
        path = self.folder / ROWS / f"part-{self.parts:05d}.parquet"
        pq.write_table(pa.table(table), path.with_suffix(".partial"))
        os.replace(path.with_suffix(".partial"), path)
        self.parts, self.pending = self.parts + 1, []
