"""Circuits of a matrix: its left null vectors of minimal support, every one of them.

They are the strips of any zonotope whose directions have the left null space as row space.
Source: elementary vectors of a subspace, Rockafellar 1969.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import combinations
from operator import mul

from jaxbound.exact.linalg import (
    Matrix,
    Rows,
    Vector,
    determinant,
    identity,
    integers,
    left_null_space,
    primitive,
    row_reduce,
    transpose,
)


def circuits(a: Rows) -> Matrix:
    """Return every vector of minimal support with h a = 0, one of each pair h, -h.

    Every circuit lies in some set of rank + 1 rows of full rank, so subsets of that size suffice; or it
    vanishes at enough columns of the null space. The fewer subsets are gone through.

    Returns:
        Primitive rows, by support in lexicographic order.
    """
    basis = transpose(row_reduce(transpose(a))[0])  # the same left null space with full column rank
    height = len(a)
    if not basis:
        return identity(height)
    rank = len(basis[0])
    if rank < height - rank:
        candidates = _among_rows(basis, rank)
    else:
        candidates = _among_zeros(left_null_space(basis), height)
    by_support: dict[tuple[int, ...], Vector] = {}
    for row in candidates:
        by_support.setdefault(tuple(i for i, x in enumerate(row) if x), row)
    return tuple(by_support[support] for support in sorted(by_support))


def _among_rows(basis: Matrix, rank: int) -> Iterator[Vector]:
    """Yield the circuits, some more than once: each lies in rank + 1 of the rows."""
    whole = [integers(row) for row in basis]
    for subset in combinations(range(len(basis)), rank + 1):
        weights = _cofactors([whole[i][0] for i in subset])
        if any(weights):
            row = [Fraction(0)] * len(basis)
            for i, x in zip(subset, weights, strict=True):
                row[i] = Fraction(x) * whole[i][1]
            yield primitive(row)


def _among_zeros(null: Matrix, width: int) -> Iterator[Vector]:
    """Yield the circuits, some more than once: each vanishes at k - 1 columns of the null space (k, width),
    whose minors are small.
    """
    k = len(null)
    if k == 0:
        return
    whole = [[int(x) for x in primitive(row)] for row in null]
    for subset in combinations(range(width), k - 1):
        weights = _cofactors([[row[j] for j in subset] for row in whole])
        if any(weights):
            yield primitive([sum(map(mul, weights, column)) for column in zip(*whole, strict=True)])


def _cofactors(rows: Sequence[Sequence[int]]) -> list[int]:
    """Return the signed maximal minors of an (r + 1) x r integer matrix.

    They are its left null vector, or zeros if its rank is below r.
    """
    if len(rows) == 1:
        return [1]  # the determinant of no row
    minors = []
    for i in range(len(rows)):
        others = [row for k, row in enumerate(rows) if k != i]
        minors.append((-1) ** i * determinant(others))
    return minors
