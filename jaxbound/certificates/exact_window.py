"""One window in exact rationals: the limits that samples and bounds set, and how far the model is from
keeping them.

    (Y, w) = E z + K U,   z = (first state, disturbances, unknown inputs, missing inputs)      rows: true
    outputs Y, disturbances w
    lo <= (Y, w) <= hi                                                           what samples and bounds say

The sensors' intervals are those of `models.sensor`, here as lo, hi: a reading y = (1 + theta) t + delta with
|theta| <= sigma, |delta| <= rho says t in [-f(rho - y), f(rho + y)], f(v) = v / (1 - sigma) for v > 0, else v
/ (1 + sigma).
"""

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Protocol, Self, TypeAlias

import numpy as np

from jaxbound.certificates.plain import exact_floats, plain_factors
from jaxbound.consistency.interface import Bounds
from jaxbound.exact import linalg
from jaxbound.exact.chebyshev import Reference, chebyshev
from jaxbound.exact.linalg import Matrix, Vector, dot
from jaxbound.models import window
from jaxbound.models.rows import Row, WindowRows
from jaxbound.models.sensor import RECORDER_ULPS
from jaxbound.models.system import LinearSystem
from jaxbound.models.window import window_rows
from jaxbound.sets.floats import rounding

__all__ = """
    Ends ExactWindow Explanation exact_samples exact_window known_inputs readable_relation rounded_up
    rounded_witness shorter stretched unstretched
""".split()

ZERO = Fraction(0)
DIGITS = (4, 8, 12, 17)
"""Of numbers that are rounded for readers, as few as will do."""
LARGEST = Fraction(10**300)
"""Of a number that is rounded for readers."""
Ends: TypeAlias = tuple[Fraction, Fraction]
"""(lo, hi) of a number."""
Samples: TypeAlias = tuple[Fraction | None, ...]
"""Samples of a window, time-major, None where one is missing."""


class Bounded(Protocol):
    """A stretch of samples and its bounds: relations of certain or uncertain models, or a `Stretch`."""

    @property
    def model(self) -> LinearSystem:
        """The plant."""

    @property
    def horizon(self) -> int:
        """It has horizon + 1 samples."""

    @property
    def bounds(self) -> Bounds:
        """{name: numbers}."""

    @property
    def lags(self) -> tuple[int, ...] | None:
        """The samples before its last at which outputs are looked at; None: all of them."""


@dataclass(frozen=True)
class Explanation:
    """The nearest that a window comes to its bounds.

    Fields: factor, on all bounds, at which it just becomes consistent; h, k: the tightest relation h (Y, w) =
    k U of an exact plant (zeros where there is none); residual, width: its value at the middles and the
    largest that the bounds allow, factor = |residual| / width;
    z: unknowns that keep all rows within factor times their bounds; reference: a start for a similar window.
    """

    factor: Fraction
    h: Vector
    k: Vector
    residual: Fraction
    width: Fraction
    z: Vector
    reference: Reference | None = None


