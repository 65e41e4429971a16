"""The claim of FAULT where a window reads inputs outside the region of training: a fault, or nothing."""

import numpy as np

from jaxbound.consistency.bank import HIGH
from jaxbound.consistency.interface import Judged
from jaxbound.models.region import Departure
from jaxbound.sets.floats.status import Status

__all__ = ["CLAIMED", "UNCLAIMED", "refuse_outside", "unclaimed"]

OUTSIDE = CLAIMED, UNCLAIMED = "fault", "undecided"
"""What FAULT outside the region of training is called."""


def refuse_outside(outside: str) -> None:
    """Raise ValueError for a word that FAULT outside the region of training cannot be called."""
    if outside not in OUTSIDE:
        raise ValueError(f"outside must be one of {', '.join(OUTSIDE)}, not {outside!r}")


def unclaimed(judged: Judged, departure: Departure) -> Judged:
    """Return verdicts with UNDECIDED in place of FAULT outside the region, of each relation of a bank too."""
    out = departure.share > 0
    fault = out & (judged.status == Status.FAULT)
    words = judged.words
    if words is not None:
        words = np.where(out, _without_fault(words), words)
    return judged._replace(status=np.where(fault, np.int8(Status.UNDECIDED), judged.status), words=words)


def _without_fault(words: np.ndarray) -> np.ndarray:
    """Return packed verdicts with UNDECIDED in place of FAULT: of both bits the low one goes."""
    fault = words & (words << np.uint32(1)) & HIGH
    return np.asarray(words & ~(fault >> np.uint32(1)))
