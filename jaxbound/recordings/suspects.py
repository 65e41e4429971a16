"""Columns that are no levels, or none of each row: angles, which jump where they are once around, counters,
which grow until they begin at 0 again, and what is recorded on change. These are hints: no proof uses them.
"""

from collections.abc import Iterator

import numpy as np

from jaxbound.recordings.hints import recorded_step

FEW = 20  # numbers that show nothing yet
TURN = 360.0
ACROSS = 60.0  # how far an angle moves from one sample to the next at most
SOME = 3  # different numbers at either end of a turn: a switch has one
ENDS = 20.0  # of a turn
FALLS = 0.02  # share of steps that may fall in a counter
GROWS = 0.2  # share of steps that grow in one
RARE = 0.5  # share of rows that change, at most, of what is recorded on change
CHANGES, VALUES = 50, 10  # of these, and different numbers: fewer are of what somebody sets
CLOSE = 3.0  # least changes that half of all changes do not exceed: a deadband is just exceeded
NEAR = 0.95  # share of its range that a counter has reached where it runs over
OVER = (256, 1000, 10_000, 32_768, 65_536, 100_000, 1_000_000, 10_000_000, 2**31, 2**32)
"""Numbers at which counters begin at 0 again."""


def suspicions(name: str, column: str, x: np.ndarray) -> Iterator[tuple[str, str]]:
    """Yield ("angle", "counter", "count" or "on change", a sentence) on a signal that is no level, with what
    is to be typed in quotes: the entry of --inputs or --outputs, or an option.

    Args:
        name: of the signal. column: it is taken from. x: (N,) its numbers, NaN where there is none.

    Example:
        >>> list(suspicions("wind", "W", np.arange(340.0, 390.0) % 360))
        [('angle', 'wind jumps from 359 to 0, as an angle does, which is no level: "wind=angle(W)" takes its
        sine and cosine')]
    """
    rows, x = len(x), x[np.isfinite(x)]
    if len(x) < FEW or x.min() == x.max():
        return
    cell = f"`{column}`"
    if column.isidentifier():
        cell = column
    steps = np.diff(x)
    if (steps == steps[0]).all():
        yield "count", f"{name} grows by {steps[0]:.6g} in each row: it counts them, and is no signal"
    elif _is_angle(x, steps):
        at = int(np.argmax(abs(steps) > TURN / 2))
        event = f"{name} jumps from {x[at]:.6g} to {x[at + 1]:.6g}, as an angle does"
        yield "angle", f'{event}, which is no level: "{name}=angle({cell})" takes its sine and cosine'
    elif _is_counter(x, steps):
        falls = int(np.count_nonzero(steps < 0))
        if not falls:
            event, over = f"{name} only grows, from {x.min():.6g} to {x.max():.6g}, as a counter does", ""
        else:
            event, over = f"{name} grows but for {falls} falls, as a counter does", _over(x, steps)
        growth = f'"{name}=rate({cell}{over})" takes its growth in a second'
        yield "counter", f"{event}, which is no level: {growth}"
    elif np.count_nonzero(steps) <= RARE * rows and least_change(x):
        band = f"{least_change(x):.6g}"
        event = f"{name} stands still, or changes by {band} or more, as what is recorded on change does"
        yield "on change", f'{event}: of an output --recording "deadband={name}:{band}" bounds the rest'


def least_change(x: np.ndarray) -> float:
    """Return the least change among numbers, (N,), that a recorder seems to have written when they changed by
    more than its deadband, which is less; 0 of others.

    Example:
        >>> round(least_change(np.cumsum(np.where(np.arange(90) % 4 < 2, 0.51, -0.62))), 6)
        0.51
    """
    x = x[np.isfinite(x)]
    changes = abs(np.diff(x))
    changes = changes[changes > 0]
    if len(changes) < CHANGES or len(np.unique(x)) < VALUES:
        return 0.0
    least = float(changes.min())
    if np.median(changes) > CLOSE * least or least < 2 * recorded_step(x):
        return 0.0
    return least


def _is_angle(x: np.ndarray, steps: np.ndarray) -> bool:
    """Return whether numbers lie within one turn and jump from its one end to the other."""
    low, high = float(x.min()), float(x.max())
    if high - low < TURN - 2 * ENDS or not (0 <= low and high <= TURN or abs(x).max() <= TURN / 2):
        return False
    jumps = abs(steps[abs(steps) > TURN / 2])
    if not len(jumps) or np.mean(TURN - jumps <= ACROSS) < 0.9:
        return False
    ends = x[x < low + ENDS], x[x > high - ENDS]
    return all(len(np.unique(end)) >= SOME for end in ends)


def _is_counter(x: np.ndarray, steps: np.ndarray) -> bool:
    """Return whether whole numbers grow, and fall, if at all, from far up to far down."""
    falls = steps[steps < 0]
    if (x != np.rint(x)).any() or np.mean(steps > 0) < GROWS or len(falls) > FALLS * len(steps):
        return False
    return bool((-falls > (x.max() - x.min()) / 2).all())


def _over(x: np.ndarray, steps: np.ndarray) -> str:
    """Return the second number of a rate, where the falls of a counter are alike and say it."""
    at = np.flatnonzero(steps < 0)
    for over in OVER:
        if NEAR * over <= x[at].min() and x.max() < over and x[at + 1].max() <= (1 - NEAR) * over:
            return f", {over}"
    return ""
