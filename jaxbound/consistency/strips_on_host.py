"""Strips once more, in NumPy: which of them contradict a window, from the samples, with nothing that XLA has
worked out.

A row i lies in [lo_i, hi_i]: a true output, by its reading y = (1 + theta) t + delta with |theta| <= sigma,
|delta| <= rho, between -f(rho - d) and f(rho + d), d = y - offset, f(v) = max(v / (1 - sigma), v / (1 +
sigma)); a disturbance or an average by its bound. So

    least = sum_i min(h_i lo_i, h_i hi_i) - k v  <=  0  <=  sum_i max(h_i lo_i, h_i hi_i) - k v = most
    (strip)

in every behaviour, and least > error or most < -error contradicts.

**The error.** Sums are in float64, one rounding u an operation. d is off by 2 u (|y| + |offset|), f(rho + d)
by 8 u S with S = (|y| + |offset| + rho) / (1 - sigma): 5 for f and the sum, 1 for rho. A product with a
rounded h adds 2, a sum of N terms N - 1: together less than half of what `rounding.residual_error` states for
N terms. S, and what the recorder rounded away, are those of the largest sample of a block: never too small,
and one number for all its windows.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxbound.models.rows import Kind
from jaxbound.models.sensor import RECORDER_ULPS, input_slip
from jaxbound.sets.floats import rounding

__all__ = ["HostStrips", "contradicted_by", "host_strips"]

BLOCK = 2**13
"""Windows at once: their rows stay in the cache."""
DENSE = 4
"""Windows are gathered where fewer than one in so many is asked for, else cut out as stretches."""


@dataclass(frozen=True)
class _Series:
    """Bounds of rows over a block of samples.

    Fields: lo, hi: arrays over samples, or numbers; size: what rounding errors are relative to.
    """

    lo: Any
    hi: Any
    size: float


@dataclass(frozen=True)
class HostStrips:
    """Strips and the bounds of a relation in float64, for NumPy. Build it with `host_strips`.

    Fields: strips: ((numbers of rows, coefficients, numbers of inputs, coefficients), ..), one a strip;
    reading: in float64; recorded: the float type of the recording; gains: ((lo, hi), ..) of g = 1 / (1 +
    theta), one an output, where tolerances keep one value over a window: rows are then those of g = 1, and it
    multiplies their sum.
    """

    strips: tuple
    reading: Any
    recorded: np.dtype
    gains: tuple = ()

    def contradicted(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return (strips, N) bool: which strips contradict the windows of u (T, m), y (T, p) that start at
        `starts`, in rising order.
        """
        out = np.zeros((len(self.strips), len(starts)), bool)
        first = 0
        with np.errstate(all="ignore"):
            while first < len(starts):
                stop = int(np.searchsorted(starts, starts[first] + BLOCK))
                out[:, first:stop] = self._block(u, y, starts[first:stop])
                first = stop
        return out

    def _block(self, u, y, starts):
        """Return the same of windows that lie close together."""
        s, begin, end = self.reading.horizon, int(starts[0]), int(starts[-1]) + 1
        span = slice(begin, end + s)
        dense = DENSE * len(starts) >= end - begin
        at = starts - begin
        cut = (lambda x, shift: x[shift : shift + end - begin]) if dense else (lambda x, shift: x[shift + at])
        series = self._series(y[span])
        inputs = [self._input(u[span, i], i) for i in range(u.shape[1])]
        found = [self._strip(strip, series, inputs, cut, u.shape[1]) for strip in self.strips]
        shape = end - begin if dense else len(starts)
        found = [np.broadcast_to(x, shape) for x in found]
        return np.stack([x[at] for x in found] if dense else found)

    def _series(self, y):
        """Return {(kind, number): _Series} of all rows over samples y."""
        series = {}
        for i in range(y.shape[1]):
            series[Kind.READING, i] = self._reading(y[:, i], i)
        for j in range(len(self.reading.disturbance)):
            series[Kind.DISTURBANCE, j] = self._disturbance(j)
        for number in range(len(self.reading.window.sums)):
            series[Kind.SUM, number] = self._sum(y, number)
        return series

    def _strip(self, strip, series, inputs, cut, m):
        """Return whether one strip contradicts windows."""
        rows, h, known, k = strip
        sums: dict = {}
        size = 0.0
        for i, c in zip(rows, h, strict=True):
            row = self.reading.window.all[i]
            if not row.seen:
                return np.False_
            x = series[row.kind, row.number]
            lo, hi = (cut(end, row.first) if isinstance(end, np.ndarray) else end for end in (x.lo, x.hi))
            gain = row.number if self.gains and row.kind is Kind.READING else None
            below, above = sums.get(gain, (0.0, 0.0))
            sums[gain] = below + c * (lo if c > 0 else hi), above + c * (hi if c > 0 else lo)
            size += abs(c) * x.size
        least, most = self._together(sums)
        slip: Any = 0.0
        for j, c in zip(known, k, strict=True):
            value, error, largest = inputs[j % m]
            value = c * cut(value, j // m)
            least, most = least - value, most - value
            size += abs(c) * largest
            if error is not None:
                slip = slip + abs(c) * cut(error, j // m)
        gamma, floor = rounding.residual_error(len(rows) + len(known) + 8, np.float64)
        error = slip + (gamma * size + floor * (1 + max(map(abs, (*h, *k)))))
        return (least > error) | (most < -error)

    def _together(self, sums):
        """Return the least and the most of sums, each times any of its gains."""
        least, most = sums.pop(None, (0.0, 0.0))
        for number, (below, above) in sums.items():
            lo, hi = self.gains[number]
            least = least + np.minimum(lo * below, hi * below)
            most = most + np.maximum(lo * above, hi * above)
        return least, most

    def _reading(self, y, i):
        """Return the _Series of an output, from its samples."""
        r = self.reading
        y = y.astype(np.float64, copy=False)
        sigma, offset, noise = float(r.tolerance[i]), float(r.offset_y[i]), float(r.noise[i])
        largest = _largest(y)
        tiny = float(rounding.tiny(np.float64))
        rho = (
            noise
            + float(r.resolution[i])
            + RECORDER_ULPS * float(rounding.unit(self.recorded)) * (largest + noise)
            + 4 * tiny
        ) * (1 + 1e-15)
        lo, hi = _between(y - offset if offset else y, rho, 0 if self.gains else sigma)
        return _Series(lo, hi, (largest + abs(offset) + rho) / (1 - sigma))

    def _rounded(self, largest):
        """Return what the recorder may have rounded away."""
        return RECORDER_ULPS * float(rounding.unit(self.recorded)) * largest

    def _disturbance(self, j):
        """Return the _Series of a disturbance: its bounds."""
        lo, hi = map(float, self.reading.disturbance[j])
        tiny = float(rounding.tiny(np.float64))
        return _Series(lo - tiny, hi + tiny, max(abs(lo), abs(hi)) + tiny)

    def _sum(self, y, number):
        """Return the _Series of a sum, at the sample with which its run begins."""
        r, values = self.reading, self.reading.window.sums[number]
        total = sum(_size(weights) for _, weights in values.parts)
        tiny = float(rounding.tiny(np.float64))
        half = float(r.average[number]) + 12 * tiny * (values.terms + total)
        if not values.measured:
            return _Series(-half, half, half)
        runs = max(len(y) - values.samples + 1, 0)
        middle, size = np.zeros(runs), 0.0
        for i, weights in values.parts:
            samples = y[:, i].astype(np.float64, copy=False)
            largest, offset, noise = _largest(samples), float(r.offset_y[i]), float(r.noise[i])
            half += _size(weights) * (float(r.resolution[i]) + self._rounded(largest + noise))
            size += _size(weights) * (largest + abs(offset))
            for lag, f in enumerate(weights):
                middle += float(f) * (samples[lag : lag + runs] - offset)
        size += half
        half += float(rounding.unit(np.float64)) * (2 * values.terms + 16) * size
        padded = np.full(len(y), np.nan)
        padded[:runs] = middle
        return _Series(padded - half, padded + half, 2 * size)

    def _input(self, u, i):
        """Return (values, how far each may be off or None, size) of an input."""
        slip = None if self.recorded == np.float64 else input_slip(u).astype(np.float64)
        u, offset = u.astype(np.float64, copy=False), float(self.reading.offset_u[i])
        return (u - offset if offset else u), slip, _largest(u) + abs(offset)


def _size(weights):
    """Return the sum of magnitudes."""
    return sum(abs(float(x)) for x in weights)


def _between(d, rho, sigma):
    """Return the ends of the true values, in deviations, behind readings d that are off by rho and a share
    sigma.
    """
    above, below = d + rho, d - rho
    if not np.any(sigma):
        return below, above
    wide, near = 1 / (1 - sigma), 1 / (1 + sigma)
    return np.minimum(below * wide, below * near), np.maximum(above * wide, above * near)


def _largest(x):
    """Return the largest magnitude; missing samples have none."""
    return float(np.fmax.reduce(np.abs(x), initial=0.0))


def contradicted_by(test: Any, frame: Any, u: np.ndarray, y: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Return (N,) bool: which windows are contradicted by combinations of their relations.

    Args:
        test: the Reading, without averages. frame: its Frame. u (lags, m, N), y (s + 1, p, N): the samples of
            the windows. h (c, N): the combinations, of outer rows; whatever they are, what is said here is
            proved, with the error of `rounding.search_error`.
    """
    R, K, h = (np.asarray(x, np.float64) for x in (frame.R, frame.K, h))
    outer, inner, N = np.asarray(frame.outer), np.asarray(frame.inner), h.shape[1]
    windows = _Windows(test, u, y)
    of, here = np.nonzero(h.T)  # few: a search ends with about as many as there are states
    h = h[here, of]
    across = np.stack([np.bincount(of, h * column[here], N) for column in R.T])
    there, also = np.nonzero(across)
    weights = np.concatenate([h, -across[there, also]])
    least, most = windows.sums(
        np.concatenate([outer[here], inner[there]]), np.concatenate([of, also]), weights
    )
    value = np.bincount(of, h * windows.reached(K[here], of), N)
    size = windows.size[outer] + np.abs(R) @ windows.size[inner] + np.abs(K) @ windows.known_size
    gamma, floor = map(float, rounding.search_error(len(R), len(R.T), len(K.T), y.dtype))
    largest = 1 + max(np.abs(R).max(initial=0), np.abs(K).max(initial=0))
    floor *= largest * largest * (1 + windows.size.sum() + windows.known_size.sum())
    error = np.bincount(of, np.abs(h) * (gamma * size[here] + floor), N) + floor
    with np.errstate(invalid="ignore"):
        return (least - value > error) | (most - value < -error)


class _Windows:
    """The rows of N windows in float64, worked out where they are asked for.

    Fields: size (rows,), known_size (l,): what rounding errors are relative to, of the largest samples.
    """

    def __init__(self, test: Any, u: np.ndarray, y: np.ndarray) -> None:
        unit, self._tiny = float(rounding.unit(y.dtype)), float(rounding.tiny(y.dtype))
        floats = lambda x: np.asarray(x, np.float64)
        self._y = test.seen(y)
        largest = np.fmax.reduce(np.abs(self._y), 0, initial=0.0).astype(np.float64)
        self._sigma, self._offset, noise = map(floats, (test.tolerance, test.offset_y, test.noise))
        bound = noise + floats(test.resolution) + RECORDER_ULPS * unit * noise + 4 * self._tiny
        self._rho = (bound[:, None] + RECORDER_ULPS * unit * largest) * (1 + 1e-15)
        top = lambda x: np.fmax.reduce(x, -1, initial=0.0)
        outputs = (top(largest) + np.abs(self._offset) + top(self._rho)) / (1 - self._sigma)
        disturbances = np.abs(floats(test.disturbance)).sum(1) + self._tiny
        self._ends = np.tile(floats(test.disturbance), (test.horizon, 1))
        self.size = np.concatenate([np.tile(outputs, len(y)), np.tile(disturbances, test.horizon)])
        offset_u = floats(test.offset_u)
        self._known = np.ascontiguousarray((u - offset_u[:, None]).reshape(-1, y.shape[2]).T)
        self.known_size = np.tile(top(top(np.abs(u)).T.astype(np.float64)) + np.abs(offset_u), len(u))

    def reached(self, k: np.ndarray, of: np.ndarray) -> np.ndarray:
        """Return what inputs do (entries,): k (entries, l) of so many windows; a missing input counts only
        where it is used.
        """
        known = self._known[of]
        missing = np.isnan(known)
        if missing.any():
            known = np.where(missing & (k == 0), 0, known)
        return np.einsum("ij,ij->i", k, known)

    def sums(self, rows: np.ndarray, of: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and the most (N,) of weighted sums: of so many rows of so many windows."""
        p, N = self._y.shape[1:]
        lo, hi = np.empty(len(rows)), np.empty(len(rows))
        outputs = rows < len(self._y) * p
        sample, i, window = rows[outputs] // p, rows[outputs] % p, of[outputs]
        d = self._y[sample, i, window] - self._offset[i]
        lo[outputs], hi[outputs] = _between(d, self._rho[i, window], self._sigma[i])
        if len(self._ends):
            ends = self._ends[rows[~outputs] - len(self._y) * p]
            lo[~outputs], hi[~outputs] = ends[:, 0] - self._tiny, ends[:, 1] + self._tiny
        below, above = weights * lo, weights * hi
        return np.bincount(of, np.minimum(below, above), N), np.bincount(of, np.maximum(below, above), N)


def host_strips(
    reading: Any, exact_h: Any, exact_k: Any, recorded: Any, constant: bool = False
) -> HostStrips:
    """Return HostStrips of exact rows h over the rows of a window and k over its inputs.

    Args:
        reading: of the relations, in float64. recorded: the float type of the recording. constant: whether
            tolerances keep one value over a window.
    """
    numbers = lambda row: tuple(i for i, x in enumerate(row) if x)
    floats = lambda row: tuple(float(rounding.fraction_to_float(x)) for x in row if x)
    strips = tuple(
        (numbers(h), floats(h), numbers(k), floats(k)) for h, k in zip(exact_h, exact_k, strict=True)
    )
    gains: tuple = ()
    if constant:
        gains = tuple(
            (1 / (1 + t) * (1 - 1e-15), 1 / (1 - t) * (1 + 1e-15)) for t in map(float, reading.tolerance)
        )
    return HostStrips(strips, reading, np.dtype(recorded), gains)
