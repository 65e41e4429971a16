"""Operations, exact counterparts and draws that the tests of intervals share."""

import operator
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import DTYPES, MODES, bounds, members

from jaxbound import sets
from jaxbound.sets.intervals.interval import Interval

BINARY = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": lambda a, b: a / b if b else None,
    "min": min,
    "max": max,
}
UNARY = {"neg": operator.neg, "abs": abs, "sqr": lambda a: a * a, "recip": lambda a: 1 / a if a else None}
EMPTY, ENTIRE = (np.inf, -np.inf), (-np.inf, np.inf)

each_dtype = pytest.mark.parametrize("dtype", DTYPES, ids=["float32", "float64"])
each_mode = pytest.mark.parametrize("mode", MODES)
COUNT = 300  # one shape for most tests, and one function of all operations: little is compiled


def binary(x, y):
    return {op: getattr(sets, op)(x, y) for op in BINARY}


def unary(x):
    return {op: getattr(sets, op)(x) for op in UNARY}


POWERS = (-3, -2, -1, 0, 1, 2, 3, 4, 7)


def powers(x):
    return {n: sets.pown(x, n) for n in POWERS}


COMPILED, COMPILED_UNARY, COMPILED_POWERS = jax.jit(binary), jax.jit(unary), jax.jit(powers)


def draw(rng, dtype, count=COUNT, **options):
    return Interval(*map(jnp.asarray, bounds(rng, dtype, count, **options)))


def ends(*x):
    """Return the bounds of Intervals as lists of tuples of Python floats, one tuple an entry."""
    return list(zip(*(np.ravel(end).tolist() for each in x for end in (each.lo, each.hi)), strict=True))


def ranges(f, *x):
    """Return, an entry, the exact values of f at members of the Intervals (None: undefined there)."""
    exact = []
    for row in ends(*x):
        inside = [members(a, b) for a, b in zip(row[::2], row[1::2], strict=True)]
        exact.append([v for point in product(*inside) if (v := f(*point)) is not None])
    return exact
