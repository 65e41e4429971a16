"""The command `jaxbound detect MODEL.toml -`: verdicts on lines of CSV as they come through a pipe.

What is there is read, judged as one burst and printed: one sample where the sender is slow, thousands where
it is ahead.
"""

import csv
import io
import json
import os
import select
import signal
import stat
import sys
import threading
import time
from collections.abc import Iterable
from contextlib import contextmanager, nullcontext
from pathlib import Path

import jax
import numpy as np

from jaxbound.cli.options import MethodOptions
from jaxbound.cli.terminal import ENDS, door, nobody_reads, say, system_trouble, usable_device
from jaxbound.cli.window import window_relations
from jaxbound.consistency.monitor import Monitor
from jaxbound.diagnosis.alarms import ENDINGS, NO_DATA, OTHER, endings, forgets_after
from jaxbound.diagnosis.hints import bound_hints, outgrown, unfit
from jaxbound.diagnosis.result import suspected
from jaxbound.files.checkpoint import as_texts, from_texts
from jaxbound.models.modelfile import load_model
from jaxbound.recordings.columns import is_plain, to_arrow, words, write_rows
from jaxbound.recordings.linetext import FEW
from jaxbound.recordings.pipetext import PipeText
from jaxbound.recordings.seams import irregular, seam_hints
from jaxbound.relations.identity import identity
from jaxbound.relations.sentence import latched, remembers
from jaxbound.runs.endings import endings_said
from jaxbound.runs.journal import STATE, VERDICTS, Journal
from jaxbound.runs.outputs import output_folder, refuse_targets
from jaxbound.runs.refusals import Refused
from jaxbound.runs.sink import Outcome, file_names, write_all
from jaxbound.runs.summary import Evidence, Summary, Window, said, unsaid
from jaxbound.sets.floats.status import Status

__all__ = ["follow", "judge_input"]

AT_ONCE = 1 << 18  # bytes read at once
PIPE = 1 << 20  # bytes that the pipe should hold
NAMES, FAULT = [x.name for x in Status], int(Status.FAULT)
TALKATIVE, QUIET = 20, 60.0  # sentences of a kind at first, then one in so many seconds


def judge_input(
    model: Path,
    options: MethodOptions,
    *,
    out: Path | None = None,
    state: Path | None = None,
    min_coverage: float = 0.5,
    as_json: bool = False,
) -> int:
    """Judge the lines of standard input, see `follow`; return the exit code."""
    with door(OSError):
        whole = stat.S_ISREG(os.fstat(0).st_mode)
    with _signals() as (stopped, woken):
        chunks = _chunks(0, stopped, woken)
        return follow(
            model, chunks, whole, options, out=out, state=state, min_coverage=min_coverage, as_json=as_json
        )


def follow(
    model: Path | str,
    chunks: Iterable[bytes | None],
    whole: bool = True,
    options: MethodOptions | None = None,
    *,
    out: Path | None = None,
    state: Path | None = None,
    min_coverage: float = 0.5,
    as_json: bool = False,
) -> int:
    """Judge bytes as they come; return the exit code.

    Args:
        model: path of the model file. chunks: iterable of bytes; None in it ends the run as a signal does.
        whole: the last line is complete without a line end, as in a file; in a pipe half of a number may be.
        options: of the test. out: folder of the verdicts; state: file to go on from; None: none.
        min_coverage: least share of decided windows. as_json: verdicts as JSON, else as CSV.

    Raises:
        Refused: a model, a header, a sampling period or a state that does not fit, a method without a
            Monitor.
    """
    options = options or MethodOptions()
    with door(), _place(model, out, state) as folder:
        stated = load_model(model)
        tested, relations = window_relations(stated, options, model, None, lambda stage, share: None)
        if not relations.searched:  # strips: sooner done than handed to another thread
            jax.config.update("jax_cpu_enable_async_dispatch", False)
        usable_device()
        monitor = Monitor(relations, options.method)
        with Journal(out, state, identity(relations, method=options.method)) as journal:
            if folder is not None:
                folder.claim(VERDICTS, STATE)
            run = _Run(monitor, journal, stated, out is not None, min_coverage, as_json)
            found = run.to_the_end(chunks, whole)
        if folder is not None:
            about = tested, Path("-"), None, options.method, relations.horizon, options.observer_options
            with folder.work() as work:
                write_all(work, Outcome(None, None, [], found, *about))
    return found.exit_code


