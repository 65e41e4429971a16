"""All that model, bounds and samples say of one window, written out row by row: the checker adds rows up, and
programs that know nothing of plants read them.

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
from jaxbound.certificates.checker.trajectories import backward, limits, plant_at, runs_of
from jaxbound.certificates.checker.vectors import add, dots
from jaxbound.certificates.checker.words import Claim, Ends, Relation, Value, Witness, insist

__all__ = ["Row", "added_up", "multipliers", "rows_of", "solution", "unknowns"]

ZERO, ONE = F(0), F(1)
Place: TypeAlias = tuple[str, int, int]
"""(kind, sample, number) of what a row speaks of."""


@dataclass(frozen=True)
class Row:
    """lo <= terms <= hi; an end that is None says nothing."""

    name: str
    terms: Polynomial
    lo: F | None
    hi: F | None
    place: Place


def rows_of(c: Claim, parameters: Sequence[F] | None = None, error: tuple[int, F] | None = None) -> list[Row]:
    """Return the rows of a claim, equations of the states included.

    Args:
        c: see `claim.claimed`. parameters: values of uncertain parameters that are put in; None: they are
            unknowns, and rows not linear. error: as of `trajectories.limits`.
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
        for i, (gain, sigma) in enumerate(zip(gains, c["tolerance"], strict=True)):
            rows.append(_row(f"gain{i}", gain, 1 / (1 + sigma), 1 / (1 - sigma), ("gain", 0, i)))
    true_values = []  # (outputs, disturbances) of each sample
    for j, (readings, w_ends) in enumerate(limits(c, error, known)):
        A, B, C, D = plant_at(c, j, v)
        u, w, free = _inputs(c, j), _unknowns(f"w{j}_", len(w_ends)), _unknowns(f"v{j}_", len(c["D_v"][0]))
        t = add(dots(C, x), dots(D, u), dots(c["D_v"], free))  # t = C x + D u + D_v v
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
    for k, (_, terms, ends) in enumerate(runs_of(c, None, error)):
        if ends is not None:
            total = sum((true_values[j][not measured][i] * x for measured, j, i, x in terms), ZERO)
            rows.append(_row(f"average{k}", total, *ends, ("a", 0, k)))
    return rows


def _parameter_rows(c: Claim, values: Sequence[F] | None) -> tuple[list[Row], Sequence[Value]]:
    """Return (the rows of the uncertain parameters, what stands for them in other rows)."""
    v = _unknowns("p", len(c.get("variables", [])))
    rows = []
    for k, (x, (number, _)) in enumerate(zip(v, c.get("variables", []), strict=True)):
        bound = c["uncertainties"][int(number)]["bound"]
        rows.append(_row(f"p{k}", x, -bound, bound, ("p", 0, k)))
    if values is None:
        return rows, v
    for k, (x, value) in enumerate(zip(v, values, strict=True)):
        rows.append(_row(f"p{k}_is", x, value, value, ("is", 0, k)))
    return rows, values


def _reading_rows(
    j: int, i: int, t: Value, reading: Ends | None, gains: Sequence[Polynomial] | None
) -> Iterator[Row]:
    """Yield the rows of one reading, none where it is missing."""
    if reading is None:
        return
    lo, hi = reading
    if gains is None:
        yield _row(f"y{j}_{i}", t, lo, hi, ("y", j, i))
    else:  # g lo <= t <= g hi
        yield _row(f"y{j}_{i}_above", t + gains[i] * -lo, ZERO, None, ("y", j, i))
        yield _row(f"y{j}_{i}_below", t + gains[i] * -hi, None, ZERO, ("y", j, i))


def _unknowns(prefix: str, count: int) -> list[Polynomial]:
    return [Polynomial({(f"{prefix}{i}",): ONE}) for i in range(count)]


def _inputs(c: Claim, j: int) -> list[Value]:
    """Return the inputs of a sample: numbers, an unknown where one is missing."""
    inputs: list[Value] = []
    for i, (value, offset) in enumerate(zip(c["u"][j], c["offset_u"], strict=True)):
        if value is None:
            inputs.append(Polynomial({(f"u{j}_{i}",): ONE}))
        else:
            inputs.append(value - offset)
    return inputs


