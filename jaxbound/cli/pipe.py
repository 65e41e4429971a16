"""The command `jaxbound detect` on a stream: verdicts on samples as they come, through a pipe or from a live
source.

What is there is read, judged as one burst and printed: one sample where the sender is slow, thousands where
it is ahead.
"""

import csv
import io
import json
import os
import stat
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import jax

from jaxbound.cli.signals import arrivals, ends
from jaxbound.cli.terminal import door, nobody_reads, say, system_trouble, usable_device
from jaxbound.cli.window import stated_model, window_relations
from jaxbound.consistency.interface import Relations
from jaxbound.consistency.monitor import Monitor
from jaxbound.consistency.searched import judging_device
from jaxbound.diagnosis.alarmrule import EVERY_FAULT, Stated, stated_rule
from jaxbound.diagnosis.hints import bound_hints, device_hints, outgrown, unfit_by
from jaxbound.diagnosis.severity import fitted
from jaxbound.files.locks import refuse_link
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.columns import Words, header_line, moments
from jaxbound.recordings.factors import known
from jaxbound.recordings.hints import missing_sentences
from jaxbound.recordings.live import LiveSource
from jaxbound.recordings.means import every_of, recorded_model
from jaxbound.recordings.meanstream import MeansStream
from jaxbound.recordings.pipetext import PipeText
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import irregular, seam_hints
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.stream import Stream, Taken
from jaxbound.relations.identity import identity
from jaxbound.runs.alarmbook import ALARMS, LiveAlarms, Notice
from jaxbound.runs.ask import Ask
from jaxbound.runs.counts import Tally
from jaxbound.runs.endings import endings_said
from jaxbound.runs.journal import STATE, Journal, LiveCheckpoint, refuse_former_state
from jaxbound.runs.judges import Live
from jaxbound.runs.loop import Memory, follow
from jaxbound.runs.outputs import OutputFolder, output_folder, refuse_targets
from jaxbound.runs.refusals import Refused
from jaxbound.runs.rows import VERDICTS, RowFile, RowText
from jaxbound.runs.sink import Outcome, Sink, Verdicts
from jaxbound.runs.sinks import close_all, file_names, open_sinks
from jaxbound.runs.summary import Evidence, Summary, Window, rests_on_outgrown, said, unsaid
from jaxbound.text.quantities import finite

STDIN = "-"
RULE = "rule of alarms"
RULED = "alarms", "rule"  # the name of alarms in a checkpoint: of every FAULT, or by a rule that is asked for
BY_VALUE = {"way to know samples that are sent again": "by time and values"}
OTHER_RULE = f"{{}} is of a {RULE}: give it again, choose another place, or delete it to begin anew"
TALKATIVE, QUIET = 20, 60.0  # sentences of a kind at first, then one in so many seconds


@dataclass(frozen=True)
class LiveRun:
    """Samples that are to be judged as they come.

    Fields:
        model: path of the model file. ask: the test. recording: see `options.reading`. data: "-", or
            the name of a live source.
        out: folder of the verdicts; state: file to go on from; None: none.
        min_coverage: least share of decided windows. json: whether verdicts are JSON, else CSV.
        alarm: the rule by which alarms are told; None: that of the model, or none are.
    """

    model: Path | str
    ask: Ask = Ask()
    recording: Mapping[str, str] | None = None
    data: str = STDIN
    out: Path | None = None
    state: Path | None = None
    min_coverage: float = 0.5
    json: bool = False
    alarm: Stated = None

    @property
    def files(self) -> list[str]:
        """The files in the folder."""
        if self.alarm is None:
            return [VERDICTS, STATE]
        return [VERDICTS, STATE, ALARMS]

    @property
    def state_path(self) -> Path | None:
        """The path of the checkpoint, None where none is kept."""
        if self.state is not None:
            return Path(self.state)
        return self.out and Path(self.out) / STATE


