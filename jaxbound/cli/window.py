"""What a command tests by: windows of the model, those that --horizon or --lags ask for, or a set
observer.
"""

import argparse
from collections.abc import Callable
from typing import Any

from jaxbound.consistency.interface import FAMILIES
from jaxbound.estimation.observer import observer
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.hints import refuse_short
from jaxbound.relations.parity import parity_relations

__all__ = ["OBSERVER", "observer_options", "refuse_options", "windowed", "window_relations"]

OBSERVER, JOINT = "observer", "joint"


def observer_options(args: argparse.Namespace) -> dict[str, Any]:
    """Return what the arguments of a command say of an observer, as `jb.observer` takes it: only what differs
    from its defaults.

    Args:
        args: .method, and of an observer .horizon, .order, .observer, .span (None: the default), .latched;
            other methods have none.
    """
    if args.method != OBSERVER:
        return {}
    given = {"order": args.order, "horizon": args.horizon, "restart": False if args.latched else None}
    given |= {"method": args.observer, "window": args.span}
    return {name: value for name, value in given.items() if value is not None}


def refuse_options(args: argparse.Namespace) -> None:
    """Raise ValueError for an option that the method of a command does not take."""
    if getattr(args, "method", None) == OBSERVER:
        if args.lags is not None:
            raise ValueError("--lags is for windows: an observer looks at every sample")
        if args.span is not None and args.observer != JOINT:
            raise ValueError(f"--span is for --observer {JOINT}")
        if args.span is not None and args.span % 2:
            raise ValueError(f"--span needs an even number of samples, not {args.span}")
    elif given := [
        option for option in ("order", "latched", "observer", "span") if getattr(args, option, None)
    ]:
        raise ValueError(f"--{given[0]} is for --method {OBSERVER}")


def windowed(model: LinearSystem, horizon: int | None, lags: tuple[int, ...] | None) -> LinearSystem:
    """Return the model with the lags that are asked for, or without its own where a horizon is: so it is kept
    beside what was found.

    Raises:
        ValueError: no lags.
    """
    if lags is not None:
        return model.replace(horizon=None, lags=lags)
    return model if horizon is None or model.lags is None else model.replace(horizon=horizon)


def window_relations(
    model: LinearSystem,
    args: argparse.Namespace,
    source: object,
    samples: int | None,
    step: Callable[[str, float], object],
) -> tuple[LinearSystem, Any]:
    """Return (model, relations) of the windows that a command asks for, or (model, observer) with --method
    observer.

    Args:
        args: .horizon, .lags, and where the command has them .method, .order, .latched, .observer, .span.
            source, samples: name and length of the recording, None where nobody knows. step: told how far
                relations are.

    Raises:
        ValueError: a recording without a whole window, windows without a relation; no observer.
    """
    refuse_options(args)
    method = getattr(args, "method", None)
    if method in FAMILIES:
        return model, FAMILIES[method](model, args.horizon)
    if method == OBSERVER:
        return model, observer(model, **observer_options(args))
    model = windowed(model, args.horizon, args.lags)
    refuse_short(source, samples, model.horizon if args.horizon is None else args.horizon)
    return model, parity_relations(model, args.horizon, progress=lambda share: step("relations", share))
