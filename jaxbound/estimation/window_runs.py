"""Averages in a window: bounds of sums over consecutive errors of a sensor, or values of a disturbance, of
which all lie in it.

Each run is one more row of the window's linear program,

    |m + sum F_v delta + sum F_w w| <= b,

delta being what a sample m_j is off by and w a disturbance, from -1 to 1. What rounding adds to the error of
a sample adds its part to b. Nothing is said of a run with a missing sample, or with a disturbance that no
sample of the window follows.
"""

from typing import Any, NamedTuple

import numpy as np

from jaxbound.estimation.ordered import mapped
from jaxbound.sets.floats import rounding

__all__ = ["AverageRows", "bounds_of", "average_rows"]


class AverageRows(NamedTuple):
    """The runs of averages in windows of L samples, in float64.

    Fields: v (a, L, p), w (a, L, g): what they combine; m, bound (a,); noise (p,): errors that averages speak
    of, rounded down.
    """

    v: Any
    w: Any
    m: Any
    bound: Any
    noise: Any


def average_rows(model: Any, L: int) -> AverageRows | None:
    """Return the AverageRows of a model; None if no average of it fits into so many samples."""
    rows = []
    for average in getattr(model, "averages", ()):
        measured, i = average.place(model.outputs)
        lo, hi = (0, 0) if measured else model.disturbance[i]
        weights = [float(x if measured else x * (hi - lo) / 2) for x in average.weights]
        middle = float(sum(average.weights) * (hi + lo) / 2)
        for first in range(L - (not measured) - len(weights) + 1):
            v, w = np.zeros((L, model.p)), np.zeros((L, model.g))
            (v if measured else w)[first : first + len(weights), i] = weights
            rows.append((v, w, middle, rounding.round_up(average.bound)))
    if not rows:
        return None
    v, w, m, bound = (np.array(x, float) for x in zip(*rows, strict=True))
    return AverageRows(v, w, m, bound, np.array([rounding.round_down(x) for x in model.noise], float))


def bounds_of(runs: AverageRows, rad: np.ndarray) -> np.ndarray:
    """Return b (a, N), at least as large as is known, infinite where nothing is said. rad (L, p, N): of
    samples, infinite without one.
    """
    seen = np.isfinite(rad)
    excess = np.maximum(np.where(seen, rad, 0).astype(np.float64) - runs.noise[:, None], 0)
    followed = np.cumsum(seen.any(1)[::-1], 0)[::-1] > 0  # by a sample, or at one
    followed = np.concatenate([followed[1:], np.zeros_like(followed[:1])])
    lost = np.einsum("aLp,LpN->aN", runs.v != 0, ~seen) + np.einsum("aLg,LN->aN", runs.w != 0, ~followed)
    b = runs.bound[:, None] + mapped(
        np.abs(runs.v).reshape(len(runs.v), -1), excess.reshape(-1, excess.shape[-1])
    )
    return np.where(lost > 0, np.inf, b * (1 + 1e-12) + 2.0**-500)
