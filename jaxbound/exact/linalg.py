"""Exact linear algebra over the rationals: small matrices, Python's own Fractions, no rounding anywhere.

A matrix is a tuple of rows, a row a tuple of Fractions. Costs are those of the host; nothing here runs per
window.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from itertools import combinations
from math import gcd, lcm
from operator import mul
from typing import Any, TypeAlias, TypeVar, cast

import jax
import numpy as np

__all__ = [
    "Frame",
    "Matrix",
    "MatrixLike",
    "Number",
    "Vector",
    "circuits",
    "determinant",
    "frame",
    "inverse",
    "left_null_space",
    "matmul",
    "matrix",
    "minimal_span",
    "presentable",
    "primitive",
    "rank",
    "rational",
    "reframe",
    "row_reduce",
    "transpose",
]

Vector: TypeAlias = tuple[Fraction, ...]
Matrix: TypeAlias = tuple[Vector, ...]
Number: TypeAlias = int | float | str | Fraction | Decimal | np.number
"""What `rational` reads."""
MatrixLike: TypeAlias = Sequence[Number] | Sequence[Sequence[Number]] | np.ndarray | jax.Array
"""What `matrix` reads."""
Rows: TypeAlias = Sequence[Sequence[Fraction | int]]
T = TypeVar("T")


def rational(x: Number) -> Fraction:
    """Read a number exactly: Fraction, Decimal, int and str ("1/3", "0.2") as they are, a float as its
    shortest decimal.

    Raises ValueError on NaN, infinity and anything that is not a number.

    Example:
        >>> rational(0.1), rational("1/3")
        (Fraction(1, 10), Fraction(1, 3))
    """
    try:
        x = cast(Number, np.asarray(x)[()]) if hasattr(x, "dtype") else x
        if isinstance(x, (str, Decimal)) and "/" not in str(x) and not -400 < Decimal(x).adjusted() < 400:
            raise OverflowError("far outside the range of floats, and its integers would not end")
        if isinstance(x, np.floating):
            return Fraction(str(x))  # the shortest decimal of its own dtype
        x = int(x) if isinstance(x, np.integer) else x
        return Fraction(x if isinstance(x, (Fraction, int, str, Decimal)) else repr(float(x)))
    except (ValueError, TypeError, ArithmeticError) as e:
        raise ValueError(f"{x!r} is not a finite number") from e


def matrix(a: MatrixLike) -> Matrix:
    """Read nested sequences or an array as an exact matrix; a vector becomes a column."""
    given: Iterable[Any] = np.asarray(a) if hasattr(a, "dtype") else a  # numbers, or rows of them
    rows = [list(r) if np.ndim(r) else [r] for r in given]
    if len({len(r) for r in rows}) > 1:
        raise ValueError(f"rows have different lengths: {[len(r) for r in rows]}")
    return tuple(tuple(rational(x) for x in r) for r in rows)


def transpose(a: Sequence[Sequence[T]]) -> tuple[tuple[T, ...], ...]:
    """Return the transpose."""
    return tuple(zip(*a, strict=True))


def matmul(a: Rows, b: Rows) -> Matrix:
    """Return a b."""
    if any(len(r) != len(b) for r in a):
        raise ValueError(f"a row of {len(a[0])} numbers times a matrix of {len(b)} rows has no meaning")
    left, right = [primitive_scale(r) for r in a], [primitive_scale(c) for c in transpose(b)]
    return tuple(tuple(Fraction(sum(map(mul, r, c)), p * q) for c, q in right) for r, p in left)


def row_reduce(a: Rows, progress: Callable[[float], object] | None = None) -> tuple[Matrix, tuple[int, ...]]:
    """Return the reduced row echelon form of `a` without zero rows, and its pivot columns. progress: called
    with the share done.
    """
    # whole numbers, each row divided by its common factor: ten times as fast as fractions
    rows: list[Sequence[int]] = [primitive_scale(r)[0] for r in a]
    pivots, top = [], 0
    for j in range(len(rows[0]) if rows else 0):
        k = next((i for i in range(top, len(rows)) if rows[i][j]), None)
        if k is None:
            continue
        rows[top], rows[k] = rows[k], rows[top]
        pivot = rows[top]
        for i in range(len(rows)):
            if i != top and rows[i][j]:
                f, head = rows[i][j], pivot[j]
                row = [head * x - f * y for x, y in zip(rows[i], pivot, strict=True)]
                common = gcd(*row) or 1
                rows[i] = [x // common for x in row] if common > 1 else row
        pivots.append(j)
        top += 1
        if progress is not None:
            progress(((j + 1) / len(rows[0])) ** 2)  # numbers grow
    return tuple(tuple(Fraction(x, r[j]) for x in r) for r, j in zip(rows[:top], pivots, strict=True)), tuple(
        pivots
    )


def rank(a: Rows) -> int:
    """Return the rank."""
    return len(row_reduce(a)[1])


def left_null_space(a: Rows, progress: Callable[[float], object] | None = None) -> Matrix:
    """Return a basis W of {w : w a = 0}, one row a basis vector (possibly no rows). progress: called with the
    share done.
    """
    m, n = len(a), len(a[0]) if a else 0
    augmented = [tuple(r) + tuple(Fraction(i == j) for j in range(m)) for i, r in enumerate(a)]
    reduced, pivots = row_reduce(augmented, progress)
    return tuple(r[n:] for r, p in zip(reduced, pivots, strict=True) if p >= n)


def inverse(a: Rows) -> Matrix:
    """Return the inverse of a regular matrix."""
    n = len(a)
    if any(len(r) != n for r in a):
        raise ValueError(f"only a square matrix has an inverse: this one is {n} x {len(a[0])}")
    reduced, pivots = row_reduce(
        [tuple(r) + tuple(Fraction(i == j) for j in range(n)) for i, r in enumerate(a)]
    )
    if pivots != tuple(range(n)):
        raise ValueError("the matrix is singular")
    return tuple(r[n:] for r in reduced)


def primitive(row: Sequence[Fraction]) -> Vector:
    """Scale a row to coprime integers, the first non-zero entry positive."""
    scale = lcm(*(x.denominator for x in row))
    whole = [int(x * scale) for x in row]
    divisor = gcd(*whole) or 1
    sign = -1 if next((x for x in whole if x), 1) < 0 else 1
    return tuple(Fraction(sign * x // divisor) for x in whole)


def presentable(row: Sequence[Fraction]) -> Vector:
    """Return a primitive row as it is while its integers are short, else divided by its largest entry."""
    largest = max(map(abs, row))
    return tuple(row) if largest < 10**4 else tuple(x / largest for x in row)


def minimal_span(a: Rows) -> Matrix:
    """Return a basis of the row space of `a` whose rows start at different columns and end at different
    columns, in order.

    Each row then spans as few consecutive columns as it can: with time-major columns, the fewest samples.
    Rows are primitive.
    """
    rows = [list(r) for r in row_reduce(a)[0]]  # different starts, in order
    while True:
        ends = [max(j for j, x in enumerate(r) if x) for r in rows]
        clash = next(((i, k) for i, k in combinations(range(len(rows)), 2) if ends[i] == ends[k]), None)
        if clash is None:
            return tuple(primitive(r) for r in rows)
        i, k = clash  # row i starts earlier: cancelling its last entry with row k keeps its start
        f = rows[i][ends[i]] / rows[k][ends[k]]
        rows[i] = [x - f * y for x, y in zip(rows[i], rows[k], strict=True)]


def circuits(a: Matrix) -> Matrix:
    """Return every vector of minimal support with h a = 0 (one of each pair h, -h), primitive, by support in
    lexicographic order.

    They are the strips of any zonotope whose directions have the left null space of `a` as row space
    (Source: elementary vectors of a subspace; every circuit lies in some set of rank + 1 rows of full rank,
    so subsets of that size suffice).
    """
    basis = transpose(row_reduce(transpose(a))[0])  # the same left null space with full column rank
    m, r = len(a), len(basis[0]) if basis and basis[0] else 0
    if r == 0:
        return tuple(tuple(Fraction(i == j) for j in range(m)) for i in range(m))
    found: dict[tuple[int, ...], Vector] = {}
    for row in _among_rows(basis, r) if r < m - r else _among_zeros(left_null_space(basis), m):
        found.setdefault(tuple(i for i, x in enumerate(row) if x), row)
    return tuple(found[k] for k in sorted(found))


def _among_rows(basis: Matrix, r: int) -> Iterator[Vector]:
    """Yield the circuits, some more than once: each lies in r + 1 of the rows."""
    whole = [primitive_scale(row) for row in basis]
    for subset in combinations(range(len(basis)), r + 1):
        h = _cofactors([whole[i][0] for i in subset])
        if any(h):
            row = [Fraction(0)] * len(basis)
            for i, x in zip(subset, h, strict=True):
                row[i] = Fraction(x) * whole[i][1]
            yield primitive(row)


def _among_zeros(null: Matrix, m: int) -> Iterator[Vector]:
    """Yield the circuits, some more than once: each vanishes at k - 1 columns of the null space (k, m), whose
    minors are small.
    """
    whole, k = [[int(x) for x in primitive(row)] for row in null], len(null)
    for subset in combinations(range(m), k - 1) if k else ():
        c = _cofactors([[row[j] for j in subset] for row in whole]) if k > 1 else [1]
        if any(c):
            yield primitive([Fraction(sum(map(mul, c, column))) for column in zip(*whole, strict=True)])


def primitive_scale(row: Sequence[Fraction | int]) -> tuple[tuple[int, ...], int]:
    """Return the row as integers and the factor by which it was multiplied."""
    scale = lcm(*(x.denominator for x in row))
    return tuple(x.numerator * (scale // x.denominator) for x in row), scale


def _cofactors(rows: Sequence[Sequence[int]]) -> list[int]:
    """Return the signed maximal minors of an (r + 1) x r integer matrix: its left null vector, or zeros if
    its rank is below r.
    """
    return [(-1) ** i * determinant([r for k, r in enumerate(rows) if k != i]) for i in range(len(rows))]


def determinant(rows: Sequence[Sequence[int]]) -> int:
    """Return the determinant of an integer matrix (Bareiss: every division is exact)."""
    a, sign, previous = [list(r) for r in rows], 1, 1
    for k in range(len(a) - 1):
        swap = next((i for i in range(k, len(a)) if a[i][k]), None)
        if swap is None:
            return 0
        if swap != k:
            a[k], a[swap], sign = a[swap], a[k], -sign
        for i in range(k + 1, len(a)):
            for j in range(k + 1, len(a)):
                a[i][j] = (a[i][j] * a[k][k] - a[i][k] * a[k][j]) // previous
        previous = a[k][k]
    return sign * a[-1][-1]


@dataclass(frozen=True)
class Frame:
    """Rows y = E x + K u with x eliminated: the `outer` rows as combinations of the `inner` ones, y_outer = R
    y_inner + K u.

    Fields: R (c, k), K (c, l), inner (k,) and outer (c,) row numbers, used (c,): False where a relation was
    given up.
    """

    R: Matrix
    K: Matrix
    inner: tuple[int, ...]
    outer: tuple[int, ...]
    used: tuple[bool, ...]


def frame(
    E: Matrix, K: Matrix, largest: float = 2, progress: Callable[[float], object] | None = None
) -> Frame:
    """Eliminate x from the rows y = E x + K u, with inner rows so chosen that no entry of R exceeds `largest`
    by much.

    Then neither rounding nor an unstable plant blows up: R is made of well-balanced combinations of samples,
    whatever the powers of A.
    progress: called with the share done, of the elimination.
    """
    reduced, pivots = row_reduce(transpose(E), progress)
    outer = tuple(j for j in range(len(E)) if j not in set(pivots))
    R = tuple(tuple(row[j] for row in reduced) for j in outer)
    through = (
        matmul(R, tuple(K[i] for i in pivots))
        if K[0] and pivots
        else tuple((Fraction(0),) * len(K[0]) for _ in outer)
    )
    known = tuple(
        tuple(a - b for a, b in zip(K[j], row, strict=True)) for j, row in zip(outer, through, strict=True)
    )
    out = Frame(R, known, tuple(pivots), outer, (True,) * len(outer))
    while True:
        size, j, i = max(
            ((abs(x), j, i) for j, row in enumerate(out.R) for i, x in enumerate(row)), default=(0, 0, 0)
        )
        if size <= largest:
            return out
        out = _exchanged(
            out, j, i
        )  # each exchange multiplies the volume of the inner rows by more than `largest`: it ends


def reframe(given: Frame, absent: Collection[int], missing: Iterable[int]) -> Frame:
    """Return a frame for a window in which the rows `absent` and the known values `missing` are not there.

    Absent inner rows change places with present ones; a missing known value is eliminated by one relation,
    whose row joins the inner ones. What cannot be replaced so matters to no used relation: its coefficients
    there are zeros.
    """
    out = given
    usable = lambda f, j: (
        f.used[j] and f.outer[j] not in absent
    )  # an absent outer row stays in use for windows that have it
    for i, row in enumerate(given.inner):
        if row in absent:
            size, j = max(((abs(r[i]), j) for j, r in enumerate(out.R) if usable(out, j)), default=(0, 0))
            if size:
                out = _exchanged(out, j, i)
    for b in missing:
        size, j = max(((abs(r[b]), j) for j, r in enumerate(out.K) if usable(out, j)), default=(0, 0))
        if size:
            out = _given_up(out, j, b)
    return out


def _exchanged(f: Frame, j: int, i: int) -> Frame:
    """Let outer row j and inner row i change places."""
    pivot = f.R[j][i]
    solved = tuple(
        (1 if q == i else -x) / pivot for q, x in enumerate(f.R[j])
    )  # the old inner row in terms of the new ones
    through = tuple(-x / pivot for x in f.K[j])
    R, K = [], []
    for a, (row, known) in enumerate(zip(f.R, f.K, strict=True)):
        if a == j:
            R.append(solved)
            K.append(through)
            continue
        share = row[i]
        R.append(
            tuple((0 if q == i else x) + share * y for q, (x, y) in enumerate(zip(row, solved, strict=True)))
            if share
            else row
        )
        K.append(tuple(x + share * y for x, y in zip(known, through, strict=True)) if share else known)
    inner, outer = list(f.inner), list(f.outer)
    inner[i], outer[j] = outer[j], inner[i]
    return Frame(tuple(R), tuple(K), tuple(inner), tuple(outer), f.used)


def _given_up(f: Frame, j: int, b: int) -> Frame:
    """Solve relation j for the known value b, put that into the other relations, and take row j among the
    inner ones.
    """
    R, K = [], []
    for a, (row, known) in enumerate(zip(f.R, f.K, strict=True)):
        share = known[b] / f.K[j][b] if a != j else Fraction(0)
        R.append((*(x - share * y for x, y in zip(row, f.R[j], strict=True)), share))
        K.append(
            tuple(x - share * y for x, y in zip(known, f.K[j], strict=True))
            if a != j
            else (Fraction(0),) * len(known)
        )
    used = tuple(u and a != j for a, u in enumerate(f.used))
    return Frame(tuple(R), tuple(K), (*f.inner, f.outer[j]), f.outer, used)
