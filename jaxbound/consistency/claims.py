"""The claim of FAULT where a window reads inputs outside the region of training: a fault, or nothing."""

from typing import Any, TypeVar

import numpy as np

from jaxbound.consistency.bank import HIGH
from jaxbound.models.region import Departure, Region
from jaxbound.sets.floats.status import Status

Claims = TypeVar("Claims", bound=Any)
"""The type of verdicts: a Judged, or what one test of many says of a bank."""
OUTSIDE = CLAIMED, UNCLAIMED = "fault", "undecided"
"""What FAULT outside the region of training is called."""


def refuse_outside(outside: str) -> None:
    """Raise ValueError for a word that FAULT outside the region of training cannot be called."""
    if outside not in OUTSIDE:
        raise ValueError(f"outside must be one of {', '.join(OUTSIDE)}, not {outside!r}")


def placed(judged: Claims, region: Region | None, u: np.ndarray, outside: str) -> Claims:
    """Return verdicts (T,) with their departure from the region of training, None where there is none.

    Args:
        u: (B + T, m), the inputs of the samples, and of so many before them as there are. outside: what FAULT
            there is called.
    """
    if region is None:
        return judged
    before = len(u) - len(judged.status)
    missing = np.concatenate([np.zeros(before, bool), judged.status == Status.MISSING])
    departure = region.departure(u, missing).cut(slice(before, None))
    if outside == UNCLAIMED:
        judged = unclaimed(judged, departure)
    claims: Claims = judged._replace(departure=departure)
    return claims


def unclaimed(judged: Claims, departure: Departure) -> Claims:
    """Return verdicts with UNDECIDED in place of FAULT outside the region: of each relation of a bank, and of
    each test of a monitor, too.
    """
    out = departure.share > 0
    changed: dict[str, Any] = {"status": _undecided_where(judged.status, out)}
    words = judged.words
    if words is not None:
        fault = words & (words << np.uint32(1)) & HIGH  # of both bits the low one goes
        changed["words"] = np.where(out, words & ~(fault >> np.uint32(1)), words)
    if getattr(judged, "statuses", None) is not None:  # of a monitor
        changed["statuses"] = _undecided_where(judged.statuses, out[..., None])
    claims: Claims = judged._replace(**changed)
    return claims


def _undecided_where(status: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Return statuses, UNDECIDED in place of FAULT where `out` says."""
    return np.where(out & (status == Status.FAULT), np.int8(Status.UNDECIDED), status)
