"""The second word on a verdict: whether its window lies in the region of training, counted and in words."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxbound.consistency.claims import CLAIMED
from jaxbound.files.checkpoint import as_texts, from_texts
from jaxbound.models.region import Departure, Region
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable

NEARLY_ALL = 0.9
"""Share of FAULT windows from which on a sentence begins with the region."""
KINDS = ALL, FAULTS, SUSPECT = range(3)
"""Windows that are counted apart."""


@readable
@dataclass(frozen=True)
class Outside:
    """Numbers of windows outside the region of training.

    Fields: windows: how many; faults: how many of these are FAULT; unclaimed: how many are UNDECIDED because
    a FAULT there is not to be claimed. inputs: {input: number of windows in which it lies farthest out}, of
    the FAULT (or unclaimed) ones where there are any. words: of the first of these, its sample farthest out;
    "" where all windows are inside.
    """

    windows: int = 0
    faults: int = 0
    unclaimed: int = 0
    inputs: Mapping[str, int] = field(default_factory=dict)
    words: str = ""

    def holds(self, faults: int) -> bool:
        """Return whether nearly all of so many FAULT windows lie outside."""
        return self.faults > 0 and self.faults >= NEARLY_ALL * faults

    def spares(self, faults: int) -> bool:
        """Return whether nearly all of so many FAULT windows lie inside."""
        return self.faults <= (1 - NEARLY_ALL) * faults

    def shown(self, tested: int, remembers: bool = False) -> str:
        """Return the numbers in words. tested: how many windows have data; remembers: they are samples of an
        observer.
        """
        what = "windows"
        if remembers:
            what = "samples"
        if not self.windows:
            return f"all {tested} {what} within the region of training"
        many = f"{self.windows} of {tested} {what} outside"
        if self.faults:
            many += f", {self.faults} of them FAULT"
        if self.unclaimed:
            many += f", {self.unclaimed} of them not explained, and not called FAULT there"
        return f"{many}; most by {self.words}"

    def plain(self) -> dict[str, Any]:
        """Return the numbers as JSON has them."""
        return {
            "windows": self.windows,
            "faults": self.faults,
            "unclaimed": self.unclaimed,
            "inputs": dict(self.inputs),
            "words": self.words or None,
        }


class Excursions:
    """A count of windows outside a region, which come in pieces.

    Args:
        region: of training.

    Fields: counts, shares, readings: [of all windows, of FAULT ones, of UNDECIDED ones that are suspect], for
    each input how many windows it leads out, and the farthest.
    """

    def __init__(self, region: Region) -> None:
        shape = len(KINDS), len(region.inputs)
        self.region = region
        self.counts, self.shares = np.zeros(shape, np.int64), np.zeros(shape)
        self.readings = np.full(shape, np.nan)

    def add(self, status: np.ndarray, margin: np.ndarray, departure: Departure) -> None:
        """Count windows, (..., T) each."""
        out = departure.share > 0
        if not out.any():
            return
        status, margin, departure = status[out], margin[out], departure.cut(out)
        fault = status == Status.FAULT
        suspect = (status == Status.UNDECIDED) & ~(margin >= 0)  # some tests measure no margin
        self._count(ALL, departure)
        self._count(FAULTS, departure.cut(fault))
        self._count(SUSPECT, departure.cut(suspect))

    def _count(self, kind: int, departure: Departure) -> None:
        for j in np.unique(departure.by).tolist():
            own = departure.cut(departure.by == j)
            farthest = int(np.argmax(own.share))
            self.counts[kind, j] += len(own.share)
            if own.share[farthest] > self.shares[kind, j]:
                self.shares[kind, j] = own.share[farthest]
                self.readings[kind, j] = own.reading[farthest]

    def total(self, outside: str = CLAIMED) -> Outside:
        """Return the numbers. outside: what FAULT there is called, see `detect`."""
        windows, faults, unclaimed = self.counts.sum(1).tolist()
        if outside == CLAIMED:
            unclaimed = 0
        kind = ALL
        if faults:
            kind = FAULTS
        elif unclaimed:
            kind = SUSPECT
        order = np.argsort(self.counts[kind], kind="stable")[::-1].tolist()
        inputs, words = {}, ""
        for j in order:
            if self.counts[kind, j]:
                inputs[self.region.inputs[j]] = int(self.counts[kind, j])
        if inputs:
            words = self.region.words(order[0], float(self.readings[kind, order[0]]))
        return Outside(windows, faults, unclaimed, inputs, words)

    def memory(self) -> list[str]:
        """Return the counts as JSON holds them."""
        return as_texts((self.counts, self.shares, self.readings))

    def resume(self, memory: list[str]) -> None:
        """Go on from a memory."""
        kept = from_texts((self.counts, self.shares, self.readings), memory)
        self.counts, self.shares, self.readings = map(np.copy, kept)
