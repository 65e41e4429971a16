"""Elementary functions of Intervals: enclosure of 200-bit values on points and on intervals, in both
precisions, and how tight they are.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import DTYPES
from elementary_cases import (
    ARB,
    COUNT,
    DOMAIN,
    FAST,
    ball_misses,
    close_calls,
    distance,
    exactly,
    inside,
    largest_error,
    points,
)
from flint import arb

from jaxbound import sets
from jaxbound.sets.intervals.interval import Interval

LONGER = {
    np.float64: (np.longdouble, 53),
    np.float32: (np.float64, 46),
}  # and how many digits of them are relied on
each_op = pytest.mark.parametrize("op", ARB)
each_dtype = pytest.mark.parametrize("dtype", DTYPES, ids=["float32", "float64"])


def point(x):
    return Interval(jnp.asarray(x), jnp.asarray(x))


def arrays(z):
    return np.asarray(z.lo), np.asarray(z.hi)


@each_op
@each_dtype
def test_the_value_at_a_point_is_enclosed_within_eight_ulps(rng, op, dtype):
    x = points(rng, op, dtype, COUNT)
    lo, hi = arrays(getattr(sets, op)(point(x)))
    balls = exactly(ARB[op], x)
    assert lo.dtype == dtype and not ball_misses(lo, hi, balls)
    normal = (
        np.isfinite(lo)
        & np.isfinite(hi)
        & (np.minimum(abs(lo), abs(hi)) > 8 * np.finfo(dtype).tiny / np.finfo(dtype).eps)
    )
    ulps = [
        max(distance(lo[i], balls[i], dtype), distance(hi[i], balls[i], dtype))
        for i in np.flatnonzero(normal)
    ]
    print(
        f"{op} {np.dtype(dtype).name}: at most {max(ulps):.1f} ulps from the exact value, on average "
        f"{np.mean(ulps):.1f}"
    )
    assert len(ulps) > COUNT / 3 and np.quantile(ulps, 0.99) <= 8 and max(ulps) <= 9.5


@pytest.mark.long(by_day="test_the_value_at_a_point_is_enclosed_within_eight_ulps")
@each_op
@each_dtype
def test_a_million_points_are_enclosed(rng, op, dtype):
    longer, digits = LONGER[dtype]
    x = points(rng, op, dtype, 1_000_000)
    lo, hi = arrays(getattr(sets, op)(point(x)))
    with np.errstate(over="ignore"):
        fast = FAST[op](x.astype(longer))
    chosen = settled_in_200_bits(lo, hi, fast, digits)
    balls = exactly(ARB[op], x[chosen])
    assert (
        not ball_misses(lo[chosen], hi[chosen], balls)
        and largest_error(fast[::500], exactly(ARB[op], x[::500])) < 2.0**-digits / 2
    )


def settled_in_200_bits(lo, hi, fast, digits):
    """Return the points that longer floats do not settle, and one in five hundred of the others."""
    hard = close_calls(lo.astype(fast.dtype), hi.astype(fast.dtype), fast, digits)
    print(f"{hard.sum()} points are settled in 200 bits only")
    return np.flatnonzero(hard | (np.arange(len(lo)) % 500 == 0))


def boxes(rng, op, dtype, count):
    """Draw intervals: narrow, wide, half-lines; some reach out of the domain."""
    x, y = points(rng, op, dtype, count), points(rng, op, dtype, count)
    kind = rng.integers(0, 5, count)
    with np.errstate(over="ignore"):
        y = np.where(kind == 0, x + abs(rng.normal(size=count).astype(dtype)) * abs(x), y)
        y = np.where(kind == 1, np.nextafter(x, dtype(np.inf)), y)
        lo, hi = np.minimum(x, y), np.maximum(x, y)
    if op in DOMAIN:
        out = rng.random(count) < 0.2
        lo = np.where(out, lo - dtype(3), lo)
        hi = np.where(out & (rng.random(count) < 0.5), hi + dtype(3), hi)
    lo = np.where(rng.random(count) < 0.05, dtype(-np.inf), lo)
    hi = np.where(rng.random(count) < 0.05, dtype(np.inf), hi)
    return lo, hi


@each_op
@each_dtype
def test_values_inside_an_interval_are_enclosed(rng, op, dtype):
    lo, hi = boxes(rng, op, dtype, COUNT)
    z = getattr(sets, op)(Interval(jnp.asarray(lo), jnp.asarray(hi)))
    low, high = DOMAIN.get(op, (-np.inf, np.inf))
    tiny = np.finfo(dtype).tiny
    for row in inside(rng, lo, hi, 4):
        at = (row >= low) & (row <= high) & ((abs(row) >= tiny) | (row == 0)) & (abs(row) < 1e6)
        at &= ~((row == 0) & op.startswith("log")) & ~((abs(row) == 1) & (op == "atanh"))
        at &= np.arange(COUNT) % 3 == 0
        assert not ball_misses(np.asarray(z.lo)[at], np.asarray(z.hi)[at], exactly(ARB[op], row[at]))


@each_op
@each_dtype
def test_bounds_are_attained_at_the_ends_or_at_an_extremum(rng, op, dtype):
    """An enclosure is not wider than the values at the ends, except where sin, cos, cosh or tan turn
    inside.
    """
    lo, hi = boxes(rng, op, dtype, COUNT)
    low, high = DOMAIN.get(op, (-np.inf, np.inf))
    f = getattr(sets, op)
    z = f(Interval(jnp.asarray(lo), jnp.asarray(hi)))
    a, b = (f(point(np.clip(v, low, high))) for v in (lo, hi))
    keep = ~np.asarray(z.is_empty)
    turns = (op in ("sin", "cos", "tan")) & (hi - lo > 0.5) | (op == "cosh") & (lo < 0) & (hi > 0)
    hull = sets.hull(a, b)
    wide = keep & ~turns & ~np.asarray(sets.subset(z, hull)) & ~np.asarray(a.is_empty | b.is_empty)
    at_turn = np.isin(np.asarray(z.lo), [-1, -np.inf]) | np.isin(np.asarray(z.hi), [1, np.inf])
    assert keep.sum() > COUNT / 2 and not (wide & ~at_turn).any()


@pytest.mark.parametrize("dtype", DTYPES, ids=["float32", "float64"])
def test_angles_of_boxes_are_enclosed(rng, dtype):
    ends = lambda: np.sort(
        rng.choice([-3, -1, 0, 1, 2, 0.3, -0.7, 1e30, 1e-30, -1e-30], (2, COUNT)), axis=0
    ).astype(dtype)
    (y_lo, y_hi), (x_lo, x_hi) = ends(), ends()
    z = sets.atan2(
        Interval(jnp.asarray(y_lo), jnp.asarray(y_hi)), Interval(jnp.asarray(x_lo), jnp.asarray(x_hi))
    )
    for y, x in zip(inside(rng, y_lo, y_hi, 6), inside(rng, x_lo, x_hi, 6)[rng.permutation(6)], strict=True):
        at = (x != 0) | (y != 0)
        balls = [
            arb.atan2(arb(p), arb(q))
            for p, q in zip(y[at].astype(float).tolist(), x[at].astype(float).tolist(), strict=True)
        ]
        assert not ball_misses(np.asarray(z.lo)[at], np.asarray(z.hi)[at], balls)


@pytest.mark.parametrize("count", [COUNT, pytest.param(1_000_000, marks=pytest.mark.long)])
@each_dtype
def test_angles_of_many_points_are_enclosed(rng, dtype, count):
    longer, digits = LONGER[dtype]
    y, x = (points(rng, op, dtype, count) for op in ("asinh", "atan"))
    near = rng.random(len(x)) < 0.5
    with np.errstate(over="ignore"):
        x = np.where(near, y * points(rng, "exp2", dtype, len(x)).clip(-8, 8), x).astype(dtype)
    x = np.where(np.isfinite(x) & (abs(x) > np.finfo(dtype).tiny), x, dtype(1))
    lo, hi = arrays(sets.atan2(point(y), point(x)))
    chosen = settled_in_200_bits(lo, hi, np.arctan2(y.astype(longer), x.astype(longer)), digits)
    balls = [
        arb.atan2(arb(p), arb(q))
        for p, q in zip(y[chosen].astype(float).tolist(), x[chosen].astype(float).tolist(), strict=True)
    ]
    assert not ball_misses(lo[chosen], hi[chosen], balls)


@pytest.mark.parametrize(
    "op",
    ["log", "tan", *(pytest.param(op, marks=pytest.mark.long) for op in ARB if op not in ("log", "tan"))],
)
def test_a_batch_under_jit_and_vmap_encloses_as_well(rng, op):
    x = points(rng, op, np.float64, 300)
    for run in (jax.jit(getattr(sets, op)), jax.jit(jax.vmap(getattr(sets, op)))):
        assert not ball_misses(*arrays(run(point(x))), exactly(ARB[op], x))
