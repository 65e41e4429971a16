"""Maps, sums and products of zonotopes and constrained zonotopes: every result encloses the exact one.

A set is {c + G x : |x_j| <= 1, A x = b}, a zonotope one without constraints. Rounding follows one rule: where
entries of row i of [c, G] are computed, the result gets one more generator along coordinate i, at least as
long as all that these entries can be off by in sum,

    e_i >= |dc_i| + sum_j |dG_ij|,

for then c + G x lies in (c + dc) + (G + dG) x + e_i [-1, 1] for every x. A map or a sum of n coordinates so
adds n generators, which come last; `reduce_order` merges them again. Nothing is added where entries are only
copied. An overflow leaves infinities or NaN, with which nothing is ever decided.
"""

from __future__ import annotations

from typing import cast

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.equations import is_traced
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.intervals.interval import Interval, Operand, interval, mid, rad
from jaxbound.sets.zonotopes.constrained import AnySet, ConstrainedZonotope, parts
from jaxbound.sets.zonotopes.zonotope import Zonotope

SHORT = (
    16  # up to here a product of matrices fuses as a sum of outer products; a library's dot does better above
)


def dimension(S: AnySet) -> int:
    """Return how many coordinates a set has, at the door of an operation: refused where arithmetic was not
    verified.
    """
    refuse_unverified(S)
    shape = np.shape(S.center if isinstance(S, Zonotope) else parts(S)[0])
    if len(shape) != 1:
        raise ValueError(
            f"one set is needed, with a center (n,): its shape is {shape}; use jax.vmap for a batch of sets"
        )
    return shape[0]


def whole(c: jax.Array, G: jax.Array, A: jax.Array, b: jax.Array, error: jax.Array | None = None) -> AnySet:
    """Return the set {c + G x + diag(error) x' : A x = b}: a Zonotope where A has no rows, whatever it had
    before.
    """
    if error is not None:
        G = jnp.concatenate([G, jnp.diag(error)], 1)
        A = jnp.concatenate([A, jnp.zeros((A.shape[0], len(error)), A.dtype)], 1)
    return ConstrainedZonotope(c, G, A, b) if A.shape[0] else Zonotope(c, G)


def reach(c: jax.Array, G: jax.Array) -> jax.Array:
    """Return (n,) upper bounds of |c_i| + sum_j |G_ij|."""
    size = jnp.abs(G)
    return up(rounding.outward_sum(size, size, 1)[1] + jnp.abs(c))


def product(M: jax.Array, G: jax.Array) -> jax.Array:
    """Return M G in floats, off by at most what `rounding.product_error` says, in whatever order it is
    added.
    """
    if M.shape[1] > SHORT:
        return jnp.matmul(M, G, precision="highest")
    return jnp.sum(M[:, :, None] * G[None], 1)


def weighed(W: jax.Array, x: jax.Array) -> jax.Array:
    """Return (r,) upper bounds of W x, for W (r, n) and x (n,) not negative."""
    gamma, floor = rounding.product_error(W.shape[1], x.dtype)
    total = jnp.sum(W * x[None], 1)
    return up(total + (gamma * total + floor * (1 + jnp.max(W, initial=0)) * (1 + jnp.max(x, initial=0))))


