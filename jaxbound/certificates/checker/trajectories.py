"""Relations that hold for every trajectory of a plant, and limits that samples and bounds set to its signals:
exact fractions.

The letters are those of `proof`, c the claim of a certificate.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction as F
from typing import Any, NamedTuple, TypeAlias

from jaxbound.certificates.checker.vectors import combine
from jaxbound.certificates.checker.words import Average, Claim, Ends, Relation, Value, insist

__all__ = ["Run", "backward", "limits", "plant_at", "runs_of"]

ROUNDED = 10
"""Smallest normal numbers by which an average is widened for each of its samples."""

Rows: TypeAlias = Sequence[Sequence[Any]]
Error: TypeAlias = tuple[int, F] | None
"""(number of an output, size): an error that is allowed to one sensor beyond its bounds."""
Term: TypeAlias = tuple[bool, int, int, F]
"""(whether of an output, sample, number of the signal, weight) in a weighted sum."""


def backward(c: Claim, r: Relation, v: Sequence[Value]) -> list[list[Any]]:
    """Return the q that a relation sum_j h_j t_j + g_j w_j - k_j u_j + a S leaves after each sample.

    Backward in time, t_j = C x_j + D u_j + D_v v_j and x_(j+1) = A x_j + B u_j + G w_j + F v_j are put in.
    The samples after j then depend on x_(j+1) alone, by q x_(j+1).

    Args: v: values of the uncertain parameters, or polynomials.

    Raises: ValueError: the relation shows other k than these of the inputs.
    """
    insist(len(r["h"]) == len(c["y"]), "the relation has another number of samples")
    outputs = [list(row) for row in r["h"]]  # sums written out
    for x, terms, _ in runs_of(c, r.get("a")):
        for measured, j, i, weight in terms:
            if measured:
                outputs[j][i] += x * weight
    q: list[Any] = [F(0)] * len(c["A"])  # nothing comes after the last sample
    left = []
    for j, (h, k) in reversed(list(enumerate(zip(outputs, r["k"], strict=True)))):
        left.append(q)
        A, B, C, D = plant_at(c, j, v)
        # of u_j: h D + q B = k
        insist(combine([*h, *q], D, B) == k, "the relation does not fit the inputs")
        q = combine([*h, *q], C, A)  # of x_j: h C + q A
    return left[::-1]


def plant_at(c: Claim, j: int, v: Sequence[Value]) -> tuple[Rows, Rows, Rows, Rows]:
    """Return A, B, C, D at sample j, at parameters v (numbers or polynomials)."""
    A, B, C, D = _matrices(c)
    for (number, lag), x in zip(c.get("variables", []), v, strict=True):
        if lag not in (None, j):
            continue  # the value of another sample
        dA, dB, dC, dD = _changes(c, int(number))
        A, B, C, D = _moved(A, x, dA), _moved(B, x, dB), _moved(C, x, dC), _moved(D, x, dD)
    return A, B, C, D


def _matrices(c: Claim) -> tuple[Rows, Rows, Rows, Rows]:
    return c["A"], c["B"], c["C"], c["D"]


def _changes(c: Claim, number: int) -> tuple[Rows | None, Rows | None, Rows | None, Rows | None]:
    parameter = c["uncertainties"][number]
    return parameter["A"], parameter["B"], parameter["C"], parameter["D"]


def _moved(matrix: Rows, x: Value, change: Rows | None) -> Rows:
    """Return M + x dM; change None: nothing of the matrix depends on the parameter."""
    if change is None:
        return matrix
    moved = []
    for row, by in zip(matrix, change, strict=True):
        moved.append([a + x * b for a, b in zip(row, by, strict=True)])
    return moved


def limits(
    c: Claim, error: Error = None, gains: Sequence[F] | None = None
) -> list[tuple[list[Ends | None], list[Ends]]]:
    """Return for each sample ((lo, hi) of each true output, None where its reading is missing; (lo, hi) of
    each disturbance).

    Args: gains: 1 / (1 + theta) of each output, where it is known.
    """
    deltas = [_delta(c, i, error) for i in range(len(c["noise"]))]
    wider = _wider(c)
    bounds = [(lo - c["floor"], hi + c["floor"]) for lo, hi in c["disturbance"]]
    out = []
    for row, more in zip(c["y"], wider, strict=True):
        readings: list[Ends | None] = []
        for i, (y, delta) in enumerate(zip(row, deltas, strict=True)):
            readings.append(_true_output(c, i, y, delta + more[i], gains))
        out.append((readings, bounds))
    return out


def _true_output(c: Claim, i: int, y: F | None, delta: F, gains: Sequence[F] | None) -> Ends | None:
    """Return (lo, hi) of the true output behind a reading, in deviations; None where it is missing."""
    if y is None:
        return None
    # y = (1 + theta) t + d with |d| <= delta, so t = (y - d) / (1 + theta): extreme at the ends of both
    factors = [1 / (1 - c["tolerance"][i]), 1 / (1 + c["tolerance"][i])]
    if gains is not None:
        factors = [gains[i]]
    y -= c["offset_y"][i]
    return min(f * (y - delta) for f in factors), max(f * (y + delta) for f in factors)


class Run(NamedTuple):
    """A run of an average: a bounded sum of true values, in deviations.

    Fields: multiplier, in a relation; terms, none where the run is not looked at; ends: (lo, hi), None where
    it says nothing.
    """

    multiplier: F
    terms: list[Term]
    ends: Ends | None


def runs_of(c: Claim, multipliers: Sequence[F] | None = None, error: Error = None) -> Iterator[Run]:
    """Yield the Run of each run of an average."""
    runs = c.get("runs", [])
    if multipliers is None:
        multipliers = [F(0)] * len(runs)
    for x, run in zip(multipliers, runs, strict=True):
        average = c["averages"][int(run["average"])]
        terms = _terms(average, run["first"])
        yield Run(x, terms, _run_ends(c, average["bound"], terms, error))


def _terms(average: Average, first: F | None) -> list[Term]:
    """Return the terms of a run, none where it is not looked at."""
    if first is None:
        return []
    terms = []
    for part in (average, *average.get("beside", [])):
        for j, weight in enumerate(part["weights"], int(first)):
            terms.append((bool(average["output"]), j, int(part["number"]), weight))
    return terms


def _run_ends(c: Claim, bound: F, terms: Sequence[Term], error: Error) -> Ends | None:
    """Return (lo, hi) of the weighted sum of true values over a run, None where it is not looked at or a
    reading is missing.

    The bound is one on the sum of noises. What resolution, recorder and an error add to each reading is added
    by its weight; the floors are for numbers that a kernel rounds to zero on the way.
    """
    if not terms:
        return None
    middle = F(0)
    sizes: dict[int, F] = {}  # sum of |weight| by output
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


def _delta(c: Claim, i: int, error: Error) -> F:
    """Return the largest |delta| of output i: noise + resolution + recorder (largest |y| + noise) + floor,
    and an error that is allowed to it.
    """
    largest = max(_looked_at(c, i), default=F(0))
    delta = c["noise"][i] + c["resolution"][i] + c["recorder"] * (largest + c["noise"][i]) + c["floor"]
    if error is not None and error[0] == i:
        delta += error[1]
    return delta


def _wider(c: Claim) -> list[list[F]]:
    """Return by how much the |delta| of each sample may be larger than `_delta` says: its noise is times a
    factor, and what the recorder rounds away of it.
    """
    every, wider = c.get("factors"), []
    if every is None:
        every = [[F(1)] * len(c["noise"])] * len(c["y"])
    for factors in every:
        more = []
        for noise, factor in zip(c["noise"], factors, strict=True):
            more.append((factor - 1) * noise * (1 + c["recorder"]))
        wider.append(more)
    return wider


def _looked_at(c: Claim, i: int) -> Iterator[F]:
    """Yield the size of each reading of an output that is looked at, alone or in an average."""
    readings = [row[i] for row in c["y"]]
    for run in c.get("runs", []):
        for measured, j, number, _ in _terms(c["averages"][int(run["average"])], run["first"]):
            if measured and number == i:
                readings.append(c["all_y"][j][i])
    for y in readings:
        if y is not None:
            yield abs(y)
