"""Elimination by frames: of rows y = E x + K u, some tell x, and the others follow from them."""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction

from jaxbound.exact.linalg import Matrix, Vector, add_multiple, matmul, row_reduce, scale, transpose, zeros

__all__ = ["ExactFrame", "frame", "reframe"]


@dataclass(frozen=True)
class ExactFrame:
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
) -> ExactFrame:
    """Eliminate x from the rows y = E x + K u, with inner rows so chosen that no entry of R exceeds `largest`
    by much.

    Then neither rounding nor an unstable plant blows up: R is made of well-balanced combinations of samples,
    whatever the powers of A.

    Args:
        progress: called with the share of the elimination that is done.
    """
    reduced, inner = row_reduce(transpose(E), progress)
    outer = tuple(j for j in range(len(E)) if j not in set(inner))
    R = tuple(tuple(row[j] for row in reduced) for j in outer)
    through = zeros(len(outer), len(K[0]))
    if K[0] and inner:
        through = matmul(R, tuple(K[i] for i in inner))
    known = tuple(add_multiple(K[j], -1, row) for j, row in zip(outer, through, strict=True))
    out = ExactFrame(R, known, inner, outer, (True,) * len(outer))
    while True:
        size, j, i = _largest_entry(out.R)
        if size <= largest:
            return out
        # each exchange multiplies the volume of the inner rows by more than `largest`: it ends
        out = _exchange(out, j, i)


def _largest_entry(R: Matrix) -> tuple[Fraction, int, int]:
    """Return (size, row, column) of the largest entry, the last one of equals."""
    entries = ((abs(x), j, i) for j, row in enumerate(R) for i, x in enumerate(row))
    return max(entries, default=(Fraction(0), 0, 0))


def reframe(given: ExactFrame, absent: Collection[int], missing: Iterable[int]) -> ExactFrame:
    """Return a frame for a window in which the rows `absent` and the known values `missing` are not there.

    Absent inner rows change places with present ones; a missing known value is eliminated by one relation,
    whose row joins the inner ones. What cannot be replaced so matters to no used relation: its coefficients
    there are zeros.
    """
    out = given
    for i, row in enumerate(given.inner):
        if row in absent:
            size, j = _largest_usable(out, out.R, i, absent)
            if size:
                out = _exchange(out, j, i)
    for b in missing:
        size, j = _largest_usable(out, out.K, b, absent)
        if size:
            out = _give_up(out, j, b)
    return out


def _largest_usable(
    f: ExactFrame, rows: Matrix, column: int, absent: Collection[int]
) -> tuple[Fraction | int, int]:
    """Return (size, row) of a column's largest entry among relations in use whose outer row is present.

    A relation of an absent outer row stays in use, for windows that have it.
    """
    usable = (j for j in range(len(rows)) if f.used[j] and f.outer[j] not in absent)
    return max(((abs(rows[j][column]), j) for j in usable), default=(0, 0))


def _exchange(f: ExactFrame, j: int, i: int) -> ExactFrame:
    """Let outer row j and inner row i change places."""
    pivot = f.R[j][i]
    solved = _with_entry(scale(f.R[j], -1 / pivot), i, 1 / pivot)  # the old inner row by the new ones
    through = scale(f.K[j], -1 / pivot)
    R, K = [], []
    for a, (row, known) in enumerate(zip(f.R, f.K, strict=True)):
        share = row[i]
        if a == j:
            R.append(solved)
            K.append(through)
        elif share:
            R.append(add_multiple(_with_entry(row, i, Fraction(0)), share, solved))
            K.append(add_multiple(known, share, through))
        else:
            R.append(row)
            K.append(known)
    inner, outer = list(f.inner), list(f.outer)
    inner[i], outer[j] = outer[j], inner[i]
    return ExactFrame(tuple(R), tuple(K), tuple(inner), tuple(outer), f.used)


def _with_entry(row: Sequence[Fraction], i: int, value: Fraction) -> Vector:
    return (*row[:i], value, *row[i + 1 :])


def _give_up(f: ExactFrame, j: int, b: int) -> ExactFrame:
    """Solve relation j for the known value b, put that into the other relations, and take row j among the
    inner ones.
    """
    R, K = [], []
    for a, (row, known) in enumerate(zip(f.R, f.K, strict=True)):
        if a == j:
            R.append((*row, Fraction(0)))
            K.append((Fraction(0),) * len(known))
            continue
        share = known[b] / f.K[j][b]
        R.append((*add_multiple(row, -share, f.R[j]), share))
        K.append(add_multiple(known, -share, f.K[j]))
    used = tuple(u and a != j for a, u in enumerate(f.used))
    return ExactFrame(tuple(R), tuple(K), (*f.inner, f.outer[j]), f.outer, used)