def judge_stream(asked: LiveRun, chunks: Iterable[Any] | None = None) -> int:
    """Judge samples as they come; return the exit code.

    Args:
        chunks: what arrives, bytes of a pipe or readings of a live source; None in it ends the run as a
            signal does. None: what arrives at standard input, or at the live source, until a signal or its
            end.

    Raises:
        Refused: a model, a header, a sampling period or a state that does not fit, a method without a
            Monitor.
    """
    ask, path = asked.ask, asked.state_path
    with door(), ExitStack() as opened:
        end = None
        if chunks is None:
            end = opened.enter_context(ends())
        stated = stated_model(asked.model, asked.recording, ask)
        rule = None
        if asked.alarm or stated.alarms:
            rule = stated_rule(asked.alarm, stated, asked.model)
        job = replace(asked, alarm=rule)
        files, folder = job.files, opened.enter_context(_folder(job))
        tested, relations = window_relations(stated, ask, job.model, None, lambda stage, share: None)
        how = {"method": ask.method, "word outside training": ask.outside, **BY_VALUE}
        alarm = None
        if rule is not None:
            alarm = fitted(rule, relations)
            how[RULE] = json.dumps(alarm.plain(), sort_keys=True)
        if not relations.searched:  # strips: sooner done than handed to another thread
            # jax states no types of this function
            jax.config.update("jax_cpu_enable_async_dispatch", False)  # type: ignore[no-untyped-call]
        usable_device()
        judge = _live(relations, ask)
        journal = before = taken = None
        if path is not None:
            if job.state is None:
                refuse_link(path)
            journal = opened.enter_context(Journal(path, identity(relations, **how)))
            before, taken = journal.before, journal.taken
        if before is not None and alarm is None and RULED[True] in before["sinks"]:
            raise Refused(OTHER_RULE.format(path))
        work: Any = nullcontext()
        if folder is not None:
            if job.state is None:
                refuse_former_state(folder.path)
            # a state tells whether the verdicts are its own
            folder.check(files, foreign=before is None)
            work = folder.work()
        with work as place:
            stream = _stream(job.data, relations.model, _Complaints(), before and before["source"], taken)
            rule = alarm or EVERY_FAULT
            alarms = LiveAlarms(rule, relations, ask.method, stream.dt, stream.complain)
            lines = _PrintedLines(job.json, job.out is None, alarms, alarm is not None)
            run = opened.enter_context(_Judging(stated, stream, judge, journal, lines, job.out, place))
            run.resume()
            if folder is not None:
                folder.claim(*files)
            if end is not None:
                chunks = arrivals(stream.raw, end)
            summary = run.to_the_end(chunks or (), job.min_coverage)
            data = Path(job.data)
            outcome = Outcome([], summary, tested, data, None, ask, relations.horizon)
            close_all(run.outputs, outcome)
        if journal is not None:
            journal.close()
        if folder is not None:
            folder.settle(*files)
    return summary.exit_code


def _live(relations: Relations, ask: Ask) -> Live:
    """Return the judge of samples as they come."""
    if relations.remembers:
        return Live(Monitor(relations, ask.method), ask.outside)
    return Live(Monitor(relations, ask.method, outside=ask.outside), ask.outside)


def _is_file() -> bool:
    """Return whether standard input is a file."""
    with door(OSError):
        return stat.S_ISREG(os.fstat(0).st_mode)


def _stream(
    data: str,
    model: SignalModel,
    complaints: "_Complaints",
    memory: dict[str, Any] | None,
    taken: Taken | None,
) -> Stream:
    """Return the Stream of the data."""
    if every_of(model) is not None:
        before = memory and memory["reading"]
        reading = _stream(data, recorded_model(model), complaints, before, taken)
        return MeansStream(reading, model, memory)
    if LiveSource.takes(data):
        return LiveSource(data, model).stream(complaints, memory, taken)
    return PipeText(model, complaints, memory, taken)


