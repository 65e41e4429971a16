"""Alarms of a recording whose verdicts come in parts."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.watch import NUMBER, Raised
from jaxbound.recordings.columns import write_columns
from jaxbound.recordings.parquet import ParquetSource
from jaxbound.recordings.recording import Recording
from jaxbound.runs.sink import Verdicts
from jaxbound.runs.watching import Watching, places_of

__all__ = ["AlarmBook"]

DEEPEST = 200  # alarms kept in memory


class AlarmBook(Watching):
    """Alarms of a recording that comes in parts, a sink.

    Args:
        rule: that is `fitted`. source: of the recording. relations, method: as tested. path: where to write
            all of them, or None. mark: called with the samples at which alarms that are over are deepest.

    Fields: total: how many there are. earliest, kept: the first and the deepest, with the seconds of start,
    end and worst sample.
    """

    def __init__(
        self,
        rule: AlarmRule,
        source: ParquetSource,
        relations: Relations,
        method: str,
        path: Path | None,
        mark: Callable[[np.ndarray], object],
    ) -> None:
        super().__init__(rule, relations, method, source.dt)
        self.source, self.path, self.mark = source, path, mark
        self.over: list[Raised] = []
        self.total = 0
        self.kept: list[tuple[Alarm, list[float]]] = []
        self.earliest: list[tuple[Alarm, list[float]]] = []

    def samples(self, first: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Return samples of the recording."""
        r = self.source.read(first, stop)
        return np.asarray(r.u), np.asarray(r.y)

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        """Take the next part; of a rule that names suspects one that began first may end last, so that all
        wait for the last sample.
        """
        over = self.follow(piece, verdicts)
        if self.rule.names:
            self.over += over
        else:
            self._write(over)
        self.forget(self.over)

    def close(self) -> None:
        """Write the alarms that are left."""
        over = [*self.over, *self.watch.finish()]
        if self.rule.names or over:
            self._write(sorted(over, key=NUMBER))

    def _write(self, over: list[Raised]) -> None:
        """Count and write alarms that are over, and keep the deepest."""
        alarms = self.alarms_of(over)
        if self.path is not None:
            write_columns(self.path, self.columns(alarms), append=self.total > 0)
        self.total += len(alarms)
        self.count(alarms, self.ended)
        places = places_of(over)
        seconds = self.at(places.ravel())[1].reshape(-1, 3)
        fresh = list(zip(alarms, seconds.tolist(), strict=True))
        # the first of all is kept too, however shallow: sentences name it
        self.earliest = self.earliest or fresh[:1]
        self.kept = sorted([*self.kept, *fresh], key=lambda pair: pair[0].depth)[:DEEPEST]
        self.mark(places[:, 2])

    def alarms(self) -> tuple[list[Alarm], dict[int, float]]:
        """Return ([Alarm], {sample: seconds}) of the first and the deepest in order of time."""
        pairs = {alarm.start: (alarm, times) for alarm, times in (*self.earliest, *self.kept)}
        named: dict[int, float] = {}
        for a, times in pairs.values():
            named |= dict(zip((a.start, a.end, a.worst), times, strict=True))
        return [pairs[start][0] for start in sorted(pairs)], named
