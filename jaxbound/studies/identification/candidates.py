"""Candidate models of a fit: one a kind of regression."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.studies.identification import filters, regression
from jaxbound.studies.identification.judging import Judge
from jaxbound.studies.identification.realisation import realised, realised_filters, realised_static
from jaxbound.studies.identification.records import Records, measured
from jaxbound.studies.identification.regression import Scales
from jaxbound.studies.identification.structure import chained, delayed

__all__ = ["KINDS", "Candidate", "FitProblem", "candidate", "largest_need"]

KINDS = ("least squares", "windows", "filters")
WINDOW = ("horizon", "lags")
"""Arguments of a LinearSystem that say which windows its bounds are for."""
EXACT, LEAST = 1e-14, 1e-3
"""The least noise, as a share of the largest sample, and of what is needed of it: for a plant that fits
exactly.
"""


@dataclass(frozen=True, eq=False)
class FitProblem:
    """A fit but for the recordings that a candidate sees.

    Fields:
        scales: of all recordings. spans (p,): between the lowest and the highest sample of each output.
        order, delay, direct: see `fit`. horizon: of the windows that a regression looks at.
        about: arguments of a LinearSystem beside its matrices. judge: the test that bounds are found for.
        wanted: sizes of the faults that are wanted, by output: bounds are in their ratio.
        fits: those that `fitted` found, by kind and by the number that was left out.
    """

    scales: Scales
    spans: tuple[float, ...]
    order: int
    delay: int
    horizon: int
    direct: bool
    about: dict[str, Any]
    judge: Judge
    wanted: Mapping[str, float] = field(default_factory=dict)
    fits: "dict[tuple[str, int | None], Candidate]" = field(default_factory=dict)

    def under(self, judge: Judge, about: dict[str, Any]) -> "FitProblem":
        """Return the problem of another test of windows that are as long: fits are the same."""
        return dataclasses.replace(self, judge=judge, about=about)

    def fitted(self, records: Records, kind: str, left: int | None = None) -> "Candidate":
        """Return the Candidate of one of KINDS, fitted once. left: the number of the part that the recordings
        lack, None: none.
        """
        if (kind, left) not in self.fits:
            self.fits[kind, left] = candidate(self, records, kind)
        known = self.fits[kind, left]
        spec = known.spec | self.about
        for name in WINDOW:
            if name not in self.about:
                spec.pop(name, None)
        return dataclasses.replace(known, spec=spec)

    @classmethod
    def of(
        cls,
        records: Records,
        order: int,
        delay: int,
        horizon: int,
        direct: bool,
        about: dict[str, Any],
        judge: Judge,
        wanted: Mapping[str, float] | None = None,
    ) -> "FitProblem":
        """Return the FitProblem of fitting to all of these recordings."""
        scales = regression.scales_of(records)
        y = np.concatenate([r[1] for r in records])
        spans = tuple(np.nanmax(y, axis=0) - np.nanmin(y, axis=0))
        return cls(scales, spans, order, delay, horizon, direct, about, judge, wanted or {})


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model without bounds: arguments of a LinearSystem, and the root mean square (p,) of its window
    residuals in the unit of each output; of outputs of which faults are wanted, in the ratio of these.
    """

    kind: str
    spec: dict[str, Any]
    spread: np.ndarray

    def model(self, noise: np.ndarray) -> LinearSystem:
        """Return the model with these bounds (p,)."""
        return LinearSystem(**self.spec, noise=noise.tolist())


def candidate(problem: FitProblem, records: Records, kind: str) -> Candidate:
    """Return the Candidate of one of KINDS, fitted to recordings."""
    scales, order, horizon, direct = problem.scales, problem.order, problem.horizon, problem.direct
    p, m = len(problem.about["outputs"]), len(problem.about["inputs"])
    records = delayed(records, problem.delay)
    steps = regression.windows_of(records, scales, order)
    windows = regression.windows_of(records, scales, horizon, regression.MOST)
    _refuse_few(records, len(steps.y), len(windows.y), horizon, order * (p + m) + direct * m + 1)
    if order == 0:
        spec, spread = realised_static(steps, scales)
    elif kind == "filters":
        spec, spread = realised_filters(records, scales, filters.poles_of(order, horizon), direct)
    else:
        theta, _ = regression.least_squares(steps, order, direct)
        if kind == "windows":
            theta, spread = regression.refined(theta, windows, order, direct)
        else:
            spread = regression.window_spread(theta, windows, order, direct)
        spec, spread = realised(theta, scales, order, direct, m, p), spread * scales.y_spread
    largest = np.nanmax(np.abs(np.concatenate([y for _, y, _ in records])), axis=0)
    spread = np.maximum(spread, EXACT * largest)  # where all fits exactly
    spec = chained(spec, problem.delay) | problem.about
    return Candidate(kind, spec, _shared(spread, problem))


def _shared(spread: np.ndarray, problem: FitProblem) -> np.ndarray:
    """Return a spread (p,) in the ratio of the wanted faults, where there are some; its geometric mean stays.

    A ratio of residuals gives the output that fits worst a wide bound, however small a fault of it is wanted.
    """
    sizes = np.array([problem.wanted.get(name, math.nan) for name in problem.about["outputs"]])
    named = np.isfinite(sizes)
    if named.sum() < 2:
        return spread
    level = np.prod((spread / sizes)[named]) ** (1 / named.sum())
    return np.where(named, sizes * level, spread)


def _refuse_few(records: Records, steps: int, windows: int, horizon: int, unknowns: int) -> None:
    """Raise ValueError if recordings hold too few steps or no window."""
    if steps >= 2 * unknowns and windows:
        return
    total = f"{measured(records)}, in {len(records)} recording{'s' * (len(records) > 1)}"
    raise ValueError(
        f"too few samples: {total}, hold {windows} complete windows of {horizon + 1} samples, and {steps} "
        f"steps for {unknowns} coefficients an output, twice as many of which are needed: record longer, or "
        f"choose a lower order or horizon"
    )


def largest_need(each: Sequence[np.ndarray]) -> float:
    """Return the largest need, at least LEAST; nan where there is no window."""
    every = np.concatenate(each)
    if not np.isfinite(every).any():
        return float("nan")
    return max(float(np.nanmax(every)), LEAST)
