"""Candidate tests of a monitor: each with the factor that recordings which are left out ask of it, and the
errors that it then sees.

Short windows see jumps, long ones lasting errors; means pay where errors average out and a window is some
times as long; lags remember as long with fewer samples. Each needs bounds of its own. Tests of windows that
are as long share their fits; floats (`gauge`) choose, and the test that is taken is proved afterwards.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxbound.diagnosis.memory import spread_lags
from jaxbound.models.system import LinearSystem
from jaxbound.studies.identification.candidates import FitProblem
from jaxbound.studies.identification.gauge import GaugeJudge, gauge_of, seen_slopes
from jaxbound.studies.identification.left_out import LeftOut, Trial, tried, widest
from jaxbound.studies.identification.means import LOOSE, lowered
from jaxbound.studies.identification.records import Records, parted
from jaxbound.studies.identification.regression import complete_windows, completeness, reached
from jaxbound.studies.identification.sizes import blindness
from jaxbound.text.progress import reporter

__all__ = [
    "AVERAGES",
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

AVERAGES = 0.95
"""Share of the bound of a sample from which on that of a mean says nothing."""
LOOKS = 16
"""Samples that windows with lags look at."""
RAMP = 100
"""Samples after which the size of a ramp counts."""
LOOKED_AT = 0.1
"""Share of complete windows, the only ones that floats look at, below which longer windows are not tried."""


class WindowChoice(NamedTuple):
    """Windows of horizon + 1 samples, of which a test looks at all or at lags, with bounds on the mean of
    `average` errors in a row; None: without. observer: the name of one in place of windows, which looks at
    all samples.
    """

    horizon: int
    lags: tuple[int, ...] | None = None
    average: int | None = None
    observer: str | None = None

    @property
    def about(self) -> dict[str, Any]:
        """The windows as an argument of a LinearSystem."""
        if self.lags is None:
            return {"horizon": self.horizon}
        return {"lags": self.lags}

    @property
    def text(self) -> str:
        """The words for a reader."""
        if self.observer is not None:
            return f"observer {self.observer}"
        if self.lags is not None:
            return f"{len(self.lags)} of {self.horizon + 1} samples"
        if self.average is not None:
            return f"means of {self.average} in {self.horizon + 1} samples"
        return f"{self.horizon + 1} samples"


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
    sure to be seen at this factor and the safety, inf: none; blindness: these sizes as one number, see
    `sizes.blindness`, without the safety. ramp: {output: size} that a ramp has after RAMP samples, likewise.
    In floats, not proved, and of complete windows alone. reach: the share of the samples at which windows
    have a verdict; 0: it does not count.
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


class TriedTest(NamedTuple):
    """A JudgedTest with the fits behind it.

    Fields: judged: the test. trial: of its windows, without averages. means (p,): the smallest bounds of
    means, None without. complete: whether windows that lack samples were none; else floats did not look at
    them.
    """

    judged: JudgedTest
    trial: Trial
    means: np.ndarray | None
    complete: bool


def best_test(tests: Sequence[JudgedTest]) -> JudgedTest:
    """Return the test that sees the smallest errors, the first one of equals."""
    return min(tests, key=_blindness)


def _blindness(test: JudgedTest) -> float:
    return test.blindness


def _blindness_tried(test: TriedTest) -> float:
    return test.judged.blindness


def best_kind(problem: FitProblem, kinds: Sequence[str], records: Records, parts: Records) -> str:
    """Return the one of KINDS whose windows see the smallest errors, as far as floats say."""
    if len(kinds) == 1:
        return kinds[0]
    searched = problem.under(GaugeJudge(), problem.about)
    found = {kind: tried(searched, kind, records, parts).blindness for kind in kinds}
    return min(found, key=found.__getitem__)


def tried_tests(
    records: Records,
    structure: tuple[int, int, bool],
    about: Mapping[str, Any],
    kinds: Sequence[str],
    held_out: float,
    safety: float,
    step: Callable[[float], object],
    wanted: Mapping[str, float],
) -> tuple[TriedTest, ...]:
    """Return the TriedTest of each of WINDOWS that recordings are long enough for, by its best kind.

    Args:
        structure: (order, delay, direct), see `fit`. about: arguments of a LinearSystem beside its matrices
            and windows. kinds: those of KINDS that are tried. held_out, safety: see `fit`. step: called with
            the share of the work done. wanted: as of a FitProblem.

    Raises:
        ValueError: the recordings are too short for any of them.
    """
    order, delay, direct = structure
    problems: dict[int, FitProblem] = {}
    tests: list[TriedTest] = []
    refusal: ValueError | None = None
    can_leave = bool(parted(records, held_out, WINDOWS[0].horizon + 1))
    for number, window in enumerate(WINDOWS):
        horizon = window.horizon
        parts = parted(records, held_out, horizon + 1)
        if horizon <= order or bool(parts) != can_leave:
            continue  # no window, or no part to leave out
        if tests and completeness(records, horizon) < LOOKED_AT:
            continue  # bounds of the few windows that are complete would be too small for the others
        given = dict(about) | window.about
        if horizon not in problems:
            judge = GaugeJudge()
            problems[horizon] = FitProblem.of(records, order, delay, horizon, direct, given, judge, wanted)
        problem = problems[horizon].under(GaugeJudge(), given)
        found = []
        try:
            for kind in kinds:
                found += _judged(problem, window, kind, records, parts, safety)
        except ValueError as e:  # too few samples for windows that are so long
            refusal = refusal or e
        if found:
            tests.append(min(found, key=_blindness_tried))
        step((number + 1) / len(WINDOWS))
    if not tests:
        raise refusal or ValueError(
            f"order {order} is too high for windows of 61 samples: choose a lower one"
        )
    return tuple(tests)


def _judged(
    problem: FitProblem, window: WindowChoice, kind: str, records: Records, parts: Records, safety: float
) -> list[TriedTest]:
    """Return the TriedTest of one of KINDS; none where no error averages out."""
    trial = tried(problem, kind, records, parts)
    left: tuple[LeftOut, ...] = trial.left
    means: dict[str, dict[int, float]] = {}
    smallest: np.ndarray | None = None
    if window.average is not None:
        smallest = searched_means(problem, trial, window.average, records)
        outputs = zip(problem.about["outputs"], smallest.tolist(), trial.bound, strict=True)
        means = {name: {window.average: x} for name, x, b in outputs if x < AVERAGES * b}
        if not means:
            return []
        pairs = zip(left, parts, strict=True)
        left = tuple(one.under(problem.judge, trial.bound, means, [part]) for one, part in pairs)
    factor = widest(left)
    wider = {name: {n: factor * x for n, x in own.items()} for name, own in means.items()}
    model = trial.candidate.model(factor * trial.bound).replace(averages=wider)
    jump, steady = problem.judge.sizes(model, problem.scales)
    judged = JudgedTest(
        window,
        kind,
        factor,
        dict(zip(model.outputs, trial.bound.tolist(), strict=True)),
        {name: x for name, own in means.items() for x in own.values()},
        _times(jump, safety),
        _times(steady, safety),
        blindness(problem.judge, model, problem.scales, problem.spans),
        _times(seen_slopes(model, problem.scales), RAMP * safety),
        reached(records, problem.horizon),
    )
    return [TriedTest(judged, trial, smallest, completeness(records, problem.horizon) == 1)]


def _times(sizes: Mapping[str, float], factor: float) -> dict[str, float]:
    return {name: factor * size for name, size in sizes.items()}


def searched_means(problem: FitProblem, trial: Trial, samples: int, records: Records) -> np.ndarray:
    """Return the smallest bounds (p,) of means, in floats. trial: of windows without averages."""
    model = trial.candidate.model(trial.bound * LOOSE)
    firsts = [complete_windows(u, y, starts, problem.horizon) for u, y, starts in records]
    hard = [first[:0] for first in firsts]  # windows that spoke against bounds before do so again, mostly

    def explained(bounds: np.ndarray) -> bool:
        gauge = gauge_of(_averaged(model, samples, bounds))
        for record, first in zip(records, hard, strict=True):
            if len(gauge.unexplained(record, first)):
                return False
        for number, (record, first) in enumerate(zip(records, firsts, strict=True)):
            against = gauge.unexplained(record, first)
            if len(against):
                hard[number] = np.append(hard[number], against)
                return False
        return True

    return lowered(trial.bound * LOOSE, explained, reporter(None))


def _averaged(model: LinearSystem, samples: int, bounds: np.ndarray) -> LinearSystem:
    """Return a model with bounds (p,) on the means of so many errors in a row."""
    means = {name: {samples: x} for name, x in zip(model.outputs, bounds.tolist(), strict=True)}
    return model.replace(averages=means)
