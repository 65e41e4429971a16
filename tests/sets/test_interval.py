"""Interval operations against exact rationals: eagerly, compiled and vmapped, in both precisions."""

import operator
from fractions import Fraction
from functools import partialmethod
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import BEYOND, DTYPES, MODES, Counted, bounds, corners, far, floats, in_blocks, members, misses, subnormals
from hypothesis import example, given, settings
from hypothesis import strategies as st

from jaxbound import sets
from jaxbound.sets import interval
from jaxbound.sets.interval import Interval

BINARY = {
    "add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": lambda a, b: a / b if b else None, "min": min, "max": max,
}  # fmt: skip
UNARY = {"neg": operator.neg, "abs": abs, "sqr": lambda a: a * a, "recip": lambda a: 1 / a if a else None}
EMPTY, ENTIRE = (np.inf, -np.inf), (-np.inf, np.inf)

each_dtype = pytest.mark.parametrize("dtype", DTYPES, ids=["float32", "float64"])
each_mode = pytest.mark.parametrize("mode", MODES)
COUNT = 300  # one shape for most tests, and one function of all operations: little is compiled


def binary(x, y):
    return {op: getattr(sets, op)(x, y) for op in BINARY}


def unary(x):
    return {op: getattr(sets, op)(x) for op in UNARY}


POWERS = (-3, -2, -1, 0, 1, 2, 3, 4, 7)


def powers(x):
    return {n: sets.pown(x, n) for n in POWERS}


COMPILED, COMPILED_UNARY, COMPILED_POWERS = jax.jit(binary), jax.jit(unary), jax.jit(powers)


def draw(rng, dtype, count=COUNT, **options):
    return Interval(*map(jnp.asarray, bounds(rng, dtype, count, **options)))


def ends(*x):
    """Return the bounds of Intervals as lists of tuples of Python floats, one tuple an entry."""
    return list(zip(*(np.ravel(end).tolist() for each in x for end in (each.lo, each.hi)), strict=True))


def ranges(f, *x):
    """Return, an entry, the exact values of f at members of the Intervals (None: undefined there)."""
    exact = []
    for row in ends(*x):
        inside = [members(a, b) for a, b in zip(row[::2], row[1::2], strict=True)]
        exact.append([v for point in product(*inside) if (v := f(*point)) is not None])
    return exact


def test_random_intervals_meet_every_kind_of_bound(rng):
    lo, hi = bounds(rng, np.float64, 500)
    with np.errstate(over="ignore"):
        kinds = [lo == hi, lo == -np.inf, hi == np.inf, (lo < 0) & (hi > 0), lo == 0, np.nextafter(lo, np.inf) == hi]
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


@pytest.mark.parametrize(("mode", "dtype"), [("eager", np.float64), ("jit", np.float32), ("jit", np.float64), ("vmap", np.float64)])
def test_pown_encloses_the_exact_power(rng, mode, dtype):
    x = draw(rng, dtype)
    for n, z in MODES[mode](powers)(x).items():
        assert not misses(z.lo, z.hi, ranges(lambda a, n=n: a**n if a or n >= 0 else None, x)), n


