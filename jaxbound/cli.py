"""The command line: jaxbound demo | detect | info.

Exit codes: 0 no fault, 1 fault found, 2 bad input or usage, 3 too little evidence, 70 internal error, 130 interrupted. What the user did
wrong is one sentence on stderr; a report is written completely or not at all.
"""

import argparse
import gc
import json
import os
import shlex
import shutil
import sys
import tempfile
import threading
import time
import traceback
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import jax
import numpy as np

from jaxbound import __version__
from jaxbound.diagnosis.consistency import METHODS, detect
from jaxbound.files import read_recording, write_alarms, write_verdicts
from jaxbound.modelfile import load_model, save_model, template
from jaxbound.plots import distinct_relations
from jaxbound.relations.parity import parity_relations
from jaxbound.report import bound_hints, coverage, percent, summary, times, worst_window, write_report

__all__ = ["main"]

OK, FAULT, BAD_INPUT, TOO_LITTLE, INTERNAL, INTERRUPTED = 0, 1, 2, 3, 70, 130
CODES = {"no fault": OK, "fault": FAULT, "too little evidence": TOO_LITTLE}
COLOUR = {"no fault": "bold green", "fault": "bold red", "too little evidence": "bold yellow"}
PLANNED = ("explain", "fit", "tune", "study")
EPILOG = "exit codes: 0 no fault, 1 fault found, 2 bad input or usage, 3 too little evidence, 70 internal error, 130 interrupted"


class Refused(Exception):
    """What the user gave cannot be used; the message says why."""


class Parser(argparse.ArgumentParser):
    """Reports wrong usage in one sentence."""

    def error(self, message):
        """Raise Refused instead of printing the usage."""
        raise Refused(f"{message.removeprefix('argument ').replace(': ', ' ', message.startswith('argument '))}; see {self.prog} --help")


def main(argv=None):
    """Run one command.

    Args:
        argv: the arguments after the program's name; None: those of the process.

    Returns:
        The exit code.
    """
    try:
        args = _parse(sys.argv[1:] if argv is None else list(argv))
        _configure()
        gc.freeze()  # what is imported stays: the collector need not look through it again and again
        return args.run(args)
    except SystemExit as e:  # --help, --version
        return e.code if isinstance(e.code, int) else OK
    except Refused as e:
        _say(str(e))
        return BAD_INPUT
    except KeyboardInterrupt:
        _say("interrupted: nothing was written")
        return INTERRUPTED
    except Exception as e:
        with tempfile.NamedTemporaryFile("w", prefix="jaxbound-traceback-", suffix=".txt", delete=False) as f:
            traceback.print_exc(file=f)
        _say(f"internal error, {type(e).__name__}: please report it with the traceback in {f.name}")
        return INTERNAL


def _parse(argv):
    if argv and argv[0] in PLANNED:
        raise Refused(f"jaxbound {argv[0]} is not implemented yet; there are demo, detect and info")
    parser = Parser("jaxbound", description="Guaranteed fault detection: every FAULT is a proof.", epilog=EPILOG)
    parser.add_argument("--version", action="version", version=f"jaxbound {__version__}")
    commands = parser.add_subparsers(metavar="demo | detect | info", required=True, parser_class=Parser)
    c = commands.add_parser("demo", help="run the example of a paper and write its report", epilog="exit code: 0")
    c.add_argument("--out", type=Path, default=Path("demo-report"), metavar="DIR", help="folder for the report (default: demo-report)")
    c.add_argument("--runs", type=_whole(1), default=500, metavar="N", help="runs to count detection rates on (default: 500)")
    c.set_defaults(run=_demo)
    c = commands.add_parser("detect", help="test a recording against a model and write a report", epilog=EPILOG)
    c.add_argument("model", type=Path, metavar="MODEL.toml")
    c.add_argument("data", metavar="DATA.csv")
    c.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for verdicts.csv, alarms.csv, report.html and pictures")
    c.add_argument("--method", default="joint", help=f"{', '.join(METHODS)} (default: joint, the exact test)")
    c.add_argument("--horizon", type=_whole(0), metavar="S", help="a window has S + 1 samples (default: the least useful S)")
    c.add_argument("--alarm", type=_k_of_n, default=(1, 1), metavar="k/n", help="an alarm needs k FAULT among n windows (default: 1/1)")
    c.add_argument("--min-coverage", type=_share, default=0.5, metavar="F", help="least share of decided windows (default: 0.5)")
    c.add_argument("--json", action="store_true", help="a machine-readable summary on stdout, nothing else")
    c.add_argument("--chunk", help=argparse.SUPPRESS)
    c.set_defaults(run=_detect)
    c = commands.add_parser("info", help="show what a model file says and what can be tested", epilog="exit codes: 0, or 2 bad input")
    c.add_argument("model", type=Path, nargs="?", metavar="MODEL.toml")
    c.add_argument("--template", action="store_true", help="print a commented model file")
    c.add_argument("--horizon", type=_whole(0), metavar="S")
    c.set_defaults(run=_info)
    args = parser.parse_args(argv)
    if getattr(args, "chunk", None) is not None:
        raise Refused("--chunk is not implemented yet: leave it out")
    return args


