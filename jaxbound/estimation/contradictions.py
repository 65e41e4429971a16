"""Samples that exact tests refute: an observer begins anew behind one, or FAULT stays.

All are arrays (T, N), time
first, recordings last.
"""

import numpy as np

from jaxbound.estimation.arrays import Array
from jaxbound.estimation.zonotope_steps import Found, ZonotopeCarry
from jaxbound.sets.floats.status import Status

__all__ = ["ended", "fresh_behind", "is_first", "latched", "staying", "with_refuted"]


def is_first(wrong: np.ndarray) -> np.ndarray:
    """Return (T, N) bool: the first refuted sample of each recording."""
    first: np.ndarray = wrong & (np.cumsum(wrong, 0) == 1)
    return first


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


def staying(before: Array, wrong: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """Return (T, N): where a FAULT of an earlier sample, or of the piece before (N,), still stays; a gap ends
    it.
    """
    behind = np.zeros_like(wrong)
    stays = np.asarray(before)
    for k in range(len(wrong)):
        behind[k] = stays & ~fresh[k]
        stays = behind[k] | wrong[k]
    return behind


def latched(carry: ZonotopeCarry, found: Found, stays: np.ndarray) -> tuple[ZonotopeCarry, Found]:
    """Return (carry, Found) where FAULT stays (T, N), behind the last sample too."""
    status = np.where(stays, np.int8(Status.FAULT), found.status)
    of_each = np.tile(stays[-1], len(carry.age) // stays.shape[-1])
    return carry._replace(empty=carry.empty | of_each), found._replace(status=status)


def with_refuted(found: Found, wrong: np.ndarray, margin: np.ndarray) -> Found:
    """Return Found with FAULT where an exact test refutes (T, N), and its margin where that is less.

    The margin of a FAULT is that of the test which found it: another one saw less.
    """
    lower = (margin < found.margin) & (wrong | (found.status != Status.FAULT))
    least = np.where(lower, margin, found.margin).astype(found.margin.dtype)
    return found._replace(status=np.where(wrong, np.int8(Status.FAULT), found.status), margin=least)
