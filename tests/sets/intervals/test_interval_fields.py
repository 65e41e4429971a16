"""An Interval made of its fields, as PyTrees make it, keeps every promise: subnormal bounds, infinite ones,
NaN, mixed precision.
"""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import DTYPES, corners, misses, subnormals
from interval_cases import BINARY, UNARY, each_dtype, ends, ranges

from jaxbound import sets
from jaxbound.sets import Interval, interval

COUNT = 400


def drawn(rng, dtype, count=COUNT):
    """Draw Intervals of any two floats, most of them subnormal, as their fields."""
    values = np.concatenate([subnormals(dtype)] * 3 + [corners(dtype), np.array([-np.inf, np.inf], dtype)])
    a, b = rng.choice(values, (2, count))
    lo, hi = np.minimum(a, b), np.maximum(a, b)
    odd = (lo == hi) & np.isinf(lo)
    return Interval(
        jnp.asarray(np.where(odd, -np.inf, lo).astype(dtype)),
        jnp.asarray(np.where(odd, np.inf, hi).astype(dtype)),
    )


def operations(x, y):
    out = {op: getattr(sets, op)(x, y) for op in BINARY} | {op: getattr(sets, op)(x) for op in UNARY}
    return out | {
        "cube": x**3,
        "hull": sets.hull(x, y),
        "sum": sets.sum(jax.tree.map(lambda *v: jnp.stack(v), x, y)),
    }


EXACT = {**{op: f for op, f in BINARY.items()}, "sum": lambda a, b: a + b}


@each_dtype
@pytest.mark.parametrize(
    "run", [pytest.param(lambda f: f, marks=pytest.mark.long), jax.jit], ids=["eager", "jit"]
)
def test_operations_on_subnormal_fields_enclose_the_exact_results(rng, dtype, run):
    x, y = drawn(rng, dtype), drawn(rng, dtype)
    found = run(operations)(x, y)
    for op, f in EXACT.items():
        assert not misses(found[op].lo, found[op].hi, ranges(f, x, y)), op
    for op, f in {**UNARY, "cube": lambda a: a**3}.items():
        assert not misses(found[op].lo, found[op].hi, ranges(f, x)), op
    assert not misses(
        found["hull"].lo, found["hull"].hi, [[v for v in row if np.isfinite(v)] for row in ends(x, y)]
    )


RELATIONS = {
    "equal": lambda a, b, c, d: (a, b) == (c, d),
    "subset": lambda a, b, c, d: c <= a and b <= d,
    "interior": lambda a, b, c, d: (c < a or c == -np.inf) and (b < d or d == np.inf),
    "disjoint": lambda a, b, c, d: b < c or d < a,
    "less": lambda a, b, c, d: a <= c and b <= d,
    "precedes": lambda a, b, c, d: b <= c,
}


@each_dtype
def test_relations_membership_and_emptiness_are_exact_on_subnormal_fields(rng, dtype):
    x, y = drawn(rng, dtype), drawn(rng, dtype)
    rows = ends(x, y)  # Python compares subnormal numbers as they are
    found = jax.jit(lambda x, y: {op: getattr(sets, op)(x, y) for op in RELATIONS})(x, y)
    for op, f in RELATIONS.items():
        assert found[op].tolist() == [f(*row) for row in rows], op
    assert sets.intersection(x, y).is_empty.tolist() == [b < c or d < a for a, b, c, d in rows]
    assert sets.contains(x, y.lo).tolist() == [a <= c <= b and np.isfinite(c) for a, b, c, d in rows]


@each_dtype
def test_numbers_of_subnormal_fields_hold(rng, dtype):
    x = drawn(rng, dtype)
    values = jax.jit(lambda x: (x.mid, x.rad, x.wid, sets.mag(x), sets.mig(x)))(x)
    for (lo, hi), mid, rad, wid, mag, mig in zip(ends(x), *(v.tolist() for v in values), strict=True):
        assert lo <= mid <= hi and mag >= max(-lo, hi) and 0 <= mig <= max(lo, -hi, 0)
        if np.isfinite(lo) and np.isfinite(hi) and np.isfinite(rad):
            a, b = Fraction(lo), Fraction(hi)
            assert (
                Fraction(mid) - Fraction(rad) <= a
                and b <= Fraction(mid) + Fraction(rad)
                and (wid == np.inf or Fraction(wid) >= b - a)
            )


