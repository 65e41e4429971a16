"""The certificate of one verdict, in exact rational arithmetic: the violated relation, or a behaviour that
explains the window.

No float takes part in what a certificate states: samples and bounds are taken as the rationals they are, and
a verdict is proved again from scratch (`exact_window`), by whichever route it was found. As JSON a
certificate is complete in itself: whoever checks it needs fractions, but neither jaxbound nor the recording.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

from jaxbound.certificates.blame import SensorError, rounded_witness, smallest_error
from jaxbound.certificates.constant_window import ConstantWindow
from jaxbound.certificates.exact_window import ExactWindow, Explanation, exact_window
from jaxbound.certificates.interface import WindowCertificate, certify
from jaxbound.certificates.witness import Witnessed, rows_of
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.redundancy import Redundancy
from jaxbound.relations.sentence import main_terms, relation_text
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable

__all__ = ["Certificate"]


@readable
@dataclass(frozen=True, eq=False)
class Certificate(Witnessed, WindowCertificate):
    """Why a window has its verdict; every number is an exact Fraction, so that anybody can check it.

    Fields:
        status: of the window, as detected. at: the index at which it ends, a tuple.
        relation: the tightest relation of the window, as text.
        h, k: its coefficients on the (s+1)p true outputs (time-major) followed by the gs disturbances, and on
            the inputs: h (Y, w) = k U for an exact plant.
        residual, width: the value of the relation at the middles of the intervals of samples and
            disturbances, and the largest that the bounds allow; a FAULT, because |residual| > width.
        factor: |residual| / width, the factor on all bounds at which the window just becomes consistent (for
            method "box": that relation).
        state: where the window can be explained, the first state of a behaviour that does (the witness), in
            deviations; else None.
        outputs, disturbances, unknown_inputs, inputs: that behaviour's true outputs (s+1, p), disturbances
            (s, g), unknown inputs (s or s+1, d) and inputs in the unit of the recording, the missing ones
            filled in; else None.
        window: the samples and bounds. explanation: what they come to.
    """

    status: Status
    at: tuple
    relation: str
    h: tuple
    k: tuple
    residual: Fraction
    width: Fraction
    factor: Fraction
    window: ExactWindow
    explanation: Explanation
    z: tuple | None

    @property
    def proves(self) -> Status:
        """FAULT or CONSISTENT: what the exact numbers say, also where the method of the detection left it
        UNDECIDED.
        """
        return Status.FAULT if self.explanation.factor > 1 else Status.CONSISTENT

    @cached_property
    def sensor_errors(self) -> tuple[SensorError, ...]:
        """A SensorError for each output: the smallest error of that sensor alone that would explain the
        window.
        """
        outputs = range(0 if self.window.constant else self.window.model.p)
        return tuple(smallest_error(self.window, i, self.explanation) for i in outputs)

    @property
    def errors(self) -> Mapping[str, Any]:
        """{output: the smallest error of that sensor alone that would explain the window}, in its unit.

        inf where no error of it would, 0 for a window that needs none; empty for a model with
        constant_tolerance. Worked out at the first call.
        """
        return {
            self.window.model.outputs[e.output]: math.inf if e.size is None else e.size
            for e in self.sensor_errors
        }

    @cached_property
    def candidates(self) -> tuple[str, ...]:
        """The signals that alone could explain a FAULT window: outputs, the smallest error relative to what
        its bounds allow first, then inputs, if the actuator did something else than was recorded. Of any
        other it is proved that it cannot.
        """
        if self.proves != Status.FAULT or self.window.constant:
            return ()
        p, limits = self.window.model.p, self.window.limits
        size = lambda i: max(x[1] - x[0] for x in limits[i : len(self.window.y) : p] if x is not None)
        found = [
            (e.size / size(e.output), self.window.model.outputs[e.output])
            for e in self.sensor_errors
            if e.size
        ]
        inputs = [i for i in range(self.window.model.m) if self.window.without_input(i).solve().factor <= 1]
        return (*(name for _, name in sorted(found)), *(self.window.model.inputs[i] for i in inputs))

    def __str__(self) -> str:
        """Return one sentence."""
        if self.proves == Status.FAULT:
            relation = main_terms(self.relation)
            if self.window.constant:
                return (
                    f"{relation} cannot hold for any gains: it is off by {float(self.factor):.4g} times "
                    f"what bounds allow"
                )
            return f"{relation} cannot hold: it would need bounds {float(self.factor):.4g} times as wide"
        return f"explained by the first state ({', '.join(f'{float(x):.6g}' for x in self.state or ())})"

    def to_dict(self, times: Sequence[str] | None = None, sample: Any = None, errors: bool = True) -> dict:
        """Return everything that a check needs, ready for JSON: numbers as exact text ("0.1", "1/3"), names
        apart from them.

        Args:
            times: text of the time of each of the s + 1 samples; None leaves them out. sample: what to call
                the last one; None: `at`.
            errors: False leaves out the smallest single-sensor errors of a FAULT, which take most of the
                time.
        """
        fault = self.proves == Status.FAULT
        numbers = {
            "relation": self._relation_dict(self.h) if any(self.h) else None,
            "errors": [
                {
                    "output": Fraction(e.output),
                    "smallest": e.size,
                    "relation": self._relation_dict(e.h, e.output, e.size or Fraction(0)),
                    "enough": e.enough,
                    "witness": None if e.z is None else self._witness_dict(e.z),
                }
                for e in self.sensor_errors
            ]
            if fault and errors
            else [],
        }
        constant = {"constant": Fraction(1)} if self.window.constant else {}
        return self._document(self.proves, constant | numbers, times, sample)

    def _relation_dict(self, h, output=0, error=None):
        w, model = self.window, self.window.model
        k, residual, width = (w if error is None else w.with_error(output, error)).relation(h)
        readings, single = w.rows.readings, w.rows.single
        none = [Fraction(0)] * max(model.g, model.m)
        of_sums = {"a": tuple(h[single:])} if w.rows.of_sums else {}
        return of_sums | {
            "h": rows_of(h[:readings], model.p),
            "g": self._every_sample(h[readings:single], none[: model.g]),
            "k": self._every_sample(k, none[: model.m]),
            "residual": residual,
            "width": width,
            "factor": abs(residual) / width,
        }


@certify.register
def _(relations: ParityRelation, u, y, method="joint", status=None, at=None):
    at = (relations.horizon,) if at is None else at
    window = exact_window(relations, u, y)
    if window.constant:
        window = ConstantWindow(
            **{field.name: getattr(window, field.name) for field in dataclasses.fields(window)}
        )
    nothing = ValueError(f"window {at[-1]} is MISSING: there is nothing to explain")
    if all(v is None for v in window.y):
        raise nothing
    found = window.solve()
    alone = (
        [(x, *window.relation(x)) for x in relations.W if _has_its_data(window, x)] if method == "box" else []
    )
    if not any(found.h) or (method == "box" and not alone):
        raise nothing
    h, k, residual, width = found.h, found.k, found.residual, found.width
    if method == "box":
        worst = max(alone, key=lambda c: abs(c[2]) / c[3])
        if violated := abs(worst[2]) > worst[3]:
            h, k, residual, width = worst
        if status is None:
            status = (
                Status.FAULT if violated else Status.CONSISTENT if relations.count == 1 else Status.UNDECIDED
            )
    proved = Status.FAULT if found.factor > 1 else Status.CONSISTENT
    if status not in (None, Status.UNDECIDED, proved):
        why = "more than its samples and bounds"
        raise NotImplementedError(
            f"the verdict of window {at[-1]} rests on {why}: certificates of such verdicts are not "
            f"implemented yet"
        )
    z = rounded_witness(window, found.z) if found.factor <= 1 else None
    text = relation_text(window.model, window.horizon, h, k)
    return Certificate(
        proved if status is None else status,
        at,
        text,
        h,
        k,
        residual,
        width,
        abs(residual) / width,
        window,
        found,
        z,
    )


@certify.register
def _(relations: Redundancy, u, y, method="box", status=None, at=None):
    return certify(relations.relations, u, y, "box", status, at)


def _has_its_data(window, h):
    if any(x and v is None for x, v in zip(h[: len(window.y)], window.y, strict=True)):
        return False
    return not any(x and v is None for x, v in zip(window.action(h), window.u, strict=True))
