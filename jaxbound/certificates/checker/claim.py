"""What a certificate claims, built anew from a model and samples: no number of the certificate takes part.

A model is a dict of exact numbers, lists of them and names, as `plain.plain_model` makes it of a LinearSystem
and `files.read_model` of a file; nothing in it is rounded yet. Samples are s + 1 rows of numbers, None where
one is missing.

Bounds are rounded outward to the float type in which the samples were judged, as the judging kernels take
them: so a certificate of either verdict speaks of the same numbers.
"""

import math
import struct
from collections.abc import Sequence
from fractions import Fraction as F
from typing import Any

__all__ = ["DOUBLE", "SINGLE", "claimed", "compare", "numbers", "rounded_up", "statement"]

DOUBLE, SINGLE = "float64", "float32"
PRECISIONS = {DOUBLE: (F(1, 2**53), F(1, 2**1022)), SINGLE: (F(1, 2**24), F(1, 2**126))}
"""Unit roundoff and smallest normal number of each float type."""
LONGEST_EXPONENT = 5
"""Characters of an exponent: the digits of 1e-12345, written out, would be no work for a checker."""
RECORDER_ULPS = 4
"""A sample is known to so many unit roundoffs times the largest of its signal: see the argument `resolution`
of a LinearSystem.
"""


def claimed(
    model: dict[str, Any],
    u: Sequence[Sequence[F | None]],
    y: Sequence[Sequence[F | None]],
    precision: str = DOUBLE,
    lags: Sequence[int] | None = None,
    first: Sequence[Sequence[F]] | None = None,
) -> dict[str, Any]:
    """Return the numbers of a certificate that are no part of its proof: those of the model, of its bounds
    and of the samples.

    Args:
        model: exact numbers. u, y: the samples, s + 1 rows each. precision: float type in which they were
            judged.
        lags: so many samples before its last the window looks at outputs; None: always. first: (lo, hi) of
            each first state, or None.
    """
    unit, floor = PRECISIONS[precision]

    def up(values):
        return [rounded_up(x, precision) for x in values]

    out = {name: model[name] for name in ("A", "B", "C", "D", "G", "F", "D_v", "offset_u", "offset_y")}
    out |= {name: up(model[name]) for name in ("tolerance", "noise", "resolution")}
    out["disturbance"] = [
        [-rounded_up(-lo, precision), rounded_up(hi, precision)] for lo, hi in model["disturbance"]
    ]
    out |= {"recorder": RECORDER_ULPS * unit, "floor": floor}
    out |= {"u": _inputs(model, u), "y": _looked_at(y, lags)}
    if lags is not None:
        out["lags"] = [F(lag) for lag in lags]
    if model["averages"]:
        bounds = up(a["bound"] for a in model["averages"])
        out["averages"] = [{**a, "bound": bound} for a, bound in zip(model["averages"], bounds, strict=True)]
        out |= {"runs": _runs(model, len(y), lags), "all_y": y}
    if model["constant"] and any(out["tolerance"]):
        out["constant"] = F(1)
    if model["uncertainties"]:
        out["uncertainties"] = [{**parameter, "bound": F(1)} for parameter in model["uncertainties"]]
        out["variables"] = _variables(model, len(y))
    if first is not None:
        out["first_state"] = first
    return _listed(out)


def statement(verdict: str, names: dict[str, Any], claim: dict[str, Any]) -> str:
    """Return the sentence that a certificate proves.

    Args: verdict: FAULT or CONSISTENT. names: of a certificate. claim: numbers, as `claimed` returns them.
    """
    who = "no behaviour" if verdict == "FAULT" else "a behaviour"
    sample, count = names["sample"], len(claim["y"])
    last = sample if isinstance(sample, int) else ", ".join(map(str, sample))
    seen = ""
    if "lags" in claim:
        seen = f", outputs looked at {', '.join(map(str, claim['lags']))} samples before the last,"
    begins = " and from a first state within its bounds" if "first_state" in claim else ""
    return (
        f"{who} of {names['model']} within its bounds{begins} explains the {count} samples that end at "
        f"sample {last}{seen}"
    ).rstrip(",")


