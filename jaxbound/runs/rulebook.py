"""Alarms by any rule of a recording whose verdicts come in parts."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.alarms import alarm_of, over_of
from jaxbound.diagnosis.suspects import tells_causes
from jaxbound.diagnosis.watch import Event, Raised
from jaxbound.recordings.parquet import ParquetSource
from jaxbound.recordings.recording import Recording
from jaxbound.runs.alarmbook import AlarmBook, speakers
from jaxbound.runs.sink import Verdicts
from jaxbound.runs.watching import Watching

__all__ = ["RuleBook", "alarm_book"]

WHOLE = "first_sample", "last_sample", "worst_sample", "windows", "outside", "by"
NUMBERS = *WHOLE[:5], "depth", "size", "share", "by", "reading"
Mark = Callable[[np.ndarray], object]


class RuleBook(AlarmBook):
    """Alarms of a recording that comes in parts, by a rule that latches, merges, names suspects or asks for
    sizes. All are kept until the last sample, since one that began first may end last.

    Args:
        rule: that is `fitted`. source: of the recording. method: of the test. The others: see `AlarmBook`.
    """

    def __init__(
        self,
        rule: AlarmRule,
        source: ParquetSource,
        relations: Relations,
        method: str,
        path: Path | None,
        mark: Mark,
    ) -> None:
        super().__init__(rule, source.dt, relations, path, mark)
        self.source = source
        self.watching = Watching(rule, relations, method, self._samples)
        self.over: list[Raised] = []
        self.nothing: Any = None  # no times, of the type that the recording has

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        """Take the next part."""
        self.nothing = piece.column.slice(0, 0)

        tests = speakers(verdicts)

        def label(k: int) -> tuple[Any, float, str]:
            return piece.column.slice(k, 1), float(piece.time[k]), tests[k]

        self._take(self.watching.add(piece, verdicts, label))

    def close(self) -> None:
        """Write all alarms."""
        self._take(self.watching.watch.finish())
        self.over.sort(key=lambda alarm: alarm.number)
        self._write(self._columns())

    def _take(self, events: list[Event]) -> None:
        """Keep the alarms that are over."""
        self.over += over_of(events)

    def _samples(self, first: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Return samples of the recording."""
        r = self.source.read(first, stop)
        return np.asarray(r.u), np.asarray(r.y)

    def _columns(self) -> dict[str, Any]:
        """Return the columns of all alarms."""
        import pyarrow as pa

        columns: dict[str, Any] = {}
        for name, moment in (("start", "from"), ("end", "to"), ("worst", "at")):
            written, seconds = [self.nothing], []
            for raised in self.over:
                text, second, _ = raised.labels[name]
                written.append(text)
                seconds.append(second)
            columns[name], columns[moment] = pa.concat_arrays(written), np.array(seconds, float)
        rows: list[tuple[Any, ...]] = []
        ended, suspects, tests = [], [], []
        for raised in self.over:
            alarm = alarm_of(raised, self.horizon)
            numbers = alarm.start, alarm.end, alarm.worst, alarm.windows, raised.outside
            rows.append((*numbers, alarm.depth, alarm.size, *raised.farthest))
            ended.append(alarm.ended)
            suspects.append(alarm.suspects)
            tests.append(raised.labels["worst"][2])
        values = np.array(rows, float).reshape(len(rows), len(NUMBERS)).T
        for name, column in zip(NUMBERS, values, strict=True):
            columns[name] = column
        for name in WHOLE:
            columns[name] = columns[name].astype(np.int64)
        columns["ended"], columns["test"] = np.array(ended, object), np.array(tests, object)
        if self.rule.names:
            first = [(*names, "")[0] for names in suspects]
            columns |= {"suspect": np.array(first, object), "suspects": suspects}
            if tells_causes(self.watching.relations.model):
                columns["cause"] = np.array([raised.suspect.cause for raised in self.over], object)
        else:
            del columns["size"]
        return columns


def alarm_book(
    rule: AlarmRule,
    source: ParquetSource,
    relations: Relations,
    method: str,
    path: Path | None,
    mark: Mark,
) -> AlarmBook:
    """Return the book of alarms for a rule; see `RuleBook` for the arguments."""
    if rule == AlarmRule(rule.k, rule.n):
        return AlarmBook(rule, source.dt, relations, path, mark)
    return RuleBook(rule, source, relations, method, path, mark)