@contextmanager
def _folder(asked: LiveRun) -> Iterator[OutputFolder | None]:
    """Make --out a folder that this command may write files into; refuse to write over anything that is
    read.
    """
    inputs = [Path(asked.model)]
    if _is_file():
        inputs.append(Path("/dev/stdin"))
    place: Any = nullcontext()
    if asked.out is not None:
        place = output_folder(asked.out, file_names(whole=False), inputs)
    with place as folder:
        path = asked.state_path
        if asked.state is not None:
            refuse_targets({"--state": Path(asked.state)}, inputs, force=True)
        if asked.out is not None and path is not None:
            for name, what in ((VERDICTS, "verdicts"), (ALARMS, "alarms")):
                if name in asked.files and os.path.realpath(path) == os.path.realpath(asked.out / name):
                    raise Refused(f"--state {path} is where the {what} are written: give another name")
            folder.check(asked.files, foreign=False)
        yield folder


class _Judging:
    """One run: its stream, judge, sinks and checkpoint."""

    def __init__(
        self,
        stated: LinearSystem,
        stream: Stream,
        judge: Live,
        journal: Journal | None,
        lines: "_PrintedLines",
        out: Path | None,
        place: Path | None,
    ) -> None:
        """Begin with nothing judged."""
        self.stream, self.judge, self.lines = stream, judge, lines
        relations = judge.monitor.relations
        self.hints = [*bound_hints(stated, relations), *device_hints(judging_device(relations.remembers))]
        self.outgrown = bool(outgrown(stated, relations))
        self.tally = Tally(relations, stream.when)
        self.alarms = lines.alarms
        self.file = self.alarm_file = None
        if out is not None and journal is not None:  # a folder has a state
            self.file = RowFile(out / VERDICTS, lines.text, journal.path)
            if lines.tells:
                self.alarm_file = RowFile(out / ALARMS, self.alarms, journal.path)
        self.outputs: list[Sink] = [] if place is None else open_sinks(place, whole=False)
        self.sinks = self._named_sinks()
        self.checkpoint = None
        if journal is not None:
            # what this judge remembers is a list of texts
            kept = cast(Any, judge)
            self.checkpoint = LiveCheckpoint(journal, stream, kept, self.sinks)
        self.resumed = journal is not None and journal.before is not None
        self.known = 0  # samples that a process before had judged

    def _named_sinks(self) -> Mapping[str, Any]:
        """Return {name in the checkpoint: sink}, in the order in which they hand on: a file before stdout."""
        named: dict[str, Any] = {"counts": self.tally, RULED[self.lines.tells]: self.alarms}
        if self.file is not None:
            named["file"] = self.file
        if self.alarm_file is not None:
            named["alarm file"] = self.alarm_file
        named["lines"] = self.lines
        for sink in self.outputs:
            named[f"{type(sink).__module__}.{type(sink).__qualname__}"] = sink
        return named

    def __enter__(self) -> "_Judging":
        return self

    def __exit__(self, *error: object) -> None:
        for file in (self.file, self.alarm_file):
            if file is not None:
                file.close()

    def resume(self) -> None:
        """Go on from the checkpoint, if there is one; refuse verdicts that are not those it speaks of."""
        if self.checkpoint is not None and self.resumed:
            self.checkpoint.resume()
            self.known = self.stream.clock.samples

    def to_the_end(self, chunks: Iterable[Any], min_coverage: float) -> Summary:
        """Judge everything that comes; return the Summary."""
        self.lines.begin(self.judge.compile())
        if self.resumed:
            behind = ""
            if self.tally.last is not None:
                behind = f", the last at {self.stream.label(cast('str | float', self.tally.last))}"
            say(f"going on after {self.stream.clock.samples} samples{behind}")
            self.lines.flush()
        for _ in follow(
            self.stream.pieces(iter(chunks)), self.judge, [*self.sinks.values()], self.checkpoint
        ):
            pass
        return self.conclude(min_coverage)

    def conclude(self, min_coverage: float) -> Summary:
        """Say the conclusion in words and return its Summary."""
        for file in (self.file, self.alarm_file):
            if file is not None:
                file.force()
        if self.checkpoint is not None:
            self.checkpoint.finish()
        alarms, endings = self.alarms.counted()
        if self.alarm_file is not None:
            self.alarm_file.end_with(self.alarms.written_rows(self.alarms.pending()))
        tally, clock, monitor = self.tally, self.stream.clock, self.judge.monitor
        numbers = tally.evidence(monitor.method, self.judge.outside, alarms, endings)
        numbers = replace(numbers, outgrown=self.outgrown and rests_on_outgrown(numbers.tests))
        worst = None
        if tally.worst is not None:
            worst = Window(tally.worst.sample, self.stream.label(tally.worst.when), numbers.margin)
        verdict, sentence = said(numbers, self.stream.label, min_coverage)
        hints = unsaid([hint for hint in self._hints(numbers) if hint], sentence)
        if self.resumed and clock.samples == self.known:
            verdict, sentence, hints = "too little evidence", self._nothing_new(), ()
        for hint in hints:
            say(hint)
        with_data = clock.samples - numbers.counts["MISSING"]
        if numbers.outside is not None and with_data:
            say(f"training: {numbers.outside.shown(with_data, numbers.remembers)}")
        some = ", ".join(f"{n} {name}" for name, n in numbers.counts.items() if n)
        say(f"{sentence} {clock.samples} samples: {some}")
        for name, test in (numbers.tests or {}).items():
            say(f"test {name}: {', '.join(f'{n} {status}' for status, n in test.counts.items() if n)}")
        return Summary(verdict, sentence, numbers, worst, hints=hints, model=monitor.relations.model.name)

    def _nothing_new(self) -> str:
        """Return the sentence of a run that judged nothing, behind one that did."""
        came = "nothing came"
        if self.stream.skipped:
            came = self.stream.skipped_text
        return f"Nothing new was judged, so nothing is concluded: {came}. Judged before:"

    def _hints(self, found: Evidence) -> list[str]:
        """Return sentences to check; some may be empty."""
        clock, relations = self.stream.clock, self.judge.monitor.relations
        where, counted = (lambda k: f"sample {k}"), (lambda k: "counted from 0")
        hints = [*seam_hints(clock, counted, where), irregular(clock, counted, where), *self.hints]
        model = relations.model
        missing = dict(zip((*known(model), *model.outputs), self.tally.missing, strict=False))
        hints += missing_sentences(model, missing, self.tally.looked_at)
        lost = self.stream.lost
        if lost:
            lines = f"{lost} line{'s' * (lost != 1)}"
            hints.append(f"{lines} could not be read: left out, and no window spans them")
        if self.stream.no_rows:
            hints.append(f"{self.stream.no_rows} lines hold no sample: left out")
        hints += unfit_by(relations, found.counts, found.margin, found.outside)
        return [*hints, *endings_said(found.ended or {}, found.alarms)]


