"""Is there a solution of f(z) in T in a box? One step of a search that proves either answer.

    excluded   f(X) misses T, or f(c) + f'(X) (X - c) does, or the Krawczyk operator misses X
    (nothing of X is lost)
    rest       X intersected with c + P (T - f(c)) + (I - P f'(X)) (X - c)
    proved     a point x of the box with f(x) in T, T having an interior; or: with z(s) = x + P s, |s_i| <=
               r_i, |f(x) - t| + |I - f'(Z) P| r <= r maps {s} into itself, so that f(z(s)) = t has a solution
               by Brouwer's theorem

P (n, m) is any float matrix, near a right inverse of f' on the box; surplus variables (n > m) follow as
little as they can. No proof depends on how good P or x are. Slopes are used only where f is proved to be
continuous.

Source: Krawczyk 1969 (the operator); Neumaier 1990, Interval methods for systems of equations, section 5.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.inclusion.functions import forgets
from jaxbound.sets.inclusion.inclusion import Inclusion, inclusion
from jaxbound.sets.intervals.comparisons import subset
from jaxbound.sets.intervals.interval import Interval, hull, mag, mid, rad, wid
from jaxbound.sets.paving.frontier import Verdicts


def components(f: Callable[..., Any], z: Interval, args: tuple[jax.Array, ...]) -> list[Interval]:
    """Return the image of a box z as a list of Intervals (); f is a function of numbers or of Intervals."""
    if is_interval_function(f, z.lo, args):
        return list(f(z, *args))
    images = jax.tree.leaves(inclusion(lambda z: f(z, *args))(z), is_leaf=_is_interval)
    return [x for image in images for x in jax.tree.map(jnp.ravel, image)]


def is_interval_function(f: Callable[..., Any], z: Any, args: tuple[Any, ...]) -> bool:
    """Return whether f takes an Interval (n,) and no array (n,), or returns Intervals even for an array."""
    try:
        return any(map(_is_interval, jax.tree.leaves(jax.eval_shape(f, z, *args), is_leaf=_is_interval)))
    except Exception as unfit:  # whatever arrays do to a function that is not meant for them
        try:
            jax.eval_shape(f, Interval(z, z), *args)
        except Exception:
            raise unfit from None
        return True


def _is_interval(x: object) -> bool:
    return isinstance(x, Interval)


def _flat(f: Callable[..., Any], args: tuple[jax.Array, ...]) -> Inclusion:
    """Return z -> f(z, *args) with all its outputs in one array, f a JAX function of numbers, as an inclusion
    function.
    """
    return inclusion(lambda z: jnp.concatenate([jnp.ravel(x) for x in jax.tree.leaves(f(z, *args))]))


class _Image(NamedTuple):
    """The image of a box, and whether f is proved to be defined and continuous there."""

    box: Interval
    smooth: jax.Array


class _Left(NamedTuple):
    """Whether a box is excluded, what is left of it, a guess x at a solution; P: near its inverse slope."""

    out: jax.Array
    rest: Interval
    x: jax.Array
    P: jax.Array


class _Near(NamedTuple):
    """|f(x) - t|, r, the box Z around x, the box over which slopes have to be close.

    r is in proportion to how far f moves over X, component by component, and twice the largest miss.
    """

    miss: jax.Array
    r: jax.Array
    Z: Interval
    wide: Interval


@forgets
@kernel(static_argnums=0)
def imaged(f: Callable[..., Any], X: Interval, args: tuple[jax.Array, ...]) -> _Image:
    """Return the images (m, N) of boxes (n, N), with smooth (N,)."""
    one = lambda X, *a: _Image(_flat(f, a)(X), _flat(f, a).continuous(X))
    return jax.vmap(one, in_axes=-1, out_axes=-1)(X, *args)


_middle = kernel(mid)


@forgets
@kernel(static_argnums=0)
def _slope(f: Callable[..., Any], X: Interval, args: tuple[jax.Array, ...]) -> Interval:
    """Return the slopes (m, n, N) of f over boxes (n, N), entire where f is not proved to be continuous."""
    return jax.vmap(lambda X, *a: _flat(f, a).jacobian(X), in_axes=-1, out_axes=-1)(X, *args)


def search(
    f: Callable[..., Any],
    domain: Interval,
    unique: bool,
    region: bool,
    X: Interval,
    T: Interval,
    args: tuple[jax.Array, ...],
) -> Verdicts[jax.Array]:
    """Return the Verdicts on boxes X, an Interval (n, N), with f of numbers and args (..., N).

    Args:
        domain: Interval (n,), where solutions count.
        unique: prove that a solution is the only one of its box too, which then is settled.
        region: any point of T is a solution's image; else T encloses one point, whichever, that has to be the
            image.
        T: Interval (m, N), the target of each box.

    f and its slope are compiled once each; what depends on f only through them, for all functions of one
    shape.
    """
    image = imaged(f, X, args)
    if T.shape != image.box.shape:
        raise ValueError(f"the target has {T.shape[0]} components, f has {image.box.shape[0]}")
    centre = _middle(X)
    value, slope = imaged(f, _point(centre), args).box, _slope(f, X, args)
    left = _narrow(domain, X, T, image, centre, value, slope)
    reached = imaged(f, _point(left.x), args)
    around = _around(unique, region, X, T, slope, left, reached.box)
    return _conclude(region, domain, T, slope, left, reached, around, _slope(f, around.wide, args))


def _over_boxes(one: Callable[..., Any], *given: object) -> Any:
    """Return one(..) of each column, with the boxes first while it works: one layout for all, and half of
    what compiles is transposing.
    """
    first = jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), given)
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), jax.vmap(one)(*first))


@kernel
def _narrow(domain: Interval, *given: object) -> _Left:
    return _over_boxes(partial(_narrowed, domain), *given)


def _narrowed(domain, X, T, image, centre, value, slope):
    smooth = image.smooth
    d, J = rad(X), mid(slope)
    # how far f can move from its value in the middle
    reach = _upper(mag(slope), d)
    # the second by the mean value theorem
    out = _apart(image.box, T) | smooth & _apart(value + Interval(-reach, reach), T)
    P = _right_inverse(J, d)
    step, error = _times(P, mid(T - value))
    strays = _upper(_stray(P, J, jnp.abs(P), rad(slope)), d) + _upper(jnp.abs(P), rad(T - value)) + error
    strays = _upward(strays)
    moved = _point(centre) + (_point(step) + Interval(-strays, strays))
    lo, hi = rounding.settle_subnormals(X.lo, X.hi)
    lo, hi = jnp.maximum(lo, moved.lo), jnp.minimum(hi, moved.hi)  # NaN where either is
    usable = smooth & ~jnp.isnan(lo) & ~jnp.isnan(hi)
    out |= jnp.any(usable & (lo > hi))
    usable &= ~out
    rest = Interval(jnp.where(usable, lo, X.lo), jnp.where(usable, hi, X.hi))
    x = centre + P @ (mid(T) - mid(value))
    # where elimination failed there is still a point to look at
    return _Left(out, rest, jnp.where(jnp.isnan(x), centre, jnp.clip(x, domain.lo, domain.hi)), P)


@kernel(static_argnums=(0, 1))
def _around(unique: bool, region: bool, *given: object) -> _Near:
    def one(X, T, slope, left, reached):
        x, P = left.x, left.P
        # an exact target is a point; of a set any point will do, so its middle is aimed at
        miss = mag(reached - (_point(mid(T)) if region else T))
        moves = jnp.abs(mid(slope)) @ (X.hi * 0.5 - X.lo * 0.5)
        usable = jnp.isfinite(moves) & (moves > 0)
        share = jnp.max(jnp.where(usable, miss / jnp.where(usable, moves, 1), 0))
        # twice the largest miss: room for what the box of slopes adds
        r = miss + jnp.where(usable, share * moves, miss) + 1024 * rounding.tiny(miss.dtype)
        reach = _upper(jnp.abs(P), r)
        Z, fixed = _point(x) + Interval(-reach, reach), jnp.all(P == 0, 1)  # zeros move nothing, exactly
        Z = Interval(jnp.where(fixed, x, Z.lo), jnp.where(fixed, x, Z.hi))
        return _Near(miss, r, Z, hull(Z, left.rest) if unique else Z)

    return _over_boxes(one, *given)


@kernel(static_argnums=0)
def _conclude(region: bool, domain: Interval, *given: object) -> Verdicts[jax.Array]:
    def one(T, slope, left, reached, around, near):
        rest, P, r, Z = left.rest, left.P, around.r, around.Z
        n, m = P.shape
        J = mid(near)
        bend = _stray(J, P, rad(near), jnp.abs(P))
        # strictly: then near P is regular, which makes the solution unique
        into = _upward(around.miss + _upper(bend, r)) < r
        holds = (n >= m) & jnp.all(into) & jnp.all(subset(Z, domain))
        inside = region & jnp.all(subset(reached.box, T) & ~reached.box.is_empty) & reached.smooth
        proved = ~left.out & (inside | holds)
        proof = jnp.where(inside, left.x, Z.lo), jnp.where(inside, left.x, Z.hi)
        lean = jnp.max(mag(slope), 0) * wid(rest)  # smear: the variable that moves f most
        # beside the whole domain: variables have different units
        whole = jnp.where(domain.hi > domain.lo, domain.hi * 0.5 - domain.lo * 0.5, 1)
        axis = jnp.argmax(jnp.where(jnp.all(jnp.isfinite(lean)), lean, wid(rest) / whole))
        return Verdicts(~left.out & ~proved, proved, proof, (rest.lo, rest.hi), axis)

    return _over_boxes(one, *given)


def _point(x: jax.Array) -> Interval:
    return Interval(x, x)


def _apart(image: Interval, T: Interval) -> jax.Array:
    """Return whether some component misses its target; a bound that is NaN excludes nothing."""
    return jnp.any((image.lo > T.hi) | (T.lo > image.hi))


def _times(A: jax.Array, B: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (A B, a bound of its error), for numbers (p, k) and (k, q) or (k,)."""
    gamma, floor = rounding.product_error(A.shape[-1], A.dtype)
    exactly = partial(jnp.matmul, precision=jax.lax.Precision.HIGHEST)
    ends = [1 + jnp.max(jnp.abs(x)) for x in (A, B)]
    return exactly(A, B), gamma * exactly(jnp.abs(A), jnp.abs(B)) + floor * ends[0] * ends[1]


