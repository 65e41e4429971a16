"""The causes of alarms on a page: the named faults that alone explain each, with their sizes as bars."""

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction

from jaxbound.certificates.diagnosis import Diagnosis
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.causes import Judged, diagnose
from jaxbound.models.system import LinearSystem

PATIENCE = 3.0
"""Seconds for the causes of a page; what is left over then is left to `explain`."""
LEAST = 0.02
"""Share of its place that the shortest bar takes."""
Bar = tuple[str, str, float | None]
"""(fault, its size or why it is excluded, length of its bar or None)."""


@dataclass(frozen=True)
class Cause:
    """The cause of an alarm in words. Fields: answer: the most plausible fault and its size; bars: a Bar for
    each named fault: the size beside a usual one, the longest of them 1.
    """

    answer: str
    bars: tuple[Bar, ...]


def causes_of(model: object, alarms: Sequence[Alarm], chosen: Sequence[int]) -> dict[int, Cause]:
    """Return {number of an alarm: its Cause}, of as many alarms as patience allows; none where the model
    names no faults.

    The worst window of each comes first, then more windows of each. An alarm for which no time is left has
    the cause that its rule worked out, if it did.

    Args:
        chosen: numbers of alarms, the deepest first.
    """
    causes: dict[int, Cause] = {}
    if not isinstance(model, LinearSystem) or not model.faults:
        return causes
    stop = time.perf_counter() + PATIENCE
    for i in chosen:
        if time.perf_counter() >= stop:
            break
        with suppress(NotImplementedError):  # as of observers
            causes[i] = _worst(alarms[i])
    for i in [*causes]:
        if time.perf_counter() >= stop:
            break
        if _is_longer(alarms[i]):
            with suppress(NotImplementedError):  # another window is an observer's
                causes[i] = cause_for_page(alarms[i].diagnose())
    for i in chosen:
        if i not in causes and alarms[i].cause:
            causes[i] = Cause(f"{alarms[i].cause}; looked at its worst window alone", ())
    return causes


def _worst(alarm: Alarm) -> Cause:
    """Return the cause of the worst window of an alarm."""
    if not isinstance(alarm.result, Judged):
        return cause_for_page(alarm.diagnose())
    found = cause_for_page(diagnose(alarm.result, alarm.worst, alarm.worst, recording=alarm.recording))
    if not _is_longer(alarm):
        return found
    return replace(found, answer=f"{found.answer}; looked at its worst window alone")


def _is_longer(alarm: Alarm) -> bool:
    """Whether more windows of an alarm than its worst one can be looked at."""
    return alarm.windows > 1 and isinstance(alarm.result, Judged)


def cause_for_page(found: Diagnosis) -> Cause:
    """Return a Diagnosis for a page."""
    largest = max(found.shares.values(), default=Fraction(0))
    bars: list[Bar] = []
    for name, words, share in found.lines:
        length: float | None = None
        if share is not None:
            length = 0.0
            if largest and name in found.shares:
                length = max(LEAST, float(share / largest))
        elif name in found.partly:
            windows = len(found.partly[name])
            looked_at = f"{windows} of the {len(found.windows)} windows that were looked at"
            words = f"explains {looked_at}, by {found.span(name)}"
        bars.append((name, words, length))
    answer = found.first
    if not found.explains:
        answer = "none of the named faults explains this"
    if found.outside:
        answer += f"; sizes and exclusions rest on extrapolation, {found.outside}"
    return Cause(answer, tuple(bars))
