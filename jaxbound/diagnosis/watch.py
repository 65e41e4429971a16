"""Alarms by a rule, as verdicts come: the same whatever the pieces they come in.

First FAULT windows are grouped into stretches (k of n, hold, clear), by array operations over samples. Where
the rule names nobody each is an alarm. Else a stretch belongs to the alarm of its suspect: it begins one,
joins one that is on or was on a moment ago, or ends one as an opposite jump. An acknowledgement ends alarms
that had begun, and the stretch that is on with them: what follows begins anew.
"""

from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np

from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.suspects import UNKNOWN, Suspect
from jaxbound.models.region import Departure

OPPOSITE = "ended by an opposite jump"
ACKNOWLEDGED = "acknowledged"
LASTING = "open at the end: nothing speaks for a repair"
BEGINS, ENDS = "begins", "ends"
NUMBER = attrgetter("number")
NO_SAMPLE, NO_DATA, OTHER = range(3)  # what follows an alarm
Blame = Callable[[int, int], Suspect]
"""The suspects of the FAULT window that ends at a sample; of a monitor with the number of the test that
speaks there.
"""


class Seen(NamedTuple):
    """Samples as a Watch sees them, arrays (N,).

    Fields: fault: bool, windows that count. margin. missing: bool. share, by, reading: of the departure from
    the region of training; share is 0 where there is none. instant: the time in s by which alarms are
    acknowledged, see `Recording.instants`. test: the number of the test of a monitor that speaks, -1: none.
    """

    fault: np.ndarray
    margin: np.ndarray
    missing: np.ndarray
    share: np.ndarray
    by: np.ndarray
    reading: np.ndarray
    instant: np.ndarray
    test: np.ndarray

    @classmethod
    def of(
        cls,
        fault: np.ndarray,
        margin: np.ndarray,
        missing: np.ndarray,
        departure: Departure | None = None,
        instant: np.ndarray | None = None,
        test: np.ndarray | None = None,
    ) -> "Seen":
        """Return the samples. departure: from the region of training; instant: nobody acknowledges without
        it; test: of a monitor; None: not known.
        """
        share = by = reading = np.zeros(len(fault))
        if departure is not None:
            share = np.where(fault & (departure.share > 0), departure.share, 0.0)
            by, reading = departure.by, departure.reading
        if instant is None:
            instant = np.full(len(fault), np.nan)
        if test is None:
            test = np.full(len(fault), -1)
        return cls(fault, margin, missing, share, by, reading, instant, test)

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
KINDS = bool, float, bool, float, float, float, float, int  # of the fields of Seen


class Raised(NamedTuple):
    """An alarm, or a stretch that it is made of.

    Fields: start, end, windows, depth, worst: as of an Alarm; first, last: the first and last FAULT window
    that made it. after: what follows it, NO_SAMPLE, NO_DATA or OTHER. sure: the sample at which it is known
    to be over. outside: how many of its FAULT windows lie outside the region of training; share, by, reading:
    of the farthest. instant: of its start, see `Seen`. test, begun_by, last_by: of a monitor the numbers of
    the tests that speak at `worst`, `start` and `last`. number: counted from 1. suspect: UNKNOWN where it is
    not asked for. ended: why it is over, "" where the rule does not say it.
    """

    start: int
    end: int
    windows: int
    depth: float
    worst: int
    first: int
    last: int
    after: int
    sure: int
    outside: int
    share: float
    by: int
    reading: float
    instant: float
    test: int
    begun_by: int
    last_by: int
    number: int = 0
    suspect: Suspect = UNKNOWN
    ended: str = ""

    @classmethod
    def of(cls, memory: Sequence[Any]) -> "Raised":
        """Return the alarm that a memory, as JSON holds it, has."""
        *numbers, (names, size, jump, cause), ended = memory
        return cls._make([*numbers, Suspect(tuple(names), size, jump, cause), ended])

    def joined(self, other: "Raised") -> "Raised":
        """Return an alarm with a stretch that came later."""
        both = self._replace(end=other.end, after=other.after, sure=other.sure)
        both = both._replace(windows=self.windows + other.windows, outside=self.outside + other.outside)
        if other.share > self.share:
            both = both._replace(share=other.share, by=other.by, reading=other.reading)
        if not other.windows:
            return both
        if not np.isnan(self.depth) and not other.depth >= self.depth:  # NaN is the deepest
            both = both._replace(depth=other.depth, worst=other.worst, test=other.test)
        return both._replace(last=other.last, last_by=other.last_by)


class Event(NamedTuple):
    """The begin or the end of an alarm. Fields: sample: at which it was known; number: of the alarm; kind:
    BEGINS or ENDS.
    """

    sample: int
    number: int
    kind: str
    alarm: Raised


