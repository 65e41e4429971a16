"""The command `jaxbound tune`: the smallest bounds under which healthy recordings are consistent."""

import argparse
from functools import partial
from typing import TYPE_CHECKING, cast

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import (
    OBSERVER,
    MethodOptions,
    add_every,
    add_force,
    add_json,
    add_observer,
    add_windows,
    method_name,
    path,
    share,
    whole_number,
)
from jaxbound.cli.terminal import (
    INTERRUPTED,
    OK,
    Refused,
    door,
    json_text,
    progress_bars,
    say,
    some_device,
    write,
)
from jaxbound.text.progress import in_part
from jaxbound.text.quantities import decimal

if TYPE_CHECKING:
    from jaxbound.studies.tuning.parametrization import Tunable

NAME = "tune"
HELP = "find the smallest bounds under which healthy recordings are consistent"
EXAMPLES = (
    (
        "jaxbound tune plant.toml healthy.csv --out tuned.toml",
        "the smallest bounds that explain healthy.csv, times 1.25",
    ),
    (
        "jaxbound tune plant.toml healthy.csv --faulty leak.csv --out tuned.toml",
        "those that leave most of leak.csv outside",
    ),
    (
        "jaxbound tune plant.toml a.csv b.csv --method observer --observer joint --latched --out tuned.toml",
        "one factor on all bounds, for `detect` with the same observer",
    ),
    (
        "jaxbound tune monitor.toml a.csv b.csv --out tuned.toml",
        "of a model with [[test]] tables: one factor a test",
    ),
)
ORDER = 2
"""By which healthy samples are compared with those around them."""
STEPS = 300
"""Of the search where none are asked for."""
CODES = (
    "exit codes: 0, 2 bad input, 70 internal error, 130 interrupted, 129 by SIGHUP, 143 by SIGTERM (the best "
    "bounds until then are written; the same command goes on)"
)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the arguments and options."""
    parser.add_argument(
        "model", type=path, metavar="MODEL.toml", help="its bounds are the start; those at 0 stay 0"
    )
    parser.add_argument(
        "healthy", type=path, nargs="+", metavar="HEALTHY", help="recordings without a fault: CSV or Parquet"
    )
    parser.add_argument(
        "--faulty",
        type=path,
        nargs="+",
        default=[],
        metavar="F",
        help="recordings with a fault, to be left outside",
    )
    parser.add_argument(
        "--out", type=path, required=True, metavar="TUNED.toml", help="the model with its new bounds"
    )
    add_every(parser)
    add_windows(parser)
    parser.add_argument(
        "--method",
        type=method_name,
        choices=("joint", OBSERVER),
        default="joint",
        metavar="METHOD",
        help="windows, or the tests that the model states, one factor each; observer: all bounds by one "
        "factor, at which it follows each recording to its end (default: windows)",
    )
    add_observer(parser)
    parser.add_argument(
        "--steps",
        type=whole_number(0, 10**7),
        metavar="N",
        help=f"gradient steps (default: {STEPS}; 0: one factor on all bounds)",
    )
    parser.add_argument("--optimizer", metavar="NAME", help="of optax: adam (default), sgd, lion, ...")
    parser.add_argument(
        "--bounds", metavar="A,B", help="which move: noise, tolerance, disturbance, parameters (default: all)"
    )
    parser.add_argument(
        "--safety",
        type=decimal,
        default=1.25,
        metavar="F",
        help="factor on the smallest bounds (default: 1.25)",
    )
    parser.add_argument(
        "--calibrate",
        type=share,
        default=1 / 3,
        metavar="F",
        help="share of the data kept out of the search (default: 1/3)",
    )
    parser.add_argument("--plot", type=path, metavar="PNG", help="picture of the search and of the margins")
    add_force(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Find bounds, write the model with them and describe them; return the exit code."""
    with swift_imports():
        import numpy as np

        from jaxbound.cli.tune_summary import (
            is_unfinished,
            optimizer,
            plain_factors,
            plain_tuning,
            show_factors,
            show_tuning,
            tuned_text,
        )
        from jaxbound.cli.window import recorded, stated_model, window_relations
        from jaxbound.files.whole import whole
        from jaxbound.plots.canvas import to_png
        from jaxbound.plots.tune import plot_tuning
        from jaxbound.recordings.read import read
        from jaxbound.runs.outputs import refuse_targets
        from jaxbound.studies.identification.outliers import refuse_outliers
        from jaxbound.studies.tuning.tuning import MonitorTuneResult, TuneResult, tune

    state = args.out.with_name(args.out.name + ".state.npz")
    files = [*args.healthy, *args.faulty]
    inputs = [args.model, *files]
    goes_on = state.exists() and is_unfinished(args.out)
    refuse_targets({"--out": args.out, "--plot": args.plot}, inputs, args.force or goes_on)
    refuse_targets({"the state of --out,": state}, inputs, force=True)
    chosen = None
    if args.bounds is not None:
        chosen = [name.strip() for name in args.bounds.split(",")]
    options = MethodOptions.of(args)
    steps = args.steps
    if steps is None:
        steps = STEPS
    with door(), progress_bars(("read", "relations", "tune")) as step:
        model = stated_model(args.model, args.every)
        columns = recorded(model, options)
        text = args.model.read_text(encoding="utf-8-sig")
        recordings = []
        for i, file in enumerate(files):
            report = partial(in_part, partial(step, "read"), i / len(files), 1 / len(files))
            recordings.append(read(file, columns, report))
        some_device()
        longest = int(np.argmax([recording.samples for recording in recordings]))
        samples = recordings[longest].samples
        model, relations = window_relations(model, options, files[longest], samples, step)
        healthy = recordings[: len(args.healthy)]
        records = [(r.u[:, : model.m], r.y, r.starts) for r in healthy]
        notes = refuse_outliers(records, columns, ORDER, 1, lambda: healthy)
        faulty = recordings[len(args.healthy) :] or None
        if relations.parts:
            _refuse_search(args)
        tuning: TuneResult | MonitorTuneResult = tune(
            cast("Tunable", relations),  # or a monitor: --method names no other kind
            healthy,
            faulty,
            optimizer(args.optimizer or "adam", steps),
            steps,
            bounds=chosen,
            safety=args.safety,
            calibrate=args.calibrate,
            progress=lambda share: step("tune", share),
            state=None if relations.parts else state,
        )
        with whole(args.out) as f:
            f.write(tuned_text(tuning, text))
        if args.plot and isinstance(tuning, TuneResult):
            with whole(args.plot) as f:
                f.write(to_png(plot_tuning(tuning)))
    hints = notes + [f"{file}: {hint}" for file, r in zip(files, recordings, strict=True) for hint in r.hints]
    if isinstance(tuning, MonitorTuneResult):
        if args.json:
            write(json_text(plain_factors(tuning, args.out, hints)))
        else:
            show_factors(tuning, [str(args.out)], hints)
        return OK
    if args.json:
        write(json_text(plain_tuning(tuning, args.out, hints)))
    else:
        written = [str(args.out)]
        if args.plot:
            written.append(str(args.plot))
        show_tuning(tuning, args.healthy, written, hints)
    if tuning.stopped:
        say(
            f"stopped after {tuning.steps} of {steps} steps: {args.out} has the best bounds until then; "
            f"the same command goes on"
        )
        return INTERRUPTED
    state.unlink(missing_ok=True)
    return OK


def _refuse_search(args: argparse.Namespace) -> None:
    """Refuse options of a search for several bounds: a test of a monitor has one factor.

    Raises:
        Refused: one of them is asked for.
    """
    asked = {
        "--steps": args.steps,
        "--optimizer": args.optimizer,
        "--bounds": args.bounds,
        "--plot": args.plot,
    }
    for option, value in asked.items():
        if value:
            raise Refused(
                f"{option} is for one test: the model states tests, and each gets one factor; ask for one "
                f"test by --horizon, --lags or --method, or leave {option} out"
            )
