"""All that model, bounds and samples say of one window, written out row by row for programs that know nothing
of plants.

Unknowns, all in deviations from the offsets: xJ_I (state I at sample J), wJ_I (disturbance), vJ_I (unknown
input), uJ_I (an input that is missing), gI (gain of output I, 1 / (1 + theta), where it keeps one value), pK
(uncertain parameter K at a sample, or over the window).

A row is lo <= sum of coefficients times products of unknowns <= hi. The words are those of `proof`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction as F
from typing import Any

from jaxbound.certificates.checker.boxes import Polynomial
from jaxbound.certificates.checker.trajectories import dots, limits, now, runs_of, turned

__all__ = ["Row", "combination", "rows_of", "solution", "unknowns"]

ZERO, ONE = F(0), F(1)


@dataclass(frozen=True)
class Row:
    """lo <= sum of terms <= hi; an end that is None says nothing.

    Fields: name; terms: {(unknown, ..): coefficient}; lo, hi; place: (kind, sample, number) of what it speaks
    of.
    """

    name: str
    terms: dict
    lo: F | None
    hi: F | None
    place: tuple


def rows_of(c: dict[str, Any], parameters: Sequence[F] | None = None) -> list[Row]:
    """Return the rows of a claim, equations of the states included.

    Args:
        c: see `claim.claimed`. parameters: values of uncertain parameters that are put in; None: they are
            unknowns, and rows not linear.
    """
    names = [f"p{k}" for k in range(len(c.get("variables", [])))]
    v: Sequence = [Polynomial({(name,): ONE}) for name in names] if parameters is None else parameters
    rows = [
        _row(name, Polynomial({(name,): ONE}), -bound, bound, ("p", 0, k))
        for k, (name, bound) in enumerate(_bounds(c, names))
    ]
    if parameters is not None:
        rows += [
            _row(f"{name}_is", Polynomial({(name,): ONE}), x, x, ("is", 0, 0))
            for name, x in zip(names, parameters, strict=True)
        ]
    n, last = len(c["A"]), len(c["y"]) - 1
    state, seen = _signals("x", 0, n), []
    ends = c.get("first_state")
    if ends is not None:
        rows += [
            _row(f"first{i}", x, lo, hi, ("x", 0, i))
            for i, (x, (lo, hi)) in enumerate(zip(state, ends, strict=True))
        ]
    gains = _signals("g", None, len(c["noise"])) if "constant" in c else None
    if gains is not None:
        for i, (gain, tolerance) in enumerate(zip(gains, c["tolerance"], strict=True)):
            rows.append(_row(f"gain{i}", gain, 1 / (1 + tolerance), 1 / (1 - tolerance), ("gain", 0, i)))
    for j, (readings, w_ends) in enumerate(limits(c, None, None if gains is None else [ONE] * len(gains))):
        A, B, C, D = (now(c, letter, j, v) for letter in "ABCD")
        u, w, free = _inputs(c, j), _signals("w", j, len(w_ends)), _signals("v", j, len(c["D_v"][0]))
        true = [
            sum(parts, Polynomial({}))
            for parts in zip(dots(C, state), dots(D, u), dots(c["D_v"], free), strict=True)
        ]
        seen.append((true, w))
        for i, (t, reading) in enumerate(zip(true, readings, strict=True)):
            rows += _reading(j, i, t, reading, gains)
        if j == last:
            continue
        rows += [
            _row(f"w{j}_{i}_bound", x, lo, hi, ("w", j, i))
            for i, (x, (lo, hi)) in enumerate(zip(w, w_ends, strict=True))
        ]
        after = _signals("x", j + 1, n)
        parts = zip(after, dots(A, state), dots(B, u), dots(c["G"], w), dots(c["F"], free), strict=True)
        for i, (new, *moved) in enumerate(parts):
            rows.append(
                _row(f"step{j}_{i}", new + sum(moved, Polynomial({})) * -ONE, ZERO, ZERO, ("step", j, i))
            )
        state = after
    return rows + list(_averages(c, seen))


def _bounds(c, names):
    bounds = [c["uncertainties"][int(who)]["bound"] for who, _ in c.get("variables", [])]
    return zip(names, bounds, strict=True)


def _reading(j, i, t, reading, gains):
    """Return the rows of one reading, none where it is missing."""
    if reading is None:
        return []
    lo, hi = reading
    if gains is None:
        return [_row(f"y{j}_{i}", t, lo, hi, ("y", j, i))]
    above, below = t + gains[i] * -lo, t + gains[i] * -hi
    return [
        _row(f"y{j}_{i}_above", above, ZERO, None, ("above", j, i)),
        _row(f"y{j}_{i}_below", below, None, ZERO, ("below", j, i)),
    ]


def _averages(c, seen):
    for k, (_, terms, ends) in enumerate(runs_of(c)):
        if ends is None:
            continue
        total = Polynomial({})
        for measured, j, i, weight in terms:
            true, w = seen[j]
            total = total + (true if measured else w)[i] * weight
        lo, hi = ends
        yield _row(f"average{k}", total, lo, hi, ("a", 0, k))


def _signals(letter, j, count):
    at = "" if j is None else f"{j}_"
    return [Polynomial({(f"{letter}{at}{i}",): ONE}) for i in range(count)]


def _inputs(c, j):
    """Return the inputs of a sample: numbers, an unknown where one is missing."""
    found = []
    for i, (value, offset) in enumerate(zip(c["u"][j], c["offset_u"], strict=True)):
        found.append(Polynomial({(f"u{j}_{i}",): ONE} if value is None else {(): value - offset}))
    return found


def _row(name, polynomial, lo, hi, place):
    """Return a Row with what is known on the side of its ends."""
    terms = dict(polynomial.terms)
    known = terms.pop((), ZERO)
    return Row(name, terms, None if lo is None else lo - known, None if hi is None else hi - known, place)


def unknowns(rows: Sequence[Row]) -> list[str]:
    """Return the names of all unknowns, in the order in which rows name them."""
    found: dict[str, None] = {}
    for row in rows:
        for monomial in row.terms:
            found |= dict.fromkeys(monomial)
    return list(found)


def combination(c: dict[str, Any], r: dict[str, Any], rows: Sequence[Row]) -> list[F]:
    """Return a multiplier for each row: their sum is 0 = .., and is at least more than 0. Positive ones use
    lo, negative ones hi.

    Args: c: a claim. r: the relation of a FAULT, as a certificate shows it. rows: as `rows_of` returns them.
    """
    sign = 1 if r["residual"] > 0 else -1
    after: list = [ZERO] * len(c["A"])  # how the samples later than j depend on the state after j
    steps = {}
    A, C = c["A"], c["C"]
    plain = _with_averages(c, r)
    for j in reversed(range(len(c["y"]))):
        for i, x in enumerate(after):
            steps[j, i] = -x
        after = dots(turned([*C, *A]), plain[j] + after)
    found, gained = [], dict.fromkeys(range(len(c["noise"])), ZERO)
    for row in rows:
        kind, j, i = row.place
        x = ZERO
        if kind == "step":
            x = sign * steps[j, i]
        elif kind in ("y", "above", "below"):
            x = sign * r["h"][j][i]
            if (kind == "above" and x < 0) or (kind == "below" and x > 0):
                x = ZERO
            gained[i] -= x * row.terms.get((f"g{i}",), ZERO)
        elif kind == "w":
            x = sign * r["g"][j][i]
        elif kind == "a":
            x = sign * r["a"][i] if "a" in r else ZERO
        elif kind == "x":
            x = sign * r["x"][i]
        found.append(x)
    for k, row in enumerate(rows):
        if row.place[0] == "gain":
            found[k] = gained[row.place[2]]
    return found


def _with_averages(c, r):
    """Return the multipliers of true outputs, a row for each sample, averages written out."""
    out = [list(row) for row in r["h"]]
    for x, terms, _ in runs_of(c, r.get("a")):
        for measured, j, i, weight in terms:
            if measured:
                out[j][i] += x * weight
    return out


def solution(c: dict[str, Any], witness: dict[str, Any], v: Sequence[F]) -> Iterator[tuple[str, F]]:
    """Yield (unknown, value) of a witness, at values v of uncertain parameters."""
    yield from ((f"p{k}", x) for k, x in enumerate(v))
    yield from ((f"g{i}", x) for i, x in enumerate(witness.get("gains", [])))
    state = witness["state"]
    for j, (u, w, free) in enumerate(
        zip(witness["inputs"], witness["disturbances"], witness["unknown_inputs"], strict=True)
    ):
        u = [value - offset for value, offset in zip(u, c["offset_u"], strict=True)]
        for letter, values in (("x", state), ("w", w), ("v", free), ("u", u)):
            yield from ((f"{letter}{j}_{i}", x) for i, x in enumerate(values))
        A, B = (now(c, letter, j, v) for letter in "AB")
        parts = zip(dots(A, state), dots(B, u), dots(c["G"], w), dots(c["F"], free), strict=True)
        state = [sum(terms, ZERO) for terms in parts]
