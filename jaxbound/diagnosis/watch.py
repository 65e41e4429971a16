"""Alarms by a rule, as verdicts come: the same whatever the pieces they come in.

First FAULT windows are grouped into stretches (k of n, hold, clear), by array operations over samples. Where
the rule names nobody each is an alarm. Else a stretch is cut where another run begins in it, FAULT windows in
a row, and belongs to the alarm of that run's suspect: it begins one, or joins one that lasts or was on a
moment ago. An acknowledgement ends alarms that had begun, and the stretch that is on with them: what follows
begins anew.

The rule says when an alarm begins. When one that latches is over, and who is suspected, is read off all FAULT
windows, whether they count or not: of two rules, the stricter one is on at no sample at which the other is
off.
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
AT_ONCE, EVERY = 256, 256
"""Runs whose suspects are asked for one after the other, and samples until one more may be: exact rationals
of each of 100 000 runs take an hour. The others have the suspect of the run before, and repair nothing.
"""
NO_SAMPLE, NO_DATA, OTHER = range(3)  # what follows an alarm
RUN_ENDS, ENDS_BEFORE, RUN_BEGINS, BEGINS_HERE = range(4)
Blame = Callable[[int, int], Suspect]
"""The suspects of the FAULT window that ends at a sample; of a monitor with the number of the test that
speaks there.
"""


class Seen(NamedTuple):
    """Samples as a Watch sees them, arrays (N,).

    Fields: fault: bool, windows that count. margin. missing: bool. share, by, reading: of the departure from
    the region of training; share is 0 where there is none. instant: the time in s by which alarms are
    acknowledged, see `Recording.instants`. test: the number of the test of a monitor that speaks, -1: none.
    proved: bool, all FAULT windows. run: the sample at which the last run of them began, as a Watch numbers
    them, -1: none did.
    """

    fault: np.ndarray
    margin: np.ndarray
    missing: np.ndarray
    share: np.ndarray
    by: np.ndarray
    reading: np.ndarray
    instant: np.ndarray
    test: np.ndarray
    proved: np.ndarray
    run: np.ndarray

    @classmethod
    def of(
        cls,
        fault: np.ndarray,
        margin: np.ndarray,
        missing: np.ndarray,
        departure: Departure | None = None,
        instant: np.ndarray | None = None,
        test: np.ndarray | None = None,
        proved: np.ndarray | None = None,
    ) -> "Seen":
        """Return the samples. departure: from the region of training; instant: nobody acknowledges without
        it; test: of a monitor; None: not known. proved: None: all FAULT windows count.
        """
        share = by = reading = np.zeros(len(fault))
        if departure is not None:
            share = np.where(fault & (departure.share > 0), departure.share, 0.0)
            by, reading = departure.by, departure.reading
        if instant is None:
            instant = np.full(len(fault), np.nan)
        if test is None:
            test = np.full(len(fault), -1)
        if proved is None:
            proved = fault
        none = np.full(len(fault), -1)
        return cls(fault, margin, missing, share, by, reading, instant, test, proved, none)

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
KINDS = bool, float, bool, float, float, float, float, int, bool, int  # of the fields of Seen


class Raised(NamedTuple):
    """An alarm, or a stretch that it is made of.

    Fields: start, end, windows, depth, worst: as of an Alarm; first, last: the first and last FAULT window
    that made it. after: what follows it, NO_SAMPLE, NO_DATA or OTHER. sure: the sample at which it is known
    to be over. outside: how many of its FAULT windows lie outside the region of training; share, by, reading:
    of the farthest. instant: of its start, see `Seen`. test, begun_by, last_by: of a monitor the numbers of
    the tests that speak at `worst`, `start` and `last`. run: the first sample of the run that it began with.
    own: the last sample before a run of somebody else. number: counted from 1. suspect: UNKNOWN where it is
    not asked for. ended: why it is over, "" where the rule does not say it. lasts: whether it stays on while
    nothing is FAULT.
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
    run: int
    own: int
    number: int = 0
    suspect: Suspect = UNKNOWN
    ended: str = ""
    lasts: bool = False

    @classmethod
    def of(cls, memory: Sequence[Any]) -> "Raised":
        """Return the alarm that a memory, as JSON holds it, has."""
        *numbers, suspect, ended, lasts = memory
        return cls._make([*numbers, Suspect.of(suspect), ended, lasts])

    def joined(self, other: "Raised") -> "Raised":
        """Return an alarm with a stretch that came later."""
        both = self._replace(end=max(self.end, other.end), own=max(self.own, other.own))
        both = both._replace(after=other.after, sure=other.sure)
        both = both._replace(windows=self.windows + other.windows, outside=self.outside + other.outside)
        if other.share > self.share:
            both = both._replace(share=other.share, by=other.by, reading=other.reading)
        if not other.windows:
            return both
        if not np.isnan(self.depth) and not other.depth >= self.depth:  # NaN is the deepest
            both = both._replace(depth=other.depth, worst=other.worst, test=other.test)
        return both._replace(last=other.last, last_by=other.last_by)


