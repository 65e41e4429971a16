"""Shares counted in scenarios: intervals that hold with a stated confidence."""

import numpy as np
from numpy.typing import ArrayLike


def proportion_interval(
    found: ArrayLike, of: ArrayLike, confidence: float = 0.95
) -> tuple[np.ndarray, np.ndarray]:
    """Return (lo, hi) of the true share behind `found` among `of` independent scenarios (Clopper, Pearson).

    It holds with at least the confidence for any share, however few there are: 0 of n gives hi = 1 - ((1 -
    confidence) / 2)^(1/n).

    Args:
        found, of: whole numbers, or arrays of them that broadcast. confidence: in (0, 1).

    Returns:
        Two arrays; (0, 1) where `of` is 0.

    Source: C. Clopper, E. Pearson, Biometrika 26 (1934).
    """
    from scipy.special import betaincinv

    found, of = np.broadcast_arrays(np.asarray(found, float), np.asarray(of, float))
    tail = (1 - confidence) / 2
    lo = np.where(found > 0, betaincinv(np.maximum(found, 1), of - np.minimum(found, of) + 1, tail), 0)
    hi = np.where(found < of, betaincinv(found + 1, np.maximum(of - found, 1), 1 - tail), 1)
    return lo, hi


def rate_interval(
    hits: ArrayLike,
    windows: ArrayLike,
    squares: ArrayLike,
    crossed: ArrayLike,
    squared: ArrayLike,
    scenarios: ArrayLike,
    confidence: float = 0.95,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (rate, lo, hi) of hits / windows where the windows of one scenario depend on each other, but the
    scenarios do not.

    The standard error is that of a ratio of two means over scenarios, times the normal quantile: for many
    scenarios. Where no window or every window is a hit, the spread says nothing: the end is then that of the
    share of scenarios with a hit, or with none missing.

    Args:
        hits, windows: sums over scenarios of their hits h and windows w. squares, crossed, squared: sums of
            h^2, h w, w^2.
        scenarios: how many. confidence: in (0, 1).

    Returns:
        Three arrays; rate NaN where there is no window, lo and hi 0 and 1 for fewer than two scenarios.

    Source: W. Cochran, *Sampling Techniques*, section 6.3.
    """
    from scipy.special import ndtri

    hits, windows, squares, crossed, squared, n = (
        np.asarray(x, float) for x in (hits, windows, squares, crossed, squared, scenarios)
    )
    with np.errstate(all="ignore"):
        rate = hits / windows
        spread = np.maximum(squares - 2 * rate * crossed + rate**2 * squared, 0)  # sum of (h - rate w)^2
        error = ndtri(0.5 + confidence / 2) * np.sqrt(n / (n - 1) * spread) / windows
    few = ~(n > 1) | np.isnan(error)
    lo, hi = np.where(few, 0, np.maximum(rate - error, 0)), np.where(few, 1, np.minimum(rate + error, 1))
    none, all_ = proportion_interval(0, n, confidence)[1], proportion_interval(n, n, confidence)[0]
    return rate, np.where(~few & (hits == windows), all_, lo), np.where(~few & (hits == 0), none, hi)
