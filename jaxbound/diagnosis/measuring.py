"""Exact margins of the windows that somebody looks at, where a Result has bounds."""

import numpy as np

from jaxbound.consistency.drive import end_to_end, windows
from jaxbound.consistency.interface import Judged, Relations, WindowTest
from jaxbound.recordings.recording import NOWHERE
from jaxbound.sets.floats.kernel import sparing

__all__ = ["exact_margins", "judged_at", "tightest"]

TOGETHER = 2**14
"""Windows that are gathered at once."""
LOOKED = 2**16
"""Windows that are searched for the tightest one, before it is the tightest of these."""
FIRST = 64
"""Windows that are searched at first for it; twice as many each further time."""


def judged_at(test: WindowTest, u: np.ndarray, y: np.ndarray, at: np.ndarray) -> Judged:
    """Return the verdicts (N,) of the windows that end at some samples, by a test of windows.

    Args:
        u (T, m), y (T, p): samples in which those windows lie as a whole. at: (N,).
    """
    before = np.arange(-test.horizon, 1)
    status, margin = np.zeros(len(at), np.int8), np.zeros(len(at), y.dtype)
    for first in range(0, len(at), TOGETHER):
        here = slice(first, first + TOGETHER)
        rows = at[here, None] + before
        with sparing():
            judged = windows(test, u[rows], y[rows], NOWHERE)
        status[here], margin[here] = judged.status[:, -1], judged.margin[:, -1]
    return Judged(status, margin)


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
    found = judged_at(test.measured(), end_to_end(u), end_to_end(y), at).margin
    bound: np.ndarray = margin.reshape(-1)[at]
    return np.where(found * bound > 0, found, bound)


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
