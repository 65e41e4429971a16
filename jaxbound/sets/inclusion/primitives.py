"""Set versions of the primitives of JAX: tables of functions of Intervals, and where each one is continuous.

| table | primitives | evaluated as |
|---|---|---|
| MOVED | reshape, gather, concatenate, ... | once on the lower and once on the upper bounds, exactly |
| RISING | max, floor, sort, ... | the same: increasing in every operand, exactly |
| RULES | add, exp, dot_general, ... | outward-rounded operations of `interval` and `elementary` |
| WHOLE | add, and, lt, ... | the same for integers and predicates that depend on an interval |
| DEFINED | sqrt, div, ... | a condition on the operands under which the primitive is; others always are |
| STEADY | floor, select_n, ... | a condition under which it has no jump |
"""

import operator
from collections.abc import Callable

import jax
import jax.numpy as jnp

from jaxbound.sets.inclusion import lifted, tables
from jaxbound.sets.inclusion.lifted import enclose, integral, of, poles
from jaxbound.sets.inclusion.predicates import Rule, comparison, equals, integers, negated, predicates, whole
from jaxbound.sets.intervals import elementary, errorfunctions
from jaxbound.sets.intervals.interval import Interval, div, mul, neg, pown, recip, sqr
from jaxbound.sets.intervals.interval import abs as absolute

MOVED: dict[str, tuple[int, ...] | None] = {  # the operands that are moved; all others are indices
    "broadcast_in_dim": (0,),
    "reshape": (0,),
    "transpose": (0,),
    "squeeze": (0,),
    "expand_dims": (0,),
    "slice": (0,),
    "rev": (0,),
    "split": (0,),
    "tile": (0,),
    "copy": (0,),
    "copy_p": (0,),
    "stop_gradient": (0,),
    "dynamic_slice": (0,),
    "gather": (0,),
    "pad": (0, 1),
    "dynamic_update_slice": (0, 1),
    "scatter": (0, 2),
    "concatenate": None,
    "stack": None,
    "optimization_barrier": None,
    "unstack": (0,),
}
RISING = {
    "max",
    "min",
    "floor",
    "ceil",
    "round",
    "sign",
    "clamp",
    "sort",
    "reduce_max",
    "reduce_min",
    "reduce_and",
    "reduce_or",
    "cummax",
    "cummin",
}


COMPARISONS: dict[str, Rule] = {
    "lt": comparison(operator.lt, False),
    "gt": comparison(operator.lt, True),
    "le": comparison(operator.le, False),
    "ge": comparison(operator.le, True),
    "lt_to": comparison(operator.lt, False),
    "le_to": comparison(operator.le, False),
    "eq": equals,
    "ne": lambda x, y, **about: negated(enclose(equals(x, y, **about))),
    "select_n": lifted.selected,
    "convert_element_type": lifted.converted,
}

RULES: dict[str, Rule] = COMPARISONS | {
    "add": lifted.added,
    "add_any": lifted.added,
    "sub": lifted.subtracted,
    "mul": lifted.multiplied,
    "neg": of(neg),
    "div": lifted.divided,
    "rem": lifted.remainder,
    "abs": of(absolute),
    "square": of(sqr),
    "integer_pow": lambda x, y, **_: pown(x, y),
    "pow": lifted.power,
    "cbrt": lifted.cube_root,
    "rsqrt": lambda x, **_: recip(elementary.sqrt(x)),
    "expm1": lifted.expm1,
    "log1p": lifted.log1p,
    "logistic": lifted.logistic,
    "reduce_sum": lifted.summed_along,
    "reduce_prod": lifted.product,
    "cumsum": lifted.scanned(lifted.added),
    "cumprod": lifted.scanned(mul),
    "dot_general": lifted.contracted,
    "scatter-add": lifted.scattered,
    "is_finite": lambda x, **_: Interval(
        jnp.isfinite(x.lo) & jnp.isfinite(x.hi), (x.lo < jnp.inf) & (x.hi > -jnp.inf)
    ),
}
RULES |= {name: of(getattr(elementary, name)) for name in elementary.__all__} | {"atan2": lifted.angle}
RULES |= {"erf": of(errorfunctions.erf), "erfc": of(errorfunctions.erfc)} | tables.RULES
RULES |= {
    "log": poles(elementary.log, (0, -1)),
    "atanh": poles(elementary.atanh, (-1, -1), (1, 1)),
    "log1p": poles(lifted.log1p, (-1, -1)),
}

WHOLE: dict[str, Rule] = COMPARISONS | {
    "add": integers(jnp.add),
    "sub": integers(jnp.subtract),
    "mul": integers(jnp.multiply),
    "neg": integers(jnp.negative),
    "reduce_sum": integers(jnp.sum),
    "and": predicates(jnp.logical_and),
    "or": predicates(jnp.logical_or),
    "not": negated,
    "xor": lambda x, y, **_: negated(enclose(equals(negated(x), negated(y)))),
}

DEFINED: dict[str, Callable[..., jax.Array]] = {
    "sqrt": lambda out, x, **_: x.lo >= 0,
    "rsqrt": lambda out, x, **_: x.lo > 0,
    "log": lambda out, x, **_: x.lo > 0,
    "log1p": lambda out, x, **_: x.lo > -1,
    "div": lambda out, x, y, **_: _nonzero(y),
    "rem": lambda out, x, y, **_: _nonzero(y),
    "integer_pow": lambda out, x, y, **_: _nonzero(x) | (y >= 0),
    "pow": lambda out, x, y, numbers, **_: (
        (x.lo > 0) | (x.lo >= 0) & (y.lo > 0) | integral(numbers[1]) & (_nonzero(x) | (y.lo >= 0))
    ),
    "asin": lambda out, x, **_: (x.lo >= -1) & (x.hi <= 1),
    "acos": lambda out, x, **_: (x.lo >= -1) & (x.hi <= 1),
    "acosh": lambda out, x, **_: x.lo >= 1,
    "atanh": lambda out, x, **_: (x.lo > -1) & (x.hi < 1),
}

STEADY: dict[str, Callable[..., jax.Array]] = {
    "interp": tables.ascending,
    "rem": lambda out, x, y, **_: _constant(jnp.trunc, div(x, y)),
    "tan": lambda out, x, **_: jnp.isfinite(out.lo) & jnp.isfinite(out.hi),
    "atan2": lambda out, y, x, **_: (x.lo > 0) | _nonzero(y),
    "sign": lambda out, x, **_: _is_point(out),
    "floor": lambda out, x, **_: _is_point(out),
    "ceil": lambda out, x, **_: _is_point(out),
    "round": lambda out, x, **_: _is_point(out),
    "select_n": lambda out, which, *cases, **_: _is_point(which),
    "convert_element_type": lambda out, x, **_: _is_point(x) | (not whole(x)) | whole(out),
}


def _is_point(x: Interval) -> jax.Array:
    return x.lo == x.hi


def _nonzero(x: Interval) -> jax.Array:
    return (x.lo > 0) | (x.hi < 0)


def _constant(step: Callable[[jax.Array], jax.Array], x: Interval) -> jax.Array:
    return step(x.lo) == step(x.hi)
