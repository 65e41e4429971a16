"""Matrix products that BLAS leaves to one thread: on a busy machine threads that wait for each other take
twenty times as much of the processors as products of this size.
"""

import numpy as np

ALONE = 2**18
"""Multiplications up to which OpenBLAS takes one thread."""


def times(x: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return the product of x (..., N, k) and a matrix (..., k, n).

    Example:
        >>> times(np.ones((2, 3)), np.ones((3, 1)))
        array([[3.],
               [3.]])
    """
    rows = max(1, ALONE // max(matrix.shape[-2] * matrix.shape[-1], 1))
    product = np.empty((*x.shape[:-1], matrix.shape[-1]))
    for first in range(0, x.shape[-2], rows):
        here = slice(first, first + rows)
        product[..., here, :] = x[..., here, :] @ matrix
    return product
