"""Constrained zonotopes: zonotopes whose coefficients obey linear equations; any bounded polyhedron is
one.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.sets.floats.equations import is_traced
from jaxbound.sets.intervals.bounds import Arrays
from jaxbound.sets.intervals.interval import Interval, mid, rad
from jaxbound.sets.zonotopes.zonotope import Zonotope, finite_arrays
from jaxbound.text.objects import readable


@readable
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class ConstrainedZonotope(Arrays):
    """{center + generators x : every |x_i| <= 1, constraints x = offsets}; may be empty. Build it with
    `constrained_zonotope`.

    Fields: center c (..., n), generators G (..., n, q), constraints A (..., k, q), offsets b (..., k).
    Leading axes are a batch of sets.

    Source: Scott, Raimondo, Marseglia, Braatz, Constrained zonotopes, Automatica 69, 2016.
    """

    center: jax.Array
    generators: jax.Array
    constraints: jax.Array
    offsets: jax.Array


AnySet: TypeAlias = Zonotope | ConstrainedZonotope


def constrained_zonotope(
    center: ArrayLike, generators: ArrayLike, A: ArrayLike, b: ArrayLike
) -> ConstrainedZonotope:
    """Build a ConstrainedZonotope {c + G x : |x_i| <= 1, A x = b}, rounded to nearest where the dtype cannot
    hold the numbers (x64 off).

    Args:
        center: (..., n). generators: (..., n, q). A: (..., k, q). b: (..., k); no row (k = 0) is a zonotope.

    Raises:
        ValueError: shapes that do not fit, NaN or infinity.

    Example:
        >>> constrained_zonotope([0.0], [[1.0, 1.0]], [[1.0, -1.0]], [0.5]).constraints.shape
        (1, 2)
    """
    center, generators, A, b = map(np.asarray, (center, generators, A, b))
    shaped = (
        center.ndim >= 1
        and generators.ndim >= 2
        and A.ndim >= 2
        and b.ndim >= 1
        and center.shape[-1:] != (0,)
    )
    if (
        not shaped
        or center.shape != generators.shape[:-1]
        or b.shape != A.shape[:-1]
        or A.shape[-1] != generators.shape[-1]
    ):
        shapes = f"{center.shape}, {generators.shape}, {A.shape} and {b.shape}"
        raise ValueError(
            f"constrained_zonotope needs center (..., n), generators (..., n, q), A (..., k, q), b (..., k): "
            f"their shapes are {shapes}"
        )
    if center.shape[:-1] != b.shape[:-1]:
        raise ValueError(
            f"a batch of sets needs as many constraints as centers: their leading shapes are "
            f"{center.shape[:-1]} and {b.shape[:-1]}"
        )
    return ConstrainedZonotope(*finite_arrays(center=center, generators=generators, A=A, b=b))


def parts(S: object) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return (c, G, A, b) of a Zonotope, with no rows in A and b, or of a ConstrainedZonotope, or of a batch
    of them; of a Zonotope around an Interval.
    """
    if isinstance(S, ConstrainedZonotope):
        return S.center, S.generators, S.constraints, S.offsets
    if isinstance(S, Interval):
        S = Zonotope(mid(S), rad(S)[..., None] * np.eye(S.shape[-1], dtype=S.dtype))
    if not isinstance(S, Zonotope):
        raise TypeError(
            f"an interval, a zonotope or a constrained zonotope is needed: this is {type(S).__name__}"
        )
    *batch, _, q = S.generators.shape
    none = lambda *shape: cast(
        jax.Array, np.zeros((*batch, *shape), S.center.dtype)
    )  # of NumPy, for which nothing is run or compiled
    return S.center, S.generators, none(0, q), none(0)


def exact(S: AnySet | Interval) -> AnySet:
    """Return a set as it is, and an Interval as the Zonotope that is the same set.

    Raises:
        ValueError: a box whose middle, or radius, is no float, or that is empty or not bounded. TypeError: a
            box inside jit.
    """
    if not isinstance(S, Interval):
        return S
    instead = "take from_interval(box), a set around it"
    if is_traced(S):
        raise TypeError(f"inside jit nobody knows whether a box is a zonotope in floats: {instead}")
    lo, hi = np.asarray(S.lo, float), np.asarray(S.hi, float)
    with np.errstate(all="ignore"):
        c, r = lo / 2 + hi / 2, hi / 2 - lo / 2
    for middle, radius, low, high in zip(*(x.ravel().tolist() for x in (c, r, lo, hi)), strict=True):
        fine = np.isfinite([middle, radius]).all() and radius >= 0
        if (
            not fine
            or Fraction(middle) - Fraction(radius) != Fraction(low)
            or (Fraction(middle) + Fraction(radius) != Fraction(high))
        ):
            raise ValueError(f"the box [{low:.17g}, {high:.17g}] is no zonotope in floats: {instead}")
    return Zonotope(jnp.asarray(c), jnp.asarray(r[..., None] * np.eye(c.shape[-1])))
