"""Verdicts of recordings larger than memory: Parquet in, Parquet out, chunk by chunk, and on after an
interruption.

Chunks overlap by the horizon, so every window is tested once, by the same compiled kernel, whatever the size
of a chunk. Verdicts are written in parts of a fixed number of samples, each completely or not at all. A part
says nothing of those before it; what was tested, and where it belongs, stands in the part itself. So the
parts are all the state there is: the same call makes those that are not there, and any number of calls may
share them that know nothing of each other. What an observer carries stands in the part behind which it is
needed: its parts follow each other, and nobody shares them; unless each part is judged by an observer of its
own, which begins some samples earlier.
"""

import json
import os
import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from jaxbound.consistency.engine import spread, stretches_for
from jaxbound.diagnosis.result import suspected
from jaxbound.files.checkpoint import from_texts, refuse_other
from jaxbound.files.whole import UNFINISHED, whole
from jaxbound.models.fingerprint import fingerprint
from jaxbound.recordings.columns import categories, to_arrow
from jaxbound.recordings.parquet import PARTIAL, VERDICTS, ParquetSource
from jaxbound.relations.identity import identity
from jaxbound.relations.sentence import remembers
from jaxbound.runs.judges import Carried, Windows
from jaxbound.runs.outputs import OutputFolder
from jaxbound.runs.partnotes import AGAIN, RUNS, Noted
from jaxbound.runs.shares import listed, numbers_of
from jaxbound.sets.floats.status import Status

if TYPE_CHECKING:
    from distributed import Client

__all__ = [
    "CHUNK",
    "PARTIAL",
    "VERDICTS",
    "all_parts",
    "forget_parts",
    "kept",
    "part_count",
    "part_files",
    "publish",
    "samples_of",
    "write_parts",
]

CHUNK = 1_000_000  # samples in memory at once
LEAST = 2**16  # and at least so many: a call of the kernel takes them anyway
PART = 1_000_000  # samples in a file of verdicts
STAGES = "read", "transfer", "compute", "write"
IDENTITY, CARRY = b"identity", b"carry"  # in the metadata of a part
OURS = re.compile(rf"part-\d{{5,}}\.parquet|\.part-\d{{5,}}\.parquet{UNFINISHED}")


def write_parts(
    relations: Any,
    source: ParquetSource,
    out: str | PathLike,
    method: str = "joint",
    chunk: int = CHUNK,
    progress: Callable | None = None,
    part: tuple[int, int] | None = None,
    client: "Client | None" = None,
    overlap: int | None = None,
) -> tuple[Path, dict[str, float]]:
    """Test a ParquetSource and write its verdicts into parts in the folder `verdicts.partial` of `out`, those
    that are not there yet.

    Args:
        As `digest.detect_dataset`; source: from `open_parquet`.

    Returns:
        (folder of the parts, {"read", "transfer", "compute", "write"}: seconds). On a CPU, transfer is the
        copying of columns into the arrays that the kernel reads. Where workers do it, their seconds are
        added.
    """
    folder, job = _begun(relations, source, Path(out), method, part, chunk, overlap)
    report, seconds = progress or (lambda share: None), dict.fromkeys(STAGES, 0.0)
    mine = numbers_of(part or (1, 1), part_count(source))
    try:
        for taken in _done(client, job, _missing(folder, mine), mine, report):
            seconds = {name: seconds[name] + more for name, more in taken.items()}
        source.unchanged()
        report(1.0)
    except ValueError:  # data that must be changed first: what was found in them is of no use then
        if part is None:
            forget_parts(folder)
        raise
    except BaseException:
        if part is None and not part_files(folder):
            forget_parts(folder)
        raise
    return folder, seconds


