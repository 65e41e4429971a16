"""Elimination by frames: of rows y = E x + K u, some tell x, and the others follow from them."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from math import lcm, log
from operator import mul
from typing import Self

from jaxbound.exact.linalg import Rows, Whole, echelon, integers, over_one, transpose
from jaxbound.text.progress import in_part, reporter


@dataclass(frozen=True)
class ExactFrame:
    """Rows y = E x + K u with x eliminated: the `outer` rows as combinations of the `inner` ones, y_outer = R
    y_inner + K u.

    Fields: R (c, k), K (c, l), inner (k,) and outer (c,) row numbers.
    """

    R: tuple[Whole, ...]
    K: tuple[Whole, ...]
    inner: tuple[int, ...]
    outer: tuple[int, ...]


def frame(
    E: Rows, K: Rows, largest: Fraction = Fraction(2), progress: Callable[[float], object] | None = None
) -> ExactFrame:
    """Eliminate x from the rows y = E x + K u, with inner rows so chosen that no entry of R exceeds `largest`
    by much.

    Then neither rounding nor an unstable plant blows up: R is made of well-balanced combinations of samples,
    whatever the powers of A.

    Args:
        progress: called with the share of the elimination that is done.
    """
    report = reporter(progress)
    reduced, inner = echelon(transpose(over_one(E)[0]), partial(in_part, report, 0.0, 0.5))
    over = lcm(*(row[j] for row, j in zip(reduced, inner, strict=True)))
    columns = [[over // row[j] * x for x in row] for row, j in zip(reduced, inner, strict=True)]
    outer = tuple(j for j in range(len(E)) if j not in set(inner))
    rows = [Whole.reduced([column[j] for column in columns], over) for j in outer]
    out = _Frame(tuple(rows), inner, outer)
    first, done = out.largest_entry()[0], 0.0
    while True:
        size, j, i = out.largest_entry()
        if size <= largest:
            return out.with_inputs(K)
        # the largest entry falls to `largest`, now and then up again
        done = max(done, 1 - _log(size / largest) / _log(first / largest))
        in_part(report, 0.5, 0.5, done)
        # each exchange multiplies the volume of the inner rows by more than `largest`: it ends
        out = out.exchanged(j, i)


def _log(x: Fraction) -> float:
    """Return the logarithm of a fraction, which may be too large for a float."""
    return log(x.numerator) - log(x.denominator)


def _solved_for(row: Whole, column: int) -> Whole:
    """Return the row that tells a column by the others, and by the left side of this row in its place."""
    numbers = [-x for x in row.numbers]
    numbers[column] = row.over
    return Whole.reduced(numbers, row.numbers[column])


def _through(row: Whole, column: int, other: Whole) -> Whole:
    """Return the row with a column told by another row, whose left side takes its place."""
    head, share = other.numbers[column], row.numbers[column]
    if not share:
        return row
    numbers = [x * head - share * y for x, y in zip(row.numbers, other.numbers, strict=True)]
    numbers[column] = share * other.over
    return Whole.reduced(numbers, row.over * head)


@dataclass(frozen=True)
class _Frame:
    """An `ExactFrame` without K: rows, those of R."""

    rows: tuple[Whole, ...]
    inner: tuple[int, ...]
    outer: tuple[int, ...]

    def with_inputs(self, K: Rows) -> ExactFrame:
        """Return the frame y_outer = R y_inner + (K_outer - R K_inner) u."""
        inner_known, below = over_one([K[i] for i in self.inner])
        columns = list(zip(*inner_known, strict=True))
        acting = [b for b, column in enumerate(columns) if any(column)]  # few inputs act on the inner rows
        own = []
        for row, j in zip(self.rows, self.outer, strict=True):
            (numbers, under), by = integers(K[j]), row.over * below
            entries = [x * by for x in numbers]
            for b in acting:
                entries[b] -= under * sum(map(mul, row.numbers, columns[b]))
            own.append(Whole(tuple(entries), under * by))
        return ExactFrame(self.rows, tuple(own), self.inner, self.outer)

    def largest_entry(self) -> tuple[Fraction, int, int]:
        """Return (size, row, column) of the largest entry of R, the last one of equals."""
        entries = [(Fraction(0), 0, 0)]
        for j, row in enumerate(self.rows):
            size, i = max(((abs(x), i) for i, x in enumerate(row.numbers)), default=(0, 0))
            entries.append((Fraction(size, row.over), j, i))
        return max(entries)

    def exchanged(self, j: int, i: int) -> Self:
        """Let outer row j and inner row i change places."""
        pivot = self.rows[j]
        rows = [_through(row, i, pivot) for row in self.rows]
        rows[j] = _solved_for(pivot, i)
        inner, outer = list(self.inner), list(self.outer)
        inner[i], outer[j] = outer[j], inner[i]
        return type(self)(tuple(rows), tuple(inner), tuple(outer))