def _upper(A: jax.Array, B: jax.Array) -> jax.Array:
    """Return an upper bound of A B, both >= 0."""
    product, error = _times(A, B)
    return product + error


def _stray(A: jax.Array, B: jax.Array, A_size: jax.Array, B_size: jax.Array) -> jax.Array:
    """Return a bound of |I - M|, M any product of a point and an interval matrix with the middles A and B.

    A_size, B_size: absolute values of the one and radii of the other.
    """
    product, error = _times(A, B)
    return _upward(
        jnp.abs(jnp.eye(len(product), dtype=product.dtype) - product) + error + _upper(A_size, B_size)
    )


def _upward(x: jax.Array) -> jax.Array:
    """Return at least the exact sum of a few numbers >= 0 that x was computed as."""
    return x * (1 + 8 * rounding.unit(x.dtype)) + 8 * rounding.tiny(x.dtype)


def _right_inverse(J: jax.Array, scale: jax.Array) -> jax.Array:
    """Return P (n, m) with J P near I (n >= m) or P J near I (n < m), moving variables in proportion to
    `scale`; zeros if there is none.
    """
    m, n = J.shape
    # in units of the box: a long side may move farther
    scale = scale / jnp.max(scale)
    A = J * scale[None]
    if n == m:
        P = _inverse(A)
    else:
        gram = A @ A.T if n > m else A.T @ A
        P = A.T @ _inverse(gram) if n > m else _inverse(gram) @ A.T
    P = scale[:, None] * P
    return jnp.where(jnp.all(jnp.isfinite(P)), P, 0)


def _inverse(M: jax.Array) -> jax.Array:
    """Return the inverse of a square matrix; a single residual, which many have, costs no elimination to
    compile.
    """
    return 1 / M if len(M) == 1 else jnp.linalg.inv(M)
