"""Lines of CSV as they come through a pipe: the samples in them, where they do not follow each other, and the
lines that cannot be read.

Lines are counted from 1, the header's. One that cannot be read is left out, with a sentence, and no window
spans it. What has been taken is remembered in a few numbers and lines, so that another process can go on
behind it, whether the sender begins again or not.
"""

import codecs
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial, reduce
from pathlib import Path
from typing import Any

import numpy as np

from jaxbound.recordings.columns import Arrow, to_arrow
from jaxbound.recordings.counting import Counting, Numbers, numbers_of
from jaxbound.recordings.csvlines import BOM, split_lines
from jaxbound.recordings.csvtext import (
    BLANK,
    FURTHER,
    MISSING_CELLS,
    READ_AS,
    UNENDED,
    WIDE,
    head_of,
    is_number,
    is_value,
    wide_encoding,
)
from jaxbound.recordings.linetext import (
    Cells,
    LineReader,
    may_end_in_zeros,
    of_one,
    reader_of,
    refuse_infinite,
)
from jaxbound.recordings.oddcells import thousands
from jaxbound.recordings.recording import Recording, Samples, Times
from jaxbound.recordings.recordingformat import RecordingFormat, format_of
from jaxbound.recordings.seams import SUMMER, TOLERATED_STEP, check_period, rows_apart
from jaxbound.recordings.selection import Moments
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.stream import Complain, OtherSamples, Stream, Taken, digests_of
from jaxbound.recordings.thousands import Doubt
from jaxbound.recordings.timestamps import (
    NO_CLOCK,
    order_in_words,
    order_of,
    parse_stamps,
    since_epoch,
    without_clock,
)

