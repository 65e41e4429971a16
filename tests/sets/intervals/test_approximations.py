"""The polynomials and fractions behind the elementary functions leave out no more than is stated, before any
rounding; corrected quotients and roots lose no more than is stated."""

from fractions import Fraction

import flint
import jax
import numpy as np
import pytest
from flint import arb

from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals import approximations

STATED = {"exp": 0.2, "log": 0.1, "tanh": 0.25}  # in units u of the result


def polynomial(coefficients, x, dtype):
    total = arb(0)
    for c in reversed(coefficients):
        total = total * x + arb(float(dtype(c)))
    return total


def exponential(r, size, dtype):
    return 1 + r + r * r * polynomial(approximations.EXP[size], r, dtype), r.exp()


def logarithm(f, size, dtype):
    s = f / (2 + f)
    return 2 * s + 2 * s**3 * polynomial(approximations.LOG[size], s * s, dtype), (1 + f).log()


def tangent(y, size, dtype):
    w = y * y
    B, N = (polynomial(table[size], w, dtype) for table in (approximations.TANH_B, approximations.TANH_N))
    return y - y * w * N / B, y.tanh()


RANGES = {
    "exp": (exponential, -0.3466, 0.3466),
    "log": (logarithm, 0.5**0.5 - 1, 2**0.5 - 1),
    "tanh": (tangent, 0.001, 1),
}


@pytest.mark.parametrize("dtype", [np.float32, np.float64], ids=["float32", "float64"])
@pytest.mark.parametrize("name", RANGES)
def test_what_a_cut_series_leaves_out_is_below_the_stated_share_of_a_rounding(name, dtype):
    form, lo, hi = RANGES[name]
    unit, worst = float(np.finfo(dtype).eps) / 2, 0.0
    with flint.ctx.workprec(200):
        for x in np.linspace(lo, hi, 1500).tolist():
            approximate, exact = form(arb(x), np.dtype(dtype).itemsize, dtype)
            worst = max(worst, float(abs(approximate - exact) / abs(exact)) / unit)
    print(f"{name} {np.dtype(dtype).name}: {worst:.3f} u")
    assert worst <= STATED[name]


@pytest.mark.parametrize("form", ["array", "scalar"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64], ids=["float32", "float64"])
def test_a_corrected_quotient_or_root_is_off_by_one_rounding_whatever_division_the_compiler_makes(
    rng, dtype, form
):
    n, d = (
        rng.uniform(0.5, 2, 3000).astype(dtype) * np.exp2(rng.integers(-20, 20, 3000)).astype(dtype)
        for _ in range(2)
    )
    d = d[:1] if form == "scalar" else d
    unit = Fraction(float(np.finfo(dtype).eps) / 2)
    exactly = lambda v: map(Fraction, np.broadcast_to(v, n.shape).astype(float).tolist())
    for q, a, b in zip(exactly(jax.jit(rounding.quotient)(n, d)), exactly(n), exactly(d), strict=True):
        assert abs(q * b - a) <= Fraction(101, 100) * unit * a
    for s, a in zip(exactly(jax.jit(rounding.root)(n)), exactly(n), strict=True):
        low, high = s / (1 + Fraction(101, 100) * unit), s / (1 - Fraction(101, 100) * unit)
        assert low * low <= a <= high * high
