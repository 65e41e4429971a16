"""What a program makes of a NaN or of an infinity inside is enclosed; loops under vmap are followed. Programs
are compiled together.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbound.sets import Interval, inclusion, interval
from jaxbound.sets.paving.existence import components

BOX = np.array([[-0.5, 0.0, -2.0, 1.0], [0.75, 0.0, -1.0, 2.0]])  # across 0, at 0, below, above


def until(a):
    return jax.lax.while_loop(lambda s: s[0] < 10, lambda s: (s[0] * 1.7 + 4, s[1] + 1.0), (a, 0.0))[1]


def steps(a, k):
    return jax.lax.fori_loop(0, k, lambda i, c: c * a, 1.0)


PROGRAMS = {
    "nan_to_num": lambda z: jnp.nan_to_num(jnp.sqrt(z), nan=-5.0),
    "isnan": lambda z: jnp.where(jnp.isnan(jnp.log(z)), 7.0, z),
    "x != x": lambda z: (lambda q: jnp.where(q != q, 4.0, 0.0))(jnp.arcsin(z)),
    "isfinite": lambda z: jnp.where(jnp.isfinite(1 / z), 1.0, 2.0),
    "less": lambda z: jnp.where(jnp.sqrt(z) < 100.0, 1.0, 2.0),
    "not less": lambda z: jnp.where(~(jnp.log(z) >= -1e9), 1.0, 2.0),
    "nansum": lambda z: jnp.nansum(jnp.sqrt(z)),
    "nanmax": lambda z: jnp.nanmax(jnp.log(z)),
    "fmax": lambda z: jnp.fmax(jnp.log(z), -3.0),
    "clamp": lambda z: jax.lax.clamp(0.25, jnp.log(z), 1.0),
    "sort": lambda z: jnp.nan_to_num(jnp.sort(jnp.sqrt(z)), nan=44.0),
    "integer": lambda z: jnp.sqrt(z).astype(jnp.int32) * 1.0,
    "power of NaN": lambda z: jnp.power(1.0, jnp.log(z)) + jnp.sqrt(z) ** 0.0,
    "quotient": lambda z: jnp.nan_to_num(z / z, nan=17.0),
    "scan": lambda z: jax.lax.scan(lambda c, x: (jnp.where(jnp.isnan(c), 0.0, jnp.sqrt(x)), c), 0.0, z)[1][
        1:
    ],
    "cond": lambda z: jax.lax.cond(jnp.sqrt(z[0]) >= 0, lambda x: x, lambda x: -x, z),
    "fill": lambda z: jnp.nansum(z.at[jnp.array([0, 9])].get(mode="fill")),
    "constant": lambda z: jnp.nansum(jnp.where(jnp.array([True, False, True, True]), z, jnp.nan)),
    "mask": lambda z: jnp.log(jnp.sum(jnp.exp(jnp.where(jnp.array([True, False, True, True]), z, -jnp.inf)))),
    "exp of -inf": lambda z: z + jnp.exp(jnp.array(-jnp.inf)),
    "angle": lambda z: jnp.arctan2(z * 0, jnp.abs(z)),
    "while under vmap": lambda z: jax.vmap(until)(z),
    "for under vmap": lambda z: jax.vmap(steps)(z, jnp.arange(4)),
}


FEW = ("nan_to_num", "isnan", "less", "nansum", "while under vmap")


@pytest.mark.parametrize(
    "names", [FEW, pytest.param(tuple(PROGRAMS), marks=pytest.mark.long)], ids=["few", "all"]
)
def test_a_program_that_makes_a_number_of_nan_or_loops_under_vmap_is_enclosed(names, rng):
    every = lambda z: {name: PROGRAMS[name](z) for name in names}
    found = inclusion(every)(interval(*BOX))
    z = np.where(rng.random((2000, 4)) < 0.2, BOX[rng.integers(0, 2, 2000)], rng.uniform(*BOX, (2000, 4)))
    values = jax.jit(jax.vmap(every))(z)
    for name, value in values.items():
        value, lo, hi = np.asarray(value), np.asarray(found[name].lo), np.asarray(found[name].hi)
        slack = 1e-9 * (1 + abs(value))
        missed = np.isfinite(value) & ~((lo <= value + slack) & (value - slack <= hi))
        assert not missed.any(), (name, z[np.argwhere(missed)[0][0]])


def test_a_box_inside_the_domain_leaves_the_answer_to_nan_questions_sure():
    f = lambda z: jnp.stack(
        [jnp.nan_to_num(jnp.log(z), nan=-5.0), jnp.where(jnp.isnan(jnp.sqrt(z)), -9.0, z)]
    )
    F = inclusion(f)
    inside = interval(2.0, 3.0)
    assert (
        F(inside).lo[0] > 0.6
        and F(inside).lo[1] == 2
        and F.continuous(inside)
        and not F.continuous(interval(-1.0, 1.0))
    )


def test_a_number_that_is_nowhere_defined_is_not_continuous_beside_one_that_is():
    assert not inclusion(lambda z: jnp.stack([z, z + jnp.nan])).continuous(interval(2.0, 3.0))


@pytest.mark.parametrize("method", ["natural", pytest.param("best", marks=pytest.mark.long)])
def test_no_method_believes_a_derivative_where_nan_is_caught(method):
    found = inclusion(lambda z: jnp.where(jnp.isnan(jnp.sqrt(z[0])), 100.0, z[0]), method)(
        interval([-1.0], [1.0])
    )
    assert found.lo <= 0 and found.hi >= 100


def test_an_image_for_paving_holds_what_nan_becomes():
    (image,) = components(lambda z: jnp.nan_to_num(jnp.log(z[:1]), nan=50.0), interval([-2.0], [-1.0]), ())
    assert image.lo <= 50 <= image.hi


def test_a_traced_box_with_nan_for_a_bound_is_unbounded():
    found = jax.jit(lambda lo, hi: inclusion(lambda z: z * 2)(Interval(lo, hi)))(
        jnp.array(jnp.nan), jnp.array(1.0)
    )
    assert found.lo == -jnp.inf and found.hi >= 2
