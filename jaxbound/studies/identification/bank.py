"""Several tests from one fit: a monitor whose tests see what the others miss.

The test that sees the smallest errors comes first, see `window_tests`. Each further one earns its place:
beside those before it a jump, a lasting error or a ramp of some output is seen from clearly smaller sizes on,
under bounds as wide as recordings that are left out ask of all of them together. One factor widens the bounds
of all tests, so none is kept because its own was small by luck. A set
observer is tried beside the windows where one is asked for, or bounds of disturbances; it is latched, so that
a lasting error stays a FAULT. A short test also earns its place where a long one has no verdict on many
samples. Each test has the coefficients and the bounds of a fit of its own.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np

from jaxbound.estimation.methods import ObserverMethod, observer_method
from jaxbound.models.modelchanges import changes_between
from jaxbound.models.modelfile import model_document, model_text
from jaxbound.models.statedtests import StatedTest, stated_tests
from jaxbound.models.system import LinearSystem
from jaxbound.models.testmodels import model_of
from jaxbound.studies.identification.advice import blind
from jaxbound.studies.identification.fit_result import FitCheck, Fitted
from jaxbound.studies.identification.following import NOBODY_SAYS
from jaxbound.studies.identification.orders import settled
from jaxbound.studies.identification.recipe import AUTO, Recipe
from jaxbound.studies.identification.search import Unwritten, fitted, unwritten
from jaxbound.studies.identification.training import Training
from jaxbound.studies.identification.trajectories import SETTLED, SMALLER, GivenUp, sure_sizes
from jaxbound.studies.identification.trial import factor_of, largest_of
from jaxbound.studies.identification.window_tests import (
    RAMP,
    JudgedTest,
    WindowChoice,
    best_test,
    tried_tests,
)
from jaxbound.text.progress import in_part

GAIN = 0.8
"""A test earns its place where it sees an error from this share of the size on that the others need."""
SOON = 8
"""Samples within which an observer is to see a jump."""


def fitted_bank(
    training: Training, asked: Recipe, sentences: Sequence[str], report: Callable[[float], object]
) -> Fitted:
    """Return a Fitted for the best windows, whose `tests` are those that earn their places, none of "auto";
    where nothing says what is tested and no part that is left out says how wide bounds must be, for the usual
    windows.

    Args:
        asked: with its observer and its disturbances for a test beside the windows. sentences: on the
            recordings. report: called with the share of the work done.
    """
    biases = [fault for fault in asked.faults if fault.kind == "bias"]
    plain = dataclasses.replace(asked, test=None, observer=None, disturbances=None, see=biases)
    plain = settled(training, plain)
    tried = tried_tests(training, plain, partial(in_part, report, 0.0, 0.25))
    tests = [one.judged for one in tried]
    of_windows = {(one.judged.window, one.judged.method): one for one in tried}

    def fit_for(test: JudgedTest, begin: float, share: float, sentences: Sequence[str] = ()) -> Unwritten:
        """Return the fit for the windows of a test."""
        known, own = of_windows[test.window, test.method], plain.of(test.window, test.method)
        return unwritten(training, own, known, sentences, partial(in_part, report, begin, share))

    best = best_test(tests)
    unsaid = asked.follow == AUTO and not np.isfinite(best.left_out).any()
    windows = fit_for(best, 0.25, 0.15, [*sentences, *([NOBODY_SAYS] * unsaid)])
    if asked.test == AUTO:
        alone = windows.written()
        report(1.0)
        return Fitted(alone, _listing(alone.check, tests, [alone.check.of(best)]))
    observer = asked.observing
    if asked.disturbances is not None and observer is None:
        observer = observer_method("joint")
    if asked.is_open and observer is None and not np.isfinite(windows.trial.own).any():
        return fitted(training, asked, sentences, partial(in_part, report, 0.4, 0.6))
    if not windows.complete:  # windows that lack samples may see less
        tests[tests.index(best)] = best = windows.written().check.of(best)
    watched: Unwritten | None = None
    notes: list[str] = []
    if observer is not None:
        own = dataclasses.replace(plain, observer=observer, disturbances=asked.disturbances, see=asked.faults)
        own = dataclasses.replace(own, method=best.method, follow=0)
        watched = unwritten(training, own, None, (), partial(in_part, report, 0.4, 0.3))
        try:
            tests.append(_judged(watched.written(), observer))
        except GivenUp as end:
            notes.append(
                f"the observer is none of the tests: nothing says what it would see, {end}; {SMALLER}"
            )
    picked = earned(tests, training.days, training.span_of)
    if asked.disturbances is not None and all(test.window.observer is None for test in picked):
        notes.append(
            "the bounds of disturbances are left out: windows alone see errors about as small; a fit for the "
            "observer alone has them, --recipe observer=joint,disturbances=auto"
        )
    fits = [windows]
    for number, test in enumerate(picked[1:]):
        if watched is not None and test.window.observer is not None:
            fits.append(watched)
        else:
            fits.append(fit_for(test, 0.7 + 0.2 * number / len(picked), 0.2 / len(picked)))
    models = [fit.written(fits) for fit in fits]
    base = models[0]
    check, stated = _saying(base.check, *notes), [StatedTest(best.window.text)]
    taken = [base.check.of(best)]
    for test, model in zip(picked[1:], models[1:], strict=True):
        name = test.window.text
        if observer is not None and test.window.observer is not None:
            taken.append(test.times(model.check.factor / test.factor))
            stated.append(test_as_fitted(base, _beside(base, model), name, observer_fields(observer)))
            more = [f"test {name!r}: {x}" for x in model.check.sentences if x not in check.sentences]
            check = dataclasses.replace(_saying(check, *more), tradeoff=model.check.tradeoff)
        else:
            taken.append(model.check.of(test))
            stated.append(test_as_fitted(base, model, name))
        check = _with_sizes(base, check, taken[-1].jump, taken[-1].steady)
    report(1.0)
    if len(stated) == 1:  # the windows of the model
        stated = []
    return Fitted(base.replace(tests=stated), _listing(check, tests, taken))


def _listing(check: FitCheck, tests: Sequence[JudgedTest], taken: Sequence[JudgedTest]) -> FitCheck:
    """Return the check with the tests that were tried: of each windows those taken, else the best."""
    best: dict[WindowChoice, JudgedTest] = {}
    for test in tests:  # in the order in which they were tried
        best[test.window.constant] = best_test([test, best.get(test.window.constant, test)])
    shown: list[JudgedTest] = []
    for window, test in best.items():
        shown += [one for one in taken if one.window.constant == window] or [test]
    return dataclasses.replace(check, tests=tuple(shown))


def _saying(check: FitCheck, *sentences: str) -> FitCheck:
    """Return the check with more sentences."""
    return dataclasses.replace(check, sentences=(*check.sentences, *sentences))


def _with_sizes(
    base: LinearSystem, check: FitCheck, jump: Mapping[str, float], steady: Mapping[str, float]
) -> FitCheck:
    """Return the check of a bank that another test joins, which sees errors from these sizes on."""
    jumps = {name: min(size, jump[name]) for name, size in check.jump.items()}
    lasting = {name: min(size, steady[name]) for name, size in check.steady.items()}
    joined = dataclasses.replace(check, jump=jumps, steady=lasting)
    before = blind(base, check)
    kept = [sentence for sentence in check.sentences if sentence not in before]
    return dataclasses.replace(joined, sentences=(*blind(base, joined), *kept))


def _judged(fitted: Fitted, method: ObserverMethod) -> JudgedTest:
    """Return the JudgedTest of an observer: of errors that no exact test of all samples can miss."""
    check = fitted.check
    jump, lasting, ramp = sure_sizes(fitted, SETTLED, SOON, RAMP)
    window = WindowChoice(0, observer=method.name)
    kind, never = check.method, float("inf")
    # never the best: windows are the model of the file, which verbs that take one test need
    asked = tuple(one.factor for one in check.left_out)
    return JudgedTest(
        window, kind, check.factor, check.smallest, {}, jump, lasting, never, ramp, left_out=asked
    )


def observer_fields(method: ObserverMethod) -> dict[str, Any]:
    """Return the fields of a test by an observer: latched, and what is not as usual of its method."""
    options: dict[str, Any] = {"observer": method.name, "latched": True}
    usual = type(method)()
    for name, value in vars(method).items():
        if value != getattr(usual, name):
            options[name] = int(value)
    return options


def _beside(base: LinearSystem, watched: LinearSystem) -> LinearSystem:
    """Return the model of an observer with the windows of the file, which it does not look at."""
    left_out = watched.left_out or base.left_out  # a field that a test cannot take away
    if base.lags is not None:
        return watched.replace(lags=base.lags, left_out=left_out)
    return watched.replace(horizon=base.horizon, left_out=left_out)


def earned(tests: Sequence[JudgedTest], days: int, spans: Mapping[str, float]) -> tuple[JudgedTest, ...]:
    """Return the best test, and behind it those that beside all before them see clearly smaller errors, at
    the factor that all need together.

    Args:
        days: recordings of the fit. spans: {output: how far it moves}.
    """
    chosen = [best_test(tests)]
    while True:
        before = _sizes(chosen, days, spans)
        joined: list[tuple[float, JudgedTest]] = []
        for test in tests:
            if any(test.window == other.window for other in chosen):
                continue
            sizes = _sizes([*chosen, test], days, spans)
            shares = np.array([sizes[error] / size for error, size in before.items()])
            # what one error gains the wider bounds of all tests must not take from the others
            if shares.min() < GAIN and shares.prod() < 1:
                joined.append((shares.prod(), test))
        if not joined:
            return tuple(chosen)
        chosen.append(min(joined, key=itemgetter(0))[1])


def _sizes(
    tests: Sequence[JudgedTest], days: int, spans: Mapping[str, float]
) -> dict[tuple[str, str], float]:
    """Return {(kind, output): the size from which on one of the tests sees an error}, the span at most, at
    the factor that they need together. A verdict on few samples counts as an error that is seen late.
    """
    factor = factor_of(largest_of([test.left_out for test in tests]), days)
    least: dict[tuple[str, str], float] = {}
    for test in tests:
        sizes = test.times(factor / test.factor).sizes
        for (kind, output), size in sizes.items():
            least[kind, output] = min(size, least.get((kind, output), spans[output]))
    reach = max(test.reach for test in tests)
    if reach:
        least["samples", ""] = 1 / reach
    return least


def test_as_fitted(
    base: LinearSystem, fitted: LinearSystem, name: str, about: Mapping[str, Any] | None = None
) -> StatedTest:
    """Return the test of a model that states a fit of its own: what differs from the base.

    Args:
        base: the model of the file. fitted: for the windows of the test, of the same signals. about: fields
            of the test beside its name and its model.
    """
    if base.extrapolation and not fitted.extrapolation:  # a field that a test cannot take away
        origins = {**fitted.provenance, "extrapolation": "assumed: none left out asks for more"}
        fitted = fitted.replace(extrapolation=1, provenance=origins)
    mine, theirs = (model_document(x.replace(tests=None)) for x in (base, fitted))
    (test,) = stated_tests([{"name": name, **(about or {}), "model": changes_between(mine, theirs)}])
    own = model_of(base, test)
    # a field that one of them lacks would be lost silently
    assert model_text(own.replace(name=base.name)) == model_text(fitted.replace(name=base.name)), name
    return test
