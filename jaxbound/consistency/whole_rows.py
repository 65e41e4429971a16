"""The rows of windows in whole numbers: exact, for blocks of windows.

One of three evaluators of `models.rows`. Samples and bounds are floats, offsets and weights rationals: times
a power of two and their denominators all are integers, in NumPy arrays of Python's. A reading
y = (1 + theta) t + delta says t in [-f(rho - d), f(rho + d)], f(v) = v / (1 - sigma) for v > 0, else
v / (1 + sigma), d = y - offset; times (1 - sigma) (1 + sigma) its ends are integers too.

The floor of the bounds, the smallest normal number, is left out of all rows: whoever proves FAULT adds it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import lcm

import numpy as np

from jaxbound.consistency.reading import Reading
from jaxbound.exact.integers import places, total, whole_floats
from jaxbound.models.rows import Kind, Row, WindowRows
from jaxbound.models.sensor import RECORDER_ULPS, input_slip
from jaxbound.models.system import LinearSystem
from jaxbound.sets.floats import rounding

__all__ = ["WholeRows", "whole_rows"]


@dataclass(frozen=True, eq=False)
class WholeRows:
    """Rows in integers, to be divided by `scale`, and multiplied by their entry of `factor`.

    Fields: twice, spread: hi + lo and hi - lo of each row, arrays (N,) of integers; factor: Fractions; known,
    slip (l, N): v and how far it may be off; absent (rows, N), missing (l, N): bool; scale: an integer;
    floor: a Fraction, at least the part left out of a row's half-width.
    """

    twice: list[np.ndarray]
    spread: list[np.ndarray]
    factor: list[Fraction]
    known: np.ndarray
    slip: np.ndarray
    absent: np.ndarray
    missing: np.ndarray
    scale: int
    floor: Fraction


def whole_rows(model: LinearSystem, reading: Reading, u: np.ndarray, y: np.ndarray) -> WholeRows:
    """Return the WholeRows of windows u (lags, m, N), y (s + 1, p, N), NaN where missing."""
    numbers = _numbers(model, reading, u, y)
    evaluate = {Kind.READING: _of_reading, Kind.DISTURBANCE: _of_disturbance, Kind.SUM: _of_sum}
    u = reading.inputs(u)
    twice, spread, factor = [], [], []
    for row in reading.window:
        middle, width, share = evaluate[row.kind](numbers, row)
        twice.append(middle)
        spread.append(width)
        factor.append(share)
    N, missing = y.shape[2], np.isnan(u)
    return WholeRows(
        twice,
        spread,
        factor,
        numbers.known.reshape(-1, N),
        numbers.slip.reshape(-1, N),
        reading.window.absent(y),
        missing.reshape(-1, N),
        numbers.scale,
        _floor(reading, float(rounding.tiny(y.dtype))),
    )


def _floor(reading: Reading, tiny: float) -> Fraction:
    """Return at least the part of a row's half-width that is left out."""
    stretch = max(1 / (1 - Fraction(float(x))) for x in reading.tolerance)
    floor = 2 * stretch * Fraction(tiny)
    for number, values in enumerate(reading.window.sums):
        if reading.window.runs(number):
            floor = max(floor, 10 * (values.terms + values.size) * Fraction(tiny))
    return floor


@dataclass(frozen=True, eq=False)
class _Numbers:
    """Samples and bounds in integers, to be divided by `scale`.

    Fields: window; deviations (s + 1, p, N) from the offsets, of missing samples any; known, slip (lags, m,
    N); noise, rounded (p,): of rounded its entries are (N,), resolution and rounding of the recorder, of both
    (s + 1, N) where noise is times a factor; tolerance (p,) Fractions; disturbance [(lo, hi)]; average
    [bound].
    """

    window: WindowRows
    deviations: np.ndarray
    known: np.ndarray
    slip: np.ndarray
    noise: list[np.ndarray]
    rounded: list[np.ndarray]
    tolerance: list[Fraction]
    disturbance: np.ndarray
    average: np.ndarray
    scale: int