def _whole(least):
    def parse(text):
        if not text.isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(f"needs a whole number >= {least}, not {text!r}")
        return int(text)

    return parse


def _k_of_n(text):
    k, slash, n = text.partition("/")
    if not slash or not k.isdecimal() or not n.isdecimal() or not 1 <= int(k) <= int(n):
        raise argparse.ArgumentTypeError(f"needs k/n with 1 <= k <= n, like 3/5, not {text!r}")
    return int(k), int(n)


def _share(text):
    try:
        share = float(text)
    except ValueError:
        share = -1.0
    if not 0 <= share <= 1:
        raise argparse.ArgumentTypeError(f"needs a share between 0 and 1, not {text!r}")
    return share


def _configure():
    """Switch on float64, the CPU unless the user chose otherwise, and a cache of compiled kernels that lasts."""
    jax.config.update("jax_enable_x64", True)
    if not os.environ.get("JAX_PLATFORMS"):
        jax.config.update("jax_platforms", "cpu")
    if jax.config.jax_compilation_cache_dir is not None:
        return
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxbound"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, RuntimeError):
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


@contextmanager
def _door(*kinds):
    """Turn what the library or the file system refuses into a sentence for the user."""
    kinds = kinds or (OSError, ValueError, NotImplementedError, TypeError)
    try:
        yield
    except kinds as e:
        system = isinstance(e, OSError) and e.filename and e.strerror
        raise Refused(f"{e.filename}: {e.strerror.lower()}" if system else str(e)) from e


@contextmanager
def _workplace(out):
    """Give a folder to write into; move its files to `out` at the end, one by one; leave nothing behind if that end is not reached."""
    missing, work = [p for p in (out, *out.parents) if not p.exists()], None
    try:
        with _door(OSError):
            if out.exists() and not out.is_dir():
                raise Refused(f"--out {out} is a file: a folder is needed")
            try:
                out.mkdir(parents=True, exist_ok=True)
                if not os.access(out, os.W_OK | os.X_OK):
                    raise PermissionError(13, "Permission denied")
            except OSError as e:
                raise Refused(f"cannot write to --out {out}: {e.strerror.lower()}") from e
            try:
                work = Path(tempfile.mkdtemp(prefix=f".{out.resolve().name}-", dir=out.resolve().parent))
            except OSError:  # a folder of ours in one that is not
                work = Path(tempfile.mkdtemp(prefix=".partial-", dir=out))
            yield work
            for file in sorted(work.iterdir()):
                shutil.move(file, out / file.name)
            missing = []
    finally:
        if work is not None:
            shutil.rmtree(work, ignore_errors=True)
        for folder in missing:
            try:
                folder.rmdir()
            except OSError:
                break


def _detect(args):
    if args.method not in METHODS and args.method != "linearised":
        raise Refused(f"--method must be one of {', '.join(METHODS)}, not {args.method!r}")
    threading.Thread(target=_load_plotting, daemon=True).start()
    with _workplace(args.out) as work, _progress(("read", "test", "report")) as step:
        found = _evaluate(args, work, step)
    return _conclude(args, *found)


