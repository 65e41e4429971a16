"""Candidate models of a fit: one a kind of regression."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxbound.models.faults import Fault
from jaxbound.models.system import LinearSystem
from jaxbound.studies.identification import filters, regression
from jaxbound.studies.identification.judging import Judge, Sizes
from jaxbound.studies.identification.realisation import realised, realised_filters, realised_static
from jaxbound.studies.identification.recipe import AUTO, KINDS, Recipe, wanted_biases
from jaxbound.studies.identification.records import Records, left_out_parts, measured_count
from jaxbound.studies.identification.structure import chained, delayed
from jaxbound.studies.identification.training import Training

WINDOW = ("horizon", "lags")
"""Arguments of a LinearSystem that say which windows its bounds are for."""
EXACT, LEAST = 1e-14, 1e-3
"""The least noise, as a share of the largest sample, and of what is needed of it: for a plant that fits
exactly.
"""


@dataclass(frozen=True, eq=False)
class FitProblem:
    """A recipe for recordings, under a test.

    Fields:
        training: all recordings. recipe: with an order, a delay and a window. judge: the test that bounds are
            found for. parts: of the recordings, which are left out in turn.
        fits: those that `fitted` found, by kind and by the number that was left out.
    """

    training: Training
    recipe: Recipe
    judge: Judge
    parts: Records
    fits: "dict[tuple[str, int | None], Candidate]"

    @classmethod
    def of(cls, training: Training, recipe: Recipe, judge: Judge) -> "FitProblem":
        """Return the FitProblem of a recipe."""
        parts = left_out_parts(training.records, recipe.held_out, recipe.window.horizon + 1)
        return cls(training, recipe, judge, parts, {})

    def under(self, judge: Judge, recipe: Recipe) -> "FitProblem":
        """Return the problem of another test of windows that are as long: fits are the same."""
        return dataclasses.replace(self, judge=judge, recipe=recipe)

    @property
    def order(self) -> int:
        """The order of models."""
        return int(self.recipe.order)

    @property
    def delay(self) -> int:
        """The samples until inputs act."""
        return int(self.recipe.delay)

    @property
    def kinds(self) -> list[str]:
        """The KINDS that are tried."""
        if self.order == 0:
            return [KINDS[0]]
        if self.recipe.method != AUTO:
            return [self.recipe.method]
        if not self.parts:  # nothing tells them apart
            return ["windows"]
        return [kind for kind in KINDS if self.training.inputs or kind != "filters"]

    def others(self, number: int) -> Records:
        """Return all parts but one."""
        return [*self.parts[:number], *self.parts[number + 1 :]]

    def fitted(self, kind: str, left: int | None = None) -> "Candidate":
        """Return the Candidate of one of KINDS, fitted once to all recordings, or to all parts but the one of
        number `left`.
        """
        if (kind, left) not in self.fits:
            records = self.training.records if left is None else self.others(left)
            self.fits[kind, left] = candidate(self, records, kind)
        known = self.fits[kind, left]
        spec = {name: x for name, x in known.spec.items() if name not in WINDOW} | self.recipe.window.about
        return dataclasses.replace(known, spec=spec)

    def sizes(self, model: LinearSystem, most: float = 1.0) -> tuple[Sizes, Sizes]:
        """Return (jump, steady) of `Judge.sizes`, where bounds are `most` times those of a model."""
        jump, steady = self.judge.sizes(model.replace(times=None), self.training.scales)
        return {name: most * x for name, x in jump.items()}, {name: most * x for name, x in steady.items()}

    def blindness(self, model: LinearSystem) -> float:
        """Return the sizes of a jump and of a lasting error that are seen, summed over outputs in their
        spreads.

        Beyond the span of an output it does not count how blind the monitor is for it.
        """
        total, training = 0.0, self.training
        for sizes in self.judge.sizes(model, training.scales):
            for name, span, spread in zip(
                model.outputs, training.spans, training.scales.y_spread, strict=True
            ):
                total += min(sizes.get(name, 0.0), span) / spread
        return total


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
    training, order, direct = problem.training, problem.order, problem.recipe.direct
    scales, horizon = training.scales, problem.recipe.window.horizon
    p, m = len(training.outputs), len(training.inputs)
    records = delayed(records, problem.delay)
    steps = regression.windows_of(records, scales, order)
    windows = regression.windows_of(records, scales, horizon, regression.MOST)
    _refuse_few(records, len(steps.y), len(windows.y), horizon, order * (p + m) + direct * m + 1)
    if order == 0:
        spec, spread = realised_static(steps, scales)
    elif kind == "filters":
        spec, spread = realised_filters(records, scales, filters.poles_of(order, horizon), direct)
    else:
        theta = regression.least_squares(steps, order, direct)
        if kind == "windows":
            theta, spread = regression.refined_coefficients(theta, windows, order, direct)
        else:
            spread = regression.window_spread(theta, windows, order, direct)
        spec, spread = realised(theta, scales, order, direct, m, p), spread * scales.y_spread
    largest = np.nanmax(np.abs(np.concatenate([y for _, y, _ in records])), axis=0)
    spread = np.maximum(spread, EXACT * largest)  # where all fits exactly
    spec = chained(spec, problem.delay) | training.about | problem.recipe.window.about
    return Candidate(kind, spec, _shared(spread, training.outputs, problem.recipe.faults))


def _shared(spread: np.ndarray, outputs: Sequence[str], faults: Sequence[Fault]) -> np.ndarray:
    """Return a spread (p,) in the ratio of the wanted biases, where there are some; its geometric mean stays.

    A ratio of residuals gives the output that fits worst a wide bound, however small a fault of it is wanted.
    """
    wanted = wanted_biases(faults)
    sizes = np.array([wanted.get(name, math.nan) for name in outputs])
    named = np.isfinite(sizes)
    if named.sum() < 2:
        return spread
    level = np.prod((spread / sizes)[named]) ** (1 / named.sum())
    return np.where(named, sizes * level, spread)


def _refuse_few(records: Records, steps: int, windows: int, horizon: int, unknowns: int) -> None:
    """Raise ValueError if recordings hold too few steps or no window."""
    if steps >= 2 * unknowns and windows:
        return
    total = f"{measured_count(records)}, in {len(records)} recording{'s' * (len(records) > 1)}"
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
