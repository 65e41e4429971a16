"""Tuning a set observer: the smallest factor on all its bounds under which it follows healthy recordings to
their ends.

Its margins say by how much a sample is off, not by which factor on all bounds it would not be: what it
carries depends on them. So the factor is found by bisection over whole recordings. Approximate sets need not
grow with the bounds: both ends of the bracket are verdicts of the observer, what lies between is not known.
"""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from jaxbound.estimation.set_observer import SetObserver
from jaxbound.sets.floats.status import Status
from jaxbound.studies.tuning.confidence import risk_of_recordings
from jaxbound.studies.tuning.left_out import of_needs
from jaxbound.studies.tuning.parametrization import model_with, moving, tuned_model
from jaxbound.studies.tuning.scaling import both_recordings
from jaxbound.studies.tuning.tune_result import TuneResult
from jaxbound.studies.tuning.widening import Smallest, concluded

CLOSE = 1.01
"""Ratio of the ends of a bracket."""
LEAST, MOST = 2.0**-20, 2.0**20


def tuned_observer(
    watch: SetObserver[Any],
    healthy: object,
    faulty: object,
    bounds: str | Iterable[str] | None,
    safety: float,
    confidence: float,
    report: Callable[[float], object],
) -> TuneResult:
    """Return the bounds of an observer, all scaled by one factor."""
    moved = moving(watch, bounds)
    good, bad = both_recordings(tuned_model(watch), watch.horizon, healthy, faulty)

    def scaled(scale: float) -> SetObserver[Any]:
        return watch.of(model_with(watch, moved, moved.rounded_up(scale * moved.start), ""))

    needs = []
    for number in range(len(good.entries)):
        own, _ = good.split(number)
        needs.append(observer_scale(scaled, own.u, own.y, own.starts))
        report(0.95 * (number + 1) / len(good.entries))
    scale = max(needs)
    risk = risk_of_recordings(np.array(needs) / scale, confidence, safety)
    found = Smallest(scale * moved.start, scale, of_needs(needs), risk, [])
    result = concluded(watch, moved, found, safety, good, bad)
    report(1.0)
    return result


def _has_no_fault(watch: SetObserver[Any], u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> bool:
    """Return whether no sample of a recording is a FAULT, decided once: a search asks often, and what it
    finds is verified by `detect`.
    """
    _, recording = watch.recording(u if u.shape[1] else None, y, starts)
    alone = watch.telling(enclosures=False)
    _, samples = alone.side_by_side(alone.begin(), recording)
    _, found = alone.found(alone.begin(), samples)
    return not (np.asarray(found.status) == Status.FAULT).any()


def observer_scale(
    build: Callable[[float], SetObserver[Any]], u: np.ndarray, y: np.ndarray, starts: np.ndarray
) -> float:
    """Return a factor at which an observer follows a recording, and at .99 times which it does not.

    Args:
        build: of a factor, the observer whose bounds are so many times as wide. u (T, m), y (T, p), starts:
            the recording.

    Raises:
        ValueError: no factor up to a million will do.
    """

    def holds(scale: float) -> bool:
        return _has_no_fault(build(scale), u, y, starts)

    high = 1.0
    if holds(high):
        low = high / 2
        while low > LEAST and holds(low):
            low, high = low / 2, low
    else:
        low, high = high, 2 * high
        while not holds(high):
            low, high = high, 2 * high
            if high > MOST:
                raise ValueError(
                    "no size of the bounds that move lets the observer follow a healthy recording: let other "
                    "bounds move too, or look at it"
                )
    while high > CLOSE * low:
        middle = (low * high) ** 0.5
        if holds(middle):
            high = middle
        else:
            low = middle
    return high
