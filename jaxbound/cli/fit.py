"""The command `jaxbound fit`: from recordings to a model file, and the picture of a fit."""

import argparse
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import (
    add_every,
    add_force,
    add_json,
    add_safety,
    add_windows,
    observer_name,
    path,
    share,
    whole_number,
)
from jaxbound.cli.terminal import OK, door, progress_bars, some_device, write
from jaxbound.estimation.methods import OBSERVERS
from jaxbound.text.quantities import decimal

if TYPE_CHECKING:
    from jaxbound.recordings.recording import Recording

NAME = "fit"
HELP = "find a model and its bounds from healthy recordings"
EXAMPLES = (
    ("jaxbound fit healthy.csv --inputs heater --outputs T1,T2 --out plant.toml", "signals are columns"),
    (
        "jaxbound fit a.csv b.csv --inputs 'Q=Heater 1' --outputs 'lift=`T out`-`T room`' --where 'fan > 0' "
        "--out plant.toml",
        "names for columns, a signal computed from columns, only while the fan runs",
    ),
)
CODES = (
    "exit codes: 0, 2 bad input or usage, 70 internal error, 130 interrupted, 129 by SIGHUP, 143 by SIGTERM "
    "(nothing is written)"
)


def whole_or_auto(least: int) -> Callable[[str], int | str]:
    """Return a reader of whole numbers, or auto."""
    number = whole_number(least, 1000)

    def read(text: str) -> int | str:
        if text == "auto":
            return text
        return number(text)

    return read


def weight_or_auto(text: str) -> float | str:
    """Return a number >= 0, or auto."""
    if text == "auto":
        return text
    try:
        number = decimal(text)
    except ValueError:
        number = -1.0
    if not 0 <= number < math.inf:
        raise argparse.ArgumentTypeError(f"needs a number >= 0, or auto, not {text!r}")
    return number


