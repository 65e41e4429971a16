"""Edges of domains, numbers of intervals and relations between them, against IEEE 1788 and exact
definitions.
"""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import BEYOND, MODES, floats, in_blocks, misses, subnormals
from interval_cases import (
    BINARY,
    COMPILED,
    COMPILED_UNARY,
    COUNT,
    EMPTY,
    ENTIRE,
    UNARY,
    draw,
    each_dtype,
    each_mode,
    ends,
)

from jaxbound import sets
from jaxbound.sets import interval
from jaxbound.sets.intervals.interval import Interval

# edges of domains

EDGES = {  # the tightest results of IEEE 1788, entry by entry
    "1 / [0, 1]": (lambda: 1 / interval(0.0, 1.0), (1, np.inf)),
    "1 / [-1, 0]": (lambda: 1 / interval(-1.0, 0.0), (-np.inf, -1)),
    "1 / [-1, 1]": (lambda: 1 / interval(-1.0, 1.0), ENTIRE),
    "1 / [0, 0]": (lambda: 1 / interval(0.0), EMPTY),
    "recip [-0, 0]": (lambda: sets.recip(interval(-0.0, 0.0)), EMPTY),
    "[0, 0] / [0, 0]": (lambda: interval(0.0) / interval(0.0), EMPTY),
    "[1, 2] / [0, 0]": (lambda: interval(1.0, 2.0) / interval(0.0), EMPTY),
    "entire / [0, 0]": (lambda: interval(*ENTIRE) / interval(0.0), EMPTY),
    "entire / entire": (lambda: interval(*ENTIRE) / interval(*ENTIRE), ENTIRE),
    "[-1, 2] / [0, 1]": (lambda: interval(-1.0, 2.0) / interval(0.0, 1.0), ENTIRE),
    "[1, 2] / [0, inf]": (lambda: interval(1.0, 2.0) / interval(0.0, np.inf), (0, np.inf)),
    "[1, inf] / [1, inf]": (lambda: interval(1.0, np.inf) / interval(1.0, np.inf), (0, np.inf)),
    "[-inf, -1] / [-1, -0]": (lambda: interval(-np.inf, -1.0) / interval(-1.0, -0.0), (1, np.inf)),
    "[1, 1] / entire": (lambda: interval(1.0) / interval(*ENTIRE), ENTIRE),
    "[0, 1] * [0, 1]": (lambda: interval(0.0, 1.0) * interval(0.0, 1.0), (0, 1)),
    "[-1, 0] * [0, inf]": (lambda: interval(-1.0, 0.0) * interval(0.0, np.inf), (-np.inf, 0)),
    "[0, 1] / [1, 2]": (lambda: interval(0.0, 1.0) / interval(1.0, 2.0), (0, 1)),
    "1 / ([0, 1] * [0, 1])": (lambda: 1 / (interval(0.0, 1.0) * interval(0.0, 1.0)), (1, np.inf)),
    "entire + entire": (lambda: interval(*ENTIRE) + interval(*ENTIRE), ENTIRE),
    "entire - entire": (lambda: interval(*ENTIRE) - interval(*ENTIRE), ENTIRE),
    "[0, 2] ** -3": (lambda: interval(0.0, 2.0) ** -3, (0.125, np.inf)),
    "[-2, 0] ** -3": (lambda: interval(-2.0, 0.0) ** -3, (-np.inf, -0.125)),
    "[-2, 1] ** -2": (lambda: interval(-2.0, 1.0) ** -2, (0.25, np.inf)),
    "[-2, 1] ** -1": (lambda: interval(-2.0, 1.0) ** -1, ENTIRE),
    "[0, 0] ** -1": (lambda: interval(0.0) ** -1, EMPTY),
    "[0, 0] ** -2": (lambda: interval(0.0) ** -2, EMPTY),
    "[0, 0] ** -3": (lambda: interval(0.0) ** -3, EMPTY),
    "[-2, 1] ** 2": (lambda: interval(-2.0, 1.0) ** 2, (0, 4)),
    "entire ** 2": (lambda: interval(*ENTIRE) ** 2, (0, np.inf)),
    "entire ** 3": (lambda: interval(*ENTIRE) ** 3, ENTIRE),
    "entire ** 0": (lambda: interval(*ENTIRE) ** 0, (1, 1)),
    "[-inf, -2] ** 3": (lambda: interval(-np.inf, -2.0) ** 3, (-np.inf, -8)),
    "sqr [-inf, 0]": (lambda: sets.sqr(interval(-np.inf, 0.0)), (0, np.inf)),
}


@pytest.mark.parametrize("name", EDGES)
def test_edges_of_domains_give_the_tightest_set_up_to_rounding(name):
    build, (lo, hi) = EDGES[name]
    z = build()
    if lo > hi:
        assert z.is_empty
    else:
        assert z.lo <= lo and hi <= z.hi and not z.is_empty
        for got, want in ((z.lo, lo), (z.hi, hi)):
            assert got == want or abs(got - want) <= 1e-14 * abs(want), "not tight"