@contextmanager
def _place(model, out, state):
    """Make --out a folder whose verdicts this command may write, and see to it that nothing that is read is
    written.
    """
    inputs = [Path(model), *([Path("/dev/stdin")] if stat.S_ISREG(os.fstat(0).st_mode) else [])]
    with nullcontext() if out is None else output_folder(out, file_names(whole=False), inputs) as folder:
        if state is not None:
            refuse_targets({"--state": Path(state)}, inputs, force=True)
        if folder is None:
            yield None
            return
        journal = out / STATE if state is None else Path(state)
        if os.path.realpath(journal) == os.path.realpath(out / VERDICTS):
            raise Refused(f"--state {journal} is where the verdicts are written: give another name")
        folder.check(
            (VERDICTS, STATE), foreign=not journal.exists()
        )  # a state tells whether the verdicts are its own
        yield folder
        folder.settle(VERDICTS, STATE)


class _Run:
    """One run: what it counts, says and remembers."""

    def __init__(self, monitor, journal, stated, is_written, min_coverage, as_json):
        self.hints, self.outgrown = (
            bound_hints(stated, monitor.relations),
            bool(outgrown(stated, monitor.relations)),
        )
        before = journal.before or {}
        self.monitor, self.journal, self.spoken = monitor, journal, {}
        self.is_written, self.min_coverage, self.as_json = is_written, min_coverage, as_json
        self.header = b"" if as_json else b"time,status,margin\n"
        self.text = PipeText(monitor.relations.model, self.complain, before.get("text"))
        empty = monitor.init()
        self.state = from_texts(empty, before["state"]) if before else empty
        self.horizon = forgets_after(monitor.relations)
        counts = dict.fromkeys(NAMES, 0)
        nothing = {
            "counts": counts,
            "aside": 0,
            "recent": [],
            "left out": 0,
            "first": None,
            "worst": None,
            "last": None,
        }
        self.found = before.get("found", nothing | {"on": 0, "on before": 0, "endings": {}})

    def to_the_end(self, chunks, whole):
        m = self.monitor.relations.model
        window = self.monitor.relations.horizon + 1
        self.monitor.run(
            self.monitor.init(), np.zeros((window, m.m)), np.zeros((window, m.p))
        )  # compiled before a sample waits for it
        if self.journal.before is not None:
            say(
                f"going on after {self.text.clock.samples} samples, the last at "
                f"{self._label(self.found['last'])}"
            )
            self.emit(self._printed(self.journal.pending))
        ended, data = True, b""
        for data in chunks:
            if data is None:
                ended = False
                break
            self.burst(self.text.take(data))
        if ended and whole:
            self.burst(self.text.take(b"", end=True))
        elif ended and self.text.tail.strip():
            self.complain("line", "the last line has no end: it is not judged")
        if ended:
            self.text.end()
        return self.conclude()

    def _label(self, when):
        return when if isinstance(when, str) or when is None else self.text.label(when)

    def burst(self, piece):
        """Judge samples, remember them, write and print their verdicts."""
        rows = b""
        if piece is not None:
            self.state, verdict = self.monitor.run(self.state, piece.u, piece.y, starts=piece.starts)
            self._count(piece, verdict)
            rows = _rows(piece.written, verdict)
        if self.text.reader is not None and not self.text.skip:  # what is sent again is remembered already
            self.journal.add(self.memory(), rows)
        self.emit(self._printed(rows))

    def memory(self):
        """Return what another process needs to go on, fit for JSON."""
        return {"text": self.text.memory(), "state": as_texts(self.state), "found": self.found}

    def _count(self, piece, verdict):
        found, status, s = self.found, verdict.status, self.monitor.relations.horizon
        for name, n in zip(NAMES, np.bincount(status, minlength=len(NAMES)).tolist(), strict=True):
            found["counts"][name] += n
        if piece.excluded is not None:
            reach = np.concatenate([np.array(found["recent"], bool), piece.excluded])
            before, ends = np.cumsum(np.append(0, reach)), np.arange(len(found["recent"]), len(reach))
            warm = max(s - self.text.clock.samples + len(status), 0)  # of these windows are none
            found["aside"] += int(
                np.count_nonzero((before[ends + 1] > before[np.maximum(ends - s, 0)])[warm:])
            )
            found["recent"] = reach[len(reach) - min(s, len(reach)) :].tolist()
        text = self.text.reader.is_text
        when = lambda k: piece.written[k].as_py().strip() if text else float(piece.time[k])
        found["last"] = when(len(status) - 1)
        found["on before"] = found["on"]
        for code in status.tolist() if found["on"] or (status == FAULT).any() else ():
            found["on"], ended = _followed(found["on"], code, self.horizon)
            found["endings"] |= {ended: found["endings"].get(ended, 0) + 1} if ended else {}
        fault = np.flatnonzero(status == FAULT)
        if len(fault):
            worst = int(fault[np.argmin(np.nan_to_num(verdict.margin[fault], nan=0.0))])
            found["first"] = when(int(fault[0])) if found["first"] is None else found["first"]
            if found["worst"] is None or verdict.margin[worst] < found["worst"][1]:
                found["worst"] = [
                    when(worst),
                    float(verdict.margin[worst]),
                    self.text.clock.samples - len(status) + worst,
                ]

    def _printed(self, rows):
        """Return rows of verdicts.csv as they go to stdout."""
        if not self.as_json or not rows:
            return rows.replace(b",true\n", b"\n").replace(b",false\n", b"\n")
        number = lambda x: float(x) if x else None
        when = str if self.text.reader.is_text else number
        on, out = self.found["on before"], []
        for t, status, margin, _ in csv.reader(io.StringIO(rows.decode())):
            on, ended = _followed(on, Status[status], self.horizon)
            out.append(
                json.dumps({"time": when(t), "status": status, "margin": number(margin), "ended": ended})
                + "\n"
            )
        return "".join(out).encode()

    def emit(self, data):
        """Print, with the header before the first; where a reader has gone away, go on only if the verdicts
        are written elsewhere too.
        """
        if not data:
            return
        data, self.header = self.header + data, b""
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
            if not self.is_written:
                raise KeyboardInterrupt("nobody reads the verdicts any more: stopped") from None

    def complain(self, kind, sentence):
        """Say a sentence, unless many of its kind were said a moment ago."""
        count, last, silent = self.spoken.get(kind, (0, 0.0, 0))
        self.found["left out"] += kind == "line"
        if count >= TALKATIVE and time.monotonic() - last < QUIET:
            self.spoken[kind] = count, last, silent + 1
            return
        more = f" ({silent} more like it before)" if silent else ""
        say(sentence + more + ("; of more like it, one a minute is shown" if count == TALKATIVE - 1 else ""))
        self.spoken[kind] = count + 1, time.monotonic(), 0

    def conclude(self):
        """Say what was found and return its Summary."""
        found, clock, relations = self.found, self.text.clock, self.monitor.relations
        if self.text.reader is not None:
            self.journal.finish(self.memory())
        where, counted = (lambda k: f"sample {k}"), (lambda k: "counted from 0")
        hints = [*seam_hints(clock, counted, where), irregular(clock, counted, where), *self.hints]
        lost = found["left out"]
        hints.append(
            f"{lost} line{'s' * (lost != 1)} could not be read: left out, and no window spans them"
            if lost
            else ""
        )
        counts, observes = found["counts"], remembers(relations)
        at, margin, sample = found["worst"] or (None, np.nan, -1)
        if not latched(relations):
            hints += unfit(counts, np.nan if observes else margin, "samples" if observes else "windows")
        alarms = sum(found["endings"].values()) + bool(found["on"])
        every = filter(None, (*hints, *endings_said(found["endings"], alarms)))
        numbers = Evidence(
            self.monitor.method,
            relations.horizon,
            clock.samples,
            counts,
            found["aside"],
            at,
            margin,
            None,
            alarms,
            found["endings"],
            remembers=observes,
            outgrown=self.outgrown,
        )
        verdict, sentence = said(numbers, self._label, self.min_coverage)
        said_of_it = unsaid(every, sentence)
        for hint in said_of_it:
            say(hint)
        say(
            f"{sentence} {clock.samples} samples: "
            f"{', '.join(f'{n} {name}' for name, n in counts.items() if n)}"
        )
        worst = None if at is None else Window(sample, self._label(at), margin)
        return Summary(verdict, sentence, numbers, worst, hints=said_of_it, model=relations.model.name)


