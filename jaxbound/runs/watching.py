"""Alarms by a rule over verdicts that come in pieces: the samples of their FAULT windows are asked for."""

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias, cast

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.consistency.monitorbank import MonitorBank
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.severity import MonitorSeverity, Severity, severity_of
from jaxbound.diagnosis.suspects import UNKNOWN, Suspect, nameless, suspect_of_window
from jaxbound.diagnosis.watch import Event, Labels, Seen, Watch
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.runs.sink import Verdicts
from jaxbound.sets.floats.status import Status

__all__ = ["Samples", "Watching"]

Samples: TypeAlias = Callable[[int, int], tuple[np.ndarray, np.ndarray]]
"""samples(first, stop) returns (u, y) of some samples, by their numbers in the recording."""


class Watching:
    """The alarms of relations, by a rule.

    Args:
        rule: that is `fitted`. relations, method: as tested. samples: those up to the piece that is being
            taken.

    Fields: watch: the alarms so far. before: so many samples before its last one a test of them reads. keep:
    suspects are asked of so many of the last samples, and of those of the piece that is being taken.

    Raises:
        ValueError: a rule with least sizes for relations that do not tell errors of single sensors.
    """

    def __init__(self, rule: AlarmRule, relations: Relations, method: str, samples: Samples) -> None:
        self.relations, self.method, self.samples = relations, method, samples
        self.watch = Watch(rule)
        self.before = relations.reach
        # those of a stretch are asked for once it is over
        self.keep = rule.n + self.watch.reach
        self.by = np.full(self.keep, -1, np.int16)  # the tests that speak at the last samples, of a monitor
        self.first = -self.keep  # number of the first of them
        if rule.names and not nameless(relations):
            self.watch.blame = self._blame
        self.severity: Severity | MonitorSeverity | None = None
        if rule.least is not None:
            self.severity = severity_of(relations, method, cast(Mapping[str, float], rule.least))

    @property
    def asks(self) -> bool:
        """Whether it asks for samples."""
        return self.watch.blame is not None or self.severity is not None

    def add(self, piece: Recording, verdicts: Verdicts, label: Labels | None) -> list[Event]:
        """Take the next verdicts; return what begins and ends in them. piece: their times; label: the same as
        alarms have them.
        """
        fault = verdicts.status == Status.FAULT
        by = self._speaking(verdicts)
        if by is not None:
            self.by = np.concatenate([self.by[len(self.by) - self.keep :], by])
            self.first = self.watch.samples - self.keep
        if self.severity is not None and fault.any():
            fault = self._counted(fault, by, self.severity)
        missing = verdicts.status == Status.MISSING
        about = fault, verdicts.margin, missing, verdicts.departure, piece.instants
        return self.watch.add(Seen.of(*about), label)

    def memory(self) -> dict[str, Any]:
        """Return the state, as JSON holds it."""
        by = self.by[len(self.by) - self.keep :]
        return {"watch": self.watch.memory(), "by": by.tolist()}

    def resume(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        self.watch.resume(memory["watch"])
        self.by = np.array(memory["by"], np.int16)
        self.first = self.watch.samples - self.keep

    def _speaking(self, verdicts: Verdicts) -> np.ndarray | None:
        """Return the numbers of the tests of a monitor that speak at each sample, else None."""
        if not self.relations.parts:
            return None
        told = cast(Any, verdicts)
        # parts of a recording name those that speak in them
        numbers = [list(self.relations.parts).index(name) for name in told.names]
        return np.asarray(np.array([-1, *numbers], np.int16)[told.by + 1])

    def _counted(
        self, fault: np.ndarray, by: np.ndarray | None, severity: Severity | MonitorSeverity
    ) -> np.ndarray:
        """Return the FAULT windows that count."""
        at = np.flatnonzero(fault)
        first, stop, begin = int(at[0]), int(at[-1]) + 1, self.watch.samples
        before = min(self.before, begin + first)
        u, y = self.samples(begin + first - before, begin + stop)
        around = np.concatenate([np.zeros(before, bool), fault[first:stop]])
        if by is not None:
            by = np.concatenate([np.full(before, -1), by[first:stop]])
        counts = np.zeros_like(fault)
        counts[first:stop] = severity.reached(u, y, around, by)[before:]
        return counts

    def _blame(self, sample: int) -> Suspect:
        """Return the suspects of the window that ends at a sample, of a monitor of the test that speaks."""
        if not self.relations.parts:
            u, y = self.samples(sample - self.relations.horizon, sample + 1)
            return suspect_of_window(self.relations, self.method, np.asarray(u), np.asarray(y))
        bank = cast(MonitorBank, self.relations)
        number = int(self.by[sample - self.first])
        relations = bank.watches[number].relations
        if nameless(relations):
            return UNKNOWN
        u, y = (np.asarray(x) for x in self.samples(sample - relations.horizon, sample + 1))
        seen = bank.seen_by(number, Recording(u, y, NOWHERE), bank.modes_of(u))
        return suspect_of_window(relations, "joint", seen.u, seen.y)
