"""The command `jaxbound demo`: the example of a paper, from model and data to a report."""

import argparse
from pathlib import Path

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import Options, whole_number

NAME = "demo"
HELP = "run the example of a paper and write its report"
EXAMPLES = (
    (
        "jaxbound demo --out demo-report",
        "the example of a paper, with false alarms and detection rates counted",
    ),
)
CODES = "exit code: 0"
OPTIONS = Options(
    {
        "--out DIR": "folder for the report (default: demo-report)",
        "--runs N": "runs to count detection rates on (default: 500)",
    },
    {"runs": whole_number(1, 10**7)},
    {"out": Path("demo-report"), "runs": 500},
)


def run(args: argparse.Namespace) -> int:
    """Simulate the example, test it and write its report; return the exit code."""
    with swift_imports():
        from jaxbound.cli.demonstration import demonstrate
    return demonstrate(args.out, args.runs)
