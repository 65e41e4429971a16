"""Parts: the verdicts of a recording larger than memory, in Parquet files of a fixed number of samples.

Each is written completely or not at all, and its metadata say what it depends on, so parts are all the state
that a run keeps: those that are not there are left to do. The carry of an observer stands in the part behind
which it is needed.
"""

import json
import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Protocol, cast

import numpy as np

from jaxbound.consistency.interface import Judged
from jaxbound.consistency.searched import judging_device
from jaxbound.files.checkpoint import refuse_other
from jaxbound.files.whole import UNFINISHED, whole
from jaxbound.models.region import Departure, Region
from jaxbound.recordings.columns import categories, from_arrow
from jaxbound.recordings.parquet import ParquetSource
from jaxbound.recordings.parquetfiles import Damage
from jaxbound.recordings.recording import Recording
from jaxbound.runs.counts import CountsByTest
from jaxbound.runs.loop import Memory, Quiet
from jaxbound.runs.partnotes import DEVICE, RUNS, TESTS, Noted
from jaxbound.runs.sink import Verdicts
from jaxbound.runs.verdictfiles import verdict_columns
from jaxbound.sets.floats.status import Status

if TYPE_CHECKING:
    import pyarrow as pa

KNOWN = {"time", "status", "margin", "outside", "outside_by", "outside_at", "test", "suspect"}
"""Columns of a part that are read by name; others are numbers of the test."""
IDENTITY, CARRY = b"identity", b"carry"  # in the metadata of a part
OURS = re.compile(rf"part-\d{{5,}}\.parquet|\.part-\d{{5,}}\.parquet{UNFINISHED}")


class Carrier(Protocol):
    """The judge whose verdicts go into parts. Fields: remembers: whether it is an observer."""

    remembers: ClassVar[bool]

    def memory(self) -> Memory:
        """Return its carry, None if it has none."""


class Parts(Quiet):
    """The parts of a stretch of a recording, a sink.

    Args:
        folder: of the parts. notes: {number of each part, in order: its identity}. size: of a part, in
            samples. end: of the samples of the stretch. about: the signals of the recording, and what is
            tested: of a monitor each test is counted. judge: of the samples; verdicts of one that carries
            something end where a part does.
    """

    def __init__(
        self,
        folder: Path,
        notes: Mapping[int, Mapping[str, str]],
        size: int,
        end: int,
        about: Noted,
        judge: Carrier,
    ) -> None:
        self.folder, self.notes, self.size, self.end = folder, notes, size, end
        self.done, self.about, self.judge = min(notes) * size, about, judge
        self.tables: list[pa.Table] = []  # samples that wait for their part, and their signals (n, k)
        self.signals: list[np.ndarray] = []
        self.counted: CountsByTest | None = None
        if about.relations.parts:
            self.counted = CountsByTest(about.relations)

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        """Take the next samples; write the parts that they complete, and at the end the part that is left."""
        import pyarrow as pa

        if self.counted is not None:  # the verdicts of a monitor end where a part does
            self.counted.add(piece, cast(Judged, verdicts))
        columns = {"time": piece.column, **verdict_columns(verdicts)}
        columns["status"] = categories([x.name for x in Status], verdicts.status)
        self.tables.append(pa.table(columns))
        self.signals.append(_signals_and_where(piece))
        while rows := sum(table.num_rows for table in self.tables):
            if rows < self.size and self.done + rows < self.end:
                return
            table, signals = pa.concat_tables(self.tables), np.concatenate(self.signals)
            self._write(table.slice(0, self.size).combine_chunks(), signals[: self.size])
            self.tables, self.signals = [table.slice(self.size)], [signals[self.size :]]

    def _write(self, table: "pa.Table", signals: np.ndarray) -> None:
        """Write the next part."""
        import pyarrow.parquet as pq

        number = self.done // self.size
        path = self.folder / part_name(number)
        about = self._metadata(number, signals)
        self.folder.mkdir(parents=True, exist_ok=True)
        if path.exists():  # another share has made it meanwhile
            refuse_other_part(path, self.notes[number])
        with whole(path, links=False) as f:
            table = table.replace_schema_metadata(about)
            pq.write_table(
                table, f, use_dictionary=["status", "outside_by", "test"], write_page_checksum=True
            )
        self.done += len(signals)

    def _metadata(self, number: int, signals: np.ndarray) -> dict[bytes, str]:
        """Return the metadata of the next part."""
        about = self.about.of(self.done, signals) | {IDENTITY: json.dumps(self.notes[number])}
        carry = self.judge.memory()
        if carry is not None:
            about[CARRY] = json.dumps(carry)
        if self.counted is not None:
            about[TESTS] = json.dumps(self.counted.memory())
            self.counted = CountsByTest(self.about.relations)
        if device := judging_device(self.judge.remembers):
            about[DEVICE] = device
        return about


