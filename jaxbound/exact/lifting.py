"""Large regular systems of whole numbers, solved exactly by lifting from a prime, and verified: no
determinant grows on the way.
"""

from collections.abc import Sequence
from math import isqrt
from typing import TypeAlias

import numpy as np

__all__ = ["lifted"]

PRIME = 2**27 - 39
"""Sums of some hundred products of two residues fit 64 bits."""
WIDEST = 500  # unknowns for which that is so

Sparse: TypeAlias = list[list[tuple[int, int]]]
"""Rows of (column, integer) without zeros."""


def lifted(M: Sequence[Sequence[int]], right: Sequence[int]) -> tuple[list[int], int] | None:
    """Return (x, det) of integers with M x = right * det, det > 0; None: not found, which says nothing of M.

    With the inverse of M modulo p, x comes digit by digit in base p; numerators and denominators follow by
    Euclid's algorithm. What is returned keeps the equations exactly: nothing rests on how many digits were
    taken.

    Source: Dixon 1982; Wang 1981 for the fractions.

    Example:
        >>> lifted([[2, 1], [0, 3]], [1, 1])
        ([1, 1], 3)
    """
    n = len(M)
    if n > WIDEST:
        return None
    inverse = _inverse(_residues(M))
    if inverse is None:
        return None
    sparse: Sparse = [[(j, x) for j, x in enumerate(row) if x] for row in M]
    most = _most_digits(sparse, right)
    rest, x, power, tried = list(right), [0] * n, 1, 8
    for steps in range(1, most + 1):
        # M x = right + power rest: the next digit solves the rest modulo p
        digits = (inverse @ _residues(rest) % PRIME).tolist()
        rest = [(r - y) // PRIME for r, y in zip(rest, _times(sparse, digits), strict=True)]
        x = [known + d * power for known, d in zip(x, digits, strict=True)]
        power *= PRIME
        if steps not in (tried, most):
            continue
        tried *= 2
        fractions = _fractions(x, power)
        if fractions is None:
            continue
        numerators, det = fractions
        if _times(sparse, numerators) == [r * det for r in right]:
            return fractions
    return None


def _residues(numbers: Sequence[int] | Sequence[Sequence[int]]) -> np.ndarray:
    """Return integers modulo the prime."""
    return (np.array(numbers, object) % PRIME).astype(np.int64)


def _times(rows: Sparse, x: Sequence[int]) -> list[int]:
    return [sum(a * x[j] for j, a in row) for row in rows]


def _most_digits(rows: Sparse, right: Sequence[int]) -> int:
    """Return how many digits are enough: by Cramer's rule numerators and denominators have no more bits than
    the sizes of all rows and of the right side together.
    """
    bits = max(map(abs, right), default=0).bit_length()
    for row in rows:
        bits += sum(abs(x) for _, x in row).bit_length()
    return 2 * bits // 26 + 4


def _inverse(M: np.ndarray) -> np.ndarray | None:
    """Return the inverse modulo the prime, or None."""
    n = len(M)
    work = np.concatenate([M, np.eye(n, dtype=np.int64)], 1)
    for j in range(n):
        below = np.flatnonzero(work[j:, j])
        if not len(below):
            return None
        i = j + below[0]
        work[[j, i]] = work[[i, j]]
        work[j] = work[j] * pow(int(work[j, j]), -1, PRIME) % PRIME
        factors = work[:, j].copy()
        factors[j] = 0
        work = (work - factors[:, None] * work[j] % PRIME) % PRIME
    return work[:, n:]


def _fractions(residues: Sequence[int], modulus: int) -> tuple[list[int], int] | None:
    """Return (numerators, their common denominator) of numbers known modulo a power of the prime; None where
    there are none so short.
    """
    det = 1
    for residue in residues:
        denominator = _denominator(residue * det % modulus, modulus)
        if denominator is None:
            return None
        det *= denominator
    half = modulus // 2
    return [(x * det + half) % modulus - half for x in residues], det


def _denominator(residue: int, modulus: int) -> int | None:
    """Return the smallest denominator that makes a residue a short number, or None.

    Euclid's algorithm on modulus and residue, until what is left is short: each remainder is a multiple of
    the residue, by the number that is followed beside it.
    """
    bound = isqrt(modulus // 2)
    before, now, low, high = modulus, residue, 0, 1
    while now > bound:
        times = before // now
        before, now = now, before - times * now
        low, high = high, low - times * high
    if 0 < abs(high) <= bound:
        return abs(high)
    return None
