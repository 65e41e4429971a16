"""What all certificates share: a behaviour that explains a window, and exact numbers as text."""

from collections.abc import Iterator, Sequence
from copy import copy
from decimal import Decimal, localcontext
from fractions import Fraction
from typing import Any

from jaxbound.certificates.checker.claim import statement
from jaxbound.certificates.plain import plain_names, plain_sums
from jaxbound.exact.linalg import dot
from jaxbound.models.sensor import RECORDER_ULPS
from jaxbound.sets.floats.status import Status

__all__ = ["Witnessed", "rows_of"]


class Witnessed:
    """A certificate of .window, an ExactWindow, with .z, the unknowns of a behaviour that explains it, or
    None.
    """

    window: Any
    z: tuple | None
    status: Status
    at: tuple

    @property
    def state(self) -> tuple | None:
        """The first state of the witness, or None."""
        return None if self.z is None else self.z[: self.window.model.n]

    @property
    def outputs(self) -> Any:
        """The true outputs of the witness, a tuple of s + 1 rows, or None."""
        if self.z is None:
            return None
        p, offset = self.window.model.p, self.window.model.offset["y"]
        return rows_of(
            [v + offset[i % p] for i, v in enumerate(self.window.rows_at(self.z)[: len(self.window.y)])], p
        )

    @property
    def disturbances(self) -> Any:
        """The disturbances of the witness, a tuple of s rows, or None."""
        w = self.window
        return (
            None
            if self.z is None
            else rows_of(self.z[w.model.n : w.model.n + w.model.g * w.horizon], w.model.g)
            or ((),) * w.horizon
        )

    @property
    def unknown_inputs(self) -> Any:
        """The unknown inputs of the witness, a tuple of s rows (s + 1 where they act on the outputs at once),
        or None.
        """
        if self.z is None:
            return None
        w = self.window
        return rows_of(
            self.z[w.model.n + w.model.g * w.horizon : len(self.z) - len(w.missing_inputs)], w.model.d
        )

    @property
    def inputs(self) -> Any:
        """The inputs of the witness as recorded, missing ones filled in, a tuple of rows, or None."""
        if self.z is None:
            return None
        w = self.window
        found = dict(zip(w.missing_inputs, self.z[len(self.z) - len(w.missing_inputs) :], strict=True))
        offset = w.model.offset["u"]
        filled = [
            found.get(j, Fraction(0)) + offset[j % w.model.m] if v is None else v for j, v in enumerate(w.u)
        ]
        return rows_of(filled, w.model.m)

    def _document(self, verdict, numbers, times, sample):
        """Return a certificate ready for JSON: the model, samples and bounds, the numbers of the proof, and
        their sum.
        """
        w, model = self.window, self.window.model
        numbers = {
            "A": model.A,
            "B": model.B,
            "C": model.C,
            "D": model.D,
            "G": model.G,
            "F": model.F,
            "D_v": model.D_v,
            "offset_u": model.offset["u"],
            "offset_y": model.offset["y"],
            "tolerance": w.tolerance,
            "noise": w.noise,
            "resolution": w.resolution,
            "disturbance": w.disturbance,
            "recorder": RECORDER_ULPS * w.unit,
            "floor": w.floor,
            **({} if w.lags is None else {"lags": tuple(map(Fraction, w.lags))}),
            **self._sums(),
            "u": self._every_sample(w.u, [None] * model.m),
            "y": rows_of(w.y, model.p),
            "witness": None if self.z is None else self._witness_dict(self.z),
            **numbers,
        }
        everything = list(all_numbers(numbers))
        numbers["sum"] = dot(everything, [Fraction(1)] * len(everything))
        names = plain_names(model, list(self.at) if sample is None else sample, times)
        said = statement(verdict.name, names, numbers)
        return {"certificate": verdict.name, "statement": said, "names": names, "numbers": texts(numbers)}

    def _sums(self):
        """Return what bounds say of sums: {"averages": one each}, {"runs": rows that count}, nothing without
        any.
        """
        w = self.window
        if not w.rows.sums:
            return {}
        sums = plain_sums(w.rows.sums, w.average)
        runs = []
        for row in w.rows.of_sums:
            runs.append({"average": Fraction(row.number), "first": Fraction(row.first) if row.seen else None})
        return {"averages": sums, "runs": runs, "all_y": rows_of(w.whole, w.model.p)}

    def _with(self, z):
        """Return a certificate of another witness."""
        other = copy(self)
        object.__setattr__(other, "z", z)
        return other

    def _witness_dict(self, z):
        flat = lambda rows: [x for row in rows for x in row]
        w, other = self.window, self._with(z)
        gains = {"gains": w.gains(z)} if w.gains(z) else {}
        return gains | {
            "state": other.state,
            "disturbances": self._every_sample(flat(other.disturbances), [lo for lo, _ in w.disturbance]),
            "unknown_inputs": self._every_sample(flat(other.unknown_inputs), [Fraction(0)] * w.model.d),
            "inputs": self._every_sample(flat(other.inputs), w.model.offset["u"]),
            "outputs": other.outputs,
        }

    def _every_sample(self, values, last):
        """Return flat values as s + 1 rows; the last sample's, where the window does not depend on them, are
        `last`.
        """
        rows = rows_of(values, len(last)) if last else ((),) * (self.window.horizon + 1)
        return (*rows, tuple(last)) if len(rows) == self.window.horizon else rows


def rows_of(values: Sequence, width: int) -> tuple[tuple, ...]:
    """Return flat values as rows of that width."""
    return tuple(tuple(values[j : j + width]) for j in range(0, len(values), width)) if width else ()


def all_numbers(tree: Any) -> Iterator[Fraction]:
    if isinstance(tree, Fraction):
        yield tree
    elif isinstance(tree, (dict, list, tuple)):
        for branch in tree.values() if isinstance(tree, dict) else tree:
            yield from all_numbers(branch)


def texts(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {k: texts(v) for k, v in tree.items()}
    if isinstance(tree, (list, tuple)):
        return [texts(v) for v in tree]
    return _text(tree) if isinstance(tree, Fraction) else tree


def _text(x):
    """Return an exact number as text that Fraction reads: a decimal where a short one is exact, else
    "p/q".
    """
    with localcontext() as context:
        context.prec = 60
        short = Decimal(x.numerator) / Decimal(x.denominator)
    return str(short) if Fraction(short) == x else str(x)
