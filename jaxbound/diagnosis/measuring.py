"""Exact margins of the windows that somebody looks at, where a Result has bounds."""

import numpy as np

from jaxbound.consistency.drive import end_to_end, windows
from jaxbound.consistency.interface import Relations
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.kernel import sparing

TOGETHER = 2**14
"""Windows that are gathered at once."""
LOOKED = 2**16
"""Windows that are searched for the tightest one, before it is the tightest of these."""
FIRST = 64
"""Windows that are searched at first for it; twice as many each further time."""


def exact_margins(
    relations: Relations, method: str, u: np.ndarray, y: np.ndarray, margin: np.ndarray, at: np.ndarray
) -> np.ndarray:
    """Return the exact margins (N,) of some windows; the bound where the search proves less.

    Args:
        u: (..., T, m), y: (..., T, p). margin: (..., T), bounds. at: (N,), numbers of the windows in the flat
            margins, each with a margin.
    """
    test = relations.test(method, y.dtype)
    assert not test.remembers, "no observer"
    test, before = test.measured(), np.arange(-test.horizon, 1)
    flat_u, flat_y = end_to_end(u), end_to_end(y)
    exact: np.ndarray = margin.reshape(-1)[at]
    for first in range(0, len(at), TOGETHER):
        here = slice(first, first + TOGETHER)
        rows = at[here, None] + before
        with sparing():
            found = windows(test, Recording(flat_u[rows], flat_y[rows])).margin[:, -1]
        exact[here] = np.where(found * exact[here] > 0, found, exact[here])
    return exact


def tightest(
    relations: Relations, method: str, u: np.ndarray, y: np.ndarray, margin: np.ndarray
) -> tuple[int, float]:
    """Return (its number in the flat margins, the exact margin) of the window with the smallest margin.

    It is searched until no other window can be tighter.

    Args:
        u, y: as of `exact_margins`. margin: (..., T), bounds that are not above the exact ones, NaN where
            there is none.
    """
    order = np.argsort(margin, axis=None)[: np.count_nonzero(~np.isnan(margin))]
    best, at, done, count = np.inf, int(order[0]), 0, FIRST
    while done < min(len(order), LOOKED) and margin.flat[order[done]] < best:
        some = order[done : done + count]
        exact = exact_margins(relations, method, u, y, margin, some)
        if exact.min() < best:
            at, best = int(some[exact.argmin()]), float(exact.min())
        done, count = done + count, 2 * count
    return at, best
