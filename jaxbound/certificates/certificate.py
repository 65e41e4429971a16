"""The certificate of one verdict, in exact rational arithmetic: the violated relation, or a behaviour that
explains the window.

No float takes part in what a certificate states: samples and bounds are taken as the rationals they are, and
a verdict is proved again from scratch (`exact_window`), by whichever route it was found. As JSON a
certificate is complete in itself: whoever checks it needs fractions, but neither jaxbound nor the recording.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, cast

import numpy as np

from jaxbound.certificates.diagnosis import Diagnosis, diagnose_window
from jaxbound.certificates.exact_window import ExactWindow, Stretch, exact_window, rounded_witness
from jaxbound.certificates.fault_size import Scale, SensorError
from jaxbound.certificates.interface import (
    Index,
    Sample,
    WindowCertificate,
    certificate_of,
    certify,
    nothing_to_explain,
)
from jaxbound.certificates.witness import Numbers, Witnessed, every_sample, in_rows
from jaxbound.exact.linalg import Vector
from jaxbound.models.named_faults import NamedFault
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.redundancy import Redundancy
from jaxbound.relations.sentence import main_terms, relation_text
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable
from jaxbound.text.progress import Progress, reporter


class Sizes(dict[str, "Fraction | float"]):
    """{signal: a size}, exact, shown as short floats: a fraction has hundreds of digits."""

    def __repr__(self) -> str:
        shown = [f"{name!r}: {float(size):.4g}" for name, size in self.items()]
        return f"{{{', '.join(shown)}}}"


@readable
@dataclass(frozen=True, eq=False)
class Certificate(Witnessed):
    """A proof of the verdict of a window; every number is an exact Fraction, so that anybody can check it.

    Fields:
        status: of the window, as detected. at: the index at which it ends, a tuple.
        relation: the tightest relation of the window, as text.
        h, k: its coefficients on the (s+1)p true outputs (time-major) followed by the gs disturbances, and on
            the inputs: h (Y, w) = k U for an exact plant.
        residual, width: the value of the relation at the middles of the intervals of samples and
            disturbances, and the largest that the bounds allow; a FAULT, because |residual| > width.
        factor: |residual| / width, the factor on all bounds at which the window just becomes consistent.
        state: where the window can be explained, the first state of a behaviour that does (the witness), in
            deviations; else None.
        outputs, disturbances, unknown_inputs, inputs: that behaviour's true outputs (s+1, p), disturbances
            (s, g), unknown inputs (s or s+1, d) and inputs in the unit of the recording, the missing ones
            filled in; else None.
        window: the samples and bounds.
    """

    status: Status
    at: Index
    relation: str
    h: Vector
    k: Vector
    residual: Fraction
    width: Fraction
    factor: Fraction
    window: ExactWindow
    z: Vector | None

    @property
    def proves(self) -> Status:
        """FAULT or CONSISTENT: what the exact numbers say, also where the method of the detection left it
        UNDECIDED.
        """
        return _verdict_of(self.factor)

    @cached_property
    def _scale(self) -> Scale:
        """The relations that faults and errors of sensors violate, collected once for all of them."""
        return Scale(self.window, self.h)

    @cached_property
    def judged(self) -> "Certificate":
        """The certificate under the bounds by which the window was judged: wider ones outside of training,
        which errors and faults explain that those stated exclude.
        """
        if self.beyond is None:
            return self
        return cast(Certificate, self.beyond())

    @property
    def sensor_errors(self) -> tuple[SensorError, ...]:
        """A SensorError for each output: the smallest error of that sensor alone that would explain the
        window.
        """
        if self.window.unweighed:
            return ()
        return tuple(map(self._scale.error, range(self.window.model.p)))

    @property
    def errors(self) -> Mapping[str, Fraction | float]:
        """{output: the smallest error of that sensor alone that would explain the window}, in its unit.

        inf where no error of it would, 0 for a window that needs none; empty for a model with
        constant_tolerance. Worked out at the first call.
        """
        sizes = Sizes()
        for error in self.judged.sensor_errors:
            output = self.window.model.outputs[error.output]
            sizes[output] = math.inf
            if error.size is not None:
                sizes[output] = error.size
        return sizes

    @property
    def candidates(self) -> tuple[str, ...]:
        """The signals that alone could explain a FAULT window: outputs, the smallest error relative to what
        its bounds allow first, then inputs, if the actuator did something else than was recorded. Of any
        other it is proved that it cannot.
        """
        if self.proves != Status.FAULT or self.window.unweighed:
            return ()
        inputs = enumerate(self.window.model.inputs)
        scale = self.judged._scale
        return *self.sensor_candidates, *(name for i, name in inputs if scale.explained_without(i))

    def work_out(self, progress: Progress | None = None) -> None:
        """Work out .errors and .candidates: see `WindowCertificate.work_out`."""
        if self.proves != Status.FAULT or self.window.unweighed:
            return
        report = reporter(progress, "errors and candidates")
        model, scale = self.window.model, self.judged._scale
        for i in range(model.p):
            scale.error(i)
            report((i + 1) / (model.p + model.m))
        for i in range(model.m):
            scale.explained_without(i)
            report((model.p + i + 1) / (model.p + model.m))

    @property
    def sensor_candidates(self) -> tuple[str, ...]:
        """The outputs among the candidates: without the exact program of each input."""
        if self.proves != Status.FAULT or self.window.unweighed:
            return ()
        shares, judged = [], self.judged
        for error in judged.sensor_errors:
            # None: no error of this sensor alone would do
            if error.size:
                name = self.window.model.outputs[error.output]
                shares.append((error.size / judged._widest(error.output), name))
        return tuple(name for _, name in sorted(shares))

    def diagnose(self, faults: Sequence[NamedFault] | None = None) -> Diagnosis:
        """Return the Diagnosis of a FAULT window: see `WindowCertificate.diagnose`."""
        if self.proves != Status.FAULT:
            raise ValueError(
                f"window {self.at[-1]} is explained without a fault: there is nothing to diagnose"
            )
        if self.window.unweighed:
            raise NotImplementedError(self.window.unweighed)
        return diagnose_window(self.judged._scale, self.at[-1], faults)

    def _widest(self, i: int) -> Fraction:
        """Return the largest width that bounds allow a reading of output i."""
        own = self.window.limits[i : len(self.window.y) : self.window.model.p]
        return max(ends[1] - ends[0] for ends in own if ends is not None)

    def __str__(self) -> str:
        """Return one sentence."""
        if self.proves != Status.FAULT:
            return f"explained by the first state ({', '.join(f'{float(x):.6g}' for x in self.state or ())})"
        relation, factor = main_terms(self.relation), f"{float(self.factor):.4g}"
        if self.window.constant:
            return f"{relation} cannot hold for any gains: it is off by {factor} times what bounds allow"
        return f"{relation} cannot hold: it would need bounds {factor} times as wide"

    def to_dict(
        self, times: Sequence[str] | None = None, sample: Sample = None, errors: bool = True
    ) -> dict[str, Any]:
        """Return everything that a check needs, ready for JSON: numbers as exact text ("0.1", "1/3"), names
        apart from them.

        Args:
            times: text of the time of each of the s + 1 samples; None leaves them out. sample: what to call
                the last one; None: `at`.
            errors: False leaves out the smallest single-sensor errors of a FAULT, which take most of the
                time.
        """
        numbers: Numbers = {"relation": None}
        if any(self.h):
            numbers["relation"] = self._relation_dict(self.h, self.window)
        numbers["errors"] = []
        if errors and self.proves == Status.FAULT:
            numbers["errors"] = list(map(self._error_dict, self.sensor_errors))
        return self._document(self.proves, numbers, times, sample)

    def _error_dict(self, error: SensorError) -> Numbers:
        """Return the numbers of a sensor's error, its relation in the window with that error."""
        # the relation of a smallest error has factor 1 in the window with that error only
        window = error.window or self.window
        witness = None
        if error.z is not None:
            witness = self._witness_dict(error.z)
        return {
            "output": Fraction(error.output),
            "smallest": error.size,
            "relation": self._relation_dict(error.h, window),
            "enough": error.enough,
            "witness": witness,
        }

    def _relation_dict(self, h: Vector, window: ExactWindow) -> Numbers:
        """Return the numbers of a relation of a window, a row for each sample."""
        rows, model = window.rows, window.model
        k, residual, width = window.relation(h)
        numbers: Numbers = {}
        # multipliers of sums stand apart: the checker writes the sums out, to see that no unknown is left
        if rows.of_sums:
            numbers["a"] = h[rows.single :]
        if window.first is not None:
            numbers["x"] = window.of_first(h)
        numbers["h"] = in_rows(h[: rows.readings], model.p)
        numbers["g"] = every_sample(window.horizon, h[rows.readings : rows.single], [Fraction(0)] * model.g)
        numbers["k"] = every_sample(window.horizon, k, [Fraction(0)] * model.m)
        numbers |= {"residual": residual, "width": width, "factor": abs(residual) / width}
        return numbers