def _signals_and_where(piece: Recording) -> np.ndarray:
    """Return (n, k) inputs, outputs and, if the model has `where`, 1 where that holds."""
    signals = [piece.u, piece.y]
    if piece.excluded is not None:
        signals.append(np.where(piece.excluded, np.nan, 1)[:, None])
    return np.concatenate(signals, 1)


def part_name(number: int) -> str:
    """Return the name of the file of a part."""
    return f"part-{number:05d}.parquet"


def part_number(part: Path) -> int:
    """Return the number of the part in a file."""
    return int(part.stem.removeprefix("part-"))


def part_files(folder: str | PathLike[str], numbers: Collection[int] | None = None) -> list[Path]:
    """Return the complete parts of a folder of verdicts in order; numbers: only these."""
    parts = sorted(Path(folder).glob("part-*.parquet"))
    if numbers is None:
        return parts
    return [part for part in parts if part_number(part) in numbers]


def missing_parts(folder: Path, numbers: range) -> list[int]:
    """Return the numbers of the parts that are not there."""
    return [i for i in numbers if not (folder / part_name(i)).exists()]


def unfinished_parts(folder: Path) -> list[Path]:
    """Return the files of parts that a killed run was writing."""
    return sorted(set(our_files(folder)) - set(part_files(folder)))


def our_files(folder: Path) -> list[Path]:
    """Return the files in a folder of parts that are called as `Parts` calls them."""
    if not folder.is_dir():
        return []
    return [folder / name for name in os.listdir(folder) if OURS.fullmatch(name)]


def forget_parts(folder: Path) -> None:
    """Remove all parts of a folder, and the folder if nothing else is in it."""
    for file in our_files(folder):
        file.unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


def refuse_foreign(folder: Path) -> None:
    """Raise ValueError if something in a folder of parts is called otherwise than a part."""
    if not folder.is_dir():
        return
    strangers = set(os.listdir(folder)) - {file.name for file in our_files(folder)}
    if strangers:
        raise ValueError(
            f"{folder} holds {min(strangers)}, which was not written by jaxbound: move it, or choose another "
            f"folder"
        )


def refuse_other_part(part: Path, note: Mapping[str, str]) -> None:
    """Raise ValueError if a part is damaged, none of ours, or of another identity than the note."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        about = pq.read_schema(part).metadata or {}
    except pa.ArrowException:
        about = {}
    if RUNS not in about:
        why = "which was not written by jaxbound, or is damaged"
        raise ValueError(f"{part.parent} holds {part.name}, {why}: move it, or choose another folder")
    refuse_other(part, json.loads(about.get(IDENTITY, "{}")), note)


def carry_behind(part: Path) -> list[str]:
    """Return the texts of what an observer carried behind a part, see `as_texts`."""
    import pyarrow.parquet as pq

    return list(json.loads(pq.read_schema(part).metadata[CARRY]))


def verdicts_of(
    folder: Path, source: ParquetSource, region: Region | None = None
) -> Iterator[tuple[Recording, Judged]]:
    """Yield (Recording, verdicts) of each part of a recording in order: times, and no signals. region: of
    training, which the parts speak of.
    """
    first = 0
    for part in part_files(folder):
        written, judged = _read_part(part, region)
        time, stamps = source.times(first, written)
        nothing = np.empty((len(time), 0))
        yield Recording(nothing, nothing, time=time, stamps=stamps, written=written), judged
        first += len(time)


def _read_part(part: Path, region: Region | None) -> tuple["pa.Array", Judged]:
    """Return (time column, verdicts) of a part."""
    import pyarrow.parquet as pq

    # not read_table: it would import pandas, which takes longer than to read a part
    with Damage(str(part)), pq.ParquetFile(part, page_checksum_verification=True) as f:
        table = f.read()
    column = {name: table.column(name).combine_chunks() for name in table.column_names}
    status = _word_numbers(column["status"], lambda name: Status[name]).astype(np.int8)
    judged = Judged(status, from_arrow(column["margin"]))
    if region is not None:
        by = _word_numbers(column["outside_by"], ("", *region.inputs).index) - 1
        share, reading = from_arrow(column["outside"]), from_arrow(column["outside_at"])
        judged = judged._replace(departure=Departure(share, by, reading, region))
    if "test" in column:
        names = "", *sorted({*column["test"].unique().to_pylist()} - {""})
        judged = judged._replace(by=_word_numbers(column["test"], names.index) - 1, names=names[1:])
    numbers = {}
    for name, x in column.items():
        if name not in KNOWN:
            numbers[name] = from_arrow(x.cast("float64"))
    return column["time"], judged._replace(columns=numbers)


def _word_numbers(words: "pa.Array", number: Callable[[str], int]) -> np.ndarray:
    """Return the number of each cell of a column of words, each of which is asked for once."""
    coded = words.dictionary_encode()
    numbers = np.array(list(map(number, coded.dictionary.to_pylist())), np.int16)
    codes = coded.indices.cast("int32")
    return np.asarray(numbers[np.frombuffer(codes.buffers()[1], np.int32, len(codes), 4 * codes.offset)])
