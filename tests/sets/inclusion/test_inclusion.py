"""Inclusion functions hold the exact range of functions of known range, by every method, compiled and not, in
both precisions.
"""

import flint
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import DTYPES
from inclusion_cases import CASES, misses, values_at

from jaxbound.sets import Interval, inclusion, interval
from jaxbound.sets.inclusion.inclusion import METHODS

FEW = [c for c in CASES if c.name in ("parabola", "figure 1", "van der pol step", "where")]
MODES = {
    "call": lambda F: F,
    "jit": jax.jit,
    "vmap": lambda F: lambda box: jax.tree.map(lambda v: v[1], jax.vmap(F)(_twice(box))),
}


@pytest.fixture(autouse=True)
def precision():
    with flint.ctx.workprec(200):
        yield


def _twice(box):
    return jax.tree.map(lambda v: jnp.stack([v, v]), box)


def box_of(case, dtype=np.float64):
    return interval(np.array(case.lo, dtype), np.array(case.hi, dtype))


def ends(enclosed):
    return list(zip(np.atleast_1d(enclosed.lo).tolist(), np.atleast_1d(enclosed.hi).tolist(), strict=True))


def check(case, enclosed, rng, count=30):
    """Assert that the extremes and the images of random points lie inside."""
    found = ends(enclosed)
    for points in (case.least, case.greatest):
        for k, value in enumerate(values_at(case, points)):
            assert not misses(found[k], value[k]), (case.name, k, found[k], value[k])
    z = np.clip(rng.uniform(case.lo, case.hi, (count, len(case.lo))), case.lo, case.hi)
    for point, value in zip(z, values_at(case, z.tolist()), strict=True):
        assert len(value) == len(found)
        assert not any(misses(e, v) for e, v in zip(found, value, strict=True)), (
            case.name,
            point,
            found,
            value,
        )


HEAVY = (
    "tanh network",
    "small differences",
    "log sum exp",
    "angle",
    "remainder",
    "saturation",
    "sigmoid",
    "sine cosine",
    "norm",
    "power",
)
BRIEF = [
    c for c in CASES if c in FEW or c.name in ("cubic", "rational", "root", "product", "rectifier", "clip")
]  # all of them: below
BY_XLA = pytest.mark.compiled
LIGHT = [pytest.param(c, marks=(pytest.mark.long, BY_XLA)) if c.name in HEAVY else c for c in CASES]


@pytest.mark.parametrize("case", LIGHT, ids=str)
def test_natural_holds_the_range(case, rng):
    check(case, inclusion(case.f)(box_of(case)), rng)


@pytest.mark.parametrize("case", BRIEF, ids=str)
def test_best_holds_the_range_and_is_never_wider_than_natural(case, rng):
    sharp, natural = inclusion(case.f, "best")(box_of(case)), inclusion(case.f)(box_of(case))
    check(case, sharp, rng)
    assert (sharp.lo >= natural.lo).all() and (sharp.hi <= natural.hi).all()


@pytest.mark.parametrize(
    "case, dtype",
    [
        pytest.param(
            c,
            d,
            id=f"{c}-{np.dtype(d)}",
            marks=()
            if c.name == "parabola" and d == np.float32
            else (pytest.mark.long, pytest.mark.compiled),
        )
        for c in CASES
        for d in DTYPES
    ],
)
def test_every_method_holds_the_range_and_best_is_never_wider(case, dtype, rng):
    natural, mean_value, best = (inclusion(case.f, method)(box_of(case, dtype)) for method in METHODS)
    for enclosed in (natural, mean_value, best):
        assert enclosed.dtype == dtype
        check(case, enclosed, rng, 100)
    assert (best.lo >= natural.lo).all() and (best.hi <= natural.hi).all()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("case", FEW[1:3], ids=str)
def test_ranges_hold_under_jit_and_vmap(case, mode, rng):
    check(case, MODES[mode](inclusion(case.f))(box_of(case)), rng)


MONOTONE = {c.name: c for c in CASES if c.name in ("figure 1", "two double tanks")}


@pytest.mark.parametrize(
    "case",
    [MONOTONE["figure 1"], pytest.param(MONOTONE["two double tanks"], marks=pytest.mark.long)],
    ids=str,
)
def test_best_is_exact_to_rounding_where_every_variable_is_monotone(case):
    found = ends(inclusion(case.f, "best")(box_of(case)))
    least, greatest = (values_at(case, points) for points in (case.least, case.greatest))
    for k, (lo, hi) in enumerate(found):
        a, b = float(least[k][k].mid()), float(greatest[k][k].mid())
        assert a - lo <= 1e-13 * max(1, abs(a)) and hi - b <= 1e-13 * max(1, abs(b))


