"""jnp.interp over Intervals: a table whose knots are numbers, its values numbers or Intervals.

JAX writes jnp.interp as a search for the segment, which nobody can follow over a set of arguments. So it is
known again, by what a call of it traces to, and becomes one primitive; its derivative is another one.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, cast

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jax.extend.core import JaxprEqn, Primitive

from jaxbound.sets.floats.equations import body
from jaxbound.sets.intervals.interval import Interval, add, div, hull, intersection, mul, or_empty, sub

INTERP, SLOPE = "interp", "interp_slope"
NAMES = ("_interp", "interp")
"""What jnp.interp is called where it is compiled."""
KNOTS = (
    "inclusion has no rule for jnp.interp whose knots depend on an interval: its argument may, and its values"
)

interp_p, slope_p = Primitive(INTERP), Primitive(SLOPE)
for primitive in (interp_p, slope_p):
    primitive.def_abstract_eval(lambda x, xp, fp: x.update(weak_type=False))


def is_interp(eqn: JaxprEqn) -> bool:
    """Return whether an equation is a call of jnp.interp(x, xp, fp), and does nothing else."""
    inner = body(eqn)
    if inner is None or eqn.params.get("name") not in NAMES or len(eqn.invars) != 3 or inner.consts:
        return False
    shapes: list[jax.ShapeDtypeStruct] = []
    for v in eqn.invars:
        aval: Any = v.aval
        shapes.append(jax.ShapeDtypeStruct(aval.shape, aval.dtype, weak_type=aval.weak_type))
    is_table = len({shape.dtype for shape in shapes}) == 1 and shapes[1].size > 1
    return is_table and str(inner.jaxpr) == _traced(*shapes)


@functools.lru_cache(64)
def _traced(*shapes: jax.ShapeDtypeStruct) -> str:
    """Return the text of what jnp.interp traces to for arguments of these shapes; "" if it takes none."""
    try:
        (call,) = jax.make_jaxpr(jnp.interp)(*shapes).jaxpr.eqns
    except (ValueError, TypeError):
        return ""
    inner = body(call)
    assert inner is not None, "it is a call"
    return str(inner.jaxpr)


@functools.partial(jax.custom_jvp)
def interpolated(x: jax.Array, xp: jax.Array, fp: jax.Array) -> jax.Array:
    """Return jnp.interp(x, xp, fp) as one primitive."""
    return cast(jax.Array, interp_p.bind(x, xp, fp))


def _tangent(primals: Sequence[jax.Array], tangents: Sequence[Any]) -> tuple[Any, Any]:
    x, xp, fp = primals
    dx, *others = tangents
    if not all(isinstance(other, SymbolicZero) for other in others):
        raise NotImplementedError(
            "inclusion has no rule for the derivative of jnp.interp by its table: method='natural' needs no "
            "derivative"
        )
    slope = slope_p.bind(x, xp, fp)
    if isinstance(dx, SymbolicZero):
        return interp_p.bind(x, xp, fp), jnp.zeros_like(slope)
    return interp_p.bind(x, xp, fp), slope * dx


interpolated.defjvp(_tangent, symbolic_zeros=True)


def _sorted(xp: jax.Array) -> jax.Array:
    """Return whether the knots of a table ascend; one that stands twice does not count."""
    return jnp.all(xp[1:] > xp[:-1])


def ascending(out: Interval, x: Interval, xp: Interval, fp: Interval, **_: object) -> jax.Array:
    """Return whether a table is a continuous function."""
    return _sorted(xp.lo)


def _numbers(xp: Interval, known: Sequence[bool]) -> jax.Array:
    """Return the knots, which must be numbers."""
    if not known[1]:
        raise NotImplementedError(KNOTS)
    return xp.lo


def interp(x: Interval, xp: Interval, fp: Interval, known: Sequence[bool], **_: object) -> Interval:
    """Return the range of a table: the hull of its lines over what x has of each segment.

    Where knots do not ascend nothing is known.
    """
    knots = _numbers(xp, known)
    first, last, before, behind = _segments(knots, fp)
    inside = Interval(*(jnp.clip(end[..., None], first.lo, last.lo) for end in (x.lo, x.hi)))
    share = div(sub(inside, first), sub(last, first))
    line = add(before, mul(share, sub(behind, before)))
    return _hull(x, knots, intersection(line, hull(before, behind)), fp)


def slopes(x: Interval, xp: Interval, fp: Interval, known: Sequence[bool], **_: object) -> Interval:
    """Return the slopes of a table over x: of all its segments that x meets, and 0 outside of it."""
    knots = _numbers(xp, known)
    first, last, before, behind = _segments(knots, fp)
    flat = jnp.zeros_like(knots)
    return _hull(x, knots, div(sub(behind, before), sub(last, first)), Interval(flat, flat))


def _segments(knots: jax.Array, fp: Interval) -> tuple[Interval, Interval, Interval, Interval]:
    """Return (first knots, last knots, values at the first, at the last) of the segments, (k - 1,) each."""
    points = Interval(knots, knots)
    return points[:-1], points[1:], fp[:-1], fp[1:]


def _hull(x: Interval, knots: jax.Array, parts: Interval, outside: Interval) -> Interval:
    """Return the hull of the parts of a table that x meets.

    Args:
        parts: (..., k - 1), one for each segment. outside: (k,) its ends are the parts beyond the first and
            the last knot.
    """
    edge = jnp.full_like(knots[:1], jnp.inf)
    first, last = jnp.concatenate([-edge, knots]), jnp.concatenate([knots, edge])
    meets = (x.lo[..., None] <= last) & (x.hi[..., None] >= first)
    shape = (*x.shape, 1)
    lo, hi = (
        jnp.concatenate([jnp.broadcast_to(end[:1], shape), part, jnp.broadcast_to(end[-1:], shape)], -1)
        for part, end in (
            (jnp.broadcast_to(parts.lo, (*x.shape, len(knots) - 1)), outside.lo),
            (jnp.broadcast_to(parts.hi, (*x.shape, len(knots) - 1)), outside.hi),
        )
    )
    fine = _sorted(knots)
    low = jnp.where(fine, jnp.min(jnp.where(meets, lo, jnp.inf), -1), -jnp.inf)
    high = jnp.where(fine, jnp.max(jnp.where(meets, hi, -jnp.inf), -1), jnp.inf)
    return or_empty(low, high, x)


RULES: dict[str, Callable[..., Interval]] = {INTERP: interp, SLOPE: slopes}
