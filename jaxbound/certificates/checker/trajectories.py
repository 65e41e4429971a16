"""What holds for every trajectory of a plant, and what samples and bounds say of its signals: exact
fractions.

The words are those of `proof`, c the numbers that a certificate claims.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction as F
from typing import Any, NamedTuple

__all__ = ["Run", "add", "dots", "follow", "insist", "limits", "now", "runs_of", "turned"]

ROUNDED = 10
"""Smallest normal numbers by which an average is widened for each of its samples."""


def insist(true: bool, reason: str) -> None:
    """Raise ValueError with a reason unless something is true."""
    if not true:
        raise ValueError(reason)


def follow(c: dict[str, Any], r: dict[str, Any], v: Sequence) -> None:
    """Check that sum h y + g w - k u = 0 for every trajectory, whatever the parameters v."""
    q: list = [F(0)] * len(c["A"])  # how the samples later than j depend on the state after j
    insist(len(r["h"]) == len(c["y"]), "the relation has another number of samples")
    for j, (h, g, k) in reversed(list(enumerate(zip(r["h"], r["g"], r["k"], strict=True)))):
        A, B, C, D = (now(c, letter, j, v) for letter in "ABCD")
        insist(not any(add(dots(turned(c["G"]), q), g)), "the relation leaves a disturbance over")
        insist(
            not any(dots(turned([*c["D_v"], *c["F"]]), h + q)), "the relation leaves an unknown input over"
        )
        insist(dots(turned([*D, *B]), h + q) == k, "the relation does not fit the inputs")
        q = dots(turned([*C, *A]), h + q)
    insist(not any(add(q, r.get("x", [F(0)] * len(q)))), "the relation leaves the unknown state over")


def now(c: dict[str, Any], letter: str, j: int, v: Sequence) -> Any:
    """Return a matrix of the model at sample j, at parameters v (numbers or polynomials)."""
    out = c[letter]
    for (who, lag), x in zip(c.get("variables", []), v, strict=True):
        change = c["uncertainties"][int(who)][letter]
        if change is not None and lag in (None, j):
            out = [
                [a + x * b for a, b in zip(row, by, strict=True)] for row, by in zip(out, change, strict=True)
            ]
    return out


def limits(
    c: dict[str, Any], error: tuple | None = None, gains: Sequence[F] | None = None
) -> list[tuple[list, list]]:
    """Return for each time ([lo, hi] of the true value behind each reading, None where it is missing; [lo,
    hi] of each disturbance).
    """
    deltas = [_delta(c, i, error) for i in range(len(c["noise"]))]
    bounds = [(lo - c["floor"], hi + c["floor"]) for lo, hi in c["disturbance"]]
    out = []
    for row in c["y"]:
        readings: list = []
        for i, (y, delta) in enumerate(zip(row, deltas, strict=True)):
            if y is None:
                readings.append(None)
                continue
            d = y - c["offset_y"][i]
            factors = (
                [1 / (1 - c["tolerance"][i]), 1 / (1 + c["tolerance"][i])] if gains is None else [gains[i]]
            )
            readings.append((min(f * (d - delta) for f in factors), max(f * (d + delta) for f in factors)))
        out.append((readings, bounds))
    return out


class Run(NamedTuple):
    """A run of an average: a bounded sum of true values, in deviations.

    Fields: multiplier, in a relation; terms: [(whether of an output, sample, number, weight)], none where the
    run is not looked at; ends: (lo, hi), None where it says nothing.
    """

    multiplier: F
    terms: list[tuple[bool, int, int, F]]
    ends: tuple[F, F] | None


def runs_of(
    c: dict[str, Any], multipliers: Sequence[F] | None = None, error: tuple | None = None
) -> Iterator[Run]:
    """Yield the Run of each run of an average."""
    runs = c.get("runs", [])
    for x, run in zip([F(0)] * len(runs) if multipliers is None else multipliers, runs, strict=True):
        average = c["averages"][int(run["average"])]
        terms = _terms(average, run["first"])
        yield Run(x, terms, _run_ends(c, average["bound"], terms, error))


def _terms(average, first):
    """Return [(whether of an output, sample, number, weight)] of a run, none where it is not looked at."""
    if first is None:
        return []
    terms = []
    for part in (average, *average.get("beside", [])):
        for j, weight in enumerate(part["weights"], int(first)):
            terms.append((bool(average["output"]), j, int(part["number"]), weight))
    return terms


def _run_ends(c, bound, terms, error):
    """Return (lo, hi) of the weighted sum over a run, None where it is not looked at or a reading is
    missing.
    """
    if not terms:
        return None
    middle = F(0)
    sizes: dict[int, F] = {}
    rad = bound + ROUNDED * len(terms) * c["floor"]
    for measured, j, i, weight in terms:
        rad += ROUNDED * abs(weight) * c["floor"]
        if measured:
            y = c["all_y"][j][i]
            if y is None:
                return None
            middle += weight * (y - c["offset_y"][i])
            sizes[i] = sizes.get(i, F(0)) + abs(weight)
    for i, size in sizes.items():
        rad += size * (_delta(c, i, error) - c["noise"][i] - c["floor"])
    return middle - rad, middle + rad


def _delta(c, i, error):
    """Return the largest |delta| of an output."""
    largest = max(_looked_at(c, i), default=F(0))
    allowed = error[1] if error is not None and error[0] == i else F(0)
    return (
        c["noise"][i] + c["resolution"][i] + c["recorder"] * (largest + c["noise"][i]) + c["floor"] + allowed
    )


def _looked_at(c, i):
    """Yield the size of each reading of an output that is looked at, alone or in an average."""
    readings = [row[i] for row in c["y"]]
    for run in c.get("runs", []):
        for measured, j, number, _ in _terms(c["averages"][int(run["average"])], run["first"]):
            if measured and number == i:
                readings.append(c["all_y"][j][i])
    for y in readings:
        if y is not None:
            yield abs(y)


def dots(rows: Any, vector: Sequence) -> list:
    """Return the product of rows with a vector."""
    return [sum((a * b for a, b in zip(row, vector, strict=True)), F(0)) for row in rows]


def turned(matrix: Any) -> Any:
    """Return the columns of a matrix."""
    return zip(*matrix, strict=True)


def add(a: Sequence, b: Sequence) -> list:
    """Return the sum of two vectors."""
    return [x + y for x, y in zip(a, b, strict=True)]
