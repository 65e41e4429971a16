"""Candidate tests of a monitor: each with the factor that recordings which are left out ask of it, and the
errors that it then sees.

Short windows see jumps, long ones lasting errors; means pay where errors average out and a window is some
times as long; lags remember as long with fewer samples. Each needs bounds of its own. Tests of windows that
are as long share their fits; floats (`gauge`) choose, and the test that is taken is proved afterwards. Where
bounds may follow the operating point, all are tried so, too, by the coefficients that see most under constant
bounds.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from jaxbound.diagnosis.memory import spread_lags
from jaxbound.models.average import Average
from jaxbound.studies.identification.candidates import FitProblem
from jaxbound.studies.identification.following import weights_of
from jaxbound.studies.identification.gauge import GaugeJudge, gauge_of, seen_slopes
from jaxbound.studies.identification.means import LOOSE, lowered
from jaxbound.studies.identification.recipe import AUTO, Recipe, WindowChoice
from jaxbound.studies.identification.records import left_out_parts
from jaxbound.studies.identification.regression import complete_windows, completeness, reached
from jaxbound.studies.identification.training import Training
from jaxbound.studies.identification.trial import Trial, tried
from jaxbound.text.progress import reporter

__all__ = [
    "RAMP",
    "WINDOWS",
    "JudgedTest",
    "TriedTest",
    "WindowChoice",
    "best_kind",
    "best_test",
    "searched_means",
    "tried_tests",
]

LOOKS = 16
"""Samples that windows with lags look at."""
RAMP = 100
"""Samples after which the size of a ramp counts."""
LOOKED_AT = 0.1
"""Share of complete windows, the only ones that floats look at, below which longer windows are not tried."""

WINDOWS = (
    WindowChoice(7),
    WindowChoice(15),
    WindowChoice(30),
    WindowChoice(30, average=8),
    WindowChoice(60),
    WindowChoice(60, average=16),
    WindowChoice(60, spread_lags(60, LOOKS)),
)
"""The tests that are tried: means where a window is about four times as long."""


class JudgedTest(NamedTuple):
    """A test, and what it is worth under bounds as wide as recordings that are left out ask for.

    Fields: window: WindowChoice; method: of the coefficients; factor: on the smallest bounds; smallest,
    smallest_mean: those bounds, {output: bound}; jump, steady: {output: size}, the smallest errors that are
    sure to be seen at this factor and the safety, inf: none. blindness: these sizes, and those of ramps, as
    one number, see `blindness`. ramp: {output: size} that a ramp has after RAMP samples, likewise.
    In floats, not proved, and of complete windows alone. reach: the share of the samples at which windows
    have a verdict; 0: it does not count. left_out: the factor that each recording, or block, asks for.
    typical: the share of these sizes that is seen where bounds that follow are as wide as on average.
    """

    window: WindowChoice
    method: str
    factor: float
    smallest: dict[str, float]
    smallest_mean: dict[str, float]
    jump: dict[str, float]
    steady: dict[str, float]
    blindness: float
    ramp: Mapping[str, float] = {}
    reach: float = 0.0
    left_out: tuple[float, ...] = ()
    typical: float = 1.0

    @property
    def sizes(self) -> dict[tuple[str, str], float]:
        """{(kind, output): size} of the errors that are seen, on average."""
        kinds = {"jump": self.jump, "steady": self.steady, "ramp": self.ramp}
        return {(kind, name): self.typical * x for kind, own in kinds.items() for name, x in own.items()}

    def times(self, wider: float) -> "JudgedTest":
        """Return the test under bounds so many times as wide."""

        def grown(sizes: Mapping[str, float]) -> dict[str, float]:
            return {output: wider * size for output, size in sizes.items()}

        return self._replace(
            factor=wider * self.factor,
            jump=grown(self.jump),
            steady=grown(self.steady),
            ramp=grown(self.ramp),
        )


@dataclass(frozen=True, eq=False)
class TriedTest:
    """A JudgedTest with the fits behind it.

    Fields: judged: the test. trial: of its windows. complete: whether windows that lack samples were none;
    else floats did not look at them.
    """

    judged: JudgedTest
    trial: Trial
    complete: bool

    @property
    def blindness(self) -> float:
        """The sizes of errors that the test sees, as one number."""
        return self.judged.blindness


def blindness(sizes: Mapping[tuple[str, str], float], spans: Mapping[str, float]) -> float:
    """Return the geometric mean of the sizes of errors from which on they are seen, in shares of the span of
    their output, beyond which it does not count how blind a test is.

    Example:
        >>> round(blindness({("jump", "T1"): 2.0, ("ramp", "T1"): 1e9}, {"T1": 8.0}), 6)
        0.5
    """
    own = np.array([spans[output] for _, output in sizes])
    shares = np.minimum(list(sizes.values()) / own, 1)
    return float(np.exp(np.log(shares).mean()))


def best_test(tests: Sequence[JudgedTest]) -> JudgedTest:
    """Return the test that sees the smallest errors, the first one of equals."""
    return min(tests, key=attrgetter("blindness"))


def best_kind(problem: FitProblem) -> str:
    """Return the one of KINDS whose windows see the smallest errors, as far as floats say."""
    if len(problem.kinds) == 1:
        return problem.kinds[0]
    searched = problem.under(GaugeJudge(), problem.recipe)
    found = {kind: tried(searched, kind).blindness for kind in problem.kinds}
    return min(found, key=found.__getitem__)


def tried_tests(training: Training, recipe: Recipe, step: Callable[[float], object]) -> tuple[TriedTest, ...]:
    """Return the TriedTest of each of WINDOWS that recordings are long enough for, by each kind.

    Args:
        recipe: with an order and a delay. step: called with the share of the work done.

    Raises:
        ValueError: the recordings are too short for any of them.
    """
    records, held_out = training.records, recipe.held_out
    kinds = FitProblem.of(training, recipe, GaugeJudge()).kinds
    problems: dict[int, FitProblem] = {}
    tests: list[TriedTest] = []
    refusal: ValueError | None = None
    can_leave = bool(left_out_parts(records, held_out, WINDOWS[0].horizon + 1))
    for number, window in enumerate(WINDOWS):
        horizon = window.horizon
        if horizon <= int(recipe.order) or bool(left_out_parts(records, held_out, horizon + 1)) != can_leave:
            continue  # no window, or no part to leave out
        if tests and completeness(records, horizon) < LOOKED_AT:
            continue  # bounds of the few windows that are complete would be too small for the others
        own = recipe.of(window, recipe.method)
        if horizon not in problems:
            problems[horizon] = FitProblem.of(training, own, GaugeJudge())
        problem = problems[horizon].under(GaugeJudge(), own)
        try:
            constant = len(tests)
            for kind in kinds:
                tests += _judged(problem, kind)
            best = min(tests[constant:], key=attrgetter("blindness"), default=None)
            # without a part that is left out nobody says how strongly bounds follow
            if best is not None and (recipe.follow != AUTO or np.isfinite(best.trial.own).any()):
                for weight in weights_of(recipe.follow):
                    own = recipe.of(window._replace(follow=weight), AUTO)
                    tests += _judged(problem.under(GaugeJudge(), own), best.judged.method)
        except ValueError as e:  # too few samples for windows that are so long
            refusal = refusal or e
        step((number + 1) / len(WINDOWS))
    if not tests:
        raise refusal or ValueError(
            f"order {recipe.order} is too high for windows of 61 samples: choose a lower one"
        )
    return tuple(tests)


def _judged(problem: FitProblem, kind: str) -> list[TriedTest]:
    """Return the TriedTest of one of KINDS; none where no error averages out."""
    recipe, training = problem.recipe, problem.training
    trial = tried(problem, kind, float(recipe.follow))
    if recipe.average is not None:
        means = searched_means(problem, trial)
        trial = replace(trial, average=recipe.average, means=means)
        if not trial.averages:
            return []
        trial = trial.under(problem.judge, problem.parts)
    factor, safety = trial.factor, recipe.safety
    wider = {name: {n: factor * x for n, x in own.items()} for name, own in trial.averages.items()}
    model = trial.candidate.model(factor * trial.bound).replace(averages=wider)
    wide = safety * trial.follows.most
    jump, steady = problem.sizes(model, wide)
    ramp = {name: RAMP * wide * x for name, x in seen_slopes(model, training.scales).items()}
    judged = JudgedTest(
        recipe.window._replace(follow=float(recipe.follow)),
        kind,
        factor,
        dict(zip(model.outputs, trial.bound.tolist(), strict=True)),
        {name: x for name, own in trial.averages.items() for x in own.values()},
        jump,
        steady,
        math.nan,
        ramp,
        reached(training.records, recipe.window.horizon),
        trial.own,
        trial.follows.mean / trial.follows.most,
    )
    judged = judged._replace(blindness=blindness(judged.sizes, training.span_of))
    return [TriedTest(judged, trial, completeness(training.records, recipe.window.horizon) == 1)]


def searched_means(problem: FitProblem, trial: Trial) -> np.ndarray:
    """Return the smallest bounds (p,) of means, in floats. trial: of windows without averages."""
    model, samples = trial.candidate.model(trial.bound * LOOSE), problem.recipe.average
    assert samples is not None, "bounds of means are asked for"
    horizon, records = problem.recipe.window.horizon, problem.training.records
    firsts = [complete_windows(u, y, starts, horizon) for u, y, starts in records]
    hard = [first[:0] for first in firsts]  # windows that spoke against bounds before do so again, mostly

    def all_explained(bounds: np.ndarray, those: Sequence[np.ndarray]) -> bool:
        weights = (Fraction(1, samples),) * samples
        means = [Average(name, weights, Fraction(x)) for name, x in zip(model.outputs, bounds, strict=True)]
        gauge = gauge_of(model, means)
        for number, (record, first) in enumerate(zip(records, those, strict=True)):
            against = gauge.unexplained(record, first)
            if len(against):
                hard[number] = np.union1d(hard[number], against)
                return False
        return True

    def explained(bounds: np.ndarray) -> bool:
        return all_explained(bounds, firsts)

    def hard_ones(bounds: np.ndarray) -> bool:
        return all_explained(bounds, hard)

    return lowered(trial.bound * LOOSE, explained, reporter(None), hard_ones)
