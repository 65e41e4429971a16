"""The cause of an alarm: the named faults that explain each of some of its windows."""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cache
from typing import Protocol, runtime_checkable

import numpy as np

from jaxbound.certificates.diagnosis import Diagnosis
from jaxbound.certificates.fault_size import FaultSize
from jaxbound.certificates.interface import WindowCertificate
from jaxbound.models.named_faults import NamedFault
from jaxbound.models.region import Departure
from jaxbound.recordings.sample_axis import Place
from jaxbound.sets.floats.status import Status

MOST = 5
"""Windows of an alarm that a cause has to explain: what no window excludes costs the most."""


class Verdicts(Protocol):
    """The verdicts of some samples: a Result, a Judged, or anything else with a status of each.

    Fields: status: (..., T) int8, see `Status`; margin: (..., T); departure: (..., T) from the region of
    training, None: it is not known.
    """

    @property
    def status(self) -> np.ndarray:
        """Of each sample."""

    @property
    def margin(self) -> np.ndarray:
        """Of each sample, NaN where there is none."""

    @property
    def departure(self) -> Departure | None:
        """Of each sample."""


class Explained(Protocol):
    """Verdicts whose windows are explained."""

    def explain(self, at: Place) -> WindowCertificate:
        """Return the certificate of the window that ends at a sample; of a batch `at` is a tuple."""

    def when(self, k: int) -> object:
        """Return the time of sample k; None: nothing tells it."""


@runtime_checkable
class Judged(Verdicts, Explained, Protocol):
    """Verdicts of a recording whose windows are grouped and explained, as a Result has them."""


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
    others = fault[fault != chosen[0]]
    spread = np.linspace(0, len(others) - 1, min(len(others), MOST - 1)).round().astype(int)
    chosen += others[spread].tolist()

    @cache
    def explained(k: int) -> WindowCertificate:
        at: int | tuple[int, ...] = k
        if recording:
            at = (*recording, k)
        return result.explain(at)

    def one(k: int, candidates: Sequence[NamedFault] | None) -> Diagnosis:
        return explained(k).diagnose(candidates)

    diagnosis = one(chosen[0], faults)
    for k in chosen[1:]:
        if not diagnosis.explains:
            break
        diagnosis = diagnosis.and_of(one(k, [weighed.fault for weighed in diagnosis.explains]))
    outside = ""
    if result.departure is not None:
        windows = result.departure.cut(recording).cut(np.array(chosen))
        farthest = int(np.argmax(np.nan_to_num(windows.share, nan=0.0, posinf=np.inf)))
        if windows.share[farthest] > 0:
            outside = windows.words(farthest, explained(chosen[farthest]).test)
    diagnosis = replace(diagnosis, of=len(fault), outside=outside)
    if diagnosis.explains or len(chosen) == 1:
        return diagnosis
    partly: dict[str, tuple[int, ...]] = {}
    ends: dict[str, tuple[FaultSize, FaultSize]] = {}
    for k in sorted(chosen):
        for weighed in one(k, faults).explains:
            name = weighed.fault.name
            partly[name] = (*partly.get(name, ()), k)
            least, most = ends.get(name, (weighed, weighed))
            ends[name] = min(weighed, least, key=_magnitude), max(weighed, most, key=_magnitude)
    order = sorted(partly, key=lambda name: -len(partly[name]))
    partly = {name: partly[name] for name in order}
    return replace(diagnosis, windows=tuple(sorted(chosen)), partly=partly, ends=ends)


def _magnitude(weighed: FaultSize) -> Fraction:
    """Return how large a fault that explains a window is."""
    return abs(weighed.size or Fraction(0))
