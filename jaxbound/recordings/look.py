"""A look at a recording before there is a model: what was read, what its columns hold, and how to go on."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxbound.recordings.hints import recorded_step
from jaxbound.recordings.otherunits import other_units
from jaxbound.recordings.read import kind_of, open_source
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.recordingformat import (
    NAMED_SIGNS,
    RECORDING,
    RecordingFormat,
    Stated,
    format_of,
    with_format,
)
from jaxbound.recordings.seams import Clock, seam_hints, tick, usual_period, varied_interval, varied_steps
from jaxbound.recordings.selection import time_column
from jaxbound.recordings.signals import Signals
from jaxbound.recordings.source import NUMBER, TEXT, WORDS
from jaxbound.recordings.stillness import Runs, follow_runs, signal_hints, stretches
from jaxbound.recordings.suspects import suspicions
from jaxbound.text.names import listed
from jaxbound.text.objects import readable
from jaxbound.text.progress import Progress, reporter
from jaxbound.text.units import without_unit

MOST = 1_000_000  # samples that are looked at of a recording that is read in pieces
ENOUGH = 1 << 28  # bytes that are looked at of what comes out of a pipe
BINS = 600  # of a picture
FEW_WORDS = 20  # that stand for missing samples
SET = 0.2  # share of steps up to which a column that is set by somebody changes
GIVEN = re.compile(
    r"set.?point|\bsp\b|command|\bcmd\b|control.signal|demand|valve|damper|outdoor|outside|ambient|weather"
    r"|solar",
    re.IGNORECASE,
)
"""Names of what the plant is told, and of what surrounds it: what it does changes neither."""
SHOWN, NAMED = 40, 12  # columns of the table, names of the command, that are shown at most
USUAL = {"header": 1, "delimiter": ",", "decimal": ".", "encoding": "utf-8"}
WIDE = 26  # letters of a name in the table


class Finding(NamedTuple):
    """A doubt about a column. Fields: mark: it in a word, for a table; sentence."""

    mark: str
    sentence: str


@dataclass(frozen=True, eq=False)
class LookedColumn:
    """One column of a recording that was looked at.

    Fields:
        name; unit: as the name says it, "" where it says none. kind: "number", "text", which is no signal, or
            "unread", which `findings` explain.
        low, high: its range, NaN where there is none. resolution: the step that all numbers are multiples of,
            0: none was found. missing: how many samples are.
        changes: share of the steps that change it. findings: see `Finding`.
        curve: (2, B) lowest and highest number of each bin of samples, for a picture.
    """

    name: str
    kind: str
    unit: str = ""
    low: float = np.nan
    high: float = np.nan
    resolution: float = 0.0
    missing: int = 0
    changes: float = 0.0
    findings: tuple[Finding, ...] = ()
    curve: np.ndarray | None = None

    @property
    def entry(self) -> str:
        """The column as --inputs and --outputs take it, "" where it is no signal: as what it is suspected."""
        if self.kind != NUMBER or not self.changes:
            return ""
        for finding in self.findings:
            if finding.mark == "count?":
                return ""
            if finding.mark in ("angle?", "counter?"):
                return finding.sentence.split('"')[1]
        if set(self.name) & set(",="):
            return f"`{self.name}`"
        return self.name

    def cells(self, wide: int) -> tuple[str, str, str, str]:
        """Return its name, of so many letters at most, its range, its step and remarks."""
        name, span, step = self.name, "", ""
        if len(name) > wide:  # names of one plant begin alike
            name = f"{name[:8]}...{name[11 - wide :]}"
        if self.kind == NUMBER and np.isfinite(self.low):
            span = f"{self.low:.5g} .. {self.high:.5g}"
        if self.resolution:
            step = f"{self.resolution:.4g}"
        remarks: list[str] = []
        if self.missing:
            remarks.append(f"{self.missing} missing")
        if self.kind == TEXT:
            remarks.append(TEXT)
        return name, span, step, ", ".join([*remarks, *self.marks])

    @property
    def marks(self) -> list[str]:
        """The marks of its findings, each once."""
        return list(dict.fromkeys(finding.mark for finding in self.findings))

    def plain(self) -> dict[str, Any]:
        """Return the fields as JSON has them."""
        fields = vars(self) | {"findings": [finding._asdict() for finding in self.findings]}
        del fields["curve"]
        return fields


@readable
@dataclass(frozen=True, eq=False)
class Look:
    """A recording as `look` found it; `plot` draws a picture of each column.

    Fields:
        source: name of the file. how: it is written, in words. time: the column of the time, None: there is
            none.
        samples: how many were looked at. first, last: the times of the first and the last as they stand
            there. dt: sampling period in s that the times show, None: they show none.
        columns: a LookedColumn each, without the time. hints: sentences on rows that were left out, gaps and
            the like.
        table: the `[recording]` table of a model file that reads a file like this one the same way, "" where
            none is needed.
        command: to go on with. axis: (B,) time of the bins of the curves, in s or datetime64.
    """

    source: str
    how: str
    time: str | None
    samples: int
    first: str
    last: str
    dt: float | None
    columns: tuple[LookedColumn, ...]
    hints: tuple[str, ...]
    table: str
    command: str
    axis: np.ndarray

    @property
    def headline(self) -> str:
        """The name of the file and its extent, in one line."""
        return f"{self.source}: {self.extent}"

    @property
    def extent(self) -> str:
        """The numbers of samples and of columns, in words."""
        kinds = [column.kind for column in self.columns]
        count = kinds.count(NUMBER)
        return f"{self.samples} samples of {count} column{'s' * (count != 1)} of numbers"

    @property
    def findings(self) -> list[Finding]:
        """The doubts about all columns."""
        return list(chain.from_iterable(column.findings for column in self.columns))

    def rows(self) -> Iterator[tuple[str, str]]:
        """Yield (name, text): how it was read, its times, what should be asked, and how to go on."""
        yield "read as", self.how
        apart = "whose steps show no sampling period"
        if self.dt is not None:
            apart = f"{self.dt:g} s apart"
        clock = "no column of times: samples are counted"
        if self.time is not None:
            clock = f"{self.first} to {self.last}, {apart} (column {self.time!r})"
        yield "time", clock
        for hint in self.hints:
            yield "recording", hint
        findings = self.findings
        for finding in findings[:SHOWN]:
            yield "column", finding.sentence
        if len(findings) > SHOWN:
            yield "", f"{len(findings) - SHOWN} sentences more: --json has all"
        yield "go on", self.command

    def cells(self, wide: int = WIDE) -> Iterator[Sequence[str]]:
        """Yield rows of cells, a column of the recording each, their names first; names of so many letters at
        most.
        """
        yield "column", "range", "step", "remarks"
        for column in self.columns[:SHOWN]:
            yield column.cells(wide)
        if len(self.columns) > SHOWN:
            yield f"... {len(self.columns) - SHOWN} more", "", "", ""

    def plain(self) -> dict[str, Any]:
        """Return the look as JSON has it."""
        fields = vars(self) | {"columns": [column.plain() for column in self.columns]}
        del fields["axis"]
        return fields

    def _head(self) -> str:
        return f"Look at {self.headline}"

    def _rows(self) -> dict[str, str]:
        rows: dict[str, str] = {}
        for name, text in self.rows():
            before = rows.get(name, "")
            rows[name] = f"{before}; {text}".removeprefix("; ")
        return rows


def look(
    data: object, *, recording: Stated = None, dt: float | None = None, progress: Progress | None = None
) -> Look:
    r"""Look at a recording before there is a model: how it is written, its times, and what each column holds.

    Nothing is refused that a sentence can tell: columns that cannot be read are listed with the reason. What
    stands still, may stand for a missing sample, or is no level (an angle, a counter) is named. Which columns
    are inputs only you know: the command takes those that change rarely for some, and those that are named as
    commands, valves or weather are.

    Args:
        data: a path, as `read` takes it, "-" for standard input, or a table. recording: how the file is
            written, as for `read`. dt: sampling period in s, for a recording without times. progress: called
            with the share of the work done.

    Returns:
        A Look, which `plot` draws.

    Raises:
        OSError: no such file. ValueError: no column can be read, and why.

    Example:
        >>> import tempfile, pathlib, jaxbound as jb
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "run.csv"
        >>> rows = [f"{3 * k},{k // 30},{(350 + k) % 360},{k % 7}.5" for k in range(60)]
        >>> _ = path.write_text("\n".join(["time,heater,wind,T [degC]", *rows, ""]))
        >>> found = jb.look(path)
        >>> found.dt, [column.unit for column in found.columns], found.columns[1].findings[0].mark
        (3.0, ['', '', 'degC'], 'angle?')
        >>> found.command.partition(" --inputs ")[2]
        "heater --outputs 'wind=angle(wind),T [degC]' --out plant.toml"
    """
    with kind_of(data).kept(data, ENOUGH) as kept:
        found = _look(kept, recording, dt, progress)
        if kept is data:
            return found
        hints = found.hints
        if Path(str(kept)).stat().st_size == ENOUGH:
            hints = (f"{ENOUGH >> 20} MiB came and it had not ended: only these are shown", *hints)
    name = {"-": "standard input"}.get(str(data), Path(str(data)).name)
    return replace(found, source=name, hints=hints, command=found.command.replace(str(kept), "FILE"))


def _look(data: object, recording: Stated, dt: float | None, progress: Progress | None) -> Look:
    """Return a look at data that can be read more than once."""
    report = reporter(progress, "read")
    stated = with_format({}, recording)
    outline = kind_of(data).outline(data, RecordingFormat.of(stated.get(RECORDING)))
    kinds = dict(outline.kinds)
    times = {name: {NUMBER: "", TEXT: "", WORDS: ""}.get(kind, kind) for name, kind in kinds.items()}
    day, clock = time_column(list(kinds), list(kinds), stated.get("time"), times.__getitem__, dt)
    for name in (day, clock):
        kinds.pop(str(name), None)
    door = _Door(data, stated, dt, clock is not None)
    names = [name for name, kind in kinds.items() if kind != TEXT]
    run, troubles = door.readable(names)
    words: dict[str, Sequence[str]] = {}
    for name, error in troubles.items():
        if kinds[name] == NUMBER and _words(error):
            words[name] = _words(error)
    if words:  # in few cells: they stand for missing samples, for all that anybody knows
        missing = [*format_of(door).missing, *chain.from_iterable(words.values())]
        door = door._replace(columns=with_format(stated, {"missing": missing}))
        run, troubles = door.readable(names)
    report(0.7)
    columns: list[LookedColumn] = []
    for name, kind in kinds.items():
        if name in run.outputs:
            columns.append(_looked(name, run, words.get(name, ())))
        elif name in troubles and name and kind != WORDS:
            sentence = str(troubles[name]).removeprefix(f"{data}: ")
            columns.append(LookedColumn(name, "unread", findings=(Finding("not read", sentence),)))
        elif name:
            columns.append(LookedColumn(name, TEXT))
    for name, sentence in other_units(run.outputs, run.y):
        i = [column.name for column in columns].index(name)
        columns[i] = replace(columns[i], findings=(*columns[i].findings, Finding("unit?", sentence)))
    period, hints, every = _clock_of(run, clock is not None)
    if clock is not None and period is None:
        hints = (*hints, *_row_a_tag(columns))
    axis = run.axis
    assert axis is not None, "a recording that is read has times"
    return Look(
        source=run.source,
        how=outline.how,
        time=clock,
        samples=run.samples,
        first=run.label(0),
        last=run.label(run.samples - 1),
        dt=period,
        columns=tuple(columns),
        hints=hints,
        table=_table(dict(outline.taken) | format_of(door).stated, clock),
        command=_command(door, columns, every),
        axis=axis[_edges(run.samples)],
    )


def _row_a_tag(columns: Sequence[LookedColumn]) -> Iterator[str]:
    """Yield a sentence where times repeat and one column holds words, one numbers: a row may be of a tag."""
    names: dict[str, list[str]] = {NUMBER: [], TEXT: [], "unread": []}
    for column in columns:
        names[column.kind].append(column.name)
    if len(names[NUMBER]) == len(names[TEXT]) == 1:
        pair = f"{names[TEXT][0]},{names[NUMBER][0]}"
        yield f"if a row is of one tag, look at it again with --long {pair}"


def _table(taken: Mapping[str, Any], clock: str | None) -> str:
    """Return the table `[recording]` of a model file that states what was taken, as far as it is not usual.
    clock: the column of the time, None: there is none.
    """
    lines = [RECORDING]
    for name, value in (*taken.items(), ("time", clock)):
        if value != USUAL.get(name):
            lines.append(f"{name} = {json.dumps(value, ensure_ascii=False)}")
    if len(lines) == 1:
        return ""
    return "\n".join(lines)


def _edges(samples: int) -> np.ndarray:
    """Return the first sample of each bin of a picture."""
    return np.unique(np.linspace(0, samples, BINS, endpoint=False).astype(int))


class _Door(NamedTuple):
    """The door of a recording. Fields: data; columns: of signals, with what is stated of how it is written;
    dt: as `look` takes it; timed: whether there is a column of times.
    """

    data: object
    columns: Mapping[str, str]
    dt: float | None
    timed: bool

    def read(self, names: Sequence[str]) -> Recording:
        """Return the Recording of these columns, as outputs, whatever steps its times have."""
        dt = None
        if not self.timed:
            dt = self.dt or 1.0
        source = open_source(
            self.data, Signals((), tuple(names), dict(self.columns), dt, regular=not self.timed)
        )
        if source.parts:
            return source.read(0, min(source.samples or 0, MOST))
        return source.read()

    def readable(self, names: Sequence[str]) -> tuple[Recording, dict[str, ValueError]]:
        """Return (the Recording of the columns that can be read, {column: why it cannot} of the others).

        Raises:
            ValueError: none can be read.
        """
        troubles: dict[str, ValueError] = {}
        if not names:
            raise ValueError(f"{self.data}: no column of it begins with a number")
        try:
            return self.read(names), troubles
        except ValueError as e:
            self._find(names, e, troubles)
        left = list(names)
        for name in troubles:
            left.remove(name)
        if not left:
            raise next(iter(troubles.values()))
        return self.read(left), troubles

    def _find(self, names: Sequence[str], error: ValueError, troubles: dict[str, ValueError]) -> None:
        """Find the columns by halves that make reading fail with an error; keep why."""
        if len(names) == 1:
            troubles[names[0]] = error
            return
        middle = len(names) // 2
        failed: list[tuple[Sequence[str], ValueError]] = []
        for half in (names[:middle], names[middle:]):
            try:
                self.read(half)
            except ValueError as e:
                failed.append((half, e))
        if len(failed) == 2 and str(failed[0][1]) == str(failed[1][1]):  # of the file, not of a column
            raise error
        for half, why in failed:
            self._find(half, why, troubles)


def _words(error: ValueError) -> Sequence[str]:
    """Return the words that made reading fail, where they are few. What holds digits may be a number."""
    words: Sequence[str] = getattr(error.__context__, "words", ())
    if len(words) > FEW_WORDS or any(map(str.isdigit, "".join(words))):
        return ()
    return words


def _looked(name: str, recording: Recording, words: Sequence[str]) -> LookedColumn:
    """Return the look at a column of numbers, in which words stand for missing samples."""
    x = np.ascontiguousarray(recording.y[:, recording.outputs.index(name)], np.float64)
    there = x[np.isfinite(x)]
    unit = without_unit(name)[1]
    if not len(there):
        return LookedColumn(name, NUMBER, unit, missing=len(x))
    runs = follow_runs(Runs(), x)
    findings: list[Finding] = []
    if words:
        cells = f"{name} holds {listed(words)} in the place of numbers"
        stand = f"read as missing samples, by `missing` of {RECORDING}"
        findings.append(Finding("words", f"{cells}: {stand}"))
    marks = [stretch.kind for stretch in stretches(runs)]
    sentences = signal_hints(name, runs, recording.label)
    before = len(sentences) - len(marks)  # numbers that may stand for a missing sample are named first
    for mark, sentence in zip(["no number?"] * before + marks, sentences, strict=True):
        findings.append(Finding(mark, sentence))
    for kind, sentence in suspicions(without_unit(name)[0], name, x):
        findings.append(Finding(f"{kind}?", sentence))
    edges, changes = _edges(len(x)), 0.0
    if len(there) > 1:
        changes = float(np.mean(np.diff(there) != 0))
    curve = np.stack([np.fmin.reduceat(x, edges), np.fmax.reduceat(x, edges)])
    return LookedColumn(
        name,
        NUMBER,
        unit,
        float(there.min()),
        float(there.max()),
        recorded_step(x),
        len(x) - len(there),
        changes,
        tuple(findings),
        curve,
    )


def _clock_of(recording: Recording, timed: bool) -> tuple[float | None, tuple[str, ...], str]:
    """Return (sampling period in s or None, sentences on rows and gaps, the interval that serves, "" where
    none is needed).
    """
    hints = recording.hints
    if not timed:  # then all was asked while it was read; of columns it is said beside them
        return None, tuple(hint for hint in hints if hint.startswith("the ")), ""
    time = np.asarray(recording.time, float)
    try:
        period = usual_period(time)
    except ValueError as e:
        return None, (*hints, str(e)), ""
    clock, _ = tick(Clock(period), time)
    varied = varied_steps(time)
    if varied:
        return period, (*hints, varied), varied_interval(time)
    return period, (*hints, *seam_hints(clock, recording.label, "sample {}".format)), ""


def _command(door: _Door, columns: Sequence[LookedColumn], every: str) -> str:
    """Return the command that fits a model to a recording. every: interval of means that is needed, or ""."""
    entries: dict[str, list[str]] = {"--inputs": [], "--outputs": []}
    for column in columns:
        is_set = (column.changes <= SET or GIVEN.search(column.name)) and column.entry == column.name
        entries["--inputs" if is_set else "--outputs"].append(column.entry)
    if not any(entries["--outputs"]):
        entries = {"--outputs": entries["--inputs"]}
    words = ["jaxbound", "fit", "FILE"]
    if isinstance(door.data, str | PathLike):
        words[-1] = str(door.data)
    for option, wanted in entries.items():
        some = list(filter(None, wanted))
        if len(some) > NAMED:
            some[NAMED:] = ["..."]
        if some:
            words += [option, ",".join(some)]
    stated = dict(door.columns)
    if every:
        stated.setdefault("every", every)
    fields = RecordingFormat.of(stated.pop(RECORDING, None)).stated
    if fields:
        words += ["--recording", ",".join(f"{name}={_on_a_line(value)}" for name, value in fields.items())]
    for name, value in stated.items():
        words += [f"--{name}", value]
    if door.dt is not None:
        words += ["--dt", f"{door.dt:g}"]
    elif not door.timed:
        words += ["--dt", "SECONDS"]
    return shlex.join([*words, "--out", "plant.toml"])


def _on_a_line(value: object) -> str:
    """Return a field of a format as a command line takes it."""
    if isinstance(value, tuple):
        return ",".join(map(_on_a_line, value))
    return next((name for name, sign in NAMED_SIGNS.items() if sign == value), str(value))
