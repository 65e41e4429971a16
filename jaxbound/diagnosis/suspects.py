"""The suspects of an alarm: the signals that alone could be wrong in a FAULT window, and the jump that the
window shows of the first of them.

Which signals these are, and the smallest error of each, is proved by the certificate. The sign of a jump is
read off the relation h that proves the smallest error of a sensor: a step of it from sample t on moves the
residual by the sum of h from t on, and the step that moves it most in the direction in which it is off is the
one that is named. That is no proof; it speaks for a repair, and changes no verdict.
"""

import math
from collections.abc import Sequence
from fractions import Fraction
from itertools import accumulate
from typing import Any, NamedTuple, cast

import numpy as np

from jaxbound.certificates.certificate import Certificate
from jaxbound.certificates.interface import WindowCertificate, certify
from jaxbound.consistency.interface import Relations
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.signals import SignalModel
from jaxbound.sets.floats.status import Status

READINGS = 64  # in a window, from which on exact errors of single sensors take too long: 122 take a minute
ALIKE = 2  # jumps are about as large if neither error is more than so many times the other


class Suspect(NamedTuple):
    """Fields: names: of the signals that alone could be wrong, the most plausible first; empty: none alone,
    or not known. size: the smallest error of the first that explains the window, in its unit, NaN where it is
    no sensor. jump: 1 up, -1 down, 0 not known. cause: the most plausible of the faults that the model names
    and the sizes of it that explain the window, in words; "" where the model names none.
    """

    names: tuple[str, ...] = ()
    size: float = math.nan
    jump: int = 0
    cause: str = ""

    @classmethod
    def of(cls, memory: Sequence[Any]) -> "Suspect":
        """Return the suspects that a memory, as JSON holds it, has."""
        names, *others = memory
        return cls(tuple(names), *others)

    @property
    def first(self) -> str:
        """The most plausible signal, "" where there is none."""
        return (*self.names, "")[0]

    def ends(self, other: "Suspect") -> bool:
        """Whether this is the opposite jump of the same signal, about as large."""
        if not self.names or self.first != other.first or self.jump * other.jump != -1:
            return False
        small, large = sorted((self.size, other.size))
        return bool(large <= ALIKE * small)


UNKNOWN = Suspect()


def nameless(relations: Relations) -> str:
    """Return why windows of these relations do not tell which sensor alone could be wrong; "": they do, of a
    monitor those of one test at least.
    """
    if relations.parts:
        whys = {name: nameless(test) for name, test in relations.parts.items()}
        if not all(whys.values()):
            return ""
        name, why = next(iter(whys.items()))
        return f"no test of this monitor tells them, {name!r}: {why}"
    if relations.remembers:
        return (
            "an observer's verdicts rest on more than one window, and `explain` names the candidates of one "
            "FAULT where a short window proves it"
        )
    if relations.linear is None:
        return f"{type(relations).__name__} has no smallest errors of single sensors"
    model = relations.linear.model
    if model.constant_tolerance:
        return "constant_tolerance leaves no smallest errors of single sensors"
    looks = relations.horizon + 1
    if relations.lags is not None:
        looks = len(relations.lags)
    if looks * model.p > READINGS:
        return f"a window has {looks * model.p} readings: the exact errors of more than {READINGS} take long"
    return ""


def suspect_of_window(
    relations: Relations, u: np.ndarray, y: np.ndarray, first: str | None = None
) -> Suspect:
    """Return the suspects of the FAULT window that samples u (s+1, m), y (s+1, p) are. first: comes first if
    it is one of them, and the cause is asked for, which takes longest; None: it is not.
    """
    try:
        certificate = certify(relations, u, y, status=Status.FAULT)
    except NotImplementedError:  # no proof by one relation
        return UNKNOWN
    names, cause = certificate.candidates, ""
    if first is not None:
        names, cause = tuple(sorted(names, key=first.__ne__)), _cause(certificate)
    if not names:
        return UNKNOWN._replace(cause=cause)
    errors = certificate.errors
    if names[0] not in errors:  # an actuator
        return Suspect(names, cause=cause)
    # it states errors of sensors
    jump = _jump(cast(Certificate, certificate).judged, list(errors).index(names[0]))
    return Suspect(names, float(errors[names[0]]), jump, cause)


def tells_causes(model: SignalModel) -> bool:
    """Whether a model names the faults that may be the cause of an alarm."""
    return isinstance(model, LinearSystem) and bool(model.faults)


def _cause(certificate: WindowCertificate) -> str:
    """Return the cause in words, see `Suspect`."""
    if not tells_causes(cast(Certificate, certificate).window.model):
        return ""
    return certificate.diagnose().first


def _jump(certificate: Certificate, i: int) -> int:
    """Return the sign of the step of output i that the relation which proves its smallest error sees best."""
    error, window = certificate.sensor_errors[i], certificate.window
    _, residual, _ = window.relation(error.h)
    own = error.h[i : len(window.y) : window.model.p]
    behind: list[Fraction] = list(accumulate(reversed(own)))
    largest = max(behind, key=abs)
    moved = largest * residual
    return int(moved > 0) - int(moved < 0)
