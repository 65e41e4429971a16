"""Alarms by a rule over verdicts that come in pieces: the samples of their FAULT windows are asked for."""

from collections.abc import Callable, Mapping
from typing import TypeAlias, cast

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.severity import Severity
from jaxbound.diagnosis.suspects import Suspect, nameless, suspect_of_window
from jaxbound.diagnosis.watch import Event, Labels, Seen, Watch
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

    Fields: watch: the alarms so far.

    Raises:
        ValueError: a rule with least sizes for relations that do not tell errors of single sensors.
    """

    def __init__(self, rule: AlarmRule, relations: Relations, method: str, samples: Samples) -> None:
        self.relations, self.method, self.samples = relations, method, samples
        self.watch = Watch(rule)
        if rule.names and not nameless(relations):
            self.watch.blame = self._blame
        self.severity = None
        if rule.least is not None:
            self.severity = Severity(relations, method, cast(Mapping[str, float], rule.least))

    def add(self, verdicts: Verdicts, label: Labels | None) -> list[Event]:
        """Take the next verdicts; return what begins and ends in them. label: their times."""
        fault = verdicts.status == Status.FAULT
        if self.severity is not None and fault.any():
            fault = self._counted(fault, self.severity)
        missing = verdicts.status == Status.MISSING
        return self.watch.add(Seen.of(fault, verdicts.margin, missing, verdicts.departure), label)

    def _counted(self, fault: np.ndarray, severity: Severity) -> np.ndarray:
        """Return the FAULT windows that count."""
        at = np.flatnonzero(fault)
        first, stop = int(at[0]), int(at[-1]) + 1
        begin, before = self.watch.samples, self.relations.horizon
        u, y = self.samples(begin + first - before, begin + stop)
        around = np.concatenate([np.zeros(before, bool), fault[first:stop]])
        counts = np.zeros_like(fault)
        counts[first:stop] = severity.reached(u, y, around)[before:]
        return counts

    def _blame(self, sample: int) -> Suspect:
        """Return the suspects of the window that ends at a sample."""
        u, y = self.samples(sample - self.relations.horizon, sample + 1)
        return suspect_of_window(self.relations, self.method, np.asarray(u), np.asarray(y))