class _PrintedLines:
    """Lines of verdicts on stdout, a sink.

    Args:
        as_json: as JSON, else as CSV. alone: the verdicts are written nowhere else. alarms: in the same loop,
            before this sink. tells: whether they are told behind the sample at which they are known, by a
            rule that is asked for; else JSON says where one ends.

    Fields: text: of the rows.
    """

    def __init__(self, as_json: bool, alone: bool, alarms: LiveAlarms, tells: bool) -> None:
        self.json, self.alone, self.alarms, self.tells = as_json, alone, alarms, tells
        self.text = RowText()
        self.notices: list[Notice] = []
        self.texts = False
        self.header = self.fresh = b""

    def begin(self, like: Verdicts) -> None:
        """Take the columns of the verdicts that come."""
        self.text.begin(like)
        if not self.json:
            self.header = header_line(self.text.names[:-1])  # suspect is not printed

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        """Take the rows of the next verdicts."""
        self.fresh = self.text.of(piece, verdicts)
        if self.json:
            # dates are written as text
            self.texts = str(moments(piece.column.slice(0, 0)).type) in ("string", "large_string")
        self.notices = self.alarms.notices

    def memory(self) -> Memory:
        """Return the rows and notices that may not be printed yet."""
        return {"rows": self.fresh.decode("latin-1"), "texts": self.texts, "notices": self.notices}

    def resume(self, memory: Any) -> None:
        """Take the rows of a process that was killed before it printed them for sure."""
        self.fresh, self.texts = memory["rows"].encode("latin-1"), memory["texts"]
        self.notices = memory["notices"]

    def flush(self) -> None:
        """Print the rows, with the header before the first.

        Where a reader has gone away, go on only if the verdicts are written elsewhere too.
        """
        if not self.fresh:
            return
        data, self.fresh = self.fresh, b""
        data, self.header = self.header + self._with_notices(self._printed(data)), b""
        try:
            if sys.stdout is None:
                raise BrokenPipeError("closed from the start")
            sys.stdout.flush()
            sys.stdout.buffer.write(data)
            sys.stdout.buffer.flush()
        except OSError as e:
            if sys.stdout is not None:
                nobody_reads()
            if not isinstance(e, BrokenPipeError):
                raise Refused(f"cannot write to standard output: {system_trouble(e)}") from e
            if self.alone:
                raise KeyboardInterrupt("nobody reads the verdicts any more: stopped") from None

    def _with_notices(self, printed: bytes) -> bytes:
        """Return lines with each notice behind the line of the sample at which it is known."""
        if not self.notices or not self.tells:
            return printed
        lines = printed.split(b"\n")[:-1]
        for row, notice in self.notices:
            lines[row] += b"\n" + self._notice(notice).encode()
        self.notices = []
        return b"\n".join([*lines, b""])

    def _notice(self, notice: dict[str, Any]) -> str:
        """Return the line of the begin or the end of an alarm."""
        if not self.json:
            return _in_a_sentence(notice)
        line = dict(notice)
        if not self.texts:
            line["time"] = _number(line["time"])
        if "depth" in line:
            line["depth"] = finite(line["depth"])
        return json.dumps(line)

    def _printed(self, rows: bytes) -> bytes:
        """Return rows of verdicts.csv as they go to stdout."""
        if not self.json:
            return rows.replace(b",true\n", b"\n").replace(b",false\n", b"\n")
        lines, ended = [], {}
        if not self.tells:  # else a line of its own says it
            ended = {number: notice.get("ended") for number, notice in self.notices}
        for number, cells in enumerate(csv.reader(io.StringIO(rows.decode()))):
            row = dict(zip(self.text.names, cells, strict=True))
            when, margin = row["time"], _number(row["margin"])
            time = when if self.texts else _number(when)
            line = {"time": time, "status": row["status"], "margin": margin, "ended": ended.get(number)}
            for name in self.text.names[3:-1]:
                if isinstance(self.text.columns[name], Words):
                    line[name] = row[name] or None
                else:
                    line[name] = _number(row[name])
            lines.append(json.dumps(line) + "\n")
        return "".join(lines).encode()