@dataclass(frozen=True, eq=False)
class ExactWindow:
    """The samples and bounds of one window, every number a Fraction.

    Fields: model, horizon; u (l,) and y ((s+1)p,): the recorded samples time-major, None where missing;
    tolerance, noise, resolution (p,); disturbance (g, 2); unit: the roundoff of the recording's float type;
    floor: its smallest normal number, in every bound; drive: what the inputs that are there make of each row.
    average (a,): bounds of averages; whole ((s+1)p,): all samples, also those that only averages look at;
    lags: of the relations. factors ((s+1)p,): on the noise of each sample, 1 where there is none; empty: the
    model has none. own: (E, K) of its rows, where a parameter is another; None: those of the model. first:
    bounds of the first state, or None. unweighed: why no fault of it is weighed; "": they are.
    """

    model: LinearSystem
    horizon: int
    u: Samples
    y: Samples
    tolerance: Vector
    noise: Vector
    resolution: Vector
    disturbance: tuple[Ends, ...]
    unit: Fraction
    floor: Fraction
    drive: Vector
    average: Vector = ()
    whole: Samples = ()
    lags: tuple[int, ...] | None = None
    factors: Vector = ()
    own: tuple[Matrix, Matrix] | None = None
    first: tuple[Ends, ...] | None = None
    unweighed: ClassVar[str] = ""

    def with_limits(self, limits: Iterable[Ends | None]) -> Self:
        """Return the window with other limits of its rows: what is supposed, bounds do not know."""
        other = copy(self)
        vars(other)["limits"] = list(limits)
        return other

    def without_input(self, i: int) -> Self:
        """Return the window with every sample of input i missing: whatever the actuator did."""
        u = list(self.u)
        u[i :: self.model.m] = [None] * len(u[i :: self.model.m])
        drive = linalg.multiply(self.forms[1], known_inputs(self.model, u))
        return replace(self, u=tuple(u), drive=drive)

    @cached_property
    def rows(self) -> WindowRows:
        """The rows of the window: see `models.rows`."""
        return window_rows(self.model, self.horizon, self.lags)

    def readings(self) -> list[tuple[Fraction | None, Fraction]]:
        """Return (d, rho) of each sample: its deviation from the offset (None where missing) and the largest
        |delta|.
        """
        p, offset = self.model.p, self.model.offset["y"]
        readings: list[tuple[Fraction | None, Fraction]] = []
        for j, v in enumerate(self.y):
            i = j % p
            rho = self.noise[i] + self.rounded[i] + self.floor
            if self.factors:
                rho += (self.factors[j] - 1) * self.noise[i] * (1 + RECORDER_ULPS * self.unit)
            if v is None:
                readings.append((None, rho))
            else:
                readings.append((v - offset[i], rho))
        return readings

    @cached_property
    def rounded(self) -> list[Fraction]:
        """The largest |delta| of each output beyond its noise, where that is times no factor: resolution, and
        what the recorder rounds away of the largest sample that is looked at.
        """
        p = self.model.p
        largest = [ZERO] * p
        for j, v in enumerate(self.y):
            if v is not None:
                largest[j % p] = max(largest[j % p], abs(v))
        for row in self.rows.of_sums:
            if row.seen and row.values.measured:
                for x in self.rows.terms(row):
                    largest[x.number] = max(largest[x.number], abs(self.whole[x.row] or ZERO))
        rounded = []
        for i, most in enumerate(largest):
            rounded.append(self.resolution[i] + RECORDER_ULPS * self.unit * (most + self.noise[i]))
        return rounded

    def _ends_of_sum(self, row: Row) -> Ends | None:
        """Return (lo, hi) of a sum, None where a sample of it is missing or it is not looked at.

        The bound is one on the sum of noises. What resolution, recorder and an error add to each reading is
        added by its weight; the floors are for numbers that a kernel rounds to zero on the way.
        """
        values, middle = row.values, ZERO
        rad = self.average[row.number] + 10 * (values.terms + values.size) * self.floor
        if values.measured:
            for i, _ in values.parts:
                rad += values.size_of(i) * self.rounded[i]
            for x in self.rows.terms(row):
                reading = self.whole[x.row]
                if reading is None or not row.seen:
                    return None
                middle += x.weight * (reading - self.model.offset["y"][x.number])
        return middle - rad, middle + rad

    @cached_property
    def limits(self) -> list[Ends | None]:
        """(lo, hi) of each row of (Y, w), in deviations from the offset; None where a sample is missing."""
        limits: list[Ends | None] = []
        for j, (d, rho) in enumerate(self.readings()):
            if d is None:
                limits.append(None)
                continue
            sigma = self.tolerance[j % self.model.p]
            limits.append((-stretched(rho - d, sigma), stretched(rho + d, sigma)))  # f of the module
        for _ in range(self.horizon):
            limits += [(lo - self.floor, hi + self.floor) for lo, hi in self.disturbance]
        return limits + [self._ends_of_sum(row) for row in self.rows.of_sums]

    def known_limits(self, number: int) -> Ends:
        """Return (lo, hi) of a row that has its samples."""
        ends = self.limits[number]
        assert ends is not None, f"row {number} lacks a sample"
        return ends

    def solve(self, start: Reference | None = None) -> Explanation:
        """Return the Explanation of this window. `start`: the reference of a similar one (same samples
        missing).
        """
        rows = tuple(i for i, ends in enumerate(self.limits) if ends is not None)
        middles, radii = [], []
        for i in rows:
            lo, hi = self.known_limits(i)
            middles.append((lo + hi) / 2 - self.drive[i])
            radii.append((hi - lo) / 2)
        E = self.unknown_columns()
        best = chebyshev([E[i] for i in rows], middles, radii, start)
        h = [ZERO] * len(self.limits)
        for i, x in zip(rows, best.h, strict=True):
            h[i] = x
        shown = readable_relation(h)
        k, residual, width = self.relation(shown)
        return Explanation(best.t, shown, k, residual, width, best.z, best.reference)

    @property
    def forms(self) -> tuple[Matrix, Matrix]:
        """(E, K): (Y, w) = E z + K U, with z = (first state, disturbances, unknown inputs)."""
        return self.own or _forms(self.model, self.horizon)

    def unknown_columns(self) -> Matrix:
        """Return E with the columns of the missing inputs, which are unknowns as well, behind it."""
        E, K = self.forms
        return linalg.beside(E, linalg.columns_of(K, self.missing_inputs))

    @property
    def constant(self) -> bool:
        """Whether a tolerance keeps one value over the window: then samples together say more than these
        limits (`ConstantWindow`).
        """
        return self.model.constant_tolerance and any(self.tolerance)

    @property
    def missing_inputs(self) -> tuple[int, ...]:
        """The numbers of the inputs that are missing and matter."""
        K = self.forms[1]
        return tuple(j for j, v in enumerate(self.u) if v is None and any(row[j] for row in K))

    def action(self, h: Sequence[Fraction]) -> Vector:
        """Return k, what a relation h does with the inputs: h (Y, w) = k U, so k = h K."""
        weights, rows = [], []
        for x, row in zip(h, self.forms[1], strict=True):
            if x:  # a relation uses few of all rows
                weights.append(x)
                rows.append(row)
        return linalg.multiply(linalg.transpose(rows), weights) or (ZERO,) * len(self.u)

    def relation(self, h: Sequence[Fraction]) -> tuple[Vector, Fraction, Fraction]:
        """Return (k, residual, width) of a relation h that annihilates E and needs no missing sample.

        h (Y, w) - k U is residual -+ width within the limits: their middles, and |h| times their half-widths.
        """
        weights, sums, widths = [], [], []
        for number, x in enumerate(h):
            if x:
                lo, hi = self.known_limits(number)
                weights.append(x)
                sums.append(lo + hi)
                widths.append(hi - lo)
        residual = dot(weights, sums) / 2 - dot(h, self.drive)
        return self.action(h), residual, dot(map(abs, weights), widths) / 2

    def rows_at(self, z: Sequence[Fraction]) -> Vector:
        """Return the true (Y, w) = E z + K U, in deviations, at unknowns z = (x, w, v, missing inputs)."""
        moved = linalg.multiply(self.unknown_columns(), z)
        return linalg.add_multiple(moved, 1, self.drive)

    def of_first(self, h: Sequence[Fraction]) -> Vector:
        """Return the multipliers of bounds of the first state: none here."""
        return ()

    def gains(self, z: Sequence[Fraction]) -> Vector:
        """Return the gains, the same in all samples of an output, that unknowns z end with: none here."""
        return ()

    def limits_at(self, z: Sequence[Fraction]) -> list[Ends | None]:
        """Return the limits of each row where unknowns are z: the same for all of them here."""
        return self.limits

    def explained_by(self, z: Sequence[Fraction]) -> bool:
        """Return True if unknowns z keep every row within its limits."""
        for ends, v in zip(self.limits_at(z), self.rows_at(z), strict=True):
            if ends is not None and not ends[0] <= v <= ends[1]:
                return False
        return True


