"""Relations once more, in NumPy: which of them contradict a window, from the samples, with nothing that XLA
has worked out.

A row i lies in [lo_i, hi_i]: a true output, by its reading y = (1 + theta) t + delta with |theta| <= sigma,
|delta| <= rho, between -f(rho - d) and f(rho + d), d = y - offset, f(v) = max(v / (1 - sigma), v / (1 +
sigma)); a disturbance or an average by its bound. So

    least = sum_i min(h_i lo_i, h_i hi_i) - k v  <=  0  <=  sum_i max(h_i lo_i, h_i hi_i) - k v = most
    (strip)

in every behaviour, and least > error or most < -error contradicts: whatever h and k are, as long as they
cancel all that is unknown.

**The error.** Sums are in float64, one rounding u an operation. d is off by 2 u (|y| + |offset|), f(rho + d)
by 8 u S with S = (|y| + |offset| + rho) / (1 - sigma): 5 for f and the sum, 1 for rho. A product with a
rounded h adds 2, a sum of N terms N - 1: together less than half of what `rounding.residual_error` states for
N terms; a run of samples is paid for by its size (`Reading.block`). S, and what the recorder rounded away,
are those of the largest sample of a window, or of a stretch: never too small, and one number for all its
windows.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.interface import Array
from jaxbound.consistency.reading import AVERAGING, Reading, gather
from jaxbound.exact.linalg import Matrix, Vector
from jaxbound.models.rows import Kind
from jaxbound.models.sensor import RECORDER_ULPS, input_slip
from jaxbound.sets.floats import rounding
from jaxbound.sets.strips.separation import Frame

__all__ = ["HostRows", "HostStrips", "contradicted_by", "contradicts", "host_strips", "row_errors"]

BLOCK = 2**13
"""Windows at once: their rows stay in the cache."""
SPARSE = 2
"""Windows whose samples are fewer than one in so many are gathered: what lies between takes time."""
ALONE = 128
"""Windows of a product that one thread works out."""
SLIGHTLY = 1 + 1e-15
"""A factor that pays for the last roundings of a bound."""
Ends: TypeAlias = np.ndarray | float
"""Numbers over samples or windows, or one for all of them."""


class _Series(NamedTuple):
    """Rows of one kind and number, by the sample with which they begin.

    Fields: lo, hi: over samples, or numbers; size: what rounding errors are relative to.
    """

    lo: Ends
    hi: Ends
    size: Ends


class _Input(NamedTuple):
    """An input. Fields: value; slip: how far it may be off; size: what rounding errors are relative to."""

    value: np.ndarray
    slip: Ends
    size: Ends


class HostRows:
    """The rows of N windows in float64, worked out where they are asked for.

    Args:
        reading: how windows are read. u, y: samples, on the first axis: of windows, u (lags, m, N), y (s + 1,
            p, N), or of a stretch, u (N + s, m), y (N + s, p), with a window from each sample on.
        certain: whether sensors are read as if their tolerances were 0.
    """

    def __init__(self, reading: Reading, u: np.ndarray, y: np.ndarray, certain: bool = False) -> None:
        self._reading, self._u, self._y, self._certain = reading, u, y, certain
        self._tiny = float(rounding.tiny(y.dtype))
        self._recorded = RECORDER_ULPS * float(rounding.unit(y.dtype))
        used = y
        if y.ndim == 3 and reading.window.lags is not None:
            used = np.where(reading.window.used[:, :, None], y, np.nan)
        self._largest = _largest(used)
        inputs = reading.known_inputs(u)
        if y.ndim == 3:
            inputs = reading.inputs(u)
        offset = _doubles(reading.offset_u).reshape(-1, *[1] * (y.ndim - 2))
        self._inputs = _moved(inputs.astype(np.float64, copy=False), offset)
        self._input_sizes = _largest(inputs) + np.abs(offset)
        self._input_slips = None
        if y.dtype != np.float64:
            self._input_slips = input_slip(inputs).astype(np.float64)
        self._series: dict[tuple[Kind, int], _Series] = {}

    @property
    def count(self) -> int:
        """How many windows these are."""
        if self._y.ndim == 3:
            return int(self._y.shape[2])
        return len(self._y) - self._reading.horizon

    @property
    def inputs(self) -> int:
        """How many inputs a window has."""
        lags = self._reading.lags
        if self._reading.acting is not None:
            lags = self._reading.acting
        return lags * int(self._inputs.shape[1])

    def row(self, i: int) -> _Series:
        """Return the ends of a row in each window, and its size."""
        row = self._reading.window.all[i]
        series = self._of(row.kind, row.number)
        if not isinstance(series.lo, np.ndarray) or not isinstance(series.hi, np.ndarray):
            return series
        return _Series(self._cut(series.lo, row.first), self._cut(series.hi, row.first), series.size)

    def input(self, b: int) -> _Input:
        """Return an input in each window."""
        lag, i = divmod(b, self._inputs.shape[1])
        slip: Ends = 0.0
        if self._input_slips is not None:
            slip = self._cut(self._input_slips[:, i], lag)
        return _Input(self._cut(self._inputs[:, i], lag), slip, self._input_sizes[i])

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the ends (rows, N) of all rows of windows, NaN of those that are not looked at."""
        window = self._reading.window
        lo, hi = np.full((2, len(window), self.count), np.nan)
        kept = np.flatnonzero(window.kept)
        for end, whole in enumerate((lo, hi)):
            samples = whole[: window.readings].reshape(-1, window.outputs, self.count)
            for i in range(window.outputs):
                samples[kept, i] = np.asarray(self._of(Kind.READING, i)[end])[kept]
        for i in window.seen[len(kept) * window.outputs :]:
            lo[i], hi[i], _ = self.row(i)
        return lo, hi

    def sizes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (rows, N), (l, N), what rounding errors of rows and inputs are relative to."""
        rows = [self._of(row.kind, row.number).size for row in self._reading.window.all]
        of_rows = np.empty((len(rows), self.count))
        for own, size in zip(of_rows, rows, strict=True):
            own[:] = size
        return of_rows, np.tile(self._input_sizes, (len(self._inputs), 1))

    @cached_property
    def known(self) -> np.ndarray:
        """(l, N): the inputs of windows, NaN where missing."""
        return self._inputs.reshape(-1, self.count)

    def _cut(self, series: np.ndarray, first: int) -> np.ndarray:
        """Return, of a series over samples, the one of each window that comes so many after its first."""
        if self._y.ndim == 3:
            return np.asarray(series[first])
        return series[first : first + self.count]

    def _of(self, kind: Kind, number: int) -> _Series:
        """Return the rows of one kind and number."""
        if (kind, number) not in self._series:
            evaluate = {
                Kind.READING: self._readings,
                Kind.DISTURBANCE: self._disturbance,
                Kind.SUM: self._sums,
            }
            self._series[kind, number] = evaluate[kind](number)
        return self._series[kind, number]

    def _readings(self, i: int) -> _Series:
        """Return the true values of an output, in deviations."""
        r, largest = self._reading, self._largest[i]
        sigma, offset = float(r.tolerance[i]), float(r.offset_y[i])
        most = 1 / (1 - sigma)
        if self._certain:
            sigma = 0.0
        noise: Ends = float(r.noise[i])
        factor = r.factor(self._u, i)
        if factor is not None:
            noise = noise * factor.astype(np.float64)
        rho = self._slip(i, noise) + (noise + 4 * self._tiny)
        rho = rho * SLIGHTLY
        lo, hi = _between(_moved(self._y[:, i].astype(np.float64, copy=False), offset), rho, sigma)
        widest = rho
        if factor is not None:
            widest = np.max(rho, 0)
        return _Series(lo, hi, (largest + abs(offset) + widest) * most * SLIGHTLY)

    def _slip(self, i: int, noise: Ends) -> Ends:
        """Return how much resolution and recorder may have rounded away of samples of an output."""
        slip: Ends = float(self._reading.resolution[i]) + self._recorded * (self._largest[i] + noise)
        return slip

    def _disturbance(self, j: int) -> _Series:
        """Return a disturbance: its bounds."""
        lo, hi = map(float, self._reading.disturbance[j])
        return _Series(lo - self._tiny, hi + self._tiny, abs(lo) + abs(hi) + self._tiny)

    def _sums(self, number: int) -> _Series:
        """Return the runs of a bounded sum, as `Reading.block` has them."""
        r, values = self._reading, self._reading.window.sums[number]
        half: Ends = float(r.average[number])
        mid, reach = np.zeros(()), np.zeros(())
        if values.measured:
            runs = len(self._y) - values.samples + 1
            mid = np.zeros((runs, *self._y.shape[2:]))
            for i, weights in values.parts:
                offset, share = float(r.offset_y[i]), _size(weights)
                half = half + share * self._slip(i, float(r.noise[i]))
                reach = reach + share * (self._largest[i] + abs(offset))
                samples = self._y[:, i].astype(np.float64, copy=False)
                for lag, weight in enumerate(map(float, weights)):
                    mid += weight * (samples[lag : lag + runs] - offset)
        half = half * SLIGHTLY + self._tiny * (values.terms + float(values.size)) * 8
        size = (2 + values.terms / AVERAGING) * (reach + half)
        if not values.measured:
            return _Series(-half, half, size)
        return _Series(mid - half, mid + half, size)


class _HostStrip(NamedTuple):
    """One strip: rows and their coefficients h, inputs and their coefficients k."""

    rows: tuple[int, ...]
    h: tuple[float, ...]
    inputs: tuple[int, ...]
    k: tuple[float, ...]


@dataclass(frozen=True)
class HostStrips:
    """Strips and the bounds of a relation in float64, for NumPy. Build it with `host_strips`.

    Fields: strips; reading: in float64; gains: ((lo, hi), ..) of g = 1 / (1 + theta), one an output, where
    tolerances keep one value over a window: rows are then those of g = 1, and it multiplies their sum.
    """

    strips: tuple[_HostStrip, ...]
    reading: Reading
    gains: tuple[tuple[float, float], ...] = ()

    def contradicted(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return (strips, N) bool: which strips contradict the windows of u (T, m), y (T, p) that start at
        `starts`, in rising order: of stretches where most samples belong to one, else gathered.
        """
        out = np.zeros((len(self.strips), len(starts)), bool)
        first, r = 0, self.reading
        with np.errstate(all="ignore"):
            while first < len(starts):
                begin, samples = int(starts[first]), r.horizon + 1
                stop = int(np.searchsorted(starts, begin + BLOCK))
                if SPARSE * (stop - first) * samples < min(BLOCK, len(y) - begin):
                    stop = min(first + BLOCK // samples, len(starts))
                    block = gather(u, y, starts[first:stop], r.lags, r.horizon)
                    out[:, first:stop] = self._of(*block)
                else:
                    span = slice(begin, int(starts[stop - 1]) + samples)
                    out[:, first:stop] = self._of(u[span], y[span])[:, starts[first:stop] - begin]
                first = stop
        return out

    def _of(self, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the same of the windows of one `HostRows`."""
        rows = HostRows(self.reading, u, y, bool(self.gains))
        every = [rows.row(i) for i in range(len(self.reading.window))]
        inputs = [rows.input(b) for b in range(rows.inputs)]
        out = np.empty((len(self.strips), rows.count), bool)
        for own, strip in zip(out, self.strips, strict=True):
            own[:] = self._seen(strip, every, inputs)
        return out

    def _seen(self, strip: _HostStrip, rows: list[_Series], inputs: list[_Input]) -> np.ndarray:
        """Return whether one strip contradicts windows: an array (N,), or one bool for all."""
        sums: dict[int | None, tuple[Ends, Ends]] = {}
        size: Ends = 0.0
        for i, c in zip(strip.rows, strip.h, strict=True):
            row = self.reading.window.all[i]
            if not row.seen:
                return np.zeros((), bool)
            lo, hi, own = rows[i]
            if c < 0:
                lo, hi = hi, lo
            gain = None
            if self.gains and row.kind is Kind.READING:
                gain = row.number
            below, above = sums.get(gain, (0.0, 0.0))
            sums[gain] = below + c * lo, above + c * hi
            size = size + abs(c) * own
        least, most = self._together(sums)
        slip: Ends = 0.0
        for b, c in zip(strip.inputs, strip.k, strict=True):
            value, off, own = inputs[b]
            least, most = least - c * value, most - c * value
            slip, size = slip + abs(c) * off, size + abs(c) * own
        terms, largest = len(strip.rows) + len(strip.inputs), max(map(abs, (*strip.h, *strip.k)))
        gamma, floor = rounding.residual_error(terms + 8, np.float64)
        return _excludes_0(least, most, slip + (float(gamma) * size + float(floor) * (1 + largest)))

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


def host_strips(reading: Reading, exact_h: Matrix, exact_k: Matrix, constant: bool = False) -> HostStrips:
    """Return HostStrips of exact rows h over the rows of a window and k over its inputs.

    Args:
        reading: of the relations, in float64. constant: whether tolerances keep one value over a window.
    """
    strips = []
    for h, k in zip(exact_h, exact_k, strict=True):
        strips.append(_HostStrip(*_sparse(h), *_sparse(k)))
    gains = []
    if constant:
        for sigma in map(float, reading.tolerance):
            gains.append((1 / (1 + sigma) * (1 - 1e-15), 1 / (1 - sigma) * SLIGHTLY))
    return HostStrips(tuple(strips), reading, tuple(gains))


def contradicted_by(
    reading: Reading, frame: Frame, u: np.ndarray, y: np.ndarray, h: np.ndarray
) -> np.ndarray:
    """Return (N,) bool: which windows are contradicted by combinations of their relations; of one that lacks
    a sample nothing is said.

    Args:
        reading: the Reading. frame: its Frame.
        u (lags, m, N), y (s + 1, p, N): the samples of the windows.
        h (c, N): the combinations, of outer rows; whatever they are, what is said here is proved, with the
            error of `rounding.search_error`.
    """
    R, K, h = _doubles(frame.R), _doubles(frame.K), _doubles(h)
    rows, order = HostRows(reading, u, y), np.concatenate([frame.outer, frame.inner])
    sizes, known_sizes = (x.max(1) for x in rows.sizes())
    sizes, c = sizes[order], len(R)
    gamma, floor, size = row_errors(R, K, (sizes[:c], sizes[c:], known_sizes), y.dtype)
    error = _times((gamma * size + floor)[None], np.abs(h))[0] + floor
    driven = _times(K.T, h)
    value = np.where(driven == 0, 0, driven * rows.known).sum(0)
    lo, hi = rows.ends()
    weights = np.concatenate([h, -_times(R.T, h)])
    return contradicts(weights, lo[order], hi[order], value, error)


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
    even off by an error. Of a row with the weight 0 nothing is asked.
    """
    below, above = (np.where(weights == 0, 0, weights * x) for x in (lo, hi))
    return _excludes_0(
        np.minimum(below, above).sum(0) - value, np.maximum(below, above).sum(0) - value, error
    )


def _excludes_0(least: Ends, most: Ends, error: Ends) -> np.ndarray:
    """Return bool: no sum between these ends is 0, even off by an error; False where one is NaN."""
    with np.errstate(invalid="ignore"):
        return np.asarray((least > error) | (most < -error))


def _between(d: np.ndarray, rho: Ends, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of the true values, in deviations, behind readings d that are off by rho and a share
    sigma.
    """
    above, below = d + rho, d - rho
    if not sigma:
        return below, above
    wide, near = 1 / (1 - sigma), 1 / (1 + sigma)
    return np.minimum(below * wide, below * near), np.maximum(above * wide, above * near)


def _moved(x: np.ndarray, offset: Ends) -> np.ndarray:
    """Return x - offset: x itself for 0, of which no copy is made."""
    if not np.any(offset):
        return x
    return x - offset


def _sparse(row: Vector) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return the places of the entries of a row that are not 0, and these in floats."""
    places = tuple(i for i, x in enumerate(row) if x)
    return places, tuple(float(rounding.fraction_to_float(row[i])) for i in places)


def _size(weights: Vector) -> float:
    """Return the sum of magnitudes."""
    return sum(abs(float(x)) for x in weights)


def _doubles(x: Array) -> np.ndarray:
    """Return an array in float64, on the host."""
    return np.asarray(x, np.float64)


def _largest(x: np.ndarray) -> np.ndarray:
    """Return the largest magnitudes along the first axis, missing samples left out: signal by signal, as long
    columns.
    """
    largest = np.zeros(x.shape[1:])
    for i in range(len(largest)):
        values = np.abs(x[:, i])
        largest[i] = np.maximum.reduce(values, 0, initial=0.0)  # compiled for whole registers, unlike fmax
        if np.isnan(largest[i]).any():
            largest[i] = np.fmax.reduce(values, 0, initial=0.0)
    return largest


def _times(A: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return A x (a, N), some columns at a time: of larger products the library starts threads, which wait
    for each other where others are at work.
    """
    out = np.empty((len(A), x.shape[1]))
    for first in range(0, x.shape[1], ALONE):
        np.matmul(A, x[:, first : first + ALONE], out=out[:, first : first + ALONE])
    return out
