"""Numbers of a program that may be NaN, or infinite at a pole: undefined in mathematics, but a program can
make numbers of it.

A primitive makes one where it is not `primitives.DEFINED`, outside its domain or at a pole, and out of
infinities. `OBSERVED` says what becomes of an enclosure where an operand may be one: a predicate is
undecided, an integer anything.

They pass from operands to results. A mark is of a whole array: True where any of its numbers may be one,
`None` where none is. A number that overflows in floats is one that its enclosure does not bound, so unbounded
operands count as infinite. -0 counts as 0.
"""

import functools
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
from jax.extend.core import JaxprEqn, Literal

from jaxbound.sets.inclusion.predicates import least, most, whole
from jaxbound.sets.inclusion.primitives import DEFINED
from jaxbound.sets.intervals.interval import Interval, hull, mag

Mark: TypeAlias = jax.Array | None
"""() bool."""


def observes(eqn: JaxprEqn) -> bool:
    """Return whether a primitive may turn a NaN operand into a number, a predicate or an integer."""
    name, params = eqn.primitive.name, eqn.params
    if name == "integer_pow":
        return params["y"] == 0
    if name == "convert_element_type":
        return not jnp.issubdtype(params["new_dtype"], jnp.floating)
    if name == "pow" and isinstance(eqn.invars[1], Literal):
        return eqn.invars[1].val == 0
    return name in OBSERVED or name == "sort"


def either(*marks: Mark) -> Mark:
    """Return whether any mark is set; None if none is given."""
    given = [m for m in marks if m is not None]
    return functools.reduce(operator.or_, given) if given else None


def possible(
    name: str, out: Interval, sets: Sequence[Interval], absent: Sequence[Mark], about: Mapping[str, Any]
) -> Mark:
    """Return the mark of the result `out` of a primitive, from its operands and their marks."""
    if name == "select_n":
        first, last = (end.astype(jnp.int32) for end in (sets[0].lo, sets[0].hi))
        meets = [jnp.any((first <= k) & (k <= last)) for k in range(len(absent) - 1)]
        return either(*(m & a for m, a in zip(meets, absent[1:], strict=True) if a is not None))
    outside = ~jnp.all(DEFINED[name](out, *sets, **about)) if name in DEFINED else None
    return either(*absent, outside, _out_of_infinities(name, out, sets))


INFINITE = frozenset(
    "add add_any sub mul div rem sin cos tan reduce_sum cumsum dot_general scatter-add".split()
)
"""Primitives that may make NaN of infinite numbers or partial sums: inf - inf, 0 inf, inf / inf, sin inf."""


def _out_of_infinities(name: str, out: Interval, sets: Sequence[Interval]) -> Mark:
    """Return the mark of NaN that a primitive makes of infinite numbers."""
    if name in ("reduce_prod", "cumprod"):  # a partial product may be infinite before a factor 0 comes
        return jnp.prod(jnp.maximum(mag(sets[0]), 1)) == jnp.inf
    if name not in INFINITE:
        return None
    intervals = [x for x in (out, *sets) if isinstance(x, Interval)]
    return either(*(~jnp.all(jnp.isfinite(x.lo) & jnp.isfinite(x.hi)) for x in intervals))


def _anywhere(absent: Sequence[Mark]) -> jax.Array:
    """Return the mark of any operand, of which at least one has one."""
    found = either(*absent)
    assert found is not None
    return found


def _undecided(out: Interval, sets: Sequence[Interval], absent: Sequence[Mark], **_: object) -> Interval:
    return Interval(out.lo & ~_anywhere(absent), out.hi | _anywhere(absent))


def _converted(out: Interval, sets: Sequence[Interval], absent: Sequence[Mark], **_: object) -> Interval:
    """Leave a float; a predicate may be True, an integer anything."""
    if not whole(out):
        return out
    lost = _anywhere(absent)
    return Interval(
        jnp.where(lost, out.lo if out.dtype == bool else least(out.dtype), out.lo),
        jnp.where(lost, most(out.dtype), out.hi),
    )


def _power(out: Interval, sets: Sequence[Interval], absent: Sequence[Mark], **_: object) -> Interval:
    """Add 1, which is NaN^0 and 1^NaN."""
    one = hull(out, Interval(jnp.ones_like(out.lo), jnp.ones_like(out.hi)))
    return jax.tree.map(lambda a, b: jnp.where(_anywhere(absent), a, b), one, out)


def _clamped(out: Interval, sets: Sequence[Interval], absent: Sequence[Mark], **_: object) -> Interval:
    """Join all operands: clamp gives a bound for NaN, on some devices."""
    every = functools.reduce(hull, sets)
    return jax.tree.map(lambda a, b: jnp.where(_anywhere(absent), a, b), every, out)


OBSERVED: dict[str, Callable[..., Interval]] = {
    name: _undecided for name in ("lt", "gt", "le", "ge", "eq", "ne", "is_finite", "lt_to", "le_to")
}
OBSERVED |= {"convert_element_type": _converted, "pow": _power, "integer_pow": _power, "clamp": _clamped}
