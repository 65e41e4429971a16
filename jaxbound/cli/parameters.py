"""The command `jaxbound parameters`: values of constant parameters that can explain a whole recording."""

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import (
    MethodOptions,
    add_every,
    add_force,
    add_json,
    add_windows,
    path,
    share,
    whole_number,
)
from jaxbound.cli.terminal import INTERRUPTED, OK, door, json_text, progress_bars, show, some_device, write

if TYPE_CHECKING:
    from jaxbound.estimation.parameter_set import ParameterSet

NAME = "parameters"
HELP = "narrow the bounds of constant parameters by a recording, losing no value that explains it"
EXAMPLES = (
    (
        "jaxbound parameters plant.toml healthy.csv --out narrowed.toml",
        "the bounds of [[uncertainty]] with varying = false, narrowed by all windows of healthy.csv",
    ),
    (
        "jaxbound parameters plant.toml run.csv --horizon 4 --plot parameters.png",
        "longer windows leave fewer values; a picture of each pair of parameters",
    ),
)
CODES = (
    "exit codes: 0 some values are left, 1 fault found: no values explain all windows, 2 bad input, "
    "70 internal error, 130 interrupted (what is left until then is shown)"
)
FAULTY = 1


def options(parser: argparse.ArgumentParser) -> None:
    """Add the arguments and options."""
    parser.add_argument(
        "model", type=path, metavar="MODEL.toml", help="with [[uncertainty]], varying = false"
    )
    parser.add_argument("data", type=path, metavar="DATA", help="one recording: CSV or Parquet")
    parser.add_argument(
        "--out", type=path, metavar="NARROWED.toml", help="the model with its bounds narrowed to the hull"
    )
    parser.add_argument("--plot", type=path, metavar="PNG", help="picture of each pair of parameters")
    add_every(parser)
    add_windows(parser)
    parser.add_argument(
        "--precision",
        type=share,
        default=1 / 32,
        metavar="F",
        help="boxes are not cut below this share of the hull (default: 1/32)",
    )
    parser.add_argument(
        "--budget",
        type=whole_number(1),
        default=20_000,
        metavar="N",
        help="boxes that are judged at most (default: 20 000)",
    )
    add_force(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Narrow the bounds of parameters and describe them; return the exit code."""
    with swift_imports():
        from jaxbound.cli.window import parity_windows, stated_model
        from jaxbound.estimation.parameter_search import STOPPED
        from jaxbound.estimation.parameters import parameters
        from jaxbound.files.whole import whole
        from jaxbound.models.modelfile import model_text
        from jaxbound.plots.canvas import to_png
        from jaxbound.plots.parameters import plot_parameters
        from jaxbound.recordings.read import read
        from jaxbound.runs.outputs import refuse_targets

    refuse_targets({"--out": args.out, "--plot": args.plot}, [args.model, args.data], args.force)
    with door(), progress_bars(("read", "relations", "parameters")) as step:
        model = stated_model(args.model, args.every)
        recording = read(args.data, model, lambda share: step("read", share))
        some_device()
        about = MethodOptions.of(args), args.data, recording.samples, step
        model, relations = parity_windows(model, *about)
        left = parameters(
            relations,
            recording,
            precision=args.precision,
            budget=args.budget,
            progress=lambda share: step("parameters", share),
        )
        written = []
        if args.out and len(left.lo):
            with whole(args.out) as f:
                f.write(model_text(left.model).encode())
            written.append(str(args.out))
        if args.plot:
            with whole(args.plot) as f:
                f.write(to_png(plot_parameters(left)))
            written.append(str(args.plot))
    if args.json:
        write(json_text(_plain(left, written, recording.hints)))
    else:
        _show(left, written, recording.hints, recording.label)
    if left.status == STOPPED:
        return INTERRUPTED
    if len(left.lo):
        return OK
    return FAULTY


def _plain(left: "ParameterSet", written: list[str], hints: tuple[str, ...]) -> dict[str, object]:
    """Return the outcome as JSON has it."""
    return {
        "status": left.status,
        "parameters": {
            name: {"bounds": left.bounds[name], "hull": left.hull.get(name)} for name in left.names
        },
        "share": left.share,
        "boxes": len(left.lo),
        "evaluated": left.evaluated,
        "windows": left.windows,
        "refuted": {str(sample): boxes for sample, boxes in left.refuted.items()},
        "written": written,
        "hints": list(hints),
    }


def _show(
    left: "ParameterSet", written: list[str], hints: tuple[str, ...], label: Callable[[int], str]
) -> None:
    """Print the outcome."""
    headline = f"FAULT proved: no values of {', '.join(left.names)} explain all {left.windows} windows"
    table = None
    if len(left.lo):
        headline = (
            f"{', '.join(left.names)}: every value that explains all {left.windows} windows is in these "
            f"bounds"
        )
        table = [("parameter", "at least", "at most", "before")]
        for name, (lo, hi) in left.hull.items():
            before = "{:g} to {:g}".format(*left.bounds[name])
            table.append((name, f"{lo:.6g}", f"{hi:.6g}", before))
    rows = [("left", f"{100 * left.share:.3g} % of the volume, in {len(left.lo)} boxes; {left.status}")]
    if left.refuted:
        sample, boxes = next(iter(left.refuted.items()))
        rows.append(("refuted most", f"the window that ends at {label(sample)}: {boxes} boxes"))
    rows += [("hint", hint) for hint in hints]
    rows += [("written", file) for file in written]
    show(headline, "bold", rows, table)
