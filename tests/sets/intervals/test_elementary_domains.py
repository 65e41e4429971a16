"""Edges of domains, exact values, extrema, shapes, gradients and second calls of the elementary functions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import Counted
from elementary_cases import ARB, COUNT, ball_misses, box
from flint import arb

from jaxbound import sets
from jaxbound.sets import interval
from jaxbound.sets.intervals.interval import Interval

INF = np.inf
EMPTY = (INF, -INF)
EDGES = [  # operation, argument, the exact result as floats, each bound exact
    ("sqrt", (-1, 4), (0, 2)),
    ("sqrt", (-4, -1), EMPTY),
    ("sqrt", (0, INF), (0, INF)),
    ("sqrt", (-INF, INF), (0, INF)),
    ("log", (-1, 0), EMPTY),
    ("log", (0, 1), (-INF, 0)),
    ("log", (-3, INF), (-INF, INF)),
    ("log", (1, 1), (0, 0)),
    ("log2", (0, 1), (-INF, 0)),
    ("log10", (1, INF), (0, INF)),
    ("exp", (-INF, 0), (0, 1)),
    ("exp", (0, INF), (1, INF)),
    ("exp2", (-3, 10), (0.125, 1024)),
    ("exp2", (-1022, 0), (2.0**-1022, 1)),
    ("exp10", (0, 0), (1, 1)),
    ("sin", (0, 0), (0, 0)),
    ("sin", (0, 2), (0, 1)),
    ("sin", (-2, 0), (-1, 0)),
    ("sin", (1, 6), (-1, 1)),
    ("sin", (-INF, 0), (-1, 1)),
    ("cos", (0, 0), (1, 1)),
    ("cos", (-4, 4), (-1, 1)),
    ("sin", (2.0**30, 2.0**30), (-1, 1)),
    ("tan", (2.0**30, 2.0**30), (-INF, INF)),
    ("tan", (1, 2), (-INF, INF)),
    ("tan", (0, 0), (0, 0)),
    ("tan", (0, 100), (-INF, INF)),
    ("asin", (2, 3), EMPTY),
    ("asin", (-5, -2), EMPTY),
    ("asin", (0, 0), (0, 0)),
    ("cosh", (0, 0), (1, 1)),
    ("acos", (1, 1), (0, 0)),
    ("acos", (2, INF), EMPTY),
    ("atan", (0, 0), (0, 0)),
    ("sinh", (-INF, 0), (-INF, 0)),
    ("sinh", (0, INF), (0, INF)),
    ("cosh", (-INF, INF), (1, INF)),
    ("tanh", (-INF, INF), (-1, 1)),
    ("tanh", (0, 0), (0, 0)),
    ("asinh", (0, INF), (0, INF)),
    ("asinh", (-INF, INF), (-INF, INF)),
    ("acosh", (-INF, 1), (0, 0)),
    ("acosh", (-INF, 0.5), EMPTY),
    ("acosh", (0, INF), (0, INF)),
    ("atanh", (-1, 1), (-INF, INF)),
    ("atanh", (1, 1), EMPTY),
    ("atanh", (-3, -1), EMPTY),
    ("atanh", (0, 5), (0, INF)),
]


@pytest.mark.parametrize(("op", "argument", "exact"), EDGES, ids=str)
def test_edges_of_domains_give_the_tightest_set(op, argument, exact):
    z = getattr(sets, op)(box(*argument))
    for got, want, other in ((float(z.lo[0]), exact[0], z.hi), (float(z.hi[0]), exact[1], z.lo)):
        assert got == want or (op == "sqrt" and want == 2 and 0 <= got - want < 1e-14), (
            op,
            argument,
            got,
            other,
        )


@pytest.mark.parametrize("op", ARB)
def test_empty_gives_empty(op):
    assert getattr(sets, op)(box(INF, -INF)).is_empty.all()


ANGLES = [  # y, x, the least and the largest angle in units of pi
    ((0, 0), (-1, 0), (1, 1)),
    ((0, 0), (0, 1), (0, 0)),
    ((0, 1), (0, 0), (0.5, 0.5)),
    ((-1, 0), (0, 0), (-0.5, -0.5)),
    ((-1, 0), (-1, 1), (-1, 1)),
    ((0, 1), (-1, 1), (0, 1)),
    ((1, 1), (-1, -1), (0.75, 0.75)),
    ((-1, -1), (-1, 1), (-0.75, -0.25)),
    ((-1, 1), (1, 1), (-0.25, 0.25)),
    ((-INF, INF), (-INF, INF), (-1, 1)),
    ((1, INF), (0, 0), (0.5, 0.5)),
    ((0, INF), (-INF, INF), (0, 1)),
    ((1, 1), (0, INF), (0, 0.5)),
    ((-1, -0.5), (-INF, -1), (-1, -0.75)),
    ((-1, 1), (0, 1), (-0.5, 0.5)),
]


@pytest.mark.parametrize(("y", "x", "turns"), ANGLES, ids=str)
def test_angles_of_boxes_at_the_axes_and_the_cut(y, x, turns):
    z = sets.atan2(box(*y), box(*x))
    for got, turn, side in ((float(z.lo[0]), turns[0], -1), (float(z.hi[0]), turns[1], 1)):
        excess = side * (arb(got) - arb.pi() * turn)
        if turn == 0:
            assert got == 0
        else:
            assert -1e-60 < float(excess) < 4e-15


def test_the_origin_alone_has_no_angle():
    assert sets.atan2(box(0, 0), box(0, 0)).is_empty.all()


def test_one_is_reached_exactly_where_an_interval_holds_a_quarter_turn(rng):
    """The neighbours of multiples of pi/2, inside and outside, for hundreds of turns."""
    n = rng.integers(-(2**19), 2**19, COUNT)
    n = np.where(n == 0, 1, n)
    exact = [arb.pi() * int(k) / 2 for k in n]
    near = np.array([float(v) for v in exact])
    below = np.array([a if arb(a) < v else np.nextafter(a, -INF) for a, v in zip(near, exact, strict=True)])
    above = np.nextafter(below, INF)
    for lo, hi, crossed in ((below, above, True), (below - 0.3, below, False), (above, above + 0.3, False)):
        quarter = n % 4
        x = Interval(jnp.asarray(lo), jnp.asarray(hi))
        s, c, t = (getattr(sets, op)(x) for op in ("sin", "cos", "tan"))
        if crossed:
            assert (np.asarray(s.hi)[quarter == 1] == 1).all() and (
                np.asarray(s.lo)[quarter == 3] == -1
            ).all()
            assert (np.asarray(c.hi)[quarter == 0] == 1).all() and (
                np.asarray(c.lo)[quarter == 2] == -1
            ).all()
        assert (np.isinf(np.asarray(t.lo))[quarter % 2 == 1] == crossed).all() and np.isfinite(
            np.asarray(t.lo)[quarter % 2 == 0]
        ).all()
        assert (np.asarray(s.lo)[quarter == 1] > 0.9).all() and (np.asarray(c.hi)[quarter == 2] < -0.9).all()


def test_subnormal_arguments_are_enclosed():
    tiny = 5e-324
    x = box([tiny, -tiny, 0.0, tiny], [tiny, -tiny, tiny, 1.0])
    for op in ("sqrt", "sin", "tan", "atan", "sinh", "asinh", "atanh", "tanh", "asin", "exp", "cosh"):
        z = getattr(sets, op)(x)
        at = [0, 2, 3] if op == "sqrt" else [0, 1, 2, 3]
        balls = [ARB[op](arb(v)) for v in np.asarray([tiny, -tiny, tiny, tiny])[at]]
        assert not ball_misses(np.asarray(z.lo)[at], np.asarray(z.hi)[at], balls), op
    for op in ("log", "log2", "log10"):
        z = getattr(sets, op)(box(tiny, tiny))
        assert not ball_misses(z.lo[:4], z.hi[:4], [ARB[op](arb(tiny))] * 4) and z.lo[0] > -1100, op


def test_numbers_and_arrays_are_points_and_shapes_broadcast():
    assert sets.exp(0.0).lo == 1 and sets.atan2(
        np.ones((2, 1)), interval(np.ones(3), np.full(3, 2.0))
    ).shape == (2, 3)
    z = sets.fma(interval(np.float32(1)), 0.1, 2)
    assert z.dtype == np.float32 and z.lo < 2.1 < z.hi


def test_bad_bounds_are_refused_by_the_door():
    with pytest.raises(ValueError, match="lo must be <= hi"):
        sets.exp(interval(2.0, 1.0))
    with pytest.raises(ValueError, match="not NaN"):
        sets.sin(np.nan)


def test_a_second_call_does_not_trace():
    f = Counted(lambda x: sets.sin(sets.exp(x) + sets.log(x)))
    run = jax.jit(f)
    for k in (1.0, 2.0, 3.0):
        run(interval(np.full(5, k), np.full(5, k + 1)))
    assert f.count == 1


@pytest.mark.parametrize(
    "op",
    ["exp", "acosh", *(pytest.param(op, marks=pytest.mark.long) for op in ARB if op not in ("exp", "acosh"))],
)
def test_gradients_of_the_bounds_are_those_of_the_function(op):
    at, step = 1.5 if op == "acosh" else 0.4, 1e-5
    width = lambda a: getattr(sets, op)(Interval(a * jnp.ones(4), a * jnp.ones(4))).hi[0]
    slope = (float(ARB[op](arb(at + step))) - float(ARB[op](arb(at - step)))) / (2 * step)
    assert abs(float(jax.grad(width)(at)) - slope) < 1e-6


AT_EDGES = [
    ("asin", (-3, 3)),
    ("acosh", (0, 2)),
    ("atanh", (-1, 1)),
    ("tan", (0, 2)),
    ("exp", (-INF, INF)),
    ("sin", (0, 2.0**40)),
    ("atan2", (0, 0)),
]


@pytest.mark.parametrize(
    ("op", "bounds"),
    [
        ("sqrt", (-1, 4)),
        ("log", (0, 2)),
        ("asin", (-3, 3)),
        *(pytest.param(*c, marks=pytest.mark.long) for c in AT_EDGES),
    ],
    ids=str,
)
def test_gradients_at_edges_of_domains_are_numbers(op, bounds):
    def total(lo, hi):
        x = Interval(lo, hi)
        z = sets.atan2(x, x) if op == "atan2" else getattr(sets, op)(x)
        return jnp.where(jnp.isfinite(z.hi), z.hi, 0).sum() + jnp.where(jnp.isfinite(z.lo), z.lo, 0).sum()

    slopes = jax.grad(total, argnums=(0, 1))(*(jnp.full(4, float(v)) for v in bounds))
    assert all(jnp.isfinite(s).all() for s in slopes)
