"""Leaving recordings out: what the bounds of a fit are worth on a day that it has not seen.

Each recording in turn is judged by a fit to all the others, under the bounds of the fit to all. These hold
every recording, the most unlike one too, so what they lack on a day that nobody saw is how wrong a model is
there: the geometric mean of what the recordings ask for (`factor_of`). The largest would count the most
unlike recording twice. n recordings promise no more than one in n + 1 for the next, whatever is computed from
them. A single recording is cut into blocks, which says less: they share a day.

Where the others do not move as the fit to all needs it, their model is none, and what it asks for says
nothing of the plant: such a recording has no factor.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.studies.identification import regression
from jaxbound.studies.identification.candidates import Candidate, FitProblem, largest_need
from jaxbound.studies.identification.following import Follows, follows_in, times
from jaxbound.studies.identification.judging import Judge
from jaxbound.studies.identification.records import Records
from jaxbound.studies.identification.structure import delayed

Walks = tuple[np.ndarray, np.ndarray]
"""(G (n, g), smallest bounds (g,)) of disturbances."""
EXCITED = 0.02
"""The least share of what all recordings say of a direction that the others must say of it: of recordings
that carry a model together it was .13 and more, of half a run .00.
"""
RANK = 1e-9
"""Share of the largest below which nothing is said of a direction by any of them."""
AVERAGES = 0.95
"""Share of the bound of a sample from which on that of a mean says nothing."""
FEW_DAYS = 1.15
"""Factor for two recordings on top of what they ask for, its root of order n - 1 for n: a fit to one of two
says little of the next, and in simulated plants half of all days asked for more.
"""


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


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate fitted to all recordings, and what each of them asks for when it is left out.

    Fields:
        bound (p,): the smallest noise that explains all. left: of each part. blindness: see
            `FitProblem.blindness`, of bounds as wide as these ask for. days: how many recordings there are.
            beside: the `own` of other tests that are written with the same factor.
        follows: how bounds follow the operating point. average, means (p,): the smallest bounds of the means
            of so many errors; None: none. walks: of disturbances.
    """

    candidate: Candidate
    bound: np.ndarray
    left: tuple[LeftOut, ...]
    blindness: float
    days: int
    beside: tuple[tuple[float, ...], ...] = ()
    follows: Follows = Follows()
    average: int | None = None
    means: np.ndarray | None = None
    walks: Walks | None = None

    @property
    def own(self) -> tuple[float, ...]:
        """The factor that each part asks of this test; nan where there is none."""
        return tuple(one.factor for one in self.left)

    @property
    def asked(self) -> tuple[float, ...]:
        """The factor that each part asks of this test and of those beside it."""
        return largest_of((self.own, *self.beside))

    @property
    def factor(self) -> float:
        """The factor on the smallest bounds that the recordings ask for."""
        return factor_of(self.asked, self.days)

    @property
    def averages(self) -> dict[str, dict[int, float]]:
        """{output: {samples: the smallest bound of their mean}}, where it says more than that of a sample."""
        if self.means is None or self.average is None:
            return {}
        outputs = zip(self.candidate.spec["outputs"], self.means.tolist(), self.bound, strict=True)
        return {name: {self.average: x} for name, x, bound in outputs if x < AVERAGES * bound}

    def under(self, judge: Judge, parts: Records) -> "Trial":
        """Return the trial with each part left out judged once more, by another test or with means."""
        left = []
        for one, part in zip(self.left, parts, strict=True):
            if one.model is not None:
                model = LinearSystem(**one.model, noise=self.bound.tolist(), averages=self.averages)
                one = LeftOut(one.model, judge.needs(model, [part])[0], one.why)
            left.append(one)
        return dataclasses.replace(self, left=tuple(left))


def excited(problem: FitProblem, others: Records, parts: Records) -> float:
    """Return the least share of what all parts say of a direction of the regressors that the others say."""
    scales, order, direct = problem.training.scales, problem.order, problem.recipe.direct
    some = regression.information(delayed(others, problem.delay), scales, order, direct)
    every = regression.information(delayed(parts, problem.delay), scales, order, direct)
    scale, directions = np.linalg.eigh(every)
    told = scale > RANK * scale.max()
    basis = directions[:, told] / np.sqrt(scale[told])
    return float(np.linalg.eigvalsh(basis.T @ some @ basis).min(initial=1.0))


def largest_of(tests: Sequence[Sequence[float]]) -> tuple[float, ...]:
    """Return the factor that each part asks of several tests, the largest that is known; else nan.

    Example:
        >>> largest_of([(1.1, 0.9), (float("nan"), 1.3)])
        (1.1, 1.3)
    """
    return tuple(np.fmax.reduce(list(filter(len, tests)) or [()]).tolist())


def factor_of(asked: Sequence[float], days: int) -> float:
    """Return the factor on the smallest bounds: the geometric mean of what the parts ask for, each for 1 at
    least, and more for few days; 1 where nothing was left out.

    Args:
        asked: by each part, nan where it is not known. days: how many recordings there are.

    Example:
        >>> round(factor_of((1.0, 8.0, 0.5), 3) / few_days(3), 6)
        2.0
    """
    if not len(asked):
        return 1.0
    known = np.array(asked)[np.isfinite(asked)]
    mean = np.exp(np.log(np.maximum(known, 1)).mean()) if len(known) else 1.0
    return float(mean) * few_days(days)


def few_days(days: int, of_two: float = FEW_DAYS) -> float:
    """Return the factor for few recordings. of_two: that for two.

    Example:
        >>> few_days(2), round(few_days(5), 3)
        (1.15, 1.036)
    """
    return float(of_two ** (1 / max(days - 1, 1)))


def tried(problem: FitProblem, kind: str, weight: float = 0.0) -> Trial:
    """Return the Trial of one of KINDS. weight: of bounds that follow the operating point; 0: constant."""
    training, judge = problem.training, problem.judge
    constant = problem.fitted(kind)
    more = times(training, training.records, weight)
    full = dataclasses.replace(constant, spec=constant.spec | more)
    follows = follows_in(training, full.spec, weight)
    model = full.model(full.spread)
    bound = largest_need(judge.needs(model, training.records)) * full.spread
    left, least = [], judge.least(model)
    for number in range(len(problem.parts)):
        left.append(_without(problem, kind, number, least, weight))
    trial = Trial(full, bound, tuple(left), 0.0, training.days, follows=follows).under(judge, problem.parts)
    # bounds that follow are judged by constant ones as wide as they are on average
    covering = constant.model(trial.factor * follows.mean * bound)
    return dataclasses.replace(trial, blindness=problem.blindness(covering))


def _without(problem: FitProblem, kind: str, number: int, least: int, weight: float) -> LeftOut:
    """Return the fit to all parts but one, not judged yet. least: samples that a part must have."""
    others = problem.others(number)
    unknown = np.full(len(problem.parts[number][1]), np.nan)
    if len(unknown) < least:
        return LeftOut(None, unknown, "it holds no window")
    if excited(problem, others, problem.parts) < EXCITED:
        return LeftOut(None, unknown, "the others do not move all that it moves")
    try:
        fitted = problem.fitted(kind, number)
    except ValueError:  # too few samples for the coefficients
        return LeftOut(None, unknown, "the others are too short")
    return LeftOut(fitted.spec | times(problem.training, others, weight), unknown)
