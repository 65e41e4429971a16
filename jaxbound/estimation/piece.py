"""Samples of recordings side by side, as the kernels of observers take them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

__all__ = ["Piece"]


class Piece(NamedTuple):
    """Samples of N recordings side by side, as kernels take them.

    Fields: u, y, slip (T, ., N): inputs, outputs, and the error of recorded inputs; fresh (T, N): whether a
    sample does not follow the one before; rounded (): the unit roundoff of the type in which y was recorded;
    noise (T, p, N): bounds of errors, or None: those of the model at every sample.
    """

    u: np.ndarray
    y: np.ndarray
    slip: np.ndarray
    fresh: np.ndarray
    rounded: np.ndarray
    noise: np.ndarray | None = None

    def mapped(self, change: Callable[[np.ndarray], np.ndarray]) -> Piece:
        """Return the piece with another choice of its samples or recordings."""
        noise = None
        if self.noise is not None:
            noise = change(self.noise)
        columns = change(self.u), change(self.y), change(self.slip), change(self.fresh)
        return Piece(*columns, self.rounded, noise)

    def of_recordings(self, lanes: np.ndarray) -> Piece:
        """Return some of the recordings."""
        return self.mapped(lambda x: np.take(x, lanes, -1))

    def cut(self, first: int, stop: int) -> Piece:
        """Return some of the samples."""
        return self.mapped(lambda x: x[first:stop])

    def filled(self, length: int) -> Piece:
        """Return the samples with zeros behind them, up to a length."""
        return self.mapped(lambda x: _filled(x, length))


def _filled(x: np.ndarray, length: int) -> np.ndarray:
    """Return x with zeros behind, up to a length."""
    out = np.zeros((length, *x.shape[1:]), x.dtype)
    out[: len(x)] = x
    return out
