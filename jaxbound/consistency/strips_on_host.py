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

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.interface import Array
from jaxbound.consistency.reading import AVERAGING, Reading
from jaxbound.exact.linalg import Matrix, Vector
from jaxbound.models.rows import Kind
from jaxbound.models.sensor import RECORDER_ULPS, input_slip
from jaxbound.sets.floats import rounding
from jaxbound.sets.strips.separation import Frame

__all__ = ["HostRows", "HostStrips", "contradicted_by", "contradicts", "host_strips", "row_errors"]

BLOCK = 2**13
"""Windows at once: their rows stay in the cache."""
SPARSE = 2
"""Windows whose samples are fewer than one in so many are laid end to end: what lies between takes time."""
DENSE = 4
"""Windows are gathered where fewer than one in so many is asked for, else cut out as stretches."""


Ends: TypeAlias = np.ndarray | float
"""Numbers over samples or windows, or one for all of them."""
Cut: TypeAlias = Callable[[np.ndarray, int], np.ndarray]
"""Takes, of a series over samples, the one of each window that comes so many samples after its first."""
SLIGHTLY = 1 + 1e-15
"""A factor that pays for the last roundings of a bound."""


@dataclass(frozen=True)
class _Series:
    """Bounds of rows over a block of samples.

    Fields: lo, hi: arrays over samples, or numbers; size: what rounding errors are relative to.
    """

    lo: Ends
    hi: Ends
    size: float


class _Input(NamedTuple):
    """An input over a block of samples. Fields: values; slip: how far each may be off, None for not at all;
    size: what rounding errors are relative to.
    """

    values: np.ndarray
    slip: np.ndarray | None
    size: float


class _HostStrip(NamedTuple):
    """One strip: rows and their coefficients h, inputs and their coefficients k."""

    rows: tuple[int, ...]
    h: tuple[float, ...]
    inputs: tuple[int, ...]
    k: tuple[float, ...]


