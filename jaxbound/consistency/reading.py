"""What a kernel needs of a relation, and how it reads a window."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.models import sensor
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats import rounding
from jaxbound.sets.strips.separation import Frame
from jaxbound.sets.strips.strips import Strips

__all__ = ["Filter", "Reading", "forms", "gather"]

Filter: TypeAlias = tuple[bool, int, tuple[float, ...]]
"""A combination of consecutive samples: whether of an output or of a disturbance, its number, weights, the
oldest sample first.
"""
AVERAGING = 16
"""Terms of an average that the error bound of one row pays for, with a magnitude as large again: see
`Reading.block`.
"""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Reading:
    """Everything a kernel needs of a relation: arrays are traced, so models of one shape share a compilation.

    Fields: shape, the Strips of a few circuits or the Frame of an exchange search; tolerance, noise,
    resolution, offset_y (p,); disturbance (g, 2); offset_u (m,); horizon; lags, the samples of u in a window;
    looks: at outputs so many samples before the
    last, None: at all. average (a,), filters: bounds of averages and what they combine.
    """

    shape: Strips | Frame
    tolerance: jax.Array
    noise: jax.Array
    resolution: jax.Array
    disturbance: jax.Array
    offset_u: jax.Array
    offset_y: jax.Array
    horizon: int = field(metadata={"static": True})
    lags: int = field(metadata={"static": True})
    looks: tuple[int, ...] | None = field(default=None, metadata={"static": True})
    average: jax.Array | np.ndarray = field(default_factory=lambda: np.zeros(0))
    filters: tuple[Filter, ...] = field(default=(), metadata={"static": True})

    @property
    def lift(self) -> jax.Array:
        """At least every factor that multiplies a row after its own rounding."""
        return sensor.lift(self.tolerance)

    def seen(self, y: Any) -> Any:
        """Return the samples y (s + 1, p, N) of windows, NaN where they are not looked at."""
        if self.looks is None:
            return y
        kept = np.isin(self.horizon - np.arange(self.horizon + 1), self.looks)[:, None, None]
        return (np if isinstance(y, np.ndarray) else jnp).where(kept, y, np.asarray(np.nan, y.dtype))

    def used(self) -> np.ndarray:
        """Return (s + 1, p) bool: the samples of outputs that are looked at, alone or in an average."""
        used = np.ones((self.horizon + 1, len(self.noise)), bool)
        if self.looks is not None:
            used[:] = np.isin(self.horizon - np.arange(self.horizon + 1), self.looks)[:, None]
            for (measured, i, weights), ends in zip(self.filters, self.ends(), strict=True):
                for end in ends if measured else ():
                    used[end + 1 - len(weights) : end + 1, i] = True
        return used

    def ends(self) -> list[list[int]]:
        """Return for each average the samples at which it ends in a window, all of them, looked at or not."""
        samples = (self.horizon, self.horizon + 1)
        return [list(range(len(weights) - 1, samples[measured])) for measured, _, weights in self.filters]

    def absent(self, y: np.ndarray) -> np.ndarray:
        """Return (rows, N) bool: which rows of windows y (s + 1, p, N) lack a sample."""
        N, gone = y.shape[2], np.isnan(y)
        parts = [
            np.isnan(self.seen(y)).reshape(-1, N),
            np.zeros((self.horizon * len(self.disturbance), N), bool),
        ]
        for (measured, i, weights), ends in zip(self.filters, self.ends(), strict=True):
            for end in ends:
                lost = gone[end + 1 - len(weights) : end + 1, i].any(0) if measured else np.zeros(N, bool)
                parts.append(
                    (lost | (measured and self.looks is not None and self.horizon - end not in self.looks))[
                        None
                    ]
                )
        return np.concatenate(parts)

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
        if self.filters or isinstance(self.shape, Strips) and self.shape.supports is None:
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
        taken = whole if self.looks is None else jnp.where(self.used()[:, :, None], whole, jnp.nan)
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
        for number in range(len(self.filters)):
            rows = [
                jnp.concatenate(pair)
                for pair in zip(rows, self._averaged(number, whole, largest[0]), strict=True)
            ]
        known = [u - self.offset_u[None, :, None], abs(u) + abs(self.offset_u)[None, :, None]]
        return *rows, *(x.reshape(-1, y.shape[2]) for x in known)

    def _averaged(self, number, y, largest):
        """Return (mid, rad, scale) of the runs of one average, (runs, N) each, NaN in mid and scale where a
        sample is missing.

        The middle, a sum of n products, is off by (n + 4) u S and the radius by (n + 8) u S with S the
        magnitude of all its terms and the radius together; a magnitude of (2 + n / 16) S has
        `rounding.residual_error` pay for that: 32 u (1 + n / 16) S beyond what it pays for any row. What
        underflows costs less than the floor in the radius.
        """
        measured, i, weights = self.filters[number]
        dtype, N, n, runs = y.dtype, y.shape[2], len(weights), max(len(self.ends()[number]), 0)
        total, tiny = sum(map(abs, weights)), float(rounding.tiny(dtype)) * 6
        bound, one = self.average[number] + tiny * (n + sum(map(abs, weights))), jnp.ones((runs, N), dtype)
        if not measured or not runs:
            rad = bound * one
            return 0 * one, rad, (2 + n / AVERAGING) * rad
        unit = rounding.unit(dtype)
        rho = self.resolution[i] + sensor.RECORDER_ULPS * unit * (
            jnp.minimum(largest[i], np.finfo(dtype).max) + self.noise[i]
        )
        d, size = y[:, i] - self.offset_y[i], abs(y[:, i]) + abs(self.offset_y[i])
        factors = np.asarray(weights, dtype)

        def add(k, sums):
            take = lambda x: jax.lax.dynamic_slice_in_dim(x, k, runs, 0)
            f = jnp.asarray(factors)[k]
            return sums[0] + f * take(d), sums[1] + jnp.abs(f) * take(size)

        mid, magnitude = jax.lax.fori_loop(0, n, add, (0 * one, 0 * one))
        rad = bound * one + np.asarray(total, dtype) * rho[None]
        looked = np.array(
            [self.looks is None or self.horizon - end in self.looks for end in self.ends()[number]]
        )[:, None]
        scale = jnp.where(looked, (2 + n / AVERAGING) * (magnitude + rad), jnp.nan)
        return jnp.where(jnp.isnan(scale), jnp.nan, mid), rad, scale

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
            samples = [
                now[i] if self.looks is None or self.horizon - j in self.looks else nothing
                for j, now in enumerate(y)
            ]
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
