"""The command line: jaxbound demo | detect | explain | fleet | info.

Exit codes: 0 no fault, 1 fault found, 2 bad input or usage, 3 too little evidence, 70 internal error, 130 interrupted. What the user did
wrong is one sentence on stderr; a report is written completely or not at all.
"""

import argparse
import gc
import importlib
import os
import sys
import tempfile
import traceback
from pathlib import Path

import jax

from jaxbound import __version__
from jaxbound.describing import isolation_text
from jaxbound.detecting import run_demo, run_detect
from jaxbound.diagnosis.consistency import METHODS
from jaxbound.modelfile import load_model, template
from jaxbound.plots import distinct_relations
from jaxbound.relations.parity import parity_relations
from jaxbound.report import bound_hints
from jaxbound.runfile import VALIDATION
from jaxbound.terminal import Refused, door, say, show, write

__all__ = ["main"]

OK, BAD_INPUT, INTERNAL, INTERRUPTED = 0, 2, 70, 130
PLANNED = ("fit", "tune", "study")
EPILOG = "exit codes: 0 no fault, 1 fault found, 2 bad input or usage, 3 too little evidence, 70 internal error, 130 interrupted"
FLEET_EPILOG = (
    "exit codes, the first that applies: 1 fault found in some unit, 2 some unit could not be tested (its row says why) or bad input or "
    "usage, 3 too little evidence for some unit, 0 no fault; 70 internal error, 130 interrupted (what was tested is written)"
)


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
        say(str(e))
        return BAD_INPUT
    except KeyboardInterrupt as e:
        say(str(e) or "interrupted: nothing was written")
        return INTERRUPTED
    except Exception as e:
        with tempfile.NamedTemporaryFile("w", prefix="jaxbound-traceback-", suffix=".txt", delete=False) as f:
            traceback.print_exc(file=f)
        say(f"internal error, {type(e).__name__}: please report it with the traceback in {f.name}")
        return INTERNAL


def _parse(argv):
    if argv and argv[0] in PLANNED:
        raise Refused(f"jaxbound {argv[0]} is not implemented yet; there are demo, detect, explain, fleet and info")
    parser = Parser("jaxbound", description="Guaranteed fault detection: every FAULT is a proof.", epilog=EPILOG)
    parser.add_argument("--version", action="version", version=f"jaxbound {__version__}")
    commands = parser.add_subparsers(metavar="demo | detect | explain | fleet | info", required=True, parser_class=Parser)
    c = commands.add_parser("demo", help="run the example of a paper and write its report", epilog="exit code: 0")
    c.add_argument("--out", type=Path, default=Path("demo-report"), metavar="DIR", help="folder for the report (default: demo-report)")
    c.add_argument("--runs", type=_whole(1), default=500, metavar="N", help="runs to count detection rates on (default: 500)")
    c.set_defaults(run=run_demo)
    c = commands.add_parser("detect", help="test a recording against a model and write a report", epilog=EPILOG)
    c.add_argument("model", type=Path, metavar="MODEL.toml")
    c.add_argument("data", metavar="DATA", help="a CSV file, a Parquet file, or a folder of Parquet files, which follow each other by name")
    c.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for verdicts, alarms.csv, report.html and pictures")
    c.add_argument("--chunk", type=_whole(1), metavar="N", help="Parquet: samples in memory at once, 65536 at least (default: 1000000)")
    more = f"; {VALIDATION} bounds states and outputs, names the faulty sensor and says what it should have shown"
    _testing(c, more)
    c.set_defaults(run=run_detect)
    c = commands.add_parser("explain", help="print the certificate of one window", epilog="exit codes: 0, or 2 bad input")
    c.add_argument("report", type=Path, metavar="DIR", help="folder that jaxbound detect wrote")
    c.add_argument("--at", required=True, metavar="TIME", help="time or number of the sample at which the window ends")
    c.add_argument("--json", action="store_true", help="the certificate as JSON on stdout, nothing else")
    c.set_defaults(run=_elsewhere("explaining"))
    c = commands.add_parser("fleet", help="test many units listed in a table", epilog=FLEET_EPILOG)
    c.add_argument("manifest", type=Path, metavar="MANIFEST", help="CSV or TOML with a unit, a model and a recording in each row")
    c.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for fleet.csv and its page, worst units first")
    _testing(c)
    c.set_defaults(run=_elsewhere("fleet"))
    c = commands.add_parser("info", help="show what a model file says and what can be tested", epilog="exit codes: 0, or 2 bad input")
    c.add_argument("model", type=Path, nargs="?", metavar="MODEL.toml")
    c.add_argument("--template", action="store_true", help="print a commented model file")
    c.add_argument("--horizon", type=_whole(0), metavar="S")
    c.set_defaults(run=_info)
    return parser.parse_args(argv)


