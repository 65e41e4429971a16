"""The cause of an alarm: the named faults that explain each of some of its windows."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np

from jaxbound.certificates.diagnosis import Diagnosis
from jaxbound.certificates.interface import WindowCertificate
from jaxbound.models.named_faults import NamedFault
from jaxbound.sets.floats.status import Status

__all__ = ["Judged", "diagnose"]

MOST = 5
"""Windows of an alarm that a cause has to explain: what no window excludes costs the most."""


@runtime_checkable
class Judged(Protocol):
    """Verdicts of a recording whose windows are explained, as a Result has them."""

    @property
    def status(self) -> np.ndarray:
        """(..., T)."""

    @property
    def margin(self) -> np.ndarray:
        """(..., T)."""

    def explain(self, at: int | tuple[int, ...]) -> WindowCertificate:
        """Return the certificate of the window that ends at a sample; of a batch `at` is a tuple."""


def diagnose(
    result: Judged,
    start: int,
    end: int,
    faults: Sequence[NamedFault] | None = None,
    recording: tuple[int, ...] = (),
) -> Diagnosis:
    """Return the Diagnosis of the FAULT windows that end at samples start <= k <= end: see
    `Result.diagnose`.
    """
    fault = np.flatnonzero(result.status[recording][start : end + 1] == Status.FAULT) + start
    if not len(fault):
        raise ValueError(
            f"no window that ends from {start} to {end} is a FAULT: there is nothing to diagnose"
        )
    margin = result.margin[recording][fault]
    chosen = [int(fault[np.argmin(np.where(np.isnan(margin), np.inf, margin))])]
    spread = np.linspace(0, len(fault) - 1, min(len(fault), MOST)).round().astype(int)
    for k in fault[spread].tolist():
        if k not in chosen and len(chosen) < MOST:
            chosen.append(k)
    found: Diagnosis | None = None
    left = faults
    for k in chosen:
        at: int | tuple[int, ...] = k
        if recording:
            at = (*recording, k)
        one = result.explain(at).diagnose(left)
        if found is not None:
            one = found.and_of(one)
        found = one
        left = [weighed.fault for weighed in found.explains]
        if not left:
            break
    assert found is not None
    return replace(found, of=len(fault))
