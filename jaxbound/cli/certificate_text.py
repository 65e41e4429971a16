"""A certificate as a reader wants it: a headline, named rows, and a table of the samples."""

from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import chain
from typing import Any, TypeAlias

from jaxbound.certificates.certificate import Certificate
from jaxbound.certificates.uncertain_certificate import UncertainCertificate
from jaxbound.models.rows import Kind
from jaxbound.relations.sentence import at_sample, row_name
from jaxbound.sets.floats.status import Status
from jaxbound.text.quantities import percent, times

Row: TypeAlias = tuple[str, str]
AnyCertificate: TypeAlias = Certificate | UncertainCertificate
EXPLAINS = "a certificate that explains its window has all unknowns"
OUTGROWN = "found from data for shorter windows: a FAULT may be no more than an error that lasts longer"
SMALLEST = 1e-300  # the smallest normal number, which widens every radius, is nothing to a reader


def certificate_text(
    certificate: AnyCertificate, k: int, labels: Sequence[str], outgrown: bool = False
) -> tuple[str, list[Row], list[tuple[str, ...]]]:
    """Return (headline, rows of (name, text), table with its header first) of a certificate, for people.

    Args:
        certificate: of a window. k: its last sample. labels: the times of its samples.
        outgrown: its bounds were found from data for shorter windows, so that a FAULT proves no fault.
    """
    if isinstance(certificate, UncertainCertificate):
        rows = list(_uncertain_rows(certificate))
    elif certificate.proves == Status.FAULT:
        rows = list(_fault_rows(certificate))
    else:
        rows = list(_consistent_rows(certificate))
    if outgrown:
        rows.append(("bounds", OUTGROWN))
    return _headline(certificate, k, labels, outgrown), rows, _sample_table(certificate, labels)


def _headline(certificate: AnyCertificate, k: int, labels: Sequence[str], outgrown: bool) -> str:
    verdict = f"{certificate.proves.name} proved"
    if outgrown and certificate.proves == Status.FAULT:
        verdict = "FAULT outside the bounds as fitted"
    status = ""
    if certificate.status != certificate.proves:
        status = f" ({certificate.status.name} for the method of the report)"
    return f"{verdict}: the window from {labels[0]} to {labels[-1]}, sample {k}{status}"


def _fault_rows(certificate: Certificate) -> Iterator[Row]:
    """Yield the relation that is violated, and the sensors and actuators that alone would explain it."""
    at_least = "at least " if certificate.window.constant else ""
    residual, width = six_digits(certificate.residual), six_digits(certificate.width)
    yield "violated", certificate.relation
    yield "", f"is {residual} at the samples, and the bounds allow ± {width}"
    yield "bounds needed", f"{at_least}{times(float(certificate.factor))} the stated ones"
    errors, candidates = certificate.errors, certificate.candidates
    for name in candidates:  # the least error beside its bounds first
        if name in errors:
            yield f"{name} wrong?", _error_text(certificate, name, errors[name])
    actuators = [name for name in candidates if name not in errors]
    if actuators:
        text = "an actuator that did something else than was recorded, at any sample, would alone explain it"
        yield f"{', '.join(actuators)} wrong?", text
    others = [name for name in errors if name not in candidates]
    if others:
        yield f"{', '.join(others)} wrong?", "no error of this sensor alone explains the window"


def _error_text(certificate: Certificate, name: str, error: Fraction | float) -> str:
    """Return how large an error of one sensor is at least that explains the window."""
    size = six_digits(error) + _unit(certificate, name)
    return (
        f"errors of up to {size} of this sensor alone, another at each sample, would explain the window, no "
        f"smaller ones; a constant one takes more"
    )


def _consistent_rows(certificate: Certificate) -> Iterator[Row]:
    """Yield the relation that comes nearest to its bounds, and the unknowns that explain the window."""
    model = certificate.window.model
    yield "tightest", certificate.relation
    yield "", f"{percent(float(certificate.factor))} of the bounds are used"
    yield "first state", _state_text(certificate)
    if model.g:
        assert certificate.disturbances is not None, EXPLAINS
        yield "disturbance", _vectors_text(certificate.disturbances)
    if model.d:
        assert certificate.unknown_inputs is not None, EXPLAINS
        yield "unknown input", _vectors_text(certificate.unknown_inputs)


