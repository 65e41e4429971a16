"""The parts of a certificate by name, every number of them a Fraction.

A document is JSON that somebody else wrote: these types say what each part must be, and whoever reads one
checks it. Rows are samples in order of time. An entry is None where a sample is missing.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any, NotRequired, TypeAlias, TypedDict

from jaxbound.certificates.checker.polynomial import Polynomial

__all__ = [
    "Average",
    "Bounded",
    "Claim",
    "Document",
    "Ends",
    "Matrix",
    "Parameter",
    "Relation",
    "Samples",
    "SensorError",
    "Value",
    "Vector",
    "Witness",
    "insist",
]

Document: TypeAlias = dict[str, Any]
"""A certificate as JSON gives it, or a part of it that is not checked yet."""
Value: TypeAlias = Fraction | Polynomial
"""A number, or a polynomial in uncertain parameters or unknowns."""
Vector: TypeAlias = list[Fraction]
Matrix: TypeAlias = list[Vector]
Samples: TypeAlias = list[list[Fraction | None]]
Ends: TypeAlias = tuple[Fraction, Fraction]
"""(lo, hi) of a number."""


class Average(TypedDict):
    """A bounded weighted sum of consecutive samples; `beside`: those of other signals in the same sum."""

    output: Fraction
    number: Fraction
    weights: Vector
    bound: Fraction
    beside: NotRequired[list[Document]]


class Bounded(TypedDict):
    """A run of an average: its number and its first sample, None where it is not looked at."""

    average: Fraction
    first: Fraction | None


class Parameter(TypedDict):
    """An uncertain parameter: changes of the matrices, None where it has none, and the bound of its size."""

    A: Matrix | None
    B: Matrix | None
    C: Matrix | None
    D: Matrix | None
    bound: Fraction
    varying: Fraction


class Claim(TypedDict):
    """The numbers that a certificate is about: model, bounds and samples. No part of its proof."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    G: Matrix
    F: Matrix
    D_v: Matrix
    offset_u: Vector
    offset_y: Vector
    tolerance: Vector
    noise: Vector
    resolution: Vector
    disturbance: list[Vector]
    recorder: Fraction
    floor: Fraction
    u: Samples
    y: Samples
    lags: NotRequired[Vector]
    averages: NotRequired[list[Average]]
    runs: NotRequired[list[Bounded]]
    all_y: NotRequired[Samples]
    constant: NotRequired[Fraction]
    uncertainties: NotRequired[list[Parameter]]
    variables: NotRequired[list[tuple[Fraction, Fraction | None]]]
    first_state: NotRequired[list[Vector]]
    factors: NotRequired[Matrix]


class Relation(TypedDict):
    """Multipliers of true outputs (h), disturbances (g), inputs (k), averages (a) and a first state (x)."""

    h: Sequence[Sequence[Any]]
    g: Sequence[Sequence[Any]]
    k: Sequence[Sequence[Any]]
    a: NotRequired[Vector]
    x: NotRequired[Vector]
    residual: NotRequired[Fraction]
    width: NotRequired[Fraction]
    factor: NotRequired[Fraction]


class Witness(TypedDict):
    """A behaviour that explains a window: outputs and inputs in the units of the recording."""

    state: Vector
    disturbances: Matrix
    unknown_inputs: Matrix
    inputs: Matrix
    outputs: Matrix
    gains: NotRequired[Vector]


class SensorError(TypedDict):
    """The smallest error of one sensor that would explain a FAULT, and what proves it."""

    output: Fraction
    smallest: Fraction | None
    relation: Relation
    enough: Fraction | None
    witness: Witness | None


def insist(true: bool, reason: str) -> None:
    """Raise ValueError with a reason unless something is true."""
    if not true:
        raise ValueError(reason)
