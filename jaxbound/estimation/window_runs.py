"""Averages in a window: bounds of sums over consecutive errors of a sensor, or values of a disturbance, of
which all lie in it.

Each run is one more row of the window's linear program,

    |m + sum F_v delta + sum F_w w| <= b,

delta being the error of a sample m_j and w a disturbance, from -1 to 1. What rounding adds to the error of a
sample adds its part to b. Nothing is said of a run with a missing sample, or with a disturbance that no
sample of the window follows.
"""

from fractions import Fraction
from typing import NamedTuple

import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.models.window import window_rows
from jaxbound.sets.floats import rounding


class AverageRows(NamedTuple):
    """The runs of averages in windows of L samples, in float64.

    Fields: v (a, L, p), w (a, L, g): the weights of errors and of disturbances; m, bound (a,); noise (p,):
    errors that averages speak of, rounded down.
    """

    v: np.ndarray
    w: np.ndarray
    m: np.ndarray
    bound: np.ndarray
    noise: np.ndarray

    @classmethod
    def none(cls, L: int, p: int, g: int) -> "AverageRows":
        """Return those of a model that bounds no averages."""
        return cls(np.zeros((0, L, p)), np.zeros((0, L, g)), np.zeros(0), np.zeros(0), np.zeros(p))

    def sizes(self, s: np.ndarray) -> np.ndarray:
        """Return the magnitudes (a, N) of all that stands in rows, of errors up to s (L, p, N)."""
        of_errors = np.einsum("aLp,LpN->aN", np.abs(self.v), s)
        return np.asarray(of_errors + (np.abs(self.w).sum((1, 2)) + np.abs(self.m))[:, None])


def average_rows(model: LinearSystem, L: int) -> AverageRows:
    """Return the rows of a model's bounded sums that fit into so many samples."""
    rows = window_rows(model, L - 1)
    count = len(rows.of_sums)
    bounds = [rounding.round_up(bounded.bound) for bounded in model.averages]
    v, w = np.zeros((count, L, model.p)), np.zeros((count, L, model.g))
    m, bound = np.zeros(count), np.zeros(count)
    for a, row in enumerate(rows.of_sums):
        middle = Fraction(0)
        for term in rows.terms(row):
            if term.measured:
                v[a, term.sample, term.number] = float(term.weight)
            else:
                lo, hi = model.disturbance[term.number]
                w[a, term.sample, term.number] = float(term.weight * (hi - lo) / 2)
                middle += term.weight * (hi + lo) / 2
        m[a], bound[a] = float(middle), bounds[row.number]
    noise = np.array([rounding.round_down(x) for x in model.noise], float)
    return AverageRows(v, w, m, bound, noise)


def bounds_of(runs: AverageRows, rad: np.ndarray) -> np.ndarray:
    """Return b (a, N), at least as large as is known, infinite where nothing is said.

    Args:
        rad (L, p, N): of samples, infinite without one.
    """
    seen = np.isfinite(rad)
    # b times the mean of factors f is at most b + sum |v| (f - 1) noise, wherever b says more than noise
    excess = np.maximum(np.where(seen, rad, 0).astype(np.float64) - runs.noise[:, None], 0)
    # a disturbance acts on the samples behind it
    any_later = np.cumsum(seen.any(1)[::-1], 0)[::-1] > 0
    any_later = np.concatenate([any_later[1:], np.zeros_like(any_later[:1])])
    lost = np.einsum("aLp,LpN->aN", runs.v != 0, ~seen) + np.einsum("aLg,LN->aN", runs.w != 0, ~any_later)
    b = runs.bound[:, None] + np.einsum("aLp,LpN->aN", np.abs(runs.v), excess)
    return np.where(lost > 0, np.inf, b * (1 + 1e-12) + 2.0**-500)
