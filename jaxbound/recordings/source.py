"""Sources of recordings: one file a kind, which every verb and command takes once it is registered.

A kind whose recordings fit into memory says which data are its own (`takes`) and makes a Recording of them
(`whole`); the rest is here.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxbound.recordings.contents import Digests, content
from jaxbound.recordings.hints import missing_hints, rounding_hints
from jaxbound.recordings.means import Unfinished
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.recordingformat import RecordingFormat
from jaxbound.recordings.seams import Clock, around, irregular, seam_hints, tick, varied_hints
from jaxbound.recordings.selection import Wanted, where_hints
from jaxbound.recordings.signals import Named, SignalModel
from jaxbound.recordings.stillness import still_hints
from jaxbound.text.progress import Progress, reporter

__all__ = [
    "KINDS",
    "NUMBER",
    "Outline",
    "PROBE",
    "TEXT",
    "PartSource",
    "Progress",
    "Source",
    "register",
    "with_hints",
]

PROBE = 100_000  # samples that show the sampling period, the unit of time and the rounding of the recorder
NUMBER, TEXT, WORDS = "number", "text", "words"
"""Kinds of columns that are no times: of words nobody knows whether they stand for numbers, like ON."""
KINDS: list[type["Source"]] = []  # of users; the last that takes the data opens them


def register(kind: type["Source"]) -> type["Source"]:
    r"""Make every verb and command read this kind of source; of several that take the same data the one
    registered last does.

    It is asked before those of jaxbound, which stand in a list in `read`.

    Args:
        kind: a subclass of Source.

    Example:
        >>> import json, tempfile, jaxbound as jb
        >>> from pathlib import Path
        >>> from jaxbound.recordings.source import KINDS, Source, register
        >>> @register
        ... class JsonLines(Source):
        ...     @classmethod
        ...     def takes(cls, data):
        ...         return str(data).endswith(".jsonl")
        ...     def whole(self, progress=None):
        ...         rows = [json.loads(line) for line in Path(self.data).read_text().splitlines()]
        ...         columns = {name: [row[name] for row in rows] for name in rows[0]}
        ...         return jb.Recording.of(self.model, columns)
        >>> with tempfile.NamedTemporaryFile("w", suffix=".jsonl") as f:
        ...     _ = f.write('{"y1": 1.0}\n{"y1": 0.8}'), f.flush()
        ...     run = jb.read(f.name, jb.LinearSystem([[0.5]], None, [[1]], noise=0.1))
        >>> run.y.tolist(), KINDS.pop() is JsonLines
        ([[1.0], [0.8]], True)
    """
    KINDS.append(kind)
    return kind


class Outline(NamedTuple):
    """How data are written, before they are read.

    Fields: how: in words. kinds: {column: `NUMBER`, `TEXT`, `WORDS`, or the kind of a time, see
    `stamp_kind`}. taken: fields of a RecordingFormat that say so.
    """

    how: str
    kinds: Mapping[str, str]
    taken: Mapping[str, Any] = {}


class Source:
    """One recording and how it is read. Made by `open`, which is asked of the kind that `takes` the data.

    Args:
        data: as given, of most kinds a path. model: whose signals are wanted.
    """

    parts = False
    """Whether it is read in pieces, so that its size does not matter, and verdicts are written in parts."""
    as_recorded = False
    """Whether samples are read with their own times where the model's are means, see `meansource`; other
    kinds leave that to `Recording.of`."""
    live = False
    """Whether samples come as time goes by: they are judged by a Monitor, see `live.LiveSource`."""
    rest: Unfinished | None = None
    """The samples that are in no mean of an interval yet, once they were read; None: there are no means."""
    _whole: Recording | None = None
    """The data as they were read first."""

    def __init__(self, data: object, model: SignalModel) -> None:
        self.data, self.model = data, model

    @classmethod
    def takes(cls, data: object) -> bool:
        """Return whether data are of this kind, by what they are called or how they begin."""
        raise NotImplementedError

    @classmethod
    def open(cls, data: object, model: SignalModel) -> "Source":
        """Return the source of these data."""
        return cls(data, model)

    @classmethod
    def outline(cls, data: object, how: RecordingFormat) -> Outline:
        """Return how these data are written. how: what is stated of that.

        Raises:
            ValueError: a kind whose columns are not known before it is read.
        """
        raise ValueError(f"{data} can be read once only: save it in a file to look at it")

    @classmethod
    @contextmanager
    def kept(cls, data: object, most: int | None = None) -> Iterator[object]:
        """Yield data that can be read more than once: these, of a pipe a file with its bytes.

        Args:
            most: bytes of a pipe that are read.
        """
        yield data

    @classmethod
    def digest(cls, data: object) -> str | None:
        """Return the digest of the data, by which they are known again; None where what was read is gone, as
        of a pipe or of arrays. See `contents`.
        """
        if isinstance(data, str | PathLike) and (Path(data).is_file() or Path(data).is_dir()):
            return content(Path(data))
        return None

    def behind(self, before: Unfinished | None) -> "Source":
        """Return the source that goes on behind the `rest` of a recording before."""
        return self

    def whole(self, progress: Progress | None = None) -> Recording:
        """Read everything. progress: called with the share of the work done."""
        raise NotImplementedError

    @cached_property
    def content(self) -> str | None:
        """The digest of the data as they are when it is first asked for."""
        return self.digest(self.data)

    @property
    def layout(self) -> str:
        """The facts that are known of the data before they are read, as text; without any, their digest."""
        return str(self.content)

    def content_of(self, first: int, stop: int) -> str:
        """Return a digest of the bytes that the samples first .. stop - 1 are read from; where these are not
        known, of all data.
        """
        return str(self.content)

    @cached_property
    def digests(self) -> Digests:
        """Digests of blocks that are known so far, as `contents` has them; those that another process has
        read may be added.
        """
        return {}

    @property
    def label(self) -> str:
        """The name of the recording for a reader."""
        return Path(str(self.data)).name

    @property
    def samples(self) -> int | None:
        """The number of samples; None: not known before the end."""
        return self.read().samples

    def read(self, first: int = 0, stop: int | None = None, progress: Progress | None = None) -> Recording:
        """Return the samples first .. stop - 1, by default all, with hints only if that is all of them.

        Raises:
            OSError, ValueError: data that are no recording of this model.
        """
        if self._whole is None:
            self._whole = self._timed(progress)
        whole = self._whole
        if stop is None:
            stop = whole.samples
        if (first, stop) == (0, whole.samples):
            return whole
        return whole.cut(first, stop)

    def _timed(self, progress: Progress | None) -> Recording:
        """Return all data as a Recording that has times."""
        try:
            whole = self.whole(progress)
        except ValueError as e:
            name = self.data if isinstance(self.data, str | PathLike) else self.label
            raise ValueError(f"{name}: {e}") from None
        time = whole.time
        if time is None:
            time = np.arange(whole.samples) * (self.model.dt or 1.0)
        return replace(whole, time=time, source=whole.source or self.label)

    def pieces(
        self, size: int, overlap: int = 0, first: int = 0, stop: int | None = None
    ) -> Iterator[tuple[int, Recording]]:
        """Yield (number of its first sample, Recording) of `size` samples each, behind the `overlap` samples
        before them that there are.
        """
        end = stop
        if end is None:
            end = self.samples or 0
        for at in range(first, end, size):
            begin = max(at - overlap, first)
            yield begin, self.read(begin, min(at + size, end))

    def find(self, text: str) -> int | None:
        """Return the number of the sample whose time is written so; None: there is none, or times are no
        texts.
        """
        written = self.read().written
        if written is None or str(written.type) != "string":
            return None
        at: int = written.index(text).as_py()
        if at < 0:
            return None
        return at


def with_hints(
    model: Named, r: Recording, row: Callable[[int], str], where: str, first: Sequence[str] = ()
) -> Recording:
    """Return a whole recording as it was read with its seams, and with sentences for its owner.

    Args:
        r: without starts and hints. row: number of a sample -> "row 7". where: the condition of the model as
            text. first: sentences.

    Raises:
        ValueError: more seams than steps of one sampling period.
    """
    if not getattr(model, "regular", True):
        return replace(r, hints=tuple(first))
    clock, starts = tick(Clock(r.dt or 1.0), r.time)
    sentence = irregular(clock, r.label, row, r.time)
    if sentence:
        raise ValueError(sentence)
    hints = [
        *first,
        *varied_hints(clock, r.time),
        *seam_hints(clock, r.label, row),
        *missing_hints(model, r.u, r.y, r.excluded),
    ]
    hints += [*rounding_hints(model, r.y), *still_hints(model, r.u, r.y, r.label)]
    if r.excluded is not None:
        starts = np.union1d(starts, around(r.excluded))
        hints += where_hints(where, int(np.count_nonzero(r.excluded)), r.samples)
    return replace(r, starts=starts, hints=tuple(hints))


class PartSource(Source):
    """A source whose samples are read in chunks, so that its size does not matter.

    Fields: path: as given; dt: sampling period in s; hints: sentences on how it is read; plan: the columns
    that are read.
    """

    parts = True
    path: Path
    dt: float
    hints: tuple[str, ...]
    plan: Wanted

    @property
    def zero(self) -> np.datetime64 | None:
        """The time stamp of 0 s, or None where the time is in seconds."""
        raise NotImplementedError

    def stamp(self, seconds: float) -> np.datetime64 | None:
        """Return the time stamp that lies so many seconds behind the first, or None where the time is in
        seconds.
        """
        if self.zero is None:
            return None
        return self.zero + np.timedelta64(round(seconds * 1e9), "ns")

    def row(self, k: int) -> str:
        """Return how the user finds sample k."""
        raise NotImplementedError

    def chunks(self, first: int, stop: int, size: int) -> Iterator[tuple[int, Recording]]:
        """Yield (number of its first sample, Recording without starts and hints) of `size` samples each."""
        raise NotImplementedError

    def pieces(
        self, size: int, overlap: int = 0, first: int = 0, stop: int | None = None
    ) -> Iterator[tuple[int, Recording]]:
        """Yield (number of its first sample, Recording) of `size` samples each, behind the `overlap` before
        them.
        """
        tail: Recording | None = None
        clock: Clock | None = None
        for start, chunk in self.chunks(first, self._end(stop), size):
            if clock is None:
                clock = Clock(self.dt, samples=start)
            clock, seams = tick(clock, chunk.time)
            piece = chunk
            if tail is not None:
                piece = tail.followed(chunk)
            origin = start + chunk.samples - piece.samples
            seams = np.concatenate([piece.starts, seams[seams > origin] - origin])
            piece = replace(piece, starts=np.union1d(seams, around(piece.excluded)))
            yield origin, piece
            tail = piece.cut(max(piece.samples - overlap, 0), piece.samples)

    def read(self, first: int = 0, stop: int | None = None, progress: Progress | None = None) -> Recording:
        """Return the samples first..stop as one Recording, with its seams; hints only if that is all of them.

        Raises:
            ValueError: more seams than steps of one sampling period, if these are all samples.
        """
        end = self._end(stop)
        ((_, r),) = self.chunks(first, end, end - first)
        reporter(progress)(0.9)
        if end - first < self._end(None):
            _, seams = tick(Clock(self.dt), r.time)
            return replace(r, starts=np.union1d(seams, around(r.excluded)))
        try:
            return with_hints(self.model, r, self.row, self.plan.condition, self.hints)
        except ValueError as e:
            raise ValueError(f"{self.path}: {e}") from None

    def probe(self) -> Recording:
        """Return the first 100 000 samples."""
        ((_, r),) = self.chunks(0, min(self._end(None), PROBE), PROBE)
        return r

    def find(self, text: str) -> None:
        """Return None: times are not searched in files, but found by number."""
        return None

    def _end(self, stop: int | None) -> int:
        if stop is None:
            return self.samples or 0
        return stop
