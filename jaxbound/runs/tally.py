"""Counts of verdicts that come in pieces: of each status, of alarms, the worst window."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from jaxbound.diagnosis.region import Excursions, Outside
from jaxbound.models.region import Region
from jaxbound.recordings.recording import Recording
from jaxbound.runs.loop import Memory, Quiet
from jaxbound.runs.sink import Verdicts
from jaxbound.sets.floats.status import Status

__all__ = ["Event", "Tally"]

When = str | float
FAULT = int(Status.FAULT)
EVENTS = "first", "worst", "tightest"
REMEMBERED = "counts", "samples", "aside", "recent", "looked_at", "missing", *EVENTS, "last"


class Event(NamedTuple):
    """A window to be told of: the number of its last sample, its margin, its time from the source."""

    sample: int
    margin: float
    when: When


@dataclass
class Tally(Quiet):
    """Counts of verdicts, a sink.

    Fields:
        when: (piece, number of a sample in it) -> its time, as JSON holds it. horizon: of the windows.
        counts: of each Status. samples: how many there were. aside: windows that are MISSING because the
            model's `where` leaves out a sample of theirs. recent: whether it did so for each of the last
            samples.
        looked_at: samples that the model's `where` does not leave out. missing: how many of these are
            missing, of each input, factor and output; empty before there are some.
        first: the first FAULT. worst: the FAULT window with the smallest margin. tightest: the window with
            the smallest margin of all. last: time of the last sample.
        region: of training; None: it is not known. beyond: windows outside of it.
    """

    when: Callable[[Recording, int], When]
    horizon: int
    counts: list[int] = field(default_factory=lambda: [0] * len(Status))
    samples: int = 0
    aside: int = 0
    recent: list[bool] = field(default_factory=list)
    looked_at: int = 0
    missing: list[int] = field(default_factory=list)
    first: Event | None = None
    worst: Event | None = None
    tightest: Event | None = None
    last: When | None = None
    region: Region | None = None

    def __post_init__(self) -> None:
        """Begin to count windows outside the region of training."""
        self.beyond: Excursions | None = None
        if self.region is not None:
            self.beyond = Excursions(self.region)

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        """Count the next samples."""
        status, margin = verdicts.status, verdicts.margin
        fresh = np.bincount(status, minlength=len(Status))
        self.counts = [n + more for n, more in zip(self.counts, fresh.tolist(), strict=True)]
        signals = np.concatenate([piece.u, piece.y], 1)
        if piece.excluded is not None:
            self._set_aside(piece.excluded)
            signals = signals[~piece.excluded]
        self.looked_at += len(signals)
        self.missing = (np.array(self.missing or 0) + np.isnan(signals).sum(0)).tolist()
        fault = np.flatnonzero(status == FAULT)
        if len(fault):
            first = self._event(piece, margin, int(fault[0]))
            self.first = self.first or first
            self.worst = _smaller(self.worst, self._smallest(piece, margin, fault) or first)
        self.tightest = _smaller(self.tightest, self._smallest(piece, margin, np.arange(len(status))))
        if self.beyond is not None and verdicts.departure is not None:
            self.beyond.add(status, margin, verdicts.departure)
        self.last = self.when(piece, len(status) - 1)
        self.samples += len(status)

    def named(self) -> dict[str, int]:
        """Return {name of a status: number of windows}."""
        return {status.name: self.counts[status] for status in Status}

    def outside(self, outside_is: str) -> Outside | None:
        """Return the windows outside the region of training; None: not known. outside_is: of a Result."""
        if self.beyond is None:
            return None
        return self.beyond.total(outside_is)

    def memory(self) -> Memory:
        """Return the counts."""
        counts = {name: getattr(self, name) for name in REMEMBERED}
        if self.beyond is None:
            return counts
        return counts | {"beyond": self.beyond.memory()}

    def resume(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        if self.beyond is not None:
            self.beyond.resume(memory.pop("beyond", {}))
        for name, value in memory.items():
            if name in EVENTS and value is not None:
                value = Event(*value)
            setattr(self, name, value)

    def _event(self, piece: Recording, margin: np.ndarray, k: int) -> Event:
        return Event(self.samples + k, float(margin[k]), self.when(piece, k))

    def _smallest(self, piece: Recording, margin: np.ndarray, among: np.ndarray) -> Event | None:
        """Return the Event of the smallest margin among samples of a piece, or None where none has one."""
        some = margin[among]
        if np.isnan(some).all():
            return None
        return self._event(piece, margin, int(among[np.nanargmin(some)]))

    def _set_aside(self, excluded: np.ndarray) -> None:
        """Count the windows of a piece that have a sample which does not count, here or before."""
        s = self.horizon
        reach = np.concatenate([np.array(self.recent, bool), excluded])
        before = np.cumsum(np.append(0, reach))
        ends = np.arange(len(self.recent), len(reach))
        within = before[ends + 1] > before[np.maximum(ends - s, 0)]
        warm = max(s - self.samples, 0)  # at these samples no window ends
        self.aside += int(np.count_nonzero(within[warm:]))
        self.recent = reach[len(reach) - min(s, len(reach)) :].tolist()


def _smaller(old: Event | None, new: Event | None) -> Event | None:
    """Return the event with the smaller margin, the older one of two alike; one without a margin is last."""
    if old is None or new is None:
        return old or new
    if new.margin < old.margin or (np.isnan(old.margin) and not np.isnan(new.margin)):
        return new
    return old
