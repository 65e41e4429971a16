"""Which single sensor could be wrong, and by how much at least? The smallest error of one sensor that would
explain a FAULT window.

An error of up to e in the samples of one output is a noise bound larger by e, on that output alone. Each
relation that is violated gives a bound from below: the e at which it just holds. The relation most violated
at that e gives the next, until none is violated: there are finitely many, so the last bound is the smallest
error, exactly. A relation without the sensor that is violated says that no error of it explains the window.
"""

from dataclasses import dataclass
from fractions import Fraction

from jaxbound.certificates.exact_window import ExactWindow, Explanation, stretched

__all__ = ["SensorError", "rounded_witness", "smallest_error"]

DIGITS = (4, 8, 12, 17)
ZERO = Fraction(0)


@dataclass(frozen=True)
class SensorError:
    """Fields: output, its number; size: the smallest error that explains the window, in the unit of the
    output, None where no error does;
    h: the relation that proves it, violated by any smaller one; enough: size rounded up; z: unknowns that
    explain the window with it.
    """

    output: int
    size: Fraction | None
    h: tuple
    enough: Fraction | None = None
    z: tuple | None = None


def smallest_error(window: ExactWindow, i: int, explanation: Explanation) -> SensorError:
    """Return the SensorError of output i for an ExactWindow and its Explanation."""
    best, size, h = explanation, Fraction(0), explanation.h
    while best.factor > 1:
        h, size = best.h, _error_that_holds(window, best.h, i)
        if size is None:
            return SensorError(i, None, h)
        best = window.with_error(i, size).solve(best.reference)
    if not size:
        return SensorError(i, size, h)
    enough = _rounded_up(size)
    wider = window.with_error(i, enough)
    return SensorError(i, size, h, enough, rounded_witness(wider, wider.solve(best.reference).z))


def rounded_witness(window: ExactWindow, z: tuple[Fraction, ...]) -> tuple[Fraction, ...]:
    """Return z with as few digits as still explain the window."""
    states = window.model.n
    for digits in DIGITS:
        short = [Fraction(f"{float(v):.{digits}g}") for v in z]
        for j, (lo, hi) in enumerate(window.disturbance * window.horizon, states):
            short[j] = max(lo, min(short[j], hi))
        if window.explained_by(short):
            return tuple(short)
    return z


def _error_that_holds(window, h, i):
    """Return the error of output i at which a relation just holds, or None if it does not use that output."""
    _, residual, width = window.relation(h)
    h = h if residual < 0 else tuple(-x for x in h)
    reach = width - abs(
        residual
    )  # of the relation beyond zero: negative while violated, and increasing in the error
    sigma, terms = window.tolerance[i], []
    for j, (d, rho) in enumerate(window.readings()):
        if j % window.model.p == i and h[j]:
            terms.append((abs(h[j]), rho + d if h[j] > 0 else rho - d))
    steady = ZERO  # of sums, whose bounds grow by as much an error
    for j, row in enumerate(window.rows.of_sums, window.rows.single):
        if h[j] and row.values.measured:
            steady += abs(h[j]) * row.values.size_of(i)
    if not terms and not steady:
        return None
    reach -= sum(a * stretched(c, sigma) for a, c in terms)
    at = lambda e: reach + steady * e + sum(a * stretched(c + e, sigma) for a, c in terms)
    low = max(
        (-c for _, c in terms if c < 0 and at(-c) < 0), default=ZERO
    )  # slopes change where a reading's limit is zero
    slope = steady + sum(a / (1 - sigma if c + low >= 0 else 1 + sigma) for a, c in terms)
    return low - at(low) / slope


def _rounded_up(x, digits=4):
    """Return a number of few digits that is not below x > 0."""
    unit = Fraction(10) ** (len(str(x.numerator)) - len(str(x.denominator)) - digits)
    return -(-x // unit) * unit
