"""The command `jaxbound detect`: a recording against a model, with verdicts, a report and an exit code."""

import argparse
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from jaxbound.cli.command import EXIT_CODES, swift_imports
from jaxbound.cli.options import (
    CLAIMS,
    COVERAGE,
    ENGINE,
    JSON,
    RULE,
    Options,
    named,
    reading,
    some_of,
    test,
    whole_number,
)
from jaxbound.cli.terminal import Refused, door, progress_bars

if TYPE_CHECKING:
    from jaxbound.cli.evaluation import Evaluation
    from jaxbound.cli.window import DetectRun
    from jaxbound.runs.ask import Ask

NAME = "detect"
HELP = "test a recording against a model and write a report"
SHARING, SPREADING = ("part", "merge", "overlap"), ("workers",)
VALIDATION = "validation"  # `runs.runfile` has it too, and imports more than a help can wait for
STDIN = "-"
EXAMPLES = (
    (
        "jaxbound detect plant.toml run.csv --out report/",
        "verdicts, alarms and one page with charts; exit code 1 if a fault is proved",
    ),
    (
        "jaxbound detect plant.toml run.csv --out report/ --alarm 3/5 -q",
        "one sentence; an alarm needs 3 FAULT among 5 windows",
    ),
    ("jaxbound detect plant.toml recordings/ --out report/", "a folder of Parquet files, larger than memory"),
    (
        "jaxbound detect plant.toml run.csv --out report/ --test observer=joint",
        "against all samples since it began: slow faults",
    ),
    (
        "jaxbound detect plant.toml run.csv --out report/ --test method=validation",
        "which sensor is wrong, and what it should have shown",
    ),
    ("logger | jaxbound detect plant.toml - --out live/", "line by line, each verdict at once"),
)
SHARES = (
    ". In shares, by three machines that see one folder: jaxbound detect plant.toml recordings/ --out "
    "report --part 1/3, the same with --part 2/3 and --part 3/3, in any order, then with --merge; what was "
    "killed goes on when it is started again"
)
PIPE = (
    ". With -: SIGINT (Ctrl-C), SIGTERM and SIGHUP end the input. Stopped in any way, kill -9 too, and "
    "started again with the same --out, verdicts.csv holds each line that was taken once, whether the "
    "sender begins again (what was judged is known by time and values, and skipped) or goes on; lines at "
    "times that were judged with other values are refused (2), and a run that judged nothing new concludes "
    "nothing (3). On standard output each verdict stands once, after kill -9 at least once, if --out or "
    "--state is given. What the pipe held when its reader was killed is lost, unless the sender sends it "
    "again"
)
CODES = EXIT_CODES + SHARES + PIPE
OPTIONS = Options(
    {
        "model MODEL.toml": "the plant and its bounds: from fit, tune, or written by hand",
        "data DATA": "a CSV file, a Parquet file, a folder of Parquet files, which follow each other by "
        "name, or -: lines of CSV from standard input, each judged as it comes, its verdict on standard "
        "output; or FILE.py:FUNCTION, a generator of recordings that are judged as they come",
        "--out DIR": "folder for verdicts, alarms.csv and report.html; with -, if given, for verdicts.csv "
        "and monitor.sqlite, with a rule of alarms also for alarms.csv",
        **test("; method=validation (names the faulty sensor, and what it should have shown)" + CLAIMS),
        **RULE,
        **reading(),
        **JSON,
    },
    {"data": named, "chunk": whole_number(1), "part": some_of("i", "2/3"), "overlap": whole_number()},
    more={
        **COVERAGE,
        "--state FILE": "with -: where to remember how to go on (default: DIR/monitor.sqlite)",
        "--chunk N": "Parquet: samples in memory at once, 65536 at least (default: 1000000)",
        "--part i/n": "Parquet: judge only the i-th of n shares, i from 1 to n, and write its verdicts into "
        "DIR, beside shares made at the same time or on other machines; exit code 0",
        "--merge": "Parquet: judge nothing and report on the shares in DIR: the verdicts, the report and the "
        "exit code of one command without --part",
        "--overlap N": "Parquet and observer: judge each million samples by an observer of its own that "
        "begins N samples earlier, which can be shared but remembers less (default: one observer)",
        **ENGINE,
    },
)


