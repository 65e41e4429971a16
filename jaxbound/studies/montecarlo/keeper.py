"""The folder of a running study: counts by which it goes on after a kill, and the rows of
single scenarios.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxbound.files.checkpoint import Checkpoint
from jaxbound.files.whole import whole
from jaxbound.studies.montecarlo.tally import TrialTally

STATE, ROWS = "study.npz", "scenarios"


class Keeper:
    """The state of a study in a folder: counts, how many tasks they hold, and the rows of single scenarios if
    they are wanted.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        identity: Mapping[str, str],
        tallies: Sequence[TrialTally],
        rows: bool,
    ) -> None:
        """Open a folder; take up the counts that a study with the same identity left there.

        Raises:
            ValueError: the folder holds another study.
        """
        self.folder, self.tallies, self.rows = Path(folder), tallies, rows
        self.checkpoint = Checkpoint(self.folder / STATE, identity)
        self.done, self.parts = 0, 0
        self.labels: list[str] = []  # of each row that is not yet written
        self.pending: list[Mapping[str, np.ndarray]] = []
        self.folder.mkdir(parents=True, exist_ok=True)
        self.begun = self._take_up()
        if rows:
            (self.folder / ROWS).mkdir(exist_ok=True)
            if not self.begun and (there := sorted(os.listdir(self.folder / ROWS))):
                raise ValueError(
                    f"{self.folder / ROWS} holds {there[0]}, which is not of this study: choose another "
                    f"folder"
                )
            self._next_rows().unlink(missing_ok=True)  # written after the last state
            self.first = self._arrays()

    def _take_up(self) -> bool:
        """Take up what was kept; return whether there was anything."""
        arrays = self.checkpoint.load()
        if arrays is None:
            return False
        self.done, self.parts = int(arrays["done"]), int(arrays["parts"])
        for i, tally in enumerate(self.tallies):
            vars(tally).update({name: arrays[f"{i}.{name}"] for name in tally.arrays()})
        return True

    def save(self, done: int) -> None:
        """Write the counts of the first `done` tasks, and the rows since the last time: completely or not at
        all.
        """
        if self.rows and self.pending:
            if not self.begun:  # rows without a state would be nobody's
                self.checkpoint.save(done=0, parts=0, **self.first)
            self._write_rows()
        self.checkpoint.save(done=done, parts=self.parts, **self._arrays())
        self.done, self.begun = done, True

    def _arrays(self) -> dict[str, np.ndarray]:
        """Return copies of all counts, by the number of the trial and their name."""
        arrays = {}
        for i, tally in enumerate(self.tallies):
            for name, counts in tally.arrays().items():
                arrays[f"{i}.{name}"] = np.array(counts)
        return arrays

    def add_rows(self, label: str, columns: Mapping[str, np.ndarray]) -> None:
        """Keep the rows of single scenarios until the next `save`. columns: {name: (N,)}, delay the last."""
        if self.rows:
            self.labels += [label] * len(columns["size"])
            self.pending.append(columns)

    def _next_rows(self) -> Path:
        return self.folder / ROWS / f"part-{self.parts:05d}.parquet"

    def _write_rows(self) -> None:
        """Write the rows since the last time as the next part."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        table = {"fault": pa.array(self.labels).dictionary_encode()}
        for name in self.pending[0]:
            values = np.concatenate([columns[name] for columns in self.pending])
            table[name] = pa.array(values, mask=values < 0 if name == "delay" else None)
        with whole(self._next_rows(), links=False) as f:
            pq.write_table(pa.table(table), f)
        self.parts, self.pending, self.labels = self.parts + 1, [], []