def _evaluate(args, work, step, extra=lambda res: ()):
    """Read, test and write everything into the folder `work`; return what the conclusion needs."""
    seconds, start = {}, time.perf_counter()
    with _door():
        model = load_model(args.model)
        relations = parity_relations(model, args.horizon)
        recording = read_recording(args.data, model, lambda share: step("read", share))
        if len(recording.time) <= relations.horizon:
            raise ValueError(f"{args.data}: the recording has {len(recording.time)} samples, one window needs {relations.horizon + 1}")
        seconds["read"], start = time.perf_counter() - start, time.perf_counter()
        _usable_device()
        res = detect(relations, recording.u, recording.y, method=args.method, progress=lambda share: step("test", share))
    step("test", 1.0)
    alarms = res.alarms(*args.alarm)
    seconds["test"], start = time.perf_counter() - start, time.perf_counter()
    hints = [*recording.hints, *bound_hints(model)]
    with ThreadPoolExecutor(1) as beside:  # a million verdicts are written while the pictures are drawn
        table = beside.submit(write_verdicts, work / "verdicts.csv", res, recording)
        write_alarms(work / "alarms.csv", alarms, recording, model.dt)
        step("report", 0.1)
        write_report(work, res, recording, alarms, hints=recording.hints, seconds=seconds, min_coverage=args.min_coverage, extra=extra(res),
                     progress=lambda share: step("report", 0.1 + 0.8 * share))  # fmt: skip
        table.result()
    step("report", 1.0)
    seconds["report"] = time.perf_counter() - start
    return res, recording, alarms, hints, seconds


def _usable_device():
    try:
        platform = jax.default_backend()
    except RuntimeError:
        raise ValueError(f"JAX_PLATFORMS={os.environ.get('JAX_PLATFORMS')} names no device of this machine: unset it, or use cpu") from None
    if platform != "cpu":
        raise ValueError(f"proofs are verified on the CPU only, so far, not on {platform}: set JAX_PLATFORMS=cpu")


def _conclude(args, res, recording, alarms, hints, seconds):
    """Print what was found and return the exit code."""
    verdict, sentence = summary(res, alarms, recording.label, args.min_coverage)
    code, worst, counts = CODES[verdict], worst_window(res), res.counts
    margin = None if worst is None or not np.isfinite(res.margin[worst]) else float(res.margin[worst])
    if args.json:
        at = None if worst is None else {"sample": worst, "time": recording.label(worst), "margin": margin,
                                         "factor": None if margin is None else 1 - margin}  # fmt: skip
        found = {
            "verdict": verdict, "exit_code": code, "summary": sentence, "model": res.relations.model.name, "data": str(args.data),
            "method": res.method, "horizon": res.relations.horizon, "samples": int(res.status.size), "counts": counts,
            "decided": coverage(res), "worst": at, "alarms": len(alarms), "hints": hints,
            "seconds": {k: round(v, 3) for k, v in seconds.items()}, "out": str(args.out)}  # fmt: skip
        _write(json.dumps(found, indent=2, allow_nan=False) + "\n")
        return code
    total = res.status.size - res.relations.horizon
    rows = [
        ("windows", ", ".join(f"{counts[s]} {s}" for s in ("FAULT", "CONSISTENT", "UNDECIDED", "MISSING") if counts[s])),
        ("decided", f"{percent(coverage(res))} of {total} windows, by the {res.method} test over {res.relations.horizon + 1} samples each"),
        ("alarms", f"{len(alarms)}" + (f", the first at {recording.label(alarms[0].start)}" if alarms else "")),
    ]
    if margin is not None:
        what = f"bounds needed: {times(1 - margin)} the stated ones" if margin < 0 else f"{percent(1 - margin)} of the bounds are used"
        rows.append(("worst window" if margin < 0 else "tightest", f"{recording.label(worst)}: margin {margin:.3g}, {what}"))
    rows += [("hint", h) for h in hints] + [("report", str(args.out / "report.html"))]
    _show(sentence, COLOUR[verdict], rows)
    return code


