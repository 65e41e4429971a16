"""Sums in one order: of a recording they are the same bits, whatever stands beside it and however it lies in
memory.

NumPy adds pairwise where an axis of one recording lies last, and libraries of matrix products choose another
kernel for each shape. In blocks of one size, in one order of memory, NumPy's own loops treat all lanes alike.
"""

import numpy as np

from jaxbound.estimation.arrays import Array

__all__ = ["added", "mapped", "product"]


def added(X: np.ndarray, axis: int = 0) -> np.ndarray:
    """Return the sums of X along an axis, added up in order; 0 of nothing."""
    sums: np.ndarray
    if X.shape[axis]:
        sums = np.add.accumulate(X, axis).take(-1, axis)
    else:
        sums = X.sum(axis)
    return sums


def mapped(M: Array, X: Array, axis: int = 0) -> np.ndarray:
    """Return M X for M (r, n) and the axis of X that has n entries."""
    rows = np.moveaxis(np.asarray(X), axis, 0)
    out = np.zeros((len(M), *rows.shape[1:]), np.result_type(M, X))
    for column, row in zip(M.T, rows, strict=True):
        out += column.reshape(-1, *[1] * row.ndim) * row
    return np.moveaxis(out, 0, axis)


def product(M: Array, X: Array) -> np.ndarray:
    """Return M X for M (r, n), X (n, N) of a block of one size, by NumPy's own loop."""
    image: np.ndarray = np.einsum("ij,jN->iN", M, X)
    return image
