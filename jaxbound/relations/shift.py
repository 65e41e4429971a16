"""Polynomials in the shift operator q, q y[k] = y[k+1], with exact coefficients; rows of them as relations
among signals.

A polynomial is a tuple of Fractions by ascending powers without trailing zeros, () is 0; a matrix a tuple of
rows of polynomials.
"""

from collections.abc import Sequence
from fractions import Fraction
from itertools import zip_longest
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
    return trim([x + y for x, y in zip_longest(a, b, fillvalue=Fraction(0))])


def mul(a: Polynomial, b: Polynomial) -> Polynomial:
    """Return a b."""
    out = [Fraction(0)] * (len(a) + len(b) - 1) if a and b else []
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
            total = [add(t, mul(x, y)) for t, y in zip(total, other, strict=True)] if x else total
        out.append(tuple(total))
    return tuple(out)


def apply(a: Sequence[Vector], rows: Sequence[Row], width: int) -> tuple[Row, ...]:
    """Return a rows: numbers a (r, c) times c rows of `width` polynomials."""
    if not rows:
        return tuple(((),) * width for _ in a)
    return matmul([tuple(trim((x,)) for x in r) for r in a], rows)


def minus_shift(rows: Sequence[Row], others: Sequence[Row]) -> tuple[Row, ...]:
    """Return q rows - others."""
    return tuple(
        tuple(add((Fraction(0), *x) if x else (), tuple(-c for c in y)) for x, y in zip(r, o, strict=True))
        for r, o in zip(rows, others, strict=True)
    )


def degree(row: Row) -> int:
    """Return the highest power in a row, -1 for zeros."""
    return max(map(len, row)) - 1


def at(row: Row, q: Fraction) -> Vector:
    """Return the numbers that a row of polynomials takes at q."""
    return tuple(sum((c * q**j for j, c in enumerate(p)), Fraction(0)) for p in row)


def coefficients(row: Row) -> Matrix:
    """Return a row as a tuple over ascending powers of rows of numbers."""
    return tuple(tuple(p[j] if j < len(p) else Fraction(0) for p in row) for j in range(degree(row) + 1))


def presentable(row: Row) -> Row:
    """Scale a row to coprime integers, or to largest entry 1 where these are long; the first leading
    coefficient is positive.
    """
    scaled = linalg.presentable(linalg.primitive([c for p in row for c in p]))
    numbers = iter(scaled if scaled[len(next(p for p in row if p)) - 1] > 0 else [-x for x in scaled])
    return tuple(tuple(next(numbers) for _ in p) for p in row)


def text(a: Polynomial) -> str:
    """Return a polynomial as text, the highest power first.

    Example:
        >>> text((Fraction(2), Fraction(-4), Fraction(1, 3)))
        '1/3 q^2 - 4 q + 2'
    """
    out = ""
    for j in reversed(range(len(a))):
        if a[j]:
            sign = ("-" if a[j] < 0 else "") if not out else (" - " if a[j] < 0 else " + ")
            out += sign + _term(abs(a[j]), "" if j == 0 else "q" if j == 1 else f"q^{j}")
    return out or "0"


def _term(size, power):
    factor = str(size) if size.denominator < 1000 else f"{float(size):.6g}"
    return power if size == 1 and power else f"{factor} {power}".strip()


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
        negative = p[-1] < 0
        p = tuple(-c for c in p) if negative else p
        sign = ("-" if negative else "") if not out else (" - " if negative else " + ")
        body = text(p)
        factor = "" if body == "1" else f"({body}) " if sum(map(bool, p)) > 1 else f"{body} "
        out += sign + factor + name
    return out + " = 0"
