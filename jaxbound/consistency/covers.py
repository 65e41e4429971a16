"""Status of windows, from boxes of their unknowns that are left and boxes that hold a proof."""

import numpy as np

from jaxbound.sets.floats.status import Status
from jaxbound.sets.paving.frontier import Cover

__all__ = ["status_of_cover"]


def status_of_cover(cover: Cover, count: int) -> np.ndarray:
    """Return the status (count,) of windows: FAULT where no box is left, CONSISTENT where one is a proof."""
    left = np.bincount(cover.owner, minlength=count)
    status = np.where(left == 0, np.int8(Status.FAULT), np.int8(Status.UNDECIDED))
    status[cover.proofs[2]] = Status.CONSISTENT
    return status
