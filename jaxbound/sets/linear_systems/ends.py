"""Intervals as one array of two upper bounds, (-lo, hi) on the first axis: both ends go through the same
operation, of one kernel.

What is inexact is closed upward, as in `products`; no set is empty, infinity is no bound. Half as many
kernels are half of the time that the compiler takes, and a bound costs the same.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals.interval import Interval


def ends(x: Interval, axis: int = 0) -> np.ndarray:
    """Return the ends of an Interval, beside each other on an axis, on the host."""
    return np.stack([-np.asarray(x.lo), np.asarray(x.hi)], axis)


def interval_of(x: jax.Array | np.ndarray) -> Interval:
    """Return the Interval of ends (2, ...)."""
    return Interval(-x[0], x[1])


def negative(x: jax.Array) -> jax.Array:
    """Return the ends of -x."""
    return x[::-1]


def none(x: jax.Array) -> jax.Array:
    """Return whether there is no number between the ends."""
    return -x[0] > x[1]


def added(x: jax.Array, y: jax.Array) -> jax.Array:
    """Enclose x + y."""
    return upward(x + y)


def subtracted(x: jax.Array, y: jax.Array) -> jax.Array:
    """Enclose x - y."""
    return upward(x + y[::-1])


def product(x: jax.Array, y: jax.Array) -> jax.Array:
    """Enclose x y; everything where 0 meets infinity."""
    side = jnp.asarray([-1, 1], x.dtype).reshape(2, *[1] * (max(x.ndim, y.ndim) - 1))
    corners = [side * (a * b)[None] for a in (-x[0], x[1]) for b in (-y[0], y[1])]
    return upward(jnp.maximum(jnp.maximum(corners[0], corners[1]), jnp.maximum(corners[2], corners[3])))


def total(x: jax.Array, axis: int) -> jax.Array:
    """Enclose the sum along an axis of the ends."""
    return rounding.outward_sum(x, x, axis)[1]


def upward(x: jax.Array) -> jax.Array:
    """Close upward what one operation gave; NaN gives everything."""
    x = rounding.outward(x, x)[1]
    return jnp.where(jnp.isnan(x), jnp.inf, x)
