"""Lines of CSV as they come through a pipe: the samples in them, where they do not follow each other, and the
lines that cannot be read.

Lines are counted from 1, the header's. One that cannot be read is left out, with a sentence, and no window
spans it. What has been taken is remembered in a few numbers and lines, so that another process can go on
behind it, whether the sender begins again or not.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxbound.recordings.columns import to_arrow
from jaxbound.recordings.counting import SECONDS, Counting, counting_of
from jaxbound.recordings.csvlines import BOM, split_lines
from jaxbound.recordings.csvtext import UNENDED, is_number
from jaxbound.recordings.factors import known
from jaxbound.recordings.linetext import SOURCE, Cells, LineReader, WrongCells
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import TOLERATED_STEP, check_period, rows_apart, tick
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.stream import Complain, OtherSamples, Stream, Taken, digests_of
from jaxbound.recordings.timestamps import (
    EPOCH,
    SECOND,
    from_epoch,
    parse_stamps,
    scale_of,
    since_epoch,
    time_label,
)

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["PipeText"]

LONGEST = 1 << 20  # bytes of a line
SHOWN = 100  # samples whose steps say whether the sampling period is the model's
TOLD = 20  # seams of one piece that get a sentence
Line = tuple[int, bytes]
"""A line with its number."""


class _LineSamples(NamedTuple):
    """The samples of some lines, before they are a Recording.

    Fields: time (N,) in s; written, the time as it stands there, numbers or a pyarrow array of texts; u, y;
    starts, excluded, stamps: as of a Recording; stamps where steps may differ.
    """

    time: np.ndarray
    written: Any
    u: np.ndarray
    y: np.ndarray
    starts: np.ndarray
    excluded: np.ndarray | None
    stamps: np.ndarray | None = None

    def behind(self, first: int) -> "_LineSamples":
        """Return the samples from number `first` on."""
        excluded = self.excluded
        if excluded is not None:
            excluded = excluded[first:]
        stamps = self.stamps
        if stamps is not None:
            stamps = stamps[first:]
        time, written, u, y = self.time[first:], self.written[first:], self.u[first:], self.y[first:]
        return _LineSamples(time, written, u, y, self.starts, excluded, stamps)


class _LineTimes(NamedTuple):
    """The times of some rows.

    Fields: time (N,) in s; stamps: as datetime64, or None; written: as they stand there; before: time of the
    sample before them, in seconds of the same count.
    """

    time: np.ndarray
    stamps: np.ndarray | None
    written: Any
    before: float


class PipeText(Stream):
    """A stream of bytes with lines of CSV in them.

    Args:
        model: whose signals are wanted. complain: called with (kind, sentence) on each line that is left out
            and each seam.
        memory: from `.memory()` of another PipeText, to go on where that ended; None: a new stream. taken: of
            all processes, by which lines are known that are sent again.

    Fields: raw: the number of standard input.
    """

    raw = 0
    units = "lines"

    def __init__(
        self,
        model: SignalModel,
        complain: Complain,
        memory: dict[str, Any] | None = None,
        taken: Taken | None = None,
    ) -> None:
        super().__init__(model, complain, taken)
        self.tail = self.rest = b""  # half a line; half a line of a process before
        self.reader: LineReader | None = None  # as soon as there is a row of data
        self.begun: list[Line] = []  # lines before that
        self.number = 0  # lines so far
        self.resumed = 0  # those before this process, as long as it is not clear how the stream goes on
        self.texts: list[str] = []  # the first and the last time, where it is written as text
        self.origin: float | None = None  # of a time that is an epoch, with units a second in .scale
        self.scale: float | None = None
        self.counting, self.unit_known = (
            SECONDS,
            False,
        )  # how numbers of a time count, and whether that is known
        self.lone = np.zeros(0)  # the first number, as long as it is the only one
        self.began = np.nan  # the instant at which `time` is 0, in s, see `Recording.origin`
        self.broken = self.aside = self.repeated = False
        self.counted: int | None = None  # samples that are sent again, where no time tells them
        self.blank: list[Line] = []  # blank lines that are wrong, without a time, where a row follows
        self.returns = 0  # carriage returns at the end, which may be the first half of a line end
        self.after: float | None = (
            None  # time of the last sample of a process before, until a later one comes
        )
        self.was_broken = False  # behind that sample
        self.shown: list[float] | None = []
        if not self.regular:
            self.shown = None
        if memory is not None:
            self._resume_from(memory)

    def _resume_from(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        self.reader = LineReader([line.encode("latin-1") for line in memory["head"]], self.model)
        self.rest = memory["tail"].encode("latin-1")
        if self.rest == b"\r":
            self.rest, self.returns = b"", 1
        self._resume_clock(memory)
        self.origin, self.scale, self.texts = memory["origin"], memory["scale"], memory["texts"]
        if "counting" in memory:  # of a version that knew seconds and epochs only
            self.counting, self.unit_known = Counting(*memory["counting"]), memory["unit_known"]
            self.lone = np.array(memory["lone"], float)
        self.aside, self.broken, self.resumed = memory["aside"], memory["broken"], memory["number"]
        self.was_broken, self.shown = self.broken, None

    @property
    def replaying(self) -> bool:  # type: ignore[override]
        """Whether the lines that came are those that a process before had judged."""
        return self.after is not None

    def memory(self) -> dict[str, Any] | None:
        """Return the state from which another PipeText goes on, as JSON holds it; None before the first
        sample.
        """
        if self.reader is None:
            return None
        broken = self.broken or bool(self.blank)
        if self.replaying:
            broken = self.was_broken
        return {
            "head": [line.decode("latin-1") for line in self.reader.head],
            "number": max(self.number, self.resumed),
            "tail": (self.rest + self.tail + b"\r"[: self.returns]).decode("latin-1"),
            **self._clock_memory(),
            "origin": self.origin,
            "scale": self.scale,
            "counting": [*self.counting],
            "lone": self.lone.tolist(),
            "unit_known": self.unit_known,
            "texts": self.texts,
            "broken": broken,
            "aside": self.aside,
        }

    def pieces(self, arrivals: Iterable[bytes | None]) -> Iterator[tuple[int, Recording]]:
        """Yield (number of its first sample, Recording) of the lines that bytes complete, as they come.

        Raises:
            ValueError: as `take`, or at the end: there was no row of data.
        """
        for data in arrivals:
            if data is None:  # a signal: the line that was begun is remembered
                return
            yield self._numbered(self.take(data))
        if self.tail.strip():
            self._lose(f"the last line {UNENDED}")
        self.refuse_empty()

    def _numbered(self, piece: Recording | None) -> tuple[int, Recording]:
        if piece is None:
            return self.nothing()
        return self.clock.samples - piece.samples, piece

    def take(self, data: bytes) -> Recording | None:
        """Return the Recording of the lines that these bytes complete, or None where there is none.

        Args:
            data: bytes; a line without its end waits for more.

        Raises:
            ValueError: no header, a column that is missing, another sampling period than the model's, a
                megabyte without a line end.
        """
        rows = self._rows(self._lines(data))
        if not rows:
            return None
        pieces = [piece for piece in self._pieces(rows) if len(piece.time)]
        if not pieces:
            return None
        samples = pieces[0] if len(pieces) == 1 else _in_one(pieces)
        self._refuse_period(samples.time)
        return self._recording(samples)

    def when(self, piece: Recording, k: int) -> str | float:
        """Return the time of a sample: its text, or seconds."""
        written = piece.column[k].as_py()
        if isinstance(written, str):
            return written.strip()
        return float(piece.time[k])

    def label(self, when: str | float) -> str:
        """Return a time from `when` as a reader would write it."""
        if isinstance(when, str):
            return when
        if self.scale is None or self.origin is None:
            return time_label(when, None, self.dt)
        nanoseconds = round((self.origin + when * self.scale) * (1e9 / self.scale))
        return time_label(when, np.datetime64(nanoseconds, "ns"), self.dt)

    def refuse_empty(self) -> None:
        """Raise ValueError at the end of a stream without samples, or with another period than dt."""
        if self.shown:
            check_period(np.array(self.shown), self.dt)
        if self.reader is None:
            if self.begun:
                raise ValueError(f"{SOURCE} ended before the first row of data")
            raise ValueError(f"{SOURCE} is empty")

    def _refuse_period(self, time: np.ndarray) -> None:
        """Refuse another sampling period than the model's, once enough samples show theirs."""
        if self.shown is None:
            return
        self.shown.extend(time[: SHOWN - len(self.shown)].tolist())
        if len(self.shown) == SHOWN:
            check_period(np.array(self.shown), self.dt)
            self.shown = None

    def _recording(self, samples: _LineSamples) -> Recording:
        """Return the Recording of samples."""
        written = samples.written
        if isinstance(written, np.ndarray):
            written = to_arrow(written)
        return Recording(
            samples.u,
            samples.y,
            samples.starts,
            known(self.model),
            self.model.outputs,
            samples.excluded,
            time=samples.time,
            origin=self.began,
            dt=self.dt,
            stamps=samples.stamps,
            written=written,
            source=SOURCE,
        )

    def _lose(self, sentence: str) -> None:
        """Say that a line is left out."""
        self.lost += 1
        self.complain("line", sentence)

    def _lines(self, data: bytes) -> list[Line]:
        """Return the complete lines, with their numbers; the bytes behind them wait for more."""
        data = self.tail + self._continued(data)
        cut = max(data.rfind(b"\n"), data.rfind(b"\r")) + 1
        lines, tail = split_lines(data[:cut]), data[cut:]
        if len(tail) > LONGEST:
            raise ValueError(f"{SOURCE}: a megabyte without a line end is no CSV")
        numbered = list(enumerate(lines, self.number + 1))
        if self.rest and lines:
            whole = self._joined(lines[0])
            if whole is None:
                del numbered[0]
            else:
                numbered[0] = self.number + 1, whole
        self.tail = tail
        self.number += len(lines)
        return numbered

    def _rows(self, lines: list[Line]) -> list[Line]:
        """Return the lines that are rows of data and new."""
        if self.reader is None:
            lines = self._begin(lines)
        if self.reader is None:
            return []
        reader = self.reader
        rows = self.blank + [(n, line) for n, line in lines if reader.is_row(line)]
        self.blank = []
        while rows and reader.layout.is_blank(rows[-1][1]):
            self.blank.insert(0, rows.pop())
        if rows and self.resumed and not self.replaying:
            rows = self._resume(rows)
        return rows

    def _continued(self, data: bytes) -> bytes:
        r"""Return bytes behind those before, without those that belong to the end of the last line.

        That end may be \r, \r\n or \r\r\n. A line is taken as soon as \r ends it; other \r behind it wait for
        what follows.
        """
        if self.returns:
            data = b"\r" * self.returns + data
            behind = data.lstrip(b"\r")
            if behind.startswith(b"\n"):
                data = behind[1:]
            elif behind:
                data = data[1:]
            else:
                self.returns = len(data)
                return b""
        complete = data.rstrip(b"\r")
        self.returns = len(data) - len(complete)
        if self.returns:
            return complete + b"\r"
        return complete

    def _begin(self, lines: list[Line]) -> list[Line]:
        """Find out how the stream is written, once there is a row of data; return the lines from there on."""
        self.begun += lines
        while self.begun and not self.begun[0][1].removeprefix(BOM).strip():
            del self.begun[0]
        separator = bool(self.begun) and self.begun[0][1].removeprefix(BOM).startswith(b"sep=")
        header = int(separator)
        at = header + 1
        while at < len(self.begun):
            number, line = self.begun[at]
            if not line.strip():
                at += 1
                continue
            head = [text for _, text in (*self.begun[: header + 1], self.begun[at])]
            try:
                reader = LineReader(head, self.model)
            except WrongCells as e:
                self._lose(f"line {number} {e}")
                del self.begun[at]
                continue
            if not self.regular and reader.plan.time is None:
                raise ValueError(f"{SOURCE} has no column of times: means over intervals need one")
            self.reader = reader
            if reader.plan.time is None:
                self.complain("hint", f"{SOURCE} has no time column: {rows_apart(self.dt)}")
            rows, self.begun = self.begun[header + 1 :], []
            return [row for row in rows if row[0] >= number or not reader.layout.is_blank(row[1])]
        return []

    def _joined(self, line: bytes) -> bytes | None:
        """Return the first line of a stream that goes on behind half a line: that line, or the whole one.

        None where one cannot tell.
        """
        reader = self._known_reader
        both, self.rest = (line, self.rest + line), b""
        if line.removeprefix(BOM).strip() in [head.strip() for head in reader.head]:
            return line
        fitting = [text for text in both if reader.fits(text)]
        if len(fitting) == 2:
            fitting = [text for text in fitting if self._is_next(text)]
        if len(fitting) == 1:
            return fitting[0]
        self.broken = True
        self._lose("line 1 may be the rest of one that was begun before")
        return None

    @property
    def _known_reader(self) -> LineReader:
        """The reader, where there has been a row of data."""
        assert self.reader is not None, "there was a row of data"
        return self.reader

    def _is_next(self, line: bytes) -> bool:
        """Return whether a line is of the sample dt after the last one; where steps differ, of a later."""
        reader = self._known_reader
        if reader.plan.time is None or not self.clock.samples:
            return False
        try:
            step = self._step_to(reader.stamp(line))
        except ValueError:
            return False
        if not self.regular:
            return step > 0
        return abs(step - self.dt) <= TOLERATED_STEP * self.dt

    def _step_to(self, cell: str) -> float:
        """Return the seconds from the last sample to one whose time is written so."""
        import pyarrow as pa

        if self._known_reader.is_text:
            time, _, _ = parse_stamps(pa.array([*self.texts, cell]), self.dt, str)
            return float(time[-1] - time[-2])
        number = since_epoch(np.array([float(cell.replace(",", "."))]))
        value = float(self.counting.seconds(number)[0])
        if self.scale is not None and self.origin is not None:
            value = (value - self.origin) / self.scale
        return value - self.clock.last

    def _resume(self, rows: list[Line]) -> list[Line]:
        """Find out how the stream goes on, from its first rows; return them without the header."""
        plan, head = self._known_reader.plan, [_bare(line) for line in self._known_reader.head]
        while rows and _bare(rows[0][1]) in head[:-1]:
            rows, self.repeated = rows[1:], True
        if not rows:
            return []
        filled = next((line for _, line in rows if line.strip()), b"")
        self._refuse_other_header(filled)
        begins_again = self.repeated and _bare(filled) == head[-1]
        if plan.time is None and begins_again:
            self.counted = 0
        elif plan.time is None:
            self.broken = True
            self.complain("replay", "no time says whether lines were lost between: windows begin anew")
        if self.clock.samples and (plan.time is not None or begins_again):
            self.after = self.clock.last
            return rows
        return self._numbered_behind(rows)

    def _refuse_other_header(self, line: bytes) -> None:
        """Refuse a line that is a header with other columns than before."""
        reader = self._known_reader
        cells = [cell.strip() for cell in reader.cells(line)]
        if self.repeated or any(is_number(cell, reader.layout.decimal) for cell in cells):
            return
        if set(cells) & set(reader.plan.columns):
            raise ValueError(
                f"{SOURCE} begins with another header than before, {', '.join(cells)}: choose another --out "
                f"or --state"
            )

    def _numbered_behind(self, rows: list[Line]) -> list[Line]:
        """Return the first rows that are new, numbered behind those of the processes before."""
        behind = self.resumed - rows[0][0] + 1
        self.resumed, self.after, self.counted = 0, None, None
        self.number += behind
        return [(n + behind, line) for n, line in rows]

    def _pieces(self, rows: list[Line]) -> Iterator[_LineSamples]:
        """Yield the samples of lines, which are halved until the one that cannot be read is alone."""
        try:
            yield self._samples(rows)
        except OtherSamples:
            raise
        except ValueError as e:
            if len(rows) > 1:
                half = len(rows) // 2
                yield from self._pieces(rows[:half])
                yield from self._pieces(rows[half:])
                return
            number, line = rows[0]
            left_out = self._left_out(rows)
            if left_out is not None:
                yield left_out
                return
            digest = digests_of([np.zeros(1)], [[line.decode("latin-1").strip()]])
            if self.replaying and self.taken.knows(digest).all():
                self.skipped += 1
                return
            self.taken.add(digest)
            self.broken = True
            trouble = self._known_reader.trouble(line) or str(e).strip()
            self._lose(f"line {number} {trouble}")

    def _left_out(self, rows: list[Line]) -> _LineSamples | None:
        """Return the sample of a line with cells that are no numbers, if `where` leaves it out, else None."""
        if self._known_reader.plan.where is None:
            return None
        try:
            return self._samples(rows, self._known_reader.numbers_in(rows[0][1]))
        except OtherSamples:
            raise
        except ValueError:
            return None

    def _samples(self, rows: list[Line], cells: Cells | None = None) -> _LineSamples:
        """Return the samples of lines that can all be read. cells: of lines that count only if `where` leaves
        all of them out; None: not read yet.
        """
        count, plan, counts = len(rows), self._known_reader.plan, cells is None
        if cells is None:
            cells = self._known_reader.columns([line for _, line in rows])
        columns, texts = cells
        digests = self._digests(columns, texts, count)
        if texts is not None:
            times = self._text_times(texts)
        elif plan.time is not None:
            times = self._number_times(columns[plan.time])
        else:
            times = self._counted_times(count)
        if plan.time is not None:
            columns.setdefault(plan.time, times.time if times.stamps is None else times.stamps)
        since = times.time
        if self.origin is not None and self.scale is None:  # numbers that are seconds
            since = since - self.origin
        u, y, excluded = plan.samples(columns, count, (since, times.stamps))
        if not counts and (excluded is None or not excluded.all()):
            raise ValueError("is no row that is left out")
        stamps = None
        if not self.regular:
            stamps = times.stamps
        samples = _LineSamples(times.time, times.written, u, y, np.zeros(0, np.int64), excluded, stamps)
        if self.after is not None:
            samples, digests, rows = self._behind(samples, digests, rows, times.before)
            if not rows:
                return samples
        self.taken.add(digests)
        return self._seamed(samples, rows, times.before)

    def _digests(self, columns: dict[str, np.ndarray], texts: "pa.Array | None", count: int) -> np.ndarray:
        """Return the digests of rows: of their time as it is written, and of all cells that are read."""
        numbers: list[np.ndarray] = [np.zeros(count)]
        words: list[list[str | None]] = []
        for column in columns.values():
            if column.dtype == object:
                words.append(column.tolist())
            else:
                numbers.append(column)
        if texts is not None:
            words.append(texts.to_pylist())
        elif self._known_reader.plan.time is None:
            numbers.append(self._first_counted + np.arange(count))
        return digests_of(numbers, words)

    def _behind(
        self, samples: _LineSamples, digests: np.ndarray, rows: list[Line], before: float
    ) -> tuple[_LineSamples, np.ndarray, list[Line]]:
        """Return samples, digests and rows behind those that an earlier process had judged."""
        timed = self._known_reader.plan.time is not None

        def named(k: int) -> tuple[str, str]:
            number, line = rows[k]
            name, end = f"line {number}", self.label(before)
            if timed:
                name = f"line {number}, at {self._known_reader.stamp(line)},"
            if self._known_reader.is_text:
                end = self.label(self.texts[-1].strip())
            return name, end

        old = self.old_ones(digests, samples.time, before, named)
        if self.counted is not None:
            self.counted += old
        if old:
            self.broken = self.was_broken  # what was lost lies before these
        new = rows[old:]
        if new and self.skipped:
            self.complain("replay", self.skipped_text)
        if new:
            new = self._numbered_behind(new)
        return samples.behind(old), digests[old:], new

    def _seamed(self, samples: _LineSamples, rows: list[Line], before: float) -> _LineSamples:
        """Return samples that are taken, with their seams."""
        known, time = self.clock.samples, samples.time
        # one sample that is on time, as most are: sooner said than by `tick`
        starts = np.zeros(0, np.int64)
        if not self.regular:
            self.clock = replace(self.clock, samples=known + len(time), last=float(time[-1]))
        elif len(time) == 1 and known and abs(time[0] - before - self.dt) <= TOLERATED_STEP * self.dt:
            self.clock = replace(self.clock, samples=known + 1, last=float(time[0]))
        else:
            self.clock, seams = tick(replace(self.clock, last=before), time)
            starts = seams - known
        if self._known_reader.is_text:
            if not self.texts:
                self.texts = [samples.written[0].as_py()]
            self.texts = [self.texts[0], samples.written[-1].as_py()]
        steps = np.diff(time, prepend=before)
        for k in starts[:TOLD]:
            late = f"comes {steps[k]:.6g} s after the sample before it, not dt = {self.dt:g} s"
            self.complain("seam", f"line {rows[k][0]} {late}: windows across are MISSING")
        if self.broken:
            starts, self.broken = np.union1d(starts, [0]), False
        excluded = samples.excluded
        if excluded is not None and self.regular:
            edges = np.flatnonzero(np.diff(excluded.astype(np.int8), prepend=np.int8(self.aside)))
            starts, self.aside = np.union1d(starts, edges), bool(excluded[-1])
        return samples._replace(starts=starts)

    def _counted_times(self, count: int) -> _LineTimes:
        """Return the times of rows that tell none: they are dt apart."""
        time = (self._first_counted + np.arange(count)) * self.dt
        return _LineTimes(time, None, time, (self.clock.samples - 1) * self.dt)

    @property
    def _first_counted(self) -> int:
        """The number of the next sample, of those that are sent again too."""
        if self.counted is not None:
            return self.counted
        return self.clock.samples

    def _number_times(self, cells: np.ndarray) -> _LineTimes:
        """Return times that are written as numbers: seconds, or an epoch."""
        if np.isnan(cells).any():
            raise ValueError("has no time")
        values = self._in_seconds(since_epoch(cells))
        if self.origin is None:
            self.origin = float(values[0])
            self.scale = scale_of(self.origin)
        if self.scale is None:
            self.began = 0.0
            return _LineTimes(values, None, cells, self.clock.last)
        self.began = self.origin / self.scale
        time = (values - self.origin) / self.scale
        return _LineTimes(time, from_epoch(values, self.scale), cells, self.clock.last)

    def _in_seconds(self, values: np.ndarray) -> np.ndarray:
        """Return numbers of the time in s: how they count, the first two of them say."""
        if self.unit_known:
            return self.counting.seconds(values)
        shown, dt = np.append(self.lone, values), None
        if self.regular:
            dt = self.dt
        self.counting = counting_of(shown, dt, str(self._known_reader.plan.time))
        self.unit_known = len(shown) > 1
        if self.unit_known and len(self.lone) and self.counting.zero:
            # one that was taken to be in seconds is a day
            self.origin = float(self.counting.seconds(self.lone)[0])
            self.scale = scale_of(self.origin)
            self.clock = replace(self.clock, last=0.0)
            if self.shown is not None:
                self.shown[:1] = [0.0]
        self.lone = shown[:1]
        if self.unit_known and self.counting.hint:
            self.complain("hint", self.counting.hint)
        return self.counting.seconds(values)

    def _text_times(self, cells: "pa.Array") -> _LineTimes:
        """Return times that are written as text; they are read behind the first and the last, by which the
        order of day and month stays what it was.
        """
        import pyarrow as pa

        before = self.texts
        if cells.null_count:
            raise ValueError("has no time")
        every = pa.concat_arrays([pa.array(before, pa.string()), cells])
        period = None
        if self.regular:
            period = self.dt
        time, stamps, hint = parse_stamps(every, period, lambda k: "")
        if stamps is not None:
            self.began = float((stamps[0] - EPOCH) / SECOND)
        if not before:
            if hint:
                self.complain("hint", hint)
            return _LineTimes(time, stamps, cells, np.nan)
        if stamps is not None:
            stamps = stamps[len(before) :]
        return _LineTimes(time[len(before) :], stamps, cells, time[1])


def _bare(line: bytes) -> bytes:
    """Return a line as headers are compared."""
    return line.removeprefix(BOM).strip()


def _in_one(pieces: list[_LineSamples]) -> _LineSamples:
    """Return samples of lines that follow each other as one."""
    import pyarrow as pa

    starts: list[np.ndarray] = []
    first = 0
    for piece in pieces:
        starts.append(piece.starts + first)
        first += len(piece.time)
    times, writtens, inputs, outputs, _, sets_aside, dates = zip(*pieces, strict=True)
    join: Callable[[Any], Any] = np.concatenate
    if isinstance(writtens[0], pa.Array):
        join = pa.concat_arrays
    excluded = None
    if sets_aside[0] is not None:
        excluded = np.concatenate(sets_aside)
    stamps = None
    if dates[0] is not None:
        stamps = np.concatenate(dates)
    signals = np.concatenate(inputs), np.concatenate(outputs)
    seams = np.concatenate(starts)
    return _LineSamples(np.concatenate(times), join(writtens), *signals, seams, excluded, stamps)