def options(parser: argparse.ArgumentParser) -> None:
    """Add the arguments and options."""
    parser.add_argument(
        "data",
        type=path,
        nargs="+",
        metavar="DATA",
        help="healthy recordings: CSV files, Parquet files or folders",
    )
    parser.add_argument(
        "--inputs",
        default="",
        metavar="A,B",
        help="columns; or name=column, or name=expression like lift=Tsup-Tmix; names with commas or = in "
        "backticks or double quotes",
    )
    parser.add_argument(
        "--outputs", required=True, metavar="C,D", help="as --inputs: what the model is to explain"
    )
    parser.add_argument(
        "--signals",
        choices=("auto",),
        help="auto: choose inputs by recordings that are left out: drop one, add a square or a product of "
        "two, computed from the columns",
    )
    parser.add_argument(
        "--order",
        type=whole_or_auto(0),
        default=2,
        metavar="N",
        help="samples back that determine the next one; 0: none, a static plant; auto: 1 to 4, "
        "by recordings that are left out (default: 2)",
    )
    parser.add_argument(
        "--delay",
        type=whole_or_auto(1),
        default=1,
        metavar="N",
        help="samples until inputs act, the dead time; auto: of 1 to 8, likewise (default: 1)",
    )
    bounded = "bounds are found for windows of S + 1 samples (default: chosen, see --test)"
    add_windows(parser, bounded, least=1)
    parser.add_argument("--direct", action="store_true", help="inputs act on outputs of the same sample")
    parser.add_argument(
        "--where",
        metavar="EXPR",
        help="condition on columns: samples where it does not hold are no part of the recording",
    )
    parser.add_argument(
        "--time", metavar="COLUMN", help="of the time stamps (default: a column that looks like time)"
    )
    parser.add_argument(
        "--dt", type=decimal, metavar="SECONDS", help="sampling period (default: the median step of the time)"
    )
    add_every(parser, "as recorded")
    add_safety(parser)
    parser.add_argument(
        "--held-out",
        type=share,
        default=0.3,
        metavar="F",
        help="of a single recording, the share that a block holds: its blocks, or several recordings, are "
        "left out in turn, and bounds as wide as a fit to the others asks for; 0: nothing (default: 0.3)",
    )
    parser.add_argument(
        "--method",
        default="auto",
        help="auto, least squares, windows, or filters (fast given dynamics: no error hides)",
    )
    parser.add_argument(
        "--observer",
        type=observer_name,
        choices=tuple(OBSERVERS),
        metavar="NAME",
        help=f"bounds for a set observer, in place of windows, or beside them by --test bank: "
        f"{', '.join(OBSERVERS)}",
    )
    parser.add_argument(
        "--disturbances",
        choices=("auto",),
        help="auto: bound process noise and offsets that drift, too: those under which the smallest fault is "
        "seen",
    )
    parser.add_argument(
        "--see",
        metavar="F,F",
        help="faults that --disturbances is chosen for, like T1:bias:2,T2:drift:0.05 (size; drift a sample; "
        "default: biases of each output); biases of several outputs: their bounds are in this ratio",
    )
    parser.add_argument(
        "--average",
        type=whole_number(2),
        metavar="N",
        help="bound the mean of N errors in a row too: lasting errors show smaller",
    )
    parser.add_argument(
        "--follow",
        type=weight_or_auto,
        default=0.0,
        metavar="W",
        help="bounds follow the operating point: times sqrt(1 + W * squared distance of the inputs from "
        "training); auto: 0, .1 or .3, by recordings that are left out (default: 0)",
    )
    parser.add_argument(
        "--test",
        choices=("auto", "bank"),
        help="bank: windows of 8, 16, 31 or 61 samples, means, lags, all that see what others miss, by "
        "recordings that are left out, as [[test]] tables of one monitor, and an observer by --observer or "
        "--disturbances; auto: the best of these windows alone (default: bank, unless --horizon, --lags, "
        "--average, --observer or --follow say what is tested, or nothing can be left out)",
    )
    parser.add_argument(
        "--out", type=path, required=True, metavar="MODEL.toml", help="the model file to write"
    )
    parser.add_argument("--name", metavar="NAME", help="of the plant (default: that of the model file)")
    parser.add_argument(
        "--plot", type=path, metavar="PNG", help="picture: how much of the bounds each window needs"
    )
    add_force(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Fit a model to recordings, write and describe it; return the exit code."""
    with swift_imports():
        from jaxbound.cli.fit_summary import named_units, plain_fit, show_fit, signal_columns
        from jaxbound.cli.tradeoff_table import wanted
        from jaxbound.files.whole import whole
        from jaxbound.models.modelfile import model_text
        from jaxbound.plots.canvas import to_png
        from jaxbound.plots.fit import plot_fit
        from jaxbound.recordings.read import read_signals
        from jaxbound.runs.outputs import refuse_targets
        from jaxbound.studies.identification.fitting import fit
        from jaxbound.studies.identification.signal_choice import products

    refuse_targets({"--out": args.out, "--plot": args.plot}, args.data, args.force)
    with door(), progress_bars(("read", "fit")) as step:
        inputs = signal_columns("--inputs", args.inputs)
        outputs = signal_columns("--outputs", args.outputs)
        inputs, outputs, units = named_units(inputs, outputs)
        see = wanted(args.see or "")
        about = {}
        if args.time:
            about["time"] = args.time
        if args.where:
            about["where"] = args.where
        if args.every:
            about["every"] = args.every
        named = {}
        for signal in inputs + outputs:
            if not isinstance(signal, str):
                named[signal[0]] = signal[1]
        names = [signal if isinstance(signal, str) else signal[0] for signal in inputs]
        read = list(inputs)
        if args.signals:
            read += products(names, named).items()
        recordings = read_signals(args.data, read, outputs, about, args.dt, lambda share: step("read", share))
        some_device()
        model = fit(
            recordings,
            args.order,
            args.horizon,
            lags=args.lags,
            inputs=names,
            outputs=[signal if isinstance(signal, str) else signal[0] for signal in outputs],
            delay=args.delay,
            direct=args.direct,
            safety=args.safety,
            held_out=args.held_out,
            method=args.method,
            average=args.average,
            test=args.test,
            observer=args.observer,
            follow=args.follow,
            disturbances=args.disturbances,
            see=see,
            signals=args.signals,
            name=args.name or args.out.stem,
            progress=lambda share: step("fit", share),
            units=units,
            columns=about | named,
        )
        with whole(args.out) as f:
            f.write(model_text(model).encode())
        if args.plot:
            with whole(args.plot) as f:
                f.write(to_png(plot_fit(model)))
    hints = _hints(args.data, recordings)
    if args.json:
        summary = plain_fit(model, args.data, args.out, args.average, hints)
        write(json.dumps(summary, indent=1, allow_nan=False) + "\n")
    else:
        files = [str(args.out)]
        if args.plot:
            files.append(str(args.plot))
        show_fit(model, args.data, files, hints, args.observer)
    return OK


def _hints(data: Sequence[Path], recordings: Sequence["Recording"]) -> list[str]:
    """Return the hints of recordings, each once; of several recordings with the file that it is about."""
    hints = []
    for file, recording in zip(data, recordings, strict=True):
        for hint in recording.hints:
            hints.append(hint if len(recordings) == 1 else f"{file}: {hint}")
    return list(dict.fromkeys(hints))