def _numbers(model: LinearSystem, reading: Reading, u: np.ndarray, y: np.ndarray) -> _Numbers:
    """Return the _Numbers of windows, all over the smallest denominator that a power of two and the offsets
    need.
    """
    used = np.where(reading.window.used[:, :, None], y, np.nan)
    factors: dict[int, np.ndarray] = {}
    for i in reading.times:
        factor = reading.factor(u, i)
        if factor is not None:
            factors[i] = factor
    u = reading.inputs(u)
    inputs = np.where(np.isnan(u), 0, u)
    slip = input_slip(inputs)
    bounds = [
        np.asarray(x, np.float64)
        for x in (reading.noise, reading.resolution, reading.disturbance, reading.average)
    ]
    # the recorder's ulps are a power of two: shifted by it sizes of samples still are integers
    shift = -int(np.log2(float(RECORDER_ULPS * rounding.unit(y.dtype))))
    finest = max(map(places, factors.values()), default=0)
    power = max(0, shift + max(map(places, (u, slip, used, *bounds))) + finest)
    offsets = (*model.offset["u"], *model.offset["y"])
    common = lcm(*(x.denominator for x in offsets))

    def whole(x: np.ndarray) -> np.ndarray:
        return whole_floats(x, power) * common

    def whole_offset(values: Sequence[Fraction]) -> np.ndarray:
        return np.array([int(x * common) << power for x in values], object).reshape(1, -1, 1)

    noise, resolution, disturbance, average = map(whole, bounds)
    samples = whole(np.where(np.isnan(used), 0, used))
    noises, rounded = list(noise), []
    for i in range(len(noise)):
        if i in factors:
            noises[i] = noise[i] * whole_floats(factors[i], finest) >> finest
        largest = np.abs(samples[:, i]).max(0)
        rounded.append(resolution[i] + ((largest + noises[i]) >> shift))
    return _Numbers(
        reading.window,
        samples - whole_offset(model.offset["y"]),
        whole(inputs) - whole_offset(model.offset["u"]),
        whole(slip),
        noises,
        rounded,
        [Fraction(float(x)) for x in reading.tolerance],
        disturbance,
        average,
        common << power,
    )


def _of_reading(numbers: _Numbers, row: Row) -> tuple[np.ndarray, np.ndarray, Fraction]:
    """Return (hi + lo, hi - lo, factor) of a true output behind its reading."""
    i, sigma = row.number, numbers.tolerance[row.number]
    over = int((1 + sigma) * sigma.denominator)
    under = int((1 - sigma) * sigma.denominator)
    either = np.array([under, over], object)  # which may be too long for 64 bits
    rho = numbers.noise[i] + numbers.rounded[i]
    if np.ndim(rho) > 1:  # of each sample
        rho = rho[row.first]
    d = numbers.deviations[row.first, i]
    above, below = rho + d, rho - d
    # times (1 - sigma) (1 + sigma) and the denominator of sigma
    hi = above * either[(above > 0).astype(int)]
    lo = -below * either[(below > 0).astype(int)]
    return hi + lo, hi - lo, Fraction(sigma.denominator, over * under)


def _of_disturbance(numbers: _Numbers, row: Row) -> tuple[np.ndarray, np.ndarray, Fraction]:
    """Return (hi + lo, hi - lo, factor) of a disturbance: its bounds."""
    lo, hi = numbers.disturbance[row.number]
    N = numbers.deviations.shape[2]
    return np.full(N, hi + lo, object), np.full(N, hi - lo, object), Fraction(1)


def _of_sum(numbers: _Numbers, row: Row) -> tuple[np.ndarray, np.ndarray, Fraction]:
    """Return (hi + lo, hi - lo, factor) of a weighted sum, its weights whole over one denominator."""
    values, N = row.values, numbers.deviations.shape[2]
    terms = numbers.window.terms(row)
    common = lcm(*(term.weight.denominator for term in terms))
    middle = np.zeros(N, object)
    half = common * numbers.average[row.number] + np.zeros(N, object)
    if values.measured:
        for i, _ in values.parts:
            half = half + int(values.size_of(i) * common) * numbers.rounded[i]
        middle = total(int(x.weight * common) * numbers.deviations[x.sample, x.number] for x in terms)
    return 2 * middle, 2 * half, Fraction(1, common)
