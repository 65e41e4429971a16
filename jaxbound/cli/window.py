"""The windows that a command tests by, those that --horizon or --lags ask for, or its set observer."""

from collections.abc import Callable

from jaxbound.cli.options import MethodOptions
from jaxbound.consistency.interface import FAMILIES, Relations
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.hints import refuse_short
from jaxbound.relations.parity import ParityRelation, parity_relations
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.runs.relations import relations_by

__all__ = ["parity_windows", "window_relations", "windowed"]


def windowed(model: LinearSystem, horizon: int | None, lags: tuple[int, ...] | None) -> LinearSystem:
    """Return the model with the lags that are asked for, or without its own lags where a horizon is.

    The report keeps the model that this returns.

    Raises:
        ValueError: no lags.
    """
    if lags is not None:
        return model.replace(horizon=None, lags=lags)
    return model if horizon is None or model.lags is None else model.replace(horizon=horizon)


def window_relations(
    model: LinearSystem,
    options: MethodOptions,
    source: object,
    samples: int | None,
    step: Callable[[str, float], object],
) -> tuple[LinearSystem, Relations]:
    """Return (model, relations) of the windows that a command asks for, or (model, observer) of an observer.

    Args:
        options: of the command. source, samples: name and length of the recording, None where nobody knows.
        step: told how far relations are.

    Raises:
        ValueError: a recording without a whole window, windows without a relation; no observer.
    """
    options.check()
    # Parity relations go their own way: lags and a horizon change the model that a report keeps, and a
    # recording that is too short is refused before minutes of elimination.
    if options.method in FAMILIES or options.observes:
        return model, relations_by(options.method, model, options.horizon, options=options.observer_options)
    return parity_windows(model, options, source, samples, step)


def parity_windows(
    model: LinearSystem,
    options: MethodOptions,
    source: object,
    samples: int | None,
    step: Callable[[str, float], object],
) -> tuple[LinearSystem, ParityRelation | UncertainRelations]:
    """Return (model, parity relations) of the windows that a command asks for; arguments and errors as of
    `window_relations`.
    """
    model = windowed(model, options.horizon, options.lags)
    refuse_short(source, samples, model.horizon if options.horizon is None else options.horizon)
    return model, parity_relations(model, options.horizon, progress=lambda share: step("relations", share))
