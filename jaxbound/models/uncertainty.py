"""Uncertain parameters: how a bounded number changes the matrices of a model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, MatrixLike, Number
from jaxbound.models.numbers import exact_matrix, ordered_pair
from jaxbound.text.objects import readable

LETTERS = ("A", "B", "C", "D")


@readable
@dataclass(frozen=True, init=False)
class Uncertainty:
    """A parameter of which only bounds are known, and what it multiplies: A(v) = A + v dA, and likewise B, C,
    D.

    Args:
        name: of the parameter, for reports.
        A, B, C, D: the coefficient of the parameter in the model's matrix of that letter, of its shape; None:
            it does not act there.
        varying: True if it may have another value at each sample, False if it keeps one value over a window.
        between: (lo, hi), the bounds of the parameter. The model's own matrices are those at the value 0 of
            the parameter, so a model whose gain lies in [2, 6] has 0 at that place, 1 in the coefficient and
            between=(2, 6).

    Attributes (exact numbers): A, B, C, D as tuples of rows or None, between.

    Raises:
        ValueError: no coefficient at all, lo >= hi, a number that is not finite.

    Source: Ploix, Adrot 2006, (1): v = 4 + 2 theta for a parameter in [2, 6].

    Example:
        >>> k = Uncertainty("k_valve", B=[[1]], between=(2, 6))
        >>> k.centre, k.radius
        (Fraction(4, 1), Fraction(2, 1))
    """

    name: str
    A: Matrix | None
    B: Matrix | None
    C: Matrix | None
    D: Matrix | None
    varying: bool
    between: tuple[Fraction, Fraction]

    def __init__(
        self,
        name: str,
        A: MatrixLike | None = None,
        B: MatrixLike | None = None,
        C: MatrixLike | None = None,
        D: MatrixLike | None = None,
        varying: bool | np.bool_ = True,
        between: Sequence[Number] | np.ndarray = (-1, 1),
    ) -> None:
        name = str(name)
        if not name:
            raise ValueError("an uncertainty needs a name")
        matrices: dict[str, Matrix | None] = {}
        for letter, given in zip(LETTERS, (A, B, C, D), strict=True):
            matrices[letter] = None
            if given is not None and len(given):
                matrices[letter] = exact_matrix(f"{letter} of uncertainty {name!r}", given)
        if not any(x for rows in matrices.values() for row in rows or () for x in row):
            raise ValueError(f"uncertainty {name!r} acts on nothing: give its coefficient in A, B, C or D")
        if not isinstance(varying, (bool, np.bool_)):
            raise ValueError(f"varying of uncertainty {name!r} must be True or False, not {varying!r}")
        bounds = ordered_pair(f"between of uncertainty {name!r}", between, apart=True)
        vars(self).update(name=name, **matrices, varying=bool(varying), between=bounds)

    @property
    def centre(self) -> Fraction:
        """The middle of its bounds."""
        return (self.between[0] + self.between[1]) / 2

    @property
    def radius(self) -> Fraction:
        """Half the width of its bounds."""
        return (self.between[1] - self.between[0]) / 2

    def on(self, letter: str) -> Matrix | None:
        """Return radius times the coefficient in one matrix, None where it does not act: what v in [-1, 1]
        multiplies.
        """
        rows = coefficient(self, letter)
        if rows is None:
            return None
        return tuple(linalg.scale(row, self.radius) for row in rows)


def coefficient(u: Uncertainty, letter: str) -> Matrix | None:
    """Return the coefficient of a parameter in one matrix, None where it does not act."""
    rows: Matrix | None = getattr(u, letter)
    return rows


def influences(
    given: Uncertainty | Sequence[Uncertainty], shapes: Mapping[str, tuple[int, int]]
) -> tuple[Uncertainty, ...]:
    """Check the uncertainties of a model against the shapes {"A": (n, n), ..} of its matrices and return them
    as a tuple.

    Raises ValueError naming what does not fit, TypeError for anything that is no Uncertainty.
    """
    parameters = tuple(given) if isinstance(given, Iterable) else (given,)
    for u in parameters:
        if not isinstance(u, Uncertainty):
            raise TypeError(f"uncertainties must be jb.Uncertainty(name, A=..., ...), not {type(u).__name__}")
        for letter in LETTERS:
            rows = coefficient(u, letter)
            if rows is not None and (len(rows), len(rows[0])) != shapes[letter]:
                raise ValueError(
                    f"{letter} of uncertainty {u.name!r} must have the shape of the model's {letter}, "
                    f"{shapes[letter]}: its shape is {(len(rows), len(rows[0]))}"
                )
    names = [u.name for u in parameters]
    twice = sorted({x for x in names if names.count(x) > 1})
    if twice:
        raise ValueError(f"each uncertainty needs its own name: {', '.join(map(repr, twice))} is used twice")
    return parameters


def centred(matrix: Matrix, uncertainties: Sequence[Uncertainty], letter: str, sign: int = 1) -> Matrix:
    """Return the matrix at the middle of all parameters (sign 1), or from that the one at the value 0 of them
    all (sign -1).
    """
    for u in uncertainties:
        rows = coefficient(u, letter)
        # v in [-1, 1] stands for centre + radius v: the middle belongs to the matrices
        if rows is not None and u.centre:
            pairs = zip(matrix, rows, strict=True)
            matrix = tuple(linalg.add_multiple(row, sign * u.centre, d) for row, d in pairs)
    return tuple(tuple(map(Fraction, row)) for row in matrix)
