"""Polynomials in the shift operator q, q y[k] = y[k+1], with exact coefficients; rows of them as relations
among signals.

A polynomial is a tuple of Fractions by ascending powers without trailing zeros, () is 0; a matrix a tuple of
rows of polynomials.
"""

from collections.abc import Sequence
from fractions import Fraction
from itertools import chain, islice, zip_longest
from typing import TypeAlias

from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, Vector
from jaxbound.relations.sentence import bracketed, joined

Polynomial: TypeAlias = tuple[Fraction, ...]
Row: TypeAlias = tuple[Polynomial, ...]


def trim(a: Sequence[Fraction]) -> Polynomial:
    """Return a polynomial without trailing zeros."""
    n = len(a)
    while n and not a[n - 1]:
        n -= 1
    return tuple(a[:n])


def degree(row: Row) -> int:
    """Return the highest power in a row, -1 for zeros."""
    return max(map(len, row)) - 1


def at(row: Row, q: Fraction) -> Vector:
    """Return the numbers that a row of polynomials takes at q."""
    return tuple(sum((c * q**j for j, c in enumerate(p)), Fraction(0)) for p in row)


def coefficients(row: Row) -> Matrix:
    """Return a row as a tuple over ascending powers of rows of numbers."""
    return tuple(zip_longest(*row, fillvalue=Fraction(0)))


def presentable_row(row: Row) -> Row:
    """Scale a row to coprime integers, or to largest entry 1 where these are long; the first leading
    coefficient is positive.
    """
    scaled = linalg.presentable(linalg.primitive(list(chain(*row))))
    leading = next(len(p) for p in row if p) - 1
    if scaled[leading] < 0:
        scaled = linalg.scale(scaled, -1)
    numbers = iter(scaled)
    return tuple(tuple(islice(numbers, len(p))) for p in row)


def text(a: Polynomial) -> str:
    """Return a polynomial as text, the highest power first.

    Example:
        >>> text((Fraction(2), Fraction(-4), Fraction(1, 3)))
        '1/3 q^2 - 4 q + 2'
    """
    terms = [(a[j] < 0, _term(abs(a[j]), _power(j))) for j in reversed(range(len(a))) if a[j]]
    return joined(terms) or "0"


def _power(j: int) -> str:
    """Return q^j as text, nothing for j = 0."""
    if j < 2:
        return ("", "q")[j]
    return f"q^{j}"


def _term(size: Fraction, power: str) -> str:
    """Return a coefficient > 0 times a power of q as text."""
    if size == 1 and power:
        return power
    factor = str(size)
    if size.denominator >= 1000:
        factor = f"{float(size):.6g}"
    return f"{factor} {power}".strip()


def row_text(row: Row, names: Sequence[str]) -> str:
    """Return a row of polynomials as a relation among signals.

    Example:
        >>> row = (Fraction(-2), Fraction(1)), (), (Fraction(0), Fraction(-3))
        >>> row_text(row, ("y1", "y2", "u1"))
        '(q - 2) y1 - 3 q u1 = 0'
    """
    terms = []
    for p, name in zip(row, names, strict=True):
        if not p:
            continue
        negative = p[-1] < 0
        if negative:
            p = linalg.scale(p, -1)
        terms.append((negative, bracketed(text(p), sum(map(bool, p))) + name))
    return joined(terms) + " = 0"