def _testing(c, more=""):
    """Add the options of every command that tests recordings."""
    c.add_argument("--method", default="joint", help=f"{', '.join(METHODS)} (default: joint, the exact test){more}")
    c.add_argument("--horizon", type=_whole(0), metavar="S", help="a window has S + 1 samples (default: the least useful S)")
    c.add_argument("--alarm", type=_k_of_n, default=(1, 1), metavar="k/n", help="an alarm needs k FAULT among n windows (default: 1/1)")
    c.add_argument("--min-coverage", type=_share, default=0.5, metavar="F", help="least share of decided windows (default: 0.5)")
    c.add_argument("--json", action="store_true", help="a machine-readable summary on stdout, nothing else")


def _elsewhere(module):
    """Return the `run` of a module that is imported only when its command is given."""
    return lambda args: importlib.import_module(f"jaxbound.{module}").run(args)


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


def _info(args):
    if args.template == (args.model is not None):
        raise Refused("jaxbound info needs either a model file or --template")
    if args.template:
        write(template())
        return OK
    with door():
        m = load_model(args.model)
        r = parity_relations(m, args.horizon)
    exact = lambda names, values: ", ".join(f"{n} {float(v):.6g}" for n, v in zip(names, values, strict=True) if v) or "none"
    signals = lambda names: ", ".join(f"{n} [{m.unit(n)}]" if m.unit(n) else n for n in names) or "none"
    origin = lambda field: f"({m.provenance.get(field, 'origin not stated')})"
    bounds = [(b, f"{exact(m.outputs, getattr(m, b))}   {origin(b)}") for b in ("tolerance", "noise", "resolution")]
    ranges = ", ".join(f"w{j + 1} in [{float(lo):.6g}, {float(hi):.6g}]" for j, (lo, hi) in enumerate(m.disturbance))
    bounds += [("disturbance", f"{ranges}   {origin('disturbance')}")] if m.g else []
    bounds += [("unknown inputs", f"{m.d}, of which nothing is known")] if m.d else []
    bounds += [
        ("parameter", f"{p.name} in [{float(p.between[0]):.6g}, {float(p.between[1]):.6g}], {'varies' if p.varying else 'constant'}")
        for p in m.uncertainties
    ]
    if m.uncertainties:
        tested = f"polynomials of order {r.order} in {len(r.variables)} uncertain numbers"
    else:
        tested = f"{len(r.circuits)} combinations tested" if r.frame is None else "combinations too many to list, the worst is searched for"
    rows = [
        ("states", f"{m.n}: {', '.join(m.states)}"), ("inputs", f"{m.m}: {signals(m.inputs)}"), ("outputs", f"{m.p}: {signals(m.outputs)}"),
        ("dt", f"{m.dt:g} s"), ("matrices", f"A {m.n}x{m.n}, B {m.n}x{m.m}, C {m.p}x{m.n}, D {'present' if m.has_feedthrough else 'zero'}"
         f"   {origin('model')}"), *bounds,
        ("offset", exact(m.inputs + m.outputs, m.offset["u"] + m.offset["y"])),
        ("horizon", f"{r.horizon}: a window has {r.horizon + 1} samples"),
        ("relations", f"{r.count} independent, {tested}"),
        *[("note", n) for n in getattr(r, "notes", ())], *[("hint", h) for h in bound_hints(m)]]  # fmt: skip
    distinct = distinct_relations(r)
    if len(distinct) < r.count:
        rows.append(("", f"the {len(distinct)} below and the same some samples earlier"))
    text = "\n".join(r.text().splitlines()[j] for j in distinct)
    show(m.name, "bold", rows, text=text if m.uncertainties else f"{text}\n\n{isolation_text(m, r.horizon)}")
    return OK


if __name__ == "__main__":
    sys.exit(main())
