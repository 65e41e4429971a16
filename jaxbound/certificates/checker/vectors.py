"""Vectors and matrices of numbers or of polynomials: lists of exact numbers, and rows of them."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Any

__all__ = ["add", "combine", "dots", "turned"]


def dots(rows: Iterable[Sequence[Any]], vector: Sequence[Any]) -> list[Any]:
    """Return the product of rows with a vector, of numbers or polynomials."""
    return [sum((a * b for a, b in zip(row, vector, strict=True) if a), Fraction(0)) for row in rows]


def combine(weights: Sequence[Any], *matrices: Iterable[Sequence[Any]]) -> list[Any]:
    """Return weights times the rows of matrices that stand above each other: h C + q A for (h, q), C, A."""
    rows = [row for matrix in matrices for row in matrix]
    return dots(turned(rows), weights)


def turned(matrix: Iterable[Iterable[Any]]) -> list[tuple[Any, ...]]:
    """Return the columns of a matrix."""
    return list(zip(*matrix, strict=True))


def add(*vectors: Iterable[Any]) -> list[Any]:
    """Return the sum of vectors."""
    return [sum(entries[1:], entries[0]) for entries in zip(*vectors, strict=True)]
