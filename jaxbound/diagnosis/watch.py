"""Alarms by a rule, as verdicts come: the same whatever the pieces they come in.

First FAULT windows are grouped into stretches (k of n, hold, clear), by array operations over samples. Where
the rule names nobody each is an alarm. Else a stretch belongs to the alarm of its suspect: it begins one,
joins one that is on or was on a moment ago, or ends one as an opposite jump. An acknowledgement ends alarms
that had begun, and the stretch that is on with them: what follows begins anew.
"""

from collections.abc import Callable
from copy import deepcopy
from operator import itemgetter
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
    "alarms_in",
]

OPPOSITE = "ended by an opposite jump"
ACKNOWLEDGED = "acknowledged"
LASTING = "open at the end: nothing speaks for a repair"
BEGINS, ENDS = "begins", "ends"
NO_SAMPLE, NO_DATA, OTHER = range(3)  # what follows an alarm
Blame = Callable[[int], Suspect]
"""The suspects of the FAULT window that ends at a sample."""
SAMPLES = "start", "end", "worst", "first", "last", "sure"
"""Fields of Raised that are numbers of samples."""


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
        return Seen(*map(itemgetter(slice(first, stop)), self))

    def counted(self) -> "Seen":
        """Return these, the first of them as one that was counted."""
        fault, share = self.fault.copy(), self.share.copy()
        fault[:1], share[:1] = False, 0.0
        return self._replace(fault=fault, share=share)

    def behind(self, before: "Seen") -> "Seen":
        """Return these behind others."""
        if not len(before.fault):
            return self
        return Seen(*map(np.concatenate, zip(before, self, strict=True)))


NOTHING = Seen.of(np.zeros(0, bool), np.zeros(0), np.zeros(0, bool))
KINDS = bool, float, bool, float, float, float, float  # of the fields of Seen


class Raised(NamedTuple):
    """Alarms, or the stretches that they are made of, arrays (N,).

    Fields: number: counted from 1. start, end, windows, depth, worst: as of an Alarm; first, last: the first
    and last FAULT window that made it. after: what follows it, NO_SAMPLE, NO_DATA or OTHER. sure: the sample
    at which it is known to be over. outside: how many of its FAULT windows lie outside the region of
    training; share, by, reading: of the farthest. instant: of its start, see `Seen`. suspect: a Suspect,
    None: not asked for. ended: why it is over, "" where the rule does not say it.
    """

    number: np.ndarray
    start: np.ndarray
    end: np.ndarray
    windows: np.ndarray
    depth: np.ndarray
    worst: np.ndarray
    first: np.ndarray
    last: np.ndarray
    after: np.ndarray
    sure: np.ndarray
    outside: np.ndarray
    share: np.ndarray
    by: np.ndarray
    reading: np.ndarray
    instant: np.ndarray
    suspect: np.ndarray
    ended: np.ndarray

    @classmethod
    def of(cls, memory: list[list[Any]]) -> "Raised":
        """Return the alarms of a memory."""
        columns = []
        for empty, values in zip(NOBODY, memory, strict=True):
            column = np.zeros(len(values), empty.dtype)
            for i, value in enumerate(values):
                column[i] = value
            columns.append(column)
        alarms = cls(*columns)
        for i, suspect in enumerate(alarms.suspect):
            if suspect is not None:
                alarms.suspect[i] = Suspect(tuple(suspect[0]), *suspect[1:])
        return alarms

    def memory(self) -> list[list[Any]]:
        """Return them as JSON holds them."""
        return list(map(np.ndarray.tolist, self))

    def cut(self, at: slice | np.ndarray) -> "Raised":
        """Return some of them."""
        return Raised(*map(itemgetter(at), self))

    def behind(self, *others: "Raised") -> "Raised":
        """Return these behind others."""
        some = [alarms for alarms in (*others, self) if len(alarms.start)]
        if len(some) < 2:
            return (*some, NOBODY)[0]
        return Raised(*map(np.concatenate, zip(*some, strict=True)))

    def joined(self, other: "Raised") -> "Raised":
        """Return an alarm with a stretch that came later."""
        deeper = (other.windows > 0) & ~np.isnan(self.depth)
        deeper &= np.isnan(other.depth) | (other.depth < self.depth)
        columns = self._asdict()
        picked = {("depth", "worst"): deeper, ("share", "by", "reading"): other.share > self.share}
        picked["last",] = other.windows > 0
        for names, which in picked.items():
            for name in names:
                columns[name] = np.where(which, getattr(other, name), columns[name])
        columns |= {"windows": self.windows + other.windows, "outside": self.outside + other.outside}
        return Raised(**columns | {"end": other.end, "after": other.after, "sure": other.sure})

    @property
    def name(self) -> str:
        """The first suspect of a single one, "" where there is none."""
        return (self.suspect[0] or UNKNOWN).first


