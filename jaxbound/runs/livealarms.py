"""Alarms by a rule of samples as they come.

An alarm has a notice of its begin, another of its end, and then a row in alarms.csv.
"""

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.alarms import Alarm, alarm_of, forgets_after, over_of
from jaxbound.diagnosis.suspects import tells_causes
from jaxbound.diagnosis.watch import BEGINS, Event, Raised
from jaxbound.files.checkpoint import as_texts, from_texts
from jaxbound.models.region import Departure, Region
from jaxbound.recordings.columns import header_line, moments, texts, write_rows
from jaxbound.recordings.factors import known
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.stream import Complain
from jaxbound.runs.alarmbook import speakers
from jaxbound.runs.loop import Memory, Quiet
from jaxbound.runs.sink import Verdicts
from jaxbound.runs.verdictfiles import alarm_columns
from jaxbound.runs.watching import Watching

__all__ = ["ALARMS", "LiveAlarms", "Notice"]

ALARMS = "alarms.csv"
COLUMNS = (
    *("start", "from", "end", "to", "worst", "at", "test"),
    *("first_sample", "last_sample", "windows", "depth", "size", "outside"),
    *("ended", "suspect", "cause", "outside_by"),
)
KINDS: dict[str, Any] = dict.fromkeys(("first_sample", "last_sample", "windows", "outside"), np.int64)
KINDS |= dict.fromkeys(("from", "to", "at", "depth", "size"), np.float64)
Notice = tuple[int, dict[str, Any]]
"""(row of the last piece behind which it stands, {"alarm": "begin" or "end", ...}); times are texts."""