def _uncertain_rows(certificate: UncertainCertificate) -> Iterator[Row]:
    """Yield the rows of a certificate of a model with uncertain parameters."""
    if certificate.z is None:
        parts = (
            f"a combination of relations in each of {len(certificate.leaves)} parts of the parameters' box"
        )
        yield "violated", certificate.relation or parts
        if len(certificate.leaves) == 1:
            (leaf,) = certificate.leaves
            low, high = six_digits(leaf["low"]), six_digits(leaf["high"])
            yield "", f"is in [{low}, {high}] at these samples, whatever the parameters"
        return
    parameters = []
    assert certificate.parameters is not None, EXPLAINS
    for (name, lag), value in certificate.parameters.items():
        parameters.append(f"{at_sample(name, lag, certificate.relations.horizon)} {six_digits(value)}")
    yield "parameters", ", ".join(parameters)
    yield "first state", _state_text(certificate)


def _state_text(certificate: AnyCertificate) -> str:
    assert certificate.state is not None, EXPLAINS
    states = zip(certificate.window.model.states, certificate.state, strict=True)
    return ", ".join(f"{name} {six_digits(x)}{_unit(certificate, name)}" for name, x in states)


def _vectors_text(vectors: Iterable[Iterable[Fraction]]) -> str:
    return "; ".join(", ".join(map(six_digits, vector)) for vector in vectors)


def _unit(certificate: AnyCertificate, name: str) -> str:
    unit = certificate.window.model.unit(name)
    return f" {unit}" if unit else ""


def _sample_table(certificate: AnyCertificate, labels: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the table of the samples: readings, limits of the true values, and parts in the proof."""
    window, model = certificate.window, certificate.window.model
    title, outputs, inputs = _parts(certificate)
    rows: list[tuple[str, ...]] = [("time", "signal", "reading", "true value from", "to", title)]
    for j, label in enumerate(labels):
        for i, name in enumerate(model.outputs):
            row = j * model.p + i
            if outputs[row] is not None:
                limits = _limits_text(window.limits[row], model.offset["y"][i])
                rows.append((label, name, _reading(window.y[row]), *limits, outputs[row] or ""))
        for i, name in enumerate(model.inputs):
            row = j * model.m + i
            if row < len(window.u) and inputs[row] is not None:
                rows.append((label, name, _reading(window.u[row]), "", "", inputs[row] or ""))
    if isinstance(certificate, Certificate) and certificate.z is None:
        rows += _disturbance_rows(certificate, labels)
    if title:
        return rows
    return [row[:-1] for row in rows]


def _parts(certificate: AnyCertificate) -> tuple[str, Sequence[str | None], Sequence[str | None]]:
    """Return the last column of the table: its title, and a text for each output and each input of each
    sample; None for a row that is left out.
    """
    window = certificate.window
    if certificate.z is not None:
        outputs, inputs = certificate.outputs, certificate.inputs
        assert outputs is not None and inputs is not None, EXPLAINS
        of_outputs = list(map(six_digits, chain.from_iterable(outputs)))
        return "explained by", of_outputs, list(map(six_digits, chain.from_iterable(inputs)))
    if isinstance(certificate, UncertainCertificate):
        return "", [""] * len(window.y), [None] * len(window.u)
    coefficients = list(map(_coefficient, certificate.h))
    for row, reading in enumerate(window.y):
        if reading is None:
            coefficients[row] = ""
    return "coefficient", coefficients, [_coefficient(-x) for x in certificate.k]


def _coefficient(x: Fraction) -> str | None:
    """Return a coefficient, None where it is 0."""
    if not x:
        return None
    return six_digits(x)


def _disturbance_rows(certificate: Certificate, labels: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield the disturbances and averages that have a part in the violated relation: they stand behind the
    outputs.
    """
    window = certificate.window
    for coefficient, row, limits in zip(certificate.h, window.rows, window.limits, strict=True):
        if coefficient and row.kind is not Kind.READING:
            when, name = labels[row.last], row_name(window.model, row)
            yield when, name, "", *_limits_text(limits), six_digits(coefficient)


def _reading(value: Fraction | None) -> str:
    if value is None:
        return "missing"
    return six_digits(value)


def _limits_text(limits: tuple[Fraction, Fraction] | None, offset: Fraction | int = 0) -> tuple[str, str]:
    """Return the two ends of the limits of a true value, in the units of its signal."""
    if limits is None:
        return "", ""
    low, high = limits
    return six_digits(low + offset), six_digits(high + offset)


def six_digits(x: Any) -> str:
    """Return an exact number as a reader wants it, with six digits."""
    return f"{float(x) if abs(x) > SMALLEST else 0.0:.6g}"
