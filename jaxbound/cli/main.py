"""The command line: jaxbound demo | example | detect | explain | verify | fleet | fit | tune | study | info.

Exit codes: 0 no fault, 1 fault found, 2 bad input or usage, 3 too little evidence or outside bounds that were
fitted to shorter windows, 70 internal error, 130 interrupted (129 by SIGHUP, 143 by SIGTERM, as shells
count). What the user did wrong is one sentence on stderr; a report is written completely or not at all.
"""

import argparse
import gc
import importlib
import os
import sys
import tempfile
import traceback
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from jaxbound import __version__
from jaxbound.cli.terminal import (
    BAD_INPUT,
    INTERNAL,
    INTERRUPTED,
    LOUDNESS,
    NORMAL,
    OK,
    QUIET,
    VERBOSE,
    Refused,
    say,
    stoppable,
    system_trouble,
    write,
)
from jaxbound.cli.usage import EPILOG, NO_COMMAND, epilog
from jaxbound.text.characters import clipped

__all__ = ["commands", "main"]

OBSERVERS = "zonotope", "strips", "joint", "constrained"  # as `estimation.observer` has them, likewise
# as `consistency.interface.METHODS`: a text, for what is asked here is not worth its imports
METHODS = "joint, box, paving, linearized"


class _Formatter(argparse.HelpFormatter):
    """Keeps paragraphs apart, and lines that are examples as they are."""

    def _fill_text(self, text, width, indent):
        filled = super()._fill_text
        return "\n\n".join(p if "\n  " in p else filled(p, width, indent) for p in text.split("\n\n"))


