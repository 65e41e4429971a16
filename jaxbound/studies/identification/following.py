"""Bounds that follow the operating point: errors of a fitted model grow away from its training, and the
bounds of all outputs with them, by one factor of the inputs of the same sample,

    sqrt(1 + weight phi' P phi),    phi the inputs minus their mean in training,

P the inverse of the covariance of the inputs in training over their number, so that phi' P phi is 1 there on
average. It is written as a sum of squares with few digits (Cholesky), so the factor is at least 1 whatever
the digits, and the one that is written is the one that is tested.

How strongly bounds follow is chosen as methods are: by what is seen, on average over training, with bounds as
wide as recordings that are left out ask for, the factor of each of them from the others alone.
"""

import keyword
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxbound.models.times import inputs_for_factors
from jaxbound.recordings.factors import read_factor
from jaxbound.studies.identification.recipe import AUTO
from jaxbound.studies.identification.records import Records
from jaxbound.studies.identification.training import Training

WEIGHTS = (0.1, 0.3)
"""That are tried beside 0; larger ones lose what they gain."""
RIDGE = 1e-3
"""Added to the covariance of inputs in units of their spreads: of two that move together nobody knows what
they do where they part, but not that infinitely much.
"""
NOBODY_SAYS = (
    "no recording says, left out, how strongly bounds have to follow the operating point: they are constant; "
    "a weight does not ask, --recipe follow=0.1"
)
SMALL = 0.01
"""Coefficients that are left out, in units of the spread of an input."""


class Follows(NamedTuple):
    """How the bounds of a fitted model follow the operating point.

    Fields: weight: of phi' P phi; 0: not at all. mean, most: of the factor on the bounds in training.
    """

    weight: float = 0.0
    mean: float = 1.0
    most: float = 1.0


def leverage_text(records: Records, inputs: Sequence[str], chosen: Sequence[str], weight: float) -> str:
    """Return the factor as an expression, of few digits, of those of the chosen inputs that move in
    recordings; "" where none does.

    How unlike its training a sample of the inputs is: |root ((u - middle) / spread)|^2.
    """
    u = _measured_inputs(records)
    columns = [i for i, name in enumerate(inputs) if name in chosen]
    if len(u) < 2:
        return ""
    columns = [i for i in columns if np.ptp(u[:, i]) > 1e-9 * np.abs(u[:, i]).max()]
    if not columns:
        return ""
    u = u[:, columns]
    middle, spread = u.mean(0), u.std(0)
    z = (u - middle) / spread
    P = np.linalg.inv(z.T @ z / len(z) + RIDGE * np.eye(len(columns))) / len(columns)
    shifted = []
    for i, x, size in zip(columns, middle, spread, strict=True):
        places = 2 - int(np.floor(np.log10(size)))
        shifted.append(_minus(_name(inputs[i]), round(float(x), places)))
    squares = ["1"]
    for i, row in enumerate(np.linalg.cholesky(P).T):
        terms = []
        for j in range(i, len(row)):
            coefficient = np.sqrt(weight) * row[j] / spread[j]
            if j == i or abs(row[j]) > SMALL:
                terms.append(f"{coefficient:.3g}*{shifted[j]}")
        squares.append(f"({' + '.join(terms).replace('+ -', '- ')})**2")
    return f"sqrt({' + '.join(squares)})"


def _measured_inputs(records: Records) -> np.ndarray:
    """Return the inputs (N, m) of all samples that say something."""
    kept = []
    for u, y, _ in records:
        kept.append(u[np.isfinite(u).all(1) & np.isfinite(y).any(1)])
    return np.concatenate(kept)


def _name(name: str) -> str:
    """Return the name of a signal as an expression has it."""
    if name.isidentifier() and not keyword.iskeyword(name):
        return name
    return f"`{name}`"


def _minus(name: str, x: float) -> str:
    if x < 0:
        return f"({name} + {-x:.12g})"
    return f"({name} - {x:.12g})"


def hindrance(training: Training) -> str:
    """Return why bounds cannot follow anything; "": they can."""
    if "every" in training.columns:
        return "samples that are means have no inputs of their own, which bounds could follow"
    if not _inputs(training):
        return "there is no input that bounds could follow, none that rests on no output"
    return ""


def weights_of(follow: float | str) -> tuple[float, ...]:
    """Return the weights that are tried beside 0. follow: as of a Recipe."""
    if follow == AUTO:
        return WEIGHTS
    return (float(follow),) if follow else ()


def _inputs(training: Training) -> tuple[str, ...]:
    return inputs_for_factors(training.inputs, training.outputs, training.columns)


def times(training: Training, records: Records, weight: float) -> dict[str, Any]:
    """Return the argument `times` of a LinearSystem that is fitted to some of the recordings."""
    if not weight:
        return {}
    text = leverage_text(records, training.inputs, _inputs(training), weight)
    if not text:  # nothing moves in them: nothing is known of how errors grow
        return {}
    return {"times": dict.fromkeys(training.outputs, text)}


def follows_in(training: Training, spec: Mapping[str, Any], weight: float) -> Follows:
    """Return how the bounds of a model follow the operating point in its training."""
    if "times" not in spec:
        return Follows()
    (text,) = set(spec["times"].values())
    columns = dict(zip(training.inputs, _measured_inputs(training.records).T, strict=True))
    factor = read_factor(text).values(columns)
    return Follows(weight, float(factor.mean()), float(factor.max()))
