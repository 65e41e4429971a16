"""One window in exact rationals: what its samples and bounds say, and how far the model is from explaining
them.

    (Y, w) = E z + K U,   z = (first state, disturbances, unknown inputs, missing inputs)      rows: true
    outputs Y, disturbances w
    lo <= (Y, w) <= hi                                                           what samples and bounds say

The sensors' intervals are those of `models.sensor`, here as lo, hi: a reading y = (1 + theta) t + delta with
|theta| <= sigma, |delta| <= rho says t in [-f(rho - y), f(rho + y)], f(v) = v / (1 - sigma) for v > 0, else v
/ (1 + sigma).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np

from jaxbound.exact import linalg
from jaxbound.exact.chebyshev import chebyshev, subspace
from jaxbound.exact.linalg import dot
from jaxbound.models import window
from jaxbound.models.rows import Row, WindowRows
from jaxbound.models.sensor import RECORDER_ULPS
from jaxbound.models.system import LinearSystem
from jaxbound.models.window import window_rows
from jaxbound.sets.floats import rounding

__all__ = ["ExactWindow", "Explanation", "exact_samples", "exact_window", "stretched"]

ZERO = Fraction(0)


@dataclass(frozen=True)
class Explanation:
    """The nearest that a window comes to its bounds.

    Fields: factor, on all bounds, at which it just becomes consistent; h, k: the tightest relation h (Y, w) =
    k U of an exact plant (zeros where there is none); residual, width: its value at the middles and the
    largest that the bounds allow, factor = |residual| / width;
    z: unknowns that keep all rows within factor times their bounds; reference: a start for a similar window.
    """

    factor: Fraction
    h: tuple
    k: tuple
    residual: Fraction
    width: Fraction
    z: tuple
    reference: tuple


@dataclass(frozen=True, eq=False)
class ExactWindow:
    """The samples and bounds of one window, every number a Fraction.

    Fields: model, horizon; u (l,) and y ((s+1)p,): the recorded samples time-major, None where missing;
    tolerance, noise, resolution (p,); disturbance (g, 2); unit: the roundoff of the recording's float type;
    floor: its smallest normal number, in every bound; drive: what the inputs that are there make of each row;
    error (p,): what is allowed to a sensor beyond its bounds. average (a,): bounds of averages; whole
    ((s+1)p,): all samples, also those that only averages look at; lags: of the relations.
    """

    model: LinearSystem
    horizon: int
    u: tuple
    y: tuple
    tolerance: tuple
    noise: tuple
    resolution: tuple
    disturbance: tuple
    unit: Fraction
    floor: Fraction
    drive: tuple
    error: tuple = ()
    average: tuple = ()
    whole: tuple = ()
    lags: tuple | None = None

    def with_error(self, i: int, e: Fraction) -> Self:
        """Return the window with an error of up to e allowed to output i."""
        return replace(self, error=tuple(e if j == i else ZERO for j in range(self.model.p)))

    def without_input(self, i: int) -> Self:
        """Return the window with every sample of input i missing: whatever the actuator did."""
        m, offset = self.model.m, self.model.offset["u"]
        u = tuple(None if j % m == i else v for j, v in enumerate(self.u))
        known = [ZERO if v is None else v - offset[j % m] for j, v in enumerate(u)]
        return replace(self, u=u, drive=tuple(dot(row, known) for row in self.forms[1]))

    @cached_property
    def rows(self) -> WindowRows:
        """The rows of the window: see `models.rows`."""
        return window_rows(self.model, self.horizon, self.lags)

    def readings(self) -> list[tuple[Fraction | None, Fraction]]:
        """Return (d, rho) of each sample: its deviation from the offset (None where missing) and the largest
        |delta|.
        """
        p, offset = self.model.p, self.model.offset["y"]
        rho = []
        for i in range(p):
            rho.append(self.noise[i] + self.rounded[i] + self.floor)
        out = []
        for j, v in enumerate(self.y):
            out.append((None if v is None else v - offset[j % p], rho[j % p]))
        return out

    @cached_property
    def rounded(self) -> list[Fraction]:
        """The largest |delta| of each output beyond its noise: resolution, what the recorder rounds away of
        the largest sample that is looked at, and the error that is allowed to it.
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
            slip = self.resolution[i] + RECORDER_ULPS * self.unit * (most + self.noise[i])
            rounded.append(slip + self.error[i] if self.error else slip)
        return rounded

    def has_samples(self, row: Row) -> bool:
        """Return whether a sum is looked at and has all its samples."""
        if not row.values.measured:
            return True
        return row.seen and all(self.whole[x.row] is not None for x in self.rows.terms(row))

    def _ends_of_sum(self, row: Row) -> tuple[Fraction, Fraction] | None:
        """Return (lo, hi) of a sum, None where a sample of it is missing or it is not looked at."""
        if not self.has_samples(row):
            return None
        values, middle = row.values, ZERO
        rad = self.average[row.number] + 10 * (values.terms + values.size) * self.floor
        if values.measured:
            offset, terms = self.model.offset["y"], self.rows.terms(row)
            for i, _ in values.parts:
                rad += values.size_of(i) * self.rounded[i]
            middle = dot([x.weight for x in terms], [self.whole[x.row] - offset[x.number] for x in terms])
        return middle - rad, middle + rad

    @cached_property
    def limits(self) -> list[tuple[Fraction, Fraction] | None]:
        """(lo, hi) of each row of (Y, w), in deviations from the offset; None where a sample is missing."""
        out: list[tuple[Fraction, Fraction] | None] = []
        for (d, rho), row in zip(self.readings(), self.rows.all, strict=False):
            sigma = self.tolerance[row.number]
            out.append(None if d is None else (-stretched(rho - d, sigma), stretched(rho + d, sigma)))
        out += [(lo - self.floor, hi + self.floor) for lo, hi in self.disturbance] * self.horizon
        return out + [self._ends_of_sum(row) for row in self.rows.of_sums]

    def known_limits(self, number: int) -> tuple[Fraction, Fraction]:
        """Return (lo, hi) of a row that has its samples."""
        ends = self.limits[number]
        assert ends is not None, f"row {number} lacks a sample"
        return ends

    def solve(self, start: Any = None) -> Explanation:
        """Return the Explanation of this window. `start`: the reference of a similar one (same samples
        missing).
        """
        rows = tuple(i for i, x in enumerate(self.limits) if x is not None)
        middles, radii = [], []
        for i in rows:
            lo, hi = self.known_limits(i)
            middles.append((lo + hi) / 2 - self.drive[i])
            radii.append((hi - lo) / 2)
        best = chebyshev(self.space(rows), middles, radii, start)
        full = [ZERO] * len(self.limits)
        for i, x in zip(rows, best.h, strict=True):
            full[i] = x
        h = linalg.presentable(linalg.primitive(full)) if any(full) else tuple(full)
        k, residual, width = self.relation(h)
        return Explanation(best.t, h, k, residual, width, best.z, best.reference)

    @property
    def forms(self) -> tuple:
        """(E, K): (Y, w) = E z + K U, with z = (first state, disturbances, unknown inputs)."""
        return _forms(self.model, self.horizon)

    def space(self, rows: Sequence[int]) -> Any:
        """Return the Subspace of some rows over all unknowns."""
        return _subspace(self.model, self.horizon, rows, self.missing_inputs)

    @property
    def constant(self) -> bool:
        """Whether a tolerance keeps one value over the window: then samples together say more than these
        limits (`ConstantWindow`).
        """
        return self.model.constant_tolerance and any(self.tolerance)

    @property
    def missing_inputs(self) -> tuple[int, ...]:
        """The numbers of the inputs that are missing and matter."""
        return tuple(j for j, v in enumerate(self.u) if v is None and any(row[j] for row in self.forms[1]))

    def action(self, h: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """Return k, what a relation h does with the inputs: h (Y, w) = k U."""
        return tuple(dot(h, [row[j] for row in self.forms[1]]) for j in range(len(self.u)))

    def relation(self, h: Sequence[Fraction]) -> tuple[tuple[Fraction, ...], Fraction, Fraction]:
        """Return (k, residual, width) of a relation h that annihilates E and needs no missing sample."""
        used = [i for i, x in enumerate(h) if x]
        weights = [h[i] for i in used]
        limits = [self.known_limits(i) for i in used]
        twice_middle = dot(weights, [lo + hi for lo, hi in limits])
        twice_width = dot(map(abs, weights), [hi - lo for lo, hi in limits])
        return self.action(h), twice_middle / 2 - dot(h, self.drive), twice_width / 2

    def rows_at(self, z: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """Return the true (Y, w), in deviations, that unknowns z = (x, w, v, missing inputs) give."""
        (E, K), missing = self.forms, self.missing_inputs
        return tuple(
            dot((*e, *(k[j] for j in missing), Fraction(1)), (*z, d))
            for e, k, d in zip(E, K, self.drive, strict=True)
        )

    def gains(self, z: Sequence[Fraction]) -> tuple[Fraction, ...] | None:
        """Return the gains, the same in all samples of an output, with which unknowns z keep every reading:
        none here.
        """
        return ()

    def explained_by(self, z: Sequence[Fraction]) -> bool:
        """Return True if unknowns z keep every row within its limits."""
        return all(x is None or x[0] <= v <= x[1] for x, v in zip(self.limits, self.rows_at(z), strict=True))


def stretched(v: Fraction, sigma: Fraction) -> Fraction:
    """Return f(v) = v / (1 - sigma) for v > 0, else v / (1 + sigma): the largest t of a reading, increasing
    in v.
    """
    return v / (1 - sigma) if v > 0 else v / (1 + sigma)


def exact_window(relations: Any, u: np.ndarray, y: np.ndarray) -> ExactWindow:
    """Return the ExactWindow of samples u (s+1, m), y (s+1, p). The bounds are those that the kernel takes,
    to the last bit.
    """
    model, fields = relations.model, exact_samples(relations, u, y)
    known = [ZERO if v is None else v - model.offset["u"][j % model.m] for j, v in enumerate(fields["u"])]
    return ExactWindow(**fields, drive=tuple(dot(row, known) for row in _forms(model, relations.horizon)[1]))


def exact_samples(relations: Any, u: np.ndarray, y: np.ndarray) -> dict[str, Any]:
    """Return the fields of an ExactWindow, all but what inputs make of each row."""
    model, s = relations.model, relations.horizon
    dtype = y.dtype
    exactly = lambda values: tuple(None if np.isnan(v) else Fraction(float(v)) for v in np.ravel(values))
    upward = lambda values: exactly(rounding.round_up(values, dtype))
    bounds = {name: np.asarray(value, np.float64) for name, value in relations.bounds.items()}
    pairs = np.reshape(bounds.get("disturbance", np.zeros((0, 2))), (-1, 2))
    down = rounding.round_down(pairs[:, 0], dtype)
    inputs = exactly(u[: window.input_lags(model, s)])
    whole = exactly(y)
    if relations.lags is not None:
        y = np.where(np.isin(s - np.arange(s + 1), relations.lags)[:, None], y, np.nan).astype(dtype)
    return {
        "model": model,
        "horizon": s,
        "u": inputs,
        "y": exactly(y),
        "tolerance": upward(bounds["tolerance"]),
        "noise": upward(bounds["noise"]),
        "resolution": upward(list(model.resolution)),
        "disturbance": tuple(zip(exactly(down), upward(pairs[:, 1]), strict=True)),
        "unit": Fraction(float(np.finfo(dtype).eps)) / 2,
        "floor": Fraction(float(np.finfo(dtype).tiny)),
        "average": upward(bounds.get("average", ())),
        "whole": whole,
        "lags": relations.lags,
    }


@lru_cache(maxsize=16)
def _forms(model, horizon):
    return window.unknowns(model, horizon)


@lru_cache(maxsize=64)
def _subspace(model, horizon, rows, missing):
    """Return the span of the unknowns over the rows that are there."""
    E, K = _forms(model, horizon)
    return subspace([E[i] + tuple(K[i][j] for j in missing) for i in rows])