@dataclass(frozen=True)
class HostStrips:
    """Strips and the bounds of a relation in float64, for NumPy. Build it with `host_strips`.

    Fields: strips; reading: in float64; recorded: the float type of the recording; gains: ((lo, hi), ..) of
    g = 1 / (1 + theta), one an output, where tolerances keep one value over a window: rows are then those of
    g = 1, and it multiplies their sum.
    """

    strips: tuple[_HostStrip, ...]
    reading: Reading
    recorded: np.dtype
    gains: tuple[tuple[float, float], ...] = ()

    def contradicted(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return (strips, N) bool: which strips contradict the windows of u (T, m), y (T, p) that start at
        `starts`, in rising order.
        """
        out = np.zeros((len(self.strips), len(starts)), bool)
        first, samples = 0, self.reading.horizon + 1
        with np.errstate(all="ignore"):
            while first < len(starts):
                stop = int(np.searchsorted(starts, starts[first] + BLOCK))
                if SPARSE * (stop - first) * samples < min(BLOCK, len(y) - starts[first]):
                    stop = min(first + BLOCK // samples, len(starts))
                    out[:, first:stop] = self._far_apart(u, y, starts[first:stop])
                else:
                    out[:, first:stop] = self._block(u, y, starts[first:stop])
                first = stop
        return out

    def _far_apart(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return the same of windows that lie far from each other: their samples are laid end to end."""
        samples = self.reading.horizon + 1
        rows = (starts[:, None] + np.arange(samples)).ravel()
        return self._block(u.take(rows, 0), y.take(rows, 0), samples * np.arange(len(starts)))

    def _block(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return the same of windows that lie close together."""
        s, begin, end = self.reading.horizon, int(starts[0]), int(starts[-1]) + 1
        span = slice(begin, end + s)
        at = starts - begin
        dense = DENSE * len(starts) >= end - begin

        def stretch(x: np.ndarray, shift: int) -> np.ndarray:
            return x[shift : shift + end - begin]

        def gathered(x: np.ndarray, shift: int) -> np.ndarray:
            return np.asarray(x[shift + at])

        series = self._series(u[span], y[span])
        inputs = [self._input(x, i) for i, x in enumerate(self.reading.known_inputs(u[span]).T)]
        cut, count = (stretch, end - begin) if dense else (gathered, len(starts))
        seen = []
        for strip in self.strips:
            seen.append(np.broadcast_to(self._seen(strip, series, inputs, cut), count))
        if dense:
            seen = [x[at] for x in seen]
        return np.stack(seen)

    def _series(self, u: np.ndarray, y: np.ndarray) -> dict[tuple[Kind, int], _Series]:
        """Return the _Series of all rows over samples u, y, by kind and number."""
        series = {}
        for i in range(y.shape[1]):
            series[Kind.READING, i] = self._reading(y[:, i], i, self.reading.factor(u, i))
        for j in range(len(self.reading.disturbance)):
            series[Kind.DISTURBANCE, j] = self._disturbance(j)
        for number in range(len(self.reading.window.sums)):
            series[Kind.SUM, number] = self._sum(y, number)
        return series

    def _seen(
        self, strip: _HostStrip, series: dict[tuple[Kind, int], _Series], inputs: list[_Input], cut: Cut
    ) -> np.ndarray:
        """Return whether one strip contradicts windows: an array (N,), or one bool for all."""
        sums: dict[int | None, tuple[Ends, Ends]] = {}
        size = 0.0
        for i, c in zip(strip.rows, strip.h, strict=True):
            row = self.reading.window.all[i]
            if not row.seen:
                return np.zeros((), bool)
            x = series[row.kind, row.number]
            lo, hi = _cut_ends(cut, x, row.first)
            if c < 0:
                lo, hi = hi, lo
            gain = None
            if self.gains and row.kind is Kind.READING:
                gain = row.number
            below, above = sums.get(gain, (0.0, 0.0))
            sums[gain] = below + c * lo, above + c * hi
            size += abs(c) * x.size
        least, most = self._together(sums)
        slip: Ends = 0.0
        for j, c in zip(strip.inputs, strip.k, strict=True):
            lag, number = divmod(j, len(inputs))
            own = inputs[number]
            value = c * cut(own.values, lag)
            least, most = least - value, most - value
            size += abs(c) * own.size
            if own.slip is not None:
                slip = slip + abs(c) * cut(own.slip, lag)
        terms, largest = len(strip.rows) + len(strip.inputs), max(map(abs, (*strip.h, *strip.k)))
        gamma, floor = rounding.residual_error(terms + 8, np.float64)
        error = slip + float(gamma * size + floor * (1 + largest))
        return _excludes_0(least, most, error)

    def _together(self, sums: dict[int | None, tuple[Ends, Ends]]) -> tuple[Ends, Ends]:
        """Return the least and the most of sums, each times any of its gains."""
        least, most = sums.get(None, (0.0, 0.0))
        for number, (below, above) in sums.items():
            if number is None:
                continue
            lo, hi = self.gains[number]
            least = least + np.minimum(lo * below, hi * below)
            most = most + np.maximum(lo * above, hi * above)
        return least, most

    def _reading(self, y: np.ndarray, i: int, factor: np.ndarray | None) -> _Series:
        """Return the _Series of an output, from its samples and the factor on its noise."""
        r = self.reading
        y = y.astype(np.float64, copy=False)
        sigma, offset = float(r.tolerance[i]), float(r.offset_y[i])
        noise: Ends = float(r.noise[i])
        if factor is not None:
            noise = noise * factor.astype(np.float64)
        largest = _largest(y)
        tiny = float(rounding.tiny(np.float64))
        rho = (noise + float(r.resolution[i]) + self._recorder * (largest + noise) + 4 * tiny) * SLIGHTLY
        own = 0.0 if self.gains else sigma
        lo, hi = _between(_moved(y, offset), rho, own)
        return _Series(lo, hi, (largest + abs(offset) + float(np.max(rho))) / (1 - sigma))

    @property
    def _recorder(self) -> float:
        """The share of a size that the recorder rounds away at most."""
        return RECORDER_ULPS * float(rounding.unit(self.recorded))

    def _disturbance(self, j: int) -> _Series:
        """Return the _Series of a disturbance: its bounds."""
        lo, hi = map(float, self.reading.disturbance[j])
        tiny = float(rounding.tiny(np.float64))
        return _Series(lo - tiny, hi + tiny, max(abs(lo), abs(hi)) + tiny)

    def _sum(self, y: np.ndarray, number: int) -> _Series:
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
            half += _size(weights) * (float(r.resolution[i]) + self._recorder * (largest + noise))
            size += _size(weights) * (largest + abs(offset))
            for lag, f in enumerate(weights):
                middle += float(f) * (samples[lag : lag + runs] - offset)
        size += half
        half += float(rounding.unit(np.float64)) * (2 * values.terms + 16) * size
        padded = np.full(len(y), np.nan)
        padded[:runs] = middle
        return _Series(padded - half, padded + half, 2 * size)

    def _input(self, u: np.ndarray, i: int) -> _Input:
        """Return an input, from its samples."""
        slip = None
        if self.recorded != np.float64:
            slip = input_slip(u).astype(np.float64)
        u, offset = u.astype(np.float64, copy=False), float(self.reading.offset_u[i])
        return _Input(_moved(u, offset), slip, _largest(u) + abs(offset))


def _cut_ends(cut: Cut, series: _Series, first: int) -> tuple[Ends, Ends]:
    """Return the ends of a row in each window, from the sample with which it begins."""
    if isinstance(series.lo, np.ndarray) and isinstance(series.hi, np.ndarray):
        return cut(series.lo, first), cut(series.hi, first)
    return series.lo, series.hi


def _moved(x: np.ndarray, offset: float) -> np.ndarray:
    """Return x - offset: x itself for 0, of which no copy is made."""
    if not offset:
        return x
    return x - offset


def _size(weights: Vector) -> float:
    """Return the sum of magnitudes."""
    return sum(abs(float(x)) for x in weights)


def _between(d: np.ndarray, rho: Ends, sigma: Ends) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of the true values, in deviations, behind readings d that are off by rho and a share
    sigma.
    """
    above, below = d + rho, d - rho
    if not np.any(sigma):
        return below, above
    wide, near = 1 / (1 - sigma), 1 / (1 + sigma)
    return np.minimum(below * wide, below * near), np.maximum(above * wide, above * near)


def _largest(x: np.ndarray) -> float:
    """Return the largest magnitude; missing samples have none."""
    return float(np.fmax.reduce(np.abs(x), initial=0.0))


ALONE = 128
"""Windows of a product that one thread works out."""
FULL = 2
"""Part of the entries of combinations above which whole rows are summed, not entry by entry."""


def contradicted_by(
    reading: Reading, frame: Frame, u: np.ndarray, y: np.ndarray, h: np.ndarray
) -> np.ndarray:
    """Return (N,) bool: which windows are contradicted by combinations of their relations.

    Args:
        reading: the Reading. frame: its Frame.
        u (lags, m, N), y (s + 1, p, N): the samples of the windows.
        h (c, N): the combinations, of outer rows; whatever they are, what is said here is proved, with the
            error of `rounding.search_error`.
    """
    R, K, h = _doubles(frame.R), _doubles(frame.K), _doubles(h)
    outer, inner, N = np.asarray(frame.outer), np.asarray(frame.inner), h.shape[1]
    windows = HostRows(reading, u, y)
    sizes, known_sizes = map(_highest, windows.sizes())
    gamma, floor, size = row_errors(R, K, (sizes[outer], sizes[inner], known_sizes), y.dtype)
    if np.count_nonzero(h) > h.size // FULL:
        error = _times((gamma * size + floor)[None], np.abs(h))[0] + floor
        return windows.contradicted(outer, inner, h, -_times(R.T, h), _times(K.T, h), error)
    of, here = np.nonzero(h.T)  # few: an exchange search ends with about as many as there are states
    h = h[here, of]
    across = np.stack([np.bincount(of, h * column[here], N) for column in R.T])
    there, also = np.nonzero(across)
    weights = np.concatenate([h, -across[there, also]])
    least, most = windows.sums(
        np.concatenate([outer[here], inner[there]]), np.concatenate([of, also]), weights
    )
    value = np.bincount(of, h * windows.reached(K[here], of), N)
    error = np.bincount(of, np.abs(h) * (gamma * size[here] + floor), N) + floor
    return _excludes_0(least - value, most - value, error)


def row_errors(
    R: np.ndarray, K: np.ndarray, sizes: tuple[np.ndarray, np.ndarray, np.ndarray], dtype: DTypeLike
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return (gamma, floor, M (c, ..)) of the outer rows of a frame, see `rounding.search_error`.

    Args:
        R, K: of the frame. sizes: of outer rows (c, ..), inner rows (k, ..) and inputs (l, ..), as
            `HostRows.sizes` has them, of each window or the largest. dtype: in which rows are worked out.
    """
    outer, inner, known = sizes
    gamma, floor = map(float, rounding.search_error(len(R), len(R.T), len(K.T), dtype))
    largest = 1 + max(np.abs(R).max(initial=0), np.abs(K).max(initial=0))
    all_sizes = outer.sum(0) + inner.sum(0) + known.sum(0)
    return gamma, floor * largest * largest * (1 + all_sizes), outer + np.abs(R) @ inner + np.abs(K) @ known


def contradicts(weights: np.ndarray, lo: np.ndarray, hi: np.ndarray, value: Ends, error: Ends) -> np.ndarray:
    """Return (N,) bool: whether sums of weighted rows (rows, N) between lo and hi, less a value, are never 0,
    even off by an error.
    """
    below, above = weights * lo, weights * hi
    return _excludes_0(
        np.minimum(below, above).sum(0) - value, np.maximum(below, above).sum(0) - value, error
    )


def _excludes_0(least: Ends, most: Ends, error: Ends) -> np.ndarray:
    """Return bool: no sum between these ends is 0, even off by an error; False where one is NaN."""
    with np.errstate(invalid="ignore"):
        return np.asarray((least > error) | (most < -error))


def _doubles(x: Array) -> np.ndarray:
    """Return an array in float64, on the host."""
    return np.asarray(x, np.float64)


def _times(A: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return A x (a, N), some columns at a time: of larger products the library starts threads, which wait
    for each other where others are at work.
    """
    out = np.empty((len(A), x.shape[1]))
    for first in range(0, x.shape[1], ALONE):
        np.matmul(A, x[:, first : first + ALONE], out=out[:, first : first + ALONE])
    return out


def _highest(x: np.ndarray) -> np.ndarray:
    """Return the largest entry along the last axis, missing ones left out."""
    return np.asarray(np.fmax.reduce(x, -1, initial=0.0))


def _largest_of(x: np.ndarray) -> np.ndarray:
    """Return the largest magnitudes (n, N) of windows (samples, n, N), missing samples left out."""
    return np.asarray(np.fmax.reduce(np.abs(x), 0, initial=0.0), np.float64)


def _factor(reading: Reading, u: np.ndarray, i: int) -> np.ndarray:
    """Return the factor (s + 1, N) on the noise of an output that has one, from windows u (s + 1, m, N)."""
    factor = reading.factor(u, i)
    assert factor is not None, "its number is among reading.times"
    return factor.astype(np.float64)


class _Runs(NamedTuple):
    """Rows of a bounded sum: their ends below, above (runs, N); size (runs, N), what rounding errors are
    relative to.
    """

    below: np.ndarray
    above: np.ndarray
    size: np.ndarray


class HostRows:
    """The rows of N windows in float64, worked out where they are asked for.

    Fields: known (l, N): inputs, NaN where missing.
    """

    def __init__(self, reading: Reading, u: np.ndarray, y: np.ndarray) -> None:
        unit, self._tiny = float(rounding.unit(y.dtype)), float(rounding.tiny(y.dtype))
        self._recorded = RECORDER_ULPS * unit
        self._y = reading.seen(y)
        largest = _largest_of(self._y)
        self._sigma, self._offset, noise = map(_doubles, (reading.tolerance, reading.offset_y, reading.noise))
        noises = noise[None, :, None]
        if reading.times:
            noises = np.broadcast_to(noises, y.shape).copy()
            for i in reading.times:
                noises[:, i] *= _factor(reading, u, i)
        bound = (
            noises + _doubles(reading.resolution)[:, None] + RECORDER_ULPS * unit * noises + 4 * self._tiny
        )
        self._rho = (bound + RECORDER_ULPS * unit * largest) * SLIGHTLY
        sizes = largest + np.abs(self._offset)[:, None] + self._rho.max(0)
        self._outputs = sizes / (1 - self._sigma)[:, None]
        self._rho = np.broadcast_to(self._rho, y.shape)  # the same at all samples, where no factor differs
        disturbance = _doubles(reading.disturbance)
        self._ends = np.tile(disturbance, (reading.horizon, 1))
        runs = [self._runs(reading, number, y) for number in range(len(reading.window.sums))]
        self._below = [part.below for part in runs]
        self._above = [part.above for part in runs]
        self._sums = [part.size for part in runs]
        u, offset_u = reading.inputs(u), _doubles(reading.offset_u)
        self.known = (u - offset_u[:, None]).reshape(-1, y.shape[2]).astype(np.float64, copy=False)
        self._inputs, self._lags = _largest_of(u) + np.abs(offset_u)[:, None], len(u)

    def sizes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (rows, N), (l, N), what rounding errors of rows and inputs are relative to: of the largest
        samples of each window.
        """
        disturbances = np.abs(self._ends).sum(1) + self._tiny
        outputs = np.tile(self._outputs, (len(self._y), 1))
        single = outputs, np.repeat(disturbances[:, None], outputs.shape[1], 1)
        return np.concatenate([*single, *self._sums]), np.tile(self._inputs, (self._lags, 1))

    def _runs(self, reading: Reading, number: int, y: np.ndarray) -> _Runs:
        """Return the runs of a bounded sum, as `Reading.block` has them."""
        values, count = reading.window.sums[number], len(reading.window.runs(number))
        bound, share = float(reading.average[number]), 2 + values.terms / AVERAGING
        mid, width = np.zeros((count, y.shape[2])), np.full(y.shape[2], bound)
        reach: Ends = 0.0
        if values.measured:
            used = np.where(reading.window.used[:, :, None], y, np.nan)
            largest = _largest_of(used)
            slips = _doubles(reading.resolution)[:, None] + self._recorded * (
                largest + _doubles(reading.noise)[:, None]
            )
            for i, weights in values.parts:
                for sample, weight in enumerate(map(float, weights)):
                    mid += weight * (y[sample : sample + count, i] - self._offset[i])
                width = width + _size(weights) * slips[i]
                reach = reach + _size(weights) * (largest[i] + abs(self._offset[i]))
        width = width * SLIGHTLY + self._tiny * (values.terms + float(values.size)) * 8
        size = np.broadcast_to(share * (reach + width), mid.shape)
        return _Runs(mid - width, mid + width, size)

    def reached(self, k: np.ndarray, of: np.ndarray) -> np.ndarray:
        """Return k times inputs (entries,), k (entries, l) of so many windows; a missing input counts only
        where it is used.
        """
        known = self.known.T[of]
        missing = np.isnan(known)
        if missing.any():
            known = np.where(missing & (k == 0), 0, known)
        return np.asarray(np.einsum("ij,ij->i", k, known))

    def contradicted(
        self,
        outer: np.ndarray,
        inner: np.ndarray,
        h: np.ndarray,
        back: np.ndarray,
        k: np.ndarray,
        error: np.ndarray,
    ) -> np.ndarray:
        """Return (N,) bool: which windows are contradicted by combinations h of outer rows, back of inner
        ones, k of inputs; of one that lacks a sample nothing is said.
        """
        (lo, hi), order = self.ends(), np.concatenate([outer, inner])
        value = np.einsum("bn,bn->n", k, self.known)
        return contradicts(np.concatenate([h, back]), lo[order], hi[order], value, error)

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the ends (rows, N) of all rows."""
        d = self._y - self._offset[:, None]
        count = d.shape[2]
        lo, hi = _between(d, self._rho, self._sigma[:, None])
        ends = np.repeat(self._ends[:, :, None], count, 2)
        below = np.concatenate([lo.reshape(-1, count), ends[:, 0] - self._tiny, *self._below])
        return below, np.concatenate([hi.reshape(-1, count), ends[:, 1] + self._tiny, *self._above])

    def sums(self, rows: np.ndarray, of: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and the most (N,) of weighted sums: of so many rows of so many windows."""
        p, N = self._y.shape[1:]
        lo, hi = np.empty(len(rows)), np.empty(len(rows))
        outputs = rows < len(self._y) * p
        sample, i, window = rows[outputs] // p, rows[outputs] % p, of[outputs]
        d = self._y[sample, i, window] - self._offset[i]
        lo[outputs], hi[outputs] = _between(d, self._rho[sample, i, window], self._sigma[i])
        single = len(self._y) * p + len(self._ends)
        if len(self._ends):
            disturbed = ~outputs & (rows < single)
            ends = self._ends[rows[disturbed] - len(self._y) * p]
            lo[disturbed], hi[disturbed] = ends[:, 0] - self._tiny, ends[:, 1] + self._tiny
        if self._below:
            summed = rows >= single
            at = rows[summed] - single, of[summed]
            lo[summed], hi[summed] = np.concatenate(self._below)[at], np.concatenate(self._above)[at]
        below, above = weights * lo, weights * hi
        return np.bincount(of, np.minimum(below, above), N), np.bincount(of, np.maximum(below, above), N)


def host_strips(
    reading: Reading, exact_h: Matrix, exact_k: Matrix, recorded: DTypeLike, constant: bool = False
) -> HostStrips:
    """Return HostStrips of exact rows h over the rows of a window and k over its inputs.

    Args:
        reading: of the relations, in float64. recorded: the float type of the recording. constant: whether
            tolerances keep one value over a window.
    """
    strips = []
    for h, k in zip(exact_h, exact_k, strict=True):
        strips.append(_HostStrip(*_sparse(h), *_sparse(k)))
    gains = []
    if constant:
        for sigma in map(float, reading.tolerance):
            gains.append((1 / (1 + sigma) * (1 - 1e-15), 1 / (1 - sigma) * SLIGHTLY))
    return HostStrips(tuple(strips), reading, np.dtype(recorded), tuple(gains))


def _sparse(row: Vector) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return the places of the entries of a row that are not 0, and these in floats."""
    places = tuple(i for i, x in enumerate(row) if x)
    return places, tuple(float(rounding.fraction_to_float(row[i])) for i in places)