def mapped(
    M: jax.Array, spread: jax.Array, c: jax.Array, G: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (M c, M G, error) for a matrix of floats and a matrix `spread` of radii around its entries."""
    far, size = reach(c, G), M.shape[1]
    gamma, least = rounding.product_error(size, c.dtype)
    weight = up(gamma * jnp.abs(M) + spread)
    floor = least * (G.shape[1] + 1) * (1 + jnp.max(jnp.abs(M), initial=0)) * (1 + jnp.max(far, initial=0))
    return product(M, c[:, None])[:, 0], product(M, G), up(weighed(weight, far) + floor)


def up(x: jax.Array) -> jax.Array:
    """Round a computed bound up, past the error of the operation that gave it."""
    return rounding.outward(x, x)[1]


def linear_map(matrix: Operand, S: AnySet, offset: Operand | None = None) -> AnySet:
    """Return the image {M p + offset : p in S}, M a matrix of numbers or of intervals.

    Args:
        matrix: (r, n) numbers or Interval: with intervals the result holds the images under every matrix
            inside.
        S: a Zonotope or ConstrainedZonotope of n coordinates. offset: (r,) numbers or Interval, or None.

    Returns:
        A set of r coordinates of the same kind with r generators more, which hold the rounding and the
        intervals' radii.

    Encloses: M p + offset for every p in S, exact arithmetic.

    Raises:
        ValueError: shapes that do not fit.

    Source: Kuehn 1998; interval matrices: Althoff, Stursberg, Buss 2007 (middle and radius apart).

    Example:
        >>> from jaxbound import sets
        >>> Z = sets.linear_map([[1.0, 1.0]], sets.zonotope([1.0, 2.0], [[1.0, 3.0], [2.0, 4.0]]))
        >>> print(Z.center, Z.generators[:, :2])
        [3.] [[3. 7.]]
    """
    M, n = interval(matrix), dimension(S)
    if len(M.shape) != 2 or M.shape[1] != n:
        raise ValueError(
            f"the matrix must have shape (r, {n}) for a set of {n} coordinates: its shape is {M.shape}"
        )
    move = None if offset is None else interval(offset)
    if move is not None and move.shape != (M.shape[0],):
        raise ValueError(f"the offset must have shape ({M.shape[0]},): its shape is {move.shape}")
    return _linear_map(M, S, move)


@kernel
def _linear_map(M: Interval, S: AnySet, move: Interval | None) -> AnySet:
    M, S, move = rounding.one_dtype(M, S, move)
    c, G, A, b = parts(S)
    c, G, error = mapped(mid(M), rad(M), c, G)
    return whole(c, G, A, b, error) if move is None else _moved(c, G, A, b, move, error)


def _moved(
    c: jax.Array, G: jax.Array, A: jax.Array, b: jax.Array, move: Interval, error: jax.Array
) -> AnySet:
    c, more = added(c, mid(move))
    return whole(c, G, A, b, up(up(error + more) + rad(move)))


def added(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return x + y and a bound of what its rounding, and subnormal numbers read as 0, can be off by."""
    total = x + y
    return total, 4 * rounding.unit(x.dtype) * jnp.abs(total) + 8 * rounding.tiny(x.dtype)


def minkowski_sum(S: AnySet, T: AnySet) -> AnySet:
    """Return {p + r : p in S, r in T}.

    Generators of S, then of T, then n for the rounding of the center. Source: Kuehn 1998; Scott, Raimondo,
    Marseglia, Braatz 2016, (12).

    Args:
        S, T: each a Zonotope or a ConstrainedZonotope; both of n coordinates.

    Raises:
        ValueError: sets of different dimension.

    Example:
        >>> from jaxbound import sets
        >>> sets.minkowski_sum(sets.zonotope([1.0], [[2.0]]), sets.zonotope([3.0], [[4.0]])).generators[:, :2]
        Array([[2., 4.]], dtype=...)
    """
    n, m = dimension(S), dimension(T)
    if n != m:
        raise ValueError(f"only sets of one dimension can be added: they have {n} and {m} coordinates")
    return _minkowski_sum(S, T)


@kernel
def _minkowski_sum(S: AnySet, T: AnySet) -> AnySet:
    (c, G, A, b), (d, H, B, e) = (parts(x) for x in rounding.one_dtype(S, T))
    center, error = added(c, d)
    return whole(center, jnp.concatenate([G, H], 1), blocks(A, B), jnp.concatenate([b, e]), error)


def blocks(A: jax.Array, B: jax.Array) -> jax.Array:
    """Return the matrix with the blocks A and B on its diagonal."""
    upper = jnp.concatenate([A, jnp.zeros((A.shape[0], B.shape[1]), A.dtype)], 1)
    return jnp.concatenate([upper, jnp.concatenate([jnp.zeros((B.shape[0], A.shape[1]), B.dtype), B], 1)])


def translate(S: AnySet, vector: Operand) -> AnySet:
    """Return {p + vector : p in S}, with n generators more.

    Args:
        S: a Zonotope or ConstrainedZonotope of n coordinates.
        vector: (n,) numbers or an Interval. Numbers in a list leave the dtype as it is.

    Raises:
        ValueError: a vector of another dimension, NaN or infinity.
    """
    n = dimension(S)
    if isinstance(vector, (list, tuple)):
        vector = interval(
            rounding.round_down(vector, S.center.dtype), rounding.round_up(vector, S.center.dtype)
        )
    move = interval(vector)
    if move.shape != (n,):
        raise ValueError(f"the vector must have shape ({n},): its shape is {move.shape}")
    return _translated(S, move)


@kernel
def _translated(S: AnySet, move: Interval) -> AnySet:
    S, move = rounding.one_dtype(S, move)
    return _moved(*parts(S), move, jnp.zeros_like(parts(S)[0]))


def scale(S: AnySet, factor: Operand) -> AnySet:
    """Return {factor * p : p in S}.

    Args:
        S: a Zonotope or ConstrainedZonotope of n coordinates.
        factor: a number, (n,) numbers one a coordinate, or an Interval of either shape.

    Raises:
        ValueError: a factor of another shape.
    """
    n, factor = dimension(S), interval(factor)
    if factor.shape not in ((), (n,)):
        raise ValueError(f"the factor must be one number or have shape ({n},): its shape is {factor.shape}")
    return _scaled(S, factor)


@kernel
def _scaled(S: AnySet, factor: Interval) -> AnySet:
    n = parts(S)[0].shape
    return _linear_map(Interval(*(jnp.diag(jnp.broadcast_to(x, n)) for x in (factor.lo, factor.hi))), S, None)


def cartesian_product(S: AnySet, T: AnySet) -> AnySet:
    """Return {(p, r) : p in S, r in T}, exactly: coordinates and generators of S, then those of T.

    Args:
        S, T: each a Zonotope or a ConstrainedZonotope, of any dimensions.
    """
    dimension(S), dimension(T)
    return _cartesian_product(S, T)


@kernel
def _cartesian_product(S: AnySet, T: AnySet) -> AnySet:
    (c, G, A, b), (d, H, B, e) = (parts(x) for x in rounding.one_dtype(S, T))
    return whole(jnp.concatenate([c, d]), blocks(G, H), blocks(A, B), jnp.concatenate([b, e]))


def from_interval(box: Interval) -> Zonotope:
    """Return the Zonotope of a box: n generators, rounded outward.

    Args:
        box: an Interval (n,).

    Raises:
        ValueError: an array of another rank, a box that is empty (inside jit it becomes a set of NaN, of
            which nothing is decided).
    """
    refuse_unverified(box)
    if len(box.shape) != 1:
        raise ValueError(f"a box is an Interval of shape (n,): the shape is {box.shape}")
    if not is_traced(box):
        empty = np.nonzero(np.asarray(box.lo) > np.asarray(box.hi))[0]
        if empty.size:
            raise ValueError(
                f"an empty box is no zonotope: {empty.size} of {box.shape[0]} coordinates are empty, first "
                f"at ({empty[0]},)"
            )
    return _from_interval(box)


@kernel
def _from_interval(box: Interval) -> Zonotope:
    return Zonotope(mid(box), jnp.diag(rad(box)))


def convex_hull(Z: Zonotope, Y: Zonotope) -> Zonotope:
    """Return a Zonotope that encloses the convex hull of two.

    {(p + r) / 2 + (p - r) s / 2} with generators taken in pairs: half their sums, half their differences,
    half the difference of the centers; missing ones of the smaller are 0.

    Args:
        Z, Y: Zonotopes of one dimension.

    Raises:
        ValueError: sets of different dimension. TypeError: a set with constraints.

    Source: Girard 2005, section 3.
    """
    for S in (Z, Y):
        if not isinstance(S, Zonotope | Interval):
            raise TypeError(
                f"the hull of two Zonotopes is enclosed, not of {type(S).__name__}: eliminate its "
                f"constraints first"
            )
    if (n := dimension(Z)) != (m := dimension(Y)):
        raise ValueError(f"the sets must have one dimension: they have {n} and {m} coordinates")
    return _convex_hull(Z, Y)


@kernel
def _convex_hull(Z: Zonotope, Y: Zonotope) -> Zonotope:
    (c, G, *_), (d, H, *_) = (parts(x) for x in rounding.one_dtype(Z, Y))
    G, H = (jnp.pad(x, ((0, 0), (0, max(G.shape[1], H.shape[1]) - x.shape[1]))) for x in (G, H))
    c, d, G, H = 0.5 * c, 0.5 * d, 0.5 * G, 0.5 * H
    columns = jnp.concatenate([(c - d)[:, None], G + H, G - H], 1)
    center, error = added(c, d)
    error = (
        error
        + 4 * rounding.unit(c.dtype) * reach(center, columns)
        + 8 * columns.shape[1] * rounding.tiny(c.dtype)
    )
    return cast(Zonotope, whole(center, columns, jnp.zeros((0, columns.shape[1]), c.dtype), c[:0], up(error)))
