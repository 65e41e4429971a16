"""Matrices whose entries are polynomials in bounded variables v, exact: sum over alpha of M_alpha v^alpha.

| paper | here |
|---|---|
| alpha | a tuple of exponents, one for each variable |
| v_[alpha], its order rho | the monomial v^alpha, sum(alpha) |
| O_[alpha] | `terms[alpha]`, sparse: {(row, column): Fraction} |

Source: Ploix, Adrot 2006, (7)-(8).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import prod
from typing import TypeAlias

from jaxbound.exact.linalg import Matrix

Exponents: TypeAlias = tuple[int, ...]
Terms: TypeAlias = dict[Exponents, dict[tuple[int, int], Fraction]]


@dataclass(frozen=True, eq=False)
class PolynomialMatrix:
    """A matrix (rows, columns) of polynomials in `variables` variables; zero entries and empty terms are not
    kept.
    """

    rows: int
    columns: int
    variables: int
    terms: Terms

    @property
    def order(self) -> int:
        """The largest order of a monomial."""
        return max(map(sum, self.terms), default=0)

    def __matmul__(self, other: PolynomialMatrix) -> PolynomialMatrix:
        by_row: dict[int, list[tuple[Exponents, int, Fraction]]] = {}
        for b, entries in other.terms.items():
            for (i, j), x in entries.items():
                by_row.setdefault(i, []).append((b, j, x))
        out: Terms = {}
        for a, entries in self.terms.items():
            for (i, k), x in entries.items():
                for b, j, y in by_row.get(k, ()):
                    term = out.setdefault(tuple(map(int.__add__, a, b)), {})
                    term[i, j] = term.get((i, j), Fraction(0)) + x * y
        return _clean(self.rows, other.columns, self.variables, out)

    def __add__(self, other: PolynomialMatrix) -> PolynomialMatrix:
        out = {a: dict(entries) for a, entries in self.terms.items()}
        for a, entries in other.terms.items():
            term = out.setdefault(a, {})
            for k, x in entries.items():
                term[k] = term.get(k, Fraction(0)) + x
        return _clean(self.rows, self.columns, self.variables, out)

    def __neg__(self) -> PolynomialMatrix:
        terms: Terms = {}
        for a, entries in self.terms.items():
            terms[a] = {k: -x for k, x in entries.items()}
        return PolynomialMatrix(self.rows, self.columns, self.variables, terms)

    def coefficient(self, alpha: Exponents) -> Matrix:
        """Return the matrix of one monomial as a tuple of rows."""
        out = [[Fraction(0)] * self.columns for _ in range(self.rows)]
        for (i, j), x in self.terms.get(alpha, {}).items():
            out[i][j] = x
        return tuple(map(tuple, out))

    def at(self, point: Sequence[Fraction]) -> Matrix:
        """Return the exact matrix at a point of Fractions."""
        out = [[Fraction(0)] * self.columns for _ in range(self.rows)]
        for a, entries in self.terms.items():
            size = prod((v**e for v, e in zip(point, a, strict=True) if e), start=Fraction(1))
            for (i, j), x in entries.items():
                out[i][j] += size * x
        return tuple(map(tuple, out))

    def pick(
        self, rows: Iterable[int] | None = None, columns: Iterable[int] | None = None
    ) -> PolynomialMatrix:
        """Return some rows and columns, in the order given."""
        i_of = _places(self.rows, rows)
        j_of = _places(self.columns, columns)
        out: Terms = {}
        for a, entries in self.terms.items():
            for (i, j), x in entries.items():
                if i in i_of and j in j_of:
                    out.setdefault(a, {})[i_of[i], j_of[j]] = x
        return _clean(len(i_of), len(j_of), self.variables, out)


def _places(count: int, some: Iterable[int] | None) -> dict[int, int]:
    """Return {old number: new one} of some of so many rows or columns, of all for None."""
    if some is None:
        some = range(count)
    return {old: new for new, old in enumerate(some)}


def constant(matrix: Matrix, variables: int, columns: int | None = None) -> PolynomialMatrix:
    """Return an exact matrix as a PolynomialMatrix; columns: how many it has, if it may be without rows."""
    entries, terms = nonzero_entries(matrix), {}
    if entries:
        terms[(0,) * variables] = entries
    if matrix:
        columns = len(matrix[0])
    return PolynomialMatrix(len(matrix), columns or 0, variables, terms)


def nonzero_entries(matrix: Matrix) -> dict[tuple[int, int], Fraction]:
    """Return {(row, column): entry} of the entries of a matrix that are not 0."""
    entries = {}
    for i, row in enumerate(matrix):
        for j, x in enumerate(row):
            if x:
                entries[i, j] = x
    return entries


def stacked(blocks: Sequence[Sequence[PolynomialMatrix]]) -> PolynomialMatrix:
    """Return a grid of matrices, a list of rows of blocks, as one matrix."""
    out: Terms = {}
    top = 0
    for row in blocks:
        left = 0
        for block in row:
            for a, entries in block.terms.items():
                term = out.setdefault(a, {})
                for (i, j), x in entries.items():
                    term[top + i, left + j] = x
            left += block.columns
        top += row[0].rows
    return PolynomialMatrix(top, left, blocks[0][0].variables, out)


def monomials(variables: int, order: int) -> list[Exponents]:
    """Return all alpha of at most an order, the orders ascending, the first variables first.

    Example:
        >>> monomials(2, 1)
        [(0, 0), (1, 0), (0, 1)]
    """
    out = []
    for total in range(order + 1):
        for some in itertools.combinations_with_replacement(range(variables), total):
            out.append(tuple(some.count(i) for i in range(variables)))
    return out


def _clean(rows: int, columns: int, variables: int, terms: Terms) -> PolynomialMatrix:
    kept: Terms = {}
    for a in sorted(terms, key=graded):
        entries = {k: x for k, x in terms[a].items() if x}
        if entries:
            kept[a] = entries
    return PolynomialMatrix(rows, columns, variables, kept)


def graded(alpha: Exponents) -> tuple[int, Exponents]:
    """Return the key by which monomials are sorted: by order, the first variables first."""
    return sum(alpha), tuple(-e for e in alpha)