WHOLE, REAL, NAMED = np.zeros(0, np.int64), np.zeros(0), np.zeros(0, object)
NOBODY = Raised(
    *(WHOLE, WHOLE, WHOLE, WHOLE, REAL, WHOLE, WHOLE, WHOLE, WHOLE, WHOLE, WHOLE),
    *(REAL, WHOLE, REAL, REAL, NAMED, NAMED),
)
"""No alarm."""


class Event(NamedTuple):
    """The begin or the end of an alarm. Fields: sample: at which it was known; number: of the alarm; kind:
    BEGINS or ENDS; alarm: a single one.
    """

    sample: int
    number: int
    kind: str
    alarm: Raised


class Watch:
    """The alarms of one recording by a rule.

    Args:
        rule: an AlarmRule that is `fitted`. blame: tells suspects; None: not asked for.

    Fields: samples: how many there were. count: of alarms. began: those that began in the last samples, of
    which number, start, instant and suspect count.
    """

    def __init__(self, rule: AlarmRule, blame: Blame | None = None) -> None:
        self.rule, self.blame = rule, blame
        self.acknowledged = rule.acknowledgements
        self.reach = rule.hold + rule.clear
        self.samples = self.count = 0
        self.before = np.zeros(0, bool)  # the last n - 1 entries of `fault`
        self.open = NOBODY  # the stretch that is on
        self.tail = NOTHING  # the last sample at which it was on, counted, and those behind it
        self.repairs = False
        self.alarms: dict[str, Raised] = {}  # by suspect, of a rule that names them; without windows at first
        self.began, self.over = NOBODY, NOBODY

    def add(self, seen: Seen) -> Raised:
        """Take the next samples; return the alarms that are over by them, in the order in which it is
        known.
        """
        begin, low = self.samples, 0
        self.began = NOBODY
        for instant, known, stop in self._acknowledgements(seen):
            self._take(seen.cut(low, stop))
            self._acknowledge(instant, begin + known)
            low = stop
        self._take(seen.cut(low))
        return self._told()

    def skip(self, count: int) -> None:
        """Take samples without a FAULT while nothing is on."""
        self.samples += count
        self.before = np.zeros(min(self.rule.n - 1, len(self.before) + count), bool)

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
        acknowledged = [name for name, alarm in self.alarms.items() if alarm.instant[0] <= instant]
        for name in acknowledged:
            if self._is_on(name):
                self._take(NOTHING, known)
            if name in self.alarms:  # not ended by an opposite jump just now
                self._end_now(name, ACKNOWLEDGED, known)
        if acknowledged and not len(self.open.start):
            self.before = np.zeros(len(self.before), bool)

    @property
    def is_quiet(self) -> bool:
        """Whether no alarm is on, and none of the last flags counts for one."""
        return not (len(self.open.start) or self.alarms or self.before.any())

    def _is_on(self, name: str) -> bool:
        """Whether the stretch that is on is one of a suspect."""
        return len(self.open.start) > 0 and self.open.name == name

    def _take(self, seen: Seen, sure: int | None = None) -> None:
        """Take samples between acknowledgements. sure: the stretch that is on is known to be over there."""
        is_on, before = len(self.open.start), self.open
        if self.is_quiet and not seen.fault.any():
            self.skip(len(seen.fault))
            return
        everything, offset = seen.behind(self.tail), self.samples - len(self.tail.fault)
        alarms, left = self._stretches(everything, seen.fault, sure)
        if len(alarms.start):
            alarms = alarms._replace(**{name: getattr(alarms, name) + offset for name in SAMPLES})
        if is_on:
            alarms = alarms.cut(slice(1, None)).behind(before.joined(alarms.cut(slice(0, 1))))
        if sure is not None:
            alarms.sure[:] = sure
        self.samples += len(seen.fault)
        flags = np.concatenate([self.before, seen.fault])
        self.before = flags[max(len(flags) - self.rule.n + 1, 0) :]
        self.open, self.tail, count = NOBODY, NOTHING, len(alarms.start)
        if left is not None:
            self.tail, count = everything.cut(left).counted(), count - 1
        if self.rule.names:
            self._follow(alarms, is_on, count)
        else:
            fresh = alarms.number[is_on:]
            fresh[:] = self.count + 1 + np.arange(len(fresh))
            self.count += len(fresh)
            self.began = alarms.cut(slice(is_on, None)).behind(self.began)
            self.over = alarms.cut(slice(0, count)).behind(self.over)
        self.open = alarms.cut(slice(count, None))
        if sure is None:
            self._sweep(self.samples)

    def _stretches(self, seen: Seen, new: np.ndarray, sure: int | None) -> tuple[Raised, int | None]:
        """Return (the stretches of samples, the first being the rest of the one that is on; the number of the
        last sample at which the last stretch was on, None: it is over).

        Args:
            seen: samples from the tail on. new: the flags of those behind it.
        """
        k, n = self.rule.k, self.rule.n
        tail = len(seen.fault) - len(new)
        flags = np.concatenate([np.zeros(n - len(self.before), bool), self.before, new])
        count = np.cumsum(flags)
        on = np.flatnonzero(count[n:] - count[:-n] >= k) + tail
        if tail:
            on = np.append(0, on)
        if not len(on):
            return NOBODY, None
        breaks = np.flatnonzero(np.diff(on) > self.reach)  # quiet samples between two: their distance - 1
        starts, until = on[np.append(0, breaks + 1)], on[np.append(breaks, len(on) - 1)]
        ends, left = np.minimum(until + self.rule.hold, len(seen.fault) - 1), None
        if sure is None and len(seen.fault) - 1 - until[-1] < self.reach:
            ends[-1] = left = int(until[-1])
        lengths = ends - starts + 1
        first = np.cumsum(lengths) - lengths
        owner = np.repeat(np.arange(len(starts)), lengths)
        at = np.arange(len(owner)) + np.repeat(starts - first, lengths)
        fault, share = seen.fault[at], seen.share[at]

        def least(x: np.ndarray) -> np.ndarray:
            hits = np.flatnonzero(x == np.minimum.reduceat(x, first)[owner])
            return np.asarray(at[hits[np.searchsorted(owner[hits], np.arange(len(starts)))]])

        margin = np.where(np.isnan(seen.margin[at]), -np.inf, seen.margin[at])
        worst, farthest = least(np.where(fault, margin, np.inf)), starts
        if share.any():
            farthest = least(-share)
        # of all FAULT windows: the rule counts some that an alarm begins after
        made = np.append(np.flatnonzero(flags) + tail - n, len(seen.fault))
        after = np.append(np.where(seen.missing, NO_DATA, OTHER), NO_SAMPLE)
        alarms = Raised(
            number=np.zeros(len(starts), np.int64),
            start=starts,
            end=ends,
            windows=np.add.reduceat(fault.astype(np.int64), first),
            depth=seen.margin[worst],
            worst=worst,
            first=made[np.searchsorted(made, starts - n + 1)],
            last=np.maximum.reduceat(np.where(fault, at, -1), first),
            after=after[ends + 1],
            sure=until + self.reach,
            outside=np.add.reduceat((share > 0).astype(np.int64), first),
            share=seen.share[farthest],
            by=seen.by[farthest].astype(np.int64),
            reading=seen.reading[farthest],
            instant=seen.instant[starts],
            suspect=np.full(len(starts), None, object),
            ended=np.full(len(starts), "", object),
        )
        return alarms, left

    def _follow(self, alarms: Raised, begun: int, over: int) -> None:
        """Give stretches to the alarms of their suspects. begun: how many began before; over: how many are
        over.
        """
        for i in range(len(alarms.start)):
            stretch = alarms.cut(slice(i, i + 1))
            if i >= begun:
                self._begin(stretch)
            if i < over:
                self._close(stretch)

    def _begin(self, stretch: Raised) -> None:
        """Ask for the suspect of a stretch, and begin its alarm where none is on."""
        at = int(stretch.start[0])
        self._sweep(at)
        self.repairs = False
        if self.blame is not None:
            stretch.suspect[0] = self.blame(at)
        alarm = self.alarms.get(stretch.name)
        if alarm is not None:
            self.repairs = (stretch.suspect[0] or UNKNOWN).ends(alarm.suspect[0] or UNKNOWN)
            return
        self.count += 1
        number, none = np.array([self.count]), np.zeros(1, np.int64)
        self.alarms[stretch.name] = stretch._replace(number=number, windows=none)
        self.began = self.alarms[stretch.name].behind(self.began)

    def _close(self, stretch: Raised) -> None:
        """Give a stretch that is over to its alarm."""
        alarm = self.alarms[stretch.name]
        if alarm.windows[0]:
            alarm = alarm.joined(stretch)
        else:
            alarm = stretch._replace(number=alarm.number, instant=alarm.instant)
        self.alarms[stretch.name] = alarm
        if self.rule.latch and self._repaired(stretch, alarm):
            self._end(alarm.name, int(stretch.sure[0]), f"{OPPOSITE} of {alarm.name}")

    def _repaired(self, stretch: Raised, alarm: Raised) -> bool:
        """Whether a stretch shows the opposite of the jump that an alarm began with, first or last."""
        if self.repairs:
            return True
        first, last = alarm.suspect[0] or UNKNOWN, int(stretch.last[0])
        if self.blame is None or not first.jump or last == stretch.start[0]:
            return False
        return self.blame(last).ends(first)

    def _sweep(self, sample: int) -> None:
        """End the alarms that nothing from a sample on can join any more."""
        if self.rule.latch:
            return
        for name, alarm in list(self.alarms.items()):
            last = int(alarm.end[0]) + int(self.rule.merge)
            if not self._is_on(name) and sample > last:
                self._end(name, max(int(alarm.sure[0]), last))

    def _end(self, name: str, sample: int, why: str = "") -> None:
        """End an alarm, as is known at a sample."""
        about = {"sure": np.array([sample]), "ended": np.array([why], object)}
        self.over = self.alarms.pop(name)._replace(**about).behind(self.over)

    def _end_now(self, name: str, why: str, sample: int) -> None:
        """End an alarm at the last sample."""
        self.alarms[name] = self.alarms[name]._replace(end=np.array([self.samples - 1]))
        self._end(name, sample, why)

    def finish(self) -> Raised:
        """Close the alarms that are on at the end of the recording; return them."""
        last, self.began = self.samples - 1, NOBODY
        if len(self.open.start):
            self._take(NOTHING, last)
        for name, alarm in list(self.alarms.items()):
            if not self.rule.latch:
                self._end(name, last)
            elif alarm.after[0] == NO_SAMPLE:
                self._end_now(name, "", last)
            else:
                self._end_now(name, LASTING, last)
        return self._told()

    def events(self, over: Raised) -> list[Event]:
        """Return the begins and the ends of alarms in the last samples, in order. over: those that end."""
        events = []
        for kind, alarms, samples in ((BEGINS, self.began, self.began.start), (ENDS, over, over.sure)):
            for i, number in enumerate(alarms.number.tolist()):
                events.append(Event(int(samples[i]), number, kind, alarms.cut(slice(i, i + 1))))
        return sorted(events, key=lambda event: event[:3])

    def pending(self) -> Raised:
        """Return the alarms that are on, as they would end if the recording ended here."""
        twin = Watch(self.rule)
        vars(twin).update(deepcopy(vars(self) | {"blame": None}), blame=self.blame)
        return twin.finish()

    def memory(self) -> dict[str, Any]:
        """Return the state, as JSON holds it."""
        return {
            "samples": self.samples,
            "count": self.count,
            "before": self.before.tolist(),
            "tail": list(map(np.ndarray.tolist, self.tail)),
            "open": self.open.memory(),
            "repairs": self.repairs,
            "alarms": {name: alarm.memory() for name, alarm in self.alarms.items()},
        }

    def resume(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        self.samples, self.count, self.repairs = memory["samples"], memory["count"], memory["repairs"]
        self.before = np.array(memory["before"], bool)
        self.tail = Seen(*map(np.array, memory["tail"], KINDS))
        self.open = Raised.of(memory["open"])
        self.alarms = {name: Raised.of(alarm) for name, alarm in memory["alarms"].items()}

    def _told(self) -> Raised:
        """Return the alarms that are over since the last call."""
        over, self.over = self.over, NOBODY
        if not len(over.start):
            return NOBODY
        return over.cut(np.argsort(over.sure, kind="stable"))


def alarms_in(rule: AlarmRule, seen: Seen, blame: Blame | None = None) -> Raised:
    """Return the alarms of a whole recording, in the order in which they begin. blame: see `Watch`."""
    watch = Watch(rule, blame)
    over = watch.add(seen)
    over = watch.finish().behind(over)
    return over.cut(np.argsort(over.number))
