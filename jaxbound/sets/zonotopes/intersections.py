"""Intersections of zonotopes and constrained zonotopes, and what it costs to forget a constraint.

An intersection {p in S : M p in Y} is a constrained zonotope, exactly: M (c + G x) = d + H y, with the x of S
and the y of Y, are more equations between coefficients. A computed row gets one more coefficient, as large as
the row can be off by.

Forgetting equations A x = b again encloses the set: whatever the gain K,

    c + G x = (c + K b) + (G - K A) x    where A x = b,

is a zonotope once A x = b is dropped. With the equations of one strip this is the family c + L (y - C c), [(I
- L C) G, L diag(s)] of zonotopes around the intersection of a zonotope with strips (Alamo, Bravo, Camacho
2005; Combastel 2015; Wang et al. 2018).
"""

from __future__ import annotations

from functools import partial, singledispatch
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.intervals.interval import Interval, Operand, interval, mid, rad
from jaxbound.sets.intervals.interval import intersection as interval_intersection
from jaxbound.sets.zonotopes.constrained import AnySet, ConstrainedZonotope, parts
from jaxbound.sets.zonotopes.maps import added, blocks, dimension, mapped, product, reach, up, whole
from jaxbound.sets.zonotopes.zonotope import Zonotope


@singledispatch
def intersection(
    S: AnySet | Interval, Y: AnySet | Interval, matrix: Operand | None = None
) -> Any:  # a ConstrainedZonotope, or an Interval
    """Return {p in S : M p in Y}, exactly but for rounding, as a ConstrainedZonotope; of two Intervals their
    common Interval.

    Args:
        S: a Zonotope or ConstrainedZonotope of n coordinates, or an Interval (with another one and no matrix:
            IEEE 1788 intersection).
        Y: a set of r coordinates: a Zonotope, a ConstrainedZonotope, or an Interval (r,): strips, half-spaces
            where a bound is infinite or NaN, nothing where it is empty (for `is_empty` to prove).
            A measurement y = M p + v, v in V: Y = translate(scale(V, -1.0), y).
        matrix: M (r, n), numbers or Interval; None: the identity.

    Returns:
        A ConstrainedZonotope of n coordinates with r constraints more; r generators more for an Interval, and
        r beside its own for a set.

    Encloses: every p in S with M p in Y for some M of the matrix. Empty intersections stay enclosed: ask
    `is_empty`.

    Raises:
        ValueError: shapes that do not fit.

    Source: Scott, Raimondo, Marseglia, Braatz 2016, (13); half-spaces: Raghuraman, Koeln 2022.

    Example:
        >>> from jaxbound import sets
        >>> box = sets.zonotope([0.0, 0.0], [[1.0, 0.0], [0.0, 1.0]])
        >>> sets.intersection(box, sets.interval([0.5], [2.0]), [[1.0, 1.0]]).constraints.round(3)
        Array([[ 1.  ,  1.  , -0.75]], dtype=...)
    """
    if matrix is None and isinstance(Y, Interval):
        return interval_intersection(cast(Interval, S), Y)
    if matrix is None:
        return intersection(Y, S)
    return intersection(Zonotope(*parts(S)[:2]), Y, matrix)


@intersection.register(Zonotope)
@intersection.register(ConstrainedZonotope)
def _(S: AnySet, Y: AnySet | Interval, matrix: Operand | None = None) -> ConstrainedZonotope:
    n, M = dimension(S), None if matrix is None else interval(matrix)
    if M is not None and (len(M.shape) != 2 or M.shape[1] != n):
        raise ValueError(
            f"the matrix must have shape (r, {n}) for a set of {n} coordinates: its shape is {M.shape}"
        )
    shape = Y.shape if isinstance(Y, Interval) else (dimension(Y),)
    if shape != (wanted := (n,) if M is None else M.shape[:1]):
        raise ValueError(f"the other set must have {wanted[0]} coordinates: its shape is {shape}")
    return _intersect(S, Y, M)


@kernel
def _intersect(S: AnySet, Y: AnySet | Interval, M: Interval | None) -> ConstrainedZonotope:
    S, Y, M = rounding.one_dtype(S, Y, M)
    c, G, A, b = parts(S)
    d, H, error = (
        (c, G, jnp.zeros_like(c)) if M is None else mapped(mid(M), rad(M), c, G)
    )  # M p = d + H x, off by `error`
    if isinstance(Y, Interval):
        Y = _bounded(Y, d, up(reach(jnp.zeros_like(d), H) + error))
        y, spread, F, B, e = (
            mid(Y),
            rad(Y),
            jnp.zeros((len(d), 0), d.dtype),
            jnp.zeros((0, 0), d.dtype),
            b[:0],
        )
    else:
        (y, F, B, e), spread = parts(Y), jnp.zeros_like(d)
    offset, more = added(y, -d)
    slack = jnp.diag(up(up(spread + error) + more))
    own = jnp.pad(blocks(A, B), ((0, 0), (0, len(d))))
    rows = jnp.concatenate([own, jnp.concatenate([H, -F, -slack], 1)])
    G = jnp.pad(G, ((0, 0), (0, F.shape[1] + len(d))))
    return ConstrainedZonotope(c, G, rows, jnp.concatenate([b, e, offset]))


