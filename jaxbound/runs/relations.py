"""The relations that a run tests by, from the name of its method."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from jaxbound.consistency.interface import FAMILIES, METHODS, MONITOR, OBSERVER, Relations
from jaxbound.diagnosis.monitoring import monitor
from jaxbound.estimation.observer import observer
from jaxbound.models.system import LinearSystem
from jaxbound.models.times import refuse_factors
from jaxbound.relations.parity import parity_relations

__all__ = ["is_monitored", "relations_by"]


def is_monitored(
    model: LinearSystem, method: str, horizon: int | None = None, lags: Sequence[int] | None = None
) -> bool:
    """Return whether a run judges by the tests of a model: it has some, and no other test is asked for.

    Args:
        method, horizon, lags: as for `relations_by`.
    """
    return bool(model.tests) and method == METHODS[0] and horizon is None and lags is None


def relations_by(
    method: str,
    model: LinearSystem,
    horizon: int | None = None,
    *,
    lags: Sequence[int] | None = None,
    options: Mapping[str, Any] | None = None,
    progress: Callable[[float], object] | None = None,
) -> Relations:
    """Return the relations of a model for a method: a registered family, an observer, the monitor of its
    tests, or parity relations.

    Args:
        method: the name of a family, "observer", "monitor", or a method of `detect`.
        horizon, lags: as for `parity_relations`; an observer and a family take no lags, a monitor neither.
        options: more keywords of `observer`.
        progress: called with the share of the parity relations that are there.

    Raises:
        ValueError: no relation, or no observer, of this model.
    """
    if method in FAMILIES:
        refuse_factors(model)
        return FAMILIES[method](model, horizon)
    if method == MONITOR:
        return monitor(model, progress=progress)
    if method == OBSERVER:
        return observer(model, **{"horizon": horizon, **(options or {})})
    return parity_relations(model, horizon, lags=lags, progress=progress)
