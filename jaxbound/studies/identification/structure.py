"""Order and delay of a model, by recordings that are left out.

Models are fitted to all recordings but one in turn. The largest window
residual of what was left out stands for the bound, and the smallest jump and lasting error that exceed it
anywhere stand for what would be seen: the same quantity by which methods are chosen, with another norm and
without a test, a thousand times as fast.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from jaxbound.studies.identification import regression
from jaxbound.studies.identification.recipe import AUTO, Recipe
from jaxbound.studies.identification.records import Record, Records, parted
from jaxbound.studies.identification.regression import CompleteWindows, Scales, courses
from jaxbound.studies.identification.training import Training

__all__ = ["DELAYS", "ORDERS", "acting_otherwise", "chained", "delayed", "settled"]

ORDERS = (1, 2, 3, 4)
DELAYS = (1, 2, 3, 4, 5, 6, 8)
"""Samples from an input to its first effect that are tried."""
ENOUGH = 1.1
"""The first order, and delay, is taken whose errors are seen from at most so many times the best's on."""
CLEARLY = 0.5
"""Share of the errors one step ahead that another delay has to leave to be advised."""
ROOM = 512
"""Windows that are looked at, at most, spread evenly: one compilation an order."""


def delayed(records: Records, delay: int) -> Records:
    """Return recordings with the inputs of delay - 1 samples before; NaN where nobody recorded them."""
    return [_delayed(record, delay - 1) for record in records]


def _delayed(record: Record, samples: int) -> Record:
    u, y, starts = record
    if not samples:
        return record
    late = np.full_like(u, np.nan)
    late[samples:] = u[: max(len(u) - samples, 0)]
    for start in np.asarray(starts, int):  # nor do inputs cross a gap
        late[start : start + samples] = np.nan
    return late, y, starts


def chained(spec: dict[str, Any], delay: int) -> dict[str, Any]:
    """Return arguments of a LinearSystem whose inputs act `delay` samples later, where those of `spec` act
    one later: each input waits in delay - 1 states.
    """
    if delay == 1 or spec["B"] is None:
        return spec
    A, B, C = (np.asarray(spec[name], float) for name in "ABC")
    (n, m), waiting = B.shape, (delay - 1) * B.shape[1]
    whole = np.zeros((n + waiting, n + waiting))
    whole[:n, :n] = A
    whole[:n, n + waiting - m :] = B
    whole[n + m :, n : n + waiting - m] = np.eye(waiting - m)
    enters = np.zeros((n + waiting, m))
    enters[n : n + m] = np.eye(m)
    return spec | {"A": whole, "B": enters, "C": np.hstack([C, np.zeros((len(C), waiting))])}


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
    parts = parted(training.records, recipe.held_out, recipe.window.horizon + 1)
    orders = [order for order in orders if order < recipe.window.horizon]
    delay = delays[0]
    if len(delays) > 1:
        pairs = {}
        for order, other in itertools.product(orders, delays):
            tried = dataclasses.replace(recipe, order=order, delay=other)
            pairs[order, other] = _Trained(training, parts, tried, is_refined=False).blindness
        _, delay = _first_good(pairs)
    found = {}
    for order in orders:
        tried = dataclasses.replace(recipe, order=order, delay=delay)
        found[order] = _Trained(training, parts, tried, is_refined=True).blindness
    return dataclasses.replace(recipe, order=_first_good(found), delay=delay)


def acting_otherwise(records: Records, order: int, delay: int, direct: bool) -> list[str]:
    """Return a sentence where inputs seem to act sooner or later than the model has it: another delay leaves
    clearly smaller errors one step ahead.
    """
    if not order or not records[0][0].shape[1]:
        return []
    scales = regression.scales_of(records)
    present = _step_error(records, scales, order, delay, direct)
    tried = {(other, False): _step_error(records, scales, order, other, False) for other in DELAYS}
    tried[1, True] = ENOUGH * _step_error(records, scales, order, 1, True)  # more numbers explain more anyway
    (other, at_once), least = min(tried.items(), key=lambda one: one[1])
    if not least <= CLEARLY * present < np.inf:
        return []
    act, how = f"{other} sample{'s' * (other > 1)} later", f"--recipe delay={other}, delay={other}"
    if at_once:
        act, how = "on outputs of the same sample", "--recipe direct=true, direct=True"
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


@dataclass(frozen=True, eq=False)
class _Trained:
    """Models of an order and a delay, of all recordings and of all but one in turn.

    Fields: parts: of the recordings, left out in turn; []: nothing is. is_refined: whether over whole
    windows; else one step ahead.
    """

    training: Training
    parts: Records
    recipe: Recipe
    is_refined: bool

    @property
    def blindness(self) -> float:
        """The sizes of errors that are seen, see `FitProblem.blindness`, by residuals; inf: too few
        samples.
        """
        order, delay, direct = int(self.recipe.order), int(self.recipe.delay), self.recipe.direct
        records, scales = delayed(self.training.records, delay), self.training.scales
        theta = self._fitted(records)
        if theta is None:
            return np.inf
        largest = [np.full(len(scales.y), 1e-9)]
        for others, own in _left_out(records, delayed(self.parts, delay)):
            trained, windows = self._fitted(others), self._windows(own)
            if trained is not None and len(windows.y):
                left = regression.window_residuals(trained, windows, order, direct)
                largest.append(np.abs(left).max((0, 1)))
        return self._seen(theta, np.max(largest, 0), np.array(self.training.spans) / scales.y_spread)

    def _windows(self, records: Records) -> CompleteWindows:
        return regression.windows_of(records, self.training.scales, self.recipe.window.horizon, ROOM)

    def _fitted(self, records: Records) -> np.ndarray | None:
        """Return the coefficients; None where samples are too few."""
        order, direct = int(self.recipe.order), self.recipe.direct
        steps, windows = regression.windows_of(records, self.training.scales, order), self._windows(records)
        inputs = steps.u.shape[2]
        unknowns = order * (steps.y.shape[2] + inputs) + direct * inputs + 1
        if len(steps.y) < 2 * unknowns or not len(windows.y):
            return None
        theta = regression.least_squares(steps, order, direct)
        if self.is_refined:
            theta, _ = regression.refined(theta, windows, order, direct)
        return theta

    def _seen(self, theta: np.ndarray, bound: np.ndarray, spans: np.ndarray) -> float:
        """Return the sizes of a jump and of a lasting error whose residuals exceed twice the bounds (p,),
        summed over outputs, in their spreads; spans (p,): the most that counts.
        """
        order, direct = int(self.recipe.order), self.recipe.direct
        count, p = self.recipe.window.horizon + 1, len(bound)
        acts = courses(count - 1)
        wrong = (acts[:, None, :, None] * np.eye(p)[None, :, None]).reshape(2 * p, count, p)
        windows = CompleteWindows(
            np.zeros((2 * p, count, len(self.training.inputs))), wrong, np.zeros(2 * p, int)
        )
        alone = theta.copy()
        alone[-1] = 0  # the response to the error, without the constant
        left = np.abs(regression.window_residuals(alone, windows, order, direct)) / bound
        shown = np.maximum(left.max((1, 2)), 1e-12).reshape(2, p)
        return float(np.minimum(2 / shown, spans).sum())


def _left_out(records: Records, parts: Records) -> Iterator[tuple[Records, Records]]:
    """Yield (all others, one) of the parts, or the recordings twice where there are none."""
    if not parts:
        yield records, records
    for number in range(len(parts)):
        yield [*parts[:number], *parts[number + 1 :]], parts[number : number + 1]
