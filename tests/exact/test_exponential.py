"""The matrix exponential and its integral: in whole numbers against inverses, in floats against SciPy."""

from fractions import Fraction

import numpy as np
import pytest
from scipy import linalg

from jaxbound.exact.exponential import _halvings, absolute_integral, exponential


@pytest.mark.parametrize("scale", [0.1, 3.0, 40.0])
def test_exponential_and_its_integral_enclose(scale, rng):
    A = rng.normal(size=(3, 3)) * scale
    A = A - (np.linalg.eigvals(A).real.max() + 0.1) * np.eye(3)
    exact = [[Fraction(float(v)) for v in row] for row in A]
    X, e = exponential(exact)
    Y, f = exponential([[-v for v in row] for row in exact])  # e^A e^-A = 1, in whole numbers
    defect = (
        np.abs(X @ Y - np.array([[Fraction(i == j) for j in range(3)] for i in range(3)], object))
        .sum(1)
        .max()
    )
    assert defect <= e * np.abs(Y).sum(1).max() + f * np.abs(X).sum(1).max() + e * f
    np.testing.assert_allclose(X.astype(float), linalg.expm(A), atol=1e-12 * np.abs(linalg.expm(A)).max())
    t = np.linspace(0, 1, 2001)
    small = linalg.expm(A / 2000)
    path = np.array([np.linalg.matrix_power(small, k) for k in range(2001)])
    integral = np.trapezoid(np.abs(path), t, axis=0)
    bound = absolute_integral(exact, Fraction(1)).astype(float)
    assert (bound > integral * (1 - 1e-4)).all() and (bound.max() < 1.05 * integral.max() or scale > 5)


def test_a_matrix_is_halved_until_its_norm_is_small_and_no_further():
    small = Fraction(1, 4)
    for norm in map(Fraction, ["1/8", "1/4", "3/8", "1/2", "5/8", "1", "9/8", "4", "33/8"]):
        halvings = _halvings(np.array([[norm / 2, -norm / 2], [0, 0]], object), small)
        assert norm / 2**halvings <= small and (not halvings or norm / 2 ** (halvings - 1) > small)
