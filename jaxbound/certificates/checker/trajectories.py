"""The plant followed backward by multipliers and forward by a behaviour, and the limits that samples and
bounds set to its signals: exact fractions.

Signals have names, all in deviations from the offsets: xJ_I (state I at sample J), yJ_I (true output), wJ_I
(disturbance), vJ_I (unknown input), uJ_I (input), averageK (bounded sum of true values), gI (gain of output
I, 1 / (1 + theta), where it keeps one value), pK (uncertain parameter K at a sample, or over the window). The
letters are those of `proof`, c the claim of a certificate.
"""

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction as F
from typing import Any, TypeAlias

from jaxbound.certificates.checker.polynomial import Value, add_multiple, combine, dot, scale
from jaxbound.certificates.checker.words import Document, Ends, insist

ROUNDED = 10
"""Smallest normal numbers by which an average is widened for each of its samples."""

Rows: TypeAlias = Sequence[Sequence[Any]]
Error: TypeAlias = tuple[int, F] | None
"""(number of an output, size): an error that is allowed to one sensor beyond its bounds."""
Term: TypeAlias = tuple[bool, int, int, F]
"""(whether of an output, sample, number of the signal, weight) in a weighted sum."""


def multipliers(c: Document, r: Document, v: Sequence[Value]) -> tuple[dict[str, Value], Value]:
    """Return ({signal: multiplier}, the part of the inputs) of a relation sum_j h_j t_j + g_j w_j - k_j u_j +
    a S + x x_0 = 0, after a check that it holds for every trajectory.

    Backward in time, t_j = C x_j + D u_j + D_v v_j and x_(j+1) = A x_j + B u_j + G w_j + F v_j are put in.
    The samples after j then depend on x_(j+1) alone, by q x_(j+1), which is -(multiplier of its equation).

    Args: v: values of the uncertain parameters, or polynomials.

    Raises: ValueError: it leaves an unknown over, or shows other k than these of the inputs.
    """
    last = len(c["y"]) - 1
    insist(len(r["h"]) == len(r["g"]) == len(r["k"]) == last + 1, "the relation has other samples")
    multiplied: dict[str, Value] = {}
    written = {True: list(map(list, r["h"])), False: list(map(list, r["g"]))}  # sums written out
    for letter, rows in (("y", r["h"]), ("w", r["g"])):
        for j, row in enumerate(rows):
            multiplied |= named(f"{letter}{j}_", row)
    runs = list(runs_of(c))
    for number, (x, terms) in enumerate(zip(r.get("a", [F(0)] * len(runs)), runs, strict=True)):
        multiplied[f"average{number}"] = x
        for measured, j, i, weight in terms:
            written[measured][j][i] += x * weight
    q: list[Any] = [F(0)] * len(c["A"])  # nothing comes after the last sample
    of_inputs: Value = F(0)
    over = "the relation leaves an unknown over"
    for j in range(last, -1, -1):
        A, B, C, D = plant_at(c, j, v)
        h, w, k = written[True][j], written[False][j], r["k"][j]
        multiplied |= named(f"step{j}_", scale(q, -1))
        insist(combine([*h, *q], D, B) == k, "the relation does not fit the inputs")
        insist((combine(q, c["G"]) or [F(0)] * len(c["disturbance"])) == scale(w, -1), over)
        insist(not any(combine([*h, *q], c["D_v"], c["F"])), over)
        for x, u, offset in zip(k, c["u"][j], c["offset_u"], strict=True):
            insist(u is not None or not x, over)
            if x:
                of_inputs = of_inputs + x * (u - offset)
        q = combine([*h, *q], C, A)  # of x_j: h C + q A
    first = r.get("x", [F(0)] * len(q))
    insist(q == scale(first, -1), over)
    return multiplied | named("x0_", first), of_inputs


def behaviour(c: Document, witness: Document, v: Sequence[F]) -> dict[str, F]:
    """Return {signal: value} of a witness at values v of the uncertain parameters."""
    values = named("p", v) | named("g", witness.get("gains") or [])
    x = witness["state"]
    samples = zip(witness["inputs"], witness["disturbances"], witness["unknown_inputs"], strict=True)
    for j, (inputs, w, free) in enumerate(samples):
        u = add_multiple(inputs, -1, c["offset_u"])
        t, after = moved(c, j, v, x, u, w, free)
        for letter, signals in (("x", x), ("w", w), ("v", free), ("u", u), ("y", t)):
            values |= named(f"{letter}{j}_", signals)
        x = after
    return values | sums_of(c, values)


