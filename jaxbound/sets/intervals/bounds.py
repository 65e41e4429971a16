"""Bounds from a user, made floats: checked on the host, rounded outward where a float cannot say it."""

import re
from collections.abc import Callable
from fractions import Fraction
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.sets.floats import rounding

Number: TypeAlias = ArrayLike | Fraction
"""What a bound is read from."""


class Arrays:
    """The base of dataclasses of arrays, which refuses lists: its factory takes them, checks them and rounds
    outward.

    A tree may hold anything else: what is mapped over a set need not be an array.
    """

    def __post_init__(self) -> None:
        """Raise TypeError if a field is a list or a tuple of floats."""
        for name, value in vars(self).items():
            if isinstance(value, list) or (
                isinstance(value, tuple) and any(isinstance(x, float) for x in value)
            ):
                words = re.sub("(?<=.)(?=[A-Z])", "_", type(self).__name__).lower()
                raise TypeError(
                    f"{type(self).__name__} needs arrays, and {name} is a {type(value).__name__}: build it "
                    f"with {words}(...)"
                )


def check(lo: np.ndarray, hi: np.ndarray) -> None:
    """Raise ValueError if two arrays of bounds are not intervals: NaN, lo > hi (unless empty), an infinite
    point.
    """
    empty = (lo == np.inf) & (hi == -np.inf)
    for bad, rule in (
        (np.isnan(lo) | np.isnan(hi), "bounds must be numbers, not NaN"),
        ((lo > hi) & ~empty, "lo must be <= hi"),
        (((lo == np.inf) | (hi == -np.inf)) & ~empty, "a point must be finite"),
    ):
        if bad.any():
            first = tuple(int(i) for i in np.argwhere(bad)[0])
            raise ValueError(f"{rule}: {bad.sum()} of {bad.size} entries violate it, first at {first}")


def bound(x: Number, directed: Callable[..., np.ndarray]) -> jax.Array | np.ndarray:
    """Convert to a float32 or float64 array; a number that does not fit is rounded in the given direction."""
    if isinstance(x, jax.Array) and jnp.issubdtype(x.dtype, jnp.floating):
        return x if x.dtype.itemsize >= 4 else x.astype(jnp.float32)
    if isinstance(x, jax.core.Tracer):  # integers: one step outward where a float does not hold them all
        near = x.astype(jnp.result_type(float))
        step = 2 * rounding.unit(near.dtype) * jnp.abs(near) * (1 if directed is rounding.round_up else -1)
        return near + jnp.where(jnp.abs(step) < 1, 0, step)
    x = np.asarray(x)
    narrow = jnp.issubdtype(x.dtype, jnp.floating) and x.dtype.itemsize <= 4
    wanted = jax.dtypes.canonicalize_dtype(np.float32 if narrow else np.float64)
    return x if x.dtype == wanted else directed(x, wanted)


def settled(lo: jax.Array | np.ndarray, hi: jax.Array | np.ndarray) -> tuple[jax.Array, jax.Array]:
    """Return bounds of one shape and dtype, none subnormal towards the inside; NumPy's on the host, where no
    shape is compiled for.
    """
    shape, dtype = jnp.broadcast_shapes(jnp.shape(lo), jnp.shape(hi)), jnp.result_type(lo, hi)
    if isinstance(lo, np.ndarray) and isinstance(hi, np.ndarray):
        low, high = rounding.settled_on_host(*(np.broadcast_to(end, shape).astype(dtype) for end in (lo, hi)))
        return jax.device_put((low, high))  # jnp.asarray compiles a copy for each shape
    return rounding.settle_subnormals(
        *(rounding.widened(jnp.broadcast_to(end, shape), dtype) for end in (lo, hi))
    )
