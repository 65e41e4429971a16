"""Alarms by a rule of samples as they come.

An alarm has a notice of its begin, another of its end, and then a row in alarms.csv.
"""

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.watch import BEGINS, Event
from jaxbound.files.checkpoint import as_texts, from_texts
from jaxbound.recordings.columns import header_line, moments, write_rows
from jaxbound.recordings.factors import known
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.stream import Complain
from jaxbound.runs.sink import Verdicts
from jaxbound.runs.watching import Watching

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["ALARMS", "LiveAlarms", "Notice"]

ALARMS = "alarms.csv"
LATELY = 100  # samples whose times are kept before those that no alarm needs are forgotten
Notice = tuple[int, dict[str, Any]]
"""(row of the last piece behind which it stands, {"alarm": "begin" or "end", ...}); times are texts."""


class LiveAlarms(Watching):
    """The alarms of samples as they come, a sink; also the text of alarms.csv for a `RowFile`.

    Args:
        rule: that is `fitted`. relations, method: as tested. dt: sampling period in s. complain: called on
            each line of a file of acknowledgements that is none.

    Fields: notices: of the last piece. header: of alarms.csv.
    """

    def __init__(
        self,
        rule: AlarmRule,
        relations: Relations,
        method: str,
        dt: float,
        complain: Complain = lambda kind, sentence: None,
    ) -> None:
        super().__init__(rule, relations, method, dt)
        self.complain, self.complained = complain, 0
        self.width = 0
        if self.asks:
            self.width = self.before + self.keep
        model = relations.model
        # the last samples, and the number of the first of them
        self.u = np.full((self.width, len(known(model))), np.nan)
        self.y = np.full((self.width, len(model.outputs)), np.nan)
        self.begin = -self.width
        self.notices: list[Notice] = []
        self.rows = b""
        self.header = header_line(self.columns([]))

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        """Follow the alarms through the next samples."""
        begin = self.watch.samples
        if self.width:
            self.u = np.concatenate([self.u, np.asarray(piece.u)])
            self.y = np.concatenate([self.y, np.asarray(piece.y)])
        over = self.follow(piece, verdicts)
        drop = len(self.u) - self.width
        self.u, self.y, self.begin = self.u[drop:], self.y[drop:], self.begin + drop
        troubles = [*self.watch.acknowledged.troubles.values()]
        for sentence in troubles[self.complained :]:
            self.complain("acknowledged", sentence)
        self.complained = len(troubles)
        self.notices, self.rows = [], b""
        if not len(self.numbers):  # nothing is on
            return
        for event in self.watch.events(over):
            self.notices.append((event.sample - begin, self._notice(event)))
        if over:
            alarms = self.alarms_of(over)
            self.count(alarms, self.ended)
            self.rows = self.written_rows(alarms)
        if self.watch.is_quiet or len(self.numbers) > LATELY:
            self.forget()

    def shown(self, piece: Recording) -> "pa.Array":
        """Return the times of a piece as texts."""
        import pyarrow as pa

        return moments(piece.column).cast(pa.string())

    def samples(self, first: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Return samples that are kept, by their numbers."""
        at = slice(first - self.begin, stop - self.begin)
        assert at.start >= 0, "so many are kept"
        return self.u[at], self.y[at]

    def of(self, piece: Recording, verdicts: Verdicts) -> bytes:
        """Return the rows of the alarms that ended in the last piece."""
        return self.rows

    def written_rows(self, alarms: Sequence[Alarm]) -> bytes:
        """Return the rows of alarms.csv."""
        if not alarms:
            return b""
        sink = io.BytesIO()
        write_rows(sink, self.columns(alarms))
        return sink.getvalue()

    def pending(self) -> list[Alarm]:
        """Return the alarms that are on, as they would end if the stream ended here, the first first."""
        return self.alarms_of(self.watch.pending())

    def counted(self) -> tuple[int, dict[str, int]]:
        """Return (number of alarms, {why one is over: how many}) if the stream ended here."""
        endings = dict(self.ended)
        self.count(self.pending(), endings)
        return self.watch.count, endings

    def memory(self) -> dict[str, Any]:
        """Return the alarms that are on, and the last samples."""
        return super().memory() | {"samples": as_texts((self.u, self.y))}

    def resume(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        super().resume(memory)
        self.u, self.y = from_texts((self.u, self.y), memory["samples"])
        self.begin = self.watch.samples - self.width

    def _notice(self, event: Event) -> dict[str, Any]:
        """Return the notice of the begin or the end of an alarm."""
        raised = event.alarm
        names, _, _, cause = raised.suspect
        suspect = {}
        if self.rule.names:
            suspect = {"suspect": (*names, None)[0]}
        if self.causes:
            suspect["cause"] = cause or None
        if event.kind == BEGINS:
            told = {"alarm": "begin", "number": event.number, "sample": raised.start}
            told |= {"time": self._text(raised.start), **suspect}
            if self.relations.parts:
                told["test"] = self.tests[np.searchsorted(self.numbers, raised.start)] or None
            return told
        (alarm,) = self.alarms_of([raised])
        told = {"alarm": "end", "number": event.number, "sample": alarm.end}
        told |= {"time": self._text(raised.end), **suspect}
        return told | {"windows": alarm.windows, "depth": alarm.depth, "ended": alarm.ended}

    def _text(self, sample: int) -> str:
        """Return the time of a sample as it is written."""
        text: str = self.at(np.array([sample]))[0][0].as_py()
        return text
