"""The command `jaxbound explain`: the certificate of one window of a report, for people and as JSON.

Only the samples of that window are read again (a CSV file: all), tested as they were, and proved anew in
exact rationals.
"""

import argparse

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import Options
from jaxbound.cli.terminal import LOUDNESS, OK, VERBOSE, Refused, door, progress_bars, show, write

NAME = "explain"
HELP = "print the certificate of one window"
EXAMPLES = (
    (
        "jaxbound explain report/ --at 60",
        "the window that ends at sample 60: the relation it violates, or what explains it",
    ),
    (
        "jaxbound explain report/ --at '2026-03-01 12:00:07' --all",
        "by its time, with every coefficient and every sample",
    ),
    (
        "jaxbound explain report/ --at 60 --cause --faults plant.toml",
        "which of the faults named in plant.toml alone explain it, and how large they are at least",
    ),
)
CODES = "exit codes: 0, or 2 bad input"
OPTIONS = Options(
    {
        "report DIR": "folder that jaxbound detect wrote",
        "--at TIME": "sample at which the window ends: its number, like 60, or its time, like 180s (with the "
        "s) or 2026-03-01T12:00:07",
        "--all": "every coefficient, and a row for each sample (-v does the same)",
        "--faults MODEL.toml": "weigh the faults that this model file names ([[fault]]); default: those of "
        "the tested model, or a bias of every sensor and an offset of every actuator",
        "--test NAME": "of a monitor: the test to ask, by default the one that spoke",
        "--cause": "the faults that alone explain a FAULT window and those that are excluded, nothing else; "
        "with --json as JSON",
    },
    required=("at",),
    more={"--json": "the certificate as JSON on stdout, nothing else"},
)


def run(args: argparse.Namespace) -> int:
    """Print a certificate and write it to DIR/certificate-SAMPLE.json; return the exit code.

    With --json, that JSON is printed and nothing is written.
    """
    with swift_imports():
        from jaxbound.cli.cause import cause_of, cause_text, show_cause
        from jaxbound.cli.certificate_text import certificate_text
        from jaxbound.cli.explanation import explain_window
        from jaxbound.relations.sentence import main_terms
        from jaxbound.runs.outputs import output_folder

    with door(), progress_bars(("relations", "proof")) as step:
        explained = explain_window(args.report, args.at, step, args.test)
        if not args.cause and not args.json:
            explained.certificate.work_out(lambda share: step("proof", share))
    with door():
        certificate, k, labels = explained.certificate, explained.sample, explained.labels
        if args.cause:
            show_cause(cause_of(certificate, k, args.faults), labels, args.json)
            return OK
        text = certificate.to_json(labels, k)
    if args.json:
        write(text + "\n")
        return OK
    file = args.report / f"certificate-{k}.json"
    try:
        with door(OSError), output_folder(args.report) as folder, folder.work() as work:
            (work / file.name).write_text(text + "\n", encoding="utf-8")
    except Refused as e:
        raise Refused(f"{e}; --json prints the certificate instead") from e
    headline, rows, table = certificate_text(certificate, k, labels, explained.outgrown)
    if certificate.test:
        rows.insert(0, ("test", certificate.test))
    is_whole = args.all or LOUDNESS.get() == VERBOSE
    if not is_whole:
        rows = [(name, main_terms(text)) for name, text in rows]
        rest = f"--all: every coefficient, and what the {len(labels)} samples say, {len(table) - 1} rows"
        rows.append(("all of it", rest))
    with door():
        rows = [*cause_text(certificate, k, args.faults), *rows]
    if explained.training:
        rows.append(("training", explained.training))
    if explained.ambiguity:
        rows.insert(0, ("asked for", explained.ambiguity))
    rows.append(("certificate", str(file)))
    show(headline, "bold", rows, table if is_whole else (), last=True)
    return OK