def _done(client, job, missing, mine, report):
    """Let a job write the parts that are missing, of the numbers in `mine`; yield the seconds of each
    task.
    """
    stretches, left = _stretches(missing), len(missing)
    if client is not None:
        tasks = stretches if job.follows else stretches_for(client, stretches)
        report(1 - left / max(len(mine), 1))
        for number, (seconds, digests) in spread(client, job, tasks) if tasks else ():
            left -= len(tasks[number])
            report(1 - left / len(mine))
            job.source.digests.update(digests)  # the recording is not read again to know what it holds
            yield seconds
        return
    first, end = mine.start * PART, min(mine.stop * PART, job.source.samples)
    for parts in stretches:
        yield job.run(parts, lambda done: report((done - first) / (end - first)))[0]


def all_parts(
    relations: Any,
    source: ParquetSource,
    out: str | PathLike,
    method: str = "joint",
    overlap: int | None = None,
) -> Path:
    """Return the folder of the parts that `write_parts` made of the same.

    Raises:
        ValueError: some are not there, or of another model, recording, version or method.
    """
    folder, _ = _begun(relations, source, Path(out), method, overlap=overlap)
    count = part_count(source)
    if missing := _missing(folder, range(count)):
        lacking = f"{folder} lacks {listed(missing, _name)}, {len(missing)} of {count} parts"
        raise ValueError(f"{lacking}: the same without merge makes only these")
    return folder