class LiveAlarms(Quiet):
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
        self.complain, self.complained = complain, 0
        self.rule, self.relations, self.dt = rule, relations, dt
        self.watching = Watching(rule, relations, method, self._samples)
        self.horizon, self.region = forgets_after(relations), Region.of(relations)
        self.causes = rule.names and tells_causes(relations.model)
        keep = 0
        if self.watching.asks:
            keep = self.watching.before + self.watching.keep
        model = relations.model
        # the last samples
        self.u = np.full((keep, len(known(model))), np.nan)
        self.y = np.full((keep, len(model.outputs)), np.nan)
        self.keep, self.first = keep, -keep  # number of the first sample that is kept
        self.endings: dict[str, int] = {}
        self.notices: list[Notice] = []
        self.rows = b""
        self.header = header_line(self._columns([]))

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        """Follow the alarms through the next samples."""
        import pyarrow as pa

        tests = speakers(verdicts)

        def label(k: int) -> tuple[str, float, str]:
            return (
                moments(piece.column.slice(k, 1)).cast(pa.string())[0].as_py(),
                float(piece.time[k]),
                tests[k],
            )

        begin = self.watching.watch.samples
        if self.keep:
            self.u = np.concatenate([self.u, np.asarray(piece.u)])
            self.y = np.concatenate([self.y, np.asarray(piece.y)])
        events = self.watching.add(piece, verdicts, label)
        drop = len(self.u) - self.keep
        self.u, self.y, self.first = self.u[drop:], self.y[drop:], self.first + drop
        self.notices = []
        for event in events:
            self.notices.append((event.sample - begin, self._notice(event, verdicts, begin)))
        troubles = [*self.watching.watch.acknowledged.troubles.values()]
        for sentence in troubles[self.complained :]:
            self.complain("acknowledged", sentence)
        self.complained = len(troubles)
        over = over_of(events)
        for alarm in self._in_words(over):
            self.endings[alarm.ended] = self.endings.get(alarm.ended, 0) + 1
        self.rows = self.written(over)

    def of(self, piece: Recording, verdicts: Verdicts) -> bytes:
        """Return the rows of the alarms that ended in the last piece."""
        return self.rows

    def written(self, over: Sequence[Raised]) -> bytes:
        """Return the rows of alarms.csv."""
        if not over:
            return b""
        sink = io.BytesIO()
        write_rows(sink, self._columns(over))
        return sink.getvalue()

    def pending(self) -> list[Raised]:
        """Return the alarms that are on, as they would end if the stream ended here, the first first."""
        return sorted(self.watching.watch.pending(), key=lambda alarm: alarm.number)

    def counted(self) -> tuple[int, dict[str, int]]:
        """Return (number of alarms, {why one is over: how many}) if the stream ended here."""
        endings = dict(self.endings)
        for alarm in self._in_words(self.pending()):
            endings[alarm.ended] = endings.get(alarm.ended, 0) + 1
        return self.watching.watch.count, endings

    def memory(self) -> Memory:
        """Return the alarms that are on, and the last samples."""
        kept = as_texts((self.u, self.y))
        return {**self.watching.memory(), "samples": kept, "endings": self.endings}

    def resume(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        self.watching.resume(memory)
        self.u, self.y = from_texts((self.u, self.y), memory["samples"])
        self.first = self.watching.watch.samples - self.keep
        self.endings = memory["endings"]

    def _samples(self, first: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Return samples that are kept, by their numbers."""
        at = slice(first - self.first, stop - self.first)
        assert at.start >= 0, "so many are kept"
        return self.u[at], self.y[at]

    def _in_words(self, over: Sequence[Raised]) -> list[Alarm]:
        """Return the Alarms of those that are over."""
        region = None
        if self.region is not None:
            nothing = np.zeros(0)
            region = Departure(nothing, nothing, nothing, self.region)
        alarms = []
        for raised in over:
            alarms.append(alarm_of(raised, self.horizon, region))
        return alarms

    def _notice(self, event: Event, verdicts: Verdicts, begin: int) -> dict[str, Any]:
        """Return the notice of the begin or the end of an alarm."""
        raised = event.alarm
        suspect = {}
        if self.rule.names:
            suspect = {"suspect": raised.suspect.first or None}
        if self.causes:
            suspect["cause"] = raised.suspect.cause or None
        if event.kind == BEGINS:
            told = {"alarm": "begin", "number": raised.number, "sample": raised.start}
            told |= {"time": raised.labels["start"][0], **suspect}
            by, names = getattr(verdicts, "by", None), getattr(verdicts, "names", ())
            if by is not None:
                told["test"] = (*names, None)[int(by[raised.start - begin])]
            return told
        alarm = self._in_words([raised])[0]
        told = {"alarm": "end", "number": raised.number, "sample": raised.end}
        told |= {"time": raised.labels["end"][0], **suspect}
        return told | {"windows": alarm.windows, "depth": alarm.depth, "ended": alarm.ended}

    def _columns(self, over: Sequence[Raised]) -> dict[str, Any]:
        """Return the columns of alarms.csv."""
        rows = []
        for raised, alarm in zip(over, self._in_words(over), strict=True):
            times = (*raised.labels["start"][:2], *raised.labels["end"][:2], *raised.labels["worst"])
            numbers = alarm.start, alarm.end, alarm.windows, alarm.depth, alarm.size, alarm.outside
            rows.append((*times, *numbers, alarm.ended, alarm.suspect, alarm.cause, alarm.outside_by))
        columns: dict[str, Any] = dict.fromkeys(COLUMNS, ())
        columns |= zip(COLUMNS, zip(*rows, strict=True), strict=False)
        left_out = []
        if not self.relations.parts:
            left_out.append("test")
        if not self.rule.names:
            left_out += ["suspect", "size"]
        if not self.causes:
            left_out.append("cause")
        if self.region is None:
            left_out += ["outside", "outside_by"]
        for name in left_out:
            del columns[name]
        for name in columns.keys() & KINDS.keys():
            columns[name] = np.array(columns[name], KINDS[name])
        for name in ("start", "end", "worst"):
            columns[name] = texts(columns[name])
        return alarm_columns(columns, self.dt)
