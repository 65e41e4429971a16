"""The model that a test of a monitor rests on: that of the file, with what is stated for this test alone."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

from jaxbound.models.modelchanges import with_changes
from jaxbound.models.modelfields import model_arguments
from jaxbound.models.modelfile import model_document
from jaxbound.models.statedtests import StatedTest
from jaxbound.models.system import LinearSystem
from jaxbound.models.watched import watched
from jaxbound.models.widths import widened, widened_ends

SAME = ("dt", "inputs", "outputs")


def model_of(model: LinearSystem, test: StatedTest) -> LinearSystem:
    """Return the model that a test rests on, without tests of its own.

    The fields of `test.changes` stand in place of those of the model (of signals by their names, matrices as
    a whole), and the factor is on its tolerance, noise, averages and disturbances; the resolution, which the
    recording itself rounds away, stays. Where a test states bounds, by a factor or by fields of its own, they
    are taken to be found for its windows; else for those of the model.

    Raises:
        ValueError: fields that make no model, other signals or another dt than the model's, a tolerance that
            the factor takes to 1.
    """
    own = model.replace(tests=None)
    try:
        if test.changes:
            own = LinearSystem(**model_arguments(with_changes(model_document(own), test.changes)))
        own = _widened(own, test.factor)
    except (ValueError, TypeError) as e:
        raise ValueError(f"the model of test {test.name!r}: {e}") from None
    # one recording is read for all tests
    for field in SAME:
        if getattr(own, field) != getattr(model, field):
            raise ValueError(
                f"the model of test {test.name!r} has {field} {getattr(own, field)!r}, the file "
                f"{getattr(model, field)!r}: all tests of a monitor judge the same samples"
            )
    if not test.states_bounds:  # a monitor says where a test reaches further than the model's windows
        return own
    if test.lags is not None:
        return own.replace(lags=test.lags)
    if test.horizon is not None:
        return own.replace(horizon=test.horizon)
    return own


def with_tests(model: LinearSystem) -> LinearSystem:
    """Return a model by which recordings are read for its tests: with all columns that these need.

    Raises:
        ValueError: as `model_of`.
    """
    models = [model_of(model, test) for test in model.tests]
    return watched(model, models, [test.when for test in model.tests])


def _widened(model: LinearSystem, factor: Fraction) -> LinearSystem:
    """Return a model whose bounds are so many times as wide; disturbances around their middle."""
    # exactly the model itself: verdicts that are kept are found again
    if factor == 1:
        return model
    changes: dict[str, Any] = {}
    if model.g:
        changes["disturbance"] = model.G, [widened_ends(ends, factor) for ends in model.disturbance]
    means = widened(tuple(average.bound for average in model.averages), factor)
    return model.replace(
        tolerance=widened(model.tolerance, factor),
        noise=widened(model.noise, factor),
        averages=[replace(average, bound=x) for average, x in zip(model.averages, means, strict=True)],
        **changes,
    )