def part_count(source: ParquetSource) -> int:
    """Return the number of parts of a ParquetSource."""
    return -(-source.samples // PART)


def samples_of(numbers: range, source: ParquetSource) -> tuple[int | None, int | None]:
    """Return the first and the last sample of the parts with these numbers; (None, None) of none."""
    return (numbers.start * PART, min(numbers.stop * PART, source.samples) - 1) if numbers else (None, None)


def _missing(folder, numbers):
    """Return the numbers of the parts that are not there."""
    return [i for i in numbers if not (folder / _name(i)).exists()]


def _stretches(numbers):
    """Return the ranges that numbers in order consist of."""
    stretches = np.split(np.array(numbers, int), np.flatnonzero(np.diff(numbers) > 1) + 1)
    return [range(int(x[0]), int(x[-1]) + 1) for x in stretches if len(x)]


def _name(number):
    return f"part-{number:05d}.parquet"


def _number(part):
    return int(part.stem.removeprefix("part-"))


@dataclass(frozen=True, eq=False)
class _Judging:
    """The test of a recording as a `Job`: a task is a range of parts, each of which it writes completely or
    not at all.

    Fields: relations, source, method: as for `write_parts`. folder: of the parts. chunk: samples in memory at
    once. size: of a part, in samples. common: what all parts depend on. overlap: samples that an observer of
    its own is given before each part; None: one for all.
    """

    relations: Any
    source: ParquetSource
    folder: Path
    method: str
    chunk: int
    size: int
    common: dict
    overlap: int | None = None
    chain: list = field(
        default_factory=list
    )  # of what follows: digests of the recording up to the end of each part

    @property
    def follows(self):
        """Whether a part needs what was carried through all those before it."""
        return remembers(self.relations) and self.overlap is None

    def note(self, number):
        """Return what the verdicts in a part depend on, before any of it is read."""
        before = self.relations.horizon if self.overlap is None else self.overlap
        content = self._content_up_to(number) if self.follows else self._content(number, before)
        place = f"part {number} of {self.size} samples each"
        return self.common | {"place in the recording": place, "content of the recording": content}

    def _content(self, number, before):
        first, stop = max(number * self.size - before, 0), min((number + 1) * self.size, self.source.samples)
        return self.source.content_of(first, stop)

    def _content_up_to(self, number):
        """Return a digest of all samples up to the end of a part: of that of the part before, and its own."""
        while len(self.chain) <= number:
            so_far = [*self.chain[-1:], self._content(len(self.chain), 0)]
            self.chain.append(blake2b(" ".join(so_far).encode(), digest_size=32).hexdigest())
        return self.chain[number]

    def run(self, parts, report=lambda done: None):
        """Write the parts of a range that are not there; return (seconds that each stage took, digests of
        what was read).

        Args:
            report: called with the number of the sample that is done.
        """
        seconds = dict.fromkeys(STAGES, 0.0)
        for missing in _stretches(
            _missing(self.folder, parts)
        ):  # some are there if a worker died with this task
            for together in [missing] if self.overlap is None else [range(i, i + 1) for i in missing]:
                self._write(together, report, _Lap(seconds))
        return seconds, self.source.digests

    def _write(self, parts, report, lap):
        judge = _judge(self, parts.start)
        about = Noted(self.source.samples, self.relations.model)
        pending = _Pending(
            self.folder, {i: self.note(i) for i in parts}, parts.start * self.size, self.size, about
        )
        done, end = parts.start * self.size, min(parts.stop * self.size, self.source.samples)
        report(done)
        for first, piece in self.source.pieces(self.chunk, judge.overlap, max(done - judge.begins, 0), end):
            lap("read")
            u, y = jax.block_until_ready(jax.device_put((piece.u, piece.y)))
            lap("transfer")
            part_of_it = [] if piece.excluded is None else [np.where(piece.excluded, np.nan, 1)[:, None]]
            signals = np.concatenate([piece.u, piece.y, *part_of_it], 1)
            stop = first + piece.samples
            for fresh, status, margin, carry in judge(replace(piece, u=u, y=y), first, done):
                lap("compute")
                done = first + fresh.stop
                pending.add(
                    piece.column[fresh], status, margin, signals[fresh], done == end, carry, judge.again
                )
                lap("write")
            assert done == stop
            report(done)


def _judge(job, part):
    """Return the Windows or the Carried of a _Judging, before the part with this number."""
    if not remembers(job.relations):
        return Windows(job.relations, job.method, job.source.samples)
    import pyarrow.parquet as pq

    watch = job.relations.test(job.method)
    carry = watch.init()
    if part and job.follows:
        before = pq.read_schema(job.folder / _name(part - 1)).metadata
        carry = from_texts(carry, json.loads(before[CARRY]))
    return Carried(watch, carry, job.size, job.overlap)


def part_files(folder: str | PathLike, numbers: Any = None) -> list[Path]:
    """Return the complete parts of a folder of verdicts in order; numbers: only these."""
    parts = sorted(Path(folder).glob("part-*.parquet"))
    return parts if numbers is None else [p for p in parts if _number(p) in numbers]


def kept(folder: str | PathLike, samples: int) -> int:
    """Return how many of the samples have their verdict in complete parts."""
    return min(PART * len(part_files(folder)), samples)


def publish(folder: OutputFolder) -> None:
    """Turn the complete parts in an `outputs.OutputFolder` into its verdicts, in the place of older ones."""
    for file in set(_ours(folder.path / PARTIAL)) - set(part_files(folder.path / PARTIAL)):
        file.unlink()  # what a killed run was writing
    folder.put({VERDICTS: folder.path / PARTIAL})


def forget_parts(parts: Path) -> None:
    """Remove what `write_parts` wrote into a folder, and the folder if nothing else is in it."""
    for file in _ours(parts):
        file.unlink(missing_ok=True)
    with suppress(OSError):
        parts.rmdir()


def _ours(parts):
    """Return the files in a folder of parts that are called as `write_parts` calls them."""
    return [parts / name for name in (os.listdir(parts) if parts.is_dir() else ()) if OURS.fullmatch(name)]


class _Lap:
    """Adds the time since the last call to a name."""

    def __init__(self, seconds):
        self.seconds, self.last = seconds, time.perf_counter()

    def __call__(self, name):
        now = time.perf_counter()
        self.seconds[name], self.last = self.seconds[name] + now - self.last, now


class _Pending:
    """Verdicts on their way into parts of `size` samples."""

    def __init__(self, folder, notes, done, size, noted):
        self.folder, self.notes, self.done, self.size, self.noted, self.held = (
            folder,
            notes,
            done,
            size,
            noted,
            [],
        )

    def add(self, written, status, margin, signals, last, carry=None, again=None):
        """Take the next verdicts and their samples; write the parts that they complete, and what is left if
        they are the last.

        carry: what goes with the last of them; verdicts with a carry end where a part does. again: see
        `Windows`, whose it is to take.
        """
        import pyarrow as pa

        self.held.append((written, status, margin, signals))
        while (rows := sum(len(x[1]) for x in self.held)) >= self.size or (last and rows):
            written, *rest = zip(*self.held, strict=True)
            whole = (pa.concat_arrays(written), *map(np.concatenate, rest))
            self._write(carry, again or {}, *(x[: self.size] for x in whole))
            self.held = [tuple(x[self.size :] for x in whole)]

    def _write(self, carry, again, written, status, margin, signals):
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = {
            "time": written,
            "status": categories([x.name for x in Status], status),
            "margin": to_arrow(margin),
            "suspect": to_arrow(suspected(status, margin)),
        }
        number = self.done // self.size
        about = self.noted.of(self.done, signals) | {IDENTITY: json.dumps(self.notes[number])}
        about |= {} if carry is None else {CARRY: json.dumps(carry)}
        about |= {AGAIN: json.dumps(again)} if again else {}
        again.clear()
        path = self.folder / _name(number)
        self.folder.mkdir(parents=True, exist_ok=True)
        if path.exists():  # another share has made it meanwhile
            _refuse_other(path, self.notes[number])
        with whole(path, links=False) as f:
            pq.write_table(
                pa.table(columns).replace_schema_metadata(about),
                f,
                use_dictionary=["status"],
                write_page_checksum=True,
            )
        self.done += len(status)


def _begun(relations, source, out, method, part=None, chunk=CHUNK, overlap=None):
    """Return (folder for the parts, _Judging that makes them); refuse what is of another run, or not ours at
    all.

    A share looks at the content of its own parts only: where many are made at once, each reads what it judges
    and not all of the recording.
    """
    relations.test(method, source.dtype)  # refuses what these relations cannot be tested by
    if overlap is not None and not remembers(relations):
        raise ValueError("overlap is for observers: windows know how far they reach back")
    if overlap is not None and (
        isinstance(overlap, bool) or not isinstance(overlap, int | np.integer) or overlap < 0
    ):
        raise ValueError(f"overlap is a whole number of samples >= 0, not {overlap!r}")
    if part is not None and remembers(relations) and overlap is None:
        raise ValueError(
            "an observer carries what it knows from each part to the next: they cannot be shared, unless "
            "each part has an observer of its "
            "own that begins so many samples earlier: give an overlap"
        )
    if source.samples <= relations.horizon:
        raise ValueError(
            f"{source.path}: the recording has {source.samples} samples, one window needs "
            f"{relations.horizon + 1}"
        )
    begins = None if overlap is None else int(overlap)
    also = {"overlap": "none" if begins is None else begins} if remembers(relations) else {}
    folder, common = (
        out / PARTIAL,
        identity(relations, method=method, recording=fingerprint(source.layout), **also),
    )
    chunk = max(chunk, LEAST, relations.horizon + 1, (begins or 0) + 1)
    job = _Judging(relations, source, folder, method, chunk, PART, common, begins)
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} is a file: move it, or choose another folder")
    strangers = set(os.listdir(folder)) - {p.name for p in _ours(folder)} if folder.is_dir() else ()
    mine = numbers_of(part or (1, 1), part_count(source))
    for file in part_files(folder):
        _refuse_other(file, job.note(_number(file)) if _number(file) in mine else common)
    if strangers:
        raise ValueError(
            f"{folder} holds {min(strangers)}, which was not written by jaxbound: move it, or choose another "
            f"folder"
        )
    return folder, job


def _refuse_other(part, note):
    """Raise ValueError if a part is damaged, none of ours, or not what belongs under its name."""
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
