"""Exact margins of the windows that somebody looks at, where a Result has bounds."""

import numpy as np

from jaxbound.consistency.drive import windows
from jaxbound.consistency.interface import Relations, WindowTest
from jaxbound.recordings.recording import NOWHERE

__all__ = ["exact_margins", "tightest"]

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
    assert isinstance(test, WindowTest)
    s, bounds = test.horizon, margin.reshape(-1)[at]
    rows = at[:, None] + np.arange(-s, 1)
    given = (x.reshape(-1, x.shape[-1])[rows] for x in (u, y))
    found = windows(test.measured(), *given, NOWHERE).margin[:, -1]
    return np.asarray(np.where(found * bounds > 0, found, bounds))


def tightest(
    relations: Relations, method: str, u: np.ndarray, y: np.ndarray, margin: np.ndarray, low: bool
) -> tuple[int, float]:
    """Return (its number in the flat margins, the exact margin) of the window with the smallest margin.

    Args:
        u, y: as of `exact_margins`. margin: (..., T), bounds, NaN at windows that are not asked for. low:
            whether these are lower bounds: then it is searched until no other window can be tighter; else it
            is the tightest of the windows with the smallest bounds.
    """
    order = np.argsort(margin, axis=None)[: np.count_nonzero(~np.isnan(margin))]
    best, at, done, count = np.inf, int(order[0]), 0, FIRST
    while done < min(len(order), LOOKED):
        some = order[done : done + count]
        if low and margin.flat[some[0]] >= best:
            break
        exact = exact_margins(relations, method, u, y, margin, some)
        if exact.min() < best:
            at, best = int(some[exact.argmin()]), float(exact.min())
        if not low:
            break
        done, count = done + count, 2 * count
    return at, best
