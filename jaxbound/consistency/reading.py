"""Relations as kernels read them, and the rows of windows in floats.

One of three evaluators of `models.rows`: middles, radii and the magnitudes that rounding errors are relative
to, on arrays over windows, inside a kernel.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.models import sensor
from jaxbound.models.rows import WeightedSum, WindowRows
from jaxbound.sets.floats import rounding
from jaxbound.sets.strips.separation import Frame
from jaxbound.sets.strips.strips import Strips

Samples = TypeVar("Samples", np.ndarray, jax.Array)
Block: TypeAlias = tuple[np.ndarray, np.ndarray]
"""Samples (u, y) of as many windows as are judged at once."""
Parts: TypeAlias = tuple[jax.Array, jax.Array, jax.Array]
"""(mid, rad, scale) of some rows."""
Columns: TypeAlias = Sequence[Sequence[jax.Array]]
"""Samples of windows as columns (N,): [sample][channel]."""
AVERAGING = 16
"""Terms of a sum that the error bound of one row pays for, with a magnitude as large again: see
`Reading._summed`.
"""


class RowValues(NamedTuple):
    """Rows of N windows: arrays (rows, N), known (l, N)."""

    mid: jax.Array
    rad: jax.Array
    scale: jax.Array
    known: jax.Array
    known_scale: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Reading:
    """Everything a kernel needs of a relation: arrays are traced, so models of one shape share a compilation.

    Fields: shape, the Strips of circuits or relations or the Frame of an exchange search; tolerance, noise,
    resolution, offset_y (p,); disturbance (g, 2); offset_u (m,); window: its rows; lags, the samples of u in
    a window; average (a,): bounds of the sums of the window.
    times: numbers of the outputs whose noise is times a factor of each sample: the columns of u behind its m
    inputs are these factors. acting: of the lags, those at which inputs act; None: all.
    """

    shape: Strips | Frame
    tolerance: jax.Array
    noise: jax.Array
    resolution: jax.Array
    disturbance: jax.Array
    offset_u: jax.Array
    offset_y: jax.Array
    window: WindowRows = field(metadata={"static": True})
    lags: int = field(metadata={"static": True})
    average: jax.Array | np.ndarray = field(default_factory=lambda: np.zeros(0))
    times: tuple[int, ...] = field(default=(), metadata={"static": True})
    acting: int | None = field(default=None, metadata={"static": True})

    def inputs(self, u: Samples) -> Samples:
        """Return the inputs of windows u (lags, m, N), those that act, without the factors behind them."""
        if not self.times:
            return u
        return u[: self.acting, : len(self.offset_u)]

    def known_inputs(self, u: Samples) -> Samples:
        """Return the inputs (T, m) of samples u, without the factors behind them."""
        if not self.times:
            return u
        return u[:, : len(self.offset_u)]

    def factor(self, u: Samples, i: int) -> Samples | None:
        """Return the factor on the noise of output i, of samples u (T, m) or of windows (lags, m, N); None:
        it has none. 1 where it is missing: so is the sample of the output.
        """
        if i not in self.times:
            return None
        own = u[:, len(self.offset_u) + self.times.index(i)]
        if isinstance(own, np.ndarray):
            return np.where(np.isnan(own), np.asarray(1, own.dtype), own)
        return jnp.where(jnp.isnan(own), 1, own)

    def noise_at(self, u: jax.Array, i: int) -> jax.Array:
        """Return the noise of output i: times its factor at samples u, as of `factor`, where it has one."""
        factor = self.factor(u, i)
        if factor is None:
            return self.noise[i]
        return self.noise[i] * factor

    @property
    def horizon(self) -> int:
        """A window has horizon + 1 samples."""
        return self.window.horizon

    @property
    def lift(self) -> jax.Array:
        """At least every factor that multiplies a row after its own rounding."""
        return sensor.lift(self.tolerance)

    @property
    def strips(self) -> Strips:
        """The strips, of a reading that has them."""
        assert isinstance(self.shape, Strips)
        return self.shape

    @property
    def frame(self) -> Frame:
        """The frame, of a reading for an exchange search."""
        assert isinstance(self.shape, Frame)
        return self.shape

    def seen(self, y: Samples) -> Samples:
        """Return the samples y (s + 1, p, N) of windows, NaN where they are not looked at."""
        if self.window.lags is None:
            return y
        kept, nothing = self.window.kept[:, None, None], np.asarray(np.nan, y.dtype)
        if isinstance(y, np.ndarray):
            return np.where(kept, y, nothing)
        return jnp.where(kept, y, nothing)

    def silenced(self, known: Sequence[jax.Array] | jax.Array) -> jax.Array:
        """Say which windows lack a known value that some circuit needs: the circuits that are left do not
        describe their set exactly.
        """
        if not len(known):
            return jnp.zeros((), bool)
        if isinstance(known, jax.Array):  # one reduction, whatever the number of values
            used = jnp.any(self.strips.k != 0, 0)
            return jnp.any(jnp.isnan(known) & used[:, None], 0)
        silenced = jnp.zeros_like(known[0], bool)
        for b, value in enumerate(known):
            silenced |= jnp.isnan(value) & jnp.any(self.strips.k[:, b] != 0)
        return silenced

    def columns(self, u: jax.Array, y: jax.Array) -> tuple[Columns, Columns]:
        """Return the samples of all windows of a stretch, u (N + s, m), y (N + s, p), as `Columns`."""
        count = y.shape[0] - self.horizon
        return _later(u, self.lags, count), _later(y, self.horizon + 1, count)

    def windows(self, u: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the samples u (lags, m, N), y (s + 1, p, N) of all windows of a stretch, u (N + s, m), y (N
        + s, p).
        """
        count = y.shape[0] - self.horizon

        def cut(x: jax.Array, lags: int) -> jax.Array:
            def later(j: jax.Array) -> jax.Array:
                return jax.lax.dynamic_slice_in_dim(x.T, j, count, 1)

            samples: jax.Array = jax.lax.map(later, jnp.arange(lags))
            return samples

        return cut(u, self.lags), cut(y, self.horizon + 1)

    def block(self, u: jax.Array, y: jax.Array) -> RowValues:
        """Return the rows of N windows u (lags, m, N), y (s + 1, p, N) as arrays (rows, N), (l, N): few
        operations, whatever s.
        """
        whole, y = y, self.seen(y)
        count = y.shape[2]
        taken = whole
        if self.window.lags is not None:
            taken = jnp.where(self.window.used[:, :, None], whole, jnp.nan)
        largest = jnp.max(jnp.where(jnp.isnan(taken), 0, abs(taken)), 0, keepdims=True)
        noise = self.noise[None, :, None]
        if self.times:
            each = [self.noise_at(u, i) * jnp.ones_like(y[:, i]) for i in range(y.shape[1])]
            noise = jnp.stack(each, 1)
        own = sensor.true_value(
            y,
            self.tolerance[None, :, None],
            noise,
            self.resolution[None, :, None],
            self.offset_y[None, :, None],
            largest,
        )
        parts = [tuple(x.reshape(-1, count) for x in own)]
        if self.horizon and len(self.disturbance):
            parts += [self._disturbance(y[0, 0])] * self.horizon
        parts += [self._summed(number, u, whole, largest[0]) for number in range(len(self.window.sums))]
        mid, rad, scale = map(jnp.concatenate, zip(*parts, strict=True))
        u = self.inputs(u)
        known = u - self.offset_u[None, :, None]
        known_scale = abs(u) + abs(self.offset_u)[None, :, None]
        return RowValues(mid, rad, scale, known.reshape(-1, count), known_scale.reshape(-1, count))

    def follows(self, values: WeightedSum) -> bool:
        """Return whether the bound of a sum is times factors."""
        return values.measured and any(i in self.times for i, _ in values.parts)

    def averaging(self, values: WeightedSum) -> int:
        """Return the terms of a sum that the error bound of one row pays for, see `_summed`."""
        if self.follows(values):
            return AVERAGING // 2
        return AVERAGING

    def _summed(self, number: int, u: jax.Array, y: jax.Array, largest: jax.Array) -> Parts:
        """Return (mid, rad, scale) of the runs of one sum, (runs, N) each, NaN in mid and scale where a
        sample is missing.

        The middle, a sum of n products, is off by (n + 4) u S and the radius by (n + 8) u S with S the
        magnitude of all its terms and the radius together; a magnitude of (2 + n / 16) S has
        `rounding.residual_error` pay for that: 32 u (1 + n / 16) S beyond what it pays for any row. A bound
        times the mean of n factors is off by (n + 4) u S more, which n / 8 in place of n / 16 pays for. What
        underflows costs less than the floor in the radius.
        """
        values, runs = self.window.sums[number], self.window.runs(number)
        dtype, tiny = y.dtype, float(rounding.tiny(y.dtype)) * 6
        parts = [(i, tuple(map(float, weights))) for i, weights in values.parts]
        n, total = values.samples * len(parts), sum(_size(weights) for _, weights in parts)
        bound, one = self.average[number] + tiny * (n + total), jnp.ones((len(runs), y.shape[2]), dtype)
        if not values.measured or not runs:
            rad = bound * one
            return 0 * one, rad, (2 + n / AVERAGING) * rad
        slips = [self._slip(i, largest, self._most_noise(u, i)) for i, _ in parts]
        sums: tuple[jax.Array, ...] = ()
        for i, weights in parts:
            sums = self._added(sums, one, weights, y, i)
        mid, magnitude = sums
        rad = bound * one
        if self.follows(values):
            rad = self._followed(number, u, 2 * tiny * (n + total) * one)
        for (_, weights), slip in zip(parts, slips, strict=True):
            rad = rad + np.asarray(_size(weights), dtype) * slip[None]
        looked = np.array([row.seen for row in runs])[:, None]
        scale = jnp.where(looked, (2 + n / self.averaging(values)) * (magnitude + rad), jnp.nan)
        return jnp.where(jnp.isnan(scale), jnp.nan, mid), rad, scale

    def _followed(self, number: int, u: jax.Array, rad: jax.Array) -> jax.Array:
        """Return rad (runs, N) and the bound of each run of a sum, times the mean of the factors on its
        samples, by weight.
        """
        values, runs = self.window.sums[number], len(rad)
        for i, weights in values.parts:
            factor = self.factor(u, i)
            shares = np.array([float(abs(x) / values.size) for x in weights], rad.dtype)
            if factor is None:
                factor = jnp.ones_like(u[:, 0])
            allowed = self.average[number] * factor

            def add(
                k: jax.Array, sums: jax.Array, shares: np.ndarray = shares, allowed: jax.Array = allowed
            ) -> jax.Array:
                return sums + jnp.asarray(shares)[k] * jax.lax.dynamic_slice_in_dim(allowed, k, runs, 0)

            rad = jax.lax.fori_loop(0, len(weights), add, rad)
        return rad

    def _most_noise(self, u: jax.Array, i: int) -> jax.Array:
        """Return the noise of output i, of windows u (lags, m, N) the largest of each."""
        factor = self.factor(u, i)
        if factor is None:
            return self.noise[i]
        return self.noise[i] * jnp.max(factor, 0)

    def _slip(self, i: int, largest: jax.Array, noise: jax.Array) -> jax.Array:
        """Return (N,), how much resolution and recorder may have rounded away of a sample of output i."""
        ulps = sensor.RECORDER_ULPS * rounding.unit(largest.dtype)
        top = np.finfo(largest.dtype).max
        return self.resolution[i] + ulps * (jnp.minimum(largest[i], top) + noise)

    def _added(
        self, sums: tuple[jax.Array, ...], one: jax.Array, weights: tuple[float, ...], y: jax.Array, i: int
    ) -> tuple[jax.Array, ...]:
        """Return (sums, their magnitudes), (runs, N) each as `one`, with the weighted samples of output i
        added.
        """
        runs = len(one)
        d, size = y[:, i] - self.offset_y[i], abs(y[:, i]) + abs(self.offset_y[i])
        factors = np.asarray(weights, y.dtype)

        def add(k: jax.Array, sums: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
            f = jnp.asarray(factors)[k]
            value = sums[0] + f * jax.lax.dynamic_slice_in_dim(d, k, runs, 0)
            magnitude = sums[1] + jnp.abs(f) * jax.lax.dynamic_slice_in_dim(size, k, runs, 0)
            return value, magnitude

        total: tuple[jax.Array, ...] = jax.lax.fori_loop(0, len(weights), add, sums or (0 * one, 0 * one))
        return total

    def _disturbance(self, like: jax.Array) -> Parts:
        """Return (mid, rad, scale) of one sample of the disturbances, (g, N) each."""
        lo, hi, one = self.disturbance[:, 0], self.disturbance[:, 1], jnp.ones_like(like)
        tiny = rounding.tiny(like.dtype)
        mid, rad, scale = 0.5 * (lo + hi), 0.5 * (hi - lo) + tiny, abs(lo) + abs(hi) + tiny
        return mid[:, None] * one[None], rad[:, None] * one[None], scale[:, None] * one[None]


def _later(x: jax.Array, lags: int, count: int) -> Columns:
    """Return the samples x (N + lags - 1, n) of N windows."""
    return [[x[j : j + count, i] for i in range(x.shape[1])] for j in range(lags)]


def _size(weights: tuple[float, ...]) -> float:
    """Return the sum of magnitudes."""
    return sum(map(abs, weights))


def gather(u: np.ndarray, y: np.ndarray, starts: np.ndarray, lags: int, horizon: int) -> Block:
    """Return the samples u (lags, m, N), y (s + 1, p, N) of windows that start at samples of u (T, m), y (T,
    p).
    """
    rows = starts + np.arange(horizon + 1)[:, None]
    # take: u[rows] is ten times slower
    inputs = u.take(rows[:lags], 0).transpose(0, 2, 1).copy()
    return inputs, y.take(rows, 0).transpose(0, 2, 1).copy()
