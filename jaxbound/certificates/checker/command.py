"""The checker as a command of its own, beside `jaxbound verify`: other readers, the same check."""

import argparse
import json
import sys
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

from jaxbound.certificates.checker.claim import DOUBLE, SINGLE, claim_of
from jaxbound.certificates.checker.files import read_model, read_samples
from jaxbound.certificates.checker.proof import confirm
from jaxbound.certificates.checker.sets import decide
from jaxbound.certificates.checker.words import Document, Matrix, Samples, insist

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
        help="of the time, where the model names none (default: the one that looks like it, if there is one)",
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


def load(path: Path) -> Document:
    """Return a certificate from a JSON file.

    Raises:
        OSError: no such file. ValueError: not JSON, a field twice.
    """

    def once(pairs: list[tuple[str, Any]]) -> Document:
        fields = dict(pairs)
        insist(len(fields) == len(pairs), "a field stands twice in it")
        return fields

    document = json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=once)
    insist(isinstance(document, dict) and "certificate" in document, "this is no certificate")
    return cast(Document, document)


def against(
    document: Document,
    model: Document,
    u: Samples,
    y: Samples,
    precision: str,
    names: Document,
    first: Matrix | None = None,
    factors: Matrix | None = None,
) -> None:
    """Raise an exception unless a certificate proves what it says of a model and of samples: see `confirm`.

    Either verdict may look at every sample although the model has lags: a FAULT then rests on more of them, a
    CONSISTENT explains more, and its statement says so. A FAULT may do without averages: what fewer bounds
    contradict, all of them do.

    Args:
        model, u, y, precision, first, factors: as of `claim_of`. names: of the certificate.
    """
    numbers, lags = document["numbers"], None
    if "lags" in numbers:
        lags = model["lags"]
        insist(
            lags is not None,
            "the certificate looks at some samples only, the model at all: give tested_model.toml of the "
            "report",
        )
    if document["certificate"] == "FAULT" and not {"averages", "lags"} & set(numbers):
        model = {**model, "averages": []}
    confirm(document, names, claim_of(model, u, y, precision, lags, first, factors))


def _check(document: Document, args: argparse.Namespace) -> None:
    """Raise an exception unless a certificate proves what it says of a model file and a CSV file."""
    if "question" in document:
        return decide(document)
    insist(
        args.model is not None and args.data is not None,
        "a certificate of a window is checked against --model and --data",
    )
    model = read_model(args.model, document.get("test"))
    document = {name: value for name, value in document.items() if name != "test"}
    sample, shown = document["names"]["sample"], document["names"]["times"]
    last = sample
    if isinstance(sample, list) and len(sample) == 1:
        last = sample[0]
    insist(type(last) is int and last >= 0, f"it names no sample of one recording: {sample}")
    insist(
        "first_state" not in document["numbers"],
        "bounds of a first state are neither in the model nor in the data: check it in Python",
    )
    model = model._replace(time=args.time or model.time)
    rows, times = read_samples(args.data, model, last, len(document["numbers"]["y"]), args.precision)
    insist(shown is None or times is not None, "the certificate shows times: name their column by --time")
    names = model.names | {"sample": sample, "times": None}
    if shown is not None and times is not None:
        names["times"] = _shown_times(shown, times, model.dt)
    m = len(model.numbers["offset_u"])
    u, y = [row[:m] for row in rows], [row[m:] for row in rows]
    against(document, model.numbers, u, y, args.precision, names)


def _shown_times(shown: list[str], times: list[str], dt: Fraction) -> list[str]:
    """Return the times as they are shown where each is that of the data, else those of the data."""
    if len(shown) != len(times):
        return times
    for one, other in zip(shown, times, strict=True):
        if one != other and not _same_seconds(one, other, dt):
            return times
    return shown


def _same_seconds(shown: str, time: str, dt: Fraction) -> bool:
    """Return whether a text such as "12.5 s" is a time of the data, which a report may have rounded."""
    return shown.endswith(" s") and abs(Fraction(shown[:-2]) - Fraction(time)) <= dt / 100