def _row(name: str, expression: Value, lo: F | None, hi: F | None, place: Place) -> Row:
    """Return a Row with what is known on the side of its ends."""
    terms = Polynomial.of(expression)
    known = terms.terms.get((), ZERO)
    if lo is not None:
        lo -= known
    if hi is not None:
        hi -= known
    return Row(name, terms + -known, lo, hi, place)


def unknowns(rows: Iterable[Row]) -> list[str]:
    """Return the names of all unknowns, in the order in which rows name them."""
    names: dict[str, None] = {}
    for row in rows:
        for monomial in row.terms.terms:
            names |= dict.fromkeys(monomial)
    return list(names)


def multipliers(
    c: Claim, r: Relation, rows: Sequence[Row], v: Sequence[Value] = (), sign: int = 1
) -> list[Any]:
    """Return the multiplier of each row in a relation, times a sign: their sum is to leave no unknown. One
    that is > 0 uses lo, one < 0 hi.

    A relation multiplies readings and bounds; the equations of the states get minus what the samples after
    each leave of the state, and gains minus what readings leave of them.

    Args:
        r: as a certificate shows it. rows: as `rows_of` returns them. v: see `trajectories.backward`.
    """
    steps = [[-1 * x for x in q] for q in backward(c, r, v)]
    parts = {"y": r["h"], "w": r["g"], "step": steps, "a": [r.get("a", [])], "x": [r.get("x", [])]}
    wanted = {}
    for kind, lines in parts.items():
        for j, line in enumerate(lines):
            for i, x in enumerate(line):
                if x:
                    wanted[kind, j, i] = sign * x
    there = {row.place for row in rows}
    lost = "the relation needs a reading that is missing, or what has no bounds"
    insist(all(place in there for place in wanted), lost)
    weights = []
    gained = dict.fromkeys(there, ZERO)  # minus what readings leave of each gain
    for row in rows:
        x = wanted.get(row.place, ZERO)
        if (row.lo is None and x > 0) or (row.hi is None and x < 0):
            x = ZERO  # the other row of the reading has the end that counts
        if row.lo is None or row.hi is None:
            i = row.place[2]
            gained["gain", 0, i] -= x * row.terms.terms.get((f"g{i}",), ZERO)
        weights.append(x)
    for k, row in enumerate(rows):
        if row.place[0] == "gain":
            weights[k] = gained[row.place]
    return weights


def added_up(rows: Iterable[Row], found: Iterable[Any]) -> Polynomial:
    """Return the sum of the terms of rows, each times its multiplier."""
    left: dict[tuple[str, ...], F] = {}
    for row, x in zip(rows, found, strict=True):
        if x:
            for monomial, value in (row.terms * x).terms.items():
                left[monomial] = left.get(monomial, ZERO) + value
    return Polynomial(left)


def solution(c: Claim, witness: Witness, v: Sequence[F]) -> dict[str, F]:
    """Return {unknown: value} of a witness, at values v of uncertain parameters, in deviations, and yJ_I, the
    true output I at sample J.
    """
    values = _named("p", v) | _named("g", witness.get("gains") or [])
    x = witness["state"]
    samples = zip(witness["inputs"], witness["disturbances"], witness["unknown_inputs"], strict=True)
    for j, (inputs, w, free) in enumerate(samples):
        A, B, C, D = plant_at(c, j, v)
        u = [value - offset for value, offset in zip(inputs, c["offset_u"], strict=True)]
        t = add(dots(C, x), dots(D, u), dots(c["D_v"], free))
        for letter, numbers in (("x", x), ("w", w), ("v", free), ("u", u), ("y", t)):
            values |= _named(f"{letter}{j}_", numbers)
        x = add(dots(A, x), dots(B, u), dots(c["G"], w), dots(c["F"], free))
    return values


def _named(prefix: str, values: Sequence[F]) -> dict[str, F]:
    return {f"{prefix}{i}": value for i, value in enumerate(values)}
