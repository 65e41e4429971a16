"""The command `jaxbound example`: recordings to try the other commands on."""

import argparse
from pathlib import Path

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import Options
from jaxbound.cli.terminal import OK, Refused, door, show, some_device

NAME = "example"
HELP = "write recordings to try the other commands on"
EXAMPLES = (
    ("jaxbound example", "which examples there are"),
    ("jaxbound example heater", "writes heater/healthy_1.csv and others"),
)
CODES = "exit codes: 0, or 2 bad input"
OPTIONS = Options(
    {
        "name [NAME]": "heater or tank; without it, the examples are listed",
        "--out DIR": "folder for the files (default: one of that name)",
    }
)


def run(args: argparse.Namespace) -> int:
    """List the examples, or write one into a folder; return the exit code."""
    with swift_imports():
        from jaxbound.cli.examples import EXAMPLES as EXAMPLE_SETS
        from jaxbound.runs.outputs import output_folder

    if args.name is None:
        table = [(name, example.about) for name, example in EXAMPLE_SETS.items()]
        show("examples", "bold", table, text="\njaxbound example heater writes its files into heater/")
        return OK
    if args.name not in EXAMPLE_SETS:
        raise Refused(f"there is no example {args.name!r}: choose one of {', '.join(EXAMPLE_SETS)}")
    example = EXAMPLE_SETS[args.name]
    out = args.out or Path(args.name)
    with door(), output_folder(out, list(example.files)) as folder, folder.work() as work:
        some_device()
        example.write(work)
    first = f"\ntry:\n  cd {out}\n  {example.first}"
    show(f"{args.name}: {example.about}, in {out}", "bold", example.files.items(), text=first)
    return OK
