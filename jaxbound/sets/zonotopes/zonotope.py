"""Zonotopes: boxes seen through a matrix."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals.bounds import Arrays
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.objects import readable


@readable
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Zonotope(Arrays):
    """{center + generators x : every |x_i| <= 1}. Build it with `zonotope`.

    Fields: center (..., n), generators (..., n, q), columns are generators. Leading axes are a batch of sets.
    """

    center: jax.Array
    generators: jax.Array

    def hull(self) -> Interval:
        """Return the smallest box around it, rounded outward: an Interval (..., n)."""
        center, generators = rounding.one_dtype(self.center, self.generators)
        size = jnp.abs(generators)
        spread = rounding.outward_sum(size, size, -1)[1]
        return Interval(*rounding.unbounded(*rounding.outward(center - spread, center + spread)))


def zonotope(center: ArrayLike, generators: ArrayLike) -> Zonotope:
    """Build a Zonotope {c + G z : |z_i| <= 1}, rounded to nearest where the dtype cannot hold the numbers
    (x64 off).

    Args:
        center: c (..., n).
        generators: G (..., n, q), a column each.

    Raises:
        ValueError: shapes that do not fit, NaN or infinity. TypeError: an Interval.

    Example:
        >>> zonotope([0.0, 0.0], [[1.0, 0.0], [0.0, 1.0]]).generators.shape
        (2, 2)
    """
    if isinstance(center, Interval) or isinstance(generators, Interval):
        raise TypeError("a zonotope is made of numbers: from_interval makes one of an Interval")
    center, generators = np.asarray(center), np.asarray(generators)
    if (
        center.ndim < 1
        or generators.ndim < 2
        or center.shape != generators.shape[:-1]
        or not center.shape[-1]
    ):
        raise ValueError(
            f"zonotope needs center (..., n) and generators (..., n, q): their shapes are {center.shape} and "
            f"{generators.shape}"
        )
    return Zonotope(*finite_arrays(center=center, generators=generators))


def finite_arrays(**arrays: np.ndarray) -> tuple[jax.Array, ...]:
    """Return NumPy arrays as JAX arrays of their common float dtype; refuse NaN and infinity by name."""
    refuse_infinite(**arrays)
    native = [
        x if x.dtype.isnative else x.astype(x.dtype.newbyteorder("="))
        for x in map(np.asarray, arrays.values())
    ]
    single = all(x.dtype == np.float32 for x in native)
    dtype = jnp.result_type(*native, np.float32 if single else float)
    return tuple(jnp.asarray(x, dtype) for x in native)


def refuse_infinite(**arrays: ArrayLike) -> None:
    """Raise ValueError, with its name, for an array of concrete numbers with NaN or infinity: what
    overflowed, or was never checked.
    """
    for name, x in arrays.items():
        finite = np.isfinite(np.asarray(x, float))
        if not finite.all():
            first = tuple(np.argwhere(~finite)[0].tolist())
            raise ValueError(
                f"{name} must be finite: {(~finite).sum()} of {finite.size} entries are not, first at {first}"
            )
