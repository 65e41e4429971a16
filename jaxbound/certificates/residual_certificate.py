"""The certificate of one verdict on a user's own residual: the unknowns that explain a window, or that a
bisection left none.

It is no proof that fractions alone can check: that needs the function, which is a program.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from jaxbound.certificates.interface import (
    Index,
    Sample,
    WindowCertificate,
    certificate_of,
    nothing_to_explain,
)
from jaxbound.certificates.plain import exact_floats
from jaxbound.certificates.witness import Numbers, texts
from jaxbound.consistency.bisection import BUDGET, search_unknowns
from jaxbound.relations.residual import Residual
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.objects import readable

PROGRAM = "a residual is a program of its user, no system of inequalities: no other checker can read it"


@readable
@dataclass(frozen=True, eq=False)
class ResidualCertificate(WindowCertificate):
    """The bisection that decided a window of a residual.

    Fields: status; at; relations: the Residual; u, y: the samples; witness: Interval (n,) that is proved to
    hold values of the unknowns that explain the window, or None; evaluated: boxes it took. errors,
    candidates: empty, no sensor is known to be wrong.
    """

    status: Status
    at: Index
    relations: Residual
    u: np.ndarray
    y: np.ndarray
    witness: Interval | None
    evaluated: int

    @property
    def proves(self) -> Status:
        """The verdict that the bisection proved."""
        return self.status

    @property
    def relation(self) -> str:
        """The equation, as text."""
        return self.relations.text()

    def __str__(self) -> str:
        """Return one sentence."""
        if self.witness is not None:
            at = ", ".join(f"{float(v):.6g}" for v in np.asarray(self.witness.mid))
            return f"explained by the unknowns ({at})"
        end = "no answer"
        if self.status == Status.FAULT:
            end = "no value of the unknowns explains it"
        return f"{end} after {self.evaluated} boxes"

    def to_dict(
        self, times: Sequence[str] | None = None, sample: Sample = None, errors: bool = True
    ) -> dict[str, Any]:
        """Return the samples, the box of the unknowns and, if there is one, the box within it that holds an
        explanation.
        """
        numbers: Numbers = {
            "u": list(map(exact_floats, self.u)),
            "y": list(map(exact_floats, self.y)),
            "box": _exact_box(self.relations.box),
            "witness": None,
            "evaluated": Fraction(self.evaluated),
        }
        if self.witness is not None:
            numbers["witness"] = _exact_box(self.witness)
        model = self.relations.model
        names: dict[str, Any] = {"model": model.name, "inputs": model.inputs, "outputs": model.outputs}
        names |= {"relation": self.relation, "sample": sample, "times": None}
        if sample is None:
            names["sample"] = list(self.at)
        if times is not None:
            names["times"] = list(times)
        return {
            "certificate": self.proves.name,
            "statement": str(self),
            "status": self.status.name,
            "names": names,
            "numbers": texts(numbers, []),
        }

    def to_vipr(self) -> str:
        """Raise NotImplementedError: the residual is a program."""
        raise NotImplementedError(PROGRAM)

    def to_smt2(self) -> str:
        """Raise NotImplementedError: the residual is a program."""
        raise NotImplementedError(PROGRAM)


def _exact_box(box: Interval) -> Numbers:
    return {"lo": exact_floats(np.asarray(box.lo)), "hi": exact_floats(np.asarray(box.hi))}


@certificate_of.register
def _(
    relations: Residual, u: np.ndarray, y: np.ndarray, status: Status | None, at: Index
) -> ResidualCertificate:
    if not (np.isfinite(u).all() and np.isfinite(y).all()):
        raise nothing_to_explain(at)
    # more boxes than detect took: one window is asked, and waited for
    paved = search_unknowns(relations, u[None], y[None], 100 * BUDGET)
    assert paved.status is not None
    if status is None:
        status = Status(int(paved.status[0]))
    witness = None
    if status == Status.CONSISTENT and paved.witness is not None:
        witness = paved.witness[0]
    return ResidualCertificate(status, at, relations, u, y, witness, int(paved.evaluated[0]))
