"""Alarms by a rule over verdicts that come in pieces: in words, and with their times."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.consistency.monitorbank import MonitorBank
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.alarms import Alarm, alarms_of, forgets_after
from jaxbound.diagnosis.severity import Severity
from jaxbound.diagnosis.suspects import UNKNOWN, Suspect, nameless, suspect_of_window, tells_causes
from jaxbound.diagnosis.watch import Raised, Seen, Watch
from jaxbound.models.region import Region
from jaxbound.recordings.columns import to_arrow
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.runs.loop import Quiet
from jaxbound.runs.sink import Verdicts
from jaxbound.runs.verdictfiles import Columns, alarm_columns
from jaxbound.sets.floats.status import Status

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["Watching", "places_of"]


class Watching(Quiet):
    """The alarms of relations, by a rule, and the times of the samples by which they are told.

    Args:
        rule: that is `fitted`. relations, method: as tested. dt: sampling period in s.

    Fields: watch: the alarms so far. before: so many samples before its last one a test of them reads. keep:
    suspects are asked of so many of the last samples, and of those of the piece that is being taken. numbers,
    written, seconds, tests: of the samples whose times are known: those of the piece, and earlier ones of
    alarms that are on. ended: {ending of an Alarm: number of alarms}.

    Raises:
        ValueError: a rule with least sizes for relations that do not tell errors of single sensors.
    """

    def __init__(self, rule: AlarmRule, relations: Relations, method: str, dt: float) -> None:
        self.rule, self.relations, self.method, self.dt = rule, relations, method, dt
        self.horizon, self.region = forgets_after(relations), Region.of(relations)
        self.causes = rule.names and tells_causes(relations.model)
        self.watch = Watch(rule)
        self.before = relations.reach
        # those of a stretch are asked for once it is over
        self.keep = rule.n + self.watch.reach
        self.by = np.full(self.keep, -1, np.int16)  # the tests that speak at the last samples, of a monitor
        self.first = -self.keep  # number of the first of them
        if rule.names and not nameless(relations):
            self.watch.blame = self._blame
        self.severity: Severity | None = None
        if rule.least is not None:
            self.severity = Severity(relations, method, cast(Mapping[str, float], rule.least))
        self.numbers: np.ndarray = np.zeros(0, np.int64)
        self.seconds: np.ndarray = np.zeros(0)
        self.tests, self.written = np.zeros(0, object), to_arrow(self.seconds)
        self.ended: dict[str, int] = {}

    def samples(self, first: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Return (u, y) of some samples up to the piece that is being taken, by their numbers."""
        raise NotImplementedError(f"{type(self).__name__} has no samples")

    def shown(self, piece: Recording) -> "pa.Array":
        """Return the times of a piece as alarms have them."""
        return piece.column

    @property
    def asks(self) -> bool:
        """Whether it asks for samples."""
        return self.watch.blame is not None or self.severity is not None

    def follow(self, piece: Recording, verdicts: Verdicts) -> list[Raised]:
        """Take the next verdicts; return the alarms that are over."""
        import pyarrow as pa

        begin, fault = self.watch.samples, verdicts.status == Status.FAULT
        by = self._speaking(verdicts)
        if by is not None:
            self.by = np.concatenate([self.by[len(self.by) - self.keep :], by])
            self.first = begin - self.keep
        if not fault.any() and self.watch.is_quiet:
            self.watch.skip(len(fault))
            return []
        written = self.shown(piece)
        if len(self.numbers):
            written = pa.concat_arrays([self.written, written])
        self.written = written
        self.numbers = np.concatenate([self.numbers, begin + np.arange(piece.samples)])
        self.seconds = np.concatenate([self.seconds, piece.time])
        self.tests = np.concatenate([self.tests, speakers(verdicts)])
        if self.severity is not None and fault.any():
            fault = self._counted(fault, by, self.severity)
        instants = None
        if self.rule.acknowledgements.is_given:
            instants = piece.instants
        missing = verdicts.status == Status.MISSING
        return self.watch.add(Seen.of(fault, verdicts.margin, missing, verdicts.departure, instants))

    def at(self, samples: np.ndarray) -> tuple["pa.Array", np.ndarray]:
        """Return the times of samples that are known, as written and in seconds."""
        places = np.searchsorted(self.numbers, samples)
        return self.written.take(to_arrow(places)), self.seconds[places]

    def forget(self, over: Sequence[Raised] = ()) -> None:
        """Forget the times of samples that no alarm that is on, and none of those that are over, needs."""
        if not len(self.numbers):
            return
        last = np.arange(self.watch.samples - max(len(self.watch.tail.fault), 1), self.watch.samples)
        if self.watch.is_quiet:
            last = last[:0]
        on = [*over, *self.watch.alarms.values()]
        if self.watch.open is not None:
            on.append(self.watch.open)
        needed = np.unique(np.concatenate([last, places_of(on).ravel()]))
        places = np.searchsorted(self.numbers, needed)
        self.written, self.numbers = self.written.take(to_arrow(places)), self.numbers[places]
        self.seconds, self.tests = self.seconds[places], self.tests[places]

    def alarms_of(self, over: Sequence[Raised]) -> list[Alarm]:
        """Return the Alarms of those that are over."""
        tests = self.tests[np.searchsorted(self.numbers, places_of(over)[:, 2])]
        return alarms_of(over, self.horizon, self.region, tests=tests.tolist())

    def count(self, alarms: Sequence[Alarm], ended: dict[str, int]) -> None:
        """Count alarms by why they are over."""
        for alarm in alarms:
            ended[alarm.ended] = ended.get(alarm.ended, 0) + 1

    def columns(self, alarms: Sequence[Alarm]) -> Columns:
        """Return the columns of alarms.csv."""
        shown = self.region is not None, self.rule.names, bool(self.relations.parts), self.causes
        return alarm_columns(alarms, self.at, self.dt, *shown)

    def memory(self) -> dict[str, Any]:
        """Return the state, as JSON holds it."""
        by = self.by[len(self.by) - self.keep :]
        times = {"numbers": self.numbers.tolist(), "seconds": self.seconds.tolist()}
        times |= {"written": self.written.to_pylist(), "tests": self.tests.tolist()}
        return {"watch": self.watch.memory(), "by": by.tolist(), "times": times, "ended": self.ended}

    def resume(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        import pyarrow as pa

        self.watch.resume(memory["watch"])
        self.by = np.array(memory["by"], np.int16)
        self.first = self.watch.samples - self.keep
        times, self.ended = memory["times"], memory["ended"]
        self.numbers, self.seconds = np.array(times["numbers"], np.int64), np.array(times["seconds"], float)
        self.tests, self.written = np.array(times["tests"], object), pa.array(times["written"], pa.string())

    def _speaking(self, verdicts: Verdicts) -> np.ndarray | None:
        """Return the numbers of the tests of a monitor that speak at each sample, else None."""
        if not self.relations.parts:
            return None
        told = cast(Any, verdicts)
        # parts of a recording name those that speak in them
        numbers = [list(self.relations.parts).index(name) for name in told.names]
        return np.asarray(np.array([-1, *numbers], np.int16)[told.by + 1])

    def _counted(self, fault: np.ndarray, by: np.ndarray | None, severity: Severity) -> np.ndarray:
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


def places_of(alarms: Sequence[Raised]) -> np.ndarray:
    """Return (N, 3), the first, the last and the worst sample of each alarm."""
    places = [(alarm.start, alarm.end, alarm.worst) for alarm in alarms]
    return np.array(places, np.int64).reshape(-1, 3)


def speakers(verdicts: Verdicts) -> np.ndarray:
    """Return the name of the test that speaks at each sample, of a monitor; else ""."""
    by, names = getattr(verdicts, "by", None), getattr(verdicts, "names", ())
    if by is None:
        return np.full(len(verdicts.status), "", object)
    return np.asarray(np.array(["", *names], object)[by + 1])
