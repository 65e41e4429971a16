"""The numbers of a model's arguments, exact, and refused with the name of their field."""

from fractions import Fraction
from numbers import Real
from typing import TypeGuard, cast

import numpy as np

from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, MatrixLike, Number


def is_real(x: object) -> TypeGuard[float]:
    """Return whether something is a number: of Python or NumPy, and no bool."""
    return isinstance(x, Real) and not isinstance(x, bool)


def is_whole(x: object) -> TypeGuard[int]:
    """Return whether something is a whole number: of Python or NumPy, and no bool."""
    return isinstance(x, int | np.integer) and not isinstance(x, bool)


def number(field: str, x: Number) -> Fraction:
    """Return a number of a field exactly; raise ValueError with its name."""
    # True is 1 to Python, and a mistake in a model
    if isinstance(x, bool | np.bool_):
        raise ValueError(f"{field} must be a number, not {x!r}")
    try:
        return linalg.rational(x)
    except ValueError as e:
        raise ValueError(f"{field}: {e}") from None


def ordered_pair(field: str, stated: object, apart: bool = False) -> tuple[Fraction, Fraction]:
    """Return the lowest and the highest number of a field exactly; raise ValueError with its name. apart:
    whether they must differ.
    """
    pair = np.asarray(stated, object)
    if pair.shape != (2,):
        raise ValueError(f"{field} needs two numbers, the lowest and the highest, not {stated!r}")
    lo, hi = number(field, pair[0]), number(field, pair[1])
    if lo > hi or (apart and lo == hi):
        sign = "<" if apart else "<="
        raise ValueError(f"{field} needs lo {sign} hi, not [{float(lo):g}, {float(hi):g}]")
    return lo, hi


def exact_matrix(field: str, a: MatrixLike | None) -> Matrix:
    """Return a matrix exactly; raise ValueError with the name of its field."""
    if a is not None and np.ndim(np.asarray(a, object)) == 0:
        raise ValueError(f"{field} must be a matrix, a list of rows like [[0.8, 0], [0.1, 0.9]], not {a!r}")
    try:
        return linalg.matrix(cast("MatrixLike", a))  # None is refused there
    except (ValueError, TypeError) as e:
        raise ValueError(f"{field}: {e}") from None


def entries_of(field: str, a: MatrixLike | None) -> Matrix:
    """Return a matrix exactly; () where it is left out or has no entry."""
    if a is None or not np.size(np.asarray(a, object)):
        return ()
    return exact_matrix(field, a)
