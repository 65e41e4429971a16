"""A certificate as a reader wants it: a headline, named rows, and a table of the samples."""

import math
from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np

from jaxbound.certificates.certificate import Certificate
from jaxbound.certificates.uncertain_certificate import UncertainCertificate
from jaxbound.models.rows import Kind
from jaxbound.relations.sentence import at_sample, row_name
from jaxbound.sets.floats.status import Status
from jaxbound.text.quantities import percent, times

__all__ = ["certificate_text", "six_digits"]

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
        rows = _uncertain_rows(certificate)
    elif certificate.proves == Status.FAULT:
        rows = _fault_rows(certificate)
    else:
        rows = _consistent_rows(certificate)
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


def _fault_rows(certificate: Certificate) -> list[Row]:
    """Return the relation that is violated, and the sensors and actuators that alone would explain it."""
    at_least = "at least " if certificate.window.constant else ""
    residual, width = six_digits(certificate.residual), six_digits(certificate.width)
    rows = [
        ("violated", certificate.relation),
        ("", f"is {residual} at the samples, and the bounds allow ± {width}"),
        ("bounds needed", f"{at_least}{times(float(certificate.factor))} the stated ones"),
    ]
    for name, error in certificate.errors.items():
        rows.append((f"{name} wrong?", _error_text(certificate, name, error)))
    actuator = "an actuator that did something else than was recorded would alone explain the window"
    for name in certificate.candidates:
        if name in certificate.window.model.inputs:
            rows.append((f"{name} wrong?", actuator))
    return rows


def _error_text(certificate: Certificate, name: str, error: Fraction | float) -> str:
    """Return whether an error of one sensor explains the window, and how large it is at least."""
    if error == math.inf:
        return "no error of this sensor alone explains the window"
    size = six_digits(error) + _unit(certificate, name)
    return (
        f"errors of up to {size} of this sensor alone, another at each sample, would explain the window, no "
        f"smaller ones; a constant one takes more"
    )


def _consistent_rows(certificate: Certificate) -> list[Row]:
    """Return the relation that comes nearest to its bounds, and the unknowns that explain the window."""
    model = certificate.window.model
    rows = [
        ("tightest", certificate.relation),
        ("", f"{percent(float(certificate.factor))} of the bounds are used"),
        ("first state", _state_text(certificate)),
    ]
    if model.g:
        assert certificate.disturbances is not None, EXPLAINS
        rows.append(("disturbance", _vectors_text(certificate.disturbances)))
    if model.d:
        assert certificate.unknown_inputs is not None, EXPLAINS
        rows.append(("unknown input", _vectors_text(certificate.unknown_inputs)))
    return rows


def _uncertain_rows(certificate: UncertainCertificate) -> list[Row]:
    """Return the rows of a certificate of a model with uncertain parameters."""
    if certificate.z is None:
        parts = (
            f"a combination of relations in each of {len(certificate.leaves)} parts of the parameters' box"
        )
        rows = [("violated", certificate.relation or parts)]
        if len(certificate.leaves) == 1:
            (leaf,) = certificate.leaves
            low, high = six_digits(leaf["low"]), six_digits(leaf["high"])
            rows.append(("", f"is in [{low}, {high}] at these samples, whatever the parameters"))
        return rows
    parameters = []
    assert certificate.parameters is not None, EXPLAINS
    for (name, lag), value in certificate.parameters.items():
        parameters.append(f"{at_sample(name, lag, certificate.relations.horizon)} {six_digits(value)}")
    return [("parameters", ", ".join(parameters)), ("first state", _state_text(certificate))]


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
    if certificate.z is not None:
        return _explained_table(certificate, labels)
    if isinstance(certificate, UncertainCertificate):
        return _limits_table(certificate, labels)
    return _violated_table(certificate, labels)


def _limits_table(certificate: UncertainCertificate, labels: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the readings of the outputs and the limits of their true values."""
    window, model = certificate.window, certificate.window.model
    rows: list[tuple[str, ...]] = [("time", "signal", "reading", "true value from", "to")]
    cells = np.ndindex(len(labels), model.p)
    for (j, i), y, limits in zip(cells, window.y, window.limits, strict=False):
        rows.append((labels[j], model.outputs[i], _reading(y), *_limits_text(limits, model.offset["y"][i])))
    return rows


def _explained_table(certificate: AnyCertificate, labels: Sequence[str]) -> list[tuple[str, ...]]:
    """Return all samples, with the true values that explain them."""
    window, model = certificate.window, certificate.window.model
    outputs, inputs = certificate.outputs, certificate.inputs
    assert outputs is not None and inputs is not None, EXPLAINS
    rows: list[tuple[str, ...]] = [("time", "signal", "reading", "true value from", "to", "explained by")]
    for j, label in enumerate(labels):
        for i, name in enumerate(model.outputs):
            row = j * model.p + i
            value = six_digits(outputs[j][i])
            if window.y[row] is None:
                rows.append((label, name, "missing", "", "", value))
                continue
            limits = _limits_text(window.limits[row], model.offset["y"][i])
            rows.append((label, name, six_digits(window.y[row]), *limits, value))
        for i, name in enumerate(model.inputs):
            row = j * model.m + i
            if row < len(window.u):
                value = six_digits(inputs[j][i])
                rows.append((label, name, _reading(window.u[row]), "", "", value))
    return rows


def _violated_table(certificate: Certificate, labels: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the samples that have a part in the violated relation, with their coefficients in it."""
    window, model = certificate.window, certificate.window.model
    rows: list[tuple[str, ...]] = [("time", "signal", "reading", "true value from", "to", "coefficient")]
    for j, label in enumerate(labels):
        for i, name in enumerate(model.outputs):
            row = j * model.p + i
            if window.y[row] is None:
                rows.append((label, name, "missing", "", "", ""))
            elif certificate.h[row]:
                limits = _limits_text(window.limits[row], model.offset["y"][i])
                coefficient = six_digits(certificate.h[row])
                rows.append((label, name, six_digits(window.y[row]), *limits, coefficient))
        for i, name in enumerate(model.inputs):
            row = j * model.m + i
            if row < len(window.u) and certificate.k[row]:
                rows.append((label, name, _reading(window.u[row]), "", "", six_digits(-certificate.k[row])))
    return rows + _bounds_rows(certificate, labels)


def _bounds_rows(certificate: Certificate, labels: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the disturbances and averages that have a part in the violated relation: they stand behind the
    outputs.
    """
    window = certificate.window
    rows: list[tuple[str, ...]] = []
    for coefficient, row, limits in zip(certificate.h, window.rows, window.limits, strict=True):
        if coefficient and row.kind is not Kind.READING:
            when, name = labels[row.last], row_name(window.model, row)
            rows.append((when, name, "", *_limits_text(limits), six_digits(coefficient)))
    return rows


def _reading(value: Fraction | None) -> str:
    return "missing" if value is None else six_digits(value)


def _limits_text(limits: tuple[Fraction, Fraction] | None, offset: Fraction | int = 0) -> tuple[str, str]:
    """Return the two ends of the limits of a true value, in the units of its signal."""
    if limits is None:
        return "", ""
    low, high = limits
    return six_digits(low + offset), six_digits(high + offset)


def six_digits(x: Any) -> str:
    """Return an exact number as a reader wants it, with six digits."""
    return f"{float(x) if abs(x) > SMALLEST else 0.0:.6g}"
