"""Disturbances that are 0, or so small that nothing shows them: a row of a window without a width leaves a
search nothing to divide by.
"""

from collections.abc import Callable
from fractions import Fraction
from typing import TypeVar

import jax
import numpy as np

from jaxbound.consistency.interface import Array, LinearRelations
from jaxbound.exact import linalg
from jaxbound.models.system import LinearSystem
from jaxbound.models.window import window_rows
from jaxbound.sets.floats import rounding

VANISHING = 2.0**-900
"""Bounds below which a disturbance counts as 0; what it does to the outputs is added to their noise."""


R = TypeVar("R", bound=LinearRelations)


def without_still(relations: R, made: Callable[[LinearSystem], R]) -> R | None:
    """Return relations without those of their disturbances that are 0; None if there are no such. made: makes
    relations of another model over the same window.
    """
    model, bounds = relations.model, relations.bounds
    ends = bounds.get("disturbance")
    summed = any(not values.measured for values in window_rows(model, 0).sums)
    # of tracers nobody knows whether they are 0, and sums of errors have rows of their own
    if ends is None or summed or any(isinstance(x, jax.core.Tracer) for x in bounds.values()):
        return None
    most = VANISHING
    if model.factors:  # what widens the noise must not be times a factor
        most = np.finfo(float).smallest_subnormal
    # the loops of a search divide by radii, whose reciprocals have to stay finite
    still = np.asarray((np.abs(ends) < most).all(1))
    if not still.any():
        return None
    less = made(_moving_model(model, still))
    kept = {name: bounds[name] for name in less.bounds}
    kept["noise"] = _wider_noise(relations, np.where(still[:, None], ends, 0))
    if not still.all():
        kept["disturbance"] = np.asarray(ends)[~still]
    return less.with_bounds(kept)


def _moving_model(model: LinearSystem, still: np.ndarray) -> LinearSystem:
    """Return the model without some of its disturbances (g,)."""
    rest = np.flatnonzero(~still)
    if not len(rest):
        return model.replace(disturbance=None)
    G = [[row[j] for j in rest] for row in model.G]
    return model.replace(disturbance=(G, [model.disturbance[j] for j in rest]))


def _wider_noise(relations: LinearRelations, ends: np.ndarray) -> Array:
    """Return noise (p,) that holds what disturbances within ends (g, 2) add to the outputs of a window, too:
    the same if they are 0.
    """
    model, noise = relations.model, relations.bounds["noise"]
    if not ends.any():
        return noise
    size = tuple(Fraction(float(x)) for x in np.abs(ends).max(1))
    rows, wider = model.C, [Fraction(float(x)) for x in noise]
    # what w of one sample does to the outputs of all later ones of a window: C G, C A G, ..
    for _ in range(relations.horizon):
        through = linalg.matmul(rows, model.G)
        for i, row in enumerate(through):
            wider[i] += sum((abs(a) * b for a, b in zip(row, size, strict=True)), Fraction(0))
        rows = linalg.matmul(rows, model.A)
    return rounding.round_up(wider)
