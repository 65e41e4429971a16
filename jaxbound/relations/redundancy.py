"""Minimal relations among the samples of all signals, polynomial in the shift operator q, with unknown inputs
eliminated exactly.

| paper | here | |
|---|---|---|
| M_y, M_u | My, Mu | My(q) y + Mu(q) u = 0 for an exact plant, whatever its state and its unknown inputs |
| q | q | forward shift |

The relations of a plant are a module over polynomials in q. Their numbers of samples are those of a basis
with the smallest degrees, the Forney indices. Numbers are exact: whether a relation exists is a question of
rank, which floats can only guess.

Source: Ragot, Maquin, Kratz 1993; degrees: Forney 1975.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import gcd
from typing import ClassVar, TypeAlias

import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.bank import BankTest
from jaxbound.consistency.interface import Budget, Relations, WindowTest, refuse_options
from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, Vector
from jaxbound.models import window
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.system import LinearSystem
from jaxbound.relations import shift
from jaxbound.relations.bounds import Bounds
from jaxbound.relations.parity import ParityRelation, stated_relations
from jaxbound.relations.sentence import few_lines
from jaxbound.relations.shift import Row
from jaxbound.text.objects import readable

METHODS = ("window", "elimination")
ZERO = Fraction(0)
_Reduced: TypeAlias = tuple[int, list[int], dict[int, int]]
"""A row of integers: the column that it leads, its numbers, and how it is made of samples."""


@readable
@dataclass(frozen=True, eq=False)
class Redundancy(Relations):
    """Relations M(q) (y; u) = 0 of a model. Build them with `redundancy` or `structured_relations`.

    Fields: model; rows: a row of p + m polynomials in q for each relation (`relations.shift`); insensitive:
    for each relation the names of the signals that it was made to ignore.
    """

    model: LinearSystem
    rows: tuple[Row, ...]
    insensitive: tuple[tuple[str, ...], ...]

    methods = ("box",)
    untuned: ClassVar[str | None] = (
        ", whose relations explain alone whatever the joint test explains: tune that, and build the bank of "
        "the tuned .model"
    )

    def _head(self) -> str:
        return f"{type(self).__name__}: {self.count} relations, {self.model.p} outputs, {self.model.m} inputs"

    def _rows(self) -> dict[str, str]:
        return few_lines(self)

    @property
    def count(self) -> int:
        """Number of relations."""
        return len(self.rows)

    @property
    def made(self) -> tuple[object, ...]:
        """The numbers of the bank, on which relations depend beside model, horizon and bounds."""
        return "bank", self.relations.W, self.relations.K

    @property
    def bounds(self) -> Bounds:
        """The bounds of the relations, as of `parity_relations`."""
        return self.relations.bounds

    @property
    def names(self) -> tuple[str, ...]:
        """The signals of the columns: outputs, then inputs."""
        return self.model.outputs + self.model.inputs

    @property
    def degrees(self) -> np.ndarray:
        """(r,) int: a relation of degree j spans j + 1 samples."""
        return np.array([shift.degree(row) for row in self.rows], int)

    @property
    def horizon(self) -> int:
        """The largest degree: a window of horizon + 1 samples holds every relation."""
        return int(self.degrees.max(initial=0))

    @cached_property
    def _dense(self) -> np.ndarray:
        out = np.full((self.count, self.horizon + 1, len(self.names)), Fraction(0), object)
        for r, row in enumerate(self.rows):
            for j, numbers in enumerate(shift.coefficients(row)):
                out[r, j] = numbers
        return out

    @property
    def My(self) -> np.ndarray:
        """(r, horizon + 1, p) Fractions: coefficients on the outputs by ascending powers of q."""
        return self._dense[:, :, : self.model.p]

    @property
    def Mu(self) -> np.ndarray:
        """(r, horizon + 1, m) Fractions: coefficients on the inputs by ascending powers of q."""
        return self._dense[:, :, self.model.p :]

    def text(self) -> str:
        """Return the relations, one a line."""
        texts = [shift.row_text(row, self.names) for row in self.rows]
        return "\n".join(f"r{i}: {text}" for i, text in enumerate(texts, 1))

    @cached_property
    def relations(self) -> ParityRelation:
        """The same relations as a ParityRelation over windows of horizon + 1 samples, each to be tested
        alone.
        """
        return stated_relations(self.model, self.horizon, *self.windows())

    def test(self, method: str, dtype: DTypeLike, budget: Budget = None) -> WindowTest:
        """Return the WindowTest by which a method decides windows; see `detect`.

        Raises:
            ValueError: a method or budget that these relations cannot be tested by.
        """
        refuse_options(method, budget)
        return BankTest(self.relations, dtype)

    def windows(self) -> tuple[Matrix, Matrix]:
        """Return (W, K), rows over the samples of a window that ends at the newest sample of each relation: W
        Y = K U, exact.

        W (count, (s+1)p), K (count, l) as in `ParityRelation`, s the horizon.
        """
        s, p, m = self.horizon, self.model.p, self.model.m
        lags = window.input_lags(self.model, s)
        W, K = [], []
        for row in self.rows:
            numbers = shift.coefficients(row)
            # a shorter relation looks at the newest samples: an error is seen by all at once
            late = s + 1 - len(numbers)
            on_outputs, on_inputs = (ZERO,) * (late * p), (ZERO,) * (late * m)
            for now in numbers:
                on_outputs += now[:p]
                # M_y y + M_u u = 0 here, W Y = K U there
                on_inputs += linalg.scale(now[p:], -1)
            W.append(on_outputs)
            K.append(on_inputs[: lags * m])
        return tuple(W), tuple(K)


def redundancy(model: ModelLike, method: str = "window") -> Redundancy:
    """Return a minimal basis of all relations between outputs and known inputs, exact.

    Args:
        model: a LinearSystem, unknown inputs included; bounded disturbances are not eliminated. Or what
            `parity_relations` takes.
        method: "window": relations are looked for among ever longer windows. "elimination": the same, but
            refused where the paper's own way does not lead there: it removes the unknown inputs first, which
            needs rank(C F) = rank F and unknown inputs that act on the state only.

    Returns:
        A Redundancy with the fewest samples in each relation.

    Raises:
        ValueError: the elimination does not apply (says why), an unknown method. NotImplementedError: the
            model has uncertainties.

    Source: Ragot 1993, (2)-(20).

    Example:
        >>> A, B, C = [[0, 0], [0, "1/2"]], [[1], [0]], [[1, 0], [0, 1], [1, 1]]
        >>> m = LinearSystem(A, B, C, unknown_inputs=[[0], [1]])
        >>> print(redundancy(m).text())
        r1: y1 + y2 - y3 = 0
        r2: q y1 - u1 = 0
        >>> redundancy(m, method="elimination").degrees
        array([0, 1])
    """
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, not {method!r}")
    model = as_model(model)
    if method == "elimination" and model.n:
        _refuse_elimination(model)
    rows = tuple(sorted(map(shift.presentable_row, basis(model)), key=shift.degree))
    return Redundancy(model, rows, ((),) * len(rows))


def _refuse_elimination(model: LinearSystem) -> None:
    """Raise ValueError where unknown inputs cannot be removed before the state.

    Source: Ragot 1993, (2)-(12).
    """
    if model.has_direct_unknown:
        raise ValueError(
            "the elimination is for unknown inputs that act on the state only, and D_v is not zero; use "
            "method='window'"
        )
    if not model.d:
        return
    shown, every = linalg.rank(linalg.matmul(model.C, model.F)), linalg.rank(model.F)
    if shown < every:
        raise ValueError(
            f"the elimination needs rank(C F) = rank F, so that each unknown input shows in the next "
            f"outputs: rank(C F) is {shown}, rank F is {every}; use method='window'"
        )


def basis(model: LinearSystem, F: Matrix | None = None, D_v: Matrix | None = None) -> tuple[Row, ...]:
    """Return the rows of a minimal basis; F, D_v instead of the model's own unknown inputs.

    Outputs are taken sample after sample. One that depends on those before it gives a relation, and so do its
    later samples, whose relations are the same, shifted: they are left out. So every relation ends at an
    output of its own, and the leading coefficients are
    triangular: no combination has a smaller degree.
    """
    if model.uncertainties:
        raise NotImplementedError(
            "relations polynomial in q are for a certain model: leave its uncertainties out, or decouple them"
        )
    if F is None or D_v is None:
        F, D_v = model.F, model.D_v
    p, free = model.p, len(D_v[0])
    most = p
    if free:  # a rank at one q can only be too small, and `most` too large
        most = p - (linalg.rank(_pencil(model, F, D_v)) - model.n)
    reached, responses = model.C, [D_v]
    waiting = list(range(p))
    independent: list[_Reduced] = []
    rows: list[Row] = []
    for j in range(model.n + 1):
        again = []
        for i in waiting:
            through: Vector = ()
            for response in reversed(responses):
                through += response[i]
            # whole numbers: one scale a row, and no fraction is reduced in the loops
            row, scale = linalg.integers(reached[i] + through)
            numbers, used = _reduced(list(row), {j * p + i: scale}, independent)
            pivot = next((c for c, x in enumerate(numbers) if x), None)
            if pivot is None:
                rows.append(_row(model, used, j))
                continue
            independent.append((pivot, numbers, used))
            again.append(i)
        waiting = again
        # no further relation exists: what comes later is these, shifted
        if len(rows) >= most:
            break
        response = ((),) * p
        if free:
            response = linalg.matmul(reached, F)
        responses.append(response)
        reached = linalg.matmul(reached, model.A)
    return tuple(rows)


def _pencil(model: LinearSystem, F: Matrix, D_v: Matrix) -> Matrix:
    """Return [[q - A, F], [C, D_v]] at some q."""
    # far from any root that a model of moderate numbers has; a hit would only cost time
    q = Fraction(1_000_003)
    rows = []
    for unit, a, f in zip(linalg.identity(model.n), model.A, F, strict=True):
        rows.append(linalg.add_multiple(linalg.scale(unit, q), -1, a) + f)
    for c, v in zip(model.C, D_v, strict=True):
        rows.append(c + v)
    return tuple(rows)


def _reduced(
    row: list[int], used: dict[int, int], kept: Sequence[_Reduced]
) -> tuple[list[int], dict[int, int]]:
    """Return a row of integers less its share of those kept, and how it is made of samples."""
    for pivot, other, others in kept:
        if row[pivot]:
            f, head = row[pivot], other[pivot]
            row = [head * x for x in row]
            for c, y in enumerate(other):
                if y:
                    row[c] -= f * y
            used = {key: head * x for key, x in used.items()}
            for key, y in others.items():
                used[key] = used.get(key, 0) - f * y
            common = gcd(*row, *used.values())
            # numbers would double their digits with each row that is taken out
            if common > 1:
                row = [x // common for x in row]
                used = {key: x // common for key, x in used.items()}
    return row, used


def _row(model: LinearSystem, used: dict[int, int], last: int) -> Row:
    """Return the row of polynomials of a relation: numbers on samples (time * p + output), the last time
    being `last`.
    """
    numbers = []
    for j in range(last + 1):
        numbers.append([Fraction(used.get(j * model.p + i, 0)) for i in range(model.p)])
    return tuple(shift.trim(c) for c in zip(*numbers, strict=True)) + known_side(model, numbers)


def known_side(model: LinearSystem, h: Sequence[Sequence[Fraction]]) -> Row:
    """Return the m polynomials of the inputs in a relation with the numbers h (degree + 1, p) on the
    outputs.
    """
    state, known = (Fraction(0),) * model.n, []
    for now in reversed(h):  # how the samples later than this one depend on the state after it
        direct, through = _times(now, model.D, model.m), _times(state, model.B, model.m)
        known.append(linalg.scale(linalg.add_multiple(direct, 1, through), -1))
        seen, moved = _times(now, model.C, model.n), _times(state, model.A, model.n)
        state = linalg.add_multiple(seen, 1, moved)
    return tuple(shift.trim(c) for c in zip(*reversed(known), strict=True))


def _times(row: Sequence[Fraction], matrix: Matrix, width: int) -> Vector:
    """Return row times matrix, which may be without rows."""
    if not matrix:
        return (ZERO,) * width
    return linalg.matmul((row,), matrix)[0]