def compare(shown: dict[str, Any], claim: dict[str, Any], where: str = "numbers") -> None:
    """Raise ValueError naming the first difference between what a certificate shows and what model and
    samples make of it.
    """
    for name, value in claim.items():
        if name not in shown:
            raise ValueError(f"{where}.{name} is missing")
        found = _difference(shown[name], value)
        if found is not None:
            path, one, other = found
            raise ValueError(
                f"the certificate is about something else: {where}.{name}{path} is {_text(one)}, model and "
                f"data say {_text(other)}"
            )


def numbers(tree: Any, seen: list[F]) -> Any:
    """Return a tree of texts as one of Fractions, None as it is; append each number to `seen`.

    Raises:
        ValueError: a leaf that is no exact text.
    """
    if isinstance(tree, dict):
        return {name: numbers(branch, seen) for name, branch in tree.items()}
    if isinstance(tree, list):
        return [numbers(branch, seen) for branch in tree]
    if tree is None:
        return None
    if not isinstance(tree, str):
        raise ValueError(f"a number must be exact text, not {tree!r}")
    exponent = tree.lower().partition("e")[2]
    if len(exponent) > LONGEST_EXPONENT:
        raise ValueError(f"a number is too large or too small to be one of a recording: {tree[:40]}")
    seen.append(F(tree))
    return seen[-1]


def rounded_up(x: F, precision: str = DOUBLE) -> F:
    """Return the smallest float of a type that is not below x."""
    nearest = float(x)
    if precision == DOUBLE:
        above = nearest if F(nearest) >= x else math.nextafter(nearest, math.inf)
        return F(above)
    (single,) = struct.unpack("<f", struct.pack("<f", nearest))
    if F(single) >= x:
        return F(single)
    (bits,) = struct.unpack("<i", struct.pack("<f", single))
    if single == 0:
        bits = 1
    elif single > 0:
        bits += 1
    else:
        bits -= 1
    (above,) = struct.unpack("<f", struct.pack("<i", bits))
    return F(above)


def _inputs(model, u):
    """Return the inputs that outputs of the window depend on: the last sample's only where one acts at
    once.
    """
    at_once = list(model["D"])
    for parameter in model["uncertainties"]:
        at_once += parameter["D"] or []
    if any(any(row) for row in at_once):
        return u
    return [*u[:-1], [None] * len(model["offset_u"])]


def _looked_at(y, lags):
    last = len(y) - 1
    return [row if lags is None or last - j in lags else [None] * len(row) for j, row in enumerate(y)]


def _runs(model, samples, lags):
    """Return {average, first sample} of every run of an average in the window; first None where it is not
    looked at.
    """
    runs = []
    for a, average in enumerate(model["averages"]):
        length = len(average["weights"])
        steps = samples if average["output"] else samples - 1
        for first in range(steps - length + 1):
            last = first + length - 1
            looked = not average["output"] or lags is None or samples - 1 - last in lags
            runs.append({"average": F(a), "first": F(first) if looked else None})
    return runs


def _variables(model, samples):
    """Return [number of a parameter, sample, or None where it keeps one value] of each variable."""
    variables = []
    for i, parameter in enumerate(model["uncertainties"]):
        lags = [F(j) for j in range(samples)] if parameter["varying"] else [None]
        variables += [[F(i), lag] for lag in lags]
    return variables


def _listed(tree):
    """Return a tree with lists for tuples and Fractions for all numbers."""
    if isinstance(tree, dict):
        return {name: _listed(branch) for name, branch in tree.items()}
    if isinstance(tree, (list, tuple)):
        return [_listed(branch) for branch in tree]
    return None if tree is None else F(tree)


def _difference(shown, value):
    """Return (path, shown, wanted) of the first difference of two trees, or None."""
    if isinstance(value, dict) and isinstance(shown, dict):
        if set(value) != set(shown):
            return "", sorted(shown), sorted(value)
        branches = [(f".{name}", shown[name], branch) for name, branch in value.items()]
    elif isinstance(value, list) and isinstance(shown, list):
        if len(value) != len(shown):
            return "", f"{len(shown)} entries", f"{len(value)} entries"
        branches = [(f"[{i}]", one, other) for i, (one, other) in enumerate(zip(shown, value, strict=True))]
    else:
        same = type(shown) is type(value) and shown == value
        return None if same else ("", shown, value)
    for path, one, other in branches:
        found = _difference(one, other)
        if found is not None:
            return path + found[0], found[1], found[2]
    return None


def _text(x):
    if not isinstance(x, F):
        return str(x)
    return str(x) if len(str(x)) < 30 else repr(float(x))
