"""The parts that all certificates share: a behaviour that explains a window, and exact numbers as text."""

from collections.abc import Iterator, Sequence
from copy import copy
from decimal import Decimal, localcontext
from fractions import Fraction
from typing import Any, Self, TypeAlias, TypeVar

from jaxbound.certificates.checker.claim import statement
from jaxbound.certificates.exact_window import ExactWindow
from jaxbound.certificates.interface import Index, Sample
from jaxbound.certificates.plain import plain_names, plain_plant, plain_sums
from jaxbound.exact.linalg import Matrix, Vector, dot
from jaxbound.models.sensor import RECORDER_ULPS
from jaxbound.sets.floats.status import Status

__all__ = ["Numbers", "Witnessed", "rows_of", "texts"]

Numbers: TypeAlias = dict[str, Any]
"""A tree of Fractions by name."""
T = TypeVar("T")


class Witnessed:
    """A certificate of .window, an ExactWindow, with .z, the unknowns of a behaviour that explains it, or
    None.

    z is (first state, disturbances, unknown inputs, missing inputs), as the columns of `ExactWindow.forms`.
    """

    window: ExactWindow
    z: Vector | None
    status: Status
    at: Index
    test: str

    @property
    def state(self) -> Vector | None:
        """The first state of the witness, or None."""
        if self.z is None:
            return None
        return self.z[: self.window.model.n]

    @property
    def outputs(self) -> Matrix | None:
        """The true outputs of the witness, a tuple of s + 1 rows, or None."""
        if self.z is None:
            return None
        p, offset = self.window.model.p, self.window.model.offset["y"]
        true = self.window.rows_at(self.z)[: len(self.window.y)]
        return rows_of([v + offset[i % p] for i, v in enumerate(true)], p)

    @property
    def disturbances(self) -> Matrix | None:
        """The disturbances of the witness, a tuple of s rows, or None."""
        if self.z is None:
            return None
        n, g, s = self.window.model.n, self.window.model.g, self.window.horizon
        return rows_of(self.z[n : n + g * s], g) or ((),) * s

    @property
    def unknown_inputs(self) -> Matrix | None:
        """The unknown inputs of the witness, a tuple of s rows (s + 1 where they act on the outputs at once),
        or None.
        """
        if self.z is None:
            return None
        model = self.window.model
        first = model.n + model.g * self.window.horizon
        return rows_of(self.z[first : len(self.z) - len(self.window.missing_inputs)], model.d)

    @property
    def inputs(self) -> Matrix | None:
        """The inputs of the witness as recorded, missing ones filled in, a tuple of rows, or None."""
        if self.z is None:
            return None
        missing, model = self.window.missing_inputs, self.window.model
        unknown = dict(zip(missing, self.z[len(self.z) - len(missing) :], strict=True))
        filled = []
        for j, v in enumerate(self.window.u):
            if v is None:
                v = unknown.get(j, Fraction(0)) + model.offset["u"][j % model.m]
            filled.append(v)
        return rows_of(filled, model.m)

    def _document(
        self, verdict: Status, proof: Numbers, times: Sequence[str] | None, sample: Sample
    ) -> dict[str, Any]:
        """Return a certificate ready for JSON: the model, samples and bounds, the numbers of the proof, and
        their sum.
        """
        w, model = self.window, self.window.model
        numbers: Numbers = plain_plant(model)
        for bound in ("tolerance", "noise", "resolution", "disturbance"):
            numbers[bound] = getattr(w, bound)
        numbers["recorder"], numbers["floor"] = RECORDER_ULPS * w.unit, w.floor
        if w.factors:
            numbers["factors"] = rows_of(w.factors, model.p)
        if w.lags is not None:
            numbers["lags"] = tuple(map(Fraction, w.lags))
        if w.rows.sums:
            numbers |= self._sums()
        nothing: list[Fraction | None] = [None] * model.m
        numbers["u"], numbers["y"] = self._every_sample(w.u, nothing), rows_of(w.y, model.p)
        numbers["witness"] = None
        if self.z is not None:
            numbers["witness"] = self._witness_dict(self.z)
        numbers |= proof
        every = list(_all_numbers(numbers))
        numbers["sum"] = dot(every, [1] * len(every))  # faster than `sum`, which reduces after each number
        if sample is None:
            sample = list(self.at)
        names = plain_names(model, sample, times)
        sentence = statement(verdict.name, names, numbers)
        document: dict[str, Any] = {"certificate": verdict.name, "statement": sentence, "names": names}
        if self.test:
            document["test"] = self.test
        return document | {"numbers": texts(numbers)}

    def _sums(self) -> Numbers:
        """Return the bounded sums, their runs in the window, and all samples that they weigh."""
        w = self.window
        runs = []
        for row in w.rows.of_sums:
            run: Numbers = {"average": Fraction(row.number), "first": None}
            if row.seen:
                run["first"] = Fraction(row.first)
            runs.append(run)
        return {
            "averages": plain_sums(w.rows.sums, w.average),
            "runs": runs,
            "all_y": rows_of(w.whole, w.model.p),
        }

    def _with(self, z: Vector) -> Self:
        """Return a certificate of another witness."""
        other = copy(self)
        object.__setattr__(other, "z", z)
        return other

    def _witness_dict(self, z: Vector) -> Numbers:
        """Return the numbers of a behaviour, a row for each sample."""
        w, model, other = self.window, self.window.model, self._with(z)
        numbers: Numbers = {}
        gains = w.gains(z)
        if gains:
            numbers["gains"] = gains
        numbers["state"] = other.state
        lowest = [lo for lo, _ in w.disturbance]
        numbers["disturbances"] = self._every_sample(_flat(other.disturbances), lowest)
        nothing = [Fraction(0)] * model.d
        numbers["unknown_inputs"] = self._every_sample(_flat(other.unknown_inputs), nothing)
        numbers["inputs"] = self._every_sample(_flat(other.inputs), model.offset["u"])
        numbers["outputs"] = other.outputs
        return numbers

    def _every_sample(self, values: Sequence[T], last: Sequence[T]) -> tuple[tuple[T, ...], ...]:
        """Return flat values as s + 1 rows; the last sample's, where the window does not depend on them, are
        `last`.
        """
        s = self.window.horizon
        if not last:
            return ((),) * (s + 1)
        rows = rows_of(values, len(last))
        if len(rows) == s:
            return (*rows, tuple(last))
        return rows


