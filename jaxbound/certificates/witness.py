"""The parts that all certificates share: a behaviour that explains a window, and exact numbers as text."""

from collections.abc import Sequence
from decimal import Decimal, localcontext
from fractions import Fraction
from functools import cached_property
from typing import Any, TypeAlias, TypeVar

from jaxbound.certificates.checker.claim import checksum, statement
from jaxbound.certificates.exact_window import ExactWindow
from jaxbound.certificates.interface import Sample, WindowCertificate
from jaxbound.certificates.plain import plain_names
from jaxbound.exact.linalg import Matrix, Vector
from jaxbound.sets.floats.status import Status

Numbers: TypeAlias = dict[str, Any]
"""A tree of Fractions by name."""
T = TypeVar("T")


class Witnessed(WindowCertificate):
    """A certificate of .window, an ExactWindow, with .z, the unknowns of a behaviour that explains it, or
    None.

    z is (first state, disturbances, unknown inputs, missing inputs), as the columns of `ExactWindow.forms`.
    """

    window: ExactWindow
    z: Vector | None

    @cached_property
    def _witness(self) -> dict[str, Vector]:
        if self.z is None:
            return {}
        return _behaviour(self.window, self.z)

    def _part(self, name: str, width: int) -> Matrix | None:
        """Return a part of the witness as rows, None where there is no witness."""
        if self.z is None:
            return None
        return in_rows(self._witness[name], width)

    @property
    def state(self) -> Vector | None:
        """The first state of the witness, or None."""
        return self._witness.get("state")

    @property
    def outputs(self) -> Matrix | None:
        """The true outputs of the witness, a tuple of s + 1 rows, or None."""
        return self._part("outputs", self.window.model.p)

    @property
    def disturbances(self) -> Matrix | None:
        """The disturbances of the witness, a tuple of s rows, or None."""
        rows = self._part("disturbances", self.window.model.g)
        if rows == ():
            return ((),) * self.window.horizon
        return rows

    @property
    def unknown_inputs(self) -> Matrix | None:
        """The unknown inputs of the witness, a tuple of s rows (s + 1 where they act on the outputs at once),
        or None.
        """
        return self._part("unknown_inputs", self.window.model.d)

    @property
    def inputs(self) -> Matrix | None:
        """The inputs of the witness as recorded, missing ones filled in, a tuple of rows, or None."""
        return self._part("inputs", self.window.model.m)

    def _document(
        self, verdict: Status, proof: Numbers, times: Sequence[str] | None, sample: Sample
    ) -> dict[str, Any]:
        """Return a certificate ready for JSON: the model, samples and bounds, the numbers of the proof, and
        their sum.
        """
        numbers: Numbers = dict(self.window.claim)
        numbers["witness"] = None
        if self.z is not None:
            numbers["witness"] = self._witness_dict(self.z)
        numbers |= proof
        every: list[Fraction] = []
        written = texts(numbers, every)
        written |= texts({"sum": checksum(every)}, [])
        if sample is None:
            sample = list(self.at)
        names = plain_names(self.window.model, sample, times)
        sentence = statement(verdict.name, names, numbers)
        document: dict[str, Any] = {"certificate": verdict.name, "statement": sentence, "names": names}
        if self.test:
            document["test"] = self.test
        return document | {"numbers": written}

    def _witness_dict(self, z: Vector) -> Numbers:
        """Return the numbers of a behaviour, a row for each sample."""
        w, model, of = self.window, self.window.model, _behaviour(self.window, z)
        numbers: Numbers = {}
        gains = w.gains(z)
        if gains:
            numbers["gains"] = gains
        numbers["state"] = of["state"]
        lowest = [lo for lo, _ in w.claim["disturbance"]]
        numbers["disturbances"] = every_sample(w.horizon, of["disturbances"], lowest)
        nothing = [Fraction(0)] * model.d
        numbers["unknown_inputs"] = every_sample(w.horizon, of["unknown_inputs"], nothing)
        numbers["inputs"] = every_sample(w.horizon, of["inputs"], model.offset["u"])
        numbers["outputs"] = in_rows(of["outputs"], model.p)
        return numbers


def every_sample(horizon: int, values: Sequence[T], last: Sequence[T]) -> tuple[tuple[T, ...], ...]:
    """Return flat values as s + 1 rows; the last sample's, where the window does not depend on them, are
    `last`.
    """
    if not last:
        return ((),) * (horizon + 1)
    rows = in_rows(values, len(last))
    # the last one acts on no sample of the window: any value within its bounds will do
    if len(rows) == horizon:
        return (*rows, tuple(last))
    return rows


def _behaviour(w: ExactWindow, z: Vector) -> dict[str, Vector]:
    """Return the behaviour at unknowns of a window, by the names of `Witnessed`, flat."""
    model, missing = w.model, w.missing_inputs
    n, g = model.n, model.g * w.horizon
    outputs = []
    for i, true in enumerate(w.rows_at(z)[: len(w.y)]):
        outputs.append(true + model.offset["y"][i % model.p])
    z = z[: len(w.unknown_columns()[0])]
    free = len(z) - len(missing)
    unknown = dict(zip(missing, z[free:], strict=True))
    filled = []
    for j, v in enumerate(w.u):
        if v is None:
            v = unknown.get(j, Fraction(0)) + model.offset["u"][j % model.m]
        filled.append(v)
    return {
        "state": z[:n],
        "disturbances": z[n : n + g],
        "unknown_inputs": z[n + g : free],
        "inputs": tuple(filled),
        "outputs": tuple(outputs),
    }


def in_rows(values: Sequence[T], width: int) -> tuple[tuple[T, ...], ...]:
    """Return flat values as rows of that width."""
    if not width:
        return ()
    return tuple(tuple(values[j : j + width]) for j in range(0, len(values), width))


def texts(tree: Any, every: list[Fraction]) -> Any:  # of a tree, whose branches have many types
    """Return a tree of exact numbers with each as text; append them to `every`."""
    if isinstance(tree, dict):
        return {name: texts(branch, every) for name, branch in tree.items()}
    if isinstance(tree, (list, tuple)):
        return [texts(branch, every) for branch in tree]
    if isinstance(tree, Fraction):
        every.append(tree)
        return _text(tree)
    return tree


def _text(x: Fraction) -> str:
    """Return an exact number as text that Fraction reads: a decimal where a short one is exact, else
    "p/q".
    """
    with localcontext() as context:
        # what people and recorders write is shorter; longer decimals are shown as quotients
        context.prec = 60
        short = Decimal(x.numerator) / Decimal(x.denominator)
    if Fraction(short) == x:
        return str(short)
    return str(x)
