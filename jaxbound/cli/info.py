"""The command `jaxbound info`: what a model file says, and what can be detected and isolated with it."""

import argparse
import json

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import MethodOptions, add_windows, path
from jaxbound.cli.terminal import OK, Refused, door, progress_bars, write

NAME = "info"
HELP = "show what a model file says and what can be tested"
EXAMPLES = (
    ("jaxbound info --template > plant.toml", "a commented model file to fill in"),
    ("jaxbound info plant.toml", "what it says, its relations, what can be detected and told apart"),
    ("jaxbound info plant.toml --json", "the same for programs"),
)
CODES = "exit codes: 0, or 2 bad input"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the arguments and options."""
    parser.add_argument("model", type=path, nargs="?", metavar="MODEL.toml", help="the model file to show")
    parser.add_argument("--template", action="store_true", help="print a commented model file")
    add_windows(parser)
    parser.add_argument("--json", action="store_true", help="the same as JSON on stdout, nothing else")


def run(args: argparse.Namespace) -> int:
    """Print the template, or describe a model; return the exit code."""
    with swift_imports():
        from jaxbound.cli.model_summary import plain_model, show_model
        from jaxbound.cli.window import parity_windows
        from jaxbound.diagnosis.monitoring import monitor
        from jaxbound.models.modelfile import load_model
        from jaxbound.models.template import template
        from jaxbound.runs.relations import is_monitored

    if args.template == (args.model is not None):
        raise Refused("jaxbound info needs either a model file or --template")
    if args.template:
        write(template())
        return OK
    with door(), progress_bars(("relations",)) as step:
        model = load_model(args.model)
        bank = None
        if is_monitored(model, "joint", args.horizon, args.lags):
            bank = monitor(model)
        model, relations = parity_windows(model, MethodOptions.of(args), args.model, None, step)
    if args.json:
        text = json.dumps(plain_model(model, relations, bank), indent=1, allow_nan=False, ensure_ascii=False)
        write(text + "\n")
        return OK
    show_model(model, relations, bank)
    return OK
