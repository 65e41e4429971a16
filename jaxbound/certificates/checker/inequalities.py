"""All that model, bounds and samples say of one window, written out row by row for programs that know nothing
of plants.

Unknowns, all in deviations from the offsets: xJ_I (state I at sample J), wJ_I (disturbance), vJ_I (unknown
input), uJ_I (an input that is missing), gI (gain of output I, 1 / (1 + theta), where it keeps one value), pK
(uncertain parameter K at a sample, or over the window).

A row is lo <= sum of coefficients times products of unknowns <= hi. The letters are those of `proof`.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction as F
from typing import Any, TypeAlias

from jaxbound.certificates.checker.polynomial import Polynomial
from jaxbound.certificates.checker.trajectories import limits, plant_at, runs_of
from jaxbound.certificates.checker.vectors import add, combine, dots
from jaxbound.certificates.checker.words import Claim, Ends, Relation, Witness

__all__ = ["Row", "combination", "rows_of", "solution", "unknowns"]

ZERO, ONE = F(0), F(1)
Place: TypeAlias = tuple[str, int, int]
Expression: TypeAlias = Polynomial[str]
"""A polynomial in the names of unknowns."""


@dataclass(frozen=True)
class Row:
    """lo <= sum of terms <= hi; an end that is None says nothing.

    Fields: name; terms: {(unknown, ..): coefficient}; lo, hi; place: (kind, sample, number) of what it speaks
    of.
    """

    name: str
    terms: dict[tuple[str, ...], F]
    lo: F | None
    hi: F | None
    place: Place


def rows_of(c: Claim, parameters: Sequence[F] | None = None) -> list[Row]:
    """Return the rows of a claim, equations of the states included.

    Args:
        c: see `claim.claimed`. parameters: values of uncertain parameters that are put in; None: they are
            unknowns, and rows not linear.
    """
    rows, v = _parameter_rows(c, parameters)
    n, last = len(c["A"]), len(c["y"]) - 1
    x = _unknowns("x0_", n)
    for i, (lo, hi) in enumerate(c.get("first_state", [])):
        rows.append(_row(f"first{i}", x[i], lo, hi, ("x", 0, i)))
    gains, known = None, None
    if "constant" in c:
        # a reading's limits at gain 1 times the gain are those at that gain
        gains, known = _unknowns("g", len(c["noise"])), [ONE] * len(c["noise"])
        rows += _gain_rows(c, gains)
    true_values = []  # (outputs, disturbances) of each sample
    for j, (readings, w_ends) in enumerate(limits(c, None, known)):
        A, B, C, D = plant_at(c, j, v)
        u, w, free = _inputs(c, j), _unknowns(f"w{j}_", len(w_ends)), _unknowns(f"v{j}_", len(c["D_v"][0]))
        # t = C x + D u + D_v v
        t = [Expression.of(terms) for terms in add(dots(C, x), dots(D, u), dots(c["D_v"], free))]
        true_values.append((t, w))
        for i, (output, reading) in enumerate(zip(t, readings, strict=True)):
            rows += _reading_rows(j, i, output, reading, gains)
        if j == last:
            break
        for i, (disturbance, (lo, hi)) in enumerate(zip(w, w_ends, strict=True)):
            rows.append(_row(f"w{j}_{i}_bound", disturbance, lo, hi, ("w", j, i)))
        # x+ - (A x + B u + G w + F v) = 0
        after = _unknowns(f"x{j + 1}_", n)
        moved = add(dots(A, x), dots(B, u), dots(c["G"], w), dots(c["F"], free))
        for i, (new, terms) in enumerate(zip(after, moved, strict=True)):
            rows.append(_row(f"step{j}_{i}", new + terms * -ONE, ZERO, ZERO, ("step", j, i)))
        x = after
    return rows + list(_average_rows(c, true_values))


def _parameter_rows(c: Claim, values: Sequence[F] | None) -> tuple[list[Row], Sequence[F] | list[Expression]]:
    """Return (the rows of the uncertain parameters, what stands for them in other rows)."""
    v = _unknowns("p", len(c.get("variables", [])))
    rows = []
    for k, (x, (number, _)) in enumerate(zip(v, c.get("variables", []), strict=True)):
        bound = c["uncertainties"][int(number)]["bound"]
        rows.append(_row(f"p{k}", x, -bound, bound, ("p", 0, k)))
    if values is None:
        return rows, v
    for k, (x, value) in enumerate(zip(v, values, strict=True)):
        rows.append(_row(f"p{k}_is", x, value, value, ("is", 0, 0)))
    return rows, values


def _gain_rows(c: Claim, gains: Sequence[Expression]) -> Iterator[Row]:
    for i, (gain, tolerance) in enumerate(zip(gains, c["tolerance"], strict=True)):
        yield _row(f"gain{i}", gain, 1 / (1 + tolerance), 1 / (1 - tolerance), ("gain", 0, i))


def _reading_rows(
    j: int, i: int, t: Expression, reading: Ends | None, gains: Sequence[Expression] | None
) -> list[Row]:
    """Return the rows of one reading, none where it is missing."""
    if reading is None:
        return []
    lo, hi = reading
    if gains is None:
        return [_row(f"y{j}_{i}", t, lo, hi, ("y", j, i))]
    return [  # g lo <= t <= g hi
        _row(f"y{j}_{i}_above", t + gains[i] * -lo, ZERO, None, ("above", j, i)),
        _row(f"y{j}_{i}_below", t + gains[i] * -hi, None, ZERO, ("below", j, i)),
    ]


def _average_rows(
    c: Claim, true_values: Sequence[tuple[list[Expression], list[Expression]]]
) -> Iterator[Row]:
    for k, (_, terms, ends) in enumerate(runs_of(c)):
        if ends is None:
            continue
        total = Expression({})
        for measured, j, i, weight in terms:
            outputs, disturbances = true_values[j]
            if measured:
                total = total + outputs[i] * weight
            else:
                total = total + disturbances[i] * weight
        lo, hi = ends
        yield _row(f"average{k}", total, lo, hi, ("a", 0, k))


def _unknowns(prefix: str, count: int) -> list[Expression]:
    return [Expression({(f"{prefix}{i}",): ONE}) for i in range(count)]


def _inputs(c: Claim, j: int) -> list[Expression]:
    """Return the inputs of a sample: numbers, an unknown where one is missing."""
    inputs = []
    for i, (value, offset) in enumerate(zip(c["u"][j], c["offset_u"], strict=True)):
        if value is None:
            inputs.append(Expression({(f"u{j}_{i}",): ONE}))
        else:
            inputs.append(Expression({(): value - offset}))
    return inputs


def _row(name: str, expression: Expression, lo: F | None, hi: F | None, place: Place) -> Row:
    """Return a Row with what is known on the side of its ends."""
    terms = dict(expression.terms)
    known = terms.pop((), ZERO)
    if lo is not None:
        lo -= known
    if hi is not None:
        hi -= known
    return Row(name, terms, lo, hi, place)


def unknowns(rows: Iterable[Row]) -> list[str]:
    """Return the names of all unknowns, in the order in which rows name them."""
    names: dict[str, None] = {}
    for row in rows:
        for monomial in row.terms:
            names |= dict.fromkeys(monomial)
    return list(names)


def combination(c: Claim, r: Relation, rows: Sequence[Row]) -> list[F]:
    """Return a multiplier for each row: their sum is 0 = .., and is at least more than 0. Positive ones use
    lo, negative ones hi.

    A relation multiplies readings and bounds; the equations of the states get what the samples after each
    leave of the state (see `trajectories.follow`), and the gains what the readings leave of them.

    Args: c: a claim. r: the relation of a FAULT, as a certificate shows it. rows: as `rows_of` returns them.
    """
    sign = 1
    if r["residual"] < 0:
        sign = -1
    states = _state_multipliers(c, r)
    multipliers = []
    gained = [ZERO] * len(c["noise"])  # minus what readings leave of each gain
    for row in rows:
        x = sign * _multiplier(row.place, r, states)
        kind, _, i = row.place
        if (kind == "above" and x < 0) or (kind == "below" and x > 0):
            x = ZERO  # the other row of the reading has the end that counts
        if kind in ("above", "below"):
            gained[i] -= x * row.terms.get((f"g{i}",), ZERO)
        multipliers.append(x)
    for k, row in enumerate(rows):
        kind, _, i = row.place
        if kind == "gain":
            multipliers[k] = gained[i]
    return multipliers


def _multiplier(place: Place, r: Relation, states: dict[tuple[int, int], F]) -> F:
    """Return the multiplier of a row in a relation, whatever its sign."""
    kind, j, i = place
    value: Any = ZERO
    if kind == "step":
        value = states[j, i]
    elif kind in ("y", "above", "below"):
        value = r["h"][j][i]
    elif kind == "w":
        value = r["g"][j][i]
    elif kind == "a" and "a" in r:
        value = r["a"][i]
    elif kind == "x":
        value = r["x"][i]
    return F(value)


def _state_multipliers(c: Claim, r: Relation) -> dict[tuple[int, int], F]:
    """Return {(j, i): multiplier of the equation of state i after sample j}: minus q of `follow`."""
    q = [ZERO] * len(c["A"])
    outputs = _with_averages(c, r)
    multipliers = {}
    for j in reversed(range(len(c["y"]))):
        for i, x in enumerate(q):
            multipliers[j, i] = -x
        q = combine([*outputs[j], *q], c["C"], c["A"])
    return multipliers


def _with_averages(c: Claim, r: Relation) -> list[list[F]]:
    """Return the multipliers of true outputs, a row for each sample, averages written out."""
    out = [list(row) for row in r["h"]]
    for x, terms, _ in runs_of(c, r.get("a")):
        for measured, j, i, weight in terms:
            if measured:
                out[j][i] += x * weight
    return out


def solution(c: Claim, witness: Witness, v: Sequence[F]) -> Iterator[tuple[str, F]]:
    """Yield (unknown, value) of a witness, at values v of uncertain parameters."""
    yield from _named("p", v)
    yield from _named("g", witness.get("gains", []))
    x = witness["state"]
    samples = zip(witness["inputs"], witness["disturbances"], witness["unknown_inputs"], strict=True)
    for j, (inputs, w, free) in enumerate(samples):
        u = [value - offset for value, offset in zip(inputs, c["offset_u"], strict=True)]
        for letter, values in (("x", x), ("w", w), ("v", free), ("u", u)):
            yield from _named(f"{letter}{j}_", values)
        A, B, _, _ = plant_at(c, j, v)
        x = add(dots(A, x), dots(B, u), dots(c["G"], w), dots(c["F"], free))


def _named(prefix: str, values: Sequence[F]) -> Iterator[tuple[str, F]]:
    for i, value in enumerate(values):
        yield f"{prefix}{i}", value
