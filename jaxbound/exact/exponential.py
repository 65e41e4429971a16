"""The matrix exponential and the integral of its absolute values, enclosed: whole numbers on the host,
nothing runs per window.

A number is a Python integer times 2^-b. A product of matrices is exact up to one rounding of each entry, so
that every error is a sum of a few known terms; with 160 bits and more they are far below what a float can
say.

Source: scaling and squaring with a truncated series, Moler, Van Loan 2003, methods 1 and 3, with all error
terms kept.
"""

from collections.abc import Callable, Sequence
from fractions import Fraction
from math import ceil, floor
from typing import TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

Exact: TypeAlias = NDArray[np.object_]
"""A matrix of Fractions, or of Python's integers."""
Rational: TypeAlias = Sequence[Sequence[Fraction | int]] | Exact

TERMS = 30  # of the series, for a matrix of norm 1/4 or less: what follows is below 2^-170
BITS = 160
PIECES = 512


def exponential(M: Rational) -> tuple[Exact, Fraction]:
    """Return (X, e): a matrix near e^M, and a bound of the error of each entry.

    Args:
        M: (n, n) Fractions, nested sequences or an array of them.

    Returns:
        X: (n, n) array of Fractions. e: a Fraction, the row sums of |X - e^M| are at most e.

    Raises:
        ValueError: e^M has an entry above 1e300.

    Encloses: X - e <= e^M <= X + e, entry by entry.

    Example:
        >>> X, e = exponential([[0, 1], [0, 0]])
        >>> [[float(x) for x in row] for row in X], e < Fraction(1, 10**40)
        ([[1.0, 1.0], [0.0, 1.0]], True)
    """
    M = np.array(M, np.object_)
    halvings = _halvings(M, Fraction(1, 4))
    bits = BITS + 4 * halvings
    X, e = _series(M, halvings, bits)
    for _ in range(halvings):
        X, e = _product(X, e, X, e, bits)
        if _norm(X) >> bits > 10**300:
            raise ValueError(
                "over one step the model grows by more than a float can say: choose a shorter step"
            )
    return _fractions(X, bits), Fraction(e, 1 << bits)


def absolute_integral(A: Rational, T: Fraction | int) -> Exact:
    """Return a bound of the integral of |e^(A t)|, entry by entry, over t from 0 to T.

    Between two of many points of time an entry is within h^2 / 8 times its second derivative of a straight
    line; past PIECES points the interval is doubled by |e^(A (T + t))| <= |e^(A T)| |e^(A t)|.

    Args:
        A: (n, n) Fractions. T: a positive Fraction.

    Returns:
        (n, n) array of Fractions, within 1 % of the integral for every matrix with |A| T <= 32.

    Raises:
        ValueError: as `exponential`.

    Encloses: the integral is at most this.

    Example:
        >>> print(f"{float(absolute_integral([[-2]], 1)[0, 0]):.3f}")  # (1 - e^-2) / 2 = 0.4323
        0.433
    """
    A = np.array(A, np.object_)
    halvings = max(_halvings(A * T, Fraction(1, 16)), 5)
    doublings, bits = max(halvings - PIECES.bit_length() + 1, 0), BITS + 4 * halvings
    pieces, h = 1 << (halvings - doublings), T / Fraction(1 << halvings)
    step, e_step = _series(A * T, halvings, bits)
    growth, e_growth = _series(abs(A) * T, halvings, bits)
    growth = growth + e_growth
    curved = abs(_scaled(A @ A, bits)) + 1
    X, e = _one(len(A), bits), 0
    ends, curvature = np.zeros_like(X), np.zeros_like(X)
    for _ in range(pieces):
        before = abs(X) + e
        curvature = curvature + before  # |A^2 X| <= |A^2| |X|, the same for every piece
        X, e = _product(X, e, step, e_step, bits)
        ends = ends + before + (abs(X) + e)
    ends, curvature = _fractions(ends, bits), _fractions(curvature, bits)
    bent = _fractions(curved, bits) @ curvature @ _fractions(growth, bits)
    total = h / 2 * ends + h**3 / 12 * bent  # the trapezoidal rule, and h^3 / 12 times the second derivative
    for _ in range(doublings):
        total = total + _fractions(abs(X) + e, bits) @ total
        X, e = _product(X, e, X, e, bits)
        total = _rounded_up(total, bits)
    return _rounded_up(total, bits)


def _halvings(M: Exact, small: Fraction) -> int:
    """Return how often M must be halved for a norm of at most `small`."""
    return max(0, ceil(Fraction(_norm(M)) / small) - 1).bit_length()


def _norm(M: Exact) -> int:
    """Return the largest sum of magnitudes in a row."""
    return cast(int, abs(M).sum(axis=1).max())  # an entry of an array of objects


def _one(n: int, bits: int) -> Exact:
    return np.eye(n, dtype=object) * (1 << bits)


def _scaled(M: Exact, bits: int) -> Exact:
    """Return M 2^bits, rounded down to integers."""
    return _each(lambda x: floor(Fraction(x) * (1 << bits)), M)


def _fractions(X: Exact, bits: int) -> Exact:
    """Return integers X as the fractions X 2^-bits."""
    return _each(lambda x: Fraction(x, 1 << bits), X)


def _rounded_up(X: Exact, bits: int) -> Exact:
    return _each(lambda x: Fraction(ceil(x * (1 << bits)), 1 << bits), X)


def _each(change: Callable[[Fraction], Fraction | int], X: Exact) -> Exact:
    return np.asarray(np.vectorize(change, otypes=[object])(X))


def _series(M: Exact, halvings: int, bits: int) -> tuple[Exact, int]:
    """Return e^(M / 2^halvings) as integers and the norm of its error, for a matrix M / 2^halvings of norm
    1/4 or less.

    Horner's rule: each of the steps P = 1 + N P / k adds one unit an entry, damped by 1/4 from step to step;
    N itself is off by one unit an entry, which the exponential enlarges by less than 1.3; the terms left out
    count as one unit more.
    """
    n = len(M)
    N = _scaled(M / Fraction(1 << halvings), bits)
    P = _one(n, bits)
    for k in range(TERMS, 0, -1):
        P = _one(n, bits) + (N @ P) // (k << bits)
    return P, 4 * n


def _product(X: Exact, e: int, Y: Exact, f: int, bits: int) -> tuple[Exact, int]:
    """Return X Y and the norm of its error."""
    return (X @ Y) >> bits, ((_norm(X) * f + _norm(Y) * e + e * f) >> bits) + 1 + len(X)
