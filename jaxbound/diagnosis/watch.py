"""Alarms by a rule, as verdicts come: the same whatever the pieces they come in.

First FAULT windows are grouped into stretches (k of n, hold, clear). A stretch then belongs to the alarm of
its suspect: it begins one, joins one that is on or was on a moment ago, or ends one as an opposite jump. An
acknowledgement ends alarms that had begun, and the stretch that is on with them: what follows begins anew.
Array operations over samples; loops are over stretches.
"""

import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import numpy as np

from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.suspects import UNKNOWN, Suspect
from jaxbound.models.region import Departure

__all__ = [
    "ACKNOWLEDGED",
    "BEGINS",
    "ENDS",
    "LASTING",
    "NO_DATA",
    "NO_SAMPLE",
    "OPPOSITE",
    "OTHER",
    "Event",
    "Raised",
    "Seen",
    "Watch",
]

OPPOSITE = "ended by an opposite jump"
ACKNOWLEDGED = "acknowledged"
LASTING = "open at the end: nothing speaks for a repair"
BEGINS, ENDS = "begins", "ends"
NO_SAMPLE, NO_DATA, OTHER = range(3)  # what follows an alarm
Labels = Callable[[int], object]
"""The time of a sample of a piece, by its number there."""
Blame = Callable[[int], Suspect]
"""The suspects of the FAULT window that ends at a sample."""


class Seen(NamedTuple):
    """Samples as a Watch sees them, arrays (N,).

    Fields: fault: bool, windows that count. margin. missing: bool. share, by, reading: of the departure from
    the region of training; share is 0 where there is none. instant: the time in s by which alarms are
    acknowledged, see `Recording.instants`.
    """

    fault: np.ndarray
    margin: np.ndarray
    missing: np.ndarray
    share: np.ndarray
    by: np.ndarray
    reading: np.ndarray
    instant: np.ndarray

    @classmethod
    def of(
        cls,
        fault: np.ndarray,
        margin: np.ndarray,
        missing: np.ndarray,
        departure: Departure | None = None,
        instant: np.ndarray | None = None,
    ) -> "Seen":
        """Return the samples. departure: from the region of training; instant: nobody acknowledges without
        it; None: not known.
        """
        nowhere = np.zeros(len(fault))
        if instant is None:
            instant = np.full(len(fault), np.nan)
        if departure is None:
            return cls(fault, margin, missing, nowhere, nowhere, nowhere, instant)
        share = np.where(fault & (departure.share > 0), departure.share, 0.0)
        return cls(fault, margin, missing, share, departure.by, departure.reading, instant)

    def cut(self, first: int, stop: int | None = None) -> "Seen":
        """Return the samples from one on, up to another."""
        return Seen(*(x[first:stop] for x in self))

    def behind(self, before: "Seen") -> "Seen":
        """Return these behind others."""
        return Seen(*(np.concatenate(pair) for pair in zip(before, self, strict=True)))


NOTHING = Seen.of(np.zeros(0, bool), np.zeros(0), np.zeros(0, bool))


@dataclass
class Raised:
    """An alarm that is on or over.

    Fields: number: counted from 1. start, end, windows, depth, worst: as of an Alarm; first, last: its first
    and last FAULT window. suspect: see `Suspect`. outside: how many of its FAULT windows lie outside the
    region of training; farthest: (share, input, reading) of the farthest. labels: the times of start, worst
    and end. after: what follows it, see `alarms.follows`. sure: the sample at which it was known to be over.
    on: whether its stretch lasts. ended: why it is over, where the rule says it. instant: of its start, see
    `Seen`.
    """

    number: int
    start: int
    end: int = -1
    windows: int = 0
    depth: float = math.inf
    worst: int = -1
    first: int = -1
    last: int = -1
    suspect: Suspect = UNKNOWN
    outside: int = 0
    farthest: tuple[float, int, float] = (0.0, -1, math.nan)
    labels: dict[str, Any] = field(default_factory=dict)
    after: int = OTHER
    sure: int = -1
    on: bool = True
    ended: str = ""
    instant: float = math.nan

    @classmethod
    def of(cls, memory: dict[str, Any]) -> "Raised":
        """Return the alarm of a memory."""
        found = cls(**memory)
        names, size, jump, cause = found.suspect
        found.suspect = Suspect(tuple(names), size, jump, cause)
        share, by, reading = found.farthest
        found.farthest = share, by, reading
        return found

    def take(self, seen: Seen, low: int, high: int, offset: int, label: Labels | None) -> None:
        """Count the samples low <= k < high of `seen`, whose first is number `offset`."""
        fault = np.flatnonzero(seen.fault[low:high]) + low
        if not len(fault):
            return
        self.windows += len(fault)
        self.last = int(fault[-1]) + offset
        if self.first < 0:
            self.first = int(fault[0]) + offset
        margin = seen.margin[fault]
        deepest = int(np.argmin(np.where(np.isnan(margin), -np.inf, margin)))
        if self.worst < 0 or _below(float(margin[deepest]), self.depth):
            self.depth, self.worst = float(margin[deepest]), int(fault[deepest]) + offset
            if label is not None:
                self.labels["worst"] = label(int(fault[deepest]))
        share = seen.share[fault]
        self.outside += int(np.count_nonzero(share > 0))
        far = int(np.argmax(share))
        if share[far] > self.farthest[0]:
            at = int(fault[far])
            self.farthest = float(share[far]), int(seen.by[at]), float(seen.reading[at])

    def join(self, other: "Raised") -> None:
        """Take a stretch of the same suspect that came later."""
        self.windows += other.windows
        self.last, self.end, self.after = other.last, other.end, other.after
        if _below(other.depth, self.depth):
            self.depth, self.worst = other.depth, other.worst
            self.labels["worst"] = other.labels.get("worst")
        self.labels["end"] = other.labels.get("end")
        self.outside += other.outside
        if other.farthest[0] > self.farthest[0]:
            self.farthest = other.farthest


