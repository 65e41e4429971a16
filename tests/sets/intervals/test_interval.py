"""Interval operations against exact rationals: eagerly, compiled and vmapped, in both precisions."""

from fractions import Fraction
from functools import partialmethod
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import MODES, bounds, corners, far, floats, in_blocks, members, misses
from hypothesis import example, given, settings
from hypothesis import strategies as st
from interval_cases import (
    BINARY,
    COMPILED,
    COMPILED_POWERS,
    COUNT,
    EMPTY,
    UNARY,
    binary,
    draw,
    each_dtype,
    each_mode,
    ends,
    powers,
    ranges,
    unary,
)

from jaxbound import sets
from jaxbound.sets import interval
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.intervals.interval import Interval


def test_random_intervals_meet_every_kind_of_bound(rng):
    lo, hi = bounds(rng, np.float64, 500)
    with np.errstate(over="ignore"):
        kinds = [
            lo == hi,
            lo == -np.inf,
            hi == np.inf,
            (lo < 0) & (hi > 0),
            lo == 0,
            np.nextafter(lo, np.inf) == hi,
        ]
    assert all(kind.any() for kind in kinds)


# soundness of single operations


@each_mode
@each_dtype
def test_binary_operations_enclose_the_exact_result(rng, mode, dtype):
    x, y = draw(rng, dtype), draw(rng, dtype)
    for op, z in MODES[mode](binary)(x, y).items():
        assert z.dtype == dtype and not misses(z.lo, z.hi, ranges(BINARY[op], x, y)), op


@each_mode
@each_dtype
def test_unary_operations_enclose_the_exact_result(rng, mode, dtype):
    x = draw(rng, dtype)
    for op, z in MODES[mode](unary)(x).items():
        assert z.dtype == dtype and not misses(z.lo, z.hi, ranges(UNARY[op], x)), op


@each_dtype
def test_binary_operations_enclose_on_every_pair_of_corners(dtype):
    a, b = (v.ravel() for v in np.meshgrid(corners(dtype), corners(dtype)))
    x, y = Interval(a, a), Interval(b, b)
    for op, z in in_blocks(COMPILED, COUNT, x, y).items():
        assert not misses(z.lo, z.hi, ranges(BINARY[op], x, y)), op


SLOWER = [
    pytest.param(mode, dtype, marks=pytest.mark.long)
    for mode, dtype in (("eager", np.float64), ("jit", np.float32), ("vmap", np.float64))
]


@pytest.mark.parametrize(("mode", "dtype"), [("jit", np.float64), *SLOWER])
def test_pown_encloses_the_exact_power(rng, mode, dtype):
    x = draw(rng, dtype)
    for n, z in MODES[mode](powers)(x).items():
        assert not misses(z.lo, z.hi, ranges(lambda a, n=n: a**n if a or n >= 0 else None, x)), n


def floats_of(width):
    info = np.finfo(f"float{width}")
    special = [
        0.0,
        -0.0,
        *(
            s * float(v)
            for s in (1, -1)
            for v in (info.tiny, info.smallest_subnormal, info.max, np.inf, 1, 3, info.eps)
        ),
    ]
    return st.one_of(st.sampled_from(special), st.floats(allow_nan=False, width=width))


@st.composite
def intervals(draw, width):
    a, b = sorted([draw(floats_of(width)), draw(floats_of(width))])
    return (a, b) if a < np.inf and b > -np.inf else (0.0, 0.0)


@pytest.mark.parametrize("width", [32, 64])
def test_binary_operations_enclose_whatever_hypothesis_finds(width):
    dtype = np.dtype(f"float{width}")
    as_one = lambda bounds: interval(*(np.asarray(v, dtype) for v in bounds))

    @settings(max_examples=100, deadline=None, database=None)
    @given(intervals(width), intervals(width))
    @example((1.0, 2.0), (0.0, 1.0))
    @example((-1.0, np.inf), (-np.inf, 0.0))
    @example((0.0, 0.0), (-np.inf, np.inf))
    def check(a, b):
        for op, z in COMPILED(as_one(a), as_one(b)).items():
            exact = [v for p, q in product(members(*a), members(*b)) if (v := BINARY[op](p, q)) is not None]
            assert not misses(z.lo, z.hi, [exact]), op

    check()


