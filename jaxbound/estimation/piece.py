"""Samples of recordings side by side, as the kernels of observers take them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Piece(NamedTuple):
    """T samples of N recordings, read once. Of one sample all are without their first axis.

    Fields: mid, rad (T, p, N): of the outputs, radius infinite where there is none; v, slip (T, m, N): inputs
    less their offset, and by which they may be off; known (T, N): whether every input is there; fresh (T, N):
    whether it does not follow the sample before; refuted (T, N): whether an exact test contradicts it.
    """

    mid: np.ndarray
    rad: np.ndarray
    v: np.ndarray
    slip: np.ndarray
    known: np.ndarray
    fresh: np.ndarray
    refuted: np.ndarray

    def cut(self, first: int, stop: int) -> Piece:
        """Return some of the samples."""
        return Piece(*(x[first:stop] for x in self))

    def filled(self, length: int) -> Piece:
        """Return the samples with zeros behind them, up to a length."""
        whole = Piece(*(np.zeros((length, *x.shape[1:]), x.dtype) for x in self))
        for out, x in zip(whole, self, strict=True):
            out[: len(x)] = x
        return whole
