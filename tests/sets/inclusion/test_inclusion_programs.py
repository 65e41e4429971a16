"""What a function may contain: structures, integers, predicates, control flow, indexing; and what is refused,
in one sentence.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import Counted
from flint import arb

from jaxbound.sets import Interval, inclusion, interval
from jaxbound.sets.floats.kernel import kernel

X = interval(np.array([0.25, -0.5, 2.0]), np.array([0.5, -0.25, 2.5]))


def samples(rng, count=200):
    """Points of X, its corners among them; the functions below are evaluated at them in floats, to which a
    tolerance belongs.
    """
    z = rng.uniform(np.asarray(X.lo), np.asarray(X.hi), (count, 3))
    corner = rng.choice([0, 1], z.shape) * (np.asarray(X.hi) - np.asarray(X.lo)) + np.asarray(X.lo)
    return np.concatenate([z, corner])


def table(z):
    return jnp.asarray([3.0, 1.0, 2.0], z.dtype)[jnp.array([2, 0, 1])] * z


def dynamic(z):
    return jax.lax.fori_loop(0, 3, lambda i, c: c.at[i].set(c[i] * z[(i + 1) % 3]), z)


def counted_steps(z):
    x, n = jax.lax.while_loop(lambda s: s[1] < 5, lambda s: (s[0] * z[0] + z[1], s[1] + 1), (z[2], 0))
    return x + n


def undecided_loop(z):
    x, n = jax.lax.while_loop(lambda s: s[0] < 10, lambda s: (s[0] * z[2], s[1] + 1), (z[2], 0))
    return jnp.stack([x, n * 1.0])


def sorted_values(z):
    return jnp.sort(z)[::-1]


def nested(z):
    inner = jax.vmap(lambda a: jax.jit(lambda b: b * jnp.sum(z))(a))
    return jax.checkpoint(lambda v: inner(v) - v)(z)


PROGRAMS = {
    "constants": lambda z: (z @ np.array([[1.0, 2], [0, 1], [0.5, 0]])) + np.pi,
    "table": table,
    "dynamic index": dynamic,
    "loop with a counter": counted_steps,
    "loop that ends by an interval": undecided_loop,
    "sort": sorted_values,
    "vmap, jit and checkpoint inside": nested,
    "integers": lambda z: z * jnp.arange(3) ** 2 + (jnp.arange(3) // 2) % 2,
    "counting": lambda z: jnp.sum(z > 0) + 0.0 * z[0],
    "predicates": lambda z: jnp.where((z > 0) & ~(z < 0.3) | (z == 2), z, -z),
    "reductions": lambda z: jnp.stack(
        [jnp.prod(z), jnp.mean(z), jnp.var(z), jnp.min(z), jnp.max(abs(z)), jnp.any(z > 3) * 1.0]
    ),
    "relu network": lambda z: jax.nn.relu(jnp.ones((2, 3)) @ z - 2.0),
    "softplus": lambda z: jax.nn.softplus(z) + jnp.logaddexp(z, z[::-1]),
    "einsum": lambda z: jnp.einsum("i,ij,j->", z, jnp.arange(9.0).reshape(3, 3), z)[None],
    "padding": lambda z: jnp.pad(z, 1, constant_values=1.5) + jnp.concatenate([z, z[:2]]),
    "rounding": lambda z: jnp.floor(4 * z) + jnp.ceil(z) + jnp.round(z) + jnp.sign(z),
    "truncation": lambda z: (4 * z).astype(int) * 0.5,
    "powers": lambda z: jnp.stack(
        [z[2] ** z[0], z[1] ** 3, z[2] ** -2, z[0] ** 0.5, jnp.cbrt(z[1]), jax.lax.rsqrt(z[2])]
    ),
    "power of an index": lambda z: z[:, None] ** jnp.arange(4)[None],
    "angle wrapped": lambda z: (4 * z + jnp.pi) % (2 * jnp.pi) - jnp.pi,
    "associative scan": lambda z: jnp.cumprod(z) + jnp.cumsum(z[::-1]) + jax.lax.cummax(z),
    "dtype": lambda z: z.astype(jnp.float32).astype(jnp.float64) * 1.0,
    "hyperbolic": lambda z: (
        jnp.sinh(z) / jnp.cosh(z) + jnp.arctan(z) + jnp.arcsin(z / 3) + jnp.arccos(z / 3) + jnp.arcsinh(z)
    ),
}


HEAVY = (
    "hyperbolic",
    "softplus",
    "powers",
    "power of an index",
    "reductions",
    "angle wrapped",
    "associative scan",
    "rounding",
)


BY_XLA = pytest.mark.compiled


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=(pytest.mark.long, BY_XLA)) if n in HEAVY else n for n in PROGRAMS]
)
def test_a_program_is_enclosed(name, rng):
    f = PROGRAMS[name]
    found = inclusion(f)(X)
    z = samples(rng)
    values = np.asarray(kernel(jax.vmap(f))(z))
    slack = (1e-6 if name == "dtype" else 1e-13) * (1 + abs(values))
    assert found.shape == values.shape[1:]
    assert (np.asarray(found.lo) <= values + slack).all() and (values - slack <= np.asarray(found.hi)).all()
    assert np.isfinite(found.lo).all() and np.isfinite(found.hi).all()


def test_an_undecided_where_gives_the_hull_and_a_decided_one_a_branch():
    f = lambda z: jnp.where(z > 0.375, jnp.log(z), 7.0)
    found = inclusion(f)(X)
    assert (
        found.hi[0] == 7
        and found.lo[0] <= np.log(0.375)
        and found.lo[1] == found.hi[1] == 7
        and found.hi[2] < 1
    )


def test_what_does_not_depend_on_a_box_stays_what_it_is():
    out = inclusion(lambda z, n: {"z": z, "n": n + 1, "flag": n > 2, "half": (0.5, jnp.arange(2))})(X, 3)
    assert (
        isinstance(out["z"], Interval) and out["n"] == 4 and out["flag"] and out["half"][1].tolist() == [0, 1]
    )
    assert isinstance(out["half"][0], Interval) and out["half"][0].lo == out["half"][0].hi == 0.5


def test_points_and_boxes_mix_and_options_are_passed_on():
    F = inclusion(lambda a, b, *, c: a * b + c)
    found = F(interval(1.0, 2.0), 3.0, c=np.array([0.0, 1.0]))
    assert (abs(np.asarray(found.lo) - [3, 4]) < 1e-12).all() and (
        abs(np.asarray(found.hi) - [6, 7]) < 1e-12
    ).all()


@pytest.mark.parametrize("method", ["natural", pytest.param("best", marks=pytest.mark.long)])
def test_an_empty_box_has_an_empty_image(method):
    nothing = interval([np.inf, 1.0], [-np.inf, 2.0])
    assert bool(inclusion(lambda z: z[0] * 2 + jnp.exp(z[1]), method)(nothing).is_empty)


@pytest.mark.parametrize(
    "method",
    [
        "natural",
        pytest.param("mean_value", marks=pytest.mark.long),
        pytest.param("best", marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize(("lo", "hi"), [(-1, 2), (0, 0), (-600, 700), (-np.inf, 1), (1, np.inf)], ids=str)
def test_the_logarithm_of_a_sum_of_exponentials_written_out_is_enclosed_and_not_empty(method, lo, hi):
    found = inclusion(lambda z: jnp.log(jnp.sum(jnp.exp(z))), method)(
        interval(np.full(3, lo, float), np.full(3, hi, float))
    )
    least, greatest = (arb(end) + arb(3).log() if np.isfinite(end) else end for end in (lo, hi))
    assert not found.is_empty and float(found.lo) <= least and float(found.hi) >= greatest
    if method != "mean_value":
        assert found.lo >= lo + np.log(3) - 1e-9 and found.hi <= hi + np.log(3) + 1e-9


@pytest.mark.parametrize(
    "method",
    [
        "natural",
        pytest.param("mean_value", marks=pytest.mark.long),
        pytest.param("best", marks=pytest.mark.long),
    ],
)
def test_unbounded_boxes_are_enclosed(method):
    half = interval([0.0, 0.0], [np.inf, 1.0])
    found = inclusion(lambda z: jnp.stack([z[0] * z[1] + 1, jnp.exp(-z[0])]), method)(half)
    assert (found.lo <= np.array([1, 0])).all() and (found.hi >= np.array([np.inf, 1])).all()
    if method != "mean_value":
        assert found.lo[0] > 0.9 and found.hi[1] < 1.1


@pytest.mark.parametrize("method", ["natural", pytest.param("best", marks=pytest.mark.long)])
def test_a_second_box_does_not_trace(method):
    f = Counted(lambda z: z[0] * z[1] - jnp.cos(z[0]))
    inclusion(f, method)(interval([0.0, 1.0], [1.0, 2.0]))
    traced = f.count
    inclusion(f, method)(interval([-3.0, 1.5], [1.0, 7.0]))
    assert traced > 0 and f.count == traced


def test_gradients_of_an_enclosure_flow():
    def width(r):
        box = Interval(jnp.array([1 - r, 2 - r]), jnp.array([1 + r, 2 + r]))
        return (lambda y: y.hi - y.lo)(inclusion(lambda z: z[0] * z[1] ** 2)(box))

    slope, width = kernel(jax.grad(width))(0.1), kernel(width)
    assert abs(slope - (width(0.1001) - width(0.0999)) / 0.0002) < 1e-6


@pytest.mark.parametrize("value", [1e-310, -5e-324])
def test_subnormal_constants_and_points_are_not_lost(value):
    double = lambda z: jnp.stack([z * value * 2.0**60, z + value])
    found = inclusion(double)(interval(1.0, 1.0))
    exact = value * 2.0**60
    assert found.lo[0] <= exact <= found.hi[0]
    found = inclusion(lambda z, p: z * p * 2.0**60)(interval(1.0, 1.0), value)
    assert found.lo <= exact <= found.hi


def test_float64_points_are_not_rounded_inwards_when_x64_is_off():
    with jax.enable_x64(False):
        found = inclusion(lambda z, p: z * p)(interval(1.0, 1.0), 0.1)
        assert found.dtype == jnp.float32 and float(found.lo) < 0.1 < float(found.hi)


half = lambda z: z.astype(jnp.float16) * 2


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda: inclusion(lambda z: jax.scipy.special.erfinv(z))(X),
            NotImplementedError,
            "no rule for the primitive erf_inv, used by the function",
        ),
        (
            lambda: inclusion(lambda z: jnp.linalg.inv(jnp.diag(z)))(X),
            NotImplementedError,
            "no rule for the primitives .*lu.*, used by",
        ),
        (
            lambda: inclusion(partial(jax.lax.map, jax.lax.lgamma))(X),
            NotImplementedError,
            "no rule for the primitive lgamma",
        ),
        (
            lambda: inclusion(half)(X),
            NotImplementedError,
            "works in float32 and float64, but .* computes in float16",
        ),
        (lambda: inclusion(lambda z: z * 1j)(X), NotImplementedError, "computes in complex128"),
        (
            lambda: inclusion(lambda z: z[z[0].astype(int)])(X),
            NotImplementedError,
            "an index depends on an interval",
        ),
        (
            lambda: inclusion(lambda z: z.astype(int) // 2 * 1.0)(X),
            NotImplementedError,
            "no rule for the primitive div of integers",
        ),
        (
            lambda: inclusion(jnp.sort, "mean_value")(X),
            NotImplementedError,
            "primitive sort, used by the derivative: method='natural' needs no",
        ),
        (
            lambda: inclusion(jnp.sin)(Interval(jnp.array([1.0, 2.0]), jnp.array([0.0, 3.0]))),
            ValueError,
            "lo must be <= hi: 1 of 2 entries",
        ),
        (lambda: inclusion(jnp.sin)(Interval(jnp.array([np.nan]), jnp.array([0.0]))), ValueError, "not NaN"),
        (
            lambda: inclusion(jnp.sin)(np.array([np.nan, 1.0])),
            ValueError,
            "a point must be a number, not NaN: 1 of 2",
        ),
        (
            lambda: inclusion(jnp.sin)(Interval(jnp.zeros(2), jnp.ones(3))),
            ValueError,
            "lo and hi of an Interval must have one shape",
        ),
        (lambda: inclusion(lambda z: z @ jnp.ones(2))(X), TypeError, "dot_general"),
        (
            lambda: inclusion(jnp.sin, "exact"),
            ValueError,
            "method must be one of natural, mean_value, best, not 'exact'",
        ),
        (lambda: inclusion(3.0), TypeError, "inclusion needs a function of arrays, not float"),
        (lambda: inclusion(jnp.sin)("1.0"), TypeError, "takes Intervals, arrays and numbers, not str"),
    ],
    ids=range(16),
)
def test_what_cannot_be_enclosed_is_refused(call, error, message):
    with pytest.raises(error, match=message):
        call()