@pytest.mark.parametrize("op", [*BINARY, "intersection", "matmul"])
def test_an_empty_argument_gives_an_empty_result(op):
    full, empty = (
        Interval(*map(jnp.asarray, (np.full(COUNT, lo), np.full(COUNT, hi))))
        for lo, hi in ((1.0, 2.0), EMPTY)
    )  # the shape of other tests
    for x, y in ((full, empty), (empty, full), (empty, empty)):
        z = getattr(sets, op)(x, y)
        assert z.is_empty.all() and (z.lo == np.inf).all() and (z.hi == -np.inf).all()


@pytest.mark.parametrize("op", [*UNARY, "pown 3", "pown 2", "pown 0", "pown -1", "pown -2"])
def test_a_unary_operation_on_empty_is_empty(op):
    name, *n = op.split()
    z = getattr(sets, name)(interval(*EMPTY), *map(int, n))
    assert (z.lo, z.hi) == EMPTY


def test_hull_with_empty_is_the_other():
    x = sets.hull(interval(*EMPTY), interval(1.0, 2.0))
    assert (x.lo, x.hi) == (1, 2) and sets.hull(interval(*EMPTY), interval(*EMPTY)).is_empty


@pytest.mark.parametrize("n", ["2", None, True])
def test_a_power_refuses_an_exponent_that_is_no_number(n):
    with pytest.raises(TypeError, match="exponent must be a number or an interval"):
        interval(1.0, 2.0) ** n


@each_dtype
def test_subnormal_bounds_built_by_the_factory_are_enclosed(dtype):
    s = subnormals(dtype)
    a, b = (v.ravel() for v in np.meshgrid(s, np.concatenate([s, [0, 1, -3]]).astype(dtype)))
    x, y = (jax.tree.map(np.asarray, interval(v)) for v in (a, b))
    for op, z in {**in_blocks(COMPILED, COUNT, x, y), **in_blocks(COMPILED_UNARY, COUNT, x)}.items():
        points = zip(a.tolist(), b.tolist(), strict=True) if op in BINARY else ((v,) for v in a.tolist())
        values = [{**BINARY, **UNARY}[op](*map(Fraction, p)) for p in points]
        assert not misses(z.lo, z.hi, [() if v is None else (v,) for v in values]), op


# numbers and relations, against exact definitions on finite bounds


def exact_bounds(x):
    return [
        tuple(-BEYOND if v == -np.inf else BEYOND if v == np.inf else Fraction(v) for v in row)
        for row in ends(x)
    ]


@each_mode
@each_dtype
def test_mid_lies_inside_and_rad_around_it_covers(rng, mode, dtype):
    x = draw(rng, dtype)
    m, r = MODES[mode](lambda x: (x.mid, x.rad))(x)
    assert m.dtype == r.dtype == dtype and np.isfinite(m).all()
    for (a, b), (c, d), mid, rad in zip(exact_bounds(x), ends(x), m.tolist(), r.tolist(), strict=True):
        assert c <= mid <= d
        assert rad == np.inf or Fraction(mid) - Fraction(rad) <= a and b <= Fraction(mid) + Fraction(rad)


@each_mode
@each_dtype
def test_mid_is_the_middle_to_half_a_unit(rng, mode, dtype):
    x = draw(rng, dtype, unbounded=False)
    u, tiny = Fraction(float(np.finfo(dtype).eps)) / 2, Fraction(float(np.finfo(dtype).tiny))
    for (a, b), mid in zip(exact_bounds(x), MODES[mode](sets.mid)(x).tolist(), strict=True):
        assert abs(Fraction(mid) - (a + b) / 2) <= u * abs(Fraction(mid)) + 2 * tiny


@each_mode
@each_dtype
def test_wid_is_at_least_the_width_and_within_nine_units(rng, mode, dtype):
    x = draw(rng, dtype)
    w = MODES[mode](sets.wid)(x)
    u, tiny = Fraction(float(np.finfo(dtype).eps)) / 2, Fraction(float(np.finfo(dtype).tiny))
    for (a, b), wid in zip(exact_bounds(x), w.tolist(), strict=True):
        assert wid >= b - a
        assert wid == np.inf or Fraction(wid) <= (b - a) * (1 + 9 * u) + 4 * tiny
        assert np.isfinite(wid) or b - a > Fraction(float(np.finfo(dtype).max)) * (1 - 9 * u)


def test_a_point_has_no_width_and_no_radius(rng):
    x = interval(floats(rng, np.float64, COUNT))
    assert (x.wid == 0).all() and (x.rad == 0).all() and (x.mid == x.lo).all()


@each_dtype
def test_mag_and_mig_are_the_extreme_absolute_values(rng, dtype):
    x = draw(rng, dtype)
    for (a, b), big, small in zip(
        ends(x), *(jax.jit(f)(x).tolist() for f in (sets.mag, sets.mig)), strict=True
    ):
        assert big == max(abs(a), abs(b)) and small == (0 if a <= 0 <= b else min(abs(a), abs(b)))


@pytest.mark.parametrize("name", ["mid", "rad", "wid", "mag", "mig"])
def test_numbers_of_empty_are_nan(name):
    assert np.isnan(getattr(sets, name)(interval(*EMPTY)))