class Watch:
    """The alarms of one recording by a rule.

    Args:
        rule: an AlarmRule that is `fitted`. blame: tells suspects; None: not asked for.

    Fields: samples: how many there were. count: of alarms. open: the stretch that is on, None: none. began:
    those that began in the last samples, of which number, start, instant and suspect count.
    """

    def __init__(self, rule: AlarmRule, blame: Blame | None = None) -> None:
        self.rule, self.blame = rule, blame
        self.acknowledged = rule.acknowledgements
        self.reach = rule.hold + rule.clear
        self.samples = self.count = 0
        self.before = np.zeros(0, bool)  # the last n - 1 entries of `fault`
        self.open: Raised | None = None
        self.tail = NOTHING  # the last sample at which it was on, counted, and those behind it
        self.repairs = False
        self.alarms: dict[str, Raised] = {}  # by suspect, of a rule that names them; without windows at first
        self.began: list[Raised] = []
        self.over: list[Raised] = []

    def add(self, seen: Seen) -> list[Raised]:
        """Take the next samples; return the alarms that are over by them, in the order in which it is
        known.
        """
        begin, low = self.samples, 0
        self.began = []
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

    def _acknowledgements(self, seen: Seen) -> Iterator[tuple[float, int, int]]:
        """Yield (time, number of the sample at which it is known, that of the first sample behind it) of
        each acknowledgement that may end an alarm in some samples.
        """
        if not self.acknowledged.is_given or not (self.alarms or seen.fault.any()) or not len(seen.fault):
            return
        for instant in self.acknowledged.between(float(seen.instant[0]), float(seen.instant.max())):
            known = int(np.argmax(seen.instant >= instant))
            yield instant, known, known + int(seen.instant[known] == instant)

    def _acknowledge(self, instant: float, known: int) -> None:
        """End the alarms that had begun at a time, as is known at a sample.

        Whoever does it twice ends nothing more: an alarm that begins behind it began later.
        """
        acknowledged = [name for name, alarm in self.alarms.items() if alarm.instant <= instant]
        for name in acknowledged:
            if self._is_on(name):
                self._take(NOTHING, known)
            if name in self.alarms:  # not ended by an opposite jump just now
                self._end_now(name, ACKNOWLEDGED, known)
        if acknowledged and self.open is None:
            self.before = np.zeros(len(self.before), bool)

    @property
    def is_quiet(self) -> bool:
        """Whether no alarm is on, and none of the last flags counts for one."""
        return self.open is None and not self.alarms and not self.before.any()

    def _is_on(self, name: str) -> bool:
        """Whether the stretch that is on is one of a suspect."""
        return self.open is not None and self.open.suspect.first == name

    def _take(self, seen: Seen, sure: int | None = None) -> None:
        """Take samples between acknowledgements. sure: the stretch that is on is known to be over there."""
        before = self.open
        if self.is_quiet and not seen.fault.any():
            self.skip(len(seen.fault))
            return
        everything, offset = seen.behind(self.tail), self.samples - len(self.tail.fault)
        alarms, left = self._stretches(everything, seen.fault, offset, sure)
        if before is not None:
            alarms[0] = before.joined(alarms[0])
        self.samples += len(seen.fault)
        flags = np.concatenate([self.before, seen.fault])
        self.before = flags[max(len(flags) - self.rule.n + 1, 0) :]
        self.open, self.tail, count = None, NOTHING, len(alarms)
        if left is not None:
            self.tail, count = everything.cut(left).counted(), count - 1
        begun = int(before is not None)
        if self.rule.names:
            self._follow(alarms, begun, count)
        else:
            self.count += len(alarms) - begun
            self.began += alarms[begun:]
            self.over += alarms[:count]
        if left is not None:
            self.open = alarms[-1]
        if sure is None:
            self._sweep(self.samples)

    def _stretches(
        self, seen: Seen, new: np.ndarray, offset: int, sure: int | None
    ) -> tuple[list[Raised], int | None]:
        """Return (the stretches of samples, the first being the rest of the one that is on; which of the
        samples is the last at which the last stretch was on, None: it is over).

        Args:
            seen: samples from the tail on, `offset` the number of the first. new: the flags of those behind
                it.
        """
        k, n = self.rule.k, self.rule.n
        tail = len(seen.fault) - len(new)
        flags = np.concatenate([np.zeros(n - len(self.before), bool), self.before, new])
        on = np.flatnonzero(often(flags, k, n)) + tail
        if tail:
            on = np.append(0, on)
        if not len(on):
            return [], None
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
        last = np.maximum.reduceat(np.where(fault, at, -1), first)
        # of all FAULT windows: the rule counts some that an alarm begins after
        made = np.append(np.flatnonzero(flags) + tail - n, len(seen.fault))
        after = np.append(np.where(seen.missing, NO_DATA, OTHER), NO_SAMPLE)
        known = until + self.reach + offset
        if sure is not None:
            known = np.full(len(starts), sure)
        columns = (
            starts + offset,
            ends + offset,
            np.add.reduceat(fault.astype(np.int64), first),
            seen.margin[worst],
            worst + offset,
            made[np.searchsorted(made, starts - n + 1)] + offset,
            last + offset,
            after[ends + 1],
            known,
            np.add.reduceat((share > 0).astype(np.int64), first),
            seen.share[farthest],
            seen.by[farthest].astype(np.int64),
            seen.reading[farthest],
            seen.instant[starts],
            seen.test[worst],
            seen.test[starts],
            seen.test[last],
            self.count + np.arange(len(starts)) + (not tail),
        )
        return [Raised(*row) for row in zip(*map(np.ndarray.tolist, columns), strict=True)], left

    def _follow(self, alarms: list[Raised], begun: int, over: int) -> None:
        """Give stretches to the alarms of their suspects. begun: how many began before; over: how many are
        over.
        """
        for i in range(len(alarms)):
            if i >= begun:
                alarms[i] = self._begin(alarms[i])
            if i < over:
                self._close(alarms[i])

    def _begin(self, stretch: Raised) -> Raised:
        """Begin the alarm of a stretch where none of its suspect is on; return the stretch with it."""
        self._sweep(stretch.start)
        self.repairs = False
        if self.blame is not None:
            stretch = stretch._replace(suspect=self.blame(stretch.start, stretch.begun_by))
        name = stretch.suspect.first
        if name in self.alarms:
            self.repairs = stretch.suspect.ends(self.alarms[name].suspect)
            return stretch
        self.count += 1
        self.alarms[name] = stretch._replace(number=self.count, windows=0)
        self.began.append(self.alarms[name])
        return stretch

    def _close(self, stretch: Raised) -> None:
        """Give a stretch that is over to its alarm."""
        name = stretch.suspect.first
        alarm = self.alarms[name]
        if alarm.windows:
            alarm = alarm.joined(stretch)
        else:
            alarm = stretch._replace(number=alarm.number, instant=alarm.instant)
        self.alarms[name] = alarm
        if self.rule.latch and self._repaired(stretch, alarm):
            self._end(name, stretch.sure, f"{OPPOSITE} of {name}")

    def _repaired(self, stretch: Raised, alarm: Raised) -> bool:
        """Whether a stretch shows the opposite of the jump that an alarm began with, first or last."""
        if self.repairs:
            return True
        if self.blame is None or not alarm.suspect.jump or stretch.last == stretch.start:
            return False
        return self.blame(stretch.last, stretch.last_by).ends(alarm.suspect)

    def _sweep(self, sample: int) -> None:
        """End the alarms that nothing from a sample on can join any more."""
        if self.rule.latch:
            return
        for name, alarm in list(self.alarms.items()):
            last = alarm.end + int(self.rule.merge)
            if not self._is_on(name) and sample > last:
                self._end(name, max(alarm.sure, last))

    def _end(self, name: str, sample: int, why: str = "") -> None:
        """End an alarm, as is known at a sample."""
        self.over.append(self.alarms.pop(name)._replace(sure=sample, ended=why))

    def _end_now(self, name: str, why: str, sample: int) -> None:
        """End an alarm at the last sample."""
        self.alarms[name] = self.alarms[name]._replace(end=self.samples - 1)
        self._end(name, sample, why)

    def finish(self) -> list[Raised]:
        """Close the alarms that are on at the end of the recording; return them."""
        last, self.began = self.samples - 1, []
        if self.open is not None:
            self._take(NOTHING, last)
        for name, alarm in list(self.alarms.items()):
            if not self.rule.latch:
                self._end(name, last)
            elif alarm.after == NO_SAMPLE:
                self._end_now(name, "", last)
            else:
                self._end_now(name, LASTING, last)
        return self._told()

    def events(self, over: Sequence[Raised]) -> list[Event]:
        """Return the begins and the ends of alarms in the last samples, in order. over: those that end."""
        events = [Event(alarm.start, alarm.number, BEGINS, alarm) for alarm in self.began]
        events += [Event(alarm.sure, alarm.number, ENDS, alarm) for alarm in over]
        return sorted(events, key=lambda event: event[:3])

    def pending(self) -> list[Raised]:
        """Return the alarms that are on, as they would end if the recording ended here, the first first."""
        twin = Watch(self.rule)
        vars(twin).update(deepcopy(vars(self) | {"blame": None}), blame=self.blame)
        return sorted(twin.finish(), key=NUMBER)

    def memory(self) -> dict[str, Any]:
        """Return the state, as JSON holds it."""
        return {
            "samples": self.samples,
            "count": self.count,
            "before": self.before.tolist(),
            "tail": list(map(np.ndarray.tolist, self.tail)),
            "open": self.open,
            "repairs": self.repairs,
            "alarms": dict(self.alarms),
        }

    def resume(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        self.samples, self.count, self.repairs = memory["samples"], memory["count"], memory["repairs"]
        self.before = np.array(memory["before"], bool)
        self.tail = Seen(*map(np.array, memory["tail"], KINDS))
        self.open = None
        if memory["open"] is not None:
            self.open = Raised.of(memory["open"])
        self.alarms = {name: Raised.of(alarm) for name, alarm in memory["alarms"].items()}

    def _told(self) -> list[Raised]:
        """Return the alarms that are over since the last call."""
        over, self.over = self.over, []
        return sorted(over, key=attrgetter("sure"))


def often(flags: np.ndarray, k: int, n: int) -> np.ndarray:
    """Return (T,) bool: whether k of the last n flags are set. flags: (n + T,), n of samples before."""
    count = np.cumsum(flags)
    return np.asarray(count[n:] - count[:-n] >= k)
