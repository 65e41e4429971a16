"""Detectors that are compared: each says of a recording which windows it would call faulty at any factor on
its bounds.
"""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cache
from typing import Any, NamedTuple, Protocol, cast

import numpy as np

from jaxbound.consistency.interface import EXACT, Relations
from jaxbound.consistency.monitorbank import MonitorBank
from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.monitoring import monitor
from jaxbound.diagnosis.result import Result
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.status import Status
from jaxbound.studies.tuning.parametrization import model_with, moving

BY_MARGIN = ("joint", "box")
"""Methods whose margins say at which factor on the bounds a window becomes consistent."""


class Flags(Protocol):
    """The windows of one recording that a detector calls faulty."""

    def faults(self, factor: float) -> np.ndarray:
        """Return (T,) bool, at a factor on the bounds."""

    @property
    def needs(self) -> np.ndarray | None:
        """(T,), the factor up to which each window is called faulty, NaN for none; None: not known."""


class Detector:
    """One of those that are compared.

    Fields: name: in tables. note: how it was made, in a sentence.
    """

    name: str
    note: str

    def flags(self, recording: Recording) -> Flags:
        """Judge a recording."""
        raise NotImplementedError

    def factors(self, wanted: Sequence[float]) -> list[float]:
        """Return those factors on its bounds, or on its threshold, that it can be asked for."""
        return list(wanted)


class Needs(NamedTuple):
    """Flags by one number a window. Fields: needs, (T,), the factor at which it becomes quiet, or NaN."""

    needs: np.ndarray

    def faults(self, factor: float) -> np.ndarray:
        """Return (T,) bool."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.needs > factor)


class Verdicts:
    """Flags of a Result: FAULT at factor 1 as proved; elsewhere by its margins, or tested again.

    Fields: result, tested: (T,) bool.
    """

    def __init__(self, result: Result, monitor: "Monitored", recording: Recording) -> None:
        self.result, self.tested = result, result.status != Status.MISSING
        self._monitor, self._recording = monitor, recording
        self._again = cache(self._tested_again)

    @property
    def needs(self) -> np.ndarray | None:
        """(T,), 1 - margin."""
        if not self._monitor.by_margin:
            return None
        return np.asarray(1 - self.result.margin)

    def faults(self, factor: float) -> np.ndarray:
        """Return (T,) bool."""
        if factor == 1:
            return np.asarray(self.result.status == Status.FAULT)
        needs = self.needs
        if needs is not None:
            return Needs(needs).faults(factor)
        return self._again(factor)

    def _tested_again(self, factor: float) -> np.ndarray:
        again = detect(self._monitor.scaled(factor), self._recording)
        return np.asarray(again.status == Status.FAULT)


def _is_of_windows(relations: Relations) -> bool:
    """Return whether one margin a sample says at which factor it becomes quiet: of windows, or of several
    tests by windows that always watch.
    """
    if not relations.parts:
        return not relations.remembers
    return not any(watch.relations.remembers or watch.when for watch in relations.watches)


class Monitored(Detector):
    """Relations, or an observer, of jaxbound."""

    def __init__(self, relations: Relations, method: str) -> None:
        self.relations, self.method, self.name = relations, method, "jaxbound"
        self.by_margin = method in BY_MARGIN and bool(relations.bounds) and _is_of_windows(relations)
        self.follows = relations.remembers and relations.untuned is None and not self.by_margin
        if relations.parts:  # one of tests that no model states cannot be built anew
            self.follows = not self.by_margin and bool(cast(MonitorBank, relations).plant.tests)
        self.note = "at the bounds as they are: its margins do not say what other bounds would give"
        if self.by_margin:
            self.note = "at factors other than 1 by exact margins: as computed, not proved"
        elif self.follows:
            self.note = "an observer follows each recording once a factor"
            if relations.parts:
                self.note = "all tests judge each recording once a factor"

    def factors(self, wanted: Sequence[float]) -> list[float]:
        """Return 1 alone where margins do not say what other bounds would give."""
        if self.by_margin or self.follows:
            return list(wanted)
        return [1.0]

    def flags(self, recording: Recording) -> Verdicts:
        """Judge a recording."""
        result = detect(self.relations, recording, method=self.method, margins=EXACT)
        return Verdicts(result, self, recording)

    def scaled(self, factor: float) -> Relations:
        """Return the observer, or the monitor, with bounds so many times as wide."""
        if self.relations.parts:
            bank = cast(MonitorBank, self.relations)
            tests = []
            for test in bank.plant.tests:
                tests.append(replace(test, factor=test.factor * Fraction(factor)))
            return monitor(bank.plant, tests)
        watch = cast(SetObserver[Any], self.relations)
        moved = moving(watch)
        return watch.of(model_with(watch, moved, moved.rounded_up(factor * moved.start), ""))
