"""Relations between Intervals, and membership: exact for all floats, by their bits, for compiled code
compares subnormal numbers as 0.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import WRAPPER_ASSIGNMENTS, reduce, wraps

import jax
import jax.numpy as jnp

from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals.bounds import Number, bound
from jaxbound.sets.intervals.interval import Interval, Operand, alike

__all__ = ["contains", "disjoint", "interior", "less", "precedes", "subset"]


def _ordered(x: Interval) -> Interval:
    """Return the bounds as integers in the order of floats, which are compared exactly."""
    return Interval(rounding.order(x.lo), rounding.order(x.hi))


def _relation(holds: Callable[..., jax.Array]) -> Callable[[Operand, Operand], jax.Array]:
    """Lift holds(x, y, no x, no y, infinity), its bounds integers in the order of floats; no relation holds
    for a bound that is NaN.
    """

    @wraps(holds, WRAPPER_ASSIGNMENTS[:4])
    def relation(x: Operand, y: Operand) -> jax.Array:
        x, y = alike(x, y)
        known = reduce(operator.and_, [end == end for end in (x.lo, x.hi, y.lo, y.hi)])
        return known & holds(
            _ordered(x), _ordered(y), x.is_empty, y.is_empty, rounding.order(jnp.full((), jnp.inf, x.dtype))
        )

    del relation.__wrapped__  # and its signature: what is lifted takes two Intervals
    return relation


@_relation
def subset(x: Interval, y: Interval, nothing: jax.Array, *_: jax.Array) -> jax.Array:
    """Return whether x lies in y. Source: IEEE 1788 subset."""
    return nothing | ((x.lo >= y.lo) & (x.hi <= y.hi))


@_relation
def interior(
    x: Interval, y: Interval, nothing: jax.Array, nowhere: jax.Array, infinite: jax.Array
) -> jax.Array:
    """Return whether x lies in the interior of y. Source: IEEE 1788 interior."""
    below, above = (x.lo > y.lo) | (y.lo == -infinite), (x.hi < y.hi) | (y.hi == infinite)
    return nothing | (below & above & ~nowhere)


@_relation
def disjoint(x: Interval, y: Interval, nothing: jax.Array, nowhere: jax.Array, _: jax.Array) -> jax.Array:
    """Return whether no point is shared. Source: IEEE 1788 disjoint."""
    return nothing | nowhere | (x.hi < y.lo) | (y.hi < x.lo)


@_relation
def less(x: Interval, y: Interval, nothing: jax.Array, nowhere: jax.Array, _: jax.Array) -> jax.Array:
    """Return whether x is weakly below y: both ends are. Source: IEEE 1788 less."""
    return (nothing & nowhere) | (~nothing & ~nowhere & (x.lo <= y.lo) & (x.hi <= y.hi))


@_relation
def precedes(x: Interval, y: Interval, nothing: jax.Array, nowhere: jax.Array, _: jax.Array) -> jax.Array:
    """Return whether every point of x is <= every point of y. Source: IEEE 1788 precedes."""
    return nothing | nowhere | (x.hi <= y.lo)


def contains(x: Interval, point: Number) -> jax.Array:
    """Return whether the number lies in x; infinities and NaN never do. Source: IEEE 1788 isMember."""
    # a number between two floats lies in x where both do
    below, above = (
        jnp.asarray(bound(point, directed)) for directed in (rounding.round_down, rounding.round_up)
    )
    dtype = jnp.result_type(x.dtype, below.dtype)
    x, below, above = jax.tree.map(lambda v: rounding.widened(v, dtype), (x, below, above))
    inside = (x.lo == x.lo) & (x.hi == x.hi) & (below == below) & (jnp.isfinite(below) | jnp.isfinite(above))
    x = _ordered(x)
    return inside & (x.lo <= rounding.order(below)) & (rounding.order(above) <= x.hi)
