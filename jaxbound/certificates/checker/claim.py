"""The claim of a certificate, built anew from a model and samples: no number of the certificate takes part.

A model is a dict of exact numbers, lists of them and names, as `plain.plain_model` makes it of a LinearSystem
and `files.read_model` of a file; nothing in it is rounded yet. Samples are s + 1 rows of numbers, None where
one is missing.

Bounds are rounded outward to the float type in which the samples were judged, as the judging kernels take
them: so a certificate of either verdict speaks of the same numbers.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction as F
from typing import Any, cast

from jaxbound.certificates.checker.words import Document, insist

DOUBLE, SINGLE = "float64", "float32"
PRECISIONS = {DOUBLE: (F(1, 2**53), F(1, 2**1022)), SINGLE: (F(1, 2**24), F(1, 2**126))}
"""Unit roundoff and smallest normal number of each float type."""
STATED = ("A", "B", "C", "D", "G", "F", "D_v", "offset_u", "offset_y")
"""Numbers of a model that a claim has as they are."""
BOUNDS = ("tolerance", "noise", "resolution", "disturbance")
"""Numbers of a model that a claim has rounded outward."""
LONGEST_EXPONENT = 5
"""Characters of an exponent: the digits of 1e-12345, written out, would be no work for a checker."""
PRIME = 2**127 - 1
"""Of a sum that shows whether a number was changed."""
RECORDER_ULPS = 4
"""A sample is known to so many unit roundoffs times the largest of its signal: see the argument `resolution`
of a LinearSystem.
"""


def claim_of(
    model: Document,
    u: Sequence[Sequence[F | None]],
    y: Sequence[Sequence[F | None]],
    precision: str = DOUBLE,
    lags: Sequence[int] | None = None,
    first: Sequence[Sequence[F]] | None = None,
    factors: Sequence[Sequence[F]] | None = None,
) -> Document:
    """Return the numbers of a certificate that are no part of its proof: those of the model, of its bounds
    and of the samples.

    Args:
        model: exact numbers. u, y: the samples, s + 1 rows each. precision: float type in which they were
            judged.
        lags: so many samples before its last the window looks at outputs; None: always. first: (lo, hi) of
            each first state, or None.
        factors: on the noise of each sample of each output, s + 1 rows; None: there are none.
    """
    unit, floor = PRECISIONS[precision]
    out: Document = {name: model[name] for name in STATED}
    for name in ("tolerance", "noise", "resolution"):
        out[name] = [rounded_up(x, precision) for x in model[name]]
    out["disturbance"] = []
    for lo, hi in model["disturbance"]:
        out["disturbance"].append([-rounded_up(-lo, precision), rounded_up(hi, precision)])
    out["recorder"], out["floor"] = RECORDER_ULPS * unit, floor
    out["u"], out["y"] = _inputs(model, u), _looked_at(y, lags)
    if factors is not None:
        insist(all(x >= 0 for row in factors for x in row), "a factor on a noise must be >= 0")
        out["factors"] = factors
    if lags is not None:
        out["lags"] = list(map(F, lags))
    if model["averages"]:
        out["averages"], out["runs"] = [], _runs(model, len(y), lags)
        for average in model["averages"]:
            out["averages"].append({**average, "bound": rounded_up(average["bound"], precision)})
        out["all_y"] = y
    if model["constant"] and any(out["tolerance"]):
        out["constant"] = F(1)
    if model["uncertainties"]:
        # a change of a matrix is half the width of its parameter, so that every |v| <= 1
        out["uncertainties"] = [{**parameter, "bound": F(1)} for parameter in model["uncertainties"]]
        out["variables"] = _variables(model, len(y))
    if first is not None:
        out["first_state"] = first
    return cast(Document, _listed(out))


def statement(verdict: str, names: Document, claim: Mapping[str, Any]) -> str:
    """Return the sentence that a certificate proves.

    Args: verdict: FAULT or CONSISTENT. names: of a certificate. claim: numbers, as `claim_of` returns them.
    """
    behaviour = "a behaviour"
    if verdict == "FAULT":
        behaviour = "no behaviour"
    begins = ""
    if "first_state" in claim:
        begins = " and from a first state within its bounds"
    last = names["sample"]
    if not isinstance(last, int):
        last = ", ".join(map(str, last))
    window = f"the {len(claim['y'])} samples that end at sample {last}"
    if "lags" in claim:
        window += f", outputs looked at {', '.join(map(str, claim['lags']))} samples before the last"
    return f"{behaviour} of {names['model']} within its bounds{begins} explains {window}"


def checksum(every: Iterable[F]) -> F:
    """Return the sum of numbers, modulo a prime: the sum itself may have thousands of digits."""
    return F(sum(x.numerator * pow(x.denominator, -1, PRIME) for x in every) % PRIME)


def compare(shown: object, wanted: object, where: str = "numbers") -> None:
    """Raise ValueError naming the first difference between what a certificate shows and what model and
    samples make of it.
    """
    one, other = shown, wanted
    if isinstance(wanted, dict) and isinstance(shown, dict):
        for name, branch in wanted.items():
            insist(name in shown, f"{where}.{name} is missing")
            compare(shown[name], branch, f"{where}.{name}")
        if where == "numbers" or set(wanted) == set(shown):
            return  # the other numbers are of the proof
        one, other = sorted(shown), sorted(wanted)
    elif isinstance(wanted, list) and isinstance(shown, list):
        for i, (a, b) in enumerate(zip(shown, wanted, strict=False)):
            compare(a, b, f"{where}[{i}]")
        if len(wanted) == len(shown):
            return
        one, other = f"{len(shown)} entries", f"{len(wanted)} entries"
    elif type(shown) is type(wanted) and shown == wanted:
        return
    raise ValueError(
        f"the certificate is about something else: {where} is {_text(one)}, model and data say {_text(other)}"
    )


def numbers(tree: Document, every: list[F]) -> Document:
    """Return a tree of texts as one of Fractions, None as it is; append each number to `every`.

    Raises:
        ValueError: a leaf that is no exact text.
    """
    insist(isinstance(tree, dict), "the numbers of a certificate need names")
    return {name: _read(branch, every) for name, branch in tree.items()}


def _read(tree: object, every: list[F]) -> object:
    if isinstance(tree, dict):
        return numbers(tree, every)
    if isinstance(tree, list):
        return [_read(branch, every) for branch in tree]
    if tree is None:
        return None
    if not isinstance(tree, str):
        raise ValueError(f"a number must be exact text, not {tree!r}")
    # before Fraction reads it: writing 1e99999999 out would take all memory
    exponent = tree.lower().partition("e")[2]
    if len(exponent) > LONGEST_EXPONENT:
        raise ValueError(f"a number is too large or too small to be one of a recording: {tree[:40]}")
    every.append(F(tree))
    return every[-1]


def rounded_up(x: F, precision: str = DOUBLE) -> F:
    """Return the smallest float of a type that is not below x."""
    unit, smallest = PRECISIONS[precision]
    # the spacing of floats around x, from the number of bits alone: no float takes part
    top = F(2) ** (x.numerator.bit_length() - x.denominator.bit_length())  # |x| / 2 < top < 2 |x|
    if top > abs(x):
        top /= 2
    spacing = 2 * unit * max(top, smallest)
    return math.ceil(x / spacing) * spacing


def _inputs(model: Document, u: Sequence[Sequence[F | None]]) -> Sequence[Sequence[F | None]]:
    """Return the inputs that outputs of the window depend on: the last sample's only where one acts at
    once.
    """
    # a parameter may act on an output at once where its middle does not
    at_once = list(model["D"])
    for parameter in model["uncertainties"]:
        at_once += parameter["D"] or []
    if any(any(row) for row in at_once):
        return u
    return [*u[:-1], [None] * len(model["offset_u"])]


def _looked_at(y: Sequence[Sequence[F | None]], lags: Sequence[int] | None) -> list[Sequence[F | None]]:
    """Return the samples with None where the window does not look at its outputs."""
    last, out = len(y) - 1, []
    for j, row in enumerate(y):
        if lags is None or last - j in lags:
            out.append(row)
        else:
            out.append([None] * len(row))
    return out


def _runs(model: Document, samples: int, lags: Sequence[int] | None) -> list[Document]:
    """Return {average, first sample} of every run of an average in the window; first None where it is not
    looked at.
    """
    runs = []
    for number, average in enumerate(model["averages"]):
        length = len(average["weights"])
        steps = samples  # outputs have s + 1 samples, disturbances s
        if not average["output"]:
            steps -= 1
        for first in range(steps - length + 1):
            run: Document = {"average": F(number), "first": F(first)}
            last = first + length - 1
            if average["output"] and lags is not None and samples - 1 - last not in lags:
                run["first"] = None
            runs.append(run)
    return runs


def _variables(model: Document, samples: int) -> list[list[F | None]]:
    """Return [number of a parameter, sample, or None where it keeps one value] of each variable."""
    variables: list[list[F | None]] = []
    for i, parameter in enumerate(model["uncertainties"]):
        if parameter["varying"]:
            variables += [[F(i), F(j)] for j in range(samples)]
        else:
            variables.append([F(i), None])
    return variables


def _listed(tree: object) -> object:
    """Return a tree with lists for tuples and Fractions for all numbers."""
    if isinstance(tree, dict):
        return {name: _listed(branch) for name, branch in tree.items()}
    if isinstance(tree, (list, tuple)):
        return [_listed(branch) for branch in tree]
    if tree is None:
        return None
    return F(cast(F, tree))


def _text(x: object) -> str:
    if isinstance(x, F) and len(str(x)) >= 30:
        return repr(float(x))
    return str(x)
