"""Large regular systems of whole numbers, solved exactly by lifting from a prime, and verified: no
determinant grows on the way.
"""

from collections.abc import Sequence
from math import isqrt

import numpy as np

__all__ = ["lifted"]

PRIME = 2**27 - 39
"""Sums of some hundred products of two residues fit 64 bits."""
WIDEST = 500  # unknowns for which that is so


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
    inverse = _inverse(np.array([[x % PRIME for x in row] for row in M], np.int64)) if n <= WIDEST else None
    if inverse is None:
        return None
    sparse = [[(j, x) for j, x in enumerate(row) if x] for row in M]
    bits = (
        sum(sum(abs(x) for x in row).bit_length() for row in M) + max(map(abs, right), default=0).bit_length()
    )
    most = 2 * bits // 26 + 4  # Cramer's rule: numerators and denominators have no more
    rest, found, power, steps, tried = list(right), [0] * n, 1, 0, 8
    while steps < most:
        digits = (inverse @ np.array([x % PRIME for x in rest], np.int64) % PRIME).tolist()
        rest = [
            (r - sum(x * digits[j] for j, x in row)) // PRIME for r, row in zip(rest, sparse, strict=True)
        ]
        found = [x + d * power for x, d in zip(found, digits, strict=True)]
        power, steps = power * PRIME, steps + 1
        if steps in (tried, most):
            tried *= 2
            solved = _fractions(found, power)
            if solved and _keeps(sparse, right, *solved):
                return solved
    return None


def _keeps(sparse, right, x, det):
    """Return whether M x = right * det."""
    return all(sum(a * x[j] for j, a in row) == r * det for row, r in zip(sparse, right, strict=True))


def _inverse(M):
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


def _fractions(residues, modulus):
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


def _denominator(residue, modulus):
    """Return the smallest denominator that makes a residue a short number, or None."""
    bound = isqrt(modulus // 2)
    before, now, low, high = modulus, residue, 0, 1
    while now > bound:
        times = before // now
        before, now = now, before - times * now
        low, high = high, low - times * high
    return abs(high) if 0 < abs(high) <= bound else None
