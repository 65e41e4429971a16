"""The command `jaxbound verify`: whether a certificate proves what it says of a model and a recording."""

import argparse
import json

from jaxbound.certificates.checker.script import CONFIRMED, NOT_CONFIRMED, REFUSED, load
from jaxbound.certificates.verification import verify, window_of
from jaxbound.cli.terminal import door, say, show
from jaxbound.models.modelfile import load_model
from jaxbound.recordings.read import open_source

__all__ = ["run"]


def run(args: argparse.Namespace) -> int:
    """Run `jaxbound verify CERTIFICATE.json --model MODEL.toml --data DATA`; return the exit code: 0
    confirmed, 1 not confirmed.

    Only the samples of the window are read (a CSV file: all).
    """
    with door():
        model = load_model(args.model)
        source = open_source(args.data, model)
    try:
        document = load(args.certificate)
        _, last, count = window_of(document)
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
