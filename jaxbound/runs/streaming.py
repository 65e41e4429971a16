"""Verdicts of recordings larger than memory: Parquet in, parts out, chunk by chunk, and on after an
interruption.

Chunks overlap by the horizon, so every window is tested once, by the same compiled kernel, whatever the size
of a chunk. Parts are all the state there is (see `parts`): the same call makes those that are not there, and
any number of calls may share them that know nothing of each other. The parts of an observer follow each
other, and nobody shares them; unless each part is judged by an observer of its own, which begins some samples
earlier.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import blake2b
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxbound.consistency.interface import Observer, Relations, WindowTest, margins_for, with_margins
from jaxbound.files.checkpoint import from_texts
from jaxbound.models.fingerprint import fingerprint
from jaxbound.recordings.contents import Digests
from jaxbound.recordings.parquet import PARTIAL, VERDICTS, ParquetSource
from jaxbound.relations.identity import identity
from jaxbound.runs.ask import Ask
from jaxbound.runs.judges import Carried, Windows
from jaxbound.runs.loop import Laps, follow
from jaxbound.runs.outputs import OutputFolder
from jaxbound.runs.partnotes import Noted
from jaxbound.runs.parts import (
    Parts,
    carry_behind,
    forget_parts,
    missing_parts,
    part_files,
    part_name,
    part_number,
    refuse_foreign,
    refuse_other_part,
    unfinished_parts,
)
from jaxbound.runs.shares import part_numbers, stretches_listed
from jaxbound.text.progress import Progress, reporter
from jaxbound.workers.engine import spread, stretches_for

if TYPE_CHECKING:
    from distributed import Client

CHUNK = 1_000_000  # samples in memory at once
LEAST = 2**16  # and at least so many: a call of the kernel takes them anyway
PART = 1_000_000  # samples in a file of verdicts
STAGES = "read", "transfer", "compute", "write"


@dataclass(frozen=True, eq=False)
class Asked:
    """The test that a recording in parts is to be given.

    Fields: relations: that ask says how to test. overlap: samples that an observer of its own is given before
    each part; None: one for all. chunk: samples in memory at once.
    """

    relations: Relations
    ask: Ask = Ask()
    overlap: int | None = None
    chunk: int = CHUNK

    def test_of(self, source: ParquetSource) -> WindowTest | Observer[Any]:
        """Return the test of a recording; refuse what these relations cannot be tested by."""
        test = self.relations.test(self.ask.method, source.dtype)
        return with_margins(test, self.ask.margins, source.samples - self.relations.horizon)


def write_parts(
    asked: Asked,
    source: ParquetSource,
    out: str | PathLike[str],
    progress: Progress | None = None,
    part: tuple[int, int] | None = None,
    client: "Client | None" = None,
) -> tuple[Path, dict[str, float]]:
    """Test a ParquetSource and write the parts that are missing in the folder `verdicts.partial` of `out`.

    Args:
        As `digest.detect_dataset`; source: from `open_parquet`.

    Returns:
        (folder of the parts, {"read", "transfer", "compute", "write"}: seconds). On a CPU, transfer is the
        copying of columns into the arrays that the kernel reads. Where workers do it, their seconds are
        added.
    """
    folder, job = _job_of(asked, source, Path(out), part)
    report = reporter(progress)
    seconds = dict.fromkeys(STAGES, 0.0)
    mine = part_numbers(part or (1, 1), part_count(source))
    missing = missing_parts(folder, mine)
    if client is None:
        tasks = _write_here(job, missing, mine, report)
    else:
        tasks = _write_by_workers(client, job, missing, mine, report)
    try:
        for task in tasks:
            for stage, more in task.items():
                seconds[stage] += more
        source.unchanged()
        report(1.0)
    except ValueError:  # data that must be changed first: their verdicts are of no use then
        if part is None:
            forget_parts(folder)
        raise
    except BaseException:
        if part is None and not part_files(folder):
            forget_parts(folder)
        raise
    return folder, seconds


def _write_here(
    job: "_Judging", missing: list[int], mine: range, report: Progress
) -> Iterator[dict[str, float]]:
    """Write the missing parts in this process; yield the seconds of each stretch of them."""
    first, end = mine.start * PART, min(mine.stop * PART, job.source.samples)
    for parts in _ranges_of(missing):
        seconds, _ = job.run(parts, lambda done: report((done - first) / (end - first)))
        yield seconds


def _write_by_workers(
    client: "Client", job: "_Judging", missing: list[int], mine: range, report: Progress
) -> Iterator[dict[str, float]]:
    """Let workers write the missing parts; yield the seconds of each task."""
    tasks, left = _ranges_of(missing), len(missing)
    if not job.follows:
        tasks = stretches_for(client, tasks)
    report(1 - left / max(len(mine), 1))
    if not tasks:
        return
    for number, (seconds, digests) in spread(client, job, tasks):
        left -= len(tasks[number])
        report(1 - left / len(mine))
        job.source.digests.update(digests)  # the recording is not read again for its digest
        yield seconds


def all_parts(asked: Asked, source: ParquetSource, out: str | PathLike[str]) -> Path:
    """Return the folder of the parts that `write_parts` made of the same.

    Raises:
        ValueError: some are not there, or of another model, recording, version or method.
    """
    folder, _ = _job_of(asked, source, Path(out))
    count = part_count(source)
    missing = missing_parts(folder, range(count))
    if missing:
        lacking = f"{folder} lacks {stretches_listed(missing, part_name)}, {len(missing)} of {count} parts"
        raise ValueError(f"{lacking}: the same without merge makes only these")
    return folder


def part_count(source: ParquetSource) -> int:
    """Return the number of parts of a ParquetSource."""
    return -(-source.samples // PART)


def sample_range(numbers: range, source: ParquetSource) -> tuple[int | None, int | None]:
    """Return the first and the last sample of the parts with these numbers; (None, None) of none."""
    if not numbers:
        return None, None
    return numbers.start * PART, min(numbers.stop * PART, source.samples) - 1


def kept(folder: str | PathLike[str], samples: int) -> int:
    """Return how many of the samples have their verdict in complete parts."""
    return min(PART * len(part_files(folder)), samples)


def publish(folder: OutputFolder) -> None:
    """Turn the complete parts in an `outputs.OutputFolder` into its verdicts, in the place of older ones."""
    for file in unfinished_parts(folder.path / PARTIAL):
        file.unlink()
    folder.put({VERDICTS: folder.path / PARTIAL})


def _ranges_of(numbers: Sequence[int]) -> list[range]:
    """Return the ranges that numbers in order consist of."""
    stretches: list[range] = []
    for number in numbers:
        if stretches and stretches[-1].stop == number:
            stretches[-1] = range(stretches[-1].start, number + 1)
        else:
            stretches.append(range(number, number + 1))
    return stretches


@dataclass(frozen=True, eq=False)
class _Judging:
    """The test of a recording as a `Job`: a task is a range of parts, each written completely or not at all.

    Fields: asked, source: as for `write_parts`. folder: of the parts. size: of a part, in samples. common:
    what all parts depend on. chain: of parts that follow each other, digests of the recording up to the end
    of each.
    """

    asked: Asked
    source: ParquetSource
    folder: Path
    size: int
    common: dict[str, str]
    chain: list[str] = field(default_factory=list)

    @property
    def follows(self) -> bool:
        """Whether a part needs the carry of all those before it."""
        return self.asked.relations.remembers and self.asked.overlap is None

    def note(self, number: int) -> dict[str, str]:
        """Return {name: text} of all that the verdicts in a part depend on, before any of it is read."""
        if self.follows:
            content = self._content_up_to(number)
        elif self.asked.overlap is not None:
            content = self._content(number, self.asked.overlap)
        else:
            content = self._content(number, self.asked.relations.horizon)
        place = f"part {number} of {self.size} samples each"
        return self.common | {"place in the recording": place, "content of the recording": content}

    def _content(self, number: int, before: int) -> str:
        """Return a digest of the samples of a part, and of so many before them."""
        first = max(number * self.size - before, 0)
        return self.source.content_of(first, min((number + 1) * self.size, self.source.samples))

    def _content_up_to(self, number: int) -> str:
        """Return a digest of all samples up to the end of a part: of that of the part before, and its own."""
        while len(self.chain) <= number:
            so_far = [*self.chain[-1:], self._content(len(self.chain), 0)]
            self.chain.append(blake2b(" ".join(so_far).encode(), digest_size=32).hexdigest())
        return self.chain[number]

    def run(
        self, parts: range, report: Callable[[int], object] = lambda done: None
    ) -> tuple[dict[str, float], Digests]:
        """Write the parts of a range that are not there.

        Args:
            report: called with the number of the sample that is done.

        Returns:
            (seconds that each stage took, digests of the blocks that were read).
        """
        seconds = dict.fromkeys(STAGES, 0.0)
        # some are there if a worker died with this task
        for stretch in _ranges_of(missing_parts(self.folder, parts)):
            for together in self._together(stretch):
                self._write(together, report, seconds)
        return seconds, self.source.digests

    def _together(self, parts: range) -> list[range]:
        """Return the ranges of parts that one judge takes: all, or each by itself."""
        if self.asked.overlap is None:
            return [parts]
        return [range(i, i + 1) for i in parts]

    def _write(self, parts: range, report: Callable[[int], object], seconds: dict[str, float]) -> None:
        """Write parts that follow each other; whatever one judge takes is read and judged once."""
        first, end = parts.start * self.size, min(parts.stop * self.size, self.source.samples)
        notes = {i: self.note(i) for i in parts}
        laps = Laps(seconds)
        judge = self._judge(parts.start, laps)
        about = Noted(self.source.samples, self.asked.relations)
        sink = Parts(self.folder, notes, self.size, end, about, judge)
        # windows of the first samples reach back into the part before
        pieces = self.source.pieces(self.asked.chunk, judge.overlap, max(first - judge.begins, 0), end)
        report(first)
        for at, piece in follow(pieces, judge, [sink], laps=laps):
            report(at + piece.samples)

    def _judge(self, part: int, laps: Laps) -> Windows | Carried[Any]:
        """Return the judge of the samples from a part on."""
        done, asked = part * self.size, self.asked
        if not asked.relations.remembers:
            test = partial(asked.ask.detect, asked.relations)
            return Windows(test, asked.relations.horizon, done, laps)
        observer = asked.test_of(self.source)
        assert observer.remembers, "what remembers is an observer"
        carry = observer.init()
        if part and self.follows:
            carry = from_texts(carry, carry_behind(self.folder / part_name(part - 1)))
        return Carried(observer, carry, self.size, done, laps, asked.overlap, asked.ask.outside)


def _job_of(
    asked: Asked, source: ParquetSource, out: Path, part: tuple[int, int] | None = None
) -> tuple[Path, _Judging]:
    """Return (folder for the parts, _Judging that makes them); refuse parts of another run, or not ours.

    A share looks at the content of its own parts only: where many are made at once, each reads what it judges
    and not all of the recording.
    """
    relations, test = asked.relations, asked.test_of(source)
    begins = _begins(relations, part, asked.overlap)
    if source.samples <= relations.horizon:
        raise ValueError(
            f"{source.path}: the recording has {source.samples} samples, one window needs "
            f"{relations.horizon + 1}"
        )
    also: dict[str, str | int] = {"margins": test.margins_are, "word outside training": asked.ask.outside}
    if relations.remembers:
        also["overlap"] = begins if begins is not None else "none"
    folder = out / PARTIAL
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} is a file: move it, or choose another folder")
    common = identity(relations, method=asked.ask.method, recording=fingerprint(source.layout), **also)
    chunk = max(asked.chunk, LEAST, relations.horizon + 1, (begins or 0) + 1)
    kind = margins_for(asked.ask.margins, source.samples - relations.horizon)
    asked = Asked(relations, replace(asked.ask, margins=kind), begins, chunk)
    job = _Judging(asked, source, folder, PART, common)
    mine = part_numbers(part or (1, 1), part_count(source))
    for file in part_files(folder):
        number = part_number(file)
        if number in mine:
            refuse_other_part(file, job.note(number))
        else:
            refuse_other_part(file, common)
    refuse_foreign(folder)
    return folder, job


def _begins(relations: Relations, part: tuple[int, int] | None, overlap: int | None) -> int | None:
    """Return how many samples before each part an observer of its own begins; refuse what is none."""
    of_windows = relations.looks_back if relations.parts else None
    if overlap is None:
        if of_windows is not None:
            return of_windows  # behind so many samples a part has the verdicts of the whole
        if part is not None and relations.remembers:
            raise ValueError(
                "an observer carries what it knows from each part to the next: they cannot be shared, unless "
                "each part has an observer of its "
                "own that begins so many samples earlier: give an overlap"
            )
        return None
    if not relations.remembers or of_windows is not None:
        raise ValueError("overlap is for observers: windows know how far they reach back")
    if isinstance(overlap, bool) or not isinstance(overlap, int | np.integer) or overlap < 0:
        raise ValueError(f"overlap is a whole number of samples >= 0, not {overlap!r}")
    return int(overlap)