def _bounded(Y: Interval, middle: jax.Array, radius: jax.Array) -> Interval:
    """Return an Interval whose infinite bounds are where values within `radius` of `middle` cannot be anyway;
    an empty one is there too.
    """
    spread = up(radius + 4 * rounding.unit(middle.dtype) * jnp.abs(middle))
    below, above = jnp.isfinite(Y.lo), jnp.isfinite(Y.hi)
    lo, hi = jnp.where(below, Y.lo, middle - spread), jnp.where(above, Y.hi, middle + spread)
    lo, hi = jnp.where(below, lo, jnp.minimum(lo, hi)), jnp.where(above, hi, jnp.maximum(lo, hi))
    nothing, away = (
        Y.is_empty | (Y.lo == jnp.inf) | (Y.hi == -jnp.inf),
        middle + (2 * spread + jnp.abs(middle) + 1),
    )
    return Interval(jnp.where(nothing, away, lo), jnp.where(nothing, away, hi))


def strip_intersection(Z: Zonotope, Y: Interval, matrix: Operand, gain: ArrayLike | None = None) -> Zonotope:
    """Return a Zonotope around {p in Z : M p in Y}: c + L (y - M c), [(I - L M) G, L diag(s)] for a gain L,
    and the rounding.

    Args:
        Z: a Zonotope of n coordinates. Y: Interval (r,) with middle y and radius s: strips, or half-spaces
            where a bound is infinite.
        matrix: M (r, n), numbers or Interval. gain: L (n, r); None: the one that gives the least sum of
            squares of all generators.

    Returns:
        A Zonotope with r + n generators more.

    Encloses: the intersection, for any gain.

    Raises:
        ValueError: shapes that do not fit. TypeError: a set with constraints.

    Source: Alamo, Bravo, Camacho 2005 (one strip); Combastel 2015, Wang, Puig, Cembrano 2018 (several).
    """
    if isinstance(Z, Interval):
        Z = Zonotope(*parts(Z)[:2])
    if not isinstance(Z, Zonotope):
        raise TypeError(
            f"strip_intersection takes a Zonotope, not {type(Z).__name__}: use intersection, which is exact"
        )
    return cast(Zonotope, eliminate_constraints(intersection(Z, Y, matrix), gain=gain))  # as none is kept


def eliminate_constraints(S: AnySet, keep: int = 0, gain: ArrayLike | None = None) -> AnySet:
    """Return a set around a ConstrainedZonotope with `keep` constraints left: a Zonotope if none.

    Args:
        S: a ConstrainedZonotope with k constraints. keep: how many stay; those that say least about the set
            go first.
        gain: (n, k) with keep=0: what multiplies b - A x before the constraints are dropped; None: the gain
            that gives the least sum of squares of all generators (of the constraints that stay as well).

    Returns:
        A ConstrainedZonotope, or a Zonotope, with n generators more (and as many as constraints that stay).

    Encloses: S, for any gain.

    Raises:
        ValueError: keep below 0, a gain of another shape, or one together with keep.
    """
    n, k = dimension(S), len(parts(S)[3])
    if not 0 <= keep:
        raise ValueError(f"keep must be 0 or more: it is {keep}")
    if gain is not None and (keep or np.shape(gain) != (n, k)):
        raise ValueError(
            f"the gain must have shape ({n}, {k}), with keep=0: its shape is {np.shape(gain)}, keep is {keep}"
        )
    if k <= keep:
        return S
    return _eliminate(S, None if gain is None else jnp.asarray(gain, S.center.dtype), keep)


@partial(jax.jit, static_argnums=2)
def _eliminate(S: AnySet, gain: jax.Array | None, keep: int) -> AnySet:
    (S,) = rounding.one_dtype(S)
    c, G, A, b = parts(S)
    if keep:
        strength = jnp.sum(product(G, A.T) ** 2, 0) / jnp.maximum(jnp.sum(A**2, 1), rounding.tiny(c.dtype))
        order = jnp.argsort(strength)
        A, b = A[order], b[order]
    gone = len(b) - keep
    rows, h = jnp.concatenate([G, A[gone:]]), jnp.concatenate([c, -b[gone:]])
    A, b = A[:gone], b[:gone]
    K = _least_squares_gain(rows, A) if gain is None else gain
    K = jnp.where(jnp.isfinite(K), K, 0)
    h, rows, error = cancelled(h, rows, A, b, K)
    # the points (rows x + h)[:n] whose other coordinates are 0, each off by `error`
    G, n = jnp.concatenate([rows, jnp.diag(error)], 1), len(c)
    return whole(h[:n], G[:n], G[n:], -h[n:])


def _least_squares_gain(H: jax.Array, A: jax.Array) -> jax.Array:
    """Return K with the least sum of squares of H - K A; no claim is made."""
    gram = product(A, A.T)
    room = 4 * len(gram) * rounding.unit(A.dtype) * jnp.trace(gram) + rounding.tiny(A.dtype)
    return jnp.linalg.solve(gram + room * jnp.eye(len(gram), dtype=A.dtype), product(A, H.T)).T


def cancelled(
    h: jax.Array, H: jax.Array, A: jax.Array, b: jax.Array, K: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (h + K b, H - K A, error): the rounding of a row in sum, for every |x| <= 1."""
    M = jnp.concatenate([jnp.eye(len(h), dtype=h.dtype), K], 1)
    return mapped(M, jnp.zeros_like(M), jnp.concatenate([h, b]), jnp.concatenate([H, -A]))
