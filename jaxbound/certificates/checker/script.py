"""The checker as a command of its own, beside `jaxbound verify`: other readers, the same check."""

import argparse
import json
import sys
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

from jaxbound.certificates.checker.claim import DOUBLE, SINGLE, claimed
from jaxbound.certificates.checker.files import read_model, read_samples
from jaxbound.certificates.checker.proof import confirm
from jaxbound.certificates.checker.trajectories import insist

__all__ = ["fewer_averages", "load", "main", "stated_lags"]

REFUSED = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
CONFIRMED, NOT_CONFIRMED, BAD_USAGE = 0, 1, 2


def main(argv: Sequence[str]) -> int:
    """Check certificates against a model file and a CSV file; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="checker", description="Check certificates with Python's standard library alone."
    )
    parser.add_argument("certificate", type=Path, nargs="+", metavar="CERTIFICATE.json")
    parser.add_argument(
        "--model",
        type=Path,
        metavar="MODEL.toml",
        help="the plant and its bounds; not for questions about sets",
    )
    parser.add_argument(
        "--data", type=Path, metavar="RUN.csv", help="the recording; not for questions about sets"
    )
    parser.add_argument(
        "--time",
        metavar="COLUMN",
        help="of the time stamps, where the model names none and the certificate shows times",
    )
    parser.add_argument(
        "--precision",
        choices=(DOUBLE, SINGLE),
        default=DOUBLE,
        help="float type of the samples (default: %(default)s)",
    )
    args = parser.parse_args(argv)
    code = CONFIRMED
    for path in args.certificate:
        try:
            document = load(path)
            _check(document, args)
        except OSError as e:
            print(f"{e.filename}: {e.strerror}", file=sys.stderr)
            return BAD_USAGE
        except REFUSED as e:
            print(f"{path}: NOT confirmed: {e}", file=sys.stderr)
            code = NOT_CONFIRMED
        else:
            print(f"{path}: confirmed: {document['certificate']}. {document['statement']}")
    return code


def load(path: Path) -> dict[str, Any]:
    """Return a certificate from a JSON file.

    Raises:
        OSError: no such file. ValueError: not JSON, a field twice.
    """

    def once(pairs):
        insist(len({name for name, _ in pairs}) == len(pairs), "a field stands twice in it")
        return dict(pairs)

    document = json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=once)
    insist(isinstance(document, dict) and "certificate" in document, "this is no certificate")
    return document


def stated_lags(document: dict[str, Any], model: dict[str, Any]) -> Sequence[int] | None:
    """Return the lags that a certificate is about: those of the model, or None where it looks at every
    sample, which either verdict may.

    A FAULT then rests on more samples than the model's lags, a CONSISTENT explains more of them, and its
    statement says so.
    """
    if "lags" not in document["numbers"]:
        return None
    insist(
        model["lags"] is not None,
        "the certificate looks at some samples only, the model at all: give tested_model.toml of the report",
    )
    return model["lags"]


def fewer_averages(document: dict[str, Any], model: dict[str, Any]) -> dict[str, Any]:
    """Return the model without its averages where a FAULT does without them: what fewer bounds contradict,
    all of them do.
    """
    unused = document["certificate"] == "FAULT" and not {"averages", "lags"} & set(document["numbers"])
    return {**model, "averages": []} if unused else model


def _check(document, args):
    if "question" in document:
        return confirm(document)
    insist(
        args.model is not None and args.data is not None,
        "a certificate of a window is checked against --model and --data",
    )
    model, names, columns, time, dt = read_model(args.model)
    sample, shown = document["names"]["sample"], document["names"]["times"]
    last = sample[-1] if isinstance(sample, list) and len(sample) == 1 else sample
    insist(type(last) is int and last >= 0, f"it names no sample of one recording: {sample}")
    time = args.time or time
    insist(shown is None or time is not None, "the certificate shows times: name their column by --time")
    insist(
        "first_state" not in document["numbers"],
        "bounds of a first state are neither in the model nor in the data: check it in Python",
    )
    rows, times = read_samples(
        args.data, columns, time, dt, last, len(document["numbers"]["y"]), args.precision
    )
    m = len(model["offset_u"])
    u, y = [row[:m] for row in rows], [row[m:] for row in rows]
    claim = claimed(fewer_averages(document, model), u, y, args.precision, stated_lags(document, model))
    names |= {"sample": sample, "times": None if shown is None else _labels(shown, times, dt)}
    return confirm(document, names, claim)


def _labels(shown, times, dt):
    """Return the times as they are shown where each is that of the data, as text or as a number of seconds,
    else those of the data.
    """
    if len(shown) != len(times):
        return times
    for one, other in zip(shown, times, strict=True):
        if one != other and not (
            one.endswith(" s") and abs(Fraction(one[:-2]) - Fraction(other)) <= dt / 100
        ):
            return times
    return shown
