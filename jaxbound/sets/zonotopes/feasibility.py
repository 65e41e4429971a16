"""Is there x in [-1, 1]^q with M x = d, exactly? For one point: on the boundary, in a flat set, or to be
shown to somebody.

M is eliminated: x_p = d'_p - sum_j R_pj x_j for the variables p that were solved for. The least max|x| over
the others, which are free, is an exact Chebyshev problem: its point is x, its circuit h = l' M proves that
there is none.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import TypeAlias

from jaxbound.exact import linalg
from jaxbound.exact.chebyshev import chebyshev

Found: TypeAlias = tuple[list[Fraction], None] | tuple[None, list[Fraction]]
"""A point, or the direction that proves that there is none."""


def feasible(M: Sequence[Sequence[Fraction | float]], d: Sequence[Fraction | float]) -> Found:
    """Return (x, None), a point x in [-1, 1]^q with M x = d, or (None, l), a direction with l'd > sum_j |l'
    M_j|: Fractions.

    Args:
        M: m rows of q numbers, floats or Fractions, read exactly. d: m numbers.

    Example:
        >>> feasible([[1.0, 1.0]], [2.0])[0], feasible([[1.0, 1.0]], [2.5])[1]
        ([Fraction(1, 1), Fraction(1, 1)], [Fraction(1, 1)])
    """
    m, q = len(M), len(M[0]) if len(M) else 0
    beside = [
        [*(Fraction(x) for x in (*row, v)), *one]
        for row, v, one in zip(M, d, linalg.identity(m), strict=True)
    ]
    rows, pivots = linalg.row_reduce(beside)  # beside M, d and what was done to the rows
    solved = {p: row for p, row in zip(pivots, rows, strict=False) if p < q}
    if q in pivots:  # a combination of rows that is zero in M
        return None, list(rows[pivots.index(q)][q + 1 :])
    if not q:
        return [], None
    free = [j for j in range(q) if j not in solved]
    itself = lambda j: [Fraction(-(j == k)) for k in range(q + 1)]
    equations = [solved.get(j) or itself(j) for j in range(q)]
    offsets = [row[q] for row in equations]
    slopes = [[row[k] for k in free] or [Fraction(0)] for row in equations]
    best = chebyshev(slopes, offsets, [Fraction(1)] * q)
    if best.t <= 1:
        return [b - linalg.dot(row, best.z) for b, row in zip(offsets, slopes, strict=True)], None
    sign = 1 if linalg.dot(best.h, offsets) > 0 else -1
    return None, list(
        linalg.multiply(
            linalg.transpose([row[q + 1 :] for row in solved.values()]), [sign * best.h[p] for p in solved]
        )
    )
