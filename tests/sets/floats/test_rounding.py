"""Bounds of compiled floating-point results, against exact rationals."""

import operator
from decimal import Decimal
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import DTYPES, MODES, Counted, corners, far, floats, misses, subnormals

from jaxbound.sets.floats import rounding

OPS = {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv}

each_dtype = pytest.mark.parametrize("dtype", DTYPES, ids=["float32", "float64"])
each_mode = pytest.mark.parametrize("mode", MODES)


def around(a, b, d):
    """Enclose the results of one operation each: a + b, a - b, a * b, a / d."""
    results = {op: run(a, d if op == "div" else b) for op, run in OPS.items()}
    return {op: rounding.outward(f, f) for op, f in results.items()}


def operands(rng, dtype, count=1200):
    """Draw points a, b and divisors d that outward speaks of: neither 0 nor beyond 2^(emax/2)."""
    a, b = (
        np.concatenate([x.ravel(), floats(rng, dtype, count)])[:count]
        for x in np.meshgrid(corners(dtype), corners(dtype))
    )
    d = np.concatenate([np.repeat(corners(dtype), len(corners(dtype))), floats(rng, dtype, 3 * count)])
    return a, b, d[(d != 0) & (abs(d) <= 2.0 ** (np.finfo(dtype).maxexp // 2))][:count]


def exactly(op, a, b, d):
    """Return the exact results of one operation on arrays of floats, one tuple an entry."""
    other = d if op == "div" else b
    return [
        (OPS[op](Fraction(x), Fraction(y)),)
        for x, y in zip(np.ravel(a).tolist(), np.ravel(other).tolist(), strict=True)
    ]


def missed(bounds, *points):
    """Return what the bounds fail to hold, over all operations."""
    return [miss for op, (lo, hi) in bounds.items() for miss in misses(lo, hi, exactly(op, *points))]


@each_dtype
def test_unit_is_half_the_spacing_of_floats_at_one(dtype):
    u = rounding.unit(dtype)
    assert u.dtype == dtype and Fraction(float(np.nextafter(dtype(1), dtype(2)))) - 1 == 2 * Fraction(
        float(u)
    )


@each_dtype
def test_tiny_is_the_smallest_normal_number(dtype):
    t = rounding.tiny(dtype)
    assert t.dtype == dtype and Fraction(float(t)) == Fraction(2) ** (-126 if dtype == np.float32 else -1022)


@each_mode
@each_dtype
def test_outward_encloses_the_exact_result_on_points(rng, mode, dtype):
    points = operands(rng, dtype)
    bounds = MODES[mode](around)(*points)
    assert bounds["div"][0].dtype == dtype and not missed(bounds, *points)


@each_dtype
def test_outward_encloses_results_with_a_broadcast_operand(rng, dtype):
    a, b, d = operands(rng, dtype)
    a, b, d = a[-40:, None], rng.choice(b, (1, 40)), rng.choice(d, (1, 40))
    assert not missed(jax.jit(around)(a, b, d), *np.broadcast_arrays(a, b, d))


@each_dtype
def test_outward_encloses_results_with_a_traced_scalar_operand(rng, dtype):
    a, b, d = operands(rng, dtype)
    kernel = jax.jit(around)
    for i in rng.integers(0, len(a), 4):
        assert not missed(kernel(a, b[i], d[i]), a, np.full_like(a, b[i]), np.full_like(a, d[i]))


@each_dtype
def test_outward_encloses_results_with_a_compiled_constant(rng, dtype):
    a, b, d = operands(rng, dtype)
    constants = [(b[i], d[i]) for i in rng.integers(0, len(a), 3)]
    for bounds, (one, other) in zip(
        jax.jit(lambda a: [around(a, *c) for c in constants])(a), constants, strict=True
    ):
        assert not missed(bounds, a, np.full_like(a, one), np.full_like(a, other))


@each_dtype
def test_outward_stays_within_nine_units_of_the_exact_result(rng, dtype):
    points = operands(rng, dtype)
    u, tiny, top = (
        Fraction(float(x)) for x in (rounding.unit(dtype), rounding.tiny(dtype), np.finfo(dtype).max)
    )
    for op, (lo, hi) in jax.jit(around)(*points).items():
        exact = exactly(op, *points)
        fits = np.array([abs(v) < top * Fraction(99, 100) for (v,) in exact])
        ranges = [(v, v) for (v,), keep in zip(exact, fits, strict=True) if keep]
        assert fits.sum() > 100 and not far(
            np.asarray(lo)[fits], np.asarray(hi)[fits], ranges, 9 * u, 4 * tiny
        )


@pytest.mark.parametrize("mode", ["jit", "vmap"])
@each_dtype
def test_a_bound_that_overflowed_falls_back_to_the_largest_float(mode, dtype):
    top = np.finfo(dtype).max
    big = np.array([np.inf, -np.inf], dtype)
    lo, hi = MODES[mode](rounding.outward)(big, big)
    assert lo.tolist() == [top, -np.inf] and hi.tolist() == [np.inf, -top]


def terms(rng, dtype, count, rows=8):
    """Draw rows of summands: one size, many sizes, and a large cancellation."""
    x = rng.normal(size=(rows, count)) * 10.0 ** rng.integers(-6, 7, (rows, count))
    x[: rows // 2] = rng.uniform(0.5, 1.5, (rows // 2, count))
    x[-1] -= x[-1].sum() / count
    return x.astype(dtype)


def exact_sums(x):
    return [(sum(map(Fraction, row)),) for row in np.asarray(x, np.float64).tolist()]


@pytest.mark.parametrize(
    ("count", "mode"), [(1, "jit"), (7, "eager"), (7, "vmap"), (40, "vmap"), (400, "jit")]
)
@each_dtype
def test_outward_sum_encloses_the_exact_sum(rng, count, mode, dtype):
    x = terms(rng, dtype, count)
    lo, hi = MODES[mode](lambda row: rounding.outward_sum(row, row, row.ndim - 1))(x)
    assert lo.dtype == dtype and not misses(lo, hi, exact_sums(x))


@each_dtype
@pytest.mark.parametrize("order", ["forward", "backward", "pairs"])
def test_outward_sum_holds_for_any_order_of_addition(rng, monkeypatch, order, dtype):
    count = 1500 + len(order)  # a shape of its own: the order is compiled in
    x = terms(rng, dtype, count)
    x[0] = rounding.unit(dtype)  # added one by one to a first 1, every term is lost
    x[0, 0] = 1
    x[1], x[2, ::-1] = -x[0], x[0]

    def one_by_one(x, axis):
        if order == "pairs":
            while x.shape[axis] > 1:
                x = x[:, ::2] + jnp.pad(x[:, 1::2], [(0, 0), (0, x.shape[axis] % 2)])
            return x[:, 0]
        x = x[:, ::-1] if order == "backward" else x
        return jax.lax.scan(lambda s, v: (s + v, None), jnp.zeros_like(x[:, 0]), x.T)[0]

    monkeypatch.setattr(rounding.jnp, "sum", one_by_one)
    lo, hi = jax.jit(lambda x: rounding.outward_sum(x, x, 1))(x)
    assert not misses(lo, hi, exact_sums(x))


@each_dtype
def test_outward_sum_of_a_million_equal_terms_encloses(dtype):
    x = jnp.full((1, 1_000_000), 0.1, dtype)
    lo, hi = rounding.outward_sum(x, x, 1)
    assert not misses(lo, hi, [(Fraction(float(dtype(0.1))) * 1_000_000,)])


@pytest.mark.parametrize("mode", ["jit", "vmap"])
def test_outward_sum_whose_partial_sums_overflow_is_unbounded(mode):
    x = np.array([[1e308, 1e308, -1e308, -1e308] * k for k in (1, 1)])
    lo, hi = MODES[mode](lambda row: rounding.outward_sum(row, row, row.ndim - 1))(x)
    assert (lo == -np.inf).all() and (hi == np.inf).all()


def test_outward_sum_keeps_infinite_bounds_and_the_other_side_finite():
    lo, hi = rounding.outward_sum(jnp.array([-np.inf, 1.0]), jnp.array([2.0, 3.0]), 0)
    assert lo == -np.inf and 5 <= hi < 5 + 1e-14


def test_outward_sum_of_more_terms_than_its_bound_covers_is_unbounded():
    lo, hi = rounding.outward_sum(*(jnp.ones(2**23, jnp.float32),) * 2, 0)
    assert (lo, hi) == (-np.inf, np.inf)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_outward_sum_adds_along_the_axis_asked_for(rng, axis):
    x = rng.normal(size=(3, 4, 5))
    lo, hi = rounding.outward_sum(jnp.asarray(x), jnp.asarray(x), axis)
    assert not misses(lo, hi, exact_sums(np.moveaxis(x, axis, -1).reshape(-1, x.shape[axis])))


def test_outward_sum_of_no_terms_encloses_zero():
    lo, hi = rounding.outward_sum(jnp.zeros((3, 0)), jnp.zeros((3, 0)), 1)
    assert lo.shape == (3,) and not misses(lo, hi, [(Fraction(0),)] * 3)


@each_dtype
@pytest.mark.parametrize("count", [3, 100])
def test_outward_sum_is_no_wider_than_its_bound(rng, count, dtype):
    x = terms(rng, dtype, count)
    lo, hi = rounding.outward_sum(jnp.asarray(x), jnp.asarray(x), 1)
    u = Fraction(float(rounding.unit(dtype)))
    for a, b, row in zip(lo.tolist(), hi.tolist(), np.asarray(x, np.float64).tolist(), strict=True):
        assert Fraction(b) - Fraction(a) <= (4 * count + 20) * u * sum(map(abs, map(Fraction, row)))


def rationals(rng, dtype, count=300):
    """Draw exact numbers: floats of the dtype, numbers an instant beside them, and numbers beyond its
    range.
    """
    near = [
        Fraction(float(x))
        for x in np.concatenate([corners(dtype), subnormals(dtype), floats(rng, dtype, count)])
    ]
    beside = [x * (1 + Fraction(s, 10**30)) for x in near for s in (-1, 1)]
    between = [(x + Fraction(float(np.nextafter(dtype(x), dtype(0))))) / 2 for x in near]
    return (
        near
        + beside
        + between
        + [Fraction(1, 10**500), -Fraction(1, 10**500), Fraction(10) ** 500, -(Fraction(10) ** 500)]
    )


@each_dtype
def test_round_up_gives_the_least_float_above(rng, dtype):
    exact = rationals(rng, dtype)
    up = rounding.round_up(exact, dtype)
    assert up.dtype == dtype and all(f >= v for f, v in zip(up.tolist(), exact, strict=True))
    with np.errstate(all="ignore"):
        below = np.nextafter(up, dtype(-np.inf))
    assert all(f < v for f, v in zip(below.tolist(), exact, strict=True))


@each_dtype
def test_round_down_gives_the_largest_float_below(rng, dtype):
    exact = rationals(rng, dtype)
    down = rounding.round_down(exact, dtype)
    assert down.dtype == dtype and all(f <= v for f, v in zip(down.tolist(), exact, strict=True))
    with np.errstate(all="ignore"):
        above = np.nextafter(down, dtype(np.inf))
    assert all(f > v for f, v in zip(above.tolist(), exact, strict=True))


def test_float64_arrays_are_rounded_to_float32_in_the_direction_asked_for(rng):
    x = np.concatenate(
        [floats(rng, np.float64, 2000), [np.inf, -np.inf, 0.1, 1e300, -1e300, 1e-300]]
    ).reshape(2, -1)
    down, up = rounding.round_down(x, np.float32), rounding.round_up(x, np.float32)
    assert down.shape == up.shape == x.shape and down.dtype == up.dtype == np.float32
    assert (down <= x).all() and (x <= up).all()
    with np.errstate(all="ignore"):
        assert (
            np.where(down == x, down, np.nextafter(down, np.float32(np.inf))) == up
        ).all()  # neighbours, or x itself


@pytest.mark.parametrize("value", ["0.1", "1/3", Decimal("0.1"), Fraction(1, 3), 2**53 + 1, 10**400, True])
def test_directed_rounding_reads_any_exact_number(value):
    exact = Fraction(value)
    assert rounding.round_down(value).tolist() <= exact <= rounding.round_up(value).tolist()
    assert exact == 1 or rounding.round_down(value) < rounding.round_up(value)


def test_directed_rounding_keeps_nan_and_shape():
    assert np.isnan(rounding.round_up(np.nan)) and rounding.round_up(np.zeros((2, 0, 3))).shape == (2, 0, 3)
    assert rounding.round_down([[Fraction(1), Fraction(2)]]).shape == (1, 2)
    assert rounding.round_down(np.zeros((0, 2), object), np.float32).dtype == np.float32


@each_dtype
def test_fraction_to_float_rounds_to_nearest(rng, dtype):
    tiny, largest = (Fraction(float(end)) for end in (np.finfo(dtype).tiny, np.finfo(dtype).max))
    normal = [v for v in rationals(rng, dtype, 100) if tiny <= abs(v) <= largest]
    assert len(normal) > 100
    for v in normal:
        f = rounding.fraction_to_float(v, dtype)
        assert f.dtype == dtype
        # through float64, a float32 can be off by a double rounding: half a unit of float64 more
        slack = Fraction(0) if dtype == np.float64 else Fraction(abs(float(f))) * Fraction(1, 2**52)
        with np.errstate(all="ignore"):
            beside = [
                Fraction(float(np.nextafter(f, dtype(s * np.inf))))
                for s in (-1, 1)
                if abs(f) < np.finfo(dtype).max
            ]
        assert all(abs(Fraction(float(f)) - v) <= abs(g - v) + slack for g in beside)


@pytest.mark.parametrize(
    ("value", "dtype"),
    [
        (Fraction(1, 10**300), np.float32),
        (-Fraction(1, 10**39), np.float32),
        (Fraction(1, 10**309), np.float64),
        (Fraction(1, 10**500), np.float64),
        (Fraction(10) ** 39, np.float32),
        (Fraction(10) ** 309, np.float64),
        (-(Fraction(10) ** 500), np.float32),
    ],
)
def test_fraction_to_float_refuses_what_the_dtype_cannot_hold(value, dtype):
    with pytest.raises(ValueError, match=f"coefficient.* {np.dtype(dtype).name}"):
        rounding.fraction_to_float(value, dtype)


def test_fraction_to_float_of_zero_is_zero():
    assert rounding.fraction_to_float(Fraction(0), np.float32) == 0


@each_mode
@each_dtype
def test_settle_moves_subnormals_outward_where_reading_them_as_0_would_not(mode, dtype):
    x, tiny = subnormals(dtype), np.finfo(dtype).tiny
    lo, hi = map(np.asarray, MODES[mode](rounding.settle_subnormals)(x, x))
    assert (
        lo.tolist() == np.where(x > 0, x, -tiny).tolist() and hi.tolist() == np.where(x > 0, tiny, x).tolist()
    )


@each_mode
@each_dtype
def test_settle_leaves_all_other_floats_as_they_are(rng, mode, dtype):
    x = np.concatenate([corners(dtype), floats(rng, dtype, 500), np.array([np.inf, -np.inf, np.nan], dtype)])
    bits = {4: np.int32, 8: np.int64}[x.itemsize]
    for end in MODES[mode](rounding.settle_subnormals)(x, x):
        assert (np.asarray(end).view(bits) == x.view(bits)).all()


def pairs(rng, dtype, exponent, count=4000):
    """Draw pairs whose sizes differ by up to 2^exponent, and pairs that cancel."""
    a, b = ((rng.uniform(1, 2, count) * rng.choice([-1, 1], count)).astype(dtype) for _ in range(2))
    b = np.ldexp(b, rng.integers(-exponent, exponent + 1, count))
    b[::4] = -a[::4] * dtype(1 + np.finfo(dtype).eps)
    return a, b.astype(dtype)


@each_mode
@each_dtype
def test_two_sum_is_exact(rng, mode, dtype):
    a, b = pairs(rng, dtype, 60)
    s, e = MODES[mode](rounding.two_sum)(a, b)
    for x, y, big, small in zip(*(np.asarray(v).tolist() for v in (a, b, s, e)), strict=True):
        assert Fraction(big) + Fraction(small) == Fraction(x) + Fraction(y) and big == dtype(
            Fraction(x) + Fraction(y)
        )


@each_mode
@each_dtype
def test_two_prod_is_exact(rng, mode, dtype):
    a, b = pairs(rng, dtype, 20)
    p, e = MODES[mode](rounding.two_prod)(a, b)
    for x, y, big, small in zip(*(np.asarray(v).tolist() for v in (a, b, p, e)), strict=True):
        assert Fraction(big) + Fraction(small) == Fraction(x) * Fraction(y)


@each_dtype
def test_two_sum_and_two_prod_with_a_constant_are_exact(rng, dtype):
    x, _ = pairs(rng, dtype, 8, 1000)
    for c in (dtype(1), dtype(0.1), dtype(-37000)):
        results = jax.jit(
            lambda x, c=c: [
                *rounding.two_sum(c, x),
                *rounding.two_sum(x, c),
                *rounding.two_prod(c, x),
                *rounding.two_prod(x, c),
            ]
        )(x)
        for v, *parts in zip(x.tolist(), *(r.tolist() for r in results), strict=True):
            s, e, t, f, p, g, q, h = map(Fraction, parts)
            assert s + e == t + f == Fraction(float(c)) + Fraction(v) and p + g == q + h == Fraction(
                float(c)
            ) * Fraction(v)


def dot(x, y):
    """Return sum x_i y_j of (k,) and (m,) for each j as double words, in a loop: the sum of exact products,
    each added without error.
    """

    def body(i, total):
        s, e = total
        p, f = rounding.two_prod(x[i], y)
        s, g = rounding.two_sum(s, p)
        return s, e + (f + g)

    return jax.lax.fori_loop(0, x.shape[0], body, (jnp.zeros_like(y), jnp.zeros_like(y)))


@each_dtype
def test_products_in_a_batched_loop_keep_twice_the_digits(rng, dtype):
    x, y = rng.normal(size=(40, 10)).astype(dtype), rng.normal(size=(40, 7)).astype(dtype)
    hi, lo = jax.jit(jax.vmap(dot))(x, y)
    u = Fraction(float(rounding.unit(dtype)))
    for row, column, highs, lows in zip(*(v.tolist() for v in (x, y, hi, lo)), strict=True):
        for b, h, low in zip(column, highs, lows, strict=True):
            products = [Fraction(a) * Fraction(b) for a in row]
            assert abs(Fraction(h) + Fraction(low) - sum(products)) <= 40 * u**2 * sum(map(abs, products))


def double(rng, dtype, exponent, count=3000):
    """Draw normalised double-word numbers: lo is at most half of the last digit of hi."""
    hi = np.ldexp(pairs(rng, dtype, 1, count)[0], rng.integers(-exponent, exponent + 1, count)).astype(dtype)
    return hi, (np.spacing(np.abs(hi)) * rng.uniform(-0.5, 0.5, count)).astype(dtype)


def worst(x, y, z, op):
    """Return the largest relative error of double-word results in units of u^2."""
    u = Fraction(float(np.finfo(z[0].dtype).eps)) / 2
    exact = lambda v: [
        Fraction(a) + Fraction(b) for a, b in zip(*(np.asarray(w).tolist() for w in v), strict=True)
    ]
    rows = zip(exact(x), exact(y), exact(z), strict=True)
    return float(max(abs(c - op(a, b)) / abs(op(a, b)) for a, b, c in rows if op(a, b)) / u**2)


@each_mode
@each_dtype
def test_dd_add_is_accurate_to_three_squared_units(rng, mode, dtype):
    x, y = double(rng, dtype, 4), double(rng, dtype, 4)
    y[0][::3], y[1][::3] = -x[0][::3] * dtype(1 + np.finfo(dtype).eps), x[1][::3]  # cancellation
    assert worst(x, y, MODES[mode](rounding.dd_add)(x, y), operator.add) <= 3.01


@each_mode
@each_dtype
def test_dd_mul_is_accurate_to_seven_squared_units(rng, mode, dtype):
    x, y = double(rng, dtype, 4), double(rng, dtype, 4)
    assert worst(x, y, MODES[mode](rounding.dd_mul)(x, y), operator.mul) <= 7


def test_a_second_call_does_not_trace():
    kernels = [rounding.outward, rounding.settle_subnormals, rounding.two_sum, rounding.two_prod]
    counted = Counted(lambda a, b: [kernel(a, b) for kernel in kernels])
    compiled = jax.jit(counted)
    for x in (np.ones(3), np.zeros(3)):
        compiled(x, x)
    assert counted.count == 1
