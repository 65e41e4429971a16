"""Sets with entries below the smallest normal number: the same answer eagerly and inside jit, or none."""

from fractions import Fraction

import jax
import numpy as np
import pytest
from corners import DTYPES

from jaxbound.sets import constrained_zonotope, contains, intersects, is_empty, zonotope

SIZES = {np.float32: (1.2e-38, 3e-40), np.float64: (1e-300, 3e-310)}
BY_DAY = pytest.param(np.float32, marks=pytest.mark.long), np.float64
YES, OPEN, NO = 1, 0, -1


def inside(question):
    return jax.jit(lambda *given: question(*given).answer)


INSIDE = {question: inside(question) for question in (contains, intersects, is_empty)}
"""Each question compiled once for its shapes: every set here has two generators, some of them 0."""


def both(question, *given):
    """Return the answers outside and inside jit."""
    return int(question(*given).answer), int(INSIDE[question](*given))


def near_the_edge(dtype):
    """Return (a, b, [[a, b]], [a + b]), b a subnormal number."""
    a, b = (dtype(x) for x in SIZES[dtype])
    A, at = np.array([[a, b]]), np.array([a + b])
    assert Fraction(float(a)) + Fraction(float(b)) >= Fraction(float(at[0]))
    return a, b, A, at


@pytest.mark.parametrize("dtype", BY_DAY)
def test_inside_jit_nothing_is_decided_of_a_point_that_is_read_as_0(dtype):
    a, b, A, at = near_the_edge(dtype)
    assert both(contains, zonotope(np.zeros(1, dtype), A), at) == (YES, OPEN)
    assert both(contains, zonotope(np.array([b]), np.array([[a, dtype(0)]])), np.array([-a])) == (NO, OPEN)


@pytest.mark.long(by_day="test_inside_jit_nothing_is_decided_of_a_point_that_is_read_as_0")
@pytest.mark.parametrize("dtype", DTYPES)
def test_inside_jit_nothing_is_decided_of_sets_that_are_read_as_0(dtype):
    a, b, A, at = near_the_edge(dtype)
    assert both(is_empty, constrained_zonotope(np.zeros(1, dtype), np.ones((1, 2), dtype), A, at)) == (
        NO,
        OPEN,
    )
    beside = zonotope(np.array([b]), np.array([[a, dtype(0)]]))
    assert both(contains, beside, zonotope(np.zeros(1, dtype), np.array([[a]]))) == (NO, OPEN)
    assert both(intersects, beside, zonotope(np.array([-a - a]), np.array([[a]]))) == (NO, OPEN)


@pytest.mark.parametrize("dtype", BY_DAY)
def test_inside_jit_nothing_is_decided_of_a_difference_that_is_read_as_0(dtype):
    least = np.finfo(dtype).tiny
    Z = zonotope(np.array([least * dtype(1.25)]), np.array([[least, dtype(0)]]) * dtype(1.5))
    near = np.array([least * dtype(1.5)])
    eager, compiled = both(contains, Z, near)
    assert eager == YES and compiled == OPEN
    assert both(contains, Z, np.array([least * dtype(1.25)]))[1] in (YES, OPEN)
    far = np.array([least * dtype(8)])
    assert both(contains, Z, far) == (NO, NO)
