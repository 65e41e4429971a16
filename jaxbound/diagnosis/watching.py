"""Alarms by a rule over the verdicts of relations, as they come: in words, with suspects and sizes."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.consistency.monitorbank import MonitorBank
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.alarms import Alarm, ending_of, forgets_after
from jaxbound.diagnosis.causes import Explained, Verdicts
from jaxbound.diagnosis.severity import Severity
from jaxbound.diagnosis.suspects import UNKNOWN, Suspect, nameless, suspect_of_window
from jaxbound.diagnosis.watch import NUMBER, Raised, Seen, Watch
from jaxbound.models.region import Region
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.sets.floats.status import Status

NONE = np.zeros((0, 0))


class Watching:
    """The alarms of relations, by a rule.

    Args:
        rule: that is `fitted`. relations: as tested; None: it is not known what judged. method: of the test.
        u, y: (T, m), (T, p) all samples of the recording; a subclass that has others states `samples`.

    Fields: watch: the alarms so far. asks: whether samples are asked for.

    Raises:
        ValueError: a rule with least sizes for relations that do not tell errors of single sensors.
    """

    def __init__(
        self,
        rule: AlarmRule,
        relations: Relations | None,
        method: str,
        u: np.ndarray = NONE,
        y: np.ndarray = NONE,
    ) -> None:
        self.rule, self.method, self.u, self.y = rule, method, u, y
        self.watch = Watch(rule)
        self.horizon: int | None = 0  # of what nobody knows no onset leaves a window
        self.region: Region | None = None
        self.severity: Severity | None = None
        self.names: tuple[str, ...] = ()
        if relations is not None:
            self.relations = relations
            self.horizon, self.region = forgets_after(relations), Region.of(relations)
            self.names = tuple(relations.parts)
            if rule.names and not nameless(relations):
                self.watch.blame = self._blame
            if rule.least is not None:
                self.severity = Severity(relations, method, cast(Mapping[str, float], rule.least))
        self.asks = self.watch.blame is not None or self.severity is not None

    def samples(self, first: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Return (u, y) of some samples up to the last one that was taken, by their numbers."""
        return self.u[first:stop], self.y[first:stop]

    def whole(
        self,
        verdicts: Verdicts,
        instants: np.ndarray | None,
        result: Explained | None,
        recording: tuple[int, ...] = (),
    ) -> list[Alarm]:
        """Return the alarms of a recording that comes as one, in order of time. instants: as for `follow`;
        result, recording: see `Alarm`.
        """
        over = [*self.follow(verdicts, instants), *self.watch.finish()]
        return self.alarms_of(sorted(over, key=NUMBER), recording, result)

    def follow(self, verdicts: Verdicts, instants: np.ndarray | None) -> list[Raised]:
        """Take the next verdicts; return the alarms that are over.

        Args:
            instants: the times by which alarms are acknowledged; None: nobody does.
        """
        by = self._speaking(verdicts)
        fault, missing = verdicts.status == Status.FAULT, verdicts.status == Status.MISSING
        proved = fault
        if self.severity is not None and fault.any():
            fault = self._counted(fault, by, self.severity)
        seen = Seen.of(fault, verdicts.margin, missing, verdicts.departure, instants, by, proved)
        return self.watch.add(seen)

    def alarms_of(
        self, over: Sequence[Raised], recording: tuple[int, ...] = (), result: Explained | None = None
    ) -> list[Alarm]:
        """Return the Alarms of those that are over. recording, result: see `Alarm`."""
        alarms = []
        for one in over:
            outside, words, test = None, "", ""
            if self.names:
                test = self.name_of(one.test)
            if self.region is not None:
                outside = one.outside
                if one.share > 0:
                    words = self.region.words(one.by, one.reading, test)
            suspect = self._sized(one)
            alarm = Alarm(
                one.start,
                one.end,
                one.windows,
                one.depth,
                one.worst,
                recording,
                result,
                ended=one.ended or ending_of(one, self.horizon),
                outside=outside,
                outside_by=words,
                suspects=suspect.names,
                size=suspect.size,
                test=test,
                cause=suspect.cause,
            )
            alarms.append(alarm)
        return alarms

    def _sized(self, one: Raised) -> Suspect:
        """Return the suspects of an alarm with the cause of its worst window, and the size there if the first
        of them alone explains it.
        """
        if self.watch.blame is None:
            return one.suspect
        worst = self._blame(one.worst, one.test, one.suspect.first)
        suspect = one.suspect._replace(cause=worst.cause)
        if worst.first == suspect.first:
            suspect = suspect._replace(size=worst.size)
        return suspect

    def name_of(self, test: int) -> str:
        """Return the name of a test of a monitor by its number; "" of none."""
        return ("", *self.names)[test + 1]

    def _speaking(self, verdicts: Verdicts) -> np.ndarray | None:
        """Return the numbers of the tests of a monitor that speak at each sample, else None."""
        if not self.names:
            return None
        told = cast(Any, verdicts)
        # parts of a recording name those that speak in them
        numbers = [self.names.index(name) for name in told.names]
        return np.asarray(np.array([-1, *numbers], np.int16)[told.by + 1])

    def _counted(self, fault: np.ndarray, by: np.ndarray | None, severity: Severity) -> np.ndarray:
        """Return the FAULT windows that count."""
        at = np.flatnonzero(fault)
        first, stop, begin = int(at[0]), int(at[-1]) + 1, self.watch.samples
        before = min(self.relations.reach, begin + first)
        u, y = self.samples(begin + first - before, begin + stop)
        around = np.concatenate([np.zeros(before, bool), fault[first:stop]])
        if by is not None:
            by = np.concatenate([np.full(before, -1), by[first:stop]])
        counts = np.zeros_like(fault)
        counts[first:stop] = severity.reached(u, y, around, by)[before:]
        return counts

    def _blame(self, sample: int, test: int, first: str | None = None) -> Suspect:
        """Return the suspects of the window that ends at a sample, of a monitor of the test that speaks.
        first: as of `suspect_of_window`.
        """
        if not self.names:
            u, y = self.samples(sample - self.relations.horizon, sample + 1)
            return suspect_of_window(self.relations, np.asarray(u), np.asarray(y), first)
        bank = cast(MonitorBank, self.relations)
        relations = bank.watches[test].relations
        if nameless(relations):
            return UNKNOWN
        u, y = (np.asarray(x) for x in self.samples(sample - relations.horizon, sample + 1))
        seen = bank.seen_by(test, Recording(u, y, NOWHERE), bank.modes_of(u))
        return suspect_of_window(relations, seen.u, seen.y, first)
