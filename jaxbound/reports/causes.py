"""The causes of alarms on a page: the named faults that alone explain each, with their sizes as bars."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from jaxbound.certificates.diagnosis import Diagnosis
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.models.system import LinearSystem

__all__ = ["Cause", "causes_of"]

PATIENCE = 3.0
"""Seconds for the causes of a page; those of the other alarms are left to `explain`."""
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
        try:
            causes[i] = cause_of(alarms[i].diagnose())
        except NotImplementedError:  # as of observers
            break
    return causes


def cause_of(found: Diagnosis) -> Cause:
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
