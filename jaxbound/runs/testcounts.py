"""The counts of each test of a monitor, and the stretches that none of them watched, of verdicts that come in
pieces.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, cast

import numpy as np

from jaxbound.consistency.interface import Judged, Relations, Verdicts
from jaxbound.consistency.monitorbank import MonitorBank, claimed
from jaxbound.diagnosis.hints import outgrown_by
from jaxbound.recordings.recording import Recording
from jaxbound.runs.loop import Memory, Quiet
from jaxbound.sets.floats.status import Status
from jaxbound.text.quantities import finite

__all__ = ["STRETCHES", "CountsByTest", "OfTest", "Unwatched"]

STRETCHES = 10
"""Stretches that nobody watched, of which the longest are kept."""
NEVER = -1
"""In place of the sample of a first FAULT."""
REMEMBERED = "samples", "covered", "counts", "speaks", "within", "first", "least", "modes"
KNOWLEDGE = 3
"""A condition holds, does not, or is unknown."""


class OfTest(NamedTuple):
    """The verdicts of one test of a monitor.

    Fields: counts: {status name: number of its samples}. first: sample of its first FAULT, None: it has none.
    speaks: how many samples' verdict is its own. margin: its least, NaN: it has none. observes: whether it is
    an observer. within: how many samples it refutes without bounds that a test has outgrown; where nobody
    knows the mode those of all tests that refute one count.
    """

    counts: Mapping[str, int]
    first: int | None
    speaks: int
    margin: float
    observes: bool = False
    within: int = 0

    def plain(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {
            "counts": dict(self.counts),
            "first_fault": self.first,
            "speaks": self.speaks,
            "margin": finite(self.margin),
        }


class CountsByTest(Quiet):
    """The counts of each test of a monitor, a sink.

    Fields: samples: how many there were. covered: of them those that a test of windows decides, or an
    observer has a verdict on: UNDECIDED is what healthy samples are to it. counts (tests, 4), speaks
    (tests,), first (tests,), least (tests,): of each test, see `OfTest`. modes (conditions, 3): at how many
    samples each condition does not hold, holds, is unknown.
    """

    def __init__(self, relations: Relations) -> None:
        """Begin at zero."""
        bank = cast(MonitorBank, relations)
        self.bank = bank
        self.observes = np.array([part.observes for part in bank.parts.values()])
        self.beyond = np.array([outgrown_by(bank, name) for name in bank.names])
        tests = len(self.observes)
        self.samples = self.covered = 0
        self.counts = np.zeros((tests, len(Status)), np.int64)
        self.speaks = np.zeros(tests, np.int64)
        self.within = np.zeros(tests, np.int64)
        self.first = np.full(tests, NEVER, np.int64)
        self.least = np.full(tests, np.nan)
        self.modes = np.zeros((len(bank.conditions), KNOWLEDGE), np.int64)

    def add(self, piece: Recording, verdicts: Judged) -> None:
        """Count the next samples, which a monitor has judged."""
        statuses, margins, by = verdicts.statuses, verdicts.test_margins, verdicts.by
        assert statuses is not None and margins is not None and by is not None, "a monitor judged them"
        self.take(np.asarray(piece.u), statuses, margins, by)

    def take(self, u: np.ndarray, statuses: np.ndarray, margins: np.ndarray, by: np.ndarray) -> None:
        """Count samples. u (T, m): inputs. statuses, margins (T, tests), by (T,): as of a MonitorResult."""
        if not len(by):
            return
        fault = statuses == Status.FAULT
        decided = np.where(self.observes, statuses != Status.MISSING, fault | (statuses == Status.CONSISTENT))
        self.covered += int(np.count_nonzero(decided.any(1)))
        for status in Status:
            self.counts[:, status] += np.count_nonzero(statuses == status, 0)
        self.speaks += np.bincount(by + 1, minlength=len(self.speaks) + 1)[1:]
        begins = fault.any(0) & (self.first == NEVER)
        self.first[begins] = self.samples + fault.argmax(0)[begins]
        self.least = np.fmin(self.least, np.fmin.reduce(margins, 0, initial=np.nan))
        modes = self.bank.modes_of(u)
        without = np.where(fault & self.beyond, np.int8(Status.UNDECIDED), statuses)
        still = claimed(without, self.bank.conditions_of, modes, self.bank.complete)
        self.within += np.count_nonzero(still == Status.FAULT, 0)
        for value in range(KNOWLEDGE):
            self.modes[:, value] += np.count_nonzero(modes == value, 0)
        self.samples += len(by)

    def join(self, memory: dict[str, Any]) -> None:
        """Take the counts of the samples behind these, as their `memory` holds them."""
        other = CountsByTest(self.bank)
        other.resume(memory)
        begins = (other.first != NEVER) & (self.first == NEVER)
        self.first[begins] = self.samples + other.first[begins]
        self.least = np.fmin(self.least, other.least)
        for name in ("counts", "speaks", "within", "modes", "covered", "samples"):
            setattr(self, name, getattr(self, name) + getattr(other, name))

    def memory(self) -> Memory:
        """Return the counts, as JSON holds them."""
        counts = {name: np.asarray(getattr(self, name)).tolist() for name in REMEMBERED}
        least = counts["least"]
        for i in np.flatnonzero(~np.isfinite(self.least)):
            least[i] = str(least[i])
        return counts

    def resume(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        self.samples, self.covered = memory["samples"], memory["covered"]
        for name in REMEMBERED[2:]:
            before = getattr(self, name)
            setattr(self, name, np.array(memory[name], before.dtype).reshape(before.shape))

    def tests(self) -> dict[str, OfTest]:
        """Return {name: OfTest}."""
        found = {}
        for i, name in enumerate(self.bank.names):
            counts = {status.name: int(self.counts[i, status]) for status in Status}
            first = None
            if self.first[i] != NEVER:
                first = int(self.first[i])
            about = int(self.speaks[i]), float(self.least[i]), bool(self.observes[i]), int(self.within[i])
            found[name] = OfTest(counts, first, *about)
        return found


class Unwatched(Quiet):
    """The stretches in which no test has a verdict, a sink.

    Fields: samples: how many there were. missing: of them without a verdict. count: of stretches that are
    over. longest: (first, stop) of the longest of them, in order of time.
    """

    def __init__(self) -> None:
        """Begin before the first sample."""
        self.samples = self.missing = self.count = 0
        self.longest = np.zeros((0, 2), np.int64)
        self.begun: int | None = None  # the first sample of a stretch that goes on

    def add(self, piece: Recording | None, verdicts: Verdicts) -> None:
        """Follow the next samples."""
        missing = np.asarray(verdicts.status) == Status.MISSING
        before = self.begun is not None
        edges = np.flatnonzero(np.diff(missing, prepend=before)) + self.samples
        if self.begun is not None:
            edges = np.concatenate([[self.begun], edges])
        self.begun = None
        if len(edges) % 2:
            self.begun = int(edges[-1])
        self._keep(edges[: len(edges) // 2 * 2].reshape(-1, 2))
        self.samples += len(missing)
        self.missing += int(np.count_nonzero(missing))

    def finish(self) -> "Unwatched":
        """Let a stretch that goes on end with the last sample."""
        if self.begun is not None:
            self._keep(np.array([[self.begun, self.samples]]))
            self.begun = None
        return self

    def _keep(self, over: np.ndarray) -> None:
        """Count stretches that are over; keep the longest."""
        self.count += len(over)
        every = np.concatenate([self.longest, over])
        longest = np.argsort(every[:, 0] - every[:, 1], kind="stable")[:STRETCHES]
        self.longest = every[np.sort(longest)]
