"""Large systems solved by lifting are solved exactly, as by determinants."""

from fractions import Fraction

import pytest

from jaxbound.exact import chebyshev, linalg
from jaxbound.exact.lifting import lifted


def whole(rng, n, size):
    return [[int(x) for x in row] for row in rng.integers(-size, size, (n, n), endpoint=True)]


@pytest.mark.parametrize("n, size", [(1, 9), (2, 10**9), (7, 10**3), (20, 10**15)])
def test_what_is_lifted_is_what_the_inverse_gives(n, size, rng):
    M, right = whole(rng, n, size), [int(x) for x in rng.integers(-(2**60), 2**60, n)]
    M = [[x + (i == j) * 2 * n * size for j, x in enumerate(row)] for i, row in enumerate(M)]  # regular
    x, det = lifted(M, right)
    wanted = linalg.matmul(linalg.inverse(linalg.matrix(M)), [[Fraction(v)] for v in right])
    assert [Fraction(v, det) for v in x] == [v for (v,) in wanted]


def test_a_singular_system_is_not_solved():
    assert lifted([[1, 2], [2, 4]], [1, 1]) is None and lifted([[0]], [1]) is None
    assert (
        lifted([[2**27 - 39]], [1]) is None
    )  # regular, but not modulo the prime: the caller has another way


def test_an_optimum_does_not_depend_on_how_its_systems_are_solved(rng, monkeypatch):
    E = linalg.matrix(rng.integers(-99, 100, (9, 4)).tolist())
    b, r = ([Fraction(int(x), 7) for x in rng.integers(low, 100, 9)] for low in (-99, 1))
    usual, seen = chebyshev.chebyshev(E, b, r), []
    monkeypatch.setattr(chebyshev, "CROWDED", 1)
    monkeypatch.setattr(chebyshev, "lifted", lambda *args: seen.append(lifted(*args)) or seen[-1])
    assert chebyshev.chebyshev(E, b, r) == usual and len(seen) and all(seen)
