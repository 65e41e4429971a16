"""Primitives of JAX lifted from numbers to sets of numbers; those of integers and predicates are in
`predicates`.

Operations that `interval` and `elementary` offer as they are do not appear here.
"""

import math
from collections.abc import Callable, Sequence
from typing import TypeAlias, TypeGuard

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike

from jaxbound.sets.floats import rounding
from jaxbound.sets.inclusion.predicates import Rule, equals, extreme, least, most, negated, whole
from jaxbound.sets.intervals.elementary import atan2, atanh, exp, kept_sign, log, sqrt, tanh
from jaxbound.sets.intervals.interval import (
    Interval,
    add,
    computed,
    div,
    empty_where,
    hull,
    intersection,
    mag,
    mul,
    neg,
    pown,
    recip,
    sqr,
    sub,
)
from jaxbound.sets.intervals.interval import sum as total

Known: TypeAlias = Sequence[bool]
Numbers: TypeAlias = Sequence[float | None]


def enclose(x: Interval | ArrayLike) -> Interval:
    """Return an Interval that is `x` or the number x, finite and not subnormal."""
    return x if isinstance(x, Interval) else computed(jnp.asarray(x), jnp.asarray(x))


def settled(x: jax.Array) -> Interval:
    """Return an Interval that holds any float `x`: NaN becomes the empty set, infinity all numbers too large
    for a float.
    """
    lo, hi = rounding.settle_subnormals(x, x)
    absent, top = jnp.isnan(x), np.finfo(x.dtype).max
    lo, hi = jnp.where(x == jnp.inf, top, lo), jnp.where(x == -jnp.inf, -top, hi)
    return computed(jnp.where(absent, jnp.inf, lo), jnp.where(absent, -jnp.inf, hi))


def added(x: Interval, y: Interval, **_: object) -> Interval:
    """Return the sum; 2 min(lo) and 2 max(hi) keep its sign, and 0 + 0 exact, which proves monotonicity."""
    out = add(x, y)
    return Interval(
        jnp.maximum(out.lo, _twice(jnp.minimum(x.lo, y.lo), -1)),
        jnp.minimum(out.hi, _twice(jnp.maximum(x.hi, y.hi), 1)),
    )


def _twice(bound: jax.Array, side: int) -> jax.Array:
    """Double a bound; an overflow towards the other side stays finite."""
    top = np.finfo(bound.dtype).max
    return jnp.minimum(2 * bound, top) if side < 0 else jnp.maximum(2 * bound, -top)


def subtracted(x: Interval, y: Interval, same: bool = False, **_: object) -> Interval:
    """Return the difference; x - x is 0."""
    return scaled(x, 0.0) if same else added(x, neg(y))


def multiplied(
    x: Interval,
    y: Interval,
    same: bool = False,
    known: Known = (False, False),
    numbers: Numbers = (None, None),
    **_: object,
) -> Interval:
    """Return the product; x * x is a square, and a factor that is a number needs two products instead of
    four.
    """
    if same:
        return sqr(x)
    if known[0]:
        return scaled(y, x.lo if numbers[0] is None else numbers[0])
    return scaled(x, y.lo if numbers[1] is None else numbers[1]) if known[1] else mul(x, y)


def divided(
    x: Interval, y: Interval, known: Known = (False, False), numbers: Numbers = (None, None), **_: object
) -> Interval:
    """Return the quotient; a divisor that is one number of ordinary size needs two quotients instead of
    four.
    """
    c = numbers[1]
    if not known[1] or c is None or not 2.0**-60 < abs(c) < 2.0**60:
        out, pole = div(x, y), (y.lo == 0) & (y.hi == 0) & ~x.is_empty  # of which a program may make a number
        return Interval(jnp.where(pole, -jnp.inf, out.lo), jnp.where(pole, jnp.inf, out.hi))
    if math.frexp(c)[0] in (0.5, -0.5):
        return scaled(x, 1 / c)
    lo, hi = jax.lax.optimization_barrier(
        (x.lo, x.hi) if c > 0 else (-x.hi, -x.lo)
    )  # else merged with a quotient that made x
    return kept_sign(Interval(lo, hi), *rounding.outward(lo / abs(c), hi / abs(c)))