# what the compiler rewrites: reciprocals, merged divisions, fused products


def large_divisors(rng, dtype, count=200):
    """Draw divisors whose reciprocals are normal, subnormal and flushed."""
    info = np.finfo(dtype)
    corner = [
        float(info.tiny),
        *(2.0**k for k in (info.maxexp // 2, info.maxexp - 2, info.maxexp - 1)),
        0.95 * float(info.max),
        3,
        0.1,
    ]
    sizes = np.concatenate(
        [corner, np.exp2(rng.uniform(info.maxexp - 3, info.maxexp - 0.1, count - len(corner)))]
    )
    return (sizes * rng.choice([-1, 1], count)).astype(dtype)


@pytest.mark.parametrize("form", ["scalar", "broadcast", "constant"])
@each_dtype
def test_div_encloses_quotients_by_huge_divisors(rng, form, dtype):
    divisors = large_divisors(rng, dtype)
    a = np.concatenate([corners(dtype), floats(rng, dtype, 30)])
    x, exact = interval(a), lambda d: [[Fraction(v) / Fraction(float(d))] for v in a.tolist()]
    if form == "broadcast":
        z = jax.tree.map(
            np.asarray,
            jax.jit(sets.div)(
                Interval(a[:, None], a[:, None]), Interval(divisors[None, :], divisors[None, :])
            ),
        )
        for j, d in enumerate(divisors):
            assert not misses(z.lo[:, j], z.hi[:, j], exact(d))
    elif form == "scalar":
        for d in divisors[:12]:
            z = jax.jit(sets.div)(x, Interval(d, d))
            assert not misses(z.lo, z.hi, exact(d))
    else:
        constants = divisors[1:5]
        results = jax.jit(lambda x: [sets.div(x, interval(d)) for d in constants])(x)
        for z, d in zip(results, constants, strict=True):
            assert not misses(z.lo, z.hi, exact(d))


CHAINS = {
    "(x / y) / z": lambda x, y, z: (x / y) / z,
    "x / (y * z)": lambda x, y, z: x / (y * z),
    "(x * y) / z": lambda x, y, z: (x * y) / z,
    "(x / y) * z": lambda x, y, z: (x / y) * z,
    "x * y + z": lambda x, y, z: x * y + z,
    "x / y - z / y": lambda x, y, z: x / y - z / y,
    "(x + y) * (x - z)": lambda x, y, z: (x + y) * (x - z),
    "(0.1 * x) / 3 + (y / 1e30) / 1e30 + z / 1.7e38": lambda x, y, z: (
        (0.1 * x) / 3 + (y / 1e30) / 1e30 + z / 1.7e38
    ),
}


def exactly(f):
    """Return f with its literals meant as the floats they are."""

    class Exact(Fraction):
        """A Fraction that turns floats into their exact values, not itself into a float."""

    for name in ("add", "sub", "mul", "truediv"):
        for side in (f"__{name}__", f"__r{name}__"):
            meant = lambda a, b, run: Exact(run(Fraction(a), Fraction(b)))
            setattr(Exact, side, partialmethod(meant, run=getattr(Fraction, side)))

    def call(*args):
        try:
            return f(*map(Exact, args))
        except ZeroDivisionError:
            return None

    return call


@pytest.mark.parametrize(
    ("chain", "dtype"),
    [(name, np.float64) for name in CHAINS] + [(name, np.float32) for name in list(CHAINS)[:3]],
    ids=str,
)
def test_compiled_chains_enclose_the_exact_result(rng, chain, dtype):
    f, count = CHAINS[chain], 60
    x, z = (draw(rng, dtype, count, unbounded=False) for _ in range(2))
    d = large_divisors(rng, dtype, count)
    d = np.where(rng.random(count) < 0.5, d, floats(rng, dtype, count))
    y = Interval(d, d)
    out = jax.jit(f)(x, y, z)
    assert not misses(out.lo, out.hi, ranges(exactly(f), x, y, z))


@pytest.mark.parametrize("chain", ["(x / y) / z", "(x * y) / z"])
@each_dtype
def test_chains_of_divisions_by_broadcast_values_enclose(rng, chain, dtype):
    f, x, d = CHAINS[chain], draw(rng, dtype, 60, unbounded=False), large_divisors(rng, dtype)
    run = jax.jit(jax.vmap(f, in_axes=(0, None, None)))
    for b, c in rng.choice(d, (6, 2)):
        z = run(x, Interval(b, b), Interval(c, c))
        assert not misses(
            z.lo, z.hi, ranges(lambda v, b=Fraction(float(b)), c=Fraction(float(c)): exactly(f)(v, b, c), x)
        )


@each_dtype
def test_a_quotient_of_quotients_is_not_merged_into_an_overflowing_product(dtype):
    d = interval(np.asarray(0.8 * np.finfo(dtype).max, dtype))
    z = jax.jit(lambda x, y: (x / y) / y)(interval(np.asarray(np.finfo(dtype).max, dtype)), d)
    exact = Fraction(float(np.finfo(dtype).max)) / Fraction(float(d.lo)) ** 2
    assert not misses(z.lo, z.hi, [(exact,)]) and z.hi < 1e-30


# sums and matrix products


def draw_matrix(rng, dtype, *shape):
    a = (rng.normal(size=shape) * 10.0 ** rng.integers(-3, 4, shape)).astype(dtype)
    return Interval(jnp.asarray(a), jnp.asarray(a + abs(rng.normal(size=shape)).astype(dtype)))


def vertex(rng, x):
    """Return an exact member of every entry, at one of its ends."""
    pick = np.where(rng.random(x.shape) < 0.5, np.asarray(x.lo), np.asarray(x.hi))
    return np.vectorize(Fraction, otypes=[object])(pick.astype(object))


FITTING = [
    ((3,), (3,)),
    ((2, 3), (3,)),
    ((3,), (3, 4)),
    ((2, 3), (3, 4)),
    ((5, 2, 3), (3, 4)),
    ((5, 2, 3), (5, 3, 4)),
    ((5, 2, 3), (3,)),
    ((3,), (5, 3, 4)),
    ((2, 40), (40, 3)),
]


def samples(rng, x, y):
    """Return exact products of vertices, one tuple an entry."""
    drawn = [np.matmul(vertex(rng, x), vertex(rng, y)) for _ in range(6)]
    return np.shape(drawn[0]), list(zip(*(np.ravel(s) for s in drawn), strict=True))


def test_matmul_encloses_exact_products_of_any_fitting_shapes(rng):
    pairs = [
        (draw_matrix(rng, np.float64, *left), draw_matrix(rng, np.float64, *right)) for left, right in FITTING
    ]
    found = kernel(lambda pairs: [sets.matmul(*pair) for pair in pairs])(pairs)
    for z, (x, y) in zip(found, pairs, strict=True):
        shape, exact = samples(rng, x, y)
        assert z.shape == shape and not misses(z.lo, z.hi, exact)


def test_matmul_encloses_eagerly(rng):
    x, y = draw_matrix(rng, np.float64, COUNT), draw_matrix(rng, np.float64, COUNT)
    z = sets.matmul(x, y)
    assert z.shape == () and not misses(z.lo, z.hi, samples(rng, x, y)[1])


@each_dtype
def test_matmul_encloses_under_vmap(rng, dtype):
    x, y = draw_matrix(rng, dtype, 6, 2, 3), draw_matrix(rng, dtype, 6, 3, 4)
    z = jax.jit(jax.vmap(sets.matmul))(x, y)
    assert z.dtype == dtype and not misses(z.lo, z.hi, samples(rng, x, y)[1])


@pytest.mark.parametrize(
    ("left", "right"), [((2, 3), (1,)), ((2, 3), (2, 3)), ((2, 3), ()), ((), (2,)), ((1,), (3,))]
)
def test_matmul_refuses_shapes_that_do_not_fit(left, right):
    with pytest.raises(ValueError, match="matmul needs"):
        sets.matmul(interval(np.ones(left)), interval(np.ones(right)))


def test_matmul_operator_takes_arrays_on_both_sides():
    a = np.array([[1.0, 2.0], [3.0, 4.0]])
    x = interval(a)
    for z in (jax.jit(lambda x: x @ a)(x), jax.jit(lambda x: a @ x)(x), jax.jit(lambda x, a: a @ x)(x, a)):
        assert isinstance(z, Interval) and not misses(z.lo, z.hi, [(Fraction(v),) for v in (7, 10, 15, 22)])


@pytest.mark.parametrize(("axis", "mode"), [(0, "jit"), (1, "jit"), (-1, "jit"), (-1, "vmap"), (-2, "eager")])
@each_dtype
def test_sum_encloses_the_exact_sum(rng, axis, mode, dtype):
    x = draw_matrix(rng, dtype, 3, 4, 5)
    z = MODES[mode](lambda x: sets.sum(x, axis))(x)
    samples = [vertex(rng, x).sum(axis) for _ in range(4)]
    assert not misses(z.lo, z.hi, list(zip(*(s.ravel() for s in samples), strict=True)))


def test_a_sum_with_an_empty_term_is_empty():
    z = sets.sum(interval([[1.0, np.inf], [1.0, 2.0]], [[2.0, -np.inf], [1.0, 3.0]]), axis=1)
    assert z.is_empty.tolist() == [True, False]


def test_a_sum_with_half_lines_is_a_half_line():
    z = sets.sum(interval([-np.inf, 1.0], [2.0, 3.0]))
    assert z.lo == -np.inf and 5 <= z.hi < 5.001


def test_a_sum_of_no_terms_encloses_zero():
    z = sets.sum(interval(np.zeros((0, 2))))
    assert z.shape == (2,) and not misses(z.lo, z.hi, [(Fraction(0),)] * 2)


# tightness: u is half the spacing of floats at 1


@each_dtype
def test_one_operation_is_within_nine_units_of_the_exact_range(rng, dtype):
    wide = lambda: np.exp2(rng.uniform(-20, 20, (2, COUNT)))
    x = Interval(*np.sort(rng.choice([-1, 1], COUNT) * wide(), 0).astype(dtype))
    y = Interval(*np.sort(wide(), 0).astype(dtype))
    u, tiny = Fraction(float(np.finfo(dtype).eps)) / 2, Fraction(float(np.finfo(dtype).tiny))
    for op, z in COMPILED(x, y).items():
        assert not far(z.lo, z.hi, [(min(v), max(v)) for v in ranges(BINARY[op], x, y)], 9 * u, 4 * tiny), op


@each_dtype
def test_pown_is_within_ten_units_a_multiplication(rng, dtype):
    x = Interval(*np.sort(np.exp2(rng.uniform(-8, 8, (2, COUNT))), 0).astype(dtype))
    u = Fraction(float(np.finfo(dtype).eps)) / 2
    for n, z in COMPILED_POWERS(x).items():
        exact = [(min(v), max(v)) for v in ranges(lambda a, n=n: a**n, x)]
        assert not far(z.lo, z.hi, exact, 10 * abs(n) * u, 0), n


@each_dtype
def test_operations_without_rounding_are_exact(rng, dtype):
    x, y = draw(rng, dtype), draw(rng, dtype)
    found = jax.jit(
        lambda x, y: (
            sets.neg(x),
            sets.abs(x),
            sets.min(x, y),
            sets.max(x, y),
            sets.hull(x, y),
            sets.intersection(x, y),
        )
    )(x, y)
    for a, b, c, d, *got in ends(x, y, *found):
        assert tuple(got) == (
            *(-b, -a),
            *(0 if a <= 0 <= b else min(abs(a), abs(b)), max(abs(a), abs(b))),
            *(min(a, c), min(b, d)),
            *(max(a, c), max(b, d)),
            *(min(a, c), max(b, d)),
            *((max(a, c), min(b, d)) if max(a, c) <= min(b, d) else EMPTY),
        )
