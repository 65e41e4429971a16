"""jnp.interp and the error functions over sets: exact rationals and 200-bit values lie in what comes out."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flint import arb, ctx

import jaxbound as jb
from jaxbound import sets

ctx.prec = 200
KNOTS = np.array([-1.0, 0.1, 0.7, 2.0, 5.5])
VALUES = np.array([3.0, -1.3, 0.4, 0.4, 9.1])


def exact(x):
    """Return the value of the table at a float, as a fraction."""
    xp, fp = (list(map(Fraction, v.tolist())) for v in (KNOTS, VALUES))
    x = min(max(Fraction(float(x)), xp[0]), xp[-1])
    for a, b, c, d in zip(xp[:-1], xp[1:], fp[:-1], fp[1:], strict=True):
        if a <= x <= b:
            return c + (x - a) / (b - a) * (d - c)
    raise AssertionError(x)


def table(x):
    return jnp.interp(x, KNOTS.astype(x.dtype), VALUES.astype(x.dtype))


def boxes(rng, count=400):
    lo = rng.uniform(-3, 7, count)
    wid = rng.choice([0.0, 1e-9, 0.3, 4.0], count)
    lo[:5], wid[:5] = KNOTS, 0
    return sets.interval(lo, lo + wid)


@pytest.mark.parametrize("method", ["natural", "best"])
def test_interp_encloses_the_table(rng, method):
    x = boxes(rng)
    y = jax.vmap(lambda box: jb.inclusion(table, method)(box))(x)
    lo, hi = np.asarray(x.lo), np.asarray(x.hi)
    for k in range(len(lo)):
        inside = [lo[k], hi[k], (lo[k] + hi[k]) / 2, *KNOTS[(KNOTS >= lo[k]) & (KNOTS <= hi[k])]]
        values = list(map(exact, inside))
        assert Fraction(float(y.lo[k])) <= min(values) and max(values) <= Fraction(float(y.hi[k]))
        span = max(values) - min(values)
        assert Fraction(float(y.hi[k])) - Fraction(float(y.lo[k])) - span < Fraction(1, 10**12)


def test_its_jacobian_has_the_slopes_of_all_segments_it_meets():
    F = jb.inclusion(table)
    J = F.jacobian(sets.interval(0.2, 0.8))
    assert float(J.lo[0, 0]) <= 0 and float(J.hi[0, 0]) >= 1.7 / 0.6
    assert float(J.hi[0, 0] - J.lo[0, 0]) == pytest.approx(1.7 / 0.6)
    J = F.jacobian(sets.interval(6.0, 7.0))
    assert (float(J.lo[0, 0]), float(J.hi[0, 0])) == (0, 0)


def test_a_set_of_values_and_float32_do_too(rng):
    x, fp = jnp.asarray(0.25), sets.interval(VALUES - 0.5, VALUES + 0.5)
    y = jb.inclusion(lambda fp: jnp.interp(x, KNOTS, fp))(fp)
    assert float(y.lo) <= float(exact(0.25)) - 0.5 + 1e-12 and float(y.hi) >= float(exact(0.25)) + 0.5 - 1e-12
    y = jb.inclusion(table)(sets.interval(np.float32(0.25), np.float32(0.3)))
    assert y.dtype == np.float32 and float(y.hi) - float(y.lo) == pytest.approx(0.05 * 1.7 / 0.6, rel=1e-4)


def test_knots_that_stand_twice_or_fall_say_nothing_wrong():
    steps = jb.inclusion(
        lambda x: jnp.interp(x, jnp.array([0.0, 1.0, 1.0, 2.0]), jnp.array([0.0, 0.0, 5.0, 5.0]))
    )
    y = steps(sets.interval(0.9, 1.1))
    assert float(y.lo) <= 0 and float(y.hi) >= 5 and not steps.continuous(sets.interval(0.9, 1.1))


def test_a_table_that_depends_on_a_set_is_refused_in_a_sentence():
    with pytest.raises(NotImplementedError, match="knots depend on an interval"):
        jb.inclusion(lambda xp: jnp.interp(0.5, xp, jnp.array([0.0, 1.0])))(
            sets.interval([0.0, 1.0], [0.1, 1.1])
        )


def test_another_function_of_that_name_is_what_it_is():
    @jax.jit
    def _interp(x, xp, fp):
        return x + xp[0] + fp[0]

    y = jb.inclusion(lambda x: _interp(x, jnp.asarray(KNOTS), jnp.asarray(VALUES)))(sets.interval(1.0, 2.0))
    assert float(y.lo) == pytest.approx(3) and float(y.hi) == pytest.approx(4)


POINTS = [0.0, 1e-300, 2.4999, 2.5, 2.5001, 6.0, 27.0, 1e300]


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", ["erf", "erfc"])
def test_error_functions_enclose(rng, name, dtype):
    x = np.concatenate([rng.uniform(-7, 7, 300), POINTS, np.negative(POINTS)])
    x = x[np.abs(x) < np.finfo(dtype).max].astype(dtype)
    y = getattr(sets, name)(sets.interval(x))
    top = 200 * np.finfo(dtype).eps
    for k in range(len(x)):
        value = getattr(arb(float(x[k])), name)()  # of 200 bits: no float but 0 and 1 is so near to it
        assert not arb(float(y.lo[k])) > value and not value > arb(float(y.hi[k]))
        assert float(y.hi[k]) - float(y.lo[k]) <= top
    wide = getattr(sets, name)(sets.interval(dtype(-1), dtype(2)))
    ends = sorted(float(getattr(arb(v), name)().mid()) for v in (-1, 2))
    assert float(wide.lo) <= ends[0] and ends[1] <= float(wide.hi)


@pytest.mark.parametrize("name", ["erf", "erfc"])
def test_inclusion_knows_them_and_their_slopes(name):
    F = jb.inclusion(getattr(jax.scipy.special, name), "best")
    y, x = F(sets.interval(0.5, 0.6)), sets.interval(0.5, 0.6)
    ends = sorted(float(getattr(arb(v), name)().mid()) for v in (0.5, 0.6))
    assert float(y.lo) == pytest.approx(ends[0], abs=1e-12) and float(y.hi) == pytest.approx(
        ends[1], abs=1e-12
    )
    J = F.jacobian(sets.interval(0.5))
    slope = (2 / arb.pi().sqrt()) * (-arb(0.25)).exp() * (1 if name == "erf" else -1)
    assert arb(float(J.lo[0, 0])) <= slope <= arb(float(J.hi[0, 0]))
    assert x.shape == ()
