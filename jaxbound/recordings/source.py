"""Where recordings come from: one file a kind of source, which every verb and command takes once it is
registered.

A kind whose recordings fit into memory says which data are its own (`takes`) and makes a Recording of them
(`whole`); the rest is here.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from jaxbound.recordings.contents import content
from jaxbound.recordings.hints import missing_hints, rounding_hints
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import Clock, around, irregular, seam_hints, tick
from jaxbound.recordings.selection import where_hints
from jaxbound.recordings.stillness import still_hints

__all__ = ["KINDS", "Source", "overlapping", "register", "told"]

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


class Source:
    """One recording and how it is read. Made by `open`, which is asked of the kind that `takes` the data.

    Args:
        data: as given, of most kinds a path. model: whose signals are wanted.
    """

    parts = False
    """Whether it is read in pieces, so that its size does not matter, and verdicts are written in parts."""
    live = False
    """Whether samples come as time goes by: they are judged by a Monitor, see `live.LiveSource`."""

    def __init__(self, data: object, model: Any) -> None:
        self.data, self.model = data, model

    @classmethod
    def takes(cls, data: object) -> bool:
        """Return whether data are of this kind, by what they are called or how they begin."""
        raise NotImplementedError

    @classmethod
    def open(cls, data: object, model: Any) -> "Source":
        """Return the source of these data."""
        return cls(data, model)

    @classmethod
    def digest(cls, data: object) -> str | None:
        """Return what the data hold as a digest, by which they are known again; None where what was read is
        gone. See `contents`.
        """
        return content(Path(str(data)))

    def whole(self, progress: Callable | None = None) -> Recording:
        """Read everything. progress: called with the share of the work done."""
        raise NotImplementedError

    @cached_property
    def content(self) -> str | None:
        """The digest of the data as they are when it is first asked for."""
        return self.digest(self.data)

    @property
    def layout(self) -> str:
        """What is known of the data before they are read, as text; where that is nothing, their digest."""
        return str(self.content)

    def content_of(self, first: int, stop: int) -> str:
        """Return a digest of what the samples first .. stop - 1 are read from; where that is not known, of
        all data.
        """
        return str(self.content)

    @cached_property
    def digests(self) -> dict:
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

    def read(self, first: int = 0, stop: int | None = None, progress: Callable | None = None) -> Recording:
        """Return the samples first .. stop - 1, by default all, with hints only if that is all of them.

        Raises:
            OSError, ValueError: data that are no recording of this model.
        """
        if "_whole" not in self.__dict__:
            try:
                found = self.whole(progress)
            except ValueError as e:
                name = self.data if isinstance(self.data, str | PathLike) else self.label
                raise ValueError(f"{name}: {e}") from None
            time = np.arange(found.samples) * (self.model.dt or 1.0) if found.time is None else found.time
            self._whole = replace(found, time=time, source=found.source or self.label)
        last = self._whole.samples if stop is None else stop
        return self._whole if (first, last) == (0, self._whole.samples) else self._whole.cut(first, last)

    def pieces(
        self, size: int, overlap: int = 0, first: int = 0, stop: int | None = None
    ) -> Iterator[tuple[int, Recording]]:
        """Yield (number of its first sample, Recording) of `size` samples each, behind the `overlap` samples
        before them that there are.
        """
        end = (self.samples or 0) if stop is None else stop
        for at in range(first, end, size):
            begin = max(at - overlap, first)
            yield begin, self.read(begin, min(at + size, end))

    def find(self, text: str) -> int | None:
        """Return the number of the sample whose time is written so; None: there is none, or it is not looked
        for in what is written.
        """
        written: Any = self.read().written
        if written is None or str(written.type) != "string":
            return None
        at = written.index(text).as_py()
        return None if at < 0 else at


def told(model: Any, r: Recording, row: Callable, where: str, first: tuple = ()) -> Recording:
    """Return a whole recording as it was read with its seams, and what its owner should know.

    Args:
        r: without starts and hints. row: number of a sample -> "row 7". where: the condition of the model as
            text. first: sentences.

    Raises:
        ValueError: more seams than steps of one sampling period.
    """
    clock, starts = tick(Clock(r.dt or 1.0), r.time)
    if sentence := irregular(clock, r.label, row):
        raise ValueError(sentence)
    hints = [*first, *seam_hints(clock, r.label, row), *missing_hints(model, r.u, r.y, r.excluded)]
    hints += [*rounding_hints(model, r.y), *still_hints(model, r.u, r.y, r.label)]
    if r.excluded is not None:
        starts = np.union1d(starts, around(r.excluded))
        hints += where_hints(where, int(np.count_nonzero(r.excluded)), r.samples)
    return replace(r, starts=starts, hints=tuple(hints))


def overlapping(
    chunks: Iterator[tuple[int, Recording]], overlap: int, dt: float
) -> Iterator[tuple[int, Recording]]:
    """Yield (number of its first sample, Recording): chunks that follow each other, each behind the `overlap`
    samples before it.

    Args:
        chunks: (number of its first sample, Recording without starts). dt: sampling period in s, by which
            seams are found.
    """
    tail, clock = None, None
    for start, chunk in chunks:
        clock = Clock(dt, samples=start) if clock is None else clock
        clock, seams = tick(clock, chunk.time)
        piece = chunk if tail is None else tail.followed(chunk)
        origin = start + chunk.samples - piece.samples
        seams = np.concatenate([piece.starts, seams[seams > origin] - origin])
        piece = replace(piece, starts=np.union1d(seams, around(piece.excluded)))
        yield origin, piece
        tail = piece.cut(max(piece.samples - overlap, 0), piece.samples)