class Parser(argparse.ArgumentParser):
    """Reports wrong usage in one sentence."""

    def error(self, message: str) -> NoReturn:
        """Raise Refused instead of printing the usage."""
        raise Refused(
            f"{message.removeprefix('argument ').replace(': ', ' ', message.startswith('argument '))}; see "
            f"{self.prog} --help"
        )

    def _print_message(self, message, file=None):
        """Print help and version as everything is printed."""
        if message:
            write(message)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: the arguments after the program's name; None: those of the process.

    Returns:
        The exit code.
    """
    with stoppable() as caught:
        code = _main(argv)
        return 128 + caught[0] if code == INTERRUPTED and caught else code


def _main(argv):
    try:
        return _run(_parse(sys.argv[1:] if argv is None else list(argv)))
    except SystemExit as e:  # --help, --version
        return e.code if isinstance(e.code, int) else OK
    except Refused as e:
        say(str(e))
        return BAD_INPUT
    except KeyboardInterrupt as e:
        say(str(e) or "interrupted: nothing was written")
        return INTERRUPTED
    except MemoryError as e:
        said = clipped(str(e)) or "no more was given"
        say(f"this needs more memory than there is ({said}): ask for less at once, or use a larger machine")
        return BAD_INPUT
    except OSError as e:  # a disk that fills up, say, while a report is written
        say(system_trouble(e))
        return BAD_INPUT
    except Exception as e:
        with tempfile.NamedTemporaryFile("w", prefix="jaxbound-traceback-", suffix=".txt", delete=False) as f:
            traceback.print_exc(file=f)
        if {"-v", "--verbose"} & set(sys.argv[1:] if argv is None else argv):
            traceback.print_exc()
        say(f"internal error, {type(e).__name__}: please report it with the traceback in {f.name}")
        return INTERNAL


def _run(args):
    """Run the command that was given. Whoever only asks for help or the version waits for none of the
    imports.
    """
    collected = gc.isenabled()
    gc.disable()  # what is imported stays: the collector need not look through it again and again
    try:
        from jaxbound.sets.floats.probe import Unverified

        _configure()
        command = getattr(importlib.import_module(f"jaxbound.cli.{args.module}"), args.function)
        gc.freeze()
    finally:
        if collected:
            gc.enable()
    token = LOUDNESS.set(args.loudness)
    try:
        return command(args)
    except Unverified as e:
        raise Refused(str(e)) from e
    finally:
        LOUDNESS.reset(token)


def commands() -> dict[str, argparse.ArgumentParser]:
    """Return the parser of each command by its name."""
    return _parsers()[1]


def _parse(argv):
    for i in reversed(range(1, len(argv))):
        if (
            argv[i - 1] in ("--input-range", "--sizes") and argv[i][:1] == "-"
        ):  # argparse takes -1:1 for an option
            argv[i - 1 : i + 1] = [f"{argv[i - 1]}={argv[i]}"]
    parser, _ = _parsers()
    if not argv:
        parser.print_help()
        raise Refused(NO_COMMAND)
    return parser.parse_args(argv)


def _parsers():
    """Return (the parser of the command line, {command: its parser})."""
    parser = Parser(
        "jaxbound", description="Guaranteed fault detection: every FAULT is a proof.", epilog=EPILOG
    )
    parser.add_argument("--version", action="version", version=f"jaxbound {__version__}")
    parser.set_defaults(function="run")
    choices = parser.add_subparsers(
        title="commands (jaxbound COMMAND --help has its options and examples)",
        metavar="COMMAND",
        required=True,
        parser_class=Parser,
    )
    c = choices.add_parser("demo", help="run the example of a paper and write its report")
    c.add_argument(
        "--out",
        type=_path,
        default=Path("demo-report"),
        metavar="DIR",
        help="folder for the report (default: demo-report)",
    )
    c.add_argument(
        "--runs",
        type=_whole(1, 10**7),
        default=500,
        metavar="N",
        help="runs to count detection rates on (default: 500)",
    )
    c.set_defaults(module="detect", function="run_demo")
    c = choices.add_parser("example", help="write recordings to try the other commands on")
    c.add_argument(
        "name", nargs="?", metavar="NAME", help="heater or tank; without it, the examples are listed"
    )
    c.add_argument(
        "--out", type=_path, metavar="DIR", help="folder for the files (default: one of that name)"
    )
    c.set_defaults(module="example")
    c = choices.add_parser("detect", help="test a recording against a model and write a report")
    c.add_argument(
        "model",
        type=_path,
        metavar="MODEL.toml",
        help="the plant and its bounds: from fit, tune, or written by hand",
    )
    c.add_argument(
        "data",
        type=_named,
        metavar="DATA",
        help="a CSV file, a Parquet file, a folder of Parquet files, which follow each "
        "other by name, or -: lines of CSV from standard input, each judged as it comes, its verdict on "
        "standard "
        "output",
    )
    c.add_argument(
        "--out",
        type=_path,
        metavar="DIR",
        help="folder for verdicts, alarms.csv and report.html; with -, if given, "
        "for verdicts.csv and monitor.jsonl",
    )
    c.add_argument(
        "--state",
        type=_path,
        metavar="FILE",
        help="with -: where to remember how to go on (default: DIR/monitor.jsonl)",
    )
    c.add_argument(
        "--chunk",
        type=_whole(1),
        metavar="N",
        help="Parquet: samples in memory at once, 65536 at least (default: 1000000)",
    )
    c.add_argument(
        "--part",
        type=_of_n("i", "2/3"),
        metavar="i/n",
        help="Parquet: judge only the i-th of n shares, i from 1 to "
        "n, and write its verdicts into DIR, beside shares made at the same time or on other machines; exit "
        "code 0",
    )
    c.add_argument(
        "--merge",
        action="store_true",
        help="Parquet: judge nothing and report on the shares in DIR: the verdicts, the "
        "report and the exit code of one command without --part",
    )
    c.add_argument(
        "--overlap",
        type=_whole(0),
        metavar="N",
        help="Parquet and observer: judge each million samples by an observer of its "
        "own that begins N samples earlier, which can be shared but remembers less (default: one observer)",
    )
    _engine(c)
    carries = "; observer carries everything since it began on"
    more = (
        f"{carries}; validation bounds states and outputs, names the faulty sensor and says what it "
        f"should have shown"
    )
    _testing(c, more)
    _observer(c)
    c.set_defaults(module="detect", function="run_detect")
    c = choices.add_parser("explain", help="print the certificate of one window")
    c.add_argument("report", type=_path, metavar="DIR", help="folder that jaxbound detect wrote")
    c.add_argument(
        "--at",
        required=True,
        metavar="TIME",
        help="sample at which the window ends: its number, like 60, or its time, like 180s (with the s) or "
        "2026-03-01T12:00:07",
    )
    c.add_argument(
        "--all", action="store_true", help="every coefficient, and a row for each sample (-v does the same)"
    )
    c.add_argument("--json", action="store_true", help="the certificate as JSON on stdout, nothing else")
    c.set_defaults(module="explain")
    c = choices.add_parser(
        "verify", help="check a certificate against a model and a recording, in exact fractions"
    )
    c.add_argument("certificate", type=_path, metavar="CERTIFICATE.json", help="that jaxbound explain wrote")
    c.add_argument(
        "--model",
        type=_path,
        required=True,
        metavar="MODEL.toml",
        help="the plant and its bounds: DIR/tested_model.toml where options of the report changed its window",
    )
    c.add_argument(
        "--data",
        type=_path,
        required=True,
        metavar="DATA",
        help="the recording: a CSV file, a Parquet file or a folder",
    )
    c.set_defaults(module="verify")
    c = choices.add_parser("fleet", help="test many units listed in a table")
    c.add_argument(
        "manifest",
        type=_path,
        metavar="MANIFEST",
        help="CSV or TOML with a unit, a model and a recording in each row",
    )
    c.add_argument(
        "--out",
        type=_path,
        required=True,
        metavar="DIR",
        help="folder for fleet.csv and its page, worst units first",
    )
    c.add_argument(
        "--state",
        type=_path,
        metavar="DIR",
        help="folder in which it is kept how each unit goes on: its next recording, in a "
        "later run, is judged as if it followed in one file",
    )
    _engine(c)
    _testing(c, carries)
    _observer(c)
    c.set_defaults(module="fleet")
    c = choices.add_parser("fit", help="find a model and its bounds from healthy recordings")
    c.add_argument(
        "data",
        type=_path,
        nargs="+",
        metavar="DATA",
        help="healthy recordings: CSV files, Parquet files or folders",
    )
    c.add_argument(
        "--inputs",
        default="",
        metavar="A,B",
        help="columns; or name=column, or name=expression like lift=Tsup-Tmix",
    )
    c.add_argument(
        "--outputs", required=True, metavar="C,D", help="as --inputs: what the model is to explain"
    )
    c.add_argument(
        "--order",
        type=_whole(1, 1000),
        default=2,
        metavar="N",
        help="samples back that determine the next one (default: 2)",
    )
    _window(
        c, "bounds are found for windows of S + 1 samples (default: 15; with --lags, the largest of them)", 1
    )
    c.add_argument("--direct", action="store_true", help="inputs act on outputs of the same sample")
    c.add_argument(
        "--where",
        metavar="EXPR",
        help="condition on columns: samples where it does not hold are no part of the recording",
    )
    c.add_argument(
        "--time", metavar="COLUMN", help="of the time stamps (default: a column that looks like time)"
    )
    c.add_argument(
        "--dt", type=float, metavar="SECONDS", help="sampling period (default: the median step of the time)"
    )
    c.add_argument(
        "--safety",
        type=float,
        default=1.25,
        metavar="F",
        help="factor on the smallest bounds (default: 1.25)",
    )
    c.add_argument(
        "--held-out",
        type=_share,
        default=0.3,
        metavar="F",
        help="last share of each recording kept from a first fit, to see "
        "what it makes of unseen data (default: 0.3)",
    )
    c.add_argument(
        "--method",
        default="auto",
        help="auto, least squares, windows, or filters (fast given dynamics: no error hides)",
    )
    c.add_argument(
        "--average",
        type=_whole(2),
        metavar="N",
        help="bound the mean of N errors in a row too: lasting errors show smaller",
    )
    c.add_argument("--out", type=_path, required=True, metavar="MODEL.toml", help="the model file to write")
    c.add_argument("--name", metavar="NAME", help="of the plant (default: that of the model file)")
    c.add_argument(
        "--plot", type=_path, metavar="PNG", help="picture: how much of the bounds each window needs"
    )
    c.add_argument(
        "--force", action="store_true", help="replace files that are there; never one that is read"
    )
    c.add_argument("--json", action="store_true", help="a machine-readable summary on stdout, nothing else")
    c.set_defaults(module="fit")
    c = choices.add_parser(
        "tune", help="find the smallest bounds under which healthy recordings are consistent"
    )
    c.add_argument(
        "model", type=_path, metavar="MODEL.toml", help="its bounds are the start; those at 0 stay 0"
    )
    c.add_argument(
        "healthy", type=_path, nargs="+", metavar="HEALTHY", help="recordings without a fault: CSV or Parquet"
    )
    c.add_argument(
        "--faulty",
        type=_path,
        nargs="+",
        default=[],
        metavar="F",
        help="recordings with a fault, to be left outside",
    )
    c.add_argument(
        "--out", type=_path, required=True, metavar="TUNED.toml", help="the model with its new bounds"
    )
    _window(c)
    c.add_argument(
        "--steps",
        type=_whole(0, 10**7),
        default=300,
        metavar="N",
        help="gradient steps (default: 300; 0: one factor on all bounds)",
    )
    c.add_argument(
        "--optimizer", default="adam", metavar="NAME", help="of optax: adam (default), sgd, lion, ..."
    )
    c.add_argument(
        "--bounds", metavar="A,B", help="which move: noise, tolerance, disturbance, parameters (default: all)"
    )
    c.add_argument(
        "--safety",
        type=float,
        default=1.25,
        metavar="F",
        help="factor on the smallest bounds (default: 1.25)",
    )
    c.add_argument(
        "--calibrate",
        type=_share,
        default=1 / 3,
        metavar="F",
        help="share of the data kept out of the search (default: 1/3)",
    )
    c.add_argument("--plot", type=_path, metavar="PNG", help="picture of the search and of the margins")
    c.add_argument(
        "--force", action="store_true", help="replace files that are there; never one that is read"
    )
    c.add_argument("--json", action="store_true", help="a machine-readable summary on stdout, nothing else")
    c.set_defaults(module="tune")
    c = choices.add_parser("study", help="simulate a million scenarios and count what is detected")
    c.add_argument("model", type=_path, metavar="MODEL.toml", help="the plant and the bounds of its monitor")
    c.add_argument(
        "--faults",
        required=True,
        metavar="F,F",
        help="like y1:bias,y2:gain,u1:bias; kinds as in a simulation",
    )
    c.add_argument(
        "--sizes",
        metavar="LO:HI:COUNT",
        help="or numbers with commas (default: twelve around the guaranteed size)",
    )
    c.add_argument(
        "--n",
        type=_whole(1),
        default=100_000,
        metavar="N",
        help="scenarios, spread over faults and sizes (default: 100000)",
    )
    c.add_argument(
        "--out",
        type=_path,
        required=True,
        metavar="DIR",
        help="folder for summary.csv, delays.parquet and report.html",
    )
    c.add_argument(
        "--samples", type=_whole(1, 10**6), default=200, metavar="T", help="of a scenario (default: 200)"
    )
    c.add_argument(
        "--onset",
        metavar="LO:HI",
        help="the fault starts at a sample LO <= k < HI (default: the second quarter)",
    )
    c.add_argument(
        "--at",
        default="uniform",
        help="unknowns: uniform (default), vertices of their bounds, or adversarial",
    )
    _window(c)
    c.add_argument(
        "--method", default="joint", help=f"of the monitor: {METHODS} (default: joint), or observer"
    )
    _observer(c)
    c.add_argument("--seed", type=_whole(0), default=0, metavar="K", help="of the scenarios (default: 0)")
    c.add_argument(
        "--input-range",
        metavar="LO:HI",
        help="levels of the inputs, one pair for all or one each with commas (default: the "
        "ranges that the model file states, which fit writes, else from 1 below the operating point to 1 "
        "above)",
    )
    c.add_argument(
        "--hold", type=_whole(1), default=20, metavar="H", help="samples that a level lasts (default: 20)"
    )
    _engine(c)
    c.add_argument("--rows", action="store_true", help="keep a row for each scenario in DIR/scenarios/")
    c.add_argument("--json", action="store_true", help="a machine-readable summary on stdout, nothing else")
    c.set_defaults(module="study")
    c = choices.add_parser("info", help="show what a model file says and what can be tested")
    c.add_argument("model", type=_path, nargs="?", metavar="MODEL.toml", help="the model file to show")
    c.add_argument("--template", action="store_true", help="print a commented model file")
    _window(c)
    c.add_argument("--json", action="store_true", help="the same as JSON on stdout, nothing else")
    c.set_defaults(module="info")
    for name, c in choices.choices.items():
        c.formatter_class, c.epilog = _Formatter, epilog(name)
        loud = c.add_mutually_exclusive_group()
        loud.add_argument(
            "-q",
            "--quiet",
            action="store_const",
            const=QUIET,
            dest="loudness",
            help="print the first line of the conclusion alone, and no progress",
        )
        loud.add_argument(
            "-v",
            "--verbose",
            action="store_const",
            const=VERBOSE,
            dest="loudness",
            help="say more: when each stage begins, all of a certificate, the traceback of an internal error",
        )
        c.set_defaults(loudness=NORMAL)
    return parser, choices.choices


def _testing(c, more=""):
    """Add the options of every command that tests recordings."""
    c.add_argument("--method", default="joint", help=f"{METHODS} (default: joint, the exact test){more}")
    _window(c)
    alarm = "an alarm needs k FAULT among n windows (default: 1/1)"
    c.add_argument("--alarm", type=_of_n("k", "3/5"), default=(1, 1), metavar="k/n", help=alarm)
    c.add_argument(
        "--min-coverage",
        type=_share,
        default=0.5,
        metavar="F",
        help="least share of decided windows (default: 0.5)",
    )
    c.add_argument("--json", action="store_true", help="a machine-readable summary on stdout, nothing else")


def _observer(c):
    """Add the options of a set observer."""
    c.add_argument(
        "--order",
        type=_whole(1, 1000),
        metavar="N",
        help="observer: directions of its set for each state; more is sharper and "
        "slower (default: 20; 5 of constrained)",
    )
    c.add_argument(
        "--latched",
        action="store_true",
        help="observer: FAULT stays until a gap; else it begins anew behind a contradiction",
    )
    c.add_argument(
        "--observer",
        choices=OBSERVERS,
        metavar="NAME",
        help="observer: zonotope (default, fast), strips (one set, least after "
        "every sample), joint (exact tests of windows that remember: slow faults, some hundred times slower) "
        "or constrained "
        "(between them)",
    )
    c.add_argument(
        "--span",
        type=_whole(4, 1000),
        metavar="N",
        help="observer joint: samples of such a window, even (default: 32)",
    )


def _engine(c):
    """Add the options that say who does the work."""
    one = c.add_mutually_exclusive_group()
    one.add_argument(
        "--workers",
        type=_whole(1, 10**4),
        metavar="N",
        help="let N processes of this machine do the work (needs dask)",
    )
    one.add_argument(
        "--scheduler",
        type=_named,
        metavar="ADDRESS",
        help="let the workers of a dask scheduler do the work, like "
        "tcp://host:8786; they see all files by the same paths",
    )


def _window(
    c, about="a window has S + 1 samples (default: that of the model, or the least useful S)", least=0
):
    """Add the options that say which windows are tested."""
    one = c.add_mutually_exclusive_group()
    one.add_argument("--horizon", type=_whole(least), metavar="S", help=about)
    one.add_argument(
        "--lags",
        type=_lags,
        metavar="0,1,2,4",
        help="look at the outputs only so many samples before the last of a window: "
        "long memory, few rows; every input between is used",
    )


def _lags(text):
    from jaxbound.models.system import whole_lags

    try:
        return whole_lags([_whole(0)(part.strip()) for part in text.split(",")])
    except (ValueError, argparse.ArgumentTypeError):
        raise argparse.ArgumentTypeError(
            f"needs different whole numbers with commas, 0 among them, like 0,1,2,4,8: not {text[:60]!r}"
        ) from None


def _named(text):
    if not text.strip():
        raise argparse.ArgumentTypeError("needs a name, not an empty text")
    return text


def _path(text):
    return Path(_named(text))


def _whole(least, most=10**15):
    def parse(text):
        if not text.isdecimal() or len(text) < 20 and int(text) < least:
            raise argparse.ArgumentTypeError(f"needs a whole number >= {least}, not {text[:40]!r}")
        if len(text) >= 20 or int(text) > most:
            raise argparse.ArgumentTypeError(f"needs a whole number of at most {most}, not {text[:40]}")
        return int(text)

    return parse


def _of_n(k, example):
    def parse(text):
        first, slash, n = text.partition("/")
        if not slash or not first.isdecimal() or not n.isdecimal() or not 1 <= int(first) <= int(n):
            raise argparse.ArgumentTypeError(f"needs {k}/n with 1 <= {k} <= n, like {example}, not {text!r}")
        return int(first), int(n)

    return parse


def _share(text):
    try:
        share = float(text)
    except ValueError:
        share = -1.0
    if not 0 <= share <= 1:
        raise argparse.ArgumentTypeError(f"needs a share between 0 and 1, not {text!r}")
    return share


def _configure():
    """Switch on float64, the CPU unless the user chose otherwise, and a cache of compiled kernels that
    lasts.
    """
    import jax

    from jaxbound.runs.cache import use_cache

    jax.config.update("jax_enable_x64", True)
    if not os.environ.get("JAX_PLATFORMS"):
        jax.config.update("jax_platforms", "cpu")
    with suppress(ValueError):  # a folder that cannot be written: what is slow is not wrong
        use_cache()


if __name__ == "__main__":
    sys.exit(main())
