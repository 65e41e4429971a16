"""Lines of CSV as they come through a pipe: the samples in them, where they do not follow each other, and the
lines that cannot be read.

Lines are counted from 1, the header's. One that cannot be read is left out, with a sentence, and no window
spans it. What has been taken is remembered in a few numbers and lines, so that another process can go on
behind it, whether the sender begins again or not.
"""

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any, NamedTuple

import numpy as np

from jaxbound.recordings.csvlines import BOM, split_lines
from jaxbound.recordings.csvtext import is_number
from jaxbound.recordings.linetext import SOURCE, LineReader, WrongCells
from jaxbound.recordings.seams import TOLERATED_STEP, Clock, Seam, check_period, tick
from jaxbound.recordings.timestamps import EPOCHS, parse_stamps, since_epoch, time_label

__all__ = ["Piece", "PipeText"]

LONGEST = 1 << 20  # bytes of a line
SHOWN = 100  # samples whose steps say whether the sampling period is the model's


class Piece(NamedTuple):
    """The samples of some lines: time (N,) in s; written, the time as it stands there, numbers or a pyarrow
    array of texts; u, y; starts: numbers, counted in these, of samples that do not follow the one before;
    excluded (N,) bool or None: left out by the model's `where`.
    """

    time: np.ndarray
    written: np.ndarray
    u: np.ndarray
    y: np.ndarray
    starts: np.ndarray
    excluded: np.ndarray | None