class Run(NamedTuple):
    """FAULT windows in a row, whether they count or not. Fields: suspect: of the first of them. repairs:
    whether that takes back the jump of a fault that lasts. asked: whether somebody was asked, see `AT_ONCE`.
    """

    suspect: Suspect
    repairs: bool = False
    asked: bool = True


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
    those that began in the last samples, of which number, start, instant and suspect count. faults: {suspect:
    that of the first window}, of all FAULT windows that nothing took back yet, of a rule with latch.
    """

    def __init__(self, rule: AlarmRule, blame: Blame | None = None) -> None:
        self.rule, self.blame = rule, blame
        self.acknowledged = rule.acknowledgements
        self.reach = rule.hold + rule.clear
        self.samples = self.count = 0
        self.before = np.zeros(0, bool)  # the last n - 1 entries of `fault`
        self.open: Raised | None = None
        self.tail = NOTHING  # the last sample at which it was on, counted, and those behind it
        self.runs: dict[int, Run] = {}  # by first sample: those that the open stretch and its tail ask for
        self.latest, self.running = -1, False  # where the last one began, and whether it is on
        self.credit = AT_ONCE * EVERY  # samples for questions
        self.spoke = -1  # the test that speaks at the last sample
        self.faults: dict[str, Suspect] = {}
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
        begun = [name for name, alarm in self.alarms.items() if alarm.instant <= instant]
        for name in begun:
            if name in (self._on(), self._suspected()):
                self._take(NOTHING, known)
            alarm = self.alarms[name]
            if alarm.lasts:
                del self.faults[name]
                self._end_now(name, ACKNOWLEDGED, known)
            else:  # ended by an opposite jump, and nothing joins it any more
                self._end(name, max(alarm.sure, known), alarm.ended)
        if begun and self.open is None:
            self.before = np.zeros(len(self.before), bool)

    @property
    def is_quiet(self) -> bool:
        """Whether no alarm and no run is on, and none of the last flags counts for one."""
        return self.open is None and not self.alarms and not self.running and not self.before.any()

    def _open_run(self) -> int:
        """Return the first sample of the run that the stretch which is on began with; -1: none is on."""
        if self.open is None:
            return -1
        return self.open.run

    def _on(self) -> str | None:
        """Return the suspect of the stretch that is on; None: none is."""
        if self.open is None:
            return None
        return self.open.suspect.first

    def _suspected(self) -> str | None:
        """Return the suspect of the run that is on; None: none is."""
        if not self.running:
            return None
        return self.runs[self.latest].suspect.first

    def _take(self, seen: Seen, sure: int | None = None) -> None:
        """Take samples between acknowledgements. sure: the stretch that is on is known to be over there."""
        before = self.open
        if self.is_quiet and not seen.proved.any():
            self.skip(len(seen.fault))
            return
        everything, offset = self._numbered(seen).behind(self.tail), self.samples - len(self.tail.fault)
        alarms, left = self._stretches(everything, seen.fault, offset, sure)
        if before is not None:
            alarms[0] = before.joined(alarms[0])
        flags = np.concatenate([self.before, seen.fault])
        self.before = flags[max(len(flags) - self.rule.n + 1, 0) :]
        self.open, self.tail, count = None, NOTHING, len(alarms)
        if left is not None:
            self.tail, count = everything.cut(left).counted(), count - 1
        begun = int(before is not None)
        if self.rule.names:
            self._follow(seen, alarms, begun, count, sure)
        else:
            self.count += len(alarms) - begun
            self.began += alarms[begun:]
            self.over += alarms[:count]
        self.samples += len(seen.fault)
        if left is not None:
            self.open = alarms[-1]
        if self.rule.names:
            self._forget()
        if sure is None:
            self._sweep(self.samples)

    def _numbered(self, seen: Seen) -> Seen:
        """Return the next samples with the runs that they lie in, or behind."""
        if not self.rule.names:
            return seen
        begins = seen.proved & ~np.append(self.running, seen.proved)[:-1]
        starts = np.where(begins, self.samples + np.arange(len(begins)), -1)
        return seen._replace(run=np.maximum.accumulate(np.append(self.latest, starts))[1:])

    def _forget(self) -> None:
        """Forget the runs that nothing asks for any more."""
        first = self.latest
        if self.open is not None:
            first = min(first, self.open.run)
        self.runs = {start: run for start, run in self.runs.items() if start >= first}

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
        sure_from = until + self.reach + offset
        if sure is not None:
            sure_from = np.full(len(starts), sure)
        if self.rule.names:  # a stretch is cut at the first window that counts of another run
            counted = on[seen.fault[on]]
            turns = counted[np.diff(seen.run[counted], prepend=self._open_run()) != 0]
            all_starts = np.union1d(starts, turns)
            of = np.searchsorted(starts, all_starts, "right") - 1
            following = np.append(all_starts[1:], len(seen.fault))
            is_cut = following <= ends[of]
            sure_from = np.where(is_cut, following + offset, sure_from[of])
            starts, ends = all_starts, np.where(is_cut, following - 1, ends[of])
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
        columns = (
            starts + offset,
            ends + offset,
            np.add.reduceat(fault.astype(np.int64), first),
            seen.margin[worst],
            worst + offset,
            made[np.searchsorted(made, starts - n + 1)] + offset,
            last + offset,
            after[ends + 1],
            sure_from,
            np.add.reduceat((share > 0).astype(np.int64), first),
            seen.share[farthest],
            seen.by[farthest].astype(np.int64),
            seen.reading[farthest],
            seen.instant[starts],
            seen.test[worst],
            seen.test[starts],
            seen.test[last],
            seen.run[starts],
            ends + offset,
            self.count + np.arange(len(starts)) + (not tail),
        )
        return [Raised(*row) for row in zip(*map(np.ndarray.tolist, columns), strict=True)], left

    def _follow(self, seen: Seen, alarms: list[Raised], begun: int, over: int, sure: int | None) -> None:
        """Give stretches to the alarms of their suspects, and follow the runs of the next samples.

        Args:
            seen: the next samples. begun: how many stretches began before. over: how many are over. sure: the
                run that is on is over, too, as is known there.
        """
        steps: list[tuple[int, int, int]] = []  # what happens at the same sample does in this order
        was_on = np.append(self.running, seen.proved)
        for at in np.flatnonzero(was_on[1:] != was_on[:-1]).tolist():
            kind = (RUN_ENDS, RUN_BEGINS)[int(seen.proved[at])]
            steps.append((self.samples + at, kind, at))
        last = stop = self.samples + len(seen.proved)
        if sure is not None:
            last = sure
            if was_on[-1]:
                steps.append((stop, RUN_ENDS, len(seen.proved)))
        for i, alarm in enumerate(alarms):
            if i >= begun:
                steps.append((alarm.start, BEGINS_HERE, i))
            if i < over:
                steps.append((alarm.end + 1, ENDS_BEFORE, i))
        tests = np.append(self.spoke, seen.test)
        for sample, kind, i in sorted(steps):
            if kind == RUN_BEGINS:
                self._run_begins(sample, int(tests[i + 1]))
            elif kind == RUN_ENDS:
                self._run_ends(sample - 1, int(tests[i]), min(sample, last))
            elif kind == BEGINS_HERE:
                alarms[i] = self._begin(alarms[i])
            else:
                self._close(alarms[i])
        self.spoke = int(tests[-1])

    def _run_begins(self, start: int, test: int) -> None:
        """Ask for the suspect of a run, where it begins."""
        self.credit = min(self.credit + start - self.latest, AT_ONCE * EVERY)
        run = Run(UNKNOWN)
        if self.blame is not None and self.credit < EVERY:
            run = Run(self.runs[self.latest].suspect, asked=False)
        elif self.blame is not None:
            self.credit -= EVERY
            run = Run(self.blame(start, test))
        self.latest, self.running = start, True
        if self.rule.latch:
            fault = self.faults.setdefault(run.suspect.first, run.suspect)
            run = run._replace(repairs=run.asked and run.suspect.ends(fault))
        self.runs[start] = run

    def _run_ends(self, last: int, test: int, sure: int) -> None:
        """End the fault of a run that shows the opposite of the jump it began with, first or last.

        Args:
            last: its last sample. test: that speaks there. sure: the sample at which it is known to be over.
        """
        run, self.running = self.runs[self.latest], False
        name = run.suspect.first
        if not self.rule.latch or not self._repaired(run, last, test):
            return
        del self.faults[name]
        alarm = self.alarms.get(name)
        if alarm is not None and alarm.lasts:
            alarm = alarm._replace(end=max(alarm.end, last), own=max(alarm.own, last))
            alarm = alarm._replace(sure=max(alarm.sure, sure), ended=f"{OPPOSITE} of {name}", lasts=False)
            self.alarms[name] = alarm

    def _repaired(self, run: Run, last: int, test: int) -> bool:
        """Whether a run shows the opposite of the jump that its fault began with, first or last."""
        fault = self.faults[run.suspect.first]
        if run.repairs:
            return True
        if self.blame is None or not run.asked or not fault.jump or last == self.latest:
            return False
        return self.blame(last, test).ends(fault)

    def _begin(self, stretch: Raised) -> Raised:
        """Begin the alarm of a stretch where none of its suspect is on; return the stretch with it."""
        self._sweep(stretch.start)
        stretch = stretch._replace(suspect=self.runs[stretch.run].suspect, lasts=self.rule.latch)
        name = stretch.suspect.first
        if name in self.alarms:
            self.alarms[name] = self.alarms[name]._replace(ended="", lasts=stretch.lasts)
            return stretch
        self.count += 1
        begun = stretch._replace(number=self.count, windows=0)
        self.alarms[name] = begun._replace(end=stretch.start, own=stretch.start, sure=stretch.start)
        self.began.append(begun)
        return stretch

    def _close(self, stretch: Raised) -> None:
        """Give a stretch that is over to its alarm."""
        name = stretch.suspect.first
        for start, run in reversed(self.runs.items()):
            if start <= stretch.run:
                break
            if run.suspect.first != name:
                stretch = stretch._replace(own=min(stretch.own, start - 1))
        alarm = self.alarms[name]
        both = alarm.joined(stretch)
        if not alarm.windows:
            both = stretch._replace(number=alarm.number, instant=alarm.instant)
            both = both._replace(end=max(alarm.end, stretch.end), own=max(alarm.own, stretch.own))
        both = both._replace(lasts=alarm.lasts, ended=alarm.ended, sure=max(alarm.sure, stretch.sure))
        self.alarms[name] = both

    def _sweep(self, sample: int) -> None:
        """End the alarms that nothing from a sample on can join any more."""
        for name, alarm in list(self.alarms.items()):
            last = alarm.own + int(self.rule.merge)
            if not alarm.lasts and name != self._on() and sample > last:
                self._end(name, max(alarm.sure, last), alarm.ended)

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
        if self.open is not None or self.running:
            self._take(NOTHING, last)
        for name, alarm in list(self.alarms.items()):
            if not alarm.lasts:
                self._end(name, last, alarm.ended)
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
            "runs": list(self.runs.items()),
            "latest": self.latest,
            "running": self.running,
            "spoke": self.spoke,
            "credit": self.credit,
            "faults": self.faults,
            "alarms": dict(self.alarms),
        }

    def resume(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        self.samples, self.count = memory["samples"], memory["count"]
        self.latest, self.running, self.spoke = memory["latest"], memory["running"], memory["spoke"]
        self.credit = memory["credit"]
        self.runs = {start: Run(Suspect.of(names), *run) for start, (names, *run) in memory["runs"]}
        self.faults = {name: Suspect.of(suspect) for name, suspect in memory["faults"].items()}
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
