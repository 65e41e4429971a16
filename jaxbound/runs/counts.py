"""Counts of verdicts that come in pieces, and the numbers that a verdict on a recording rests on: of each
status, of each test of a monitor, the worst window, the stretches that no test watched.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, cast

import numpy as np

from jaxbound.consistency.interface import EXACT, Judged, Relations
from jaxbound.consistency.monitorbank import MonitorBank, claimed
from jaxbound.diagnosis.causes import Verdicts
from jaxbound.diagnosis.hints import outgrown_by
from jaxbound.diagnosis.region import Excursions, Outside
from jaxbound.models.region import Region
from jaxbound.recordings.recording import Recording
from jaxbound.runs.loop import Memory, Quiet
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable
from jaxbound.text.quantities import finite

When = str | float
FAULT = int(Status.FAULT)
EVENTS = "first", "worst", "tightest"
COUNTED = "counts", "samples", "aside", "recent", "looked_at", "missing", *EVENTS, "last"
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


@readable
@dataclass(frozen=True)
class Evidence:
    """The numbers that a verdict on a recording rests on.

    Fields:
        method: of the test. horizon: windows have horizon + 1 samples. samples: how many were tested.
        counts: {status name: number of windows}. aside: how many are MISSING because the model's `where`
            leaves out a sample of theirs.
        at, margin: sample (or whatever has a label) and margin of the FAULT window with the smallest margin
            (without FAULT: of any window);
            None, NaN: there is none.
        first: sample of the first FAULT window, None where it is not known. alarms: how many. ended: {why an
            alarm is over: how many}.
        faulty: {output: number of its faulty samples}, of a validation; else None.
        remembers: whether verdicts rest on all samples since the start (an observer): UNDECIDED then is what
            healthy samples are.
        outgrown: whether the bounds were found from data for shorter windows than these: FAULT then proves no
            fault.
        margins: of the verdicts, "exact" or "bounds", see `detect`. bounded: whether `margin` is such a
            bound: the exact one is not below it, of FAULT not above it.
        outside: the windows outside the region of training; None: the model states no ranges, or a validation
            judged.
        observes: whether UNDECIDED is what healthy samples are: of an observer, or a monitor with one.
        tests: {name: OfTest} of a monitor; else None. test: the name of the one that speaks at `at`.
        covered: of a monitor how many samples count as decided; None: another test judged. known: how many of
            the first samples were judged in a recording before.
    """

    method: str
    horizon: int
    samples: int
    counts: Mapping[str, int]
    aside: int = 0
    at: int | None = None
    margin: float = np.nan
    first: int | None = None
    alarms: int = 0
    ended: Mapping[str, int] | None = None
    faulty: Mapping[str, int] | None = None
    remembers: bool = False
    outgrown: bool = False
    margins: str = EXACT
    bounded: bool = False
    outside: Outside | None = None
    tests: Mapping[str, OfTest] | None = None
    test: str = ""
    observes: bool = False
    covered: int | None = None
    known: int = 0

    @property
    def warm_up(self) -> int:
        """How many samples at the start have no verdict: none is there yet, or it was given before."""
        return max(self.horizon, self.known)

    @property
    def windows(self) -> int:
        """How many windows there are: the warm-up is none, nor is what the model's `where` leaves out."""
        return max(self.samples - self.warm_up - self.aside, 0)

    @property
    def decided(self) -> float:
        """The share of windows that are proved one way or the other; of a monitor `covered` of them."""
        if not self.windows:
            return 0.0
        if self.covered is not None:
            return self.covered / self.windows
        return (self.counts["CONSISTENT"] + self.counts["FAULT"]) / self.windows

    @property
    def training(self) -> str:
        """How many windows lie outside the region of training, in words; "": there is no region."""
        if self.outside is None:
            return ""
        return self.outside.shown(round(self.tested * self.windows), self.remembers)

    @property
    def tested(self) -> float:
        """The share of windows that have data."""
        if not self.windows:
            return 0.0
        return 1 - (self.counts["MISSING"] - self.warm_up - self.aside) / self.windows


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
        modes = self.bank.modes_of(np.asarray(piece.u))
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
        numbers = {}
        for i, name in enumerate(self.bank.names):
            counts = {status.name: int(self.counts[i, status]) for status in Status}
            first = None
            if self.first[i] != NEVER:
                first = int(self.first[i])
            numbers[name] = OfTest(
                counts,
                first,
                int(self.speaks[i]),
                float(self.least[i]),
                bool(self.observes[i]),
                int(self.within[i]),
            )
        return numbers


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

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
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


