"""Sets of integers and of predicates, and what the primitives of JAX make of them.

An Interval of predicates says in `lo` what surely holds and in `hi` what possibly does; an Interval of
integers holds all integers from lo to hi.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.intervals.interval import Interval

Rule: TypeAlias = Callable[..., Interval | jax.Array]
"""What a primitive becomes: a function of Intervals, given the parameters of the primitive by name."""


def whole(x: Interval) -> bool:
    """True for an Interval of integers or predicates."""
    return not jnp.issubdtype(x.dtype, jnp.floating)


def least(dtype: np.dtype) -> float:
    """Return the least number (or predicate) of a type, -inf for floats."""
    return (
        False
        if dtype == jnp.bool_
        else np.iinfo(dtype).min
        if jnp.issubdtype(dtype, jnp.integer)
        else -np.inf
    )


def most(dtype: np.dtype) -> float:
    """Return the greatest number (or predicate) of a type, inf for floats."""
    return (
        True if dtype == jnp.bool_ else np.iinfo(dtype).max if jnp.issubdtype(dtype, jnp.integer) else np.inf
    )


def integers(f: Callable[..., jax.Array]) -> Rule:
    """Lift an integer operation that is monotone in each operand; where it could wrap around, anything is
    possible.
    """

    def rule(*xs, axes=None, **_):
        dtype, along = xs[0].dtype, {} if axes is None else {"axis": axes}
        corners = [[(x.lo, x.hi)[k >> i & 1] for i, x in enumerate(xs)] for k in range(2 ** len(xs))]
        exact = [f(*ends, **along) for ends in corners]
        real = [f(*(e.astype(float) for e in ends), **along) for ends in corners]
        size = [f(*(jnp.abs(e.astype(float)) for e in ends), **along) for ends in corners]
        limit = 2.0 ** jnp.finfo(real[0].dtype).nmant  # floats hold all integers up to here
        wraps = (
            (extreme(jnp.minimum, real) < least(dtype))
            | (extreme(jnp.maximum, real) > most(dtype))
            | (extreme(jnp.maximum, size) > limit)
        )
        lo, hi = extreme(jnp.minimum, exact), extreme(jnp.maximum, exact)
        return Interval(jnp.where(wraps, least(dtype), lo), jnp.where(wraps, most(dtype), hi))

    return rule


def extreme(pick: Callable[[jax.Array, jax.Array], jax.Array], values: Sequence[jax.Array]) -> jax.Array:
    """Return the least (pick = jnp.minimum) or greatest of arrays."""
    return functools.reduce(pick, values)


def comparison(holds: Callable[[Any, Any], Any], swap: bool) -> Rule:
    """Lift < or <= to Intervals: surely where it holds for the farthest ends, possibly where for the
    nearest.
    """

    def rule(x, y, same=False, **_):
        if same:
            return jnp.full(x.shape, holds(0, 0))
        x, y = (y, x) if swap else (x, y)
        return Interval(holds(x.hi, y.lo), holds(x.lo, y.hi))

    return rule


def equals(x: Interval, y: Interval, same: bool = False, **_: object) -> Interval | jax.Array:
    """Compare for equality: sure for one and the same number, possible where x and y overlap."""
    if same:
        return jnp.ones(x.shape, bool)
    return Interval((x.lo == x.hi) & (y.lo == y.hi) & (x.lo == y.lo), (x.lo <= y.hi) & (y.lo <= x.hi))


def predicates(f: Callable[..., jax.Array]) -> Rule:
    """Lift an increasing operation on predicates."""

    def rule(*xs, **_):
        _need_predicates(xs)
        return Interval(f(*(x.lo for x in xs)), f(*(x.hi for x in xs)))

    return rule


def _need_predicates(xs: Sequence[Interval]) -> None:
    if any(x.dtype != jnp.bool_ for x in xs):
        raise NotImplementedError(
            "inclusion cannot follow the bits of an integer that depends on an interval"
        )


def negated(x: Interval, **_: object) -> Interval:
    """Return not x."""
    _need_predicates([x])
    return Interval(~x.hi, ~x.lo)