def excess(method, f, middle, width):
    """Return how much wider than the range of an increasing f its enclosure is."""
    box = interval(np.array([middle - width / 2]), np.array([middle + width / 2]))
    found = inclusion(f, method)(box)
    return float(found.hi - found.lo) - float(f(box.hi) - f(box.lo))


def test_mean_value_converges_with_the_square_of_the_width():
    f = lambda z: z[0] * jnp.exp(-z[0]) * z[0] + z[0]
    widths = 2.0 ** -np.arange(2, 9)
    order = lambda method: (
        np.diff(np.log2([excess(method, f, 1.5, w) for w in widths])) / np.diff(np.log2(widths))
    )
    assert (order("mean_value") > 1.85).all() and (order("mean_value") < 2.3).all()
    assert (order("natural") < 1.2).all()


def test_jacobian_holds_the_slopes_and_the_kinks():
    F = inclusion(lambda z: jnp.stack([z[0] * z[1], abs(z[0]), jnp.maximum(z[0], z[1])]), "best")
    J = F.jacobian(interval([-1.0, 1.0], [2.0, 3.0]))
    assert (J.lo <= np.array([[1, -1], [-1, 0], [0, 0]])).all() and (
        J.hi >= np.array([[3, 2], [1, 0], [1, 1]])
    ).all()
    assert (J.hi - J.lo <= np.array([[2, 3], [2, 0], [1, 1]]) + 1e-12).all()


BROKEN = {
    "floor": lambda z: jnp.floor(z[0]),
    "where": lambda z: jnp.where(z[0] > 0, 1.0, 0.0) + z[0],
    "sign": lambda z: jnp.sign(z[0]) * z[0],
    "division": lambda z: 1 / z[0],
    "predicate": lambda z: (z[0] > 0) * 1.0,
    "integer": lambda z: (2 * z[0]).astype(int) * 1.0,
    "remainder": lambda z: z[0] % 0.5,
    "cond": lambda z: jax.lax.cond(z[0] > 0.25, lambda: 1.0, lambda: z[0]),
    "root": lambda z: jnp.sqrt(z[0]),
    "stopped": lambda z: jax.lax.stop_gradient(jnp.floor(z[0])),
}


@pytest.mark.parametrize(
    "f",
    [
        pytest.param(f, id=name, marks=() if name in ("floor", "root", "stopped") else pytest.mark.long)
        for name, f in BROKEN.items()
    ],
)
def test_where_continuity_is_not_proved_derivatives_are_not_used(f):
    box = interval([-0.75], [0.875])
    F = inclusion(f, "best")
    assert not F.continuous(box)
    J, natural, best = F.jacobian(box), inclusion(f)(box), F(box)
    assert (J.lo == -np.inf).all() and (J.hi == np.inf).all()
    assert best.lo == natural.lo and best.hi == natural.hi


@jax.custom_jvp
def liar(x):
    return x**2


liar.defjvp(lambda primals, tangents: (primals[0] ** 2, 0.0 * tangents[0]))


@jax.custom_vjp
def other_liar(x):
    return x**2


other_liar.defvjp(lambda x: (x**2, None), lambda _, g: (0.0 * g,))


@pytest.mark.parametrize(
    "f",
    [
        pytest.param(liar, id="custom_jvp", marks=pytest.mark.long),
        pytest.param(other_liar, id="custom_vjp"),
        pytest.param(lambda x: jax.lax.stop_gradient(x) ** 2, id="stop_gradient", marks=pytest.mark.long),
    ],
)
def test_a_derivative_that_is_not_that_of_the_function_is_not_believed(f):
    box = interval([1.0], [2.0])
    found = inclusion(lambda z: f(z[0]), "mean_value")(box)
    assert found.lo <= 1 and found.hi >= 4
    inside = inclusion(
        lambda z: jax.lax.scan(lambda c, _: (c + f(z[0]), None), 0.0, None, length=3)[0], "mean_value"
    )(box)
    assert inside.lo <= 3 and inside.hi >= 12


def test_a_square_root_of_a_square_has_a_slope_even_where_its_formula_has_none():
    f = lambda z: jnp.sqrt(z[0] ** 2) + z[1]
    found = inclusion(f, "best")(interval([0.0, 0.0], [0.0, 1.0]))
    assert found.lo <= 0 and found.hi >= 1


def test_a_float32_box_inside_jit_keeps_its_subnormal_bounds_beside_float64():
    tiny = jnp.full((), -1e-40, jnp.float32)
    found = jax.jit(inclusion(lambda x, y: x.astype(y.dtype) * y))(Interval(tiny, tiny), interval(1e30, 1e30))
    assert found.lo <= float(tiny) * 1e30
