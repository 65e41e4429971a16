"""Streams: recordings that come as time goes by, piece by piece, each sample once.

A stream is a source as any other (`source.Source`, with `live`): it yields Recordings. It also remembers its
position, so that another process can go on behind it.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict
from hashlib import blake2b
from typing import Any

import numpy as np

from jaxbound.recordings.factors import known
from jaxbound.recordings.recording import NOWHERE, SINCE_1970, Recording
from jaxbound.recordings.seams import TOLERATED_STEP, Clock, Seam, tick
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.timestamps import time_label

Complain = Callable[[str, str], None]
"""Called with (kind, sentence) on each sample that is left out, and each seam."""
BYTES = 8  # of a digest: one of a thousand million samples is like another one in 10 thousand million of them


class OtherSamples(ValueError):
    """A sample came that is not after the last one that was judged, and was not judged."""


class Taken:
    """The digests of the samples that a stream took, by which it knows what is sent again.

    Args:
        before: returns those of earlier processes, asked where some come that may be old; None: there is
            none, and nothing is kept for a later one.

    Fields: fresh: those of this process since somebody saved them.
    """

    def __init__(self, before: Callable[[], bytes] | None = None) -> None:
        self.before, self.fresh = before, bytearray()
        self.old: np.ndarray | None = None

    def add(self, digests: np.ndarray) -> None:
        """Take digests, (N,) from `digests_of`."""
        if self.before is not None:
            self.fresh += digests.tobytes()

    def knows(self, digests: np.ndarray) -> np.ndarray:
        """Return (N,) bool: whether an earlier process took these."""
        if self.old is None:
            earlier = self.before or bytes
            self.old = np.unique(np.frombuffer(earlier(), np.uint64))
        return np.isin(digests, self.old)


def digests_of(numbers: Sequence[np.ndarray], texts: Sequence[Sequence[str | None]] = ()) -> np.ndarray:
    """Return the digests of rows, (N,) uint64.

    Args:
        numbers, texts: columns of N cells each.
    """
    cells = np.stack([np.asarray(x, np.float64) for x in numbers], 1) + 0.0  # -0 is 0
    cells[np.isnan(cells)] = np.nan  # one of many
    words: Sequence[Sequence[str | None]] = [()] * len(cells)
    if texts:
        words = [*zip(*texts, strict=True)]
    digests = bytearray()
    for row, written in zip(cells, words, strict=True):
        digests += blake2b(row.tobytes() + repr(written).encode(), digest_size=BYTES).digest()
    return np.frombuffer(bytes(digests), np.uint64)


class Stream:
    """Samples as they come.

    Args:
        model: whose signals are wanted. complain: see `Complain`. taken: of all processes.

    Fields: raw: where they come from, an iterator, or the number of an open file; dt: sampling period in s;
    regular: whether samples have to be dt apart; else no step is a seam; clock: of all samples so far; lost:
    samples, or lines, that could not be read; no_rows: lines that
    hold no sample; skipped: those that an earlier process had judged; replaying:
    whether the sender has begun again, and all that it sends was taken before. units: the word for them.
    """

    raw: Any = ()
    replaying = False
    units = "samples"

    def __init__(self, model: SignalModel, complain: Complain, taken: Taken | None = None) -> None:
        self.model, self.complain = model, complain
        self.taken = taken or Taken()
        self.skipped = 0
        self.dt = model.dt or 1.0
        self.regular: bool = getattr(model, "regular", True)
        self.clock = Clock(self.dt)
        self.lost = self.no_rows = 0
        self.aside = False  # whether `where` leaves the last sample out

    def pieces(self, arrivals: Iterable[Any]) -> Iterator[tuple[int, Recording]]:
        """Yield (number of its first sample, Recording) as samples come; one without samples where there are
        none.

        `starts` of a piece has 0 where its first sample does not follow the last one before.

        Args:
            arrivals: what comes from `raw`; None in it ends the stream as a signal does: what was begun is
                remembered.

        Raises:
            ValueError: as `take` and `ended`.
        """
        for arrival in arrivals:
            if arrival is None:
                return
            yield self.numbered(self.take(arrival))
        self.ended()

    def take(self, arrival: object) -> Recording | None:
        """Return the Recording of the samples in what arrived, or None where there is none."""
        raise NotImplementedError

    def ended(self) -> None:
        """Take the end of the stream."""

    def numbered(self, piece: Recording | None) -> tuple[int, Recording]:
        """Return (number of its first sample, piece) of one that was just taken; None: without samples."""
        if piece is None:
            columns, outputs = known(self.model), self.model.outputs
            u, y = np.empty((0, len(columns))), np.empty((0, len(outputs)))
            piece = Recording(u, y, NOWHERE, columns, outputs)
        return self.clock.samples - piece.samples, piece

    def memory(self) -> dict[str, Any] | None:
        """Return the state from which another process goes on, as JSON holds it; None where there is none
        yet.
        """
        raise NotImplementedError

    def when(self, piece: Recording, k: int) -> str | float:
        """Return the time of a sample of a piece, as JSON holds it: its text, or seconds."""
        if piece.written is not None and str(piece.written.type) == "string":
            return str(piece.written[k].as_py()).strip()
        assert piece.time is not None, "a piece of a stream has times"
        return float(piece.time[k])

    def label(self, when: str | float) -> str:
        """Return a time from `when` as the owner of the samples would write it."""
        if isinstance(when, str):
            return when
        stamp = None
        if when > SINCE_1970:
            stamp = np.datetime64(round(when * 1e9), "ns")
        return time_label(when, stamp, self.dt)

    @property
    def last_label(self) -> str:
        """The time of the last sample as its owner would write it."""
        return self.label(self.clock.last)

    def old_ones(self, digests: np.ndarray, time: np.ndarray, named: Callable[[int], str]) -> int:
        """Return how many samples at the beginning an earlier process had judged.

        Args:
            digests, time: (N,) of samples that come behind those. named: returns the name of one by its
                number.

        Raises:
            OtherSamples: the next one is not after the last that was judged: it says something else.
        """
        old = self.taken.knows(digests)
        count = len(old)
        if not old.all():
            count = int(np.argmin(old))
        self.skipped += count
        if count < len(old) and not time[count] > self.clock.last:
            raise OtherSamples(
                f"{named(count)} is no sample that was judged, though all up to {self.last_label} were: "
                f"another recording, or one whose clock was set back, needs another --out or --state"
            )
        if count < len(old) and self.skipped:
            self.complain("replay", self.skipped_text)
        return count

    @property
    def skipped_text(self) -> str:
        """The sentence on samples that are skipped."""
        return f"{self.skipped} {self.units} were judged before and are skipped"

    def seams(self, time: np.ndarray, excluded: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Let the clock go on by some samples; return the numbers of those that do not come dt behind the one
        before, and of those at either end of a stretch that `where` leaves out.

        Args:
            time, excluded: as of a Recording.
        """
        clock, count, last = self.clock, self.clock.samples, float(time[-1])
        # one sample that is on time, as most are: sooner said than by `tick`
        on_time = len(time) == 1 and count and abs(last - clock.last - self.dt) <= TOLERATED_STEP * self.dt
        if on_time or not self.regular:
            self.clock, starts = Clock(self.dt, count + len(time), last, clock.seams), NOWHERE
        else:
            self.clock, seams = tick(clock, time)
            starts = seams - count
        if excluded is None or not self.regular:
            return starts, NOWHERE
        edges = np.flatnonzero(np.diff(excluded.astype(np.int8), prepend=np.int8(self.aside)))
        self.aside = bool(excluded[-1])
        return starts, edges

    def _clock_memory(self) -> dict[str, Any]:
        """Return the memory of the clock."""
        return {
            "samples": self.clock.samples,
            "time": self.clock.last,
            "seams": [asdict(seam) for seam in self.clock.seams],
            "lost": self.lost,
            "no_rows": self.no_rows,
            "aside": self.aside,
        }

    def _resume_clock(self, memory: dict[str, Any]) -> None:
        """Let the clock go on from a memory."""
        seams = tuple(Seam(**seam) for seam in memory["seams"])
        self.clock = Clock(self.dt, memory["samples"], memory["time"], seams)
        self.lost, self.aside = memory["lost"], memory.get("aside", False)
        self.no_rows = memory.get("no_rows", 0)