def sums_of(c: Document, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the bounded sums of true values."""
    sums = {}
    for number, terms in enumerate(runs_of(c)):
        total: Any = F(0)
        for measured, j, i, weight in terms:
            total = total + values[f"{'wy'[measured]}{j}_{i}"] * weight
        sums[f"average{number}"] = total
    return sums


def named(prefix: str, values: Sequence[Any]) -> dict[str, Any]:
    """Return numbered values by their names."""
    return {f"{prefix}{i}": value for i, value in enumerate(values)}


def moved(
    c: Document,
    j: int,
    v: Sequence[Value],
    x: Sequence[Value],
    u: Sequence[Value],
    w: Sequence[Value],
    free: Sequence[Value],
) -> tuple[list[Any], list[Any]]:
    """Return (t, x+) = (C x + D u + D_v v, A x + B u + G w + F v) at sample j."""
    A, B, C, D = plant_at(c, j, v)
    outputs, states = zip(C, D, c["D_v"], strict=True), zip(A, B, c["G"], c["F"], strict=True)
    t = [dot([*a, *b, *e], [*x, *u, *free]) for a, b, e in outputs]
    return t, [dot([*a, *b, *g, *f], [*x, *u, *w, *free]) for a, b, g, f in states]


def plant_at(c: Document, j: int, v: Sequence[Value]) -> list[Rows]:
    """Return A, B, C, D at sample j, at parameters v (numbers or polynomials)."""
    plant = [c["A"], c["B"], c["C"], c["D"]]
    for (number, lag), x in zip(c.get("variables", []), v, strict=True):
        if lag not in (None, j):
            continue  # the value of another sample
        for place, letter in enumerate("ABCD"):
            change = c["uncertainties"][int(number)][letter]
            if change is not None:
                rows = zip(plant[place], change, strict=True)
                plant[place] = [add_multiple(row, x, by) for row, by in rows]
    return plant


def limits(c: Document, error: Error = None) -> dict[str, Ends]:
    """Return {signal: (lo, hi)} of all that samples and bounds say; of the output of a gain that keeps its
    value those at gain 1, which count times the gain.
    """
    # the recorder rounds by the largest reading of a signal, so all samples are read first
    rounded = _rounded(c, error)
    ends = named("x0_", list(map(tuple, c.get("first_state", []))))
    if "constant" in c:
        ends |= named("g", [(1 / (1 + sigma), 1 / (1 - sigma)) for sigma in c["tolerance"]])
    for k, (number, _) in enumerate(c.get("variables", [])):
        bound = c["uncertainties"][int(number)]["bound"]
        ends[f"p{k}"] = -bound, bound
    for j, (row, factors) in enumerate(zip(c["y"], _factors_of(c), strict=True)):
        for i, y in enumerate(row):
            if y is not None:
                noise = c["noise"][i] * (1 + c["recorder"]) * factors[i]
                ends[f"y{j}_{i}"] = _true_output(c, i, y, noise + rounded[i] + c["floor"])
    for j in range(len(c["y"]) - 1):
        ends |= named(f"w{j}_", [(lo - c["floor"], hi + c["floor"]) for lo, hi in c["disturbance"]])
    return ends | _ends_of_sums(c, rounded)


def _factors_of(c: Document) -> Rows:
    """Return the factors on the noise of each sample of each output."""
    return c.get("factors") or [[F(1)] * len(c["noise"])] * len(c["y"])


def _true_output(c: Document, i: int, y: F, delta: F) -> Ends:
    """Return (lo, hi) of the true output behind a reading, in deviations."""
    lo, hi = y - c["offset_y"][i] - delta, y - c["offset_y"][i] + delta
    if "constant" in c:
        return lo, hi
    # y = (1 + theta) t + d with |d| <= delta, so t = (y - d) / (1 + theta): extreme at the ends of both
    least, most = 1 + c["tolerance"][i], 1 - c["tolerance"][i]
    return min(lo / least, lo / most), max(hi / least, hi / most)


def runs_of(c: Document) -> Iterator[list[Term]]:
    """Yield the terms of each run of an average, none where it is not looked at."""
    for run in c.get("runs", []):
        average, terms = c["averages"][int(run["average"])], []
        for part in (average, *average.get("beside", [])):
            if run["first"] is not None:
                for j, weight in enumerate(part["weights"], int(run["first"])):
                    terms.append((bool(average["output"]), j, int(part["number"]), weight))
        yield terms


def readings_of(c: Document, terms: Sequence[Term]) -> list[F | None]:
    """Return the readings that a run of an average sums up, None where one is missing."""
    return [c["all_y"][j][i] for measured, j, i, _ in terms if measured]


def _ends_of_sums(c: Document, rounded: Sequence[F]) -> dict[str, Ends]:
    """Return {sum: (lo, hi)} of the weighted sums of true values over runs that are looked at and miss no
    reading.

    The bound is one on the sum of noises, times the mean of their factors, by weight. What resolution,
    recorder and an error add to each reading is added by its weight; the floors are for numbers that a
    kernel rounds to zero on the way.
    """
    every = _factors_of(c)
    most = [max(own) for own in zip(*every, strict=True)]
    ends = {}
    for number, (run, terms) in enumerate(zip(c.get("runs", []), runs_of(c), strict=True)):
        if not terms or None in readings_of(c, terms):
            continue
        bound, size = c["averages"][int(run["average"])]["bound"], sum(abs(weight) for *_, weight in terms)
        middle, rad = F(0), ROUNDED * len(terms) * c["floor"]
        for measured, j, i, weight in terms:
            factor = F(1)
            if measured:
                factor = every[j][i]
                middle += weight * (c["all_y"][j][i] - c["offset_y"][i])
                rad += abs(weight) * (rounded[i] + c["recorder"] * c["noise"][i] * most[i])
            rad += abs(weight) * (ROUNDED * c["floor"] + factor * bound / size)
        ends[f"average{number}"] = middle - rad, middle + rad
    return ends


def _rounded(c: Document, error: Error) -> list[F]:
    """Return by how much readings of each output may be off beyond their noise: resolution, recorder times
    the largest reading that is looked at, alone or in an average, and an error that is allowed to it.
    """
    largest = [F(0)] * len(c["noise"])
    rows = list(c["y"])
    for terms in runs_of(c):
        for measured, j, i, _ in terms:
            if measured:
                rows.append([None] * i + [c["all_y"][j][i]])
    for row in rows:
        for i, y in enumerate(row):
            largest[i] = max(largest[i], abs(y or F(0)))
    rounded = add_multiple(c["resolution"], c["recorder"], largest)
    if error is not None:
        rounded[error[0]] += error[1]
    return rounded
