"""Parity relations of a model with uncertain parameters: polynomials in v that hold for every state, exact.

    Omega(v) E(v) = 0     =>     N(v) z - K(v) U = 0,     N = [Omega, -Omega V],  K = Omega H,  z = (true
    outputs, disturbances)

Source: Ploix, Adrot 2006, (4)-(6).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Self, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike

from jaxbound.consistency.interface import (
    METHODS,
    Array,
    Budget,
    Starts,
    WindowTest,
    refuse_options,
)
from jaxbound.consistency.parametric import ParametricTest
from jaxbound.consistency.polynomial_reading import PolynomialReading, PolynomialRelations, Polynomials
from jaxbound.exact import linalg
from jaxbound.exact.linalg import Vector
from jaxbound.models.system import LinearSystem
from jaxbound.models.window import window_rows
from jaxbound.relations.annihilator import Step, annihilator, generic_rank, rank_over_box
from jaxbound.relations.bounds import Bounds, changed_bounds, float_bound, model_bounds, reading
from jaxbound.relations.forms import Formed, Forms, forms, over_samples
from jaxbound.relations.polynomial import Exponents, PolynomialMatrix, Terms, stacked
from jaxbound.relations.sentence import bracketed, few_lines, joined, number_text, row_name, sample_names
from jaxbound.relations.uncertain_window import Variable, uncertain_window
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.strips.polynomials import closure
from jaxbound.text.objects import readable
from jaxbound.text.progress import Progress

Polynomial: TypeAlias = list[tuple[Exponents, Fraction]]
"""[(exponents, coefficient)], the constant first."""


@readable
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class UncertainRelations(Formed, PolynomialRelations):
    """Parity relations with uncertain parameters over a window of horizon + 1 samples. Build it with
    `parity_relations`.

    Fields: bounds {"tolerance": (p,), "noise": (p,), "parameters": (number of uncertainties,)}, and
    "disturbance": (g, 2) if the model has one; a parameter's bound is in half-widths of its `between`, 1 as
    built. model, horizon. variables: ((name, lag or None), ..), what the polynomials are in. N (count, (s+1)p
    + gs) and K (count, l): exact PolynomialMatrices, N(v) z = K(v) U for an exact plant with true outputs and
    disturbances z. steps: how the search went, one `Step` an order. complete: "proved" if the relations say
    all that can be said of a window at every v of the box, "sampled" if that holds at all points tried,
    "partial" if the search gave up.
    notes: sentences for the user.
    """

    bounds: Bounds = field()  # no default, whatever the family of all relations has
    model: LinearSystem = field(metadata={"static": True})
    horizon: int = field(metadata={"static": True})
    variables: tuple[Variable, ...] = field(metadata={"static": True})
    N: PolynomialMatrix = field(metadata={"static": True})
    K: PolynomialMatrix = field(metadata={"static": True})
    steps: tuple[Step, ...] = field(metadata={"static": True})
    complete: str = field(metadata={"static": True})
    notes: tuple[str, ...] = field(metadata={"static": True})

    methods = METHODS

    def _head(self) -> str:
        return (
            f"{type(self).__name__}: {self.count} relations over {self.horizon + 1} samples, "
            f"{self.model.p} outputs, {self.model.m} inputs"
        )

    def _rows(self) -> dict[str, str]:
        return few_lines(self)

    @property
    def count(self) -> int:
        """Number of relations."""
        return self.N.rows

    @property
    def form(self) -> str:
        """How they were made."""
        return "polynomial"

    @property
    def made(self) -> tuple[object, ...]:
        """The form and the order, on which relations depend beside model, horizon and bounds."""
        return self.form, self.order

    @property
    def order(self) -> int:
        """The largest order of a monomial in the relations."""
        return max(self.N.order, self.K.order)

    @property
    def tested(self) -> str:
        """The polynomials that a window is tested by, in words."""
        return f"polynomials of order {self.order} in {len(self.variables)} uncertain numbers"

    @property
    def exponents(self) -> tuple[Exponents, ...]:
        """The monomials of the relations and all that divide one of them, the constant first, orders
        ascending.
        """
        return closure(((0,) * len(self.variables), *self.N.terms, *self.K.terms))

    def reading(self, dtype: DTypeLike, method: str = "joint") -> PolynomialReading:
        """Return the PolynomialReading of these relations in a float dtype: what compiled kernels take."""
        model, alphas = self.model, self.exponents
        read = reading(None, model, self.horizon, self.bounds, dtype)
        names = [u.name for u in model.uncertainties]
        parameters = np.array([names.index(name) for name, _ in self.variables], int)
        size = float_bound(self.bounds["parameters"], dtype)[parameters]
        # kernels take arrays of NumPy too
        N, K = (cast("jax.Array", _floats(matrix, alphas, dtype)) for matrix in (self.N, self.K))
        return PolynomialReading(read, N, K, size, alphas, self._noisy())

    def test(self, method: str, dtype: DTypeLike, budget: Budget = None) -> WindowTest:
        """Return the WindowTest by which a method decides windows; see `detect`.

        Raises:
            ValueError: a method or budget that these relations cannot be tested by.
        """
        refuse_options(method, budget, adaptive=method == "joint")
        return ParametricTest(self, method, dtype, budget)

    def _noisy(self) -> tuple[int, ...]:
        """Return the rows of z that have a bound of their own beyond what the recorder rounds away."""
        resolution = np.array(list(map(float, self.model.resolution)))
        loud = np.zeros(self.model.p, bool)
        for bound in (self.bounds["tolerance"], self.bounds["noise"], resolution):
            if isinstance(bound, jax.core.Tracer):  # nobody knows whether it is 0
                loud[:] = True
            else:
                loud |= np.asarray(bound) > 0
        outputs = (self.horizon + 1) * self.model.p
        used = set()
        for entries in self.N.terms.values():
            used |= {j for _, j in entries}
        return tuple(j for j in sorted(used) if j >= outputs or loud[j % self.model.p])

    def without(self, rows: Collection[int], inputs: Collection[int]) -> Self | None:
        """Return relations of the same window that need neither these of its rows nor these of its inputs, or
        None if there are none.

        Args:
            rows: a set of numbers of samples (s+1)p, time-major. inputs: a set of numbers of the l inputs;
                they may be anything.
        """
        found = _without(self.model, self.horizon, frozenset(rows), frozenset(inputs))
        if found is None:
            return None
        return dataclasses.replace(self, **found)

    def polynomials(self, u: ArrayLike, y: ArrayLike) -> Polynomials:
        """Return the relations of N windows as polynomials: see `PolynomialReading.polynomials`.

        Args:
            u: (s + 1, m, N), y: (s + 1, p, N), as recorded, NaN where missing.
        """
        u, y = jnp.asarray(u), jnp.asarray(y)
        polynomials: Polynomials = _polynomials(self.reading(y.dtype), u, y)
        return polynomials

    def with_bounds(self, bounds: Mapping[str, ArrayLike]) -> Self:
        """Return the same relations under other bounds.

        Args:
            bounds: {"tolerance": (p,), "noise": (p,), "disturbance": (g,) or (g, 2), "parameters": (number of
                uncertainties,)}, or some of them; arrays, numbers or tracers. "parameters" is in half-widths
                of `between`: 2 means a parameter twice as uncertain. Beyond 1 the relations still hold, but
                whether they say all is no longer proved (complete: "sampled").

        Raises:
            ValueError: an unknown name, a wrong shape, a negative bound, a tolerance >= 1, lo > hi, NaN or
                infinity.
        """
        fresh = changed_bounds(self.model, self.bounds, bounds)
        # wider than the box that was examined
        wider = isinstance(fresh["parameters"], jax.core.Tracer) or (fresh["parameters"] > 1).any()
        complete = self.complete
        if wider and complete == "proved":
            complete = "sampled"
        return dataclasses.replace(self, bounds=fresh, complete=complete)

    def _forms(self, u: object, y: object, starts: Starts) -> Forms:
        return forms(_forms, self, self.reading, u, y, starts)

    def text(self) -> str:
        """Return the relations, one a line, as a reader would write them.

        Example:
            >>> from jaxbound.models.uncertainty import Uncertainty
            >>> from jaxbound.relations.parity import parity_relations
            >>> a, c = Uncertainty("a", A=[[0.1, 0], [0, 0]]), Uncertainty("c", C=[[0.1, 0]], varying=False)
            >>> m = LinearSystem([[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0]], uncertainties=[a, c])
            >>> print(parity_relations(m).text())
            r1: (0.16 + 0.02 a[k-2]) y1[k-2] - (1 + 0.1 a[k-1]) y1[k-1] + y1[k] - (1 + 0.1 c) u1[k-2] = 0
        """
        return "\n".join(f"r{i + 1}: {self._line(i)} = 0" for i in range(self.count))

    def _line(self, i: int) -> str:
        model, at = self.model, sample_names(self.horizon)
        names = []
        for name, lag in self.variables:
            names.append(name if lag is None else name + at[lag])
        rows = window_rows(model, self.horizon).all
        terms = []
        for row, polynomial in zip(rows, self._polynomials_of(self.N, i), strict=False):
            terms.append((polynomial, row_name(model, row) + at[row.last]))
        for j, polynomial in enumerate(self._polynomials_of(self.K, i)):
            terms.append((_negative(polynomial), model.inputs[j % model.m] + at[j // model.m]))
        return joined(_term(polynomial, signal, names) for polynomial, signal in terms if polynomial)

    def _polynomials_of(self, matrix: PolynomialMatrix, i: int) -> list[Polynomial]:
        """Return [(exponents, coefficient)] of each entry of a row of a matrix."""
        found = []
        for j in range(matrix.columns):
            entry = ((a, matrix.terms.get(a, {}).get((i, j))) for a in self.exponents)
            found.append([(a, x) for a, x in entry if x is not None])
        return found


def uncertain_relations(
    model: LinearSystem, horizon: int, progress: Progress | None = None
) -> UncertainRelations:
    """Eliminate the unknown state, and unknown inputs, from a window of a model with uncertainties: see
    `parity_relations`.
    """
    if model.constant_tolerance:
        raise NotImplementedError(
            "constant_tolerance and uncertainties do not go together yet: give the constant gain error of a "
            "sensor as an uncertainty "
            "of its row of C (and D) with varying=False instead"
        )
    variables, E, H, V = uncertain_window(model, horizon)
    reduced, notes = _without_unseen(E, model)
    rank = generic_rank(reduced)
    if rank == E.rows:
        raise ValueError(
            f"horizon {horizon} gives no relation: {E.rows} samples do not outnumber the {rank} unknowns "
            f"that act on them; "
            "choose a longer one"
        )
    proof, where = rank_over_box(reduced, rank)
    if where is not None:
        near = _place(model, variables, where)
        if proof == "drops":
            raise ValueError(
                f"the model is not regularly observable: at {near} a window of "
                f"{horizon + 1} samples shows less of its "
                "state than elsewhere; narrow the bounds of the uncertainties so that they exclude this"
            )
        notes += (f"regular observability is not proved, nor refuted, near {near}: FAULT stays a proof",)
    omega, steps, complete = annihilator(reduced, progress)
    if not omega.rows:
        raise ValueError(
            f"horizon {horizon}: the relations are too large to be found; fewer varying parameters or "
            f"another horizon may do"
        )
    # relations may be all at almost every v, and too few where the rank of E drops
    if complete == "proved" and proof != "proved":
        complete = "sampled"
    if complete == "partial":
        notes += (
            f"the search for relations gave up at order {steps[-1].order}: there may be more, of higher "
            f"orders",
        )
    return UncertainRelations(
        model_bounds(model), model, horizon, variables, _on_rows(omega, V), omega @ H, steps, complete, notes
    )


@functools.lru_cache(512)
def _without(
    model: LinearSystem, horizon: int, rows: frozenset[int], inputs: frozenset[int]
) -> dict[str, Any] | None:
    """Return {field: value} of the UncertainRelations that need neither these rows nor these inputs, or None:
    see `without`.
    """
    _, E, H, V = uncertain_window(model, horizon)
    left = [i for i in range(E.rows) if i not in rows]
    free = E
    if inputs:  # missing ones may be anything, as a state
        free = stacked([[E, H.pick(columns=sorted(inputs))]])
    reduced = free.pick(rows=left)
    omega, steps, complete = annihilator(reduced)
    if not omega.rows:
        return None
    # fewer rows may lose rank where all of them do not
    if rank_over_box(reduced, generic_rank(reduced))[0] != "proved":
        complete = "sampled"
    # columns of rows that are left out are zeros: the relation does not look there
    whole: Terms = {}
    for a, entries in omega.terms.items():
        whole[a] = {(i, left[j]): x for (i, j), x in entries.items()}
    omega = dataclasses.replace(omega, columns=E.rows, terms=whole)
    return {"N": _on_rows(omega, V), "K": omega @ H, "steps": steps, "complete": complete}


def _on_rows(omega: PolynomialMatrix, V: PolynomialMatrix) -> PolynomialMatrix:
    """Return N = [Omega, -Omega V], what relations do with the true outputs and disturbances."""
    if not V.columns:
        return omega
    return stacked([[omega, -(omega @ V)]])


def _without_unseen(E: PolynomialMatrix, model: LinearSystem) -> tuple[PolynomialMatrix, tuple[str, ...]]:
    """Return E in fewer unknowns with the same left null space: combinations that act on no sample, whatever
    v, are left out.
    """
    rows: list[Vector] = []
    for a in E.terms:
        rows += [row for row in E.coefficient(a) if any(row)]
    pivots = linalg.row_reduce(rows)[1] if rows else ()
    reduced, hidden = E.pick(columns=pivots), model.n - sum(j < model.n for j in pivots)
    if not hidden:
        return reduced, ()
    some = f"{hidden} of {model.n} states act"
    if hidden == 1:
        some += "s"
    note = (
        f"{some} on no output within the horizon, whatever the parameters: relations and verdicts say "
        f"nothing about it"
    )
    return reduced, (note,)


def _place(model: LinearSystem, variables: Sequence[Variable], point: Sequence[Fraction]) -> str:
    """Return "a = 3, b = 0.5 (sample 2 of the window)": a point of the box in the user's units."""
    by_name = {u.name: u for u in model.uncertainties}
    values = []
    for (name, lag), v in zip(variables, point, strict=True):
        value = f"{name} = {float(by_name[name].centre + by_name[name].radius * v):g}"
        if lag is not None:
            value += f" (sample {lag + 1} of the window)"
        values.append(value)
    return ", ".join(values)


