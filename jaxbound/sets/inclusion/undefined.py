"""Numbers of a program that may be NaN, or infinite at a pole: undefined in mathematics, but a program can
make numbers of it.

| table | what it says |
|---|---|
| MADE | a condition on the operands under which a primitive may make one, by its domain, a pole, or out of
infinities (0 inf, inf - inf) | | OBSERVED | what becomes of an enclosure where an operand may be one: a
predicate is undecided, an integer anything |

They pass from operands to results, in a reduction from any of its terms. A number that overflows in floats is
one that its enclosure does not bound, so unbounded operands count as infinite. -0 counts as 0. `None`:
nowhere.
"""

import functools
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias, overload

import jax
import jax.numpy as jnp
from jax.extend.core import JaxprEqn, Literal

from jaxbound.sets.inclusion.lifted import integral, meets_zero
from jaxbound.sets.inclusion.predicates import least, most, whole
from jaxbound.sets.intervals.interval import Interval, hull, mag

__all__ = ["MADE", "OBSERVED", "either", "observes", "possible"]


Mark: TypeAlias = jax.Array | None


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


@overload
def either(*marks: jax.Array) -> jax.Array: ...
@overload
def either(*marks: Mark) -> Mark: ...
def either(*marks: Mark) -> Mark:
    """Return the union of the masks; None if none is given."""
    given = [m for m in marks if m is not None]
    return functools.reduce(operator.or_, given) if given else None


def possible(
    name: str, out: Interval, sets: Sequence[Interval], absent: Sequence[Mark], about: Mapping[str, Any]
) -> Mark:
    """Return a mask of possible NaN in the result `out` of a primitive, from its operands and their masks."""
    made = MADE[name](out, *sets, **about) if name in MADE else None
    if name == "select_n":
        return _chosen(sets[0], absent[1:], out.shape)
    given = [jnp.broadcast_to(a, s.shape) for a, s in zip(absent, sets, strict=True) if a is not None]
    passed = [_passed(name, a, out.shape, about) for a in given]
    found = either(*passed, made)
    return None if found is None else jnp.broadcast_to(found, out.shape)


def _passed(name: str, mark: jax.Array, shape: tuple[int, ...], about: Mapping[str, Any]) -> jax.Array:
    """Return a mask of the results that NaN among the operands reaches."""
    if name == "sort":
        return jnp.broadcast_to(
            jnp.any(mark, about["dimension"], keepdims=True), shape
        )  # NaN comes last, infinity at either end
    if name.startswith("reduce_"):
        return jnp.any(mark, about["axes"])
    if name.startswith("cum"):
        return jax.lax.cummax(mark.astype(jnp.int8), about["axis"], about["reverse"]) > 0
    if name in ("dot_general", "scatter-add"):  # entries meet others, whatever the shapes
        return jnp.any(mark)
    return mark if mark.shape == shape or not mark.shape else jnp.any(mark)


def _chosen(which: Interval, marks: Sequence[Mark], shape: tuple[int, ...]) -> Mark:
    if all(m is None for m in marks):
        return None
    first, last = (end.astype(jnp.int32) for end in (which.lo, which.hi))
    parts = [(first <= k) & (k <= last) & m for k, m in enumerate(marks) if m is not None]
    return jnp.broadcast_to(either(*parts), shape)


def _unbounded(*xs: Interval) -> jax.Array:
    return either(*((x.lo == -jnp.inf) | (x.hi == jnp.inf) for x in xs))


def _sum(out: Interval, x: Interval, y: Interval, **_: object) -> jax.Array:
    return (x.hi == jnp.inf) & (y.lo == -jnp.inf) | (x.lo == -jnp.inf) & (y.hi == jnp.inf)


def _difference(out: Interval, x: Interval, y: Interval, **_: object) -> jax.Array:
    return (x.hi == jnp.inf) & (y.hi == jnp.inf) | (x.lo == -jnp.inf) & (y.lo == -jnp.inf)


def _product(out: Interval, x: Interval, y: Interval, **_: object) -> jax.Array:
    return meets_zero(x) & _unbounded(y) | meets_zero(y) & _unbounded(x)


def _unbounded_anywhere(out: Interval, *xs: Interval, **_: object) -> jax.Array:
    return _unbounded(out) | jnp.any(
        jnp.stack([jnp.any(_unbounded(x)) for x in xs if isinstance(x, Interval)])
    )


def _large(out: Interval, x: Interval, **_: object) -> jax.Array:
    """Return whether a partial product of the factors may be infinite before a factor 0 comes."""
    return jnp.prod(jnp.maximum(mag(x), 1)) == jnp.inf


MADE: dict[str, Callable[..., jax.Array]] = {
    "sqrt": lambda out, x, **_: x.lo < 0,
    "rsqrt": lambda out, x, **_: x.lo <= 0,
    "log": lambda out, x, **_: x.lo <= 0,
    "log1p": lambda out, x, **_: x.lo <= -1,
    "asin": lambda out, x, **_: (x.lo < -1) | (x.hi > 1),
    "acos": lambda out, x, **_: (x.lo < -1) | (x.hi > 1),
    "acosh": lambda out, x, **_: x.lo < 1,
    "atanh": lambda out, x, **_: (x.lo <= -1) | (x.hi >= 1),
    "sin": lambda out, x, **_: _unbounded(x),
    "cos": lambda out, x, **_: _unbounded(x),
    "tan": lambda out, x, **_: _unbounded(x),
    "add": _sum,
    "add_any": _sum,
    "sub": _difference,
    "mul": _product,
    "div": lambda out, x, y, **_: meets_zero(y) | _unbounded(x) & _unbounded(y),
    "rem": lambda out, x, y, **_: meets_zero(y) | _unbounded(x),
    "pow": lambda out, x, y, numbers, **_: meets_zero(x) if integral(numbers[1]) or whole(y) else x.lo <= 0,
    "integer_pow": lambda out, x, y, **_: meets_zero(x) & (y < 0),
    "reduce_sum": _unbounded_anywhere,
    "cumsum": _unbounded_anywhere,
    "dot_general": _unbounded_anywhere,
    "scatter-add": _unbounded_anywhere,
    "reduce_prod": _large,
    "cumprod": _large,
}


def _anywhere(absent: Sequence[Mark]) -> jax.Array:
    """Return the union of the masks of all operands, of which there is at least one."""
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