def scaled(x: Interval, factor: float | jax.Array) -> Interval:
    """Return x times numbers; 0, 1 and -1 are exact, because derivatives are full of them."""
    if isinstance(factor, float):
        if factor == 0:
            return empty_where(x.is_empty, jnp.zeros_like(x.lo), jnp.zeros_like(x.hi))
        turned = x if factor > 0 else neg(x)
        return turned if abs(factor) == 1 else _scaled_up(turned, abs(factor))
    positive = factor > 0
    turned = Interval(jnp.where(positive, x.lo, -x.hi), jnp.where(positive, x.hi, -x.lo))
    size = jnp.abs(factor)
    out = _scaled_up(turned, size)
    one, none = size == 1, (size == 0) & ~x.is_empty
    return Interval(
        jnp.where(none, 0, jnp.where(one, turned.lo, out.lo)),
        jnp.where(none, 0, jnp.where(one, turned.hi, out.hi)),
    )


def _scaled_up(x: Interval, size: float | jax.Array) -> Interval:
    return kept_sign(x, *rounding.outward(x.lo * size, x.hi * size))


def summed_along(x: Interval, axes: Sequence[int], **_: object) -> Interval:
    """Add along axes; nonnegative terms keep a nonnegative sum."""
    if not axes:
        return x
    kept = [i for i in range(len(x.shape)) if i not in axes]
    last = lambda v: v.transpose(*kept, *axes).reshape([v.shape[i] for i in kept] + [-1])
    terms = Interval(last(x.lo), last(x.hi))
    out, count = total(terms, axis=-1), terms.shape[-1]
    if not count:
        return Interval(jnp.zeros_like(out.lo), jnp.zeros_like(out.hi))
    # the least of many numbers may overlook NaN, a bound that is not known
    known = [~jnp.any(jnp.isnan(x), -1) for x in (terms.lo, terms.hi)]
    positive, negative = known[0] & (jnp.min(terms.lo, -1) >= 0), known[1] & (jnp.max(terms.hi, -1) <= 0)
    return Interval(
        jnp.where(positive, jnp.maximum(out.lo, 0), out.lo),
        jnp.where(negative, jnp.minimum(out.hi, 0), out.hi),
    )


