"""Order and delay of a model, chosen by recordings that are left out as methods are, see `trial`, by a few of
their windows.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np

from jaxbound.studies.identification import regression
from jaxbound.studies.identification.candidates import FitProblem
from jaxbound.studies.identification.gauge import GaugeJudge
from jaxbound.studies.identification.recipe import AUTO, Recipe
from jaxbound.studies.identification.records import Records
from jaxbound.studies.identification.regression import Scales
from jaxbound.studies.identification.structure import delayed
from jaxbound.studies.identification.training import Training
from jaxbound.studies.identification.trial import tried

ORDERS = (1, 2, 3, 4)
DELAYS = (1, 2, 3, 4, 5, 6, 8)
"""Samples from an input to its first effect that are tried."""
ENOUGH = 1.1
"""The first order, and delay, is taken whose errors are seen from at most so many times the best's on."""
CLEARLY = 0.5
"""Share of the errors one step ahead that another delay has to leave to be advised."""
ROOM = 512
"""Windows of a recording that are looked at, at most, spread evenly."""


def settled(training: Training, recipe: Recipe) -> Recipe:
    """Return a recipe with the order and the delay that would see the smallest errors at the bounds that
    recordings which are left out ask for, where these are left to the data.

    First the delay, of models of every order that are fitted one step ahead; then the order, of models that
    are refined over whole windows: one step ahead the noise of sensors asks for more than the plant has.

    Raises:
        ValueError: there are too few samples for any of them.
    """
    if AUTO not in (recipe.order, recipe.delay):
        return recipe
    orders: Sequence[int] = ORDERS if recipe.order == AUTO else (int(recipe.order),)
    delays: Sequence[int] = DELAYS if recipe.delay == AUTO else (int(recipe.delay),)
    window = recipe.window
    orders = [order for order in orders if order < window.horizon]
    plain = dataclasses.replace(recipe, horizon=window.horizon, lags=None, average=None, observer=None)

    def blindness(order: int, delay: int, kind: str) -> float:
        """Return the sizes of errors that are seen, see `FitProblem.blindness`; inf: too few samples."""
        own = dataclasses.replace(plain, order=order, delay=delay)
        try:
            return tried(FitProblem.of(training, own, GaugeJudge(most=ROOM)), kind).blindness
        except ValueError:
            return np.inf

    delay = delays[0]
    if len(delays) > 1:
        pairs = {pair: blindness(*pair, "least squares") for pair in itertools.product(orders, delays)}
        _, delay = _first_good(pairs)
    found = {order: blindness(order, delay, "windows") for order in orders}
    return dataclasses.replace(recipe, order=_first_good(found), delay=delay)


def acting_otherwise(records: Records, order: int, delay: int, direct: bool) -> list[str]:
    """Return a sentence where inputs seem to act sooner or later than the model has it: another delay leaves
    clearly smaller errors one step ahead.
    """
    if not order or not records[0][0].shape[1]:
        return []
    scales = regression.scales_of(records)
    present = _step_error(records, scales, order, delay, direct)
    errors = {(other, False): _step_error(records, scales, order, other, False) for other in DELAYS}
    errors[1, True] = ENOUGH * _step_error(
        records, scales, order, 1, True
    )  # more numbers explain more anyway
    (other, at_once), least = min(errors.items(), key=lambda one: one[1])
    if not least <= CLEARLY * present < np.inf:
        return []
    act, how = f"{other} sample{'s' * (other > 1)} later", f"--recipe delay={other}"
    if at_once:
        act, how = "on outputs of the same sample", "--recipe direct=true"
    return [
        f"inputs seem to act {act}: errors one step ahead are then {least / present:.2f} times as large, and "
        f"bounds may be as much smaller; fit again with {how}"
    ]


def _step_error(records: Records, scales: Scales, order: int, delay: int, direct: bool) -> float:
    """Return the root of the mean square of the errors of one step; inf: too few samples."""
    steps = regression.windows_of(delayed(records, delay), scales, order)
    if len(steps.y) < 2 * (order + 1) * (steps.y.shape[2] + steps.u.shape[2]):
        return np.inf
    return float(np.sqrt(regression.step_error(steps, order, direct) / len(steps.y)))


Choice = TypeVar("Choice", int, tuple[int, int])


def _first_good(found: Mapping[Choice, float]) -> Choice:
    """Return the first choice of those that are not much worse than the best."""
    least = min(found.values())
    if not np.isfinite(least):
        raise ValueError(
            "too few samples for any order: record longer, or choose an order and a shorter horizon"
        )
    return min(choice for choice, blind in found.items() if blind <= ENOUGH * least)