def _demo(args):
    from jaxbound import demo

    threading.Thread(target=_load_plotting, daemon=True).start()
    with _workplace(args.out) as work, _progress(("simulate", "read", "test", "report")) as step:
        with _door():
            _usable_device()
        run = demo.demo_run(jax.random.key(2000))
        rates, (false_alarms, clean) = demo.detection_rates(args.runs, jax.random.key(5), lambda share: step("simulate", share))
        save_model(demo.demo_model(), work / "model.toml")
        demo.write_run(work / "run.csv", run)

        detecting = argparse.Namespace(model=work / "model.toml", data=work / "run.csv", horizon=None, method="joint", alarm=(1, 1),
                                       min_coverage=0.5)  # fmt: skip
        extra = lambda res: demo.sections(work, run, res, rates, false_alarms, clean, args.runs)
        res, recording, alarms, hints, seconds = _evaluate(detecting, work, step, extra)
    verdict, sentence = summary(res, alarms, recording.label)
    again = ["jaxbound", "detect", *(str(args.out / f) for f in ("model.toml", "run.csv")), "--out", str(args.out)]
    rows = [("false alarms", f"{false_alarms} in {clean} windows without a fault ({args.runs} runs)"),
            ("report", str(args.out / "report.html")), ("try it", shlex.join(again))]  # fmt: skip
    _show(f"Section 5 of Adrot, Maquin, Ragot 2000. {sentence}", "bold", rows, demo.rate_table(rates))
    return OK


def _info(args):
    if args.template == (args.model is not None):
        raise Refused("jaxbound info needs either a model file or --template")
    if args.template:
        _write(template())
        return OK
    with _door():
        m = load_model(args.model)
        r = parity_relations(m, args.horizon)
    exact = lambda names, values: ", ".join(f"{n} {float(v):.6g}" for n, v in zip(names, values, strict=True) if v) or "none"
    signals = lambda names: ", ".join(f"{n} [{m.unit(n)}]" if m.unit(n) else n for n in names) or "none"
    origin = lambda field: f"({m.provenance.get(field, 'origin not stated')})"
    bounds = [(b, f"{exact(m.outputs, getattr(m, b))}   {origin(b)}") for b in ("tolerance", "noise", "resolution")]
    rows = [
        ("states", f"{m.n}: {', '.join(m.states)}"), ("inputs", f"{m.m}: {signals(m.inputs)}"), ("outputs", f"{m.p}: {signals(m.outputs)}"),
        ("dt", f"{m.dt:g} s"), ("matrices", f"A {m.n}x{m.n}, B {m.n}x{m.m}, C {m.p}x{m.n}, D {'present' if m.has_feedthrough else 'zero'}"
         f"   {origin('model')}"), *bounds,
        ("offset", exact(m.inputs + m.outputs, m.offset["u"] + m.offset["y"])),
        ("horizon", f"{r.horizon}: a window has {r.horizon + 1} samples"),
        ("relations", f"{r.count} independent, {len(r.circuits)} combinations tested"),
        *[("hint", h) for h in bound_hints(m)]]  # fmt: skip
    distinct = distinct_relations(r)
    if len(distinct) < r.count:
        rows.append(("", f"the {len(distinct)} below and the same some samples earlier"))
    _show(m.name, "bold", rows, text="\n".join(r.text().splitlines()[j] for j in distinct))
    return OK


def _load_plotting():
    """Import matplotlib while the data are read: it takes as long as testing a million windows."""
    import matplotlib.backends.backend_agg
    import matplotlib.figure  # noqa: F401


@contextmanager
def _progress(stages):
    """Show a bar for each stage on a terminal's stderr; yields a function of (stage, share)."""
    if not sys.stderr.isatty():
        yield lambda stage, share: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:>8}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks = {stage: bars.add_task(stage, total=1.0) for stage in stages}
        yield lambda stage, share: bars.update(tasks[stage], completed=share)


def _write(text):
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:  # the reader, `head` perhaps, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _show(headline, style, rows, table=None, text=""):
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    console = console if console.is_terminal else Console(width=160)
    grid = Table.grid(padding=(0, 2))
    for name, value in rows:
        grid.add_row(Text(name, "dim"), Text(value, overflow="fold"))
    with console.capture() as page:
        console.print(Text(headline, style), soft_wrap=not console.is_terminal)
        if table:
            rates = Table(box=None, padding=(0, 2), pad_edge=False)
            for i, name in enumerate(table[0]):
                rates.add_column(name, justify="right" if i else "left")
            for row in table[1:]:
                rates.add_row(*row)
            console.print(rates)
        console.print(grid)
        if text:
            console.print(Text(text), soft_wrap=True)
    _write(page.get() if console.is_terminal else "\n".join(line.rstrip() for line in page.get().split("\n")))


def _say(sentence):
    from rich.console import Console

    Console(stderr=True).print(f"jaxbound: {sentence}", soft_wrap=True, markup=False, highlight=False)


if __name__ == "__main__":
    sys.exit(main())
