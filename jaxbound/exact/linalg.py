"""Exact linear algebra over the rationals: small matrices, Python's own Fractions, no rounding anywhere.

A matrix is a tuple of rows, a row a tuple of Fractions. Costs are those of the host; nothing here runs per
window.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from itertools import chain, compress
from math import gcd, lcm
from operator import mul, truth
from typing import Self, TypeAlias, TypeVar, cast, overload

import jax
import numpy as np
from numpy.typing import ArrayLike

Vector: TypeAlias = tuple[Fraction, ...]
Matrix: TypeAlias = tuple[Vector, ...]
Number: TypeAlias = int | float | str | Fraction | Decimal | np.number
"""What `rational` reads."""
MatrixLike: TypeAlias = Sequence[Number] | Sequence[Sequence[Number]] | np.ndarray | jax.Array
"""What `matrix` reads."""
Row: TypeAlias = Sequence[Fraction | int]
Rows: TypeAlias = Sequence[Row]
T = TypeVar("T")


@dataclass(frozen=True)
class Whole(Sequence[Fraction]):
    """A row of fractions in whole numbers: of long ones, fractions take ten times as long to make as to use.

    Fields: numbers; over: what they are divided by, above 0.
    """

    numbers: tuple[int, ...]
    over: int

    @classmethod
    def reduced(cls, numbers: Iterable[int], over: int) -> Self:
        """Return a row without a common factor. over: any number but 0."""
        row = tuple(numbers)
        common = gcd(over, *row)
        if over < 0:
            common = -common
        if common != 1:
            row = tuple(x // common for x in row)
        return cls(row, over // common)

    def __len__(self) -> int:
        return len(self.numbers)

    @overload
    def __getitem__(self, i: int) -> Fraction: ...

    @overload
    def __getitem__(self, i: slice) -> Self: ...

    def __getitem__(self, i: int | slice) -> Fraction | Self:
        if isinstance(i, slice):
            return type(self)(self.numbers[i], self.over)
        return Fraction(self.numbers[i], self.over)

    def __iter__(self) -> Iterator[Fraction]:
        return (Fraction(x, self.over) for x in self.numbers)


WIDEST_EXPONENT = 400
"""Powers of ten beyond which a decimal is refused: floats end before, and its integers would not."""
SHORT_INTEGER = 10**4
"""Integers below it are shown as they are."""


def rational(x: Number) -> Fraction:
    """Read a number exactly: Fraction, Decimal, int and str ("1/3", "0.2") as they are, a float as its
    shortest decimal.

    Raises ValueError on NaN, infinity and anything that is not a number.

    Example:
        >>> rational(0.1), rational("1/3")
        (Fraction(1, 10), Fraction(1, 3))
    """
    try:
        if hasattr(x, "dtype"):
            x = cast(Number, np.asarray(x)[()])
        return _fraction(x)
    except (ValueError, TypeError, ArithmeticError) as e:
        raise ValueError(f"{x!r} is not a finite number") from e


def _fraction(x: Number) -> Fraction:
    if isinstance(x, np.floating):
        return Fraction(str(x))  # the shortest decimal of its own dtype
    if isinstance(x, np.integer):
        return Fraction(int(x))
    if isinstance(x, Fraction | int):
        return Fraction(x)
    if not isinstance(x, str | Decimal):
        return Fraction(repr(float(x)))
    if isinstance(x, str) and (not x.isascii() or "_" in x):
        raise ValueError("only Python reads underscores and digits of other scripts")
    if "/" not in str(x) and abs(Decimal(x).adjusted()) >= WIDEST_EXPONENT:
        raise OverflowError("far outside the range of floats")
    return Fraction(x)


def matrix(a: MatrixLike) -> Matrix:
    """Read nested sequences or an array as an exact matrix; a vector becomes a column."""
    read: Iterable[Number | Sequence[Number] | np.ndarray] = a
    if hasattr(a, "dtype"):
        read = np.asarray(a)
    rows = list(map(_read_row, read))
    lengths = list(map(len, rows))
    if len(set(lengths)) > 1:
        raise ValueError(f"rows have different lengths: {lengths}")
    return tuple(rows)


def _read_row(row: Number | Sequence[Number] | np.ndarray) -> Vector:
    if np.ndim(cast(ArrayLike, row)) == 0:
        return (rational(cast(Number, row)),)
    return tuple(map(rational, cast(Sequence[Number], row)))


def identity(n: int) -> Matrix:
    """Return the identity matrix of n rows."""
    zero, one = Fraction(0), Fraction(1)
    return tuple((zero,) * i + (one,) + (zero,) * (n - 1 - i) for i in range(n))


def zeros(rows: int, columns: int) -> Matrix:
    """Return a matrix of zeros."""
    return ((Fraction(0),) * columns,) * rows


def transpose(a: Sequence[Sequence[T]]) -> tuple[tuple[T, ...], ...]:
    """Return the transpose."""
    return tuple(zip(*a, strict=True))


def beside(*blocks: Sequence[Sequence[T]]) -> tuple[tuple[T, ...], ...]:
    """Return matrices of as many rows each side by side.

    Example:
        >>> beside([[1], [2]], [[3, 4], [5, 6]])
        ((1, 3, 4), (2, 5, 6))
    """
    return tuple(tuple(chain.from_iterable(rows)) for rows in zip(*blocks, strict=True))


def columns_of(a: Sequence[Sequence[T]], numbers: Iterable[int]) -> tuple[tuple[T, ...], ...]:
    """Return the matrix of some columns, by their numbers.

    Example:
        >>> columns_of([[1, 2, 3], [4, 5, 6]], (2, 0))
        ((3, 1), (6, 4))
    """
    chosen, rows = tuple(numbers), []
    for row in a:
        rows.append(tuple(row[j] for j in chosen))
    return tuple(rows)


def dot(a: Iterable[Fraction | int], b: Iterable[Fraction | int]) -> Fraction:
    """Return the sum of products exactly: one common denominator, so that nothing is reduced in between.

    Example:
        >>> dot([Fraction(1, 2), 3], [4, Fraction(1, 3)])
        Fraction(3, 1)
    """
    pairs = [(x, y) for x, y in zip(a, b, strict=True) if x and y]
    common = lcm(*(x.denominator * y.denominator for x, y in pairs))
    total = 0
    for x, y in pairs:
        total += x.numerator * y.numerator * (common // (x.denominator * y.denominator))
    return Fraction(total, common)


def multiply(a: Rows, x: Row) -> Vector:
    """Return the vector a x."""
    whole, over = integers(x)
    out = []
    for row in a:
        if len(row) != len(x):
            raise ValueError(f"a row of {len(row)} numbers times a vector of {len(x)} has no meaning")
        own, under = integers(row)
        out.append(Fraction(sum(map(mul, own, whole)), under * over))
    return tuple(out)


def scale(row: Row, factor: Fraction | int) -> Vector:
    """Return factor * row."""
    return tuple(Fraction(factor * x) for x in row)


def add_multiple(row: Row, factor: Fraction | int, other: Row) -> Vector:
    """Return row + factor * other.

    Example:
        >>> add_multiple([1, 2], Fraction(1, 2), [4, 0])
        (Fraction(3, 1), Fraction(2, 1))
    """
    n, m = factor.numerator, factor.denominator
    out = []
    for x, y in zip(row, other, strict=True):
        total = Fraction(x)
        if y:  # over one denominator, reduced once: + and * of Fractions reduce three times
            a, b, c, d = x.numerator, x.denominator, y.numerator, y.denominator
            total = Fraction(a * d * m + n * c * b, b * d * m)
        out.append(total)
    return tuple(out)


def matmul(a: Rows, b: Rows) -> Matrix:
    """Return a b."""
    if any(len(r) != len(b) for r in a):
        raise ValueError(f"a row of {len(a[0])} numbers times a matrix of {len(b)} rows has no meaning")
    if not a:  # the columns of a wide b are long to read
        return ()
    rows, over = over_one(b)
    columns = list(zip(*rows, strict=True))
    product = []
    for row, under in map(integers, a):
        there = list(map(truth, row))
        some = tuple(compress(row, there))
        sums = (sum(map(mul, some, compress(column, there))) for column in columns)
        product.append(tuple(Fraction(x, under * over) for x in sums))
    return tuple(product)


def row_reduce(a: Rows, progress: Callable[[float], object] | None = None) -> tuple[Matrix, tuple[int, ...]]:
    """Return the reduced row echelon form of `a` without zero rows, and its pivot columns.

    Args:
        progress: called with the share done.
    """
    rows, pivots = echelon(a, progress)
    return tuple(tuple(Fraction(x, row[j]) for x in row) for row, j in zip(rows, pivots, strict=True)), pivots


def echelon(
    a: Rows, progress: Callable[[float], object] | None = None
) -> tuple[list[Sequence[int]], tuple[int, ...]]:
    """Return the rows of `row_reduce`, each times its pivot, a whole number; and its pivot columns."""
    # whole numbers, each row divided by its common factor: ten times as fast as fractions
    rows: list[Sequence[int]] = [integers(r)[0] for r in a]
    pivots: list[int] = []
    for j in range(_width(a)):
        top = len(pivots)
        there = [i for i in range(top, len(rows)) if rows[i][j]]
        if not there:
            continue
        k = min(there, key=lambda i: sum(map(truth, rows[i])))  # the sparsest fills in least
        rows[top], rows[k] = rows[k], rows[top]
        pivots.append(j)
        for i, row in enumerate(rows):
            if i != top and row[j]:
                rows[i] = cancel(row, rows[top], j)
        if progress is not None:
            progress(((j + 1) / len(rows[0])) ** 2)  # numbers grow
    return rows[: len(pivots)], tuple(pivots)  # what has no pivot is a row of zeros


def _width(a: Rows) -> int:
    if not a:
        return 0
    return len(a[0])


def _first(row: Row) -> int:
    """Return the place of the first number that is not 0."""
    return list(map(truth, row)).index(True)


def cancel(row: Sequence[int], pivot: Sequence[int], j: int) -> Sequence[int]:
    """Return a multiple of a row plus a multiple of the pivot row, with a zero at j and no common factor."""
    f, head = row[j], pivot[j]
    combined = [head * x - f * y for x, y in zip(row, pivot, strict=True)]
    common = gcd(*combined)
    if common <= 1:
        return combined
    return [x // common for x in combined]


def rank(a: Rows) -> int:
    """Return the rank."""
    return len(echelon(a)[1])


def left_null_space(a: Rows, progress: Callable[[float], object] | None = None) -> Matrix:
    """Return a basis W of {w : w a = 0}, one row a basis vector (possibly no rows).

    Args:
        progress: called with the share done.
    """
    width = _width(a)
    reduced, pivots = row_reduce(_beside_identity(a), progress)
    return tuple(r[width:] for r, p in zip(reduced, pivots, strict=True) if p >= width)


def inverse(a: Rows) -> Matrix:
    """Return the inverse of a regular matrix."""
    n = len(a)
    if any(len(r) != n for r in a):
        raise ValueError(f"only a square matrix has an inverse: this one is {n} x {len(a[0])}")
    reduced, pivots = row_reduce(_beside_identity(a))
    if pivots != tuple(range(n)):
        raise ValueError("the matrix is singular")
    return tuple(r[n:] for r in reduced)


def _beside_identity(a: Rows) -> Rows:
    """Return the rows of [a, I]."""
    return beside(a, identity(len(a)))


def over_one(a: Rows) -> tuple[list[tuple[int, ...]], int]:
    """Return rows in whole numbers, and what all of them are divided by."""
    rows = list(map(integers, a))
    common, whole = lcm(*(over for _, over in rows)), []
    for row, over in rows:
        factor = common // over
        whole.append(tuple(factor * x for x in row))
    return whole, common


def integers(row: Row) -> tuple[tuple[int, ...], int]:
    """Return the row as integers and the factor by which it was multiplied.

    Example:
        >>> integers([Fraction(1, 2), Fraction(1, 3)])
        ((3, 2), 6)
    """
    if isinstance(row, Whole):
        return row.numbers, row.over
    factor = lcm(*(x.denominator for x in row))
    return tuple(x.numerator * (factor // x.denominator) for x in row), factor


def floats(row: Row) -> list[float]:
    """Return the nearest floats.

    Raises OverflowError where there is none.
    """
    if isinstance(row, Whole):
        return [x / row.over for x in row.numbers]
    return list(map(float, row))


def primitive(row: Row) -> Vector:
    """Scale a row to coprime integers, the first non-zero entry positive."""
    whole, _ = integers(row)
    if not any(whole):
        return tuple(map(Fraction, whole))
    divisor = gcd(*whole)
    if whole[_first(whole)] < 0:
        divisor = -divisor
    return tuple(Fraction(x // divisor) for x in whole)


def presentable(row: Sequence[Fraction]) -> Vector:
    """Return a primitive row as it is while its integers are short, else divided by its largest entry."""
    largest = max(map(abs, row))
    if largest < SHORT_INTEGER:
        return tuple(row)
    return tuple(x / largest for x in row)


def minimal_span(a: Rows, progress: Callable[[float], object] | None = None) -> Matrix:
    """Return a basis of the row space of `a` whose rows start at different columns and end at different
    columns, in order.

    Each row then spans as few consecutive columns as it can: with time-major columns, the fewest samples.
    Rows are primitive.

    Args:
        progress: called with the share done.
    """
    rows = echelon(a)[0]  # different starts, in order
    ends = list(map(_end, rows))
    several = len(rows) - len(set(ends))
    while (clash := _first_clash(ends)) is not None:
        i, k = clash  # row i starts earlier: cancelling its last entry with row k keeps its start
        rows[i] = cancel(rows[i], rows[k], ends[i])
        ends[i] = _end(rows[i])
        if progress is not None:
            progress(1 - (len(rows) - len(set(ends))) / several)  # an end that is left is k's still
    return tuple(map(primitive, rows))


def _end(row: Row) -> int:
    """Return the number of the last entry of a row that is not zero."""
    return len(row) - 1 - _first(row[::-1])


def _first_clash(ends: Sequence[int]) -> tuple[int, int] | None:
    """Return the first two rows that end at the same column, None where there are none."""
    behind: dict[int, int] = {}
    found = None
    for i in range(len(ends) - 1, -1, -1):
        if ends[i] in behind:
            found = i, behind[ends[i]]
        behind[ends[i]] = i
    return found


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
