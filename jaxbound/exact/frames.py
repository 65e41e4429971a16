"""Elimination by frames: of rows y = E x + K u, some tell x, and the others follow from them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from math import gcd, log
from operator import mul
from typing import NamedTuple, Self

from jaxbound.exact.linalg import Matrix, integers, row_reduce, transpose
from jaxbound.text.progress import in_part, reporter

__all__ = ["ExactFrame", "frame"]


@dataclass(frozen=True)
class ExactFrame:
    """Rows y = E x + K u with x eliminated: the `outer` rows as combinations of the `inner` ones, y_outer = R
    y_inner + K u.

    Fields: R (c, k), K (c, l), inner (k,) and outer (c,) row numbers.
    """

    R: Matrix
    K: Matrix
    inner: tuple[int, ...]
    outer: tuple[int, ...]


def frame(
    E: Matrix, K: Matrix, largest: Fraction = Fraction(2), progress: Callable[[float], object] | None = None
) -> ExactFrame:
    """Eliminate x from the rows y = E x + K u, with inner rows so chosen that no entry of R exceeds `largest`
    by much.

    Then neither rounding nor an unstable plant blows up: R is made of well-balanced combinations of samples,
    whatever the powers of A.

    Args:
        progress: called with the share of the elimination that is done.
    """
    report = reporter(progress)
    reduced, inner = row_reduce(transpose(E), partial(in_part, report, 0.0, 0.5))
    R, outer = transpose(reduced) or ((),) * len(E), tuple(j for j in range(len(E)) if j not in set(inner))
    out = _Frame(tuple(_Row(*integers(R[j])) for j in outer), inner, outer)
    first, done = out.largest_entry()[0], 0.0
    while True:
        size, j, i = out.largest_entry()
        if size <= largest:
            return out.in_fractions(K)
        # the largest entry falls to `largest`, now and then up again
        done = max(done, 1 - _log(size / largest) / _log(first / largest))
        in_part(report, 0.5, 0.5, done)
        # each exchange multiplies the volume of the inner rows by more than `largest`: it ends
        out = out.exchanged(j, i)


def _log(x: Fraction) -> float:
    """Return the logarithm of a fraction, which may be too large for a float."""
    return log(x.numerator) - log(x.denominator)


class _Row(NamedTuple):
    """A row of R in whole numbers over one denominator: fractions take several times as long.

    Fields: numbers; over: what they are divided by, above 0.
    """

    numbers: tuple[int, ...]
    over: int

    @classmethod
    def reduced(cls, numbers: Sequence[int], over: int) -> Self:
        """Return a row without a common factor."""
        common = gcd(over, *numbers)
        if over < 0:
            common = -common
        return cls(tuple(x // common for x in numbers), over // common)

    def solved_for(self, column: int) -> Self:
        """Return the row that tells a column by the others, and by the left side of this row in its place."""
        numbers = [-x for x in self.numbers]
        numbers[column] = self.over
        return self.reduced(numbers, self.numbers[column])

    def through(self, column: int, other: Self) -> Self:
        """Return the row with a column told by another row, whose left side takes its place."""
        head, share = other.numbers[column], self.numbers[column]
        if not share:
            return self
        numbers = [x * head - share * y for x, y in zip(self.numbers, other.numbers, strict=True)]
        numbers[column] = share * other.over
        return self.reduced(numbers, self.over * head)


@dataclass(frozen=True)
class _Frame:
    """An `ExactFrame` whose rows of R are in whole numbers, and K is left out."""

    rows: tuple[_Row, ...]
    inner: tuple[int, ...]
    outer: tuple[int, ...]

    def in_fractions(self, K: Matrix) -> ExactFrame:
        """Return the frame in fractions: y_outer = R y_inner + (K_outer - R K_inner) u."""
        inner_known, below = integers([x for i in self.inner for x in K[i]])
        columns = [inner_known[b :: len(K[0])] for b in range(len(K[0]))]
        R, own = [], []
        for row, j in zip(self.rows, self.outer, strict=True):
            R.append(tuple(Fraction(x, row.over) for x in row.numbers))
            entries = []
            for x, column in zip(K[j], columns, strict=True):
                through = sum(map(mul, row.numbers, column))
                if through:  # few inputs act on the inner rows
                    by, under = row.over * below, x.denominator
                    x = Fraction(x.numerator * by - through * under, under * by)
                entries.append(x)
            own.append(tuple(entries))
        return ExactFrame(tuple(R), tuple(own), self.inner, self.outer)

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
        rows = [row.through(i, pivot) for row in self.rows]
        rows[j] = pivot.solved_for(i)
        inner, outer = list(self.inner), list(self.outer)
        inner[i], outer[j] = outer[j], inner[i]
        return type(self)(tuple(rows), tuple(inner), tuple(outer))