def _term(polynomial: Polynomial, signal: str, names: Sequence[str]) -> tuple[bool, str]:
    """Return a polynomial times a signal as a term of `joined`."""
    negative = polynomial[0][1] < 0
    if negative:
        polynomial = _negative(polynomial)
    return negative, bracketed(_sum(polynomial, names), len(polynomial)) + signal


def _negative(polynomial: Polynomial) -> Polynomial:
    """Return a polynomial times -1."""
    return [(alpha, -x) for alpha, x in polynomial]


def _sum(terms: Polynomial, names: Sequence[str]) -> str:
    """Return a polynomial as text, its first coefficient positive."""
    texts = []
    for alpha, x in terms:
        factors = []
        for name, e in zip(names, alpha, strict=True):
            if e:
                factors.append(name if e == 1 else f"{name}^{e}")
        if abs(x) != 1 or not factors:
            factors.insert(0, number_text(abs(x)))
        texts.append((x < 0, " ".join(factors)))
    return joined(texts)


def _floats(matrix: PolynomialMatrix, alphas: Sequence[Exponents], dtype: DTypeLike) -> np.ndarray:
    """Return the coefficients (rows, len(alphas), columns) as nearest floats."""
    out = np.zeros((matrix.rows, len(alphas), matrix.columns), dtype)
    for a, alpha in enumerate(alphas):
        for (i, j), x in matrix.terms.get(alpha, {}).items():
            out[i, a, j] = rounding.fraction_to_float(x, dtype)
    return out


