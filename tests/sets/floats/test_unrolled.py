"""Sums and extremes over few rows that are written out, and over many in a loop: those of NumPy."""

import numpy as np

from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.unrolled import FEW, TOGETHER, foremost, largest, product, summed

COUNTS = (1, 2, TOGETHER + 1, FEW, FEW + 1, FEW + TOGETHER + 1, 5 * FEW + 3)


def test_products_and_sums_over_few_and_many_rows_are_those_of_numpy(rng):
    """Of small whole numbers, which are added up exactly in any order."""
    dot = kernel(lambda x, y: summed(lambda a, b: a * b, x, y))
    for count in COUNTS:
        A, x, y = (rng.integers(-9, 10, size).astype(float) for size in ((3, count), (count, 2), (count, 2)))
        np.testing.assert_array_equal(kernel(product)(A, x), A @ x)
        np.testing.assert_array_equal(dot(x, y), (x * y).sum(0))
    np.testing.assert_array_equal(kernel(product)(np.ones((3, 0)), np.ones((0, 2))), np.zeros((3, 2)))


def test_the_first_of_the_largest_rows_is_found(rng):
    one = np.ones(50)
    for count in (*COUNTS[:4], 5 * FEW + 3):
        rows = rng.integers(0, 3, (count, 50)).astype(float)
        for top, first in (kernel(largest)(rows, one), kernel(foremost)(rows)):
            np.testing.assert_array_equal(top, rows.max(0))
            np.testing.assert_array_equal(first, rows.argmax(0))