class Event(NamedTuple):
    """The begin or the end of an alarm. Fields: sample: at which it was known; kind: BEGINS or ENDS."""

    sample: int
    kind: str
    alarm: Raised


class Watch:
    """The alarms of one recording by a rule.

    Args:
        rule: an AlarmRule that is `fitted`. blame: tells suspects; None: not asked for.
    """

    def __init__(self, rule: AlarmRule, blame: Blame | None = None) -> None:
        self.rule, self.blame = rule, blame
        self.acknowledged = rule.acknowledgements
        self.reach = rule.hold + rule.clear
        self.samples = self.count = 0
        self.before = np.zeros(0, bool)  # the n - 1 entries of `fault` before the tail
        self.tail = NOTHING  # samples behind the last at which a stretch was on
        self.times: list[Any] = []  # of the tail
        self.now: Any = None  # time of the last sample
        self.stretch: Raised | None = None
        self.until = -1  # the last sample at which it was on
        self.repairs = False
        self.alarms: dict[str, Raised] = {}
        self.events: list[Event] = []

    def add(self, seen: Seen, label: Labels | None = None) -> list[Event]:
        """Take the next samples; return what begins and ends in them, in order. label: of their times."""
        begin, low = self.samples, 0
        for instant, known, stop in self._acknowledgements(seen):
            self._take(seen.cut(low, stop), _labels_from(label, low))
            self._acknowledge(instant, begin + known)
            low = stop
        self._take(seen.cut(low), _labels_from(label, low))
        return self._said()

    def _acknowledgements(self, seen: Seen) -> list[tuple[float, int, int]]:
        """Return (time, number of the sample at which it is known, that of the first sample behind it) of
        each acknowledgement that may end an alarm in some samples.
        """
        if not self.acknowledged.is_given or not (self.alarms or seen.fault.any()) or not len(seen.fault):
            return []
        found = []
        for instant in self.acknowledged.between(float(seen.instant[0]), float(seen.instant.max())):
            known = int(np.argmax(seen.instant >= instant))
            found.append((instant, known, known + int(seen.instant[known] == instant)))
        return found

    def _acknowledge(self, instant: float, known: int) -> None:
        """End the alarms that had begun at a time, as is known at a sample.

        Whoever does it twice ends nothing more: an alarm that begins behind it began later.
        """
        acknowledged = [alarm for alarm in self.alarms.values() if alarm.instant <= instant]
        for alarm in acknowledged:
            name = alarm.suspect.first
            if self.stretch is not None and self.stretch.suspect.first == name:
                self._close(self.tail, self.until + 1, known, self._labels())
                self.tail, self.times = NOTHING, []
            if name in self.alarms:  # not ended by an opposite jump just now
                alarm.ended = ACKNOWLEDGED
                self._up_to_now(alarm)
                self._end(alarm, known)
        if acknowledged and self.stretch is None:
            self.before = np.zeros(len(self.before), bool)

    def _take(self, seen: Seen, label: Labels | None) -> None:
        """Take samples between acknowledgements."""
        new = len(seen.fault)
        if not new:
            return
        if label is not None:
            self.now = label(new - 1)
        if self.stretch is None and not self.alarms and not seen.fault.any() and not self.before.any():
            self.samples += new
            self.before = np.zeros(min(self.rule.n - 1, len(self.before) + new), bool)
            return
        held, times = len(self.tail.fault), self.times
        everything = seen.behind(self.tail)
        offset = self.samples - held

        def labelled(k: int) -> object:
            if k < held:
                return times[k]
            assert label is not None
            return label(k - held)

        own = None
        if label is not None:
            own = labelled
        for start, last in self._stretches(everything.fault):
            self._follow(everything, start, last, offset, own)
        self.samples += new
        self._settle(everything, offset, own)
        self._sweep(self.samples)
        self._keep(everything, offset, own)

    def finish(self) -> list[Event]:
        """Close the alarms that are on at the end of the recording."""
        last = self.samples - 1
        if self.stretch is not None:
            self._close(self.tail, self.until + 1, last, self._labels())
        for alarm in list(self.alarms.values()):
            if self.rule.latch:
                if not alarm.on and alarm.after != NO_SAMPLE:
                    alarm.ended = LASTING
                self._up_to_now(alarm)
            self._end(alarm, last)
        return self._said()

    def pending(self) -> list[Raised]:
        """Return the alarms that are on, as they would end if the recording ended here."""
        twin = deepcopy(vars(self) | {"blame": None})
        other = Watch(self.rule, None)
        vars(other).update(twin, blame=self.blame)
        return [event.alarm for event in other.finish()]

    def memory(self) -> dict[str, Any]:
        """Return the state, as JSON holds it."""
        stretch = None
        if self.stretch is not None:
            stretch = asdict(self.stretch)
        return {
            "samples": self.samples,
            "count": self.count,
            "before": self.before.tolist(),
            "tail": [np.asarray(x).tolist() for x in self.tail],
            "times": self.times,
            "now": self.now,
            "stretch": stretch,
            "until": self.until,
            "repairs": self.repairs,
            "alarms": {key: asdict(alarm) for key, alarm in self.alarms.items()},
        }

    def resume(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        self.samples, self.count, self.until = memory["samples"], memory["count"], memory["until"]
        self.before = np.array(memory["before"], bool)
        kinds = bool, float, bool, float, float, float, float
        tail = zip(memory["tail"], kinds, strict=True)
        self.tail = Seen(*(np.array(x, kind) for x, kind in tail))
        self.times, self.now, self.repairs = memory["times"], memory["now"], memory["repairs"]
        self.stretch = None
        if memory["stretch"] is not None:
            self.stretch = Raised.of(memory["stretch"])
        self.alarms = {key: Raised.of(alarm) for key, alarm in memory["alarms"].items()}

    def _stretches(self, fault: np.ndarray) -> list[tuple[int, int]]:
        """Return (first, last) sample at which each stretch is on, by k of n."""
        k, n = self.rule.k, self.rule.n
        filled = np.concatenate([np.zeros(n - len(self.before), bool), self.before, fault])
        count = np.cumsum(filled)
        on = np.flatnonzero(count[n:] - count[:-n] >= k)
        if not len(on):
            return []
        breaks = np.flatnonzero(np.diff(on) > self.reach)
        starts = on[np.concatenate([[0], breaks + 1])]
        lasts = on[np.concatenate([breaks, [len(on) - 1]])]
        return list(zip(starts.tolist(), lasts.tolist(), strict=True))

    def _follow(self, seen: Seen, start: int, last: int, offset: int, label: Labels | None) -> None:
        """Go through one stretch: it is on from a sample to another."""
        low = start
        if self.stretch is not None and start + offset - self.until <= self.reach:
            low = self.until + 1 - offset
        else:
            self._settle(seen, offset, label, start + offset)
            self._begin(seen, start, offset, label)
        assert self.stretch is not None, "it was begun"
        self.stretch.take(seen, low, last + 1, offset, label)
        self.until = last + offset
        if label is not None:
            self.stretch.labels["end"] = label(last)

    def _begin(self, seen: Seen, start: int, offset: int, label: Labels | None) -> None:
        """Begin a stretch, and the alarm of its suspect where none is on."""
        at = start + offset
        self._sweep(at)
        suspect = UNKNOWN
        if self.blame is not None:
            suspect = self.blame(at)
        stretch = Raised(0, at, suspect=suspect)
        if label is not None:
            stretch.labels["start"] = label(start)
        stretch.first = at - self._counted(seen.fault, start)
        self.stretch, self.repairs = stretch, False
        alarm = self.alarms.get(suspect.first)
        if alarm is not None:
            alarm.on = True
            self.repairs = suspect.ends(alarm.suspect)
            return
        self.count += 1
        begun = Raised(self.count, at, first=stretch.first, suspect=suspect)
        begun.instant = float(seen.instant[start])
        begun.labels = {"start": stretch.labels.get("start")}
        self.alarms[suspect.first] = begun
        self.events.append(Event(at, BEGINS, deepcopy(begun)))

    def _counted(self, fault: np.ndarray, start: int) -> int:
        """Return how many samples before the first of a stretch its first FAULT window lies."""
        low = start + 1 - self.rule.n
        early = fault[max(low, 0) : start + 1]
        if low < 0:
            early = np.concatenate([self.before[max(len(self.before) + low, 0) :], early])
        return len(early) - 1 - int(np.argmax(early))

    def _settle(self, seen: Seen, offset: int, label: Labels | None, before: int | None = None) -> None:
        """Close the stretch that is on if it is over by now, or by the next one at sample `before`."""
        if self.stretch is None:
            return
        if before is not None or self.samples - 1 - self.until >= self.reach:
            self._close(seen, offset, self.until + self.reach, label)

    def _close(self, seen: Seen, offset: int, sure: int, label: Labels | None) -> None:
        """Close the stretch, known at sample `sure` to be over."""
        stretch = self.stretch
        assert stretch is not None, "it is on"
        self.stretch = None
        last = len(seen.fault) - 1 + offset
        stretch.end = min(self.until + self.rule.hold, last)
        low, high = self.until + 1 - offset, stretch.end + 1 - offset
        stretch.take(seen, max(low, 0), max(high, 0), offset, label)
        if label is not None and stretch.end > self.until:
            stretch.labels["end"] = label(stretch.end - offset)
        stretch.after = NO_SAMPLE
        if stretch.end < last:
            stretch.after = OTHER
            if seen.missing[high]:
                stretch.after = NO_DATA
        alarm = self.alarms[stretch.suspect.first]
        if alarm.windows:
            alarm.join(stretch)
        else:
            own = {"number": alarm.number, "instant": alarm.instant}
            vars(alarm).update(vars(stretch), **own)
        alarm.on, alarm.sure = False, sure
        if self.rule.latch and self._repaired(stretch, alarm):
            alarm.ended = f"{OPPOSITE} of {alarm.suspect.first}"
            self._end(alarm, sure)

    def _repaired(self, stretch: Raised, alarm: Raised) -> bool:
        """Whether a stretch shows the opposite of the jump that an alarm began with, first or last."""
        if self.repairs:
            return True
        if self.blame is None or not alarm.suspect.jump or stretch.last == stretch.start:
            return False
        return self.blame(stretch.last).ends(alarm.suspect)

    def _sweep(self, sample: int) -> None:
        """End the alarms that nothing from a sample on can join any more."""
        if self.rule.latch:
            return
        for alarm in list(self.alarms.values()):
            if not alarm.on and sample > alarm.end + int(self.rule.merge):
                self._end(alarm, max(alarm.sure, alarm.end + int(self.rule.merge)))

    def _end(self, alarm: Raised, sample: int) -> None:
        """End an alarm, as is known at a sample."""
        del self.alarms[alarm.suspect.first]
        self.events.append(Event(sample, ENDS, alarm))

    def _keep(self, seen: Seen, offset: int, label: Labels | None) -> None:
        """Keep the samples that the next ones need."""
        low = len(seen.fault)
        if self.stretch is not None:
            low = self.until + 1 - offset
        self._keep_flags(seen.fault[:low])
        self.tail, self.times = seen.cut(low), []
        if label is not None:
            self.times = [label(k) for k in range(low, len(seen.fault))]

    def _keep_flags(self, fault: np.ndarray) -> None:
        """Keep the last n - 1 of the flags that were kept and those behind them."""
        flags = np.concatenate([self.before, fault])
        self.before = flags[max(len(flags) - self.rule.n + 1, 0) :]

    def _up_to_now(self, alarm: Raised) -> None:
        """Let an alarm last to the last sample."""
        alarm.end = self.samples - 1
        alarm.labels["end"] = self.now

    def _labels(self) -> Labels | None:
        """Return the times of the tail, where they are known."""
        if len(self.times) < len(self.tail.fault):
            return None
        return self.times.__getitem__

    def _said(self) -> list[Event]:
        """Return the events since the last call, in order."""
        events, self.events = sorted(self.events, key=lambda event: event.sample), []
        return events


def _below(one: float, other: float) -> bool:
    """Whether a margin is deeper than another; one that is not known is deepest."""
    if math.isnan(other):
        return False
    return math.isnan(one) or one < other


def _labels_from(label: Labels | None, first: int) -> Labels | None:
    """Return the times of samples from one on, by their number behind it."""
    if label is None or not first:
        return label

    def of_these(k: int) -> object:
        return label(first + k)

    return of_these