def test_numbers_of_unbounded_intervals_follow_the_standard():
    top = np.finfo(float).max
    x = interval([-np.inf, -np.inf, 1.0], [np.inf, 1.0, np.inf])
    mid, rad, wid, mag, mig = jax.jit(lambda x: (x.mid, x.rad, x.wid, sets.mag(x), sets.mig(x)))(x)
    assert mid.tolist() == [0, -top, top] and mig.tolist() == [0, 0, 1]
    assert rad.tolist() == wid.tolist() == mag.tolist() == [np.inf] * 3


def few_ends(rng, dtype, count=COUNT):
    """Draw intervals between few ends, so that ends often coincide."""
    lo = rng.integers(-3, 3, count)
    hi = np.maximum(lo + rng.integers(0, 4, count), -2)
    return Interval(
        *(jnp.asarray(v, dtype) for v in (np.where(lo == -3, -np.inf, lo), np.where(hi >= 3, np.inf, hi)))
    )


RELATIONS = {  # on non-empty sets, by their ends
    "equal": lambda a, b, c, d: a == c and b == d,
    "subset": lambda a, b, c, d: c <= a and b <= d,
    "interior": lambda a, b, c, d: (c < a or c == -np.inf) and (b < d or d == np.inf),
    "disjoint": lambda a, b, c, d: b < c or d < a,
    "less": lambda a, b, c, d: a <= c and b <= d,
    "precedes": lambda a, b, c, d: b <= c,
}
ON_EMPTY = {  # empty with full, full with empty, empty with empty: IEEE 1788, table 10.3
    "equal": (False, False, True),
    "subset": (True, False, True),
    "interior": (True, False, True),
    "disjoint": (True, True, True),
    "less": (False, False, True),
    "precedes": (True, True, True),
}


@each_mode
@each_dtype
def test_relations_compare_the_ends(rng, mode, dtype):
    x, y = few_ends(rng, dtype), few_ends(rng, dtype)
    got = MODES[mode](lambda x, y: [getattr(sets, relation)(x, y) for relation in RELATIONS])(x, y)
    for answers, by_ends in zip(got, RELATIONS.values(), strict=True):
        want = [by_ends(*row) for row in ends(x, y)]
        assert answers.tolist() == want and 0 < sum(want) < len(want)


@pytest.mark.parametrize("relation", RELATIONS)
def test_relations_on_empty_follow_the_standard(relation):
    x = interval([np.inf, -np.inf, np.inf], [-np.inf, np.inf, -np.inf])
    y = interval([-np.inf, np.inf, np.inf], [np.inf, -np.inf, -np.inf])
    assert tuple(getattr(sets, relation)(x, y).tolist()) == ON_EMPTY[relation]


@each_mode
@each_dtype
def test_contains_is_exact(rng, mode, dtype):
    x = draw(rng, dtype)
    p = np.where(
        rng.random(COUNT) < 0.5,
        rng.choice(subnormals(dtype), COUNT),
        np.where(rng.random(COUNT) < 0.5, x.lo, x.hi),
    ).astype(dtype)
    with np.errstate(over="ignore"):
        p = np.where(rng.random(COUNT) < 0.3, np.nextafter(x.lo, dtype(-np.inf)), p).astype(dtype)
    got = MODES[mode](sets.contains)(x, p)
    want = [a <= v <= b and np.isfinite(v) for (a, b), v in zip(ends(x), p.tolist(), strict=True)]
    assert got.tolist() == want and 0 < sum(want) < len(want)


def test_contains_is_false_for_nan_and_infinities():
    x = interval(*ENTIRE)
    assert not sets.contains(x, np.array([np.nan, np.inf, -np.inf])).any() and sets.contains(x, 1e308)


def test_contains_does_not_round_a_number_to_the_narrower_dtype():
    x = interval(np.float32(0.1))
    assert not sets.contains(x, 0.1) and sets.contains(x, float(np.float32(0.1)))


def test_contains_does_not_take_a_subnormal_for_zero():
    assert not sets.contains(interval(0.0), 5e-324) and sets.contains(interval(0.0, 1.0), 5e-324)


def test_equality_is_that_of_sets_entry_by_entry():
    x, y = interval([1.0, 2.0], [3.0, 4.0]), interval([1.0, 2.0], [3.0, 5.0])
    assert (x == x).all() and (x == y).tolist() == [True, False] and (x != y).tolist() == [False, True]
    assert jax.jit(lambda a, b: a == b)(x, y).tolist() == sets.equal(x, y).tolist()
    assert interval(0.5) == Fraction(1, 2) and (np.ones(2) == interval(np.ones(2))).all()
    assert interval(*EMPTY) == interval(*EMPTY) and not interval(5e-324) == interval(0.0)
    assert not sets.Interval(jnp.array(np.nan), jnp.array(1.0)) == interval(0.0, 1.0)
    assert (x == None) is False and x != "entire" and {x: 1}[x] == 1  # noqa: E711


def test_equality_with_what_is_no_number_is_refused():
    with pytest.raises(TypeError):
        interval(0.0) == object()  # noqa: B015
