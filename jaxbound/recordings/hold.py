"""Recordings that are written when a value changes, as samples that are dt apart: the last value stands for
so long as is stated.

What the recorder does not write, changes below its deadband, is an error within a bound: the deadband, where
it is stated, is a bound of each output, see `models.signals.sensors`.
"""

from collections.abc import Mapping

import numpy as np

from jaxbound.recordings.clockintervals import seconds_of
from jaxbound.recordings.seams import VARIED, Clock, tick

DEADBAND = (
    "values stand for at most {hold} (hold): changes that the recorder did not write are errors: state its "
    "`deadband` beside hold{seen}"
)
INPUTS = (
    "inputs changed by a deadband or more, perhaps {seen}: a model takes them as they are recorded, so that "
    "bounds of disturbances have to hold the rest"
)
NEVER = -1


def last_known(x: np.ndarray) -> np.ndarray:
    """Return (N,) the number of the last cell that holds something, -1 before the first."""
    if x.dtype == object:
        there = np.array([cell is not None for cell in x.tolist()], bool)
    else:
        there = ~np.isnan(x)
    return np.maximum.accumulate(np.where(there, np.arange(len(x)), NEVER))


def held(
    columns: Mapping[str, np.ndarray], time: np.ndarray, grid: np.ndarray, hold: str
) -> dict[str, np.ndarray]:
    """Return columns at other times: the last value before each, missing where that is older than stated.

    Args:
        columns: {name: (N,) floats, or texts as objects}. time: (N,) s, ascending. grid: (K,) s. hold: how
            long a value stands, like "10min".

    Example:
        >>> x = np.array([1.0, np.nan, 3.0])
        >>> held({"x": x}, np.array([0.0, 1.0, 5.0]), np.arange(6.0), "2s")["x"]
        array([ 1.,  1.,  1., nan, nan,  3.])
    """
    before = np.searchsorted(time, grid + 1e-9 * np.abs(grid), side="right") - 1
    out: dict[str, np.ndarray] = {}
    for name, x in columns.items():
        last = np.where(before < 0, NEVER, last_known(x)[np.maximum(before, 0)])
        fresh = (last >= 0) & (grid - time[np.maximum(last, 0)] <= seconds_of(hold) * (1 + 1e-9))
        nothing = np.array(None if x.dtype == object else np.nan, x.dtype)
        out[name] = np.where(fresh, x[np.maximum(last, 0)], nothing)
    return out


def grid_of(time: np.ndarray, dt: float) -> np.ndarray:
    """Return times dt apart, from the first time to the last; those of the rows where most of them are."""
    _, seams = tick(Clock(dt), time)
    if len(seams) <= VARIED * len(time):
        return time
    count = int(np.floor((time[-1] - time[0]) / dt * (1 + 1e-12))) + 1
    grid: np.ndarray = time[0] + np.arange(count) * dt
    return grid
