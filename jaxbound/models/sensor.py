"""The interval of the true value behind a recorded sample, in closed form.

A sensor reads y = (1 + theta) t + delta with |theta| <= sigma, |delta| <= rho (noise plus resolution). The
true values t that explain y are [t_lo, t_hi] with t_hi = max((y + rho) / (1 + sigma), (y + rho) / (1 -
sigma)) and t_lo = min over the same two of y - rho (mu is monotone in theta and affine in delta: Adrot 2000
(9); exact, see the exactness theorem). With e = 1 / (1 - sigma^2) this is

    middle e (y + sigma clip(y, -rho, rho)),    radius e (rho + sigma max(|y|, rho)),

without cancellation, without a case distinction and differentiable.
"""

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
    # clip written as two magnitudes: without a comparison it vectorises and has derivatives
    above, below, half = abs(d + rho), abs(d - rho), 0.5 * tolerance
    # above - below = 2 clip(d, -rho, rho), above + below = 2 max(|d|, rho)
    return e * (d + half * (above - below)), e * (rho + half * (above + below))


def true_value(
    y: jax.Array,
    tolerance: jax.Array,
    noise: jax.Array,
    resolution: jax.Array,
    offset: jax.Array,
    largest: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (mid, rad, scale) of the true values behind samples, minus the offset.

    Args:
        y: recorded values, an array over samples, outputs or windows; NaN where absent.
        tolerance, noise, resolution, offset: of their outputs, taken as exact; noise that differs from sample
            to sample may be off by one rounding.
        largest: the largest magnitude of the output in its window.

    Returns:
        Three arrays like y: middle (NaN where absent), radius, and the magnitude that rounding errors are
        relative to (`rounding.residual_error`), all of the dtype of the samples. Every radius is > 0.
    """
    e = 1 / ((1 - tolerance) * (1 + tolerance))
    absent = jnp.isnan(y)
    y = jnp.where(absent, 0, y)  # keeps NaN out of gradients
    # an infinite sample stays its own row's matter
    rho = _rho(noise, resolution, jnp.minimum(largest, np.finfo(largest.dtype).max))
    middle, rad = true_range(y - offset, rho, tolerance, e)
    size = e * (1 + tolerance) * (abs(y) + abs(offset)) + rad
    # 0 * inf is NaN in every row of a window with an infinite sample, and NaN is absence, never overflow
    size = jnp.where(size < jnp.inf, size, jnp.inf)
    return jnp.where(absent, jnp.nan, middle), rad, jnp.where(absent, jnp.nan, size)


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
    # the largest of every window that a sample belongs to: samples before it, and behind it
    for lag in range(1, min(horizon, T - 1) + 1):
        largest[..., lag:, :] = np.maximum(largest[..., lag:, :], size[..., :-lag, :])
        largest[..., :-lag, :] = np.maximum(largest[..., :-lag, :], size[..., lag:, :])
    # a wider type keeps what the recorder rounded away, a narrower one rounds once more
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
