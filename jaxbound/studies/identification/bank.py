"""Several tests from one fit: a monitor whose tests see what the others miss.

The test that sees the smallest errors comes first, see `window_tests`. Each further one earns its place: it
sees a jump or a lasting error of some output from clearly smaller sizes on than all tests before it, under
bounds as wide as recordings that are left out ask of it: a jump, an error that lasts, or a ramp. A set
observer is tried beside the windows where one is asked for, or bounds of disturbances; it is latched, so that
a lasting error stays a FAULT. A short test also earns its place where a long one has no verdict on many
samples. Each test has the coefficients and the bounds of a fit of its own.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from jaxbound.estimation.methods import ObserverMethod, observer_method
from jaxbound.models.modelchanges import changes_between
from jaxbound.models.modelfile import model_document, model_text
from jaxbound.models.statedtests import StatedTest, stated_tests
from jaxbound.models.system import LinearSystem
from jaxbound.models.testmodels import model_of
from jaxbound.studies.identification.advice import WIDE, blind, wide
from jaxbound.studies.identification.fit_result import FitCheck, Fitted
from jaxbound.studies.identification.orders import settled
from jaxbound.studies.identification.recipe import AUTO, Recipe
from jaxbound.studies.identification.search import fitted
from jaxbound.studies.identification.training import Training
from jaxbound.studies.identification.trajectories import SETTLED, SMALLER, GivenUp, sure_sizes
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
    of_windows = {one.judged.window: one for one in tried}

    def fit_for(test: JudgedTest, begin: float, share: float, sentences: Sequence[str] = ()) -> Fitted:
        """Return the fit for the windows of a test; put what it sees beyond complete ones into `tests`."""
        known, own = of_windows[test.window], plain.of(test.window, test.method)
        model = fitted(training, own, known, sentences, partial(in_part, report, begin, share))
        if not known.complete:
            tests[tests.index(test)] = model.check.of(test)
        return model

    base = fit_for(best_test(tests), 0.25, 0.15, sentences)
    check = base.check
    if asked.test == AUTO:
        report(1.0)
        return Fitted(base, dataclasses.replace(check, tests=tuple(tests)))
    observer = asked.observing
    if asked.disturbances is not None and observer is None:
        observer = observer_method("joint")
    if asked.is_open and observer is None and all(math.isnan(one.factor) for one in check.left_out):
        return fitted(training, asked, None, sentences, partial(in_part, report, 0.4, 0.6))
    watched: Fitted | None = None
    if observer is not None:
        own = dataclasses.replace(plain, observer=observer, disturbances=asked.disturbances, see=asked.faults)
        own = dataclasses.replace(own, method=check.method)
        watched = fitted(training, own, None, (), partial(in_part, report, 0.4, 0.3))
        try:
            tests.append(_judged(watched, observer))
        except GivenUp as end:
            why = f"the observer is none of the tests: nothing says what it would see, {end}; {SMALLER}"
            check = _saying(check, why)
    picked = earned(tests)
    is_watched = any(test.window.observer is not None for test in picked)
    if asked.disturbances is not None and not is_watched:
        why = (
            "the bounds of disturbances are left out: windows alone see errors about as small; a fit for the "
            "observer alone has them, --recipe observer=joint,disturbances=auto"
        )
        check = _saying(check, why)
    stated = [StatedTest(picked[0].window.text)]
    share = 0.3 / len(picked)
    for number, test in enumerate(picked[1:]):
        name, jump, steady = test.window.text, test.jump, test.steady
        if watched is not None and observer is not None and test.window.observer is not None:
            stated.append(test_as_fitted(base, _beside(base, watched), name, observer_fields(observer)))
            more = [f"test {name!r}: {x}" for x in watched.check.sentences if x not in check.sentences]
            check = dataclasses.replace(_saying(check, *more), tradeoff=watched.check.tradeoff)
        else:
            model = fit_for(test, 0.7 + number * share, share)
            stated.append(test_as_fitted(base, model, name))
            jump, steady = model.check.jump, model.check.steady
            if model.check.factor > WIDE:
                check = _saying(check, f"test {name!r}: {wide(check, model.check.factor)}")
        check = _with_sizes(base, check, jump, steady)
    report(1.0)
    if len(stated) == 1:  # the windows of the model
        stated = []
    return Fitted(base.replace(tests=stated), dataclasses.replace(check, tests=tuple(tests)))


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
    return JudgedTest(window, kind, check.factor, check.smallest, {}, jump, lasting, never, ramp)


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


def earned(tests: Sequence[JudgedTest]) -> tuple[JudgedTest, ...]:
    """Return the best test, and behind it those that see clearly smaller errors than all before them."""
    chosen = [best_test(tests)]
    sizes = dict(_sizes(chosen[0]))
    while True:
        best = min(tests, key=lambda test: _least_share(test, sizes))
        if not _least_share(best, sizes) < GAIN:
            return tuple(chosen)
        chosen.append(best)
        for error, size in _sizes(best):
            sizes[error] = min(sizes[error], size)


def _least_share(test: JudgedTest, sizes: Mapping[tuple[str, str], float]) -> float:
    """Return the least share of these sizes from which on the test sees an error."""
    return min(size / sizes[error] for error, size in _sizes(test))


def _sizes(test: JudgedTest) -> Iterator[tuple[tuple[str, str], float]]:
    """Yield ((kind, output), size) of the errors that a test sees; beyond any size where it sees none. A
    verdict on few samples counts as an error that is seen late.
    """
    for kind, sizes in (("jump", test.jump), ("steady", test.steady), ("ramp", test.ramp)):
        for output, size in sizes.items():
            yield (kind, output), min(size, 1e300)
    if test.reach:
        yield ("samples", ""), 1 / test.reach


def test_as_fitted(
    base: LinearSystem, fitted: LinearSystem, name: str, about: Mapping[str, Any] | None = None
) -> StatedTest:
    """Return the test of a model that states a fit of its own: what differs from the base.

    Args:
        base: the model of the file. fitted: for the windows of the test, of the same signals. about: fields
            of the test beside its name and its model.
    """
    mine, theirs = (model_document(x.replace(tests=None)) for x in (base, fitted))
    (test,) = stated_tests([{"name": name, **(about or {}), "model": changes_between(mine, theirs)}])
    own = model_of(base, test)
    # a field that one of them lacks would be lost silently
    assert model_text(own.replace(name=base.name)) == model_text(fitted.replace(name=base.name)), name
    return test
