"""From one recipe to a fitted model: what it leaves open is tried, by recordings that are left out, and the
best is verified by the proved test.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter

import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.recordings.signals import Signals
from jaxbound.studies.identification import advice
from jaxbound.studies.identification.bounds import verified
from jaxbound.studies.identification.candidates import FitProblem
from jaxbound.studies.identification.closed_loop import closed_loops
from jaxbound.studies.identification.disturbances import chosen_disturbances
from jaxbound.studies.identification.fit_result import FitCheck, Fitted, PartLeftOut, Tradeoff
from jaxbound.studies.identification.following import NOBODY_SAYS, weights_of
from jaxbound.studies.identification.gauge import GaugeJudge
from jaxbound.studies.identification.judging import ObserverJudge, WindowJudge, explains
from jaxbound.studies.identification.means import smallest_means
from jaxbound.studies.identification.orders import acting_otherwise, settled
from jaxbound.studies.identification.outliers import refuse_outliers
from jaxbound.studies.identification.recipe import AUTO, Recipe
from jaxbound.studies.identification.training import Training
from jaxbound.studies.identification.trajectories import SETTLED, SMALLER, GivenUp, hidden_jumps
from jaxbound.studies.identification.trial import Trial, tried
from jaxbound.studies.identification.window_tests import RAMP, TriedTest, best_kind, searched_means
from jaxbound.text.progress import in_part


def on_recordings(training: Training, recipe: Recipe) -> list[str]:
    """Return sentences on what recordings tell, whatever is fitted to them.

    Raises:
        ValueError: signals that stand still, outliers.
    """
    records, inputs, outputs = training.records, training.inputs, training.outputs
    resting = advice.inputs_at_rest(records, inputs, outputs, recipe.window.horizon)
    signals = Signals(inputs, outputs, dict(training.columns), training.dt)
    order, delay = (1 if x == AUTO else max(int(x), 1) for x in (recipe.order, recipe.delay))
    return [
        *refuse_outliers(records, signals, order, delay, training.again),
        *resting,
        *advice.inputs_together(records, inputs),
        *advice.apart(records, inputs, outputs),
        *closed_loops(records, inputs, outputs),
    ]


@dataclass(frozen=True, eq=False)
class Unwritten:
    """A fit of one test whose bounds are not written yet.

    Fields: trial: its smallest bounds, and what each recording that is left out asks for. safety: on top of
    that. complete: whether floats looked at all windows of other tests. sentences: on recordings and bounds.
    """

    problem: FitProblem
    trial: Trial
    safety: float
    complete: bool
    tradeoff: tuple[Tradeoff, ...]
    sentences: tuple[str, ...]

    def written(self, beside: Sequence["Unwritten"] = ()) -> Fitted:
        """Return the fit with verified bounds. beside: tests that are written with the same factor."""
        problem, training, sentences = self.problem, self.problem.training, list(self.sentences)
        trial = dataclasses.replace(self.trial, beside=tuple(one.trial.own for one in beside))
        # a safety that the wanted faults allow is one on bounds as wide as this test alone asks for
        safety = max(problem.recipe.safety, self.safety * self.trial.factor / trial.factor)
        # few digits are what a user reads in the model file: what is verified is what is saved
        model, used = verified(problem.judge, trial, training, safety)
        hidden: dict[str, float] = {}
        observer = problem.recipe.observing
        if observer is not None and observer.sharp:
            try:
                hidden = hidden_jumps(model, SETTLED, RAMP)
            except GivenUp as end:
                sentences.append(f"what noise may hide from any test is not known: {end}; {SMALLER}")
        check = _check(problem, trial, model, used, safety)
        check = dataclasses.replace(check, tradeoff=self.tradeoff, hidden=hidden)
        if not self.complete:
            sentences.append(advice.COMPLETE_ONLY)
        sentences += advice.data_limits(model, check, problem.recipe.held_out)
        sentences += advice.alike(training.records, training.inputs, check)
        sentences = [*advice.blind(model, check), *sentences]
        return Fitted(model, dataclasses.replace(check, sentences=tuple(sentences)))


def fitted(
    training: Training, recipe: Recipe, sentences: Sequence[str], report: Callable[[float], object]
) -> Fitted:
    """Return the fit of one test, see `unwritten`."""
    return unwritten(training, recipe, None, sentences, report).written()


def unwritten(
    training: Training,
    recipe: Recipe,
    taken: TriedTest | None,
    sentences: Sequence[str],
    report: Callable[[float], object],
) -> Unwritten:
    """Return the fit of one test.

    Args:
        recipe: its test is None. taken: its windows as they were tried; None: no others were. sentences: on
            the recordings.
    """
    recipe = settled(training, recipe)
    acting = acting_otherwise(training.records, int(recipe.order), int(recipe.delay), recipe.direct)
    sentences = [*sentences, *acting]
    observer = recipe.observing
    judge = WindowJudge() if observer is None else ObserverJudge(observer)
    problem = FitProblem.of(training, recipe, judge)
    report(0.05)

    safety, progress = recipe.safety, partial(in_part, report, 0.05, 0.75)
    tradeoff: tuple[Tradeoff, ...] = ()
    if recipe.disturbances is not None:
        best, safety, tradeoff, unseen = chosen_disturbances(problem, progress)
        sentences += unseen
    elif taken is not None and taken.complete:
        best = taken.trial.under(GaugeJudge(every=True), problem.parts)
    else:
        best, more = _best(problem, progress)
        sentences += more
        if recipe.average is not None:
            best = _with_means(problem, best, partial(in_part, report, 0.8, 0.1))
    if recipe.average is not None:
        unsaid = [name for name in training.outputs if name not in best.averages]
        sentences += [advice.no_average(name, recipe.average) for name in unsaid]

    complete = taken is None or taken.complete
    report(1.0)
    return Unwritten(problem, best, safety, complete, tradeoff, tuple(sentences))


def _best(problem: FitProblem, step: Callable[[float], object]) -> tuple[Trial, list[str]]:
    """Return (trial, sentences): of the kind, and with bounds that follow as strongly, as sees most."""
    recipe, follow, kinds = problem.recipe, problem.recipe.follow, problem.kinds
    if recipe.observer is None and not follow:  # the proved test for the best of them alone
        kinds = [best_kind(problem)]
    trials = []
    for number, kind in enumerate(kinds):
        trials.append(tried(problem, kind))
        step((number + 1) / len(kinds))
    best = min(trials, key=attrgetter("blindness"))  # the first one of equals
    if not follow:
        return best, []
    if follow == AUTO and not np.isfinite(best.own).any():
        return best, [NOBODY_SAYS]
    following = [tried(problem, best.candidate.kind, weight) for weight in weights_of(follow)]
    if follow != AUTO:
        return following[0], []
    return min([best, *following], key=attrgetter("blindness")), []


def _with_means(problem: FitProblem, trial: Trial, step: Callable[[float], object]) -> Trial:
    """Return a trial with proved bounds of means."""
    samples = problem.recipe.average
    assert samples is not None, "bounds of means are asked for"
    model = LinearSystem(**trial.candidate.spec)
    explained = partial(explains, parts=problem.training.records)
    guess = searched_means(problem, trial)
    means = smallest_means(model, trial.bound, samples, explained, step, guess)
    return dataclasses.replace(trial, average=samples, means=means).under(problem.judge, problem.parts)


def _check(
    problem: FitProblem, trial: Trial, model: LinearSystem, used: Sequence[np.ndarray], safety: float
) -> FitCheck:
    """Return the check of a model with verified bounds."""
    training, factor = problem.training, trial.factor
    jump, steady = problem.sizes(model, trial.follows.most)
    left, recordings = [], []
    for one, asked in zip(trial.left, trial.asked, strict=True):
        left.append(PartLeftOut(int(np.isfinite(one.need).sum()), asked, one.why))
    for (_, y, _), share in zip(training.records, used, strict=True):
        finite = share[np.isfinite(share)]
        largest = float(finite.max()) if len(finite) else math.nan
        recordings.append({"samples": len(y), "windows": len(finite), "used": largest})
    means = [] if trial.means is None else trial.means.tolist()
    return FitCheck(
        method=trial.candidate.kind,
        order=problem.order,
        delay=problem.delay,
        factor=factor,
        safety=float(safety),
        smallest=dict(zip(training.outputs, trial.bound.tolist(), strict=True)),
        smallest_mean=dict(zip(training.outputs, means, strict=False)),
        held_out=_held_out_summary([one.need / safety for one in trial.left]),
        left_out=tuple(left),
        recordings=tuple(recordings),
        used=tuple(used),
        held_out_used=tuple(one.need / (factor * safety) for one in trial.left),
        jump=jump,
        steady=steady,
        follows=trial.follows,
        moved=training.span_of,
    )


def _held_out_summary(shares: Sequence[np.ndarray]) -> dict[str, float] | None:
    """Return the verdicts on held-out windows, each given by the share of the bounds that it needs."""
    every = np.concatenate([*shares, [np.nan]])
    every = every[np.isfinite(every)]
    if not len(every):
        return None
    return {"windows": len(every), "fault": float((every > 1).mean()), "growth": float(every.max())}
