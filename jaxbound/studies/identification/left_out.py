"""Leaving recordings out: what the bounds of a fit are worth on a day that it has not seen.

Each recording in turn is judged by a fit to all the others, under the bounds of the fit to all. How much
wider they would have had to be is what another recording like these may ask for; n recordings promise no more
than one in n + 1 for the next, whatever is computed from them. A single recording is cut into blocks, which
says less: they share a day.

Where the others do not move as the fit to all needs it, their model is none, and what it asks for says
nothing of the plant: such a recording has no factor.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.studies.identification import regression
from jaxbound.studies.identification.candidates import (
    Candidate,
    FitProblem,
    largest_need,
)
from jaxbound.studies.identification.judging import Judge
from jaxbound.studies.identification.records import Records
from jaxbound.studies.identification.sizes import blindness
from jaxbound.studies.identification.structure import delayed

__all__ = ["EXCITED", "LeftOut", "Trial", "excited", "left_out", "tried", "widest"]

EXCITED = 0.02
"""The least share of what all recordings say of a direction that the others must say of it: of recordings
that carry a model together it was .13 and more, of half a run .00.
"""
RANK = 1e-9
"""Share of the largest below which nothing is said of a direction by any of them."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """A recording, or a block of one, under the fit to all others.

    Fields: model: arguments of a LinearSystem, of that fit; None where `why` says why there is none. need
    (T,): the factor on the bounds of the fit to all that explains each window, nan where there is none.
    """

    model: Mapping[str, Any] | None
    need: np.ndarray = field(repr=False)
    why: str = ""

    @property
    def factor(self) -> float:
        """The largest need; nan where there is none."""
        if not np.isfinite(self.need).any():
            return float("nan")
        return float(np.nanmax(self.need))

    def under(
        self, judge: Judge, noise: np.ndarray, averages: Mapping[str, Mapping[int, float]], part: Records
    ) -> "LeftOut":
        """Return the same part, judged under other bounds. averages: {output: {samples: bound}}."""
        if self.model is None:
            return self
        model = LinearSystem(**self.model, noise=noise.tolist(), averages=averages)
        return LeftOut(self.model, judge.needs(model, part)[0], self.why)


def left_out(
    problem: FitProblem, kind: str, parts: Records, number: int, noise: np.ndarray, least: int
) -> LeftOut:
    """Return one of the parts of recordings under the fit, of one of KINDS, to all others.

    Args:
        noise: (p,), the bounds of the fit to all. least: samples that a part must have.
    """
    others, own = [*parts[:number], *parts[number + 1 :]], parts[number : number + 1]
    unknown = np.full(len(own[0][1]), np.nan)
    if len(unknown) < least:
        return LeftOut(None, unknown, "it holds no window")
    if excited(problem, others, parts) < EXCITED:
        return LeftOut(None, unknown, "the others do not move all that it moves")
    try:
        fitted = problem.fitted(others, kind, number)
    except ValueError:  # too few samples for the coefficients
        return LeftOut(None, unknown, "the others are too short")
    return LeftOut(fitted.spec, unknown).under(problem.judge, noise, {}, own)


def excited(problem: FitProblem, others: Records, parts: Records) -> float:
    """Return the least share of what all parts say of a direction of the regressors that the others say."""
    about = problem.scales, problem.order, problem.direct
    others, parts = delayed(others, problem.delay), delayed(parts, problem.delay)
    some, every = regression.information(others, *about), regression.information(parts, *about)
    scale, directions = np.linalg.eigh(every)
    told = scale > RANK * scale.max()
    basis = directions[:, told] / np.sqrt(scale[told])
    return float(np.linalg.eigvalsh(basis.T @ some @ basis).min(initial=1.0))


def widest(left: Sequence[LeftOut]) -> float:
    """Return the factor that the recordings ask for, each left out in turn: at least 1."""
    factors = [1.0]
    for one in left:
        if np.isfinite(one.factor):
            factors.append(one.factor)
    return max(factors)


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate fitted to all recordings, and what each of them asks for when it is left out.

    Fields: bound (p,): the smallest noise that explains all. left: of each part. blindness: see
        `sizes.blindness`, of bounds as wide as these ask for.
    """

    candidate: Candidate
    bound: np.ndarray
    left: tuple[LeftOut, ...]
    blindness: float


def tried(problem: FitProblem, kind: str, records: Records, parts: Records) -> Trial:
    """Return the Trial of one of KINDS. parts: of the recordings, which are left out in turn."""
    full, judge = problem.fitted(records, kind), problem.judge
    model = full.model(full.spread)
    bound = largest_need(judge.needs(model, records)) * full.spread
    left, least = [], judge.least(model)
    for number in range(len(parts)):
        left.append(left_out(problem, kind, parts, number, bound, least))
    covering = full.model(widest(left) * bound)
    return Trial(full, bound, tuple(left), blindness(judge, covering, problem.scales, problem.spans))