@kernel
def _polynomials(reading: PolynomialReading, u: jax.Array, y: jax.Array) -> Polynomials:
    return reading.polynomials(u, y)


@kernel
def _forms(reading: PolynomialReading, u: jax.Array, y: jax.Array) -> Forms:
    """Return the Forms (T, count): every monomial and noise at its worst by itself."""
    s, count = reading.horizon, y.shape[0] - reading.horizon
    u, y = (jnp.stack([x[j : j + count].T for j in range(s + 1)]) for x in (u, y))
    value, _, spread, rad = reading.polynomials(u, y)
    samples = (y - reading.window.offset_y[None, :, None]).reshape(-1, count)
    none = jnp.zeros((), y.dtype)
    known = (u[: reading.lags] - reading.window.offset_u[None, :, None]).reshape(-1, count)
    external = sum(_products(reading.N, samples), none) - sum(_products(reading.K, known), none)
    centre: jax.Array = value[:, 0]
    width: jax.Array | float = 0.0
    for j in range(len(rad)):
        width = width + abs(spread[:, :, j]).sum(1)[:, None] * rad[j][None]
    for a, alpha in enumerate(reading.exponents[1:], 1):
        half = 1.0
        if all(e % 2 == 0 for e in alpha):  # v^alpha is in [0, 1], else in [-1, 1]
            half = 0.5
            centre += 0.5 * value[:, a]
        width += half * abs(value[:, a])
    lo, hi = external - centre - width, external - centre + width
    return over_samples(external, s), over_samples(lo, s), over_samples(hi, s)


def _products(coefficients: Array, rows: jax.Array) -> Iterator[jax.Array]:
    """Yield the nominal coefficients (count,) of each row times the row (N,), 0 where they are 0."""
    for j, x in enumerate(rows):
        own = coefficients[:, 0, j, None]
        yield jnp.where(own == 0, 0, own * x[None])
