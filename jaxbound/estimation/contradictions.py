"""Samples that exact tests refute: an observer begins anew behind one, or FAULT stays.

Methods that test more than their zonotopes do ("joint", "constrained") share it. All are arrays (T, N), time
first, recordings last.
"""

import numpy as np

from jaxbound.estimation.zonotope_steps import ZonotopeCarry

__all__ = ["ended", "fresh_behind", "is_first", "staying"]


def is_first(wrong: np.ndarray) -> np.ndarray:
    """Return (T, N) bool: the first refuted sample of each recording."""
    return wrong & (np.cumsum(wrong, 0) == 1)


def fresh_behind(fresh: np.ndarray, refuted: np.ndarray) -> np.ndarray:
    """Return the samples that begin anew, those behind a refuted one with them."""
    anew = fresh.copy()
    anew[1:] |= refuted[:-1]
    return anew


def ended(carry: ZonotopeCarry, gone: np.ndarray) -> ZonotopeCarry:
    """Return a carry that knows nothing of some recordings, gone (N,), for each of its weights."""
    of_each = np.tile(gone, len(carry.age) // len(gone))
    return carry._replace(
        age=np.where(of_each, -1, carry.age).astype(np.int32), ready=np.where(of_each, 0, carry.ready)
    )


def staying(before: np.ndarray, wrong: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """Return (T, N): where a FAULT of an earlier sample, or of the piece before (N,), still stays; a gap ends
    it.
    """
    behind = np.zeros_like(wrong)
    stays = before
    for k in range(len(wrong)):
        behind[k] = stays & ~fresh[k]
        stays = behind[k] | wrong[k]
    return behind