def product(x: Interval, axes: Sequence[int], **_: object) -> Interval:
    """Multiply along axes, half by half."""
    for axis in sorted(axes, reverse=True):
        while (count := x.shape[axis]) > 1:
            part = lambda a, b, x=x, axis=axis: jax.tree.map(
                lambda v: jax.lax.slice_in_dim(v, a, b, axis=axis), x
            )
            halves = mul(part(0, count // 2), part(count // 2, count // 2 * 2))
            join = lambda a, b, axis=axis: jax.tree.map(lambda *v: jnp.concatenate(v, axis), a, b)
            x = join(halves, part(count - 1, count)) if count % 2 else halves
        x = jax.tree.map(lambda v, axis=axis: jnp.prod(v, axis), x)  # of one factor, or of none: 1
    return x


def scanned(combine: Callable[[Interval, Interval], Interval]) -> Rule:
    """Return the partial results of an operation along an axis."""

    def rule(x, axis, reverse, **_):
        return jax.lax.associative_scan(combine, x, reverse=reverse, axis=axis)

    return rule


def contracted(
    x: Interval,
    y: Interval,
    dimension_numbers: tuple[tuple[Sequence[int], Sequence[int]], tuple[Sequence[int], Sequence[int]]],
    known: Known = (False, False),
    **_: object,
) -> Interval:
    """Multiply and add over the contracted axes, entry by entry."""
    (cx, cy), (bx, by) = dimension_numbers
    fx, fy = ([i for i in range(len(v.shape)) if i not in (*c, *b)] for v, c, b in ((x, cx, bx), (y, cy, by)))
    sizes = lambda v, axes: tuple(v.shape[i] for i in axes)
    B, M, N, K = (math.prod(s) for s in (sizes(x, bx), sizes(x, fx), sizes(y, fy), sizes(x, cx)))
    left = jax.tree.map(lambda v: v.transpose(*bx, *fx, *cx).reshape(B, M, 1, K), x)
    right = jax.tree.map(lambda v: v.transpose(*by, *fy, *cy).reshape(B, 1, N, K), y)
    left, right = (computed(v.lo, v.hi) for v in (left, right))  # moved, and settled as before
    out = summed_along(multiplied(left, right, known=known), axes=(3,))
    return jax.tree.map(lambda v: v.reshape(*sizes(x, bx), *sizes(x, fx), *sizes(y, fy)), out)


def scattered(
    x: Interval,
    indices: jax.Array,
    updates: Interval,
    bind: Callable[..., jax.Array],
    dimension_numbers: jax.lax.ScatterDimensionNumbers,
    **_: object,
) -> Interval:
    """Add every update on its own, so that one sum of known length bounds all of them."""
    count = math.prod(indices.shape[:-1])
    window = dimension_numbers.update_window_dims
    number = jnp.arange(count).reshape([1 if i in window else size for i, size in enumerate(updates.shape)])

    def terms(origin, updates):
        alone = lambda k: bind(jnp.zeros_like(origin), indices, jnp.where(number == k, updates, 0))
        return jnp.concatenate([origin[None], jax.vmap(alone)(jnp.arange(count))])

    return summed_along(Interval(terms(x.lo, updates.lo), terms(x.hi, updates.hi)), axes=(0,))


def selected(which: Interval, *cases: Interval, **_: object) -> Interval:
    """Return the hull of the cases that are possible."""
    top, bottom = most(cases[0].dtype), least(cases[0].dtype)
    first, last = (end.astype(jnp.int32) for end in (which.lo, which.hi))
    possible = [(first <= k) & (k <= last) for k in range(len(cases))]
    lo = [jnp.where(p, case.lo, top) for p, case in zip(possible, cases, strict=True)]
    hi = [jnp.where(p, case.hi, bottom) for p, case in zip(possible, cases, strict=True)]
    return Interval(extreme(jnp.minimum, lo), extreme(jnp.maximum, hi))


def converted(x: Interval, new_dtype: DTypeLike, **_: object) -> Interval:
    """Change the type and not the number; a float cut to an integer rounds towards 0, and a predicate says
    whether it is not 0.
    """
    new = jnp.dtype(new_dtype)
    if new == jnp.bool_:
        return negated(enclose(equals(x, enclose(jnp.zeros_like(x.lo)))))
    lo, hi = x.lo.astype(new), x.hi.astype(new)
    if jnp.issubdtype(new, jnp.floating):
        if x.dtype == jnp.bool_ or not whole(x) and new.itemsize >= x.dtype.itemsize:
            return Interval(lo, hi)
        below, above = rounding.outward(lo, hi)
        limit = 2.0 ** (jnp.finfo(new).nmant + 1)  # integers up to here are floats
        exact = (jnp.abs(lo) < limit) & (jnp.abs(hi) < limit) if whole(x) else x.is_empty
        return Interval(jnp.where(exact, lo, below), jnp.where(exact, hi, above))
    if x.dtype == jnp.bool_:
        return Interval(lo, hi)
    fits = (x.lo.astype(float) >= 0.99 * least(new)) & (x.hi.astype(float) <= 0.99 * most(new))
    return Interval(jnp.where(fits, lo, least(new)), jnp.where(fits, hi, most(new)))


def _near_zero(x: Interval, out: Interval, near: Callable[[Interval], Interval], limit: float) -> Interval:
    """Replace the ends of an increasing function within [-limit, limit] by those of a formula that keeps its
    digits there.
    """
    low, high = (jnp.clip(v, -limit, limit) for v in (x.lo, x.hi))
    lo, hi = near(Interval(low, low)).lo, near(Interval(high, high)).hi
    return Interval(jnp.where(low == x.lo, lo, out.lo), jnp.where(high == x.hi, hi, out.hi))


def expm1(x: Interval, **_: object) -> Interval:
    """Return e^x - 1, near 0 by 2 t / (1 - t), t = tanh(x / 2)."""

    def near(v):
        t = tanh(scaled(v, 0.5))
        return div(scaled(t, 2.0), sub(1.0, t))

    return _near_zero(x, sub(exp(x), 1.0), near, 1.0)


def log1p(x: Interval, **_: object) -> Interval:
    """Return log(1 + x), near 0 by 2 atanh(x / (2 + x))."""
    return _near_zero(x, log(add(x, 1.0)), lambda v: scaled(atanh(div(v, add(v, 2.0))), 2.0), 0.5)


def logistic(x: Interval, **_: object) -> Interval:
    """Return 1 / (1 + e^-x)."""
    return recip(add(exp(neg(x)), 1.0))


def cube_root(x: Interval, **_: object) -> Interval:
    """Return the cube root, by exp(log|x| / 3)."""
    return _signed_power(x, lambda v: exp(div(log(v), 3.0)), odd=True, at_zero=True)


def power(x: Interval, y: Interval, numbers: Numbers = (None, None), **_: object) -> Interval:
    """Return x^y: the real power of x >= 0, or of any x for an integer exponent."""
    exponent = numbers[1]
    if exponent == 0.5:
        return sqrt(x)
    if integral(exponent):
        return pown(x, int(exponent))
    if whole(y):
        n = Interval(y.lo.astype(x.dtype), y.hi.astype(x.dtype))
        power = lambda v: exp(mul(n, log(v)))
        even, odd = (_signed_power(x, power, odd, n.hi > 0) for odd in (False, True))
        either = _with(hull(even, odd), 1, meets_zero(n))
        known, parity = n.lo == n.hi, jnp.abs(n.lo) % 2 == 1
        pick = lambda e, o, b: jnp.where(known, jnp.where(n.lo == 0, 1, jnp.where(parity, o, e)), b)
        return Interval(pick(even.lo, odd.lo, either.lo), pick(even.hi, odd.hi, either.hi))
    out = _signed_power(_cut(x, 0, jnp.inf), lambda v: exp(mul(y, log(v))), False, y.hi > 0)
    left = exp(
        mul(y, log(_cut(neg(x), 0, jnp.inf)))
    )  # of a negative number where y is an integer, even or odd
    some = (jnp.ceil(y.lo) <= jnp.floor(y.hi)) & ~left.is_empty
    out = Interval(
        jnp.where(some, jnp.minimum(out.lo, -left.hi), out.lo),
        jnp.where(some, jnp.maximum(out.hi, left.hi), out.hi),
    )
    return _with(out, 1, meets_zero(x) & meets_zero(y))  # 0^0


def angle(y: Interval, x: Interval, **_: object) -> Interval:
    """Return atan2, 0 at the origin."""
    return _with(atan2(y, x), 0, meets_zero(y) & meets_zero(x))


def _with(x: Interval, number: float, present: jax.Array) -> Interval:
    """Add a number where it is present."""
    return Interval(
        jnp.where(present, jnp.minimum(x.lo, number), x.lo),
        jnp.where(present, jnp.maximum(x.hi, number), x.hi),
    )


def meets_zero(x: Interval) -> jax.Array:
    """Return (...) bool: whether 0 is in x."""
    return (x.lo <= 0) & (x.hi >= 0)


def poles(f: Callable[..., Interval], *places: tuple[float, float]) -> Rule:
    """Lift a function that is infinite at its poles, where it would be empty."""

    def rule(x, **_):
        out, top = f(x), np.finfo(x.dtype).max
        for place, sign in places:
            out = _with(
                _with(out, sign * np.inf, here := (x.lo <= place) & (x.hi >= place)), sign * top, here
            )
        return out

    return rule


def integral(exponent: float | None) -> TypeGuard[float]:
    """True for a known exponent that is an integer."""
    return exponent is not None and float(exponent).is_integer() and abs(exponent) <= 2**31


def _cut(x: Interval, lo: float, hi: float) -> Interval:
    return intersection(x, Interval(jnp.full_like(x.lo, lo), jnp.full_like(x.hi, hi)))


def _signed_power(
    x: Interval, power: Callable[[Interval], Interval], odd: bool, at_zero: bool | jax.Array
) -> Interval:
    """Join the powers of the positive and of the negative numbers of x; `at_zero` says where 0 has the power
    0 (log 0 has no value).
    """

    def half(v):
        out = power(v)
        zero = at_zero & (v.lo == 0) & (v.hi >= 0)
        return Interval(jnp.where(zero, 0, out.lo), jnp.where(zero, jnp.maximum(out.hi, 0), out.hi))

    right, left = half(_cut(x, 0, jnp.inf)), half(_cut(neg(x), 0, jnp.inf))
    return hull(right, neg(left) if odd else left)


def remainder(x: Interval, y: Interval, **_: object) -> Interval:
    """Return x - y trunc(x / y), which has the sign of x and is smaller than y."""
    turns = div(x, y)
    low, high = jnp.trunc(turns.lo), jnp.trunc(turns.hi)
    size = jnp.minimum(mag(x), mag(y))
    lo, hi = jnp.where(x.lo < 0, -size, 0), jnp.where(x.hi > 0, size, 0)
    one = (low == high) & jnp.isfinite(low)
    turn = jnp.where(one, low, 0)
    straight = sub(x, mul(y, Interval(turn, turn)))
    lo, hi = (
        jnp.where(one, jnp.maximum(lo, straight.lo), lo),
        jnp.where(one, jnp.minimum(hi, straight.hi), hi),
    )
    return Interval(jnp.where(turns.is_empty, jnp.inf, lo), jnp.where(turns.is_empty, -jnp.inf, hi))


def of(f: Callable[..., Interval]) -> Rule:
    """Lift a function of Intervals: the parameters of the primitive carry no mathematics."""
    return lambda *xs, **_: f(*xs)
