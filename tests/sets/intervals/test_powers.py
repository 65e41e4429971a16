"""Real powers of Intervals: 200-bit values lie in them, and the edges of their domain are the tightest."""

import math

import numpy as np
import pytest
from flint import arb, ctx

from jaxbound import sets
from jaxbound.sets import interval

ctx.prec = 200


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_power_encloses(rng, dtype):
    x = np.exp(rng.uniform(-20, 20, 300)).astype(dtype)
    y = (rng.normal(size=300) * rng.choice([0.1, 1, 3], 300)).astype(dtype)
    out = sets.pow(interval(x), interval(y))
    for k in range(300):
        value = arb(float(x[k])) ** arb(float(y[k]))
        assert arb(float(out.lo[k])) <= value <= arb(float(out.hi[k]))
        size = 1 + abs(float(y[k]) * math.log(float(x[k])))
        far = float(out.hi[k]) - float(out.lo[k])
        assert far <= 20 * size * np.finfo(dtype).eps * float(out.hi[k]) + 10 * np.finfo(dtype).tiny


def test_operators_take_any_exponent():
    x = interval(1.0, 2.0)
    y = x**0.9
    assert float(y.lo) == 1 and arb(2) ** arb(0.9) <= arb(float(y.hi)) and float(y.hi) < 1.8660659830737
    assert sets.subset(2.0**x, interval(1.999999, 4.000001)) and sets.subset(interval(2.0, 4.0), 2.0**x)
    assert (interval(-2.0, 1.0) ** 2.0 == interval(-2.0, 1.0) ** 2).all()
    assert sets.subset(interval(1.0, 4.0), x**x)


@pytest.mark.parametrize(
    ("x", "y", "out"),
    [
        ((0, 4), 0.5, (0, 2)),
        ((-1, 4), 0.5, (0, 2)),
        ((0, 4), -0.5, (0.5, math.inf)),
        ((0, 0), 0.5, (0, 0)),
        ((0, 0), -0.5, None),
        ((-3, -2), 0.5, None),
        ((0, math.inf), 0.5, (0, math.inf)),
        ((1, 1), 7.5, (1, 1)),
    ],
)
def test_edges_of_the_domain(x, y, out):
    found = interval(*map(float, x)) ** y
    if out is None:
        assert found.is_empty
    else:
        assert float(found.lo) == pytest.approx(out[0], rel=1e-14)
        assert float(found.hi) == pytest.approx(out[1], rel=1e-14)
