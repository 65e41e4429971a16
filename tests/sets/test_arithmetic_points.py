"""A million points an arithmetic operation, decided exactly: sums and products of floats are split without error on the host."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbound import sets
from jaxbound.sets.interval import Interval

MILLION = 1_000_000


def split_sum(a, b):
    """Return (s, e) with s = fl(a + b), s + e = a + b (Knuth; NumPy rounds as IEEE 754 says)."""
    s = a + b
    z = s - a
    return s, (a - (s - z)) + (b - z)


def split_product(a, b):
    """Return (p, e) with p = fl(a b), p + e = a b (Dekker)."""

    def halves(x):
        t = x * x.dtype.type(2.0 ** ((np.finfo(x.dtype).nmant + 2) // 2) + 1)
        high = t - (t - x)
        return high, x - high

    (a_hi, a_lo), (b_hi, b_lo) = halves(a), halves(b)
    p = a * b
    return p, ((a_hi * b_hi - p) + a_hi * b_lo + a_lo * b_hi) + a_lo * b_lo


def at_most(x, p, e):
    """True where x <= p + e, p = fl(p + e)."""
    return (x < p) | ((x == p) & (e >= 0))


def at_least(x, p, e):
    return (x > p) | ((x == p) & (e <= 0))


def quotient_between(lo, hi, a, b):
    """True where lo <= a / b <= hi, b > 0: compare lo b and hi b with a."""
    below, above = split_product(lo, b), split_product(hi, b)
    return ((below[0] < a) | ((below[0] == a) & (below[1] <= 0))) & ((above[0] > a) | ((above[0] == a) & (above[1] >= 0)))


def between(lo, hi, exact):
    return at_most(lo, *exact) & at_least(hi, *exact)


CHECKS = {
    "add": lambda lo, hi, a, b: between(lo, hi, split_sum(a, b)),
    "sub": lambda lo, hi, a, b: between(lo, hi, split_sum(a, -b)),
    "mul": lambda lo, hi, a, b: between(lo, hi, split_product(a, b)),
    "div": lambda lo, hi, a, b: quotient_between(lo, hi, a, b),
    "sqr": lambda lo, hi, a, b: between(lo, hi, split_product(a, a)),
    "recip": lambda lo, hi, a, b: quotient_between(lo, hi, np.ones_like(b), b),
    "sqrt": lambda lo, hi, a, b: at_most_square(lo, b) & at_least_square(hi, b),
}


def at_most_square(lo, x):
    p, e = split_product(lo, lo)
    return (p < x) | ((p == x) & (e <= 0))


def at_least_square(hi, x):
    p, e = split_product(hi, hi)
    return (p > x) | ((p == x) & (e >= 0))


@pytest.mark.parametrize("count", [20_000, pytest.param(MILLION, marks=pytest.mark.long)])
@pytest.mark.parametrize("form", ["array", "scalar"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64], ids=["float32", "float64"])
def test_exact_results_at_points_are_enclosed(rng, dtype, form, count):
    """The second operand is an array or one number for all, whose reciprocal the compiler may take."""
    reach = np.finfo(dtype).maxexp // 5
    draw = lambda: np.exp2(rng.uniform(-reach, reach, count)).astype(dtype)
    a, b = draw() * rng.choice([-1, 1], count).astype(dtype), draw()
    b[: count // 2] = a[: count // 2] * (1 + rng.integers(-9, 10, count // 2) * np.finfo(dtype).eps)  # cancellation
    b = abs(b)
    other = b[:1] if form == "scalar" else b
    point = lambda v: Interval(jnp.asarray(v), jnp.asarray(v))
    operands = {"sqr": lambda x, y: (x,), "recip": lambda x, y: (y,), "sqrt": lambda x, y: (y,)}
    kernel = jax.jit(lambda x, y: {op: getattr(sets, op)(*operands.get(op, lambda x, y: (x, y))(x, y)) for op in CHECKS})
    for op, z in kernel(point(a), point(other)).items():
        lo, hi = (np.broadcast_to(np.asarray(v), a.shape) for v in (z.lo, z.hi))
        held = CHECKS[op](lo, hi, a, np.broadcast_to(other, a.shape))
        assert held.all(), (op, (~held).sum())