def test_elementary_functions_read_subnormal_fields():
    x = Interval(jnp.array([-5e-324]), jnp.array([5e-324]))
    assert (
        sets.exp(x).lo < 1 < sets.exp(x).hi
        and sets.sin(x).lo < 0 < sets.sin(x).hi
        and sets.atan2(x, x).lo < -3
    )
    assert sets.sqrt(Interval(jnp.array([5e-324]), jnp.array([1e-310]))).hi >= 1e-155
    assert sets.fma(x, 1e300, 0.0).hi >= 5e-24 and sets.exp(x).lo <= 1


def test_precisions_mix_without_losing_a_subnormal_number():
    small = np.array([-1e-40], np.float32)
    narrow = Interval(jnp.asarray(small), jnp.asarray(small))
    wide = Interval(jnp.array([1e40]), jnp.array([1e40]))
    exact = Fraction(float(small[0]))
    mixed = jax.jit(lambda a, b: (a * b, a + b * 0.0, sets.fma(a, b, b * 0.0)))(narrow, wide)
    for found, value in zip(mixed, (exact * Fraction(1e40), exact, exact * Fraction(1e40)), strict=True):
        assert Fraction(float(found.lo[0])) <= value <= Fraction(float(found.hi[0]))
    assert interval(small, np.array([1.0])).lo[0] <= float(small[0])
    assert not jax.jit(sets.subset)(narrow, interval(np.array([0.0]), np.array([1.0])))[0]


@pytest.mark.parametrize(
    "dtype", [pytest.param(t, marks=[pytest.mark.long] if t == np.float32 else []) for t in DTYPES]
)
def test_a_bound_that_is_nan_bounds_nothing(dtype):
    x, one = (
        Interval(jnp.array([np.nan, 0.0, np.nan], dtype), jnp.array([1.0, np.nan, np.nan], dtype)),
        interval(np.ones(3, dtype)),
    )
    assert (x.rad == np.inf).all() and (x.wid == np.inf).all()
    unary = (
        sets.sqr,
        sets.recip,
        abs,
        sets.sqrt,
        sets.log,
        sets.exp,
        sets.asin,
        sets.cos,
        lambda v: v**3,
        lambda v: v**-2,
    )
    binary = (sets.add, sets.sub, sets.mul, sets.div, sets.hull, sets.intersection, sets.fma)

    @jax.jit  # one program: the compiler takes |x| >= 0 for true, and there is little to compile
    def results(x, one):
        both = [f(x, one, one) if f is sets.fma else f(x, one) for f in binary]
        related = [getattr(sets, name)(*pair) for name in RELATIONS for pair in ((x, one), (one, x))]
        return [f(x) for f in unary], both, sets.div(one, x), related

    single, both, quotient, related = results(x, one)
    for out in (*single, *both, quotient):
        assert (
            not np.asarray(out.is_empty).any() and not (np.asarray(out.lo) > np.finfo(dtype).tiny * 9).all()
        )
    for out in (both[binary.index(f)] for f in (sets.mul, sets.add, sets.div)):
        assert not (np.isfinite(out.lo) & np.isfinite(out.hi)).any()
    assert not np.any(related)


def test_bounds_survive_the_round_trips_of_pytrees():
    x = Interval(jnp.array([-5e-324]), jnp.array([5e-324]))
    large = jnp.array([1e308])
    scale = jax.jit(lambda v: sets.mul(v, Interval(large, large)))
    carried = jax.lax.scan(lambda c, _: (c, scale(c)), x, None, length=2)[1]
    for out in (
        scale(jax.tree.map(lambda v: v, x)),
        jax.vmap(scale)(jax.tree.map(lambda v: v[None], x)),
        carried,
        scale(jax.device_put(x)),
    ):
        assert (out.hi >= 4e-16).all() and (out.lo <= -4e-16).all()
