"""How intervals are built, and how they behave as numbers, arrays and trees."""

import operator
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import DTYPES, Counted, members, misses, subnormals
from interval_cases import (
    COUNT,
    binary,
    draw,
    each_dtype,
    ends,
)

from jaxbound import sets
from jaxbound.sets import interval
from jaxbound.sets.intervals.interval import Interval

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


@pytest.mark.parametrize(
    "value", [Fraction(1, 3), "1/3", 2**53 + 1, 10**400, -(10**400), Fraction(1, 10**400)]
)
def test_exact_numbers_are_enclosed(value):
    x = interval(value)
    assert x.lo.tolist() <= Fraction(value) <= x.hi.tolist()


@pytest.mark.parametrize("run", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_integer_arrays_that_a_float_cannot_hold_are_enclosed(rng, run):
    n = np.concatenate(
        [rng.integers(-(2**62), 2**62, COUNT - 6), [2**53 + 1, -(2**53) - 1, 2**53, 7, 0, -(2**63)]]
    )
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
def test_subnormal_bounds_move_outward_where_reading_them_as_0_would_not(dtype):
    s, tiny = subnormals(dtype), np.finfo(dtype).tiny
    x = interval(s)
    assert np.asarray(x.lo).tolist() == np.where(s > 0, s, -tiny).tolist()
    assert np.asarray(x.hi).tolist() == np.where(s > 0, tiny, s).tolist()


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


@pytest.mark.parametrize(
    "number",
    [3, 0.1, np.float64(0.1), np.float32(0.1), Fraction(1, 10), np.array([0.1, 3.0]), jnp.array([0.1, 3.0])],
)
@pytest.mark.parametrize("op", ["add", "sub", "mul", "div"])
def test_numbers_and_arrays_work_on_both_sides(number, op):
    x = Interval(*map(jnp.asarray, (np.resize([1.0, -3.0], COUNT), np.resize([2.0, -1.0], COUNT))))
    number = np.resize(number, COUNT) if np.ndim(number) else number
    exact = [
        Fraction(v) if isinstance(v, Fraction) else Fraction(float(v))
        for v in np.broadcast_to(np.asarray(number), COUNT).tolist()
    ]
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


@pytest.mark.parametrize("number", [0.1, 0.3, -0.7, 2**24 + 1, 1e300, 1e-300])
def test_a_plain_number_that_the_dtype_cannot_hold_is_enclosed_by_operations_without_rounding(number):
    hull = sets.hull(interval(np.float32(0)), number)
    assert hull.dtype == np.float32 and hull.lo.tolist() <= Fraction(number) <= hull.hi.tolist()


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
    counted = Counted(
        lambda x, y: [binary(x, y), sets.matmul(x, y), sets.contains(x, y.lo), x.mid, x**3, x + 0.1]
    )
    compiled = jax.jit(counted)
    for x in (np.ones(2), np.zeros(2)):
        compiled(Interval(x, x), Interval(x, x))
    assert counted.count == 1


def test_bounds_from_numpy_compile_nothing():
    found = []

    def listen(event, seconds, **about):
        if event == "/jax/core/compile/backend_compile_duration":
            found.append(about)

    lo = np.arange(3 * 7 * 13.0).reshape(3, 7, 13)  # a shape that no other test has
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        x = interval(lo, lo + 1)
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    assert found == [] and x.lo.shape == (3, 7, 13)


@pytest.mark.parametrize(
    "build",
    [
        lambda: Interval([1.0, 2.0], [3.0, 4.0]),
        lambda: Interval((1.0, 2.0), (3.0, 4.0)),
        lambda: sets.Zonotope([0.0], [[1.0]]),
        lambda: sets.ConstrainedZonotope(np.zeros(1), np.eye(1), [[1.0]], [0.5]),
    ],
)
def test_a_class_refuses_lists_and_says_what_takes_them(build):
    with pytest.raises(
        TypeError,
        match="needs arrays, and .* is a (list|tuple): build it with "
        "(interval|zonotope|constrained_zonotope)",
    ):
        build()


def test_trees_of_anything_else_are_built():
    x = interval([1.0, 2.0], [3.0, 4.0])
    assert (
        jax.tree.map(np.shape, x).lo == (2,)
        and jax.tree.unflatten(jax.tree.structure(x), [None, object()]).lo is None
    )
