"""The command `jaxbound verify`: whether a certificate proves its statement of a model and a recording."""

import argparse
import json

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import Options, reading
from jaxbound.cli.terminal import door, say, show

NAME = "verify"
HELP = "check a certificate against a model and a recording, in exact fractions"
EXAMPLES = (
    (
        "jaxbound verify report/certificate-60.json --model report/tested_model.toml --data run.csv",
        "inequalities built anew from model and samples, in exact fractions",
    ),
)
CODES = (
    "exit codes: 0 confirmed, 1 not confirmed: it proves nothing, or something else than of this model and "
    "these data, and the sentence says what differs; 2 bad input or usage"
)
OPTIONS = Options(
    {
        "certificate CERTIFICATE.json": "that jaxbound explain wrote",
        "--model MODEL.toml": "the plant and its bounds: DIR/tested_model.toml where options of the report "
        "changed its window",
        "--data DATA": "the recording: a CSV file, a Parquet file or a folder",
        **reading(),
    },
    required=("model", "data"),
)


def run(args: argparse.Namespace) -> int:
    """Check a certificate; return the exit code: 0 confirmed, 1 not confirmed.

    Only the samples of the window are read (a CSV file: all).
    """
    with swift_imports():
        from jaxbound.certificates.checker.command import CONFIRMED, NOT_CONFIRMED, REFUSED, load
        from jaxbound.certificates.verification import named_window, of_test, verify
        from jaxbound.cli.window import stated_model
        from jaxbound.recordings.read import open_source
        from jaxbound.runs.ask import Ask

    with door():
        model = stated_model(args.model, args.recording, Ask())
    try:
        document = load(args.certificate)
        _, tested = of_test(document, model)
        with door():
            source = open_source(args.data, tested.recorded)
        _, last, count = named_window(document)
        begin = last + 1 - count
        if begin < 0 or (source.samples is not None and last >= source.samples):
            raise ValueError(
                f"{args.data} has no {count} samples that end at sample {last}: it has {source.samples}, "
                f"numbered from 0"
            )
        with door(OSError):
            part = source.read(begin, last + 1)
        verify(document, model, part, begin=begin)
    except json.JSONDecodeError as e:
        say(f"{args.certificate}: NOT confirmed: this is not JSON: {e}")
        return NOT_CONFIRMED
    except REFUSED as e:
        say(f"{args.certificate}: NOT confirmed: {e}")
        return NOT_CONFIRMED
    except OSError as e:
        with door():
            raise e
    show(f"confirmed: {document['certificate']}", "bold", [("proved", document["statement"])])
    return CONFIRMED
