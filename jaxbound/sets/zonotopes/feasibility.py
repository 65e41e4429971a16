"""Is there x in [-1, 1]^q with M x = d, exactly? For one point: on the boundary, in a flat set, or to be
shown to somebody.

Rows of M are solved for basic variables one after another; a basic variable outside of [-1, 1] changes places
with one that can still move and helps it, the first of each kind (Bland's rule, by which it ends). If none
helps, the row proves that there is no x. Source: Dutertre, de Moura, A fast linear-arithmetic solver for
DPLL(T), 2006. All numbers are whole: every division is exact (Edmonds 1967; Bareiss 1968). A good guess
leaves little to do but the elimination.
"""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from math import lcm
from typing import TypeAlias

__all__ = ["feasible"]


Found: TypeAlias = tuple[list[Fraction], None] | tuple[None, list[Fraction]]
"""A point, or the direction that proves that there is none."""


def feasible(
    M: Sequence[Sequence[Fraction | float]],
    d: Sequence[Fraction | float],
    guess: Sequence[float] | None = None,
    order: Iterable[int] | None = None,
) -> Found:
    """Return (x, None), a point x in [-1, 1]^q with M x = d, or (None, l), a direction with l'd > sum_j |l'
    M_j|: Fractions.

    Args:
        M: m rows of q numbers, floats or Fractions, read exactly. d: m numbers.
        guess: q floats, where x may be. order: the q variables, those to be solved for first.

    Example:
        >>> feasible([[1.0, 1.0]], [2.0])[0], feasible([[1.0, 1.0]], [2.5])[1]
        ([Fraction(1, 1), Fraction(1, 1)], [Fraction(1, 1)])
    """
    m, q = len(M), len(M[0]) if len(M) else 0
    rows, scales, known = [], [], [Fraction(v) for v in d]
    for i, row in enumerate(M):
        exact = [Fraction(v) for v in row]
        scale = lcm(*(v.denominator for v in exact), 1)
        rows.append(
            [int(v * scale) for v in exact] + [int(i == k) for k in range(m)]
        )  # beside M, what was done to its rows
        scales.append(scale)
    combination = lambda row: [Fraction(e * s) for e, s in zip(row[q:], scales, strict=True)]
    value = lambda row: sum(
        (Fraction(e * s) * v for e, s, v in zip(row[q:], scales, known, strict=True) if e), Fraction(0)
    )

    basis: list[int] = []
    last = 1
    for j in range(q) if order is None else order:
        pivot = next((i for i in range(len(basis), m) if rows[i][j]), None)
        if pivot is not None:
            rows[len(basis)], rows[pivot] = rows[pivot], rows[len(basis)]
            last = _pivot(rows, len(basis), j, last)
            basis.append(j)
    for row in rows[len(basis) :]:  # combinations of rows that are zero in M
        if short := value(row):
            return None, [v if short > 0 else -v for v in combination(row)]
    rows = rows[: len(basis)]

    start = [0.0] * q if guess is None else guess
    x = [Fraction(v) if abs(v) < 1 - 2.0**-20 else Fraction(1 if v > 0 else -1) for v in start]
    while True:
        for row, j in zip(rows, basis, strict=True):
            x[j] = (
                value(row)
                - sum((c * x[k] for k, c in enumerate(row[:q]) if c and k not in basis), Fraction(0))
            ) / last
        j = min((j for j in basis if abs(x[j]) > 1), default=-1)
        if j < 0:
            return x, None
        i, up = basis.index(j), x[j] < -1
        helps = (
            k
            for k, c in enumerate(rows[i][:q])
            if c and k not in basis and (x[k] > -1 if (c * last > 0) == up else x[k] < 1)
        )
        k = next(helps, None)
        if k is None:
            sign = (-1 if up else 1) * (1 if last > 0 else -1)
            return None, [sign * v for v in combination(rows[i])]
        x[j] = Fraction(-1 if up else 1)
        last = _pivot(rows, i, k, last)
        basis[i] = k


def _pivot(rows: list[list[int]], i: int, j: int, last: int) -> int:
    """Solve row i for variable j and put it into the others; all basic columns then hold the number returned,
    alone.
    """
    pivot = rows[i][j]
    for k, row in enumerate(rows):
        if k != i:
            f = row[j]
            rows[k] = [(pivot * a - f * b) // last for a, b in zip(row, rows[i], strict=True)]
    return pivot