def run(args: argparse.Namespace) -> int:
    """Test a recording and write its report; return the exit code."""
    if args.data == STDIN:
        return _run_live(args)
    with swift_imports():
        from jaxbound.cli.conclusion import conclude
        from jaxbound.cli.share import judge_share
        from jaxbound.cli.window import DetectRun, asked, asked_test
        from jaxbound.recordings.live import LiveSource
        from jaxbound.recordings.read import kind_of

    if LiveSource.takes(args.data):
        return _run_live(args)
    if args.out is None:
        raise Refused("the following arguments are required: --out; see jaxbound detect --help")
    _refuse(args, ("state",), "is for samples that come through a pipe: give - as DATA")
    ask = asked_test(args, VALIDATION, claims=True)
    with door(OSError):
        kind = kind_of(args.data)
    _refuse_shares(args, ask, kind.parts)
    whole = asked(DetectRun, args, ask)
    if whole.part is not None:
        return judge_share(whole, whole.part)
    in_parts = kind.parts and ask.method != VALIDATION
    replaces = (whole.out / "report.html").exists()
    evaluation = _evaluate_parts(whole) if in_parts else _evaluate_whole(whole)
    return conclude(evaluation, whole, replaces)


def _run_live(args: argparse.Namespace) -> int:
    """Judge samples as they come, from standard input or a live source; return the exit code."""
    _refuse(args, SPREADING, "is for Parquet: samples through a pipe are judged as they come")
    _refuse(args, (*SHARING, "chunk"), f"is for recordings: give a file instead of {args.data}")
    with swift_imports():
        from jaxbound.cli.pipe import LiveRun, judge_stream
        from jaxbound.cli.window import asked, asked_test

    ask = asked_test(args, VALIDATION, claims=True)
    if ask.method == VALIDATION:
        raise Refused(f"{VALIDATION} reads a recording as a whole: give a file instead of {args.data}")
    return judge_stream(asked(LiveRun, args, ask))


def _evaluate_parts(run: "DetectRun") -> "Evaluation":
    """Test a Parquet recording chunk by chunk and write its report."""
    from jaxbound.cli.evaluation import FILES_OF_PARTS, evaluate_parts
    from jaxbound.runs.outputs import output_folder

    with (
        door(),
        output_folder(run.out, FILES_OF_PARTS, (run.model, run.data)) as folder,
        progress_bars(("relations", "test", "report")) as step,
    ):
        return evaluate_parts(folder, step, run)


def _evaluate_whole(run: "DetectRun") -> "Evaluation":
    """Test a recording that is read as a whole and write its report."""
    from jaxbound.cli.evaluation import FILES_OF_A_WHOLE, FORMER, evaluate
    from jaxbound.recordings.parquet import VERDICTS
    from jaxbound.runs.outputs import output_folder

    validates = run.ask.method == VALIDATION
    method: Callable[..., Evaluation] = evaluate
    stages: tuple[str, ...] = ("read", "relations", "test", "report")
    if validates:
        from jaxbound.cli.validation import evaluate_validation

        method, stages = evaluate_validation, ("read", "test", "report")
    with door(OSError), output_folder(run.out, FILES_OF_A_WHOLE, (run.model, run.data)) as folder:
        with folder.work() as work, progress_bars(stages) as step:
            evaluation = method(work, step, run)
        for name in (VERDICTS, *FORMER):
            folder.remove(name)
    return evaluation


def _refuse_shares(args: argparse.Namespace, ask: "Ask", has_parts: bool) -> None:
    """Raise Refused for options of Parquet where there are no parts, or none that can be shared.

    Args:
        ask: the test. has_parts: whether the recording is one of Parquet.
    """
    of_parts = *SHARING, "chunk"
    if args.part is not None and args.merge:
        raise Refused("--merge reports on what --part makes: give one of the two")
    if ask.method == VALIDATION:
        if ask.outside != "fault":
            raise Refused(f"outside is for other methods: {VALIDATION} does not ask where its inputs lie")
        _refuse(args, of_parts, f"is for other methods: {VALIDATION} reads {args.data} as a whole")
    if ask.method == "observer" and args.overlap is None:
        _refuse(
            args,
            SHARING,
            "is for windows: an observer carries what it knows from sample to sample, its work can be shared "
            "only where --overlap N lets one begin anew N samples before each part",
        )
    if not has_parts:
        _refuse(args, of_parts, f"is for Parquet: {args.data} is read as a whole")
    if ask.method == VALIDATION or not has_parts:
        _refuse(args, SPREADING, f"is for Parquet and other methods: {args.data} is read as a whole")
    if args.part is not None or args.merge:
        _refuse(args, SPREADING, "spreads the work itself: leave out --part and --merge")


def _refuse(args: argparse.Namespace, names: Sequence[str], why: str) -> None:
    """Raise Refused if one of these options is given. why: the sentence behind its name."""
    for name in names:
        value = getattr(args, name)
        if value is not None and value is not False:  # 0 is a value
            raise Refused(f"--{name} {why}")