class Event(NamedTuple):
    """A window to be told of: the number of its last sample, its margin, its time from the source."""

    sample: int
    margin: float
    when: When


@dataclass
class Tally(Quiet):
    """Counts of verdicts, a sink.

    Fields:
        relations: as tested. when: (piece, number of a sample in it) -> its time, as JSON holds it.
        counts: of each Status. samples: how many there were. aside: windows that are MISSING because the
            model's `where` leaves out a sample of theirs. recent: whether it did so for each of the last
            samples.
        looked_at: samples that the model's `where` does not leave out. missing: how many of these are
            missing, of each input, factor and output; empty before there are some.
        first: the first FAULT. worst: the FAULT window with the smallest margin. tightest: the window with
            the smallest margin of all. last: time of the last sample.
        beyond: windows outside the region of training; by_test: of each test of a monitor; None: there is
            none.
    """

    relations: Relations
    when: Callable[[Recording, int], When]
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

    def __post_init__(self) -> None:
        """Begin to count what not all relations have."""
        self.beyond: Excursions | None = None
        region = Region.of(self.relations)
        if region is not None:
            self.beyond = Excursions(region)
        self.by_test: CountsByTest | None = None
        if self.relations.parts:
            self.by_test = CountsByTest(self.relations)

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
        if self.by_test is not None and getattr(verdicts, "statuses", None) is not None:
            self.by_test.add(piece, cast(Judged, verdicts))
        self.last = self.when(piece, len(status) - 1)
        self.samples += len(status)

    def evidence(self, method: str, outside: str, alarms: int, ended: Mapping[str, int]) -> Evidence:
        """Return the Evidence of all that was counted, with the time of the worst window in place of its
        sample.

        Args:
            method, outside: of the test, see `detect`. alarms, ended: see `Evidence`.
        """
        at: Any = None
        margin = np.nan
        if self.worst is not None:
            at, margin = self.worst.when, self.worst.margin
        found = Evidence(
            method,
            self.relations.horizon,
            self.samples,
            {status.name: self.counts[status] for status in Status},
            self.aside,
            at,
            margin,
            alarms=alarms,
            ended=ended,
            remembers=self.relations.remembers,
            observes=self.relations.observes,
        )
        if self.beyond is not None:
            found = replace(found, outside=self.beyond.total(outside))
        if self.by_test is not None:
            found = replace(found, tests=self.by_test.tests(), covered=self.by_test.covered)
        return found

    def memory(self) -> Memory:
        """Return the counts."""
        counts = {name: getattr(self, name) for name in COUNTED}
        for name, part in self._parts().items():
            counts[name] = part.memory()
        return counts

    def resume(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        for name, part in self._parts().items():
            part.resume(memory.pop(name))
        for name, value in memory.items():
            if name in EVENTS and value is not None:
                value = Event(*value)
            setattr(self, name, value)

    def _parts(self) -> dict[str, Excursions | CountsByTest]:
        """Return {name: what not all relations have}."""
        parts: dict[str, Excursions | CountsByTest] = {}
        if self.beyond is not None:
            parts["beyond"] = self.beyond
        if self.by_test is not None:
            parts["tests"] = self.by_test
        return parts

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
        s = self.relations.horizon
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
