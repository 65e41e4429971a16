"""The interval of the true value behind a recorded sample, in closed form.

A sensor reads y = (1 + theta) t + delta with |theta| <= sigma, |delta| <= rho (noise plus resolution). The
true values t that explain y are [t_lo, t_hi] with t_hi = max((y + rho) / (1 + sigma), (y + rho) / (1 -
sigma)) and t_lo = min over the same two of y - rho (mu is monotone in theta and affine in delta: Adrot 2000
(9); exact, see the exactness theorem). With e = 1 / (1 - sigma^2) this is

    middle e (y + sigma clip(y, -rho, rho)),    radius e (rho + sigma max(|y|, rho)),

without cancellation, without a case distinction and differentiable.
"""

from collections.abc import Sequence
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding

RECORDER_ULPS = 4
"""A sample is known to this many unit roundoffs of its float type, times the largest |y| of its signal in the
window plus noise.
"""


Numbers = TypeVar("Numbers", jax.Array, np.ndarray)


def true_range(d: Numbers, rho: Numbers, tolerance: Numbers, e: Numbers) -> tuple[Numbers, Numbers]:
    """Return (middle, radius) of true values whose samples, less the offset, are d, off by at most rho; e = 1
    / (1 - tolerance^2).
    """
    above, below, half = abs(d + rho), abs(d - rho), 0.5 * tolerance
    # above - below = 2 clip(d, -rho, rho), above + below = 2 max(|d|, rho)
    return e * (d + half * (above - below)), e * (rho + half * (above + below))


def true_value(
    samples: Sequence[jax.Array],
    tolerance: jax.Array,
    noise: jax.Array | Sequence[jax.Array],
    resolution: jax.Array,
    offset: jax.Array,
    largest: jax.Array | None = None,
) -> tuple[list[jax.Array], list[jax.Array], list[jax.Array]]:
    """Return (mid, rad, scale) of the true values behind the samples of one output in one window, minus the
    offset.

    Args:
        samples: the s + 1 recorded values of one output, each a scalar or an array over windows; NaN where
            absent.
        tolerance, noise, resolution, offset: of that output, scalars, taken as exact; noise that differs from
            sample to sample: as the samples, off by one rounding.
        largest: the largest magnitude among the samples, if the caller has it (else the samples must be all
            of the window's).

    Returns:
        Three lists of s + 1: middle (NaN where absent), radius, and the magnitude that rounding errors are
        relative to (`rounding.residual_error`), all of the dtype of the samples. Every radius is > 0.
    """
    e = 1 / ((1 - tolerance) * (1 + tolerance))
    absent = list(map(jnp.isnan, samples))
    # keeps NaN out of gradients
    samples = [jnp.where(gone, 0, y) for gone, y in zip(absent, samples, strict=True)]
    if largest is None:
        largest = abs(samples[0])
        for y in samples[1:]:
            largest = jnp.maximum(largest, abs(y))
    # an infinite sample stays its own row's matter
    largest = jnp.minimum(largest, np.finfo(largest.dtype).max)
    if isinstance(noise, Sequence):
        each = [_rho(x, resolution, largest) for x in noise]
    else:
        each = [_rho(noise, resolution, largest)] * len(samples)
    mid, rad, scale = [], [], []
    for gone, y, rho in zip(absent, samples, each, strict=True):
        middle, radius = true_range(y - offset, rho, tolerance, e)
        mid.append(jnp.where(gone, jnp.nan, middle))
        rad.append(radius)
        size = e * (1 + tolerance) * (abs(y) + abs(offset)) + rad[-1]
        # 0 * inf is NaN in every row of a window with an infinite sample, and NaN is absence, never overflow
        scale.append(jnp.where(gone, jnp.nan, jnp.where(size < jnp.inf, size, jnp.inf)))
    return mid, rad, scale


def _rho(noise: jax.Array, resolution: jax.Array, largest: jax.Array) -> jax.Array:
    """Return the largest |delta| of samples."""
    return (
        noise
        + resolution
        + RECORDER_ULPS * rounding.unit(largest.dtype) * (largest + noise)
        + rounding.tiny(largest.dtype)
    )


def largest_error(y: np.ndarray, noise: np.ndarray, recorded: np.dtype | type, horizon: int) -> np.ndarray:
    """Return (..., T, p), at least |delta| of each sample of recordings y (..., T, p): the noise (p,) and
    what was rounded away.

    As in `true_value`, for the largest of all windows of horizon + 1 samples that the sample belongs to.
    recorded: the float type in which y was rounded, which y may have been widened from or narrowed to. On the
    host.
    """
    size = np.where(np.isnan(y), 0, abs(y)).astype(np.float64)
    largest, T = size.copy(), size.shape[-2]
    for lag in range(1, min(horizon, T - 1) + 1):
        largest[..., lag:, :] = np.maximum(largest[..., lag:, :], size[..., :-lag, :])
        largest[..., :-lag, :] = np.maximum(largest[..., :-lag, :], size[..., lag:, :])
    coarsest = max(float(rounding.unit(recorded)), float(rounding.unit(y.dtype)))
    error = noise + RECORDER_ULPS * coarsest * (largest + noise) + float(rounding.tiny(y.dtype))
    return rounding.round_up(error * (1 + 2.0**-50), y.dtype)  # 2^-50: for these four operations


def input_slip(u: np.ndarray) -> np.ndarray:
    """Return at least the difference between inputs as given and u, what is computed with: an array like u.

    Inputs are exact, but in float32 they may have been rounded to it once, for outputs in float32 or because
    JAX runs with x64 off: nothing tells that from a recording that was in float32 all along.
    """
    if u.dtype == np.float64:
        return np.zeros_like(u)
    slip: np.ndarray = 1.01 * rounding.unit(u.dtype) * np.abs(u) + rounding.tiny(u.dtype)
    return slip


def lift(tolerance: jax.Array | np.ndarray) -> jax.Array:
    """Return the largest factor e that multiplies a row: an underflow may be followed by it."""
    return jnp.max(1 / ((1 - tolerance) * (1 + tolerance)))