def _in_a_sentence(notice: dict[str, Any]) -> str:
    """Return a notice as a line between rows of CSV, which a reader of CSV takes for a comment."""
    words = f"# alarm {notice['number']} {notice['alarm']}s at {notice['time']}"
    for kind in ("suspect", "cause", "test"):
        if notice.get(kind):
            words += f", {kind} {notice[kind]}"
    if "ended" in notice:
        words += f": {notice['ended']}"
    return words


def _number(text: str) -> float | None:
    """Return the number in a cell, None of an empty one, or of an infinite one."""
    if not text:
        return None
    return finite(float(text))


class _Complaints:
    """Sentences on samples, as they come: many of a kind are counted, not said."""

    def __init__(self) -> None:
        self.spoken: dict[str, tuple[int, float, int]] = {}

    def __call__(self, kind: str, sentence: str) -> None:
        """Say a sentence, unless many of its kind were said a moment ago."""
        count, last, silent = self.spoken.get(kind, (0, 0.0, 0))
        if count >= TALKATIVE and time.monotonic() - last < QUIET:
            self.spoken[kind] = count, last, silent + 1
            return
        more = f" ({silent} more like it before)" if silent else ""
        rarely = "; of more like it, one a minute is shown" if count == TALKATIVE - 1 else ""
        say(sentence + more + rarely)
        self.spoken[kind] = count + 1, time.monotonic(), 0
