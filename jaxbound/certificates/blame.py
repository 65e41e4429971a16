"""The smallest error of one sensor alone that would explain a FAULT window.

An error of up to e in the samples of one output is a noise bound larger by e, on that output alone. Each
relation that is violated gives a bound from below: the e at which it just holds. The relation most violated
at that e gives the next, until none is violated: there are finitely many, so the last bound is the smallest
error, exactly. A relation without the sensor that is violated says that no error of it explains the window.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias

from jaxbound.certificates.exact_window import ExactWindow, Explanation, stretched
from jaxbound.exact.linalg import Vector

__all__ = ["SensorError", "rounded_up", "rounded_witness", "smallest_error"]

DIGITS = (4, 8, 12, 17)
ZERO = Fraction(0)
LARGEST = Fraction(10**300)
"""Of a number that is rounded for readers."""
Slopes: TypeAlias = list[tuple[Fraction, Fraction]]
"""(a, c) of terms a f(c + e) in an error e, f(v) = v / (1 -+ sigma): see `exact_window`."""


@dataclass(frozen=True)
class SensorError:
    """Fields: output, its number; size: the smallest error that explains the window, in the unit of the
    output, None where no error does;
    h: the relation that proves it, violated by any smaller one; enough: size rounded up; z: unknowns that
    explain the window with it.
    """

    output: int
    size: Fraction | None
    h: Vector
    enough: Fraction | None = None
    z: Vector | None = None


def smallest_error(window: ExactWindow, i: int, explanation: Explanation) -> SensorError:
    """Return the SensorError of output i for an ExactWindow and its Explanation."""
    best, h = explanation, explanation.h
    size: Fraction | None = ZERO
    while best.factor > 1:
        h = best.h
        size = _error_that_holds(window, h, i)
        if size is None:
            return SensorError(i, None, h)
        best = window.with_error(i, size).solve(best.reference)
    if not size:
        return SensorError(i, size, h)
    enough = rounded_up(size)
    wider = window.with_error(i, enough)
    return SensorError(i, size, h, enough, rounded_witness(wider, wider.solve(best.reference).z))


def rounded_witness(window: ExactWindow, z: Vector) -> Vector:
    """Return z with as few digits as still explain the window."""
    states = window.model.n
    if any(abs(v) > LARGEST for v in z):
        return z  # beyond floats
    for digits in DIGITS:
        short = [Fraction(f"{float(v):.{digits}g}") for v in z]
        for j, (lo, hi) in enumerate(window.disturbance * window.horizon, states):
            short[j] = max(lo, min(short[j], hi))
        if window.explained_by(short):
            return tuple(short)
    return z


def _error_that_holds(window: ExactWindow, h: Vector, i: int) -> Fraction | None:
    """Return the error of output i at which a relation just holds, or None if it does not use that output.

    The most that bounds allow of h (Y, w) - k U grows with the error e, and the relation holds where it
    reaches 0. It is a sum of a f(c + e) and of steady e: increasing and piecewise linear, with another slope
    where the limit of a reading is 0.
    """
    _, residual, width = window.relation(h)
    if residual > 0:  # of h and -h the one whose most is below 0
        h = tuple(-x for x in h)
    terms, steady = _slopes(window, h, i)
    if not terms and not steady:
        return None
    sigma = window.tolerance[i]
    reach = width - abs(residual)  # negative while it is violated
    for a, c in terms:
        reach -= a * stretched(c, sigma)

    def most(e: Fraction) -> Fraction:
        return reach + steady * e + sum(a * stretched(c + e, sigma) for a, c in terms)

    low = ZERO  # the last break before it holds
    for _, c in terms:
        if c < 0 and most(-c) < 0:
            low = max(low, -c)
    slope = steady
    for a, c in terms:
        if c + low >= 0:
            slope += a / (1 - sigma)
        else:
            slope += a / (1 + sigma)
    return low - most(low) / slope


def _slopes(window: ExactWindow, h: Vector, i: int) -> tuple[Slopes, Fraction]:
    """Return the terms of a relation's readings of output i, and how its sums grow with an error of it."""
    terms, steady = [], ZERO
    for j, (d, rho) in enumerate(window.readings()):
        if j % window.model.p != i or d is None or not h[j]:
            continue
        if h[j] > 0:
            terms.append((h[j], rho + d))
        else:
            terms.append((-h[j], rho - d))
    for j, row in enumerate(window.rows.of_sums, window.rows.single):
        if h[j] and row.values.measured:
            steady += abs(h[j]) * row.values.size_of(i)
    return terms, steady


def rounded_up(x: Fraction, digits: int = 4) -> Fraction:
    """Return a number of few digits that is not below x > 0."""
    unit = Fraction(10) ** (len(str(x.numerator)) - len(str(x.denominator)) - digits)
    return -(-x // unit) * unit