def _followed(on, status, horizon):
    """Return (FAULT windows in a row up to this one, why the alarm that they were is over, None if none ended
    here).
    """
    if status == FAULT:
        return on + 1, None
    after = np.array([NO_DATA if status == Status.MISSING else OTHER])
    return 0, ENDINGS[endings(0, on - 1, after, horizon)[0]] if on else None


def _rows(written, verdict):
    """Return rows of verdicts.csv as `write_verdicts` writes them."""
    import pyarrow as pa

    texts = isinstance(written, pa.Array)
    if len(written) <= FEW and (not texts or is_plain(written)):  # by hand, which is sooner done
        times = written.to_pylist() if texts else map(_number, written.tolist())
        return "".join(
            f"{when},{NAMES[status]},{_number(margin)},"
            f"{'true' if status == FAULT or margin < 0 else 'false'}\n"
            for when, status, margin in zip(
                times, verdict.status.tolist(), verdict.margin.tolist(), strict=True
            )
        ).encode()
    columns = {
        "time": written if texts else to_arrow(written),
        "status": words(NAMES, verdict.status),
        "margin": to_arrow(verdict.margin),
    }
    sink = pa.BufferOutputStream()
    write_rows(sink, columns | {"suspect": to_arrow(suspected(verdict.status, verdict.margin))})
    return sink.getvalue().to_pybytes()