SOURCE = "standard input"
LONGEST = 1 << 20  # bytes of a line
SHOWN = 100  # samples whose steps say whether the sampling period is the model's
TIME = "= time"
"""The time of a row, which no column is called."""
TOLD = 20  # seams of one piece that get a sentence
Line = tuple[int, bytes]
"""A line with its number."""


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
        format_of(model).refuse_in("a pipe", "hold", "equal", "long")
        self.undecided: bytes | None = b""  # the first bytes, as long as they do not show the encoding
        self.wide = ""  # the encoding of text with several bytes a letter
        self.decoder: codecs.IncrementalDecoder | None = None  # of such text
        self.tail = self.rest = b""  # half a line; half a line of a process before
        self.head: list[bytes] = []  # the header and the first row of data, perhaps a line with the delimiter
        self.reader: LineReader | None = None  # as soon as there is a row of data
        self.doubts: dict[str, Doubt] = {}  # of columns whose decimal signs may be signs for thousands
        self.begun: list[Line] = []  # lines before that
        self.looked_at = 0  # of these, as rows of data
        self.doubtful: ValueError | None = None  # why these are no header yet
        self.number = 0  # lines so far
        self.resumed = 0  # those before this process, as long as it is not clear how the stream goes on
        self.texts: list[str] = []  # the first and the last time, where it is written as text
        self.order = ""  # of day and month, as soon as times show it
        self.numbers: Numbers | None = None  # how those of a time tell it, and whether that is known
        self.unit_known = False
        self.lone = np.zeros(0)  # the first number, as long as it is the only one
        self.broken = self.repeated = self.hinted = False
        self.counted: int | None = None  # samples that are sent again, where no time tells them
        self.blank: list[Line] = []  # blank lines that are wrong, without a time, where a row follows
        self.returns = 0  # carriage returns at the end, which may be the first half of a line end
        self.replaying = False  # the lines that come are those that a process before had judged
        self.was_broken = False  # behind the last sample of that one
        self.was_before: dict[str, np.ndarray] = {}
        self.before: dict[str, np.ndarray] = {}  # the last row, where a signal looks back
        self.line = b""  # the last row
        self.shown: list[float] | None = []
        if not self.regular:
            self.shown = None
        if memory is not None:
            self._resume_from(memory)

    def _resume_from(self, memory: dict[str, Any]) -> None:
        """Go on from a memory."""
        if memory.get("wide"):
            self.wide, held, flag = memory["wide"]
            self.decoder = codecs.getincrementaldecoder(self.wide)("replace")
            self.decoder.setstate((held.encode("latin-1"), flag))
        self._understand([line.encode("latin-1") for line in memory["head"]])
        reader = self._known_reader
        reader.layout = replace(reader.layout, skip=0)
        reader.resume(memory.get("reader", {}))
        for name, fields in memory.get("doubts", {}).items():
            self.doubts[name] = Doubt(**fields)
        self.rest = memory["tail"].encode("latin-1")
        if self.rest == b"\r":
            self.rest, self.returns = b"", 1
        self._resume_clock(memory)
        self.texts, self.unit_known = memory["texts"], memory["unit_known"]
        self.order = memory.get("order", "")
        self.lone = np.array(memory["lone"], float)
        if memory["numbers"] is not None:
            counting, scale, origin = memory["numbers"]
            self.numbers = Numbers(Counting(*counting), scale, origin)
        for name, cell in memory.get("before", {}).items():
            self.was_before[name] = np.array([cell], object if name in reader.texts else float)
        self.before = self.was_before
        self.broken, self.resumed = memory["broken"], memory["number"]
        self.was_broken, self.shown = self.broken, None

    def memory(self) -> dict[str, Any] | None:
        """Return the state from which another PipeText goes on, as JSON holds it; None before the first
        sample.
        """
        if self.reader is None:
            return None
        broken, before = self.broken or bool(self.blank), self.before
        if self.replaying:
            broken, before = self.was_broken, self.was_before
        wide = None
        if self.decoder is not None:
            held, flag = self.decoder.getstate()
            wide = self.wide, held.decode("latin-1"), flag
        return {
            "wide": wide,
            "head": [line.decode("latin-1") for line in self.head],
            "number": max(self.number, self.resumed),
            "tail": (self.rest + self.tail + b"\r"[: self.returns]).decode("latin-1"),
            **self._clock_memory(),
            "numbers": self.numbers,
            "lone": self.lone.tolist(),
            "unit_known": self.unit_known,
            "texts": self.texts,
            "order": self.order,
            "broken": broken,
            "before": {name: x.item() for name, x in before.items() if x.dtype.kind != "M"},
            "reader": self.reader.memory(),
            "doubts": {name: vars(doubt) for name, doubt in self.doubts.items()},
        }

    def ended(self) -> None:
        """Take the end of the stream: a last line without its own is left out.

        Raises:
            ValueError: there was no row of data.
        """
        if self.tail.strip():
            self._lose(f"the last line {UNENDED}")
        self.refuse_empty()

    def take(self, arrival: bytes) -> Recording | None:  # type: ignore[override]  # nothing else arrives
        """Return the Recording of the lines that these bytes complete, or None where there is none; a line
        without its end waits for more.

        Raises:
            ValueError: no header, a column that is missing, another sampling period than the model's, a
                megabyte without a line end.
        """
        rows = self._rows(self._lines(self._narrow(arrival)))
        pieces = [piece for piece in self._pieces(rows) if piece.samples] if rows else []
        if not pieces:
            return None
        whole = reduce(Recording.followed, pieces)
        self._refuse_period(whole.time)
        return whole

    def _narrow(self, data: bytes) -> bytes:
        """Return bytes of text with several bytes a letter in UTF-8, and others as they are."""
        if self.undecided is not None:
            data = self.undecided + data
            self.undecided = data
            if len(data) < 2:
                return b""
            self.undecided, wide = None, wide_encoding(data, format_of(self.model))
            if wide and self.decoder is None:
                self.wide, self.decoder = wide, codecs.getincrementaldecoder(wide)("replace")
            elif self.decoder is not None and data.startswith(WIDE):  # the sender begins again
                self.decoder.reset()
        if self.decoder is None:
            return data
        return self.decoder.decode(data).encode()

    def label(self, when: str | float) -> str:
        """Return a time from `when` as a reader would write it."""
        numbers = self.numbers
        if isinstance(when, str) or numbers is None or numbers.scale is None:
            return super().label(when)
        return super().label(numbers.origin / numbers.scale + when)

    def refuse_empty(self) -> None:
        """Raise ValueError at the end of a stream without samples, or with another period than dt."""
        if self.shown:
            check_period(np.array(self.shown), self.dt)
        if self.reader is None:
            if self.doubtful is not None:
                raise self.doubtful
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
        # where no time shows that a row is missing, a blank line may have been meant for one
        is_blank, timed = reader.layout.is_blank, reader.plan.time is not None
        if self._format.skip:
            lines = [one for one in lines if not self._is_aside(*one)]
        rows = self.blank + [(n, line) for n, line in lines if not (timed and is_blank(line))]
        self.blank = []
        while rows and is_blank(rows[-1][1]):
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
        at = self.looked_at or int(separator) + 1
        while at < len(self.begun):
            number, line = self.begun[at]
            if not line.strip():
                at += 1
                continue
            above = [one for one in self.begun[:at] if one[1].strip()]
            trouble = self._understand([text for _, text in (*above, self.begun[at])])
            if trouble:
                self._lose(f"line {number} {trouble}")
                del self.begun[at]
                continue
            at += 1
            if self.reader is None:
                self.looked_at = at
                continue
            reader = self._known_reader
            for hint in reader.layout.hints:
                self.complain("hint", f"{SOURCE}: {hint}")
            if reader.plan.time is None:
                self.complain("hint", f"{SOURCE} has no time column: {rows_apart(self.dt)}")
            header = above[reader.layout.header - 1][0]
            if reader.layout.skip > reader.layout.header:  # units stand between
                header = number - 1
            rows, self.begun = [row for row in self.begun if row[0] > header], []
            self.reader.layout = replace(reader.layout, skip=0)
            return [row for row in rows if row[0] >= number or not reader.layout.is_blank(row[1])]
        return []

    def _understand(self, head: list[bytes]) -> str:
        """Find out how the stream is written by its first lines, the last of which is the first row of data,
        or perhaps none: then there is no reader yet. Return the trouble with that row, by which it is not
        known, or "".
        """
        how = format_of(self.model)
        try:
            begun = head_of(Path(SOURCE), b"\n".join(head) + b"\n", "" if self.wide else how.encoding)
            if self.wide:
                begun = begun._replace(hints=(READ_AS.format(self.wide.upper()),))
            reader = reader_of(begun._replace(lines=begun.lines[: len(head)]), self.model, how)
        except ValueError as e:
            self.doubtful = ValueError(f"{SOURCE}: {str(e).replace('the file', 'the stream')}")
            if len(head) < FURTHER and self._may_be_above(head):
                return ""
            raise self.doubtful from None
        layout, row = reader.layout, head[-1]
        if len(layout.cells(row)) != len(layout.names) or layout.is_open(row):
            return reader.trouble(row)
        if not self.regular and reader.plan.time is None:
            raise ValueError(f"{SOURCE} has no column of times: means over intervals need one")
        cells = list(map(str.strip, layout.cells(row)))
        if how.comment and layout.text(row).startswith(how.comment):
            return ""
        if len(head) < FURTHER and not any(c != "1" and is_value(c, layout.decimal, how) for c in cells):
            if {*cells} - {"1", *MISSING_CELLS}:
                return ""  # units, perhaps
        self.head, self.reader = head, reader
        if layout.delimiter != "," and not how.decimal and not how.thousands:
            numbers = {*reader.index} - {*reader.texts, reader.plan.time}
            self.doubts = {name: Doubt() for name in reader.index if name in numbers}
        return ""

    def _may_be_above(self, head: list[bytes]) -> bool:
        """Return whether the last of some lines may stand above the header: it is no row of numbers."""
        above, last = (re.split(rb"[;,\t]", line) for line in head[-2:])
        values = sum(is_value(cell.decode("latin-1"), ",") for cell in last)
        return values < 2 or len(above) != len(last)

    def _joined(self, line: bytes) -> bytes | None:
        """Return the first line of a stream that goes on behind half a line: that line, or the whole one.

        None where one cannot tell.
        """
        both, self.rest = (line, self.rest + line), b""
        if line.removeprefix(BOM).strip() in [head.strip() for head in self.head]:
            return line
        layout = self._known_reader.layout
        fitting = [text for text in both if len(layout.cells(text)) == len(layout.names)]
        if len(fitting) == 2:
            fitting = [text for text in fitting if self._is_next(text)]
        if len(fitting) == 1:
            return fitting[0]
        self.broken = True
        self._lose("line 1 may be the rest of one that was begun before")
        return None

    @property
    def _format(self) -> RecordingFormat:
        """The format that is stated, or that times have shown."""
        how = self._known_reader.layout.how
        if not self.order:
            return how
        return replace(how, time_format=self.order)

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
            step = self._step_to(self._stamp(line))
        except ValueError:
            return False
        if not self.regular:
            return step > 0
        return abs(step - self.dt) <= TOLERATED_STEP * self.dt

    def _stamp(self, line: bytes) -> str:
        """Return the time of a line as it is written, the day before the clock where they have columns of
        their own.
        """
        reader = self._known_reader
        cells = reader.layout.cells(line)
        halves = [name for name in (reader.plan.day, reader.plan.time) if name is not None]
        return " ".join(cells[reader.index[name]].strip() for name in halves)

    def _step_to(self, cell: str) -> float:
        """Return the seconds from the last sample to one whose time is written so."""
        import pyarrow as pa

        if self._known_reader.is_text:
            cells = pa.array([*self.texts, cell])
            time, _, _ = parse_stamps(cells, self.dt, str, self._format, self.clock.last)
            return float(time[-1] - time[-2])
        assert self.numbers is not None, "there was a row of data"
        number = since_epoch(np.array([float(cell.replace(",", "."))]))
        return float(self.numbers.times(number)[0][0]) - self.clock.last

    def _resume(self, rows: list[Line]) -> list[Line]:
        """Find out how the stream goes on, from its first rows; return them without the header."""
        plan, head = self._known_reader.plan, list(map(_bare, self.head))
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
            self.replaying = True
            return rows
        return self._numbered_behind(rows)

    def _refuse_other_header(self, line: bytes) -> None:
        """Refuse a line that is a header with other columns than before."""
        reader = self._known_reader
        cells = [cell.strip() for cell in reader.layout.cells(line)]
        if self.repeated or any(is_number(cell, reader.layout.decimal) for cell in cells):
            return
        if set(cells) & set(reader.plan.columns):
            raise ValueError(
                f"{SOURCE} begins with another header than before, {', '.join(cells)}: choose another --out "
                f"or --state"
            )

    def _refuse_other_names(self, line: bytes) -> None:
        """Refuse a stream whose columns change places on the way: a line with other names of columns."""
        names, plan = self._known_reader.layout.names, self._known_reader.plan
        cells = [cell.strip() for cell in self._known_reader.layout.cells(line)]
        if len(cells) == len(names) and cells != names and len({*cells} & {*plan.columns}) > 1:
            raise ValueError(
                f"{SOURCE} goes on with another header than before, {', '.join(cells)}: choose another --out "
                f"or --state"
            )

    def _numbered_behind(self, rows: list[Line]) -> list[Line]:
        """Return the first rows that are new, numbered behind those of the processes before."""
        behind = self.resumed - rows[0][0] + 1
        self.resumed, self.replaying, self.counted = 0, False, None
        self.number += behind
        return [(n + behind, line) for n, line in rows]

    def _pieces(self, rows: list[Line]) -> Iterator[Recording]:
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
            if self._is_aside(number, line):
                return
            self._refuse_other_names(line)
            digest = digests_of([np.zeros(1)], [[line.decode("latin-1").strip()]])
            if self.replaying and self.taken.knows(digest).all():
                self.skipped += 1
                return
            self.taken.add(digest)
            self.broken = True
            trouble = self._known_reader.trouble(line) or str(e).strip()
            self._lose(f"line {number} {trouble}")

    def _is_aside(self, number: int, line: bytes) -> bool:
        """Return whether a line is no row, and say so."""
        reason = self._known_reader.aside(line)
        if number in self._format.skip:
            reason = "are left out as stated"
        if reason:
            self.no_rows += 1
            self.complain("line", f"line {number} {of_one(reason)}: left out")
        return bool(reason)

    def _samples(self, rows: list[Line]) -> Recording:
        """Return the samples of lines that can all be read, but for those that `where` leaves out."""
        reader = self._known_reader
        plan, cells = reader.plan, reader.read_few([line for _, line in rows])
        if cells.rows < len(rows):
            raise ValueError(BLANK)
        if plan.where is None:  # before they tell how the time is counted
            reader.refuse(cells, None, "".format)
        digests = self._digests(cells)
        lines = [line for _, line in rows]
        again = np.array(lines, object) == np.array([self.line, *lines[:-1]], object)
        if plan.time is not None and again.any() and self.dt < SUMMER:
            return self._others(rows, again, "repeats the line before")
        if cells.times is not None:
            times = self._text_times(cells.times)
            alone = self._without_clock(cells.times, times[0])
            if self.replaying:
                alone &= ~self.taken.knows(digests)
            if alone.any():
                return self._others(rows, alone, of_one(NO_CLOCK))
        elif plan.time is not None:
            times = self._number_times(cells.columns[plan.time])
        else:  # rows are dt apart
            times = (self._first_counted + np.arange(cells.rows)) * self.dt, None, None
        columns, (since, stamps, _) = cells.columns, times
        if plan.time is not None:
            columns.setdefault(plan.time, since if stamps is None else stamps)
        if self.numbers is not None and self.numbers.scale is None:
            since = since - self.numbers.origin
        samples = self._samples_behind(columns, (since, stamps))
        if plan.where is not None:
            reader.refuse(cells, samples[2], "".format)
        self._refuse_doubt(cells, samples[2], rows)
        piece = Recording.filed(self.model, samples, times, SOURCE, self.dt)
        if self.replaying:
            piece, digests, rows = self._behind(piece, digests, rows)
            if not rows:
                return piece
        self.taken.add(digests)
        self.line = rows[-1][1]
        return self._seamed(piece, rows)

    def _without_clock(self, cells: Arrow, time: np.ndarray) -> np.ndarray:
        """Return (N,) bool: which of these rows have a date without a clock, see `without_clock`."""
        import pyarrow as pa

        step, before = self.dt, self.texts
        if not self.regular:
            step = self.clock.last / max(self.clock.samples - 1, 1) or math.inf
        every = pa.concat_arrays([pa.array(before, pa.string()), cells])
        return without_clock(every, np.append([0, self.clock.last][: len(before)], time), step)[len(before) :]

    def _others(self, rows: list[Line], gone: np.ndarray, reason: str) -> Recording:
        """Return the samples of lines without those that are none."""
        left: list[Line] = []
        for row, is_gone in zip(rows, gone.tolist(), strict=True):
            if is_gone:
                self.no_rows += 1
                self.complain("line", f"line {row[0]} {reason}: left out")
            else:
                left.append(row)
        if left:
            return self._samples(left)
        return self.numbered(None)[1]

    def _samples_behind(self, columns: Mapping[str, np.ndarray], moments: Moments) -> Samples:
        """Return the samples of columns; a rate needs the row before them, too."""
        plan, (since, stamps) = self._known_reader.plan, moments
        count, behind = len(since), 0
        if any(signal.looks_back for signal in plan.every):
            before, last = self.before, {name: x[-1:] for name, x in columns.items()}
            self.before = {TIME: since[-1:]} | last
            if before and not self.broken:
                behind = 1
                since = np.append(before[TIME], since)
                columns = {name: np.append(before.get(name, x[:1]), x) for name, x in columns.items()}
                if stamps is not None:
                    stamps = np.append(stamps[:1], stamps)
        u, y, excluded = plan.samples(columns, count + behind, (since, stamps), dt=self.dt)
        if excluded is not None:
            excluded = excluded[behind:]
        return u[behind:], y[behind:], excluded

    def _refuse_doubt(self, cells: Cells, excluded: np.ndarray | None, rows: list[Line]) -> None:
        """Refuse a number whose decimal sign may be a sign for thousands, behind whole ones."""
        reader = self._known_reader
        doubts = {name: doubt for name, doubt in self.doubts.items() if not doubt.over}
        if not doubts:
            return
        zeros = np.fromiter((may_end_in_zeros(line) for _, line in rows), bool, len(rows))
        for name, doubt in doubts.items():
            values, at = cells.columns[name], reader.index[name]
            if excluded is not None:
                values = np.where(excluded, np.nan, values)
            odd = doubt.next_odd(values, zeros | (values % 1 != 0), partial(self._cell, rows, at))
            if odd:
                raise ValueError(f"of {thousands(name, [odd])}")

    def _cell(self, rows: list[Line], at: int, k: int) -> str:
        """Return a cell of the line of row k."""
        return self._known_reader.row_of(rows[k][1])[at]

    def _digests(self, cells: Cells) -> np.ndarray:
        """Return the digests of rows: of their time as it is written, and of all cells that are read."""
        numbers: list[np.ndarray] = [np.zeros(cells.rows)]
        words: list[list[str | None]] = []
        for column in cells.columns.values():
            if column.dtype == object:
                words.append(column.tolist())
            else:
                numbers.append(column)
        if cells.times is not None:
            words.append(cells.times.to_pylist())
        elif self._known_reader.plan.time is None:
            numbers.append(self._first_counted + np.arange(cells.rows))
        return digests_of(numbers, words)

    @property
    def last_label(self) -> str:
        """The time of the last sample as it stands there, of numbers as a reader would write it."""
        if self._known_reader.is_text:
            return self.label(self.texts[-1].strip())
        return super().last_label

    def _behind(
        self, piece: Recording, digests: np.ndarray, rows: list[Line]
    ) -> tuple[Recording, np.ndarray, list[Line]]:
        """Return samples, digests and rows behind those that an earlier process had judged."""

        def named(k: int) -> str:
            number, line = rows[k]
            if self._known_reader.plan.time is None:
                return f"line {number}"
            return f"line {number}, at {self._stamp(line)},"

        old = self.old_ones(digests, piece.time, named)
        if self.counted is not None:
            self.counted += old
        if old:
            self.broken = self.was_broken  # what was lost lies before these
        new = rows[old:]
        if new:
            new = self._numbered_behind(new)
        return piece.cut(old, piece.samples), digests[old:], new

    def _seamed(self, piece: Recording, rows: list[Line]) -> Recording:
        """Return samples that are taken, with their seams."""
        steps = np.diff(piece.time, prepend=self.clock.last)
        starts, edges = self.seams(piece.time, piece.excluded)
        if self._known_reader.is_text:
            first, *_ = self.texts or [piece.column[0].as_py()]
            self.texts = [first, piece.column[-1].as_py()]
        for k in starts[:TOLD]:
            late = f"comes {steps[k]:.6g} s after the sample before it, not dt = {self.dt:g} s"
            self.complain("seam", f"line {rows[k][0]} {late}: windows across are MISSING")
        if self.broken:
            starts, self.broken = np.union1d(starts, [0]), False
        if not len(starts) and not len(edges):
            return piece
        return replace(piece, starts=np.union1d(starts, edges))

    @property
    def _first_counted(self) -> int:
        """The number of the next sample, of those that are sent again too."""
        if self.counted is not None:
            return self.counted
        return self.clock.samples

    def _number_times(self, cells: np.ndarray) -> Times:
        """Return times that are written as numbers: seconds, or an epoch."""
        if np.isnan(cells).any():
            raise ValueError("has no time")
        refuse_infinite(str(self._known_reader.plan.time), cells, None, "".format)
        values = since_epoch(cells)
        if not self.unit_known or self.numbers is None:
            self._understand_numbers(values)
        assert self.numbers is not None, "some came"
        return *self.numbers.times(values), to_arrow(cells)

    def _understand_numbers(self, values: np.ndarray) -> None:
        """Find out how numbers tell the time: the first two of them say."""
        shown, dt = np.append(self.lone, values), None
        if self.regular:
            dt = self.dt
        self.numbers, _ = numbers_of(shown, dt, self._known_reader.time_name)
        counting = self.numbers.counting
        self.unit_known = len(shown) > 1
        if self.unit_known and len(self.lone) and counting.zero:
            # one that was taken to be in seconds is a day
            self.clock = replace(self.clock, last=0.0)
            if self.shown is not None:
                self.shown[:1] = [0.0]
        self.lone = shown[:1]
        if self.unit_known and counting.hint:
            self.complain("hint", counting.hint)

    def _text_times(self, cells: Arrow) -> Times:
        """Return times that are written as text; they are read behind the first and the last, and by the
        order of day and month that times have shown.
        """
        import pyarrow as pa

        before = self.texts
        if cells.null_count:
            raise ValueError("has no time")
        every = pa.concat_arrays([pa.array(before, pa.string()), cells])
        period = last = None
        if self.regular:
            period = self.dt
        if before:
            last = self.clock.last
        time, stamps, hint = parse_stamps(every, period, "".format, self._format, last)
        if stamps is not None and not hint and not self._format.time_format:
            self.order = order_of(every, stamps)
            if self.order and self.hinted:
                shown = f"time stamps like {cells[0].as_py()!r} show their order"
                self.complain("hint", f"{shown}: they are {order_in_words(self.order)}")
        if hint and not self.hinted:
            self.complain("hint", hint)
        self.hinted |= bool(hint)
        if not before:
            return time, stamps, cells
        if stamps is not None:
            stamps = stamps[len(before) :]
        # a clock without a day counts anew from the first one and the last
        self.clock = replace(self.clock, last=float(time[1]))
        return time[len(before) :], stamps, cells


def _bare(line: bytes) -> bytes:
    """Return a line as headers are compared."""
    return line.removeprefix(BOM).strip()
