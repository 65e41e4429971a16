"""The certificate of one verdict on a user's own residual: the unknowns that explain a window, or that a
bisection left none.

It is no proof that fractions alone can check: that needs the function, which is a program. It says what to
check.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from jaxbound.certificates.interface import WindowCertificate, certify
from jaxbound.certificates.witness import texts
from jaxbound.consistency.bisection import BUDGET, search
from jaxbound.relations.residual import Residual
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.objects import readable

__all__ = ["ResidualCertificate"]

PROGRAM = "a residual is a program of its user, no system of inequalities: no other checker can read it"


@readable
@dataclass(frozen=True, eq=False)
class ResidualCertificate(WindowCertificate):
    """Why a window of a residual has its verdict.

    Fields: status; at; relations: the Residual; u, y: the samples; witness: Interval (n,) that is proved to
    hold values of the unknowns that explain the window, or None; evaluated: boxes it took. errors,
    candidates: empty, no sensor is known to be wrong.
    """

    status: Status
    at: tuple
    relations: Residual
    u: np.ndarray
    y: np.ndarray
    witness: Interval | None
    evaluated: int

    @property
    def proves(self) -> Status:
        """What the bisection proved."""
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
        end = "no value of the unknowns explains it" if self.status == Status.FAULT else "no answer"
        return f"{end} after {self.evaluated} boxes"

    def to_dict(self, times: Sequence[str] | None = None, sample: Any = None, errors: bool = True) -> dict:
        """Return the samples, the box of the unknowns and, if there is one, the box within it that holds an
        explanation.
        """
        exact = lambda x: [Fraction(float(v)) for v in np.asarray(x)]
        box = lambda b: {"lo": exact(b.lo), "hi": exact(b.hi)}
        numbers = {
            "u": list(map(exact, self.u)),
            "y": list(map(exact, self.y)),
            "box": box(self.relations.box),
            "witness": None if self.witness is None else box(self.witness),
            "evaluated": Fraction(self.evaluated),
        }
        model = self.relations.model
        names = {
            "model": model.name,
            "inputs": model.inputs,
            "outputs": model.outputs,
            "relation": self.relation,
            "sample": list(self.at) if sample is None else sample,
            "times": None if times is None else list(times),
        }
        return {
            "certificate": self.proves.name,
            "statement": str(self),
            "status": self.status.name,
            "names": names,
            "numbers": texts(numbers),
        }

    def to_vipr(self) -> str:
        """Raise NotImplementedError: the residual is a program."""
        raise NotImplementedError(PROGRAM)

    def to_smt2(self) -> str:
        """Raise NotImplementedError: the residual is a program."""
        raise NotImplementedError(PROGRAM)


@certify.register
def _(relations: Residual, u, y, method="joint", status=None, at=None):
    at = (relations.horizon,) if at is None else at
    if not (np.isfinite(u).all() and np.isfinite(y).all()):
        raise ValueError(f"window {at[-1]} is MISSING: there is nothing to explain")
    found = search(relations, u[None], y[None], 100 * BUDGET)
    assert found.status is not None
    status = Status(int(found.status[0])) if status is None else status
    witness = found.witness[0] if status == Status.CONSISTENT and found.witness is not None else None
    return ResidualCertificate(status, at, relations, u, y, witness, int(found.evaluated[0]))