def floats_of(width):
    info = np.finfo(f"float{width}")
    special = [0.0, -0.0, *(s * float(v) for s in (1, -1) for v in (info.tiny, info.smallest_subnormal, info.max, np.inf, 1, 3, info.eps))]
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
    corner = [float(info.tiny), *(2.0**k for k in (info.maxexp // 2, info.maxexp - 2, info.maxexp - 1)), 0.95 * float(info.max), 3, 0.1]
    sizes = np.concatenate([corner, np.exp2(rng.uniform(info.maxexp - 3, info.maxexp - 0.1, count - len(corner)))])
    return (sizes * rng.choice([-1, 1], count)).astype(dtype)


@pytest.mark.parametrize("form", ["scalar", "broadcast", "constant"])
@each_dtype
def test_div_encloses_quotients_by_huge_divisors(rng, form, dtype):
    divisors = large_divisors(rng, dtype)
    a = np.concatenate([corners(dtype), floats(rng, dtype, 30)])
    x, exact = interval(a), lambda d: [[Fraction(v) / Fraction(float(d))] for v in a.tolist()]
    if form == "broadcast":
        z = jax.tree.map(np.asarray, jax.jit(sets.div)(Interval(a[:, None], a[:, None]), Interval(divisors[None, :], divisors[None, :])))
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
    "(0.1 * x) / 3 + (y / 1e30) / 1e30 + z / 1.7e38": lambda x, y, z: (0.1 * x) / 3 + (y / 1e30) / 1e30 + z / 1.7e38,
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
    ("chain", "dtype"), [(name, np.float64) for name in CHAINS] + [(name, np.float32) for name in list(CHAINS)[:3]], ids=str
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
        assert not misses(z.lo, z.hi, ranges(lambda v, b=Fraction(float(b)), c=Fraction(float(c)): exactly(f)(v, b, c), x))


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


FITTING = [((3,), (3,)), ((2, 3), (3,)), ((3,), (3, 4)), ((2, 3), (3, 4)), ((5, 2, 3), (3, 4)), ((5, 2, 3), (5, 3, 4)), ((5, 2, 3), (3,)),
           ((3,), (5, 3, 4)), ((2, 40), (40, 3))]  # fmt: skip


def samples(rng, x, y):
    """Return exact products of vertices, one tuple an entry."""
    drawn = [np.matmul(vertex(rng, x), vertex(rng, y)) for _ in range(6)]
    return np.shape(drawn[0]), list(zip(*(np.ravel(s) for s in drawn), strict=True))


def test_matmul_encloses_exact_products_of_any_fitting_shapes(rng):
    pairs = [(draw_matrix(rng, np.float64, *left), draw_matrix(rng, np.float64, *right)) for left, right in FITTING]
    found = jax.jit(lambda pairs: [sets.matmul(*pair) for pair in pairs])(pairs)
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


@pytest.mark.parametrize(("left", "right"), [((2, 3), (1,)), ((2, 3), (2, 3)), ((2, 3), ()), ((), (2,)), ((1,), (3,))])
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
    found = jax.jit(lambda x, y: (sets.neg(x), sets.abs(x), sets.min(x, y), sets.max(x, y), sets.hull(x, y), sets.intersection(x, y)))(x, y)
    for a, b, c, d, *got in ends(x, y, *found):
        assert tuple(got) == (
            *(-b, -a),
            *(0 if a <= 0 <= b else min(abs(a), abs(b)), max(abs(a), abs(b))),
            *(min(a, c), min(b, d)),
            *(max(a, c), max(b, d)),
            *(min(a, c), max(b, d)),
            *((max(a, c), min(b, d)) if max(a, c) <= min(b, d) else EMPTY),
        )


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
}  # fmt: skip


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
        Interval(*map(jnp.asarray, (np.full(COUNT, lo), np.full(COUNT, hi)))) for lo, hi in ((1.0, 2.0), EMPTY)
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


@pytest.mark.parametrize("n", [1.5, "2", None, True])
def test_pown_refuses_an_exponent_that_is_no_integer(n):
    with pytest.raises(TypeError, match="exponent must be an integer"):
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
    return [tuple(-BEYOND if v == -np.inf else BEYOND if v == np.inf else Fraction(v) for v in row) for row in ends(x)]


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
    for (a, b), big, small in zip(ends(x), *(jax.jit(f)(x).tolist() for f in (sets.mag, sets.mig)), strict=True):
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
    return Interval(*(jnp.asarray(v, dtype) for v in (np.where(lo == -3, -np.inf, lo), np.where(hi >= 3, np.inf, hi))))


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
    p = np.where(rng.random(COUNT) < 0.5, rng.choice(subnormals(dtype), COUNT), np.where(rng.random(COUNT) < 0.5, x.lo, x.hi)).astype(dtype)
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


# the factory


@pytest.mark.parametrize("value", [0.1, 1 / 3, 1e300, 1e-300, 2**24 + 1, Fraction(1, 3), "0.1"])
def test_numbers_are_enclosed_when_x64_is_off(value):
    with jax.enable_x64(False):
        x = interval(value)
        assert x.dtype == np.float32 and x.lo.tolist() <= Fraction(value) <= x.hi.tolist()
        with np.errstate(over="ignore"):
            assert np.nextafter(np.asarray(x.lo), np.float32(np.inf)) >= x.hi or value == 1e-300  # neighbours


def test_numbers_in_operations_are_enclosed_when_x64_is_off():
    with jax.enable_x64(False):
        for z, number in ((interval(0.0) + 0.1, 0.1), (1e-300 + interval(0.0), 1e-300)):
            assert z.dtype == np.float32 and z.lo.tolist() <= Fraction(number) <= z.hi.tolist()


@pytest.mark.parametrize("value", [Fraction(1, 3), "1/3", 2**53 + 1, 10**400, -(10**400), Fraction(1, 10**400)])
def test_exact_numbers_are_enclosed(value):
    x = interval(value)
    assert x.lo.tolist() <= Fraction(value) <= x.hi.tolist()


@pytest.mark.parametrize("run", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_integer_arrays_that_a_float_cannot_hold_are_enclosed(rng, run):
    n = np.concatenate([rng.integers(-(2**62), 2**62, COUNT - 6), [2**53 + 1, -(2**53) - 1, 2**53, 7, 0, -(2**63)]])
    x = run(interval)(jnp.asarray(n))
    assert not misses(x.lo, x.hi, [(v,) for v in n.tolist()])
    assert (x.wid[(n > -(2**52)) & (n < 2**52)] == 0).all()


@pytest.mark.parametrize("run", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_int32_arrays_are_enclosed_when_x64_is_off(run):
    n = [2**24 + 1, -(2**24) - 1, 2**31 - 1, 5]
    with jax.enable_x64(False):
        x = run(interval)(jnp.asarray(n, np.int32))
        assert not misses(x.lo, x.hi, [(v,) for v in n])


@each_dtype
def test_subnormal_bounds_move_outward(dtype):
    s, tiny = subnormals(dtype), np.finfo(dtype).tiny
    x = interval(s)
    assert np.asarray(x.lo).tolist() == np.where(s > 0, 0, -tiny).tolist()
    assert np.asarray(x.hi).tolist() == np.where(s > 0, tiny, 0).tolist()


@pytest.mark.parametrize("value", [np.float16(0.1), np.longdouble(1) / 3])
def test_other_float_types_are_enclosed(value):
    x = interval(value)
    assert x.dtype in DTYPES and x.lo.tolist() <= Fraction(*value.as_integer_ratio()) <= x.hi.tolist()


def test_half_precision_jax_arrays_become_float32():
    x = interval(jnp.array([0.1, 3], jnp.bfloat16))
    assert x.dtype == np.float32 and x.lo.tolist() == x.hi.tolist() == [0.10009765625, 3]


def test_bounds_broadcast_to_one_shape_and_the_wider_dtype():
    x = interval(np.float32(-1), np.ones((2, 3)))
    assert x.shape == x.hi.shape == (2, 3) and x.dtype == x.hi.dtype == np.float64


def test_an_interval_passes_through_the_factory():
    x = interval(1.0, 2.0)
    assert interval(x) is x


def test_an_interval_with_a_second_bound_is_refused():
    with pytest.raises(ValueError, match="already has an upper bound"):
        interval(interval(1.0), 2.0)


@pytest.mark.parametrize(
    ("lo", "hi", "message"),
    [
        ([1.0, np.nan], [2.0, 3.0], r"not NaN: 1 of 2 entries violate it, first at \(1,\)"),
        ([1.0, 2.0], [2.0, np.nan], r"not NaN: 1 of 2 entries violate it, first at \(1,\)"),
        (np.nan, None, r"not NaN: 1 of 1 entries violate it, first at \(\)"),
        ([[0.0, 1.0], [2.0, 3.0]], 0.5, r"lo must be <= hi: 3 of 4 entries violate it, first at \(0, 1\)"),
        (1.0, -np.inf, "lo must be <= hi: 1 of 1"),
        (np.inf, 0.0, "lo must be <= hi: 1 of 1"),
        ([0.0, np.inf], None, r"a point must be finite: 1 of 2 entries violate it, first at \(1,\)"),
        (-np.inf, -np.inf, "a point must be finite"),
    ],
)
def test_the_factory_refuses_bounds_that_are_no_interval(lo, hi, message):
    with pytest.raises(ValueError, match=message):
        interval(lo, hi)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_operations_refuse_numbers_that_are_not_finite(number):
    with pytest.raises(ValueError, match="not NaN|finite"):
        interval(1.0) + number


def test_empty_and_entire_exist():
    x = interval([np.inf, -np.inf, 1.0], [-np.inf, np.inf, 1.0])
    assert x.is_empty.tolist() == [True, False, False]


# operators, arrays, trees


@pytest.mark.parametrize("number", [3, 0.1, np.float64(0.1), np.float32(0.1), Fraction(1, 10), np.array([0.1, 3.0]), jnp.array([0.1, 3.0])])
@pytest.mark.parametrize("op", ["add", "sub", "mul", "div"])
def test_numbers_and_arrays_work_on_both_sides(number, op):
    x = Interval(*map(jnp.asarray, (np.resize([1.0, -3.0], COUNT), np.resize([2.0, -1.0], COUNT))))
    number = np.resize(number, COUNT) if np.ndim(number) else number
    exact = [Fraction(v) if isinstance(v, Fraction) else Fraction(float(v)) for v in np.broadcast_to(np.asarray(number), COUNT).tolist()]
    run = {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv}[op]
    for z, f in ((run(x, number), run), (run(number, x), lambda a, b: run(b, a))):
        assert isinstance(z, Interval) and z.shape == (COUNT,)
        points = [[f(m, v) for m in members(*row)] for row, v in zip(ends(x), exact, strict=True)]
        assert not misses(z.lo, z.hi, points)


def test_functions_take_two_plain_numbers():
    z = sets.add(0.1, 0.2)
    assert z.lo.tolist() <= Fraction(0.1) + Fraction(0.2) <= z.hi.tolist()


@each_dtype
def test_a_plain_number_takes_the_dtype_of_its_partner(dtype):
    assert (interval(dtype(1)) * 0.1).dtype == dtype and (2 - interval(dtype(1))).dtype == dtype


def test_operators_are_the_functions():
    x, y = interval([1.0, -2.0], [2.0, 3.0]), interval([0.5, 1.0], [0.75, 4.0])
    by_operators = jax.jit(lambda x, y: [x + y, x - y, x * y, x / y, -x, abs(x), x**3, x @ y])(x, y)
    by_functions = jax.jit(
        lambda x, y: [
            *(f(x, y) for f in (sets.add, sets.sub, sets.mul, sets.div)),
            *(sets.neg(x), sets.abs(x), sets.pown(x, 3), sets.matmul(x, y)),
        ]
    )(x, y)
    for got, want in zip(by_operators, by_functions, strict=True):
        assert got.lo.tolist() == want.lo.tolist() and got.hi.tolist() == want.hi.tolist()


def test_indexing_length_and_iteration_give_intervals():
    x = interval(np.arange(6.0).reshape(2, 3), np.arange(6.0).reshape(2, 3) + 1)
    assert len(x) == 2 and x[1, 2].hi == 6 and x[:, None].shape == (2, 1, 3)
    assert [row.lo.tolist() for row in x] == [[0, 1, 2], [3, 4, 5]]


def test_membership_by_the_in_operator_is_refused():
    with pytest.raises(TypeError):
        assert 2.0 in interval([1.0], [3.0])


def test_an_interval_is_a_tree_of_its_two_bounds():
    x = interval(1.0, 2.0)
    leaves, structure = jax.tree.flatten(x)
    assert leaves == [1, 2] and sets.equal(jax.tree.unflatten(structure, leaves), x)
    assert jax.tree.map(lambda v: v + 1, x).hi == 3


def test_vmap_maps_over_intervals_as_over_arrays(rng):
    x, y = draw(rng, np.float64), interval(2.0, 3.0)
    mapped = jax.jit(jax.vmap(sets.mul, in_axes=(0, None)))(x, y)
    assert sets.equal(mapped, jax.jit(sets.mul)(x, y)).all()


def test_the_bounds_of_a_polynomial_have_its_gradient():
    f = lambda a: (interval(a) ** 2 * 3 - interval(a) / 2).hi
    assert abs(jax.jit(jax.grad(f))(1.5) - (6 * 1.5 - 0.5)) < 1e-12


def test_gradients_of_products_and_quotients_are_finite_away_from_edges():
    def f(a, b):
        x, y = Interval(a, a + 1), Interval(b, b + 2)
        z = x * y - sets.recip(y) + x @ y
        return jnp.sum(z.hi - z.lo + z.mid)

    for g in jax.jit(jax.grad(f, (0, 1)))(jnp.array([1.0, -3.0]), jnp.array([2.0, 5.0])):
        assert np.isfinite(g).all() and (g != 0).any()


def test_scan_carries_an_interval():
    step = lambda x, _: (x * interval(0.5) + 1, None)
    last, _ = jax.lax.scan(step, interval(0.0, 1.0), length=60)
    assert last.lo <= 2 <= last.hi and last.wid < 1e-12


def test_a_second_call_does_not_trace():
    counted = Counted(lambda x, y: [binary(x, y), sets.matmul(x, y), sets.contains(x, y.lo), x.mid, x**3, x + 0.1])
    compiled = jax.jit(counted)
    for x in (np.ones(2), np.zeros(2)):
        compiled(Interval(x, x), Interval(x, x))
    assert counted.count == 1
