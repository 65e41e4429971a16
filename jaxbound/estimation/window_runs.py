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
from jaxbound.models.window import bounded_sums, window_rows
from jaxbound.sets.floats import rounding

__all__ = ["Runs", "bounds_of", "runs_of"]


class Runs(NamedTuple):
    """The runs of averages in windows of L samples, in float64.

    Fields: v (a, L, p), w (a, L, g): what they combine; m, bound (a,); noise (p,): errors that averages speak
    of, rounded down.
    """

    v: Any
    w: Any
    m: Any
    bound: Any
    noise: Any


def runs_of(model: Any, L: int) -> Runs | None:
    """Return the Runs of a model; None if no average of it fits into so many samples."""
    if not getattr(model, "averages", ()):
        return None
    rows, found = window_rows(model, L - 1), []
    bounds = [rounding.round_up(bounded.bound) for bounded in bounded_sums(model)]
    for row in rows.of_sums:
        v, w, middle = np.zeros((L, model.p)), np.zeros((L, model.g)), 0
        for x in rows.terms(row):
            if x.measured:
                v[x.sample, x.number] = float(x.weight)
            else:
                lo, hi = model.disturbance[x.number]
                w[x.sample, x.number] = float(x.weight * (hi - lo) / 2)
                middle += x.weight * (hi + lo) / 2
        found.append((v, w, float(middle), bounds[row.number]))
    if not found:
        return None
    v, w, m, bound = (np.array(x, float) for x in zip(*found, strict=True))
    return Runs(v, w, m, bound, np.array([rounding.round_down(x) for x in model.noise], float))


def bounds_of(runs: Runs, rad: np.ndarray) -> np.ndarray:
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
