"""A million points an arithmetic operation, decided exactly: sums and products of floats are split without
error on the host.
"""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbound import sets
from jaxbound.sets.intervals.interval import Interval

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
    return ((below[0] < a) | ((below[0] == a) & (below[1] <= 0))) & (
        (above[0] > a) | ((above[0] == a) & (above[1] >= 0))
    )


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
    b[: count // 2] = a[: count // 2] * (
        1 + rng.integers(-9, 10, count // 2) * np.finfo(dtype).eps
    )  # cancellation
    b = abs(b)
    other = b[:1] if form == "scalar" else b
    point = lambda v: Interval(jnp.asarray(v), jnp.asarray(v))
    operands = {"sqr": lambda x, y: (x,), "recip": lambda x, y: (y,), "sqrt": lambda x, y: (y,)}
    kernel = jax.jit(
        lambda x, y: {op: getattr(sets, op)(*operands.get(op, lambda x, y: (x, y))(x, y)) for op in CHECKS}
    )
    for op, z in kernel(point(a), point(other)).items():
        lo, hi = (np.broadcast_to(np.asarray(v), a.shape) for v in (z.lo, z.hi))
        held = CHECKS[op](lo, hi, a, np.broadcast_to(other, a.shape))
        assert held.all(), (op, (~held).sum())


def encloses(lo, hi, fast, error, exactly):
    """True where lo <= value <= hi: by a longer float and a bound of its error, else by rationals."""
    lo, hi = (np.asarray(v).astype(np.longdouble) for v in (lo, hi))
    held = (lo <= fast - error) & (fast + error <= hi)
    for i in np.flatnonzero(~held):
        held[i] = Fraction(float(lo[i])) <= exactly(i) <= Fraction(float(hi[i]))
    return held


@pytest.mark.parametrize("count", [20_000, pytest.param(MILLION, marks=pytest.mark.long)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64], ids=["float32", "float64"])
def test_products_plus_a_number_are_enclosed(rng, dtype, count):
    reach = np.finfo(dtype).maxexp // 6
    draw = lambda: (np.exp2(rng.uniform(-reach, reach, count)) * rng.choice([-1, 1], count)).astype(dtype)
    a, b = draw(), draw()
    near = (-(a * b) * (1 + rng.integers(-9, 10, count) * np.finfo(dtype).eps)).astype(dtype)  # cancellation
    c = np.choose(
        rng.integers(0, 3, count),
        [near, draw(), (near * np.exp2(rng.integers(-60, 60, count))).astype(dtype)],
    )
    z = jax.jit(sets.fma)(*(Interval(jnp.asarray(v), jnp.asarray(v)) for v in (a, b, c)))
    p, e = split_product(*(v.astype(np.longdouble) if dtype == np.float32 else v for v in (a, b)))
    fast = p.astype(np.longdouble) + c + e
    error = (abs(fast) + abs(e.astype(np.longdouble)) + abs(p.astype(np.longdouble) + c)) * np.longdouble(
        2.0**-61
    )
    held = encloses(
        z.lo,
        z.hi,
        fast,
        error,
        lambda i: Fraction(float(a[i])) * Fraction(float(b[i])) + Fraction(float(c[i])),
    )
    assert held.all(), (a[~held][:3], b[~held][:3], c[~held][:3])


@pytest.mark.parametrize(
    "n", [3, *(pytest.param(n, marks=pytest.mark.long) for n in (2, 4, 7, 16, -1, -2, -5))]
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64], ids=["float32", "float64"])
def test_powers_of_points_are_enclosed(rng, dtype, n, request):
    count = 200_000 if "long" in {m.name for m in request.node.iter_markers()} else 20_000
    reach = np.finfo(dtype).maxexp / abs(n) * 0.95
    x = (np.exp2(rng.uniform(-reach, reach, count)) * rng.choice([-1, 1], count)).astype(dtype)
    x[: count // 4] = (1 + rng.integers(-9999, 9999, count // 4) * np.finfo(dtype).eps).astype(dtype)
    z = jax.jit(lambda v: sets.pown(v, n))(Interval(jnp.asarray(x), jnp.asarray(x)))
    fast = np.ones(count, np.longdouble)
    for _ in range(abs(n)):
        fast = fast * x
    fast = 1 / fast if n < 0 else fast
    held = encloses(
        z.lo,
        z.hi,
        fast,
        abs(fast) * (abs(n) + 2) * np.longdouble(2.0**-63),
        lambda i: Fraction(float(x[i])) ** n,
    )
    assert held.all(), x[~held][:3]
