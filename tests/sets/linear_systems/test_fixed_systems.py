"""Systems with a matrix prepared once: every solution is enclosed, in both precisions, and as tightly as by
solve_interval.
"""

from fractions import Fraction

import jax
import numpy as np
import pytest

import jaxbound as jb
from jaxbound.exact import linalg
from jaxbound.sets.linear_systems.ends import interval_of
from jaxbound.sets.linear_systems.fixed_systems import prepare, solutions
from jaxbound.sets.linear_systems.solve import solve_interval

solve = jax.jit(lambda systems, h: interval_of(solutions(systems, h)))


def interval_matrix(rng, r, n, dtype, width=0.02):
    middle = np.eye(n)[np.minimum(np.arange(r), n - 1)] + rng.uniform(
        -0.15, 0.15, (r, n)
    )  # the last rows take each other's place
    spread = width * rng.random((r, n)) * (rng.random((r, n)) < 0.5)
    return jb.interval((middle - spread).astype(dtype), (middle + spread).astype(dtype))


def vertex(rng, X):
    return np.where(rng.random(X.shape) < 0.5, np.asarray(X.lo), np.asarray(X.hi)).astype(float)


@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.long)])
def test_exact_solutions_of_vertex_systems_are_enclosed_as_tightly_as_by_one_call(rng, dtype):
    n, count, N = 4, 3, 64
    M = interval_matrix(rng, n + count - 1, n, dtype)
    middle = rng.normal(size=(n + count - 1, N)) * 10.0 ** rng.integers(-3, 4, N)
    spread = np.abs(middle) * rng.choice([0, 1e-3], middle.shape)
    h = jb.interval((middle - spread).astype(dtype), (middle + spread).astype(dtype))
    box = solve(prepare(M[..., None], count), h)
    for k in range(N):
        system = k % count
        rows = [*range(n - 1), n - 1 + system]
        A, b = vertex(rng, M[np.array(rows)]), vertex(rng, h[np.array(rows), k])
        inverse = linalg.inverse([[Fraction(v) for v in row] for row in A])
        x = [sum(a * Fraction(v) for a, v in zip(row, b, strict=True)) for row in inverse]
        for i in range(n):
            assert Fraction(float(box.lo[system, i, k])) <= x[i] <= Fraction(float(box.hi[system, i, k]))
    first = h[:n].lo.T, h[:n].hi.T
    alike = solve_interval(M[:n], jb.interval(*first), "hbr").x
    assert ((box.hi - box.lo)[0].T <= 1.001 * (alike.hi - alike.lo)).all()


def test_what_is_not_regular_is_answered_by_everything(rng):
    M = jb.interval(np.array([[1.0, 1.0], [1.0, 1.0]]))
    box = solve(prepare(M[..., None]), jb.interval(np.ones((2, 5))))
    assert (box.lo == -np.inf).all() and (box.hi == np.inf).all()
    M = jb.interval(np.eye(2))
    box = solve(prepare(M[..., None]), jb.interval(np.array([[-np.inf], [1.0]]), np.array([[1.0], [2.0]])))
    assert box.lo[0, 0, 0] == -np.inf and box.hi[0, 1, 0] >= 2.0
