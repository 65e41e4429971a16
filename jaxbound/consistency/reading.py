"""Relations as kernels read them, and the rows of windows in floats.

One of three evaluators of `models.rows`: middles, radii and the magnitudes that rounding errors are relative
to, on arrays over windows, inside a kernel.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.models import sensor
from jaxbound.models.rows import WindowRows
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats import rounding
from jaxbound.sets.strips.separation import Frame
from jaxbound.sets.strips.strips import Strips

__all__ = ["Reading", "forms", "gather"]

Samples = TypeVar("Samples", np.ndarray, jax.Array)
AVERAGING = 16
"""Terms of a sum that the error bound of one row pays for, with a magnitude as large again: see
`Reading._summed`.
"""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Reading:
    """Everything a kernel needs of a relation: arrays are traced, so models of one shape share a compilation.

    Fields: shape, the Strips of a few circuits or the Frame of an exchange search; tolerance, noise,
    resolution, offset_y (p,); disturbance (g, 2); offset_u (m,); window: its rows; lags, the samples of u in
    a window; average (a,): bounds of the sums of the window.
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

    @property
    def horizon(self) -> int:
        """A window has horizon + 1 samples."""
        return self.window.horizon

    @property
    def lift(self) -> jax.Array:
        """At least every factor that multiplies a row after its own rounding."""
        return sensor.lift(self.tolerance)

    def seen(self, y: Samples) -> Samples:
        """Return the samples y (s + 1, p, N) of windows, NaN where they are not looked at."""
        if self.window.lags is None:
            return y
        xp = np if isinstance(y, np.ndarray) else jnp
        return xp.where(self.window.kept[:, None, None], y, np.asarray(np.nan, y.dtype))

    def silenced(self, known: list) -> jax.Array:
        """Say which windows lack a known value that some circuit needs: the circuits that are left do not
        describe their set exactly.
        """
        strips: Any = self.shape  # or a bank: what has circuits on known values
        silenced = jnp.zeros_like(known[0], bool) if len(known) else jnp.zeros((), bool)
        for b, value in enumerate(known):
            silenced |= jnp.isnan(value) & jnp.any(strips.k[:, b] != 0)
        return silenced

    def stretch(self, u: jax.Array, y: jax.Array) -> tuple:
        """Return the rows of all windows of a stretch, u (N + s, m), y (N + s, p): see `rows`; as arrays for
        strips that run in a scan.
        """
        if self.window.sums or isinstance(self.shape, Strips) and self.shape.supports is None:
            return self.block(*self.windows(u, y))
        count = y.shape[0] - self.horizon
        return self.rows(
            [[u[j : j + count, i] for i in range(u.shape[1])] for j in range(self.lags)],
            [[y[j : j + count, i] for i in range(y.shape[1])] for j in range(self.horizon + 1)],
        )

    def windows(self, u: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the samples u (lags, m, N), y (s + 1, p, N) of all windows of a stretch, u (N + s, m), y (N
        + s, p).
        """
        count = y.shape[0] - self.horizon
        take = lambda x, lags: jax.lax.map(
            lambda j: jax.lax.dynamic_slice_in_dim(x.T, j, count, 1), jnp.arange(lags)
        )
        return take(u, self.lags), take(y, self.horizon + 1)

    def block(self, u: jax.Array, y: jax.Array) -> tuple:
        """Return the rows of N windows u (lags, m, N), y (s + 1, p, N) as arrays (rows, N), (l, N): few
        operations, whatever s.
        """
        whole, y = y, self.seen(y)
        taken = whole if self.window.lags is None else jnp.where(self.window.used[:, :, None], whole, jnp.nan)
        largest = jnp.max(jnp.where(jnp.isnan(taken), 0, abs(taken)), 0, keepdims=True)
        tolerance, noise, resolution, offset = (
            x[None, :, None] for x in (self.tolerance, self.noise, self.resolution, self.offset_y)
        )
        rows = [
            x.reshape(-1, y.shape[2])
            for (x,) in sensor.true_value([y], tolerance, noise, resolution, offset, largest)
        ]
        if self.horizon and len(self.disturbance):
            rows = [
                jnp.concatenate([x, *[w] * self.horizon])
                for x, w in zip(rows, self._disturbance(y[0, 0]), strict=True)
            ]
        for number in range(len(self.window.sums)):
            rows = [
                jnp.concatenate(pair)
                for pair in zip(rows, self._summed(number, whole, largest[0]), strict=True)
            ]
        known = [u - self.offset_u[None, :, None], abs(u) + abs(self.offset_u)[None, :, None]]
        return *rows, *(x.reshape(-1, y.shape[2]) for x in known)

    def _summed(
        self, number: int, y: jax.Array, largest: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return (mid, rad, scale) of the runs of one sum, (runs, N) each, NaN in mid and scale where a
        sample is missing.

        The middle, a sum of n products, is off by (n + 4) u S and the radius by (n + 8) u S with S the
        magnitude of all its terms and the radius together; a magnitude of (2 + n / 16) S has
        `rounding.residual_error` pay for that: 32 u (1 + n / 16) S beyond what it pays for any row. What
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
        slips = [self._slip(i, largest) for i, _ in parts]
        sums: tuple[jax.Array, ...] = ()
        for i, weights in parts:
            sums = self._added(sums, one, weights, y, i)
        mid, magnitude = sums
        rad = bound * one
        for (_, weights), slip in zip(parts, slips, strict=True):
            rad = rad + np.asarray(_size(weights), dtype) * slip[None]
        looked = np.array([row.seen for row in runs])[:, None]
        scale = jnp.where(looked, (2 + n / AVERAGING) * (magnitude + rad), jnp.nan)
        return jnp.where(jnp.isnan(scale), jnp.nan, mid), rad, scale

    def _slip(self, i: int, largest: jax.Array) -> jax.Array:
        """Return (N,), how much resolution and recorder may have rounded away of a sample of output i."""
        ulps = sensor.RECORDER_ULPS * rounding.unit(largest.dtype)
        top = np.finfo(largest.dtype).max
        return self.resolution[i] + ulps * (jnp.minimum(largest[i], top) + self.noise[i])

    def _added(
        self,
        sums: tuple[jax.Array, ...],
        one: jax.Array,
        weights: tuple[float, ...],
        y: jax.Array,
        i: int,
    ) -> tuple[jax.Array, ...]:
        """Return (sums, their magnitudes), (runs, N) each as `one`, with the weighted samples of output i
        added.
        """
        runs = len(one)
        d, size = y[:, i] - self.offset_y[i], abs(y[:, i]) + abs(self.offset_y[i])
        factors = np.asarray(weights, y.dtype)

        def add(k, sums):
            def take(x):
                return jax.lax.dynamic_slice_in_dim(x, k, runs, 0)

            f = jnp.asarray(factors)[k]
            return sums[0] + f * take(d), sums[1] + jnp.abs(f) * take(size)

        return jax.lax.fori_loop(0, len(weights), add, sums or (0 * one, 0 * one))

    def _disturbance(self, like):
        """Return (mid, rad, scale) of one sample of the disturbances, (g, N) each."""
        lo, hi, one = self.disturbance[:, 0], self.disturbance[:, 1], jnp.ones_like(like)
        tiny = rounding.tiny(like.dtype)
        return [
            x[:, None] * one[None]
            for x in (0.5 * (lo + hi), 0.5 * (hi - lo) + tiny, abs(lo) + abs(hi) + tiny)
        ]

    def rows(self, u: Any, y: Any) -> tuple:
        """Return (mid, rad, scale, known, known_scale), lists of (N,), of windows with the samples
        u[lag][input], y[lag][output].

        Rows are the true outputs, time-major, then the disturbances w_k .. w_{k+s-1}.
        """
        per_output, nothing = [], jnp.full_like(y[0][0], jnp.nan)
        for i in range(len(self.noise)):
            samples = [now[i] if self.window.looked_at(j) else nothing for j, now in enumerate(y)]
            per_output.append(
                sensor.true_value(
                    samples, self.tolerance[i], self.noise[i], self.resolution[i], self.offset_y[i]
                )
            )
        mid, rad, scale = (
            [output[part][j] for j in range(self.horizon + 1) for output in per_output] for part in range(3)
        )
        if len(self.disturbance):
            for rows, w in zip((mid, rad, scale), self._disturbance(jnp.ones_like(y[0][0])), strict=True):
                rows.extend([*w] * self.horizon)
        known = [v - self.offset_u[i] for now in u for i, v in enumerate(now)]
        known_scale = [abs(v) + abs(self.offset_u[i]) for now in u for i, v in enumerate(now)]
        return mid, rad, scale, known, known_scale


def _size(weights: tuple[float, ...]) -> float:
    """Return the sum of magnitudes."""
    return sum(map(abs, weights))


def gather(u: np.ndarray, y: np.ndarray, starts: np.ndarray, lags: int, horizon: int) -> tuple:
    """Return the samples u (lags, m, N), y (s + 1, p, N) of windows that start at samples of u (T, m), y (T,
    p).
    """
    rows = starts + np.arange(horizon + 1)[:, None]
    taken = lambda x, rows: x.take(rows, 0).transpose(0, 2, 1).copy()  # x[rows] is ten times slower
    return taken(u, rows[:lags]), taken(y, rows)


def forms(kernel: Callable, relations: Any, test: Callable, u: Any, y: Any, starts: Any) -> tuple:
    """Return the arrays (..., T, count) that kernel(test(dtype), u (T, m), y (T, p)) makes of recordings; NaN
    where there is no window.
    """
    given = Recording.of(relations.model, u, y, starts)
    u, y = jax.device_put((given.u, given.y))  # jnp.asarray compiles a copy for each shape
    if y.shape[-2] <= relations.horizon:
        return (jnp.full((*y.shape[:-1], relations.count), jnp.nan, y.dtype),) * 3
    for _ in range(y.ndim - 2):
        kernel = jax.vmap(kernel, (None, 0, 0))
    found = kernel(test(y.dtype), u, y)
    across = np.flatnonzero(given.across(relations.horizon))
    return tuple(x.at[..., across, :].set(jnp.nan) for x in found) if len(across) else found
