"""Alarms by a rule over verdicts that come in pieces, with the times of their samples: of a recording in
parts, and of samples as they come.

An alarm of the latter has a notice of its begin, another of its end, and then a row in alarms.csv.
"""

import io
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.suspects import tells_causes
from jaxbound.diagnosis.watch import BEGINS, NUMBER, Event, Raised
from jaxbound.diagnosis.watching import Watching
from jaxbound.files.checkpoint import as_texts, from_texts
from jaxbound.recordings.columns import Arrow, header_line, moments, to_arrow, write_columns, write_rows
from jaxbound.recordings.factors import known
from jaxbound.recordings.parquet import ParquetSource
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.stream import Complain
from jaxbound.runs.loop import Quiet
from jaxbound.runs.sink import Verdicts
from jaxbound.runs.verdictfiles import AlarmColumns, Columns
from jaxbound.sets.floats.status import Status

DEEPEST = 200  # alarms kept in memory
ALARMS = "alarms.csv"
LATELY = 100  # samples whose times are kept before those that no alarm needs are forgotten
Notice = tuple[int, dict[str, Any]]
"""(row of the last piece behind which it stands, {"alarm": "begin" or "end", ...}); times are texts."""


class TimedAlarms(Watching, Quiet):
    """The alarms of relations, by a rule, and the times of the samples by which they are told.

    Args:
        rule: that is `fitted`. relations, method: as tested. dt: sampling period in s.

    Fields: numbers, written, seconds: of the samples whose times are known: those of the piece, and earlier
    ones of alarms that are on. ended: {ending of an Alarm: number of alarms}.

    Raises:
        ValueError: as `Watching`.
    """

    def __init__(self, rule: AlarmRule, relations: Relations, method: str, dt: float) -> None:
        super().__init__(rule, relations, method)
        self.relations = relations
        causes = rule.names and tells_causes(relations.model)
        self.shows = AlarmColumns(dt, self.region is not None, bool(self.names), rule.names, causes)
        self.numbers: np.ndarray = np.zeros(0, np.int64)
        self.seconds: np.ndarray = np.zeros(0)
        self.written = to_arrow(self.seconds)
        self.ended: Counter[str] = Counter()

    def shown(self, piece: Recording) -> Arrow:
        """Return the times of a piece as alarms have them."""
        return piece.column

    def taken(self, piece: Recording, verdicts: Verdicts) -> list[Raised]:
        """Take the next verdicts; return the alarms that are over."""
        import pyarrow as pa

        begin, fault = self.watch.samples, verdicts.status == Status.FAULT
        if not fault.any() and self.watch.is_quiet:
            self.watch.skip(len(fault))
            return []
        written = self.shown(piece)
        if len(self.numbers):
            written = pa.concat_arrays([self.written, written])
        self.written = written
        self.numbers = np.concatenate([self.numbers, begin + np.arange(piece.samples)])
        self.seconds = np.concatenate([self.seconds, piece.time])
        instants = None
        if self.rule.acknowledgements.is_given:
            instants = piece.instants
        return self.follow(verdicts, instants)

    def at(self, samples: np.ndarray) -> tuple[Arrow, np.ndarray]:
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
        needed = np.unique(np.concatenate([last, alarm_samples(on).ravel()]))
        self.written, self.seconds = self.at(needed)
        self.numbers = needed

    def columns(self, alarms: Sequence[Alarm]) -> Columns:
        """Return the columns of alarms.csv."""
        return self.shows.of(alarms, self.at)

    def memory(self) -> dict[str, Any]:
        """Return the state, as JSON holds it."""
        times = {"numbers": self.numbers.tolist(), "seconds": self.seconds.tolist()}
        times["written"] = self.written.to_pylist()
        return {"watch": self.watch.memory(), "times": times, "ended": self.ended}

    def resume(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        import pyarrow as pa

        self.watch.resume(memory["watch"])
        times, self.ended = memory["times"], Counter(memory["ended"])
        self.numbers, self.seconds = np.array(times["numbers"], np.int64), np.array(times["seconds"], float)
        self.written = pa.array(times["written"], pa.string())


def alarm_samples(alarms: Sequence[Raised]) -> np.ndarray:
    """Return (N, 3), the first, the last and the worst sample of each alarm."""
    places = [(alarm.start, alarm.end, alarm.worst) for alarm in alarms]
    return np.array(places, np.int64).reshape(-1, 3)


class AlarmBook(TimedAlarms):
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
        over = self.taken(piece, verdicts)
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
        self.ended.update(alarm.ended for alarm in alarms)
        places = alarm_samples(over)
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


class LiveAlarms(TimedAlarms):
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
        if self.asks:  # those of a stretch are asked for once it is over
            self.width = relations.reach + rule.n + self.watch.reach
        model = relations.model
        # the last samples, and the number of the first of them
        self.u = np.full((self.width, len(known(model))), np.nan)
        self.y = np.full((self.width, len(model.outputs)), np.nan)
        self.begin = -self.width
        self.worst: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self.notices: list[Notice] = []
        self.rows = b""
        self.header = header_line(self.columns([]))

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        """Follow the alarms through the next samples."""
        begin = self.watch.samples
        self._drop()
        if self.width:
            self.u = np.concatenate([self.u, np.asarray(piece.u)])
            self.y = np.concatenate([self.y, np.asarray(piece.y)])
        over = self.taken(piece, verdicts)
        if self.watch.blame is not None:
            self._keep(over)
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
            self.ended.update(alarm.ended for alarm in alarms)
            self.rows = self.written_rows(alarms)
        if self.watch.is_quiet or len(self.numbers) > LATELY:
            self.forget()

    def shown(self, piece: Recording) -> Arrow:
        """Return the times of a piece as texts."""
        import pyarrow as pa

        return moments(piece.column).cast(pa.string())

    def samples(self, first: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Return samples that are kept, by their numbers."""
        if first < self.begin:
            u, y = self.worst[stop - 1]
            return u[len(u) - (stop - first) :], y[len(y) - (stop - first) :]
        at = slice(first - self.begin, stop - self.begin)
        return self.u[at], self.y[at]

    def _drop(self) -> None:
        """Forget all samples but the last ones."""
        drop = len(self.u) - self.width
        self.u, self.y, self.begin = self.u[drop:], self.y[drop:], self.begin + drop

    def _keep(self, over: Sequence[Raised]) -> None:
        """Keep the windows in which alarms are deepest, as their sizes are asked for when they are over."""
        on = [*over, *self.watch.alarms.values()]
        if self.watch.open is not None:
            on.append(self.watch.open)
        kept = {}
        for alarm in on:
            first, stop = alarm.worst - self.relations.reach, alarm.worst + 1
            kept[alarm.worst] = self.worst.get(alarm.worst) or self.samples(first, stop)
        self.worst = kept

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
        return self.watch.count, self.ended + Counter(alarm.ended for alarm in self.pending())

    def memory(self) -> dict[str, Any]:
        """Return the alarms that are on, and the last samples."""
        self._drop()
        worst = [(sample, as_texts(window)) for sample, window in self.worst.items()]
        return super().memory() | {"samples": as_texts((self.u, self.y)), "worst": worst}

    def resume(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        super().resume(memory)
        self.u, self.y = from_texts((self.u, self.y), memory["samples"])
        self.begin = self.watch.samples - self.width
        like = self.u[: self.relations.reach + 1], self.y[: self.relations.reach + 1]
        for sample, texts in memory["worst"]:
            self.worst[sample] = from_texts(like, texts)

    def _notice(self, event: Event) -> dict[str, Any]:
        """Return the notice of the begin or the end of an alarm."""
        raised = event.alarm
        suspect = {}
        if self.rule.names:
            suspect = {"suspect": (*raised.suspect.names, None)[0]}
        if event.kind == BEGINS:
            if self.shows.causes and self.watch.blame is not None:
                first = self._blame(raised.start, raised.begun_by, raised.suspect.first)
                suspect["cause"] = first.cause or None
            told = {"alarm": "begin", "number": event.number, "sample": raised.start}
            told |= {"time": self._text(raised.start), **suspect}
            if self.relations.parts:
                told["test"] = self.name_of(raised.begun_by) or None
            return told
        (alarm,) = self.alarms_of([raised])
        if self.shows.causes:
            suspect["cause"] = alarm.cause or None
        told = {"alarm": "end", "number": event.number, "sample": alarm.end}
        told |= {"time": self._text(raised.end), **suspect}
        return told | {"windows": alarm.windows, "depth": alarm.depth, "ended": alarm.ended}

    def _text(self, sample: int) -> str:
        """Return the time of a sample as it is written."""
        return str(self.at(np.array([sample]))[0][0].as_py())