def _number(x):
    """Return a float as pyarrow writes it, NaN as nothing."""
    if x != x:
        return ""
    if x == 0 or 1e-4 <= abs(x) < 1e9:
        return repr(x).removesuffix(".0")
    import pyarrow as pa

    return pa.array([x]).cast(pa.string())[0].as_py()


def _chunks(fd, stopped, woken):
    """Yield what can be read, as soon as something can; None, at the end, if a signal ended it."""
    try:
        import fcntl

        fcntl.fcntl(fd, fcntl.F_SETPIPE_SZ, PIPE)
    except (ImportError, AttributeError, OSError):  # no pipe, or none that can grow: the usual 64 kB will do
        pass
    while True:
        ready, _, _ = select.select([fd, woken], [], [])
        if stopped.is_set():
            yield None
            return
        if fd in ready:
            data = os.read(fd, AT_ONCE)
            if not data:
                return
            yield data


@contextmanager
def _signals():
    """Give (an event that SIGINT, SIGTERM and SIGHUP set, a file descriptor that can be read then): nothing
    is interrupted half-way.
    """
    stopped, (woken, waker) = threading.Event(), os.pipe()
    os.set_blocking(waker, False)
    ends = [n for n in ENDS if signal.getsignal(n) != signal.SIG_IGN]  # nohup
    before = {n: signal.signal(n, lambda *_: stopped.set()) for n in (signal.SIGINT, *ends)}
    previous = signal.set_wakeup_fd(waker)
    try:
        yield stopped, woken
    finally:
        signal.set_wakeup_fd(previous)
        for n, handler in before.items():
            signal.signal(n, handler)
        os.close(woken)
        os.close(waker)
