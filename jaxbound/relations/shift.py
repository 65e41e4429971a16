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

__all__ = [
    "Polynomial",
    "Row",
    "add",
    "apply",
    "at",
    "coefficients",
    "degree",
    "matmul",
    "minus_shift",
    "presentable",
    "relation_text",
    "text",
]

Polynomial: TypeAlias = tuple[Fraction, ...]
Row: TypeAlias = tuple[Polynomial, ...]


def trim(a: Sequence[Fraction]) -> Polynomial:
    """Return a polynomial without trailing zeros."""
    n = len(a)
    while n and not a[n - 1]:
        n -= 1
    return tuple(a[:n])


def add(a: Polynomial, b: Polynomial) -> Polynomial:
    """Return a + b.

    Example:
        >>> text(add((Fraction(1), Fraction(2)), (Fraction(3), Fraction(-2))))
        '4'
    """
    pairs = zip_longest(a, b, fillvalue=Fraction(0))
    return trim([x + y for x, y in pairs])


def mul(a: Polynomial, b: Polynomial) -> Polynomial:
    """Return a b."""
    if not a or not b:
        return ()
    out = [Fraction(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            out[i + j] += x * y
    return trim(out)


def matmul(a: Sequence[Row], b: Sequence[Row]) -> tuple[Row, ...]:
    """Return the product of two matrices of polynomials."""
    out = []
    for row in a:
        total: list[Polynomial] = [()] * len(b[0])
        for x, other in zip(row, b, strict=True):
            if x:
                total = [add(t, mul(x, y)) for t, y in zip(total, other, strict=True)]
        out.append(tuple(total))
    return tuple(out)


def apply(a: Sequence[Vector], rows: Sequence[Row], width: int) -> tuple[Row, ...]:
    """Return a rows: numbers a (r, c) times c rows of `width` polynomials."""
    if not rows:
        return (((),) * width,) * len(a)
    polynomials = [tuple(trim((x,)) for x in row) for row in a]
    return matmul(polynomials, rows)


def minus_shift(rows: Sequence[Row], others: Sequence[Row]) -> tuple[Row, ...]:
    """Return q rows - others."""
    out = []
    for row, other in zip(rows, others, strict=True):
        out.append(tuple(_later(x, y) for x, y in zip(row, other, strict=True)))
    return tuple(out)


def _later(x: Polynomial, y: Polynomial) -> Polynomial:
    """Return q x - y."""
    return add(trim((Fraction(0), *x)), tuple(-c for c in y))


def degree(row: Row) -> int:
    """Return the highest power in a row, -1 for zeros."""
    return max(map(len, row)) - 1


def at(row: Row, q: Fraction) -> Vector:
    """Return the numbers that a row of polynomials takes at q."""
    return tuple(sum((c * q**j for j, c in enumerate(p)), Fraction(0)) for p in row)


def coefficients(row: Row) -> Matrix:
    """Return a row as a tuple over ascending powers of rows of numbers."""
    return tuple(zip_longest(*row, fillvalue=Fraction(0)))


def presentable(row: Row) -> Row:
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
    out = ""
    for j in reversed(range(len(a))):
        if a[j]:
            out += _sign(a[j] < 0, first=not out) + _term(abs(a[j]), _power(j))
    return out or "0"


def _sign(negative: bool, first: bool) -> str:
    """Return the sign of a term, with its blanks."""
    if first:
        return "-" if negative else ""
    return " - " if negative else " + "


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


def relation_text(row: Row, names: Sequence[str]) -> str:
    """Return a row of polynomials as a relation among signals.

    Example:
        >>> row = (Fraction(-2), Fraction(1)), (), (Fraction(0), Fraction(-3))
        >>> relation_text(row, ("y1", "y2", "u1"))
        '(q - 2) y1 - 3 q u1 = 0'
    """
    out = ""
    for p, name in zip(row, names, strict=True):
        if not p:
            continue
        sign = _sign(p[-1] < 0, first=not out)
        if p[-1] < 0:
            p = linalg.scale(p, -1)
        out += sign + _factor(p) + name
    return out + " = 0"


def _factor(p: Polynomial) -> str:
    """Return a polynomial as a factor in text, in brackets where it is a sum, nothing for 1."""
    body = text(p)
    if body == "1":
        return ""
    if sum(map(bool, p)) > 1:
        return f"({body}) "
    return f"{body} "
