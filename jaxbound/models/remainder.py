"""A function as a plane plus a remainder that is enclosed over a box: what is left of a nonlinear model once
it is linear.

    f(x) = S (x - c) + r,    r in [lo, hi]

The box is cut into thousands of cells; on each, f is enclosed by its value in the middle and its slopes all
over the cell: the excess is of second order in the size of a cell.

Source: Moore, Kearfott, Cloud 2009, chapter 6: mean value form, refinement.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr

from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.inclusion.derivatives import plain
from jaxbound.sets.inclusion.functions import forgets
from jaxbound.sets.inclusion.jaxprs import evaluate, refuse_unsupported
from jaxbound.sets.inclusion.lifted import enclose
from jaxbound.sets.intervals.interval import Interval, add, interval, mid, mul, sub, sum

CELLS = 4096

Function: TypeAlias = Callable[[jax.Array], jax.Array]


@dataclass(frozen=True)
class Plane:
    """A plane near a function, and what it leaves: arrays of Fractions.

    Fields: centre (N,), slopes (k, N), remainder (k, 2).
    """

    centre: np.ndarray
    slopes: np.ndarray
    remainder: np.ndarray


def plane(
    f: Function,
    lo: Sequence[Fraction] | np.ndarray,
    hi: Sequence[Fraction] | np.ndarray,
    level: int = 0,
    smooth: tuple[Function, ...] = (),
) -> Plane:
    """Return the Plane of f over a box.

    Args:
        f: a hashable JAX function of one array (N,) with an array (k,) as its value.
        lo, hi: (N,) Fractions.
        level: the plane has no slope along the last `level` entries.
        smooth: further functions of the array that must be continuous, too.

    Returns:
        A Plane about the middle of the box; rows of the remainder are infinite (floats) where f is not proved
        to be continuous all over the box with bounded slopes, all of them where one of `smooth` is not
        continuous.

    Encloses: slopes (x - centre) + r with r in the remainder holds f(x), for each x of the box.

    Example:
        >>> p = plane(lambda x: x * x, [Fraction(1)], [Fraction(3)])  # 4 (x - 2) + 4 + (x - 2)^2
        >>> [round(float(v), 4) for v in (p.centre[0], p.slopes[0, 0], *p.remainder[0])]
        [2.0, 4.0, 4.0, 5.0]
    """
    box = interval(np.array(lo, object), np.array(hi, object))
    c = mid(box)
    slopes = np.array(_derivatives_at(f, c))
    slopes[:, len(c) - level :] = 0
    found = _remainders((f, *smooth), _cells(f, box, c), c, slopes)
    ends = np.stack([np.asarray(found.lo).min(0), np.asarray(found.hi).max(0)], 1)
    exact = np.vectorize(_exact, otypes=[object])
    return Plane(exact(c), exact(slopes), exact(ends))


def _exact(x: float) -> Fraction | float:
    """Return a finite float exactly, another as it is."""
    if not np.isfinite(x):
        return float(x)
    return Fraction(float(x))


def derivatives(f: Function) -> Function:
    """Return the derivatives (k, N) of f as a function; those of its mathematics: no custom rule, no
    stop_gradient.
    """

    def mathematics(x: jax.Array) -> jax.Array:
        closed = jax.make_jaxpr(f)(_like(x))
        value: jax.Array = plain(closed.jaxpr, closed.consts, [x])[0]
        return value

    slopes: Function = jax.jacfwd(mathematics)
    return slopes


def _like(x: jax.Array) -> jax.ShapeDtypeStruct:
    """Return the shape and type of an array."""
    return jax.ShapeDtypeStruct(x.shape, x.dtype)  # type: ignore[no-untyped-call]  # jax states no types here


@forgets
@kernel(static_argnums=0)
def _derivatives_at(f: Function, x: jax.Array) -> jax.Array:
    """Return the derivatives of f at a point, in plain floats, 0 where they are infinite: a choice, not a
    proof.
    """
    slopes = derivatives(f)(x)
    return jnp.where(jnp.isfinite(slopes), slopes, 0)


def _cells(f: Function, box: Interval, c: jax.Array) -> Interval:
    """Return CELLS cells, an Interval (CELLS, N), that fill the box, cut most where the slopes of f change
    most.
    """
    N, lo, hi = len(c), np.asarray(box.lo), np.asarray(box.hi)
    ends = np.tile(np.asarray(c), (2 * N, 1))
    ends[np.arange(N), np.arange(N)], ends[N + np.arange(N), np.arange(N)] = lo, hi
    slopes = np.stack([_derivatives_at(f, end) for end in ends])
    # how much slopes differ between the two ends of an axis, times its width
    change = (np.abs(slopes[:N] - slopes[N:]).sum(1) * (hi - lo)).sum(1)
    cuts = np.ones(N, int)
    # halves where a cell still sees the largest change of slopes: the excess is of that order
    while cuts.prod() < CELLS:
        cuts[np.argmax(change / cuts)] *= 2
    low, high = [], []
    for a, b, k in zip(lo, hi, cuts, strict=True):
        # rounded edges must neither leave the box nor fall short of it
        edges = np.clip(np.linspace(a, b, k + 1, dtype=lo.dtype), a, b)
        edges[0], edges[-1] = a, b
        low.append(edges[:-1])
        high.append(edges[1:])
    return Interval(_grid(low), _grid(high))


def _grid(axes: list[np.ndarray]) -> jax.Array:
    """Return all points (count, N) of a grid."""
    along = np.meshgrid(*axes, indexing="ij")
    return jnp.asarray(np.stack([numbers.ravel() for numbers in along], 1))


@forgets
@kernel(static_argnums=0)
def _remainders(
    functions: tuple[Function, ...], cells: Interval, c: jax.Array, slopes: jax.Array
) -> Interval:
    """Enclose the remainder of the first function beside the plane, over each cell. All functions are
    continuous.
    """
    shape = _like(c)
    whole = [jax.make_jaxpr(g)(shape) for g in functions]
    first = jax.make_jaxpr(derivatives(functions[0]))(shape)
    refuse_unsupported(first.jaxpr, "the derivative of the model", "write it with others")
    q = mid(cells)
    value, _ = _enclosed(whole[0], Interval(q, q))
    J, _ = _enclosed(first, cells)
    continuous = jnp.all(jnp.stack([_enclosed(closed, cells)[1] for closed in whole]), 0)
    return jax.vmap(partial(_remainder, c, slopes))(cells, value, J, continuous)


def _enclosed(closed: ClosedJaxpr, boxes: Interval) -> tuple[Interval, jax.Array]:
    """Return an enclosure of the only output over each box, and whether it is continuous there."""

    def over(box: Interval) -> tuple[Interval, jax.Array]:
        (out,), continuous = evaluate(closed.jaxpr, closed.consts, [box])
        x = enclose(out)
        # a formula that has no value may have any
        low, high = jnp.where(x.is_empty, -jnp.inf, x.lo), jnp.where(x.is_empty, jnp.inf, x.hi)
        return Interval(low, high), jnp.asarray(continuous)

    return jax.vmap(over)(boxes)


def _remainder(
    c: jax.Array, slopes: jax.Array, cell: Interval, value: Interval, J: Interval, continuous: jax.Array
) -> Interval:
    """Enclose the remainder over one cell by f's value in the middle and its slopes J all over the cell."""
    q = interval(mid(cell))
    # mean value form: f(q) and slopes of the cell enclose f, less the plane
    near = sub(value, _times(interval(slopes), sub(q, c)))
    out = add(near, _times(sub(J, slopes), sub(cell, q)))
    # infinite where nothing is proved: an extreme over all cells keeps it, and would lose NaN
    proved = continuous & ~jnp.isnan(out.lo) & ~jnp.isnan(out.hi)
    return Interval(jnp.where(proved, out.lo, -jnp.inf), jnp.where(proved, out.hi, jnp.inf))


def _times(M: Interval, x: Interval) -> Interval:
    """Return M x."""
    return sum(mul(M, x[None, :]), 1)