def _verdict_of(factor: Fraction) -> Status:
    """Return the verdict of exact numbers: a window is FAULT where its bounds would have to be wider."""
    if factor > 1:
        return Status.FAULT
    return Status.CONSISTENT


@certificate_of.register(ParityRelation)
def of_window(
    relations: ParityRelation | Stretch, u: np.ndarray, y: np.ndarray, status: Status | None, at: Index
) -> Certificate:
    """Return the Certificate of a window whose rows are written out: see `certificate_of`."""
    window = exact_window(relations, u, y)
    if all(v is None for v in window.y):
        raise nothing_to_explain(at)
    best = window.solve()
    if not any(best.h):
        raise nothing_to_explain(at)
    proved = _verdict_of(best.t)
    if status not in (None, Status.UNDECIDED, proved):
        raise NotImplementedError(
            f"the verdict of window {at[-1]} rests on more than its samples and bounds: certificates of such "
            f"verdicts are not implemented yet"
        )
    if status is None:
        status = proved
    z = None
    if proved == Status.CONSISTENT:
        z = rounded_witness(window, best.z)
    k, residual, width = window.relation(best.h)
    text = relation_text(window.model, window.horizon, best.h, k)
    return Certificate(status, at, text, best.h, k, residual, width, abs(residual) / width, window, z)


@certificate_of.register
def _(
    relations: Redundancy, u: np.ndarray, y: np.ndarray, status: Status | None, at: Index
) -> WindowCertificate:
    return certify(relations.relations, u, y, status=status, at=at)
