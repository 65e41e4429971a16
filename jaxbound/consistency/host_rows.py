"""The rows of windows on the host, in NumPy: in float64, or in whole numbers.

A row i lies in [lo_i, hi_i]: a true output, by its reading y = (1 + theta) t + delta with |theta| <= sigma,
|delta| <= rho, between -f(rho - d) and f(rho + d), d = y - offset, f(v) = max(v / (1 - sigma), v / (1 +
sigma)); a disturbance or a sum by its bound.

**The error** in float64, one rounding u an operation: d is off by 2 u (|y| + |offset|), f(rho + d) by 8 u S
with S = (|y| + |offset| + rho) / (1 - sigma): 5 for f and the sum, 1 for rho. A product with a rounded h adds
2, a sum of N terms N - 1: together less than half of what `rounding.residual_error` states for N terms; a run
of samples is paid for by its size (`Reading.block`). S, and what the recorder rounded away, are those of the
largest sample of a window, or of a stretch: never too small, and one number for all its windows.

**Whole numbers** have no error. Samples and bounds are floats, offsets and weights rationals: times a power
of two and their denominators all are integers, in arrays of Python's, and so are the quotients. The floor of
the bounds, the smallest normal number, is left out of them: whoever proves FAULT adds it.
"""

from fractions import Fraction
from math import ceil, lcm
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np

from jaxbound.consistency.interface import Array
from jaxbound.consistency.reading import Reading
from jaxbound.exact.integers import places, whole_floats
from jaxbound.models.rows import Kind, WeightedSum
from jaxbound.models.sensor import RECORDER_ULPS, input_slip
from jaxbound.models.system import LinearSystem
from jaxbound.sets.floats import rounding

SLIGHTLY = 1 + 1e-15
"""A factor that pays for the last roundings of a bound."""
Ends: TypeAlias = np.ndarray | float
"""Numbers over samples or windows, or one for all of them."""


class Series(NamedTuple):
    """Rows of one kind and number, by the sample with which they begin.

    Fields: lo, hi: over samples, or numbers; size: what rounding errors are relative to.
    """

    lo: Ends
    hi: Ends
    size: Ends


class Input(NamedTuple):
    """An input. Fields: value; slip: how far it may be off; size: what rounding errors are relative to."""

    value: np.ndarray
    slip: Ends
    size: Ends


class _Doubles:
    """The arithmetic of rows in float64."""

    exact: ClassVar[bool] = False
    kind: ClassVar[type] = float
    slightly: ClassVar[float] = SLIGHTLY
    unit: int = 1
    tiny: float

    def __init__(self, y: np.ndarray) -> None:
        self.tiny = float(rounding.tiny(y.dtype))

    def number(self, x: float | Fraction) -> float:
        """Return one number."""
        return float(x)

    def array(self, x: np.ndarray) -> np.ndarray:
        """Return samples."""
        return x.astype(np.float64, copy=False)

    def times(self, x: Ends, factor: Fraction) -> Ends:
        """Return numbers times a fraction."""
        return x * float(factor)

    def factored(self, x: Ends, factors: np.ndarray) -> Ends:
        """Return numbers times floats."""
        return x * factors.astype(np.float64)


class _Whole(_Doubles):
    """The same times `unit`, which makes all that rows are made of whole, half of it too; 0 for samples that
    are missing.
    """

    exact, kind, slightly, tiny = True, object, 1, 0

    def __init__(self, reading: Reading, model: LinearSystem, u: np.ndarray, y: np.ndarray) -> None:
        known = reading.inputs(u)
        factors = [own for own in (reading.factor(u, i) for i in range(model.p)) if own is not None]
        bounds = reading.noise, reading.resolution, reading.disturbance, reading.average
        # the recorder's ulps are a power of two: shifted by it sizes of samples still are integers
        shift = 1 - int(np.log2(float(RECORDER_ULPS * rounding.unit(y.dtype))))
        self._finest = max(map(places, factors), default=0)
        self._power = shift + max(map(places, (known, input_slip(known), y, *bounds))) + self._finest
        divisors = []
        for values in reading.window.sums:
            for weight in (x for _, weights in values.parts for x in weights):
                divisors += [weight.denominator, (weight / values.size).denominator]
        for sigma in doubles(reading.tolerance).tolist():
            divisors += [(1 - Fraction(sigma)).numerator, (1 + Fraction(sigma)).numerator]
        self._rest = lcm(*divisors) * lcm(*(x.denominator for name in "uy" for x in model.offset[name]))
        self.unit = self._rest << self._power

    def number(self, x: float | Fraction) -> int:
        """Return one number."""
        return int(Fraction(x) * self.unit)

    def array(self, x: np.ndarray) -> np.ndarray:
        """Return samples."""
        return np.asarray(whole_floats(np.where(np.isnan(x), 0, x), self._power) * self._rest)

    def times(self, x: Ends, factor: Fraction) -> Ends:
        """Return numbers times a fraction, whose denominator divides them."""
        whole: Ends = x // factor.denominator * factor.numerator
        return whole

    def factored(self, x: Ends, factors: np.ndarray) -> Ends:
        """Return numbers times floats."""
        whole: np.ndarray = x * whole_floats(factors, self._finest) // 2**self._finest
        return whole