def rows_of(values: Sequence[T], width: int) -> tuple[tuple[T, ...], ...]:
    """Return flat values as rows of that width."""
    if not width:
        return ()
    return tuple(tuple(values[j : j + width]) for j in range(0, len(values), width))


def _flat(rows: Matrix | None) -> Vector:
    return tuple(x for row in rows or () for x in row)


def _all_numbers(tree: object) -> Iterator[Fraction]:
    if isinstance(tree, Fraction):
        yield tree
    elif isinstance(tree, dict):
        yield from _all_numbers(list(tree.values()))
    elif isinstance(tree, (list, tuple)):
        for branch in tree:
            yield from _all_numbers(branch)


def texts(tree: Any) -> Any:  # of a tree, whose branches have many types
    """Return a tree of exact numbers with each as text."""
    if isinstance(tree, dict):
        return {name: texts(branch) for name, branch in tree.items()}
    if isinstance(tree, (list, tuple)):
        return [texts(branch) for branch in tree]
    if isinstance(tree, Fraction):
        return _text(tree)
    return tree


def _text(x: Fraction) -> str:
    """Return an exact number as text that Fraction reads: a decimal where a short one is exact, else
    "p/q".
    """
    with localcontext() as context:
        context.prec = 60
        short = Decimal(x.numerator) / Decimal(x.denominator)
    if Fraction(short) == x:
        return str(short)
    return str(x)
