"""A monitor of a plant: the tests that its model file states, behind one verdict."""

from collections.abc import Callable
from functools import partial
from os import PathLike
from typing import Any, TypeAlias

from jaxbound.consistency.interface import Relations, Watch
from jaxbound.consistency.monitorbank import MonitorBank
from jaxbound.diagnosis.memory import suggest_lags
from jaxbound.estimation.methods import OBSERVERS
from jaxbound.estimation.observer import observer
from jaxbound.exact.price import SECONDS
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.modelfile import load_model
from jaxbound.models.statedtests import StatedTest, StatedTests
from jaxbound.models.system import LinearSystem
from jaxbound.models.testmodels import model_of
from jaxbound.relations.cost import relation_cost
from jaxbound.relations.parity import parity_relations
from jaxbound.text.progress import Progress, in_part, reporter

Watchable: TypeAlias = Relations | ModelLike | str | PathLike[str]
"""What `detect` takes: relations, an observer, a monitor; or a plant, which its own monitor watches."""

HORIZON = 15
"""Of a model that states no windows, where nothing says which would see more."""


def monitor(
    model: ModelLike | str | PathLike[str],
    tests: StatedTests | None = None,
    progress: Callable[[float], object] | None = None,
) -> MonitorBank:
    """Return the monitor of a plant, for `detect`, `Monitor` and the shell: several tests, one verdict.

    A sample is FAULT where any of the tests proves it. Each test has its own windows, lags or observer, its
    own factor on the bounds, its own numbers where it states some, and a condition under which it holds.

    Args:
        model: a LinearSystem, the path of its file, or a discrete state-space object of python-control or
            scipy.signal. tests: as the `[[test]]` tables of the file have them,
            [{"name": "short", "horizon": 15}, {"name": "slow", "observer": "joint", "factor": 1.2, "when":
            "fan > 0"}]; None: those of the model, or its windows where it states none. Of a model that states
            neither: its shortest windows, and beside them the lags of `suggest_lags`, or windows of 16
            samples where nothing says which lags see an error; uncertain models have the shortest alone.
        progress: called with the share of the tests that are there.

    Returns:
        A MonitorBank. What `detect` returns has .tests, the Result of each test by its name, and .by, the
        number of the test that speaks at each sample.

    Raises:
        OSError: no file. TypeError: no model. ValueError: tests=[], or one that is none, see `LinearSystem`;
            numbers that make no model; a model without a relation, or without an observer.

    Encloses: FAULT is a proof. Where a condition has no value, it is claimed only where every condition that
        may hold has a test that proves it, and one of the conditions is "otherwise".

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.9]], [[1]], [[1]], noise=0.1)
        >>> tests = [{"name": "jumps", "horizon": 1}, {"name": "drifts", "horizon": 4, "factor": 1.5}]
        >>> res = jb.detect(jb.monitor(m, tests), [[0.0]] * 6, [[9], [8.1], [7.3], [6.6], [5.9], [5.9]])
        >>> [jb.Status(s).name for s in res.status], res.test_at(5)
        (['MISSING', 'CONSISTENT', 'CONSISTENT', 'CONSISTENT', 'CONSISTENT', 'FAULT'], 'jumps')
    """
    if isinstance(model, str | PathLike):
        model = load_model(model)
    model = as_model(model, factors=True)
    if tests is not None:
        model = model.replace(tests=tests)
    elif not model.tests:
        model = model.replace(tests=_usual_tests(model))
    if not model.tests:
        raise ValueError(
            'a monitor needs tests: tests=[] has none; give [{"name": "short", "horizon": 15}, ..], or leave '
            "it out"
        )
    report = reporter(progress, "monitor")
    watches = []
    for i, test in enumerate(model.tests):
        try:
            part = partial(in_part, report, i / len(model.tests), 1 / len(model.tests))
            relations = relations_of_test(model, test, part)
        except (ValueError, TypeError) as e:
            raise ValueError(f"test {test.name!r}: {e}") from None
        about = test.words(relations.horizon + 1)
        watches.append(Watch(test.name, relations, test.when, about))
        report((i + 1) / len(model.tests))
    return MonitorBank(model, watches)


def _usual_tests(model: LinearSystem) -> list[dict[str, Any]]:
    """Return the tests, as a file has them, of a model that states none: its windows; where it states none
    of these either the shortest ones, which soon have a verdict, and long ones, which see small errors.
    """
    shortest: dict[str, Any] = {"name": "windows"}
    if model.horizon is not None or model.uncertainties:
        return [shortest]
    try:
        return [shortest, {"name": "lags", "lags": list(suggest_lags(model))}]
    except ValueError:  # sizes need an operating range, or nothing lasting is sure to be seen
        if relation_cost(model, HORIZON)[0] < SECONDS:
            return [shortest, {"name": "long", "horizon": HORIZON}]
        return [shortest]


def relations_of_test(model: LinearSystem, test: StatedTest, progress: Progress | None = None) -> Relations:
    """Return the parity relations, or the observer, of one test of a model.

    Args:
        model, test: that states it. progress: called with the share of the relations that are there.

    Raises:
        ValueError: as `monitor`.
    """
    own = model_of(model, test)
    if test.observer is None:
        horizon = test.horizon
        if test.lags is not None:
            return parity_relations(own, lags=test.lags, progress=progress)
        return parity_relations(own, horizon, progress=progress)
    return observer(own, test.observer, **observer_keywords(test))


def observer_keywords(test: StatedTest) -> dict[str, Any]:
    """Return the options of a test by an observer as keywords of `observer`.

    Raises:
        ValueError: one of another observer.
    """
    options = dict(test.options)
    kind = OBSERVERS.get(test.observer or "")
    if kind is not None and "window" in options and not hasattr(kind, "window"):
        raise ValueError(f"window is no option of the observer {test.observer!r}")
    options["restart"] = not options.pop("latched", False)
    if "weight" in options:
        options["weight"] = [float(x) for x in options["weight"]]
    return options
