"""Windows that rounding leaves open far from the boundary, and their strips in whole numbers: exact, whatever
the scales.

Where a sensor has no noise, its bound is what the recorder rounds away: as thin as the rounding of a residual
in floats, which then decides nothing. A strip times all denominators compares integers (`host_rows`),

    |sum_i h_i (hi_i + lo_i) - 2 k v| <= sum_i |h_i| (hi_i - lo_i),

some microseconds for each, so only windows with such a bound come here. Those of a search: `search_on_host`.
"""

import numpy as np

from jaxbound.consistency.host_rows import HostRows
from jaxbound.consistency.interface import Array, LinearRelations
from jaxbound.consistency.reading import Reading
from jaxbound.exact.integers import ratios
from jaxbound.exact.linalg import Matrix, integers
from jaxbound.sets.floats import rounding

THIN = {np.dtype(np.float64): 2.0**26, np.dtype(np.float32): 2.0**12}
"""A bound is thin where it is less than so many roundoffs of its sample: a margin is then uncertain by 1e-6,
or in float32 by 0.01.
"""
BLOCK = 2**12
"""Windows that are asked at once."""


def thin(reading: Reading, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Say which windows u (lags, m, N), y (s + 1, p, N) have a bound so small that rounding leaves some far
    from the boundary open.

    So do windows whose sums may overflow, or bounds near underflow.
    """

    def column(x: Array) -> np.ndarray:
        return np.asarray(x, y.dtype)[:, None]

    offset = column(reading.offset_y)
    size, least = np.fmax.reduce(np.abs(y), 0), np.fmin.reduce(np.abs(y - offset), 0)
    with np.errstate(invalid="ignore"):  # no tolerance of an infinite sample
        noise = column(reading.noise)
        if reading.times:
            noise = noise * _least_factors(reading, u, y)
        bound = noise + column(reading.resolution) + column(reading.tolerance) * least
    small = ~(bound > THIN[y.dtype] * rounding.unit(y.dtype) * (size + np.abs(offset))).all(0)
    # a product of two such samples would overflow
    small |= (size > np.sqrt(np.finfo(y.dtype).max)).any(0)
    small |= (bound < 2.0**40 * rounding.tiny(y.dtype)).any(0)
    return np.asarray(small & finite(u, y))


def finite(u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Say which windows u (lags, m, N), y (s + 1, p, N) have no infinite sample, of which there is no whole
    number.
    """
    return np.asarray(~(np.isinf(y).any((0, 1)) | np.isinf(u).any((0, 1))))


def _least_factors(reading: Reading, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (p, N), the least factor on the noise of each output in windows; 1 where it has none."""
    least = np.ones(y.shape[1:], y.dtype)
    for i in reading.times:
        factor = reading.factor(u, i)
        if factor is not None:
            least[i] = factor.min(0)
    return least


def exact_strip_margins(
    relations: LinearRelations, reading: Reading, strips: tuple[Matrix, Matrix], u: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """Return (N,) margins: > 0 inside, < 0 outside, both proved; 0: a missing input silences a strip; NaN: no
    strip has its data.

    Args:
        relations: of a window; reading: their Reading, whose bounds count. strips: (h, k), exact rows over
            (Y, w) and over U.
        u (lags, m, N), y (s + 1, p, N): samples of N windows, NaN where missing.
    """
    rows, N = HostRows(reading, u, y, model=relations.model), y.shape[2]
    absent, (known, slips, missing) = rows.absent(), rows.known()
    lo, hi = (np.where(absent, 0, x) for x in rows.ends())
    gauge, out, inside = np.full(N, -1.0), np.zeros(N, bool), np.ones(N, bool)
    for exact_h, exact_k in zip(*strips, strict=True):
        whole = np.array(integers((*exact_h, *exact_k))[0], object)
        h, k = whole[: len(exact_h)], whole[len(exact_h) :]
        i, j = np.flatnonzero(h), np.flatnonzero(k)
        h, k = h[i], k[j]
        # both sides twice: hi + lo may be odd, and halves are no whole numbers
        middle = abs(h @ (lo[i] + hi[i]) - 2 * (k @ known[j]))
        width, slip = abs(h) @ (hi[i] - lo[i]), 2 * (abs(k) @ slips[j])
        silent, floor = missing[j].any(0), 2 * rows.floor() * abs(h).sum()
        present = ~(absent[i].any(0) | silent)
        out |= present & (middle - width - slip > floor).astype(bool)
        inside &= ((middle + slip <= width).astype(bool) | ~present) & ~silent
        # the verdict is exact; the size of the margin may be the nearest float
        gauge = np.where(present, np.maximum(gauge, ratios(middle, width)), gauge)
    margin, least = 1 - gauge, np.finfo(y.dtype).eps
    proved = np.where(out, np.minimum(margin, -least), np.where(inside, np.maximum(margin, least), 0))
    return np.where(gauge < 0, np.nan, proved).astype(y.dtype)