class PipeText:
    """Takes bytes, gives Pieces.

    Args:
        model: whose signals are wanted. complain: called with (kind, sentence) on each line that is left out
            and each seam.
        memory: from `.memory()` of another PipeText, to go on where that ended; None: a new stream.
    """

    def __init__(self, model: Any, complain: Callable[[str, str], None], memory: dict | None = None) -> None:
        self.model, self.complain, self.tail, self.last = model, complain, b"", b""
        self.reader: Any = None  # a LineReader, as soon as there is a row of data
        self.held: list[tuple[int, bytes]] = []
        self.number = self.resumed = (
            0  # lines so far; those before this process, as long as it is not clear how the stream goes on
        )
        self.clock, self.texts = Clock(model.dt), []
        self.origin: Any = None  # of a time that is an epoch, with units a second in .scale
        self.scale: Any = None
        self.broken = self.aside = self.repeated = False
        self.skip, self.skipped, self.rest = 0, 0, b""
        self.blank: list[
            tuple[int, bytes]
        ] = []  # blank lines that are wrong, without a time, where a row follows
        self.returns = (
            0  # carriage returns at the end of what was taken, which may be the first half of a line end
        )
        self.after: float | None = None
        self.shown: list[float] | None = []
        if memory is not None:
            self.reader = LineReader([line.encode("latin-1") for line in memory["head"]], model)
            self.rest, self.last = (memory[x].encode("latin-1") for x in ("tail", "last"))
            if self.rest == b"\r":
                self.rest, self.returns = b"", 1
            self.clock = Clock(
                model.dt, memory["samples"], memory["time"], tuple(Seam(**s) for s in memory["seams"])
            )
            self.origin, self.scale, self.texts, self.aside = (
                memory["origin"],
                memory["scale"],
                memory["texts"],
                memory["aside"],
            )
            self.broken, self.number, self.resumed, self.shown = memory["broken"], 0, memory["number"], None

    def memory(self) -> dict | None:
        """Return what another PipeText needs to go on, as JSON holds it; None before the first sample."""
        if self.reader is None:
            return None
        line = lambda b: b.decode("latin-1")
        return {
            "head": [line(x) for x in self.reader.head],
            "number": max(self.number, self.resumed, self.skip),
            "tail": line(self.rest + self.tail + b"\r"[: self.returns]),
            "last": line(self.last),
            "samples": self.clock.samples,
            "time": self.clock.last,
            "seams": [asdict(s) for s in self.clock.seams],
            "origin": self.origin,
            "scale": self.scale,
            "texts": self.texts,
            "broken": self.broken or bool(self.blank),
            "aside": self.aside,
        }

    def take(self, data: bytes, end: bool = False) -> Piece | None:
        """Return the Piece of the lines that these bytes complete, or None where there is none; `end`: the
        last line needs no line end.

        Raises:
            ValueError: no header, a column that is missing, another sampling period than the model's, a
                megabyte without a line end.
        """
        data = self.tail + self._continued(data, end)
        cut = len(data) if end else max(data.rfind(b"\n"), data.rfind(b"\r")) + 1
        lines, tail = split_lines(data[:cut]), data[cut:]
        if len(tail) > LONGEST:
            raise ValueError(f"{SOURCE}: a megabyte without a line end is no CSV")
        if self.rest and lines:
            lines[0] = self._joined(lines[0])
        self.tail = tail
        first, self.number = self.number + 1, self.number + len(lines)
        kept = [(n, line) for n, line in enumerate(lines, first) if line is not None]
        if kept and self.reader is None:
            kept = self._begin(kept)
        kept = self.blank + [(n, line) for n, line in kept if self.reader.is_row(line)]
        self.blank = []
        while kept and self.reader.layout.is_blank(kept[-1][1]):
            self.blank.insert(0, kept.pop())
        if kept and self.resumed:
            kept = self._resume(kept)
        if self.skip:
            kept = self._replayed(kept)
        if not kept:
            return None
        self.last = kept[-1][1]
        pieces = [piece for piece in self._pieces(kept) if len(piece.time)]
        if not pieces:
            return None
        piece = pieces[0] if len(pieces) == 1 else _concatenated(pieces)
        if self.shown is not None:
            self.shown.extend(piece.time[: SHOWN - len(self.shown)].tolist())
            if len(self.shown) == SHOWN or end:
                check_period(np.array(self.shown), self.model.dt)
                self.shown = None
        return piece

    def end(self) -> None:
        """Say what can only be said at the end: see `take` for what it raises."""
        if self.shown:
            check_period(np.array(self.shown), self.model.dt)
        if self.reader is None:
            raise ValueError(
                f"{SOURCE} ended before the first row of data" if self.held else f"{SOURCE} is empty"
            )

    def label(self, time: float) -> str:
        """Return a time in s as a reader would write it; where it is written as text, that of the last
        sample.
        """
        if self.reader.is_text:
            return self.texts[-1].strip()
        stamp = (
            None
            if self.scale is None
            else np.datetime64(round((self.origin + time * self.scale) * (1e9 / self.scale)), "ns")
        )
        return time_label(time, stamp, self.model.dt)

    def _continued(self, data, end):
        r"""Return bytes behind those before without what of them belongs to the end of the last line, which
        may be \r, \r\n or \r\r\n.

        A line is taken as soon as \r ends it; other \r behind it wait for what follows.
        """
        if self.returns:
            data = b"\r" * self.returns + data
            behind = data.lstrip(b"\r")
            if behind.startswith(b"\n"):
                data = behind[1:]
            elif behind or end:
                data = data[1:]
            else:
                self.returns = len(data)
                return b""
        kept = data if end else data.rstrip(b"\r")
        self.returns = len(data) - len(kept)
        return kept + b"\r" if self.returns else kept

    def _begin(self, kept):
        """Find out how the stream is written, once there is a row of data; return the lines from the first
        that may be one.
        """
        self.held += kept
        while self.held and not self.held[0][1].removeprefix(BOM).strip():
            del self.held[0]
        header = 1 if self.held and self.held[0][1].removeprefix(BOM).startswith(b"sep=") else 0
        at = header + 1
        while at < len(self.held):
            number, line = self.held[at]
            if not line.strip():
                at += 1
                continue
            try:
                self.reader = LineReader(
                    [line for _, line in (*self.held[: header + 1], self.held[at])], self.model
                )
            except WrongCells as e:
                self.complain("line", f"line {number} {e}")
                del self.held[at]
                continue
            rows, self.held = self.held[header + 1 :], []
            return [pair for pair in rows if pair[0] >= number or not self.reader.layout.is_blank(pair[1])]
        return []

    def _joined(self, line):
        """Return the first line of a stream that goes on behind half a line: that line, or the whole one;
        None where one cannot tell.
        """
        both, self.rest = (line, self.rest + line), b""
        if line.removeprefix(BOM).strip() in [x.strip() for x in self.reader.head]:
            return line
        whole = [x for x in both if self.reader.fits(x)]
        if len(whole) == 2:
            whole = [x for x in whole if self._is_next(x)]
        if len(whole) == 1:
            return whole[0]
        self.broken = True
        self.complain("line", "line 1 may be the rest of one that was begun before")
        return None

    def _is_next(self, line):
        """Return whether a line of data is of the sample dt after the last one."""
        import pyarrow as pa

        if self.reader.plan.time is None or not self.clock.samples:
            return False
        cell = self.reader.stamp(line)
        try:
            if self.reader.is_text:
                step = np.diff(parse_stamps(pa.array([*self.texts, cell]), self.model.dt, str)[0])[-1]
            else:
                value = float(since_epoch(np.array([float(cell.replace(",", "."))]))[0])
                step = (value if self.scale is None else (value - self.origin) / self.scale) - self.clock.last
        except ValueError:
            return False
        return abs(step - self.model.dt) <= TOLERATED_STEP * self.model.dt

    def _resume(self, kept):
        """Find out how the stream goes on: return the lines that are new, as far as that is clear."""
        bare = lambda line: line.removeprefix(BOM).strip()
        header = [bare(x) for x in self.reader.head[:-1]]
        while kept and bare(kept[0][1]) in header:
            kept, self.repeated = kept[1:], True
        if not kept:
            return []
        filled = next((line for _, line in kept if line.strip()), b"")
        cells = [c.strip() for c in self.reader.cells(filled)]
        if (
            not self.repeated
            and not any(is_number(c, self.reader.layout.decimal) for c in cells)
            and set(cells) & set(self.reader.plan.columns)
        ):
            raise ValueError(
                f"{SOURCE} begins with another header than before, {', '.join(cells)}: choose another --out "
                f"or --state"
            )
        if bare(filled) == bare(self.reader.head[-1]) and (
            self.repeated or self.reader.plan.time is not None
        ):
            self.skip = self.resumed
            self.complain("replay", "the sender began again: what was judged before is skipped")
        else:
            self.after = self.clock.last if self.reader.plan.time is not None and self.clock.samples else None
            if self.reader.plan.time is None:
                self.broken = True
                self.complain("replay", "no time says whether lines were lost between: windows begin anew")
            first = kept[0][0]
            kept = [(n - first + 1 + self.resumed, line) for n, line in kept]
            self.number += self.resumed - first + 1
        self.resumed = 0
        return kept

    def _replayed(self, kept):
        """Return what is left behind the lines that were taken by an earlier process."""
        old = [pair for pair in kept if pair[0] <= self.skip]
        if old and old[-1][0] == self.skip or self.number >= self.skip:
            line = old[-1][1] if old else None
            if line is not None and line.strip() != self.last.strip():
                self.complain(
                    "replay",
                    f"the sender began again, but its line {old[-1][0]} is not the one that was judged: what "
                    f"it sends "
                    "from here on is taken to follow that",
                )
            self.skip = 0
        return kept[len(old) :]

    def _pieces(self, kept):
        """Yield the Pieces of lines, which are halved until the one that cannot be read is alone."""
        try:
            yield self._piece(kept)
        except ValueError as e:
            if len(kept) > 1:
                half = len(kept) // 2
                yield from self._pieces(kept[:half])
                yield from self._pieces(kept[half:])
            else:
                self.broken = True
                self.complain(
                    "line", f"line {kept[0][0]} {self.reader.trouble(kept[0][1]) or str(e).strip()}"
                )

    def _piece(self, kept):
        """Return the Piece of lines that can all be read."""
        count, plan = len(kept), self.reader.plan
        columns, stamps = self.reader.columns([line for _, line in kept])
        time, stamps, written, before = self._times(
            columns.get(plan.time) if stamps is None else stamps, count
        )
        columns.setdefault(plan.time, time if stamps is None else stamps)
        u, y, excluded = plan.samples(columns, count)
        new = np.arange(count)
        if (
            self.after is not None
        ):  # the sender may have begun again somewhere: what is not after the last sample was judged
            fresh = time > before
            new = new[np.argmax(fresh) :] if fresh.any() else new[:0]
            self.after, self.skipped = None if len(new) else self.after, self.skipped + count - len(new)
            self.number -= count - len(new)
            if not len(new):
                return Piece(time[new], written[:0], u[new], y[new], new, None)
            time, written, u, y, kept = time[new], written[new[0] :], u[new], y[new], kept[new[0] :]
            excluded = None if excluded is None else excluded[new]
            if self.skipped:
                self.complain(
                    "replay",
                    f"{self.skipped} lines, not after {self.label(before)}, were judged before and are "
                    f"skipped: if the "
                    "clock was set back meanwhile, begin anew with another --out or --state",
                )
        return self._follow(time, written, u, y, excluded, before, kept)

    def _follow(self, time, written, u, y, excluded, before, kept):
        """Find the seams of samples that are taken."""
        known = self.clock.samples
        if (
            len(time) == 1
            and known
            and abs(time[0] - before - self.model.dt) <= TOLERATED_STEP * self.model.dt
        ):  # soon said
            self.clock, seams = (
                replace(self.clock, samples=known + 1, last=float(time[0])),
                np.zeros(0, np.int64),
            )
        else:
            self.clock, seams = tick(replace(self.clock, last=before), time)
        if self.reader.is_text:
            self.texts = [self.texts[0] if self.texts else written[0].as_py(), written[-1].as_py()]
        starts = seams - known
        for k in starts[:20]:
            step = time[k] - (time[k - 1] if k else before)
            self.complain(
                "seam",
                f"line {kept[k][0]} comes {step:.6g} s after the sample before it, not dt = "
                f"{self.model.dt:g} s: "
                "windows across are MISSING",
            )
        if self.broken:
            starts, self.broken = np.union1d(starts, [0]), False
        if excluded is not None:
            edges = np.flatnonzero(np.diff(excluded.astype(np.int8), prepend=np.int8(self.aside)))
            starts, self.aside = np.union1d(starts, edges), bool(excluded[-1])
        return Piece(time, written, u, y, starts, excluded)

    def _times(self, cells, count):
        """Return (time (N,) in s; as datetime64 or None; as written; time of the sample before as seconds of
        the same count).
        """
        import pyarrow as pa

        if cells is None:
            time = (self.clock.samples + np.arange(count)) * self.model.dt
            return time, None, time, (self.clock.samples - 1) * self.model.dt
        if self.reader.is_text:
            known = self.texts
            if cells.null_count:
                raise ValueError("has no time")
            time, stamps, hint = parse_stamps(
                pa.concat_arrays([pa.array(known, pa.string()), cells]), self.model.dt, lambda k: ""
            )
            if hint and not known:
                self.complain("hint", hint)
            own = slice(len(known), None)
            return time[own], None if stamps is None else stamps[own], cells, time[1] if known else np.nan
        if np.isnan(cells).any():
            raise ValueError("has no time")
        values = since_epoch(cells)
        if self.origin is None:
            self.origin = float(values[0])
            self.scale = next((scale for scale in EPOCHS if 1e9 * scale <= self.origin < 5e9 * scale), None)
        if self.scale is None:
            return values, None, cells, self.clock.last
        stamps = np.round(values * (1e9 / self.scale)).astype("int64").astype("datetime64[ns]")
        return (values - self.origin) / self.scale, stamps, cells, self.clock.last


def _concatenated(pieces):
    """Return Pieces that follow each other as one."""
    import pyarrow as pa

    first = np.cumsum([0, *(len(p.time) for p in pieces)])
    join = lambda i: np.concatenate([p[i] for p in pieces])
    starts = np.concatenate([p.starts + at for p, at in zip(pieces, first, strict=False)])
    texts = isinstance(pieces[0].written, pa.Array)
    written = pa.concat_arrays([p.written for p in pieces]) if texts else join(1)
    return Piece(join(0), written, join(2), join(3), starts, None if pieces[0].excluded is None else join(5))
