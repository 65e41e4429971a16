"""Which windows a command tests: those of the model, or those that --horizon or --lags ask for."""

import argparse
from collections.abc import Callable
from typing import Any

from jaxbound.models.system import LinearSystem
from jaxbound.recordings.hints import refuse_short
from jaxbound.relations.parity import parity_relations

__all__ = ["windowed", "window_relations"]


def windowed(model: LinearSystem, horizon: int | None, lags: tuple[int, ...] | None) -> LinearSystem:
    """Return the model with the lags that are asked for, or without its own where a horizon is: so it is kept beside what was found.

    Raises:
        ValueError: no lags.
    """
    if lags is not None:
        return model.replace(horizon=None, lags=lags)
    return model if horizon is None or model.lags is None else model.replace(horizon=horizon)


def window_relations(
    model: LinearSystem, args: argparse.Namespace, source: object, samples: int | None, step: Callable[[str, float], object]
) -> tuple[LinearSystem, Any]:
    """Return (model, relations) of the windows that a command asks for.

    Args:
        args: .horizon, .lags. source, samples: name and length of the recording, None where nobody knows. step: told how far relations are.

    Raises:
        ValueError: a recording without a whole window, windows without a relation.
    """
    model = windowed(model, args.horizon, args.lags)
    refuse_short(source, samples, model.horizon if args.horizon is None else args.horizon)
    return model, parity_relations(model, args.horizon, progress=lambda share: step("relations", share))