def stretched(v: Fraction, sigma: Fraction) -> Fraction:
    """Return f(v) = v / (1 - sigma) for v > 0, else v / (1 + sigma): the largest t of a reading, increasing
    in v.
    """
    if v > 0:
        return v / (1 - sigma)
    return v / (1 + sigma)


def unstretched(v: Fraction, sigma: Fraction) -> Fraction:
    """Return the number of which f of `stretched` is v."""
    if v > 0:
        return v * (1 - sigma)
    return v * (1 + sigma)


def rounded_witness(window: ExactWindow, z: Vector) -> Vector:
    """Return z with as few digits as still explain the window."""
    states = window.model.n
    for candidate in shorter(z):
        short = list(candidate)
        for j, (lo, hi) in enumerate(window.disturbance * window.horizon, states):
            short[j] = max(lo, min(short[j], hi))
        if window.explained_by(short):
            return tuple(short)
    return z


def shorter(values: Sequence[Fraction]) -> Iterator[Vector]:
    """Yield numbers rounded for readers, of few digits first; none where they are beyond floats."""
    if all(abs(v) <= LARGEST for v in values):
        for digits in DIGITS:
            yield tuple(Fraction(f"{float(v):.{digits}g}") for v in values)


def rounded_up(x: Fraction, digits: int = 4) -> Fraction:
    """Return a number of few digits that is not below x > 0."""
    unit = Fraction(10) ** (len(str(x.numerator)) - len(str(x.denominator)) - digits)
    return -(-x // unit) * unit


def known_inputs(model: LinearSystem, u: Sequence[Fraction | None]) -> Vector:
    """Return inputs in deviations from their offsets, 0 for those that are missing."""
    known = []
    for j, v in enumerate(u):
        if v is None:
            known.append(ZERO)
        else:
            known.append(v - model.offset["u"][j % model.m])
    return tuple(known)


def readable_relation(h: Sequence[Fraction]) -> Vector:
    """Return the same relation in numbers that people can read: coprime, or divided by the largest."""
    if not any(h):
        return tuple(h)
    return linalg.presentable(linalg.primitive(h))


def exact_window(relations: Bounded, u: np.ndarray, y: np.ndarray) -> ExactWindow:
    """Return the ExactWindow of samples u (s+1, m), factors on noise behind them, y (s+1, p). The bounds are
    those that the kernel takes, to the last bit.
    """
    samples = exact_samples(relations, u, y)
    K = _forms(relations.model, relations.horizon)[1]
    return ExactWindow(**samples, drive=linalg.multiply(K, known_inputs(relations.model, samples["u"])))


def exact_samples(relations: Bounded, u: np.ndarray, y: np.ndarray) -> dict[str, Any]:
    """Return the fields of an ExactWindow, all but what inputs make of each row."""
    model, s, dtype = relations.model, relations.horizon, y.dtype
    bounds = {name: np.asarray(value, np.float64) for name, value in relations.bounds.items()}
    pairs = np.reshape(bounds.get("disturbance", np.zeros((0, 2))), (-1, 2))
    lowest = _exactly(rounding.round_down(pairs[:, 0], dtype))
    highest = _exactly(rounding.round_up(pairs[:, 1], dtype))
    looked_at, m = y, model.m
    if relations.lags is not None:
        kept = np.isin(s - np.arange(s + 1), relations.lags)
        looked_at = np.where(kept[:, None], y, np.nan).astype(dtype)
    return {
        "model": model,
        "horizon": s,
        "u": exact_floats(u[: window.input_lags(model, s), :m]),
        "y": exact_floats(looked_at),
        "tolerance": _exactly(rounding.round_up(bounds["tolerance"], dtype)),
        "noise": _exactly(rounding.round_up(bounds["noise"], dtype)),
        "resolution": _exactly(rounding.round_up(list(model.resolution), dtype)),
        "disturbance": tuple(zip(lowest, highest, strict=True)),
        "unit": Fraction(float(np.finfo(dtype).eps)) / 2,
        "floor": Fraction(float(np.finfo(dtype).tiny)),
        "average": _exactly(rounding.round_up(bounds.get("average", ()), dtype)),
        "whole": exact_floats(y),
        "lags": relations.lags,
        "factors": tuple(x for row in plain_factors(model, u) or () for x in row),
    }


def _exactly(bounds: np.ndarray) -> Vector:
    return tuple(map(Fraction, bounds.tolist()))


@lru_cache(maxsize=16)
def _forms(model: LinearSystem, horizon: int) -> tuple[Matrix, Matrix]:
    return window.unknowns(model, horizon)