class HostRows:
    """The rows of N windows, worked out where they are asked for.

    Fields: exact: whether in whole numbers; unit: what these are divided by, else 1.

    Args:
        reading: how windows are read. u, y: samples, on the first axis: of windows, u (lags, m, N), y (s + 1,
            p, N), or of a stretch, u (N + s, m), y (N + s, p), with a window from each sample on.
        certain: whether sensors are read as if their tolerances were 0. model: the plant, for whole numbers;
            None: in float64.
    """

    def __init__(
        self,
        reading: Reading,
        u: np.ndarray,
        y: np.ndarray,
        certain: bool = False,
        model: LinearSystem | None = None,
    ) -> None:
        self._reading, self._u, self._y, self._certain = reading, u, y, certain
        used, inputs = y, reading.known_inputs(u)
        if y.ndim == 3:
            inputs = reading.inputs(u)
            if reading.window.lags is not None:
                # a sample that lags do not look at must not widen what the recorder rounds away
                used = np.where(reading.window.used[:, :, None], y, np.nan)
        offsets = {"u": doubles(reading.offset_u).tolist(), "y": doubles(reading.offset_y).tolist()}
        self._in: _Doubles = _Doubles(y)
        if model is not None:
            self._in, offsets = _Whole(reading, model, u, used), dict(model.offset)
        self.exact, self.unit = self._in.exact, self._in.unit
        self._recorded = Fraction(float(RECORDER_ULPS * rounding.unit(y.dtype)))
        self._samples, self._largest = self._in.array(used), self._in.array(_largest(used))
        self._offset = list(map(self._in.number, offsets["y"]))
        offset: np.ndarray = np.array(list(map(self._in.number, offsets["u"])), self._in.kind)
        offset = offset.reshape(-1, *[1] * (y.ndim - 2))
        self._inputs = _moved(self._in.array(inputs), offset)
        self._input_sizes = _largest(inputs) + np.abs(doubles(reading.offset_u)).reshape(offset.shape)
        self._input_slips = None
        if y.dtype != np.float64:
            self._input_slips = self._in.array(input_slip(inputs))
        self._series: dict[tuple[Kind, int], Series] = {}

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

    def row(self, i: int) -> Series:
        """Return the ends of a row in each window, and its size."""
        row = self._reading.window.all[i]
        series = self._of(row.kind, row.number)
        if not isinstance(series.lo, np.ndarray) or not isinstance(series.hi, np.ndarray):
            return series
        return Series(self._cut(series.lo, row.first), self._cut(series.hi, row.first), series.size)

    def input(self, b: int) -> Input:
        """Return an input in each window."""
        lag, i = divmod(b, self._inputs.shape[1])
        slip: Ends = 0
        if self._input_slips is not None:
            slip = self._cut(self._input_slips[:, i], lag)
        return Input(self._cut(self._inputs[:, i], lag), slip, self._input_sizes[i])

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the ends (rows, N) of all rows of windows, NaN of those that are not looked at."""
        window = self._reading.window
        both: np.ndarray = np.full((2, len(window), self.count), np.nan, self._in.kind)
        lo, hi = both
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

    def absent(self) -> np.ndarray:
        """Return (rows, N) bool: which rows windows lack."""
        return self._reading.window.absent(self._y)

    def floor(self) -> int:
        """Return at least what is left out of the bound of a row, of whole numbers."""
        tiny = Fraction(float(rounding.tiny(self._y.dtype)))
        shares = [2 / (1 - Fraction(float(x))) for x in self._reading.tolerance]
        shares += [10 * (values.terms + values.size) for values in self._reading.window.sums]
        return ceil(max(shares) * tiny * self.unit)

    def known(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (l, N) the inputs of windows, how far they may be off, and which are missing."""
        inputs, missing = self._inputs, np.isnan(self._reading.inputs(self._u))
        slips: np.ndarray = np.zeros(inputs.shape, self._in.kind)
        if self._input_slips is not None:
            slips = self._input_slips
        known, off, gone = (x.reshape(-1, self.count) for x in (inputs, slips, missing))
        return known, off, gone

    def _cut(self, series: np.ndarray, first: int) -> np.ndarray:
        """Return, of a series over samples, the one of each window that comes so many after its first."""
        if self._y.ndim == 3:
            return np.asarray(series[first])
        return series[first : first + self.count]

    def _of(self, kind: Kind, number: int) -> Series:
        """Return the rows of one kind and number."""
        if (kind, number) not in self._series:
            evaluate = {
                Kind.READING: self._readings,
                Kind.DISTURBANCE: self._disturbance,
                Kind.SUM: self._sums,
            }
            self._series[kind, number] = evaluate[kind](number)
        return self._series[kind, number]

    def _readings(self, i: int) -> Series:
        """Return the true values of an output, in deviations."""
        r, own, offset = self._reading, self._in, self._offset[i]
        sigma = Fraction(float(r.tolerance[i]))
        noise: Ends = own.number(float(r.noise[i]))
        factor = r.factor(self._u, i)
        if factor is not None:
            noise = own.factored(noise, factor)
        # noise, resolution, what the recorder rounded, and what these sums lose
        rho = (self._slip(i, noise) + (noise + 4 * own.tiny)) * own.slightly
        d = _moved(self._samples[:, i], offset)
        lo, hi = d - rho, d + rho
        if sigma and not self._certain:
            wide, near = 1 / (1 - sigma), 1 / (1 + sigma)
            # extreme at an end of the tolerance, which end depends on the sign
            lo = np.minimum(own.times(lo, wide), own.times(lo, near))
            hi = np.maximum(own.times(hi, wide), own.times(hi, near))
        if self.exact:
            return Series(lo, hi, 0)
        widest = rho
        if factor is not None:
            widest = np.max(rho, 0)
        # the largest factor, a little more than its float
        most = float(1 / (1 - sigma)) * SLIGHTLY
        return Series(lo, hi, (self._largest[i] + abs(offset) + widest) * most)

    def _slip(self, i: int, noise: Ends) -> Ends:
        """Return how much resolution and recorder may have rounded away of samples of an output."""
        recorded = self._in.times(self._largest[i] + noise, self._recorded)
        return self._in.number(float(self._reading.resolution[i])) + recorded

    def _disturbance(self, j: int) -> Series:
        """Return a disturbance: its bounds."""
        lo, hi = (self._in.number(float(x)) for x in self._reading.disturbance[j])
        return Series(lo - self._in.tiny, hi + self._in.tiny, abs(lo) + abs(hi) + self._in.tiny)

    def _sums(self, number: int) -> Series:
        """Return the runs of a bounded sum, as `Reading.block` has them."""
        r, own, values = self._reading, self._in, self._reading.window.sums[number]
        half: Ends = own.number(float(r.average[number]))
        mid: np.ndarray = np.zeros((), own.kind)
        reach = np.zeros(())
        if values.measured:
            runs = len(self._y) - values.samples + 1
            if r.follows(values):
                half = self._followed(values, half, runs)
            for i, weights in values.parts:
                noise: Ends = own.number(float(r.noise[i]))
                factor = r.factor(self._u, i)
                if factor is not None:
                    noise = np.max(own.factored(noise, factor), 0)
                slip = self._slip(i, noise)
                half = half + own.times(slip, values.size_of(i))
                d = self._samples[:, i] - self._offset[i]
                for lag, weight in enumerate(weights):
                    mid = mid + own.times(d[lag : lag + runs], weight)
                if not self.exact:
                    reach = reach + float(values.size_of(i)) * (self._largest[i] + abs(self._offset[i]))
        size: Ends = 0
        if not self.exact:
            half = half * SLIGHTLY + own.tiny * (values.terms + float(values.size)) * 8
            widest = np.max(np.atleast_1d(half), 0)
            size = (2 + values.terms / r.averaging(values)) * (reach + widest)
        if not values.measured:
            return Series(-half, half, size)
        return Series(mid - half, mid + half, size)

    def _followed(self, values: WeightedSum, bound: Ends, runs: int) -> np.ndarray:
        """Return the bound of each run of a sum: times the mean of the factors on its samples, by weight."""
        own = self._in
        total: np.ndarray = np.zeros((), own.kind)
        for i, weights in values.parts:
            factor = self._reading.factor(self._u, i)
            for lag, weight in enumerate(weights):
                allowed = bound
                if factor is not None:
                    allowed = own.factored(bound, factor[lag : lag + runs])
                total = total + own.times(allowed, abs(weight) / values.size)
        return total


def doubles(x: Array) -> np.ndarray:
    """Return an array in float64, on the host."""
    return np.asarray(x, np.float64)


def _moved(x: np.ndarray, offset: Ends) -> np.ndarray:
    """Return x - offset: x itself for 0, of which no copy is made."""
    if not np.any(offset):
        return x
    return np.asarray(x - offset)


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
