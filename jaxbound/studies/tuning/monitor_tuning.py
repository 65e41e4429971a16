"""Tuning a monitor: one factor on the bounds of each of its tests, found as for this test alone, on the
samples at which it watches.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, Context, Decimal
from fractions import Fraction
from functools import partial
from typing import TypeAlias, cast

import numpy as np

from jaxbound.consistency.monitorbank import MonitorBank
from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.monitoring import monitor, relations_of_test
from jaxbound.models.statedtests import StatedTest
from jaxbound.models.system import LinearSystem
from jaxbound.models.watched import NO, UNKNOWN
from jaxbound.studies.tuning.parametrization import Tunable, tuned_model
from jaxbound.studies.tuning.scaling import JoinedRecordings, both_recordings
from jaxbound.studies.tuning.tune_result import TuneResult, caught_of
from jaxbound.text.objects import readable
from jaxbound.text.progress import in_part

DIGITS = 4
"""Of a factor in a model file."""
UNSCALED = "parameters"
"""Bounds that the factor of a test leaves as they are."""
TuneOne: TypeAlias = Callable[..., TuneResult]


@readable
@dataclass(frozen=True, eq=False)
class MonitorTuneResult:
    """The factors of a monitor's tests that were tuned, and what is known of them.

    Fields:
        tests: {name: TuneResult} of each test as it is tuned alone, on the samples at which it watches.
        factors: {name: Fraction} on the bounds of the model, as .model states them: smallest times factor
            times safety, rounded up to four digits. start: the same, before.
        counts: {status name: healthy samples} of the monitor under .model; FAULT is 0. faulty_counts: the
            same of the faulty samples, or None.
        model: the LinearSystem with these factors, for `save_model`. relations: its monitor, for `detect`.
        notes: sentences on what did not move.
    """

    tests: Mapping[str, TuneResult]
    factors: Mapping[str, Fraction]
    start: Mapping[str, Fraction]
    counts: dict[str, int]
    faulty_counts: dict[str, int] | None
    model: LinearSystem
    relations: MonitorBank
    notes: tuple[str, ...]

    @property
    def caught(self) -> float | None:
        """The share of faulty samples with a verdict that are FAULT, or None."""
        return caught_of(self.faulty_counts)


def tuned_monitor(
    bank: MonitorBank, healthy: object, faulty: object, tune_one: TuneOne, report: Callable[[float], object]
) -> MonitorTuneResult:
    """Return the factors of a monitor's tests.

    Args:
        healthy, faulty: as of `tune`. tune_one: tunes one test, tune_one(relations, healthy, faulty,
            bounds=.., progress=..).

    Raises:
        ValueError: as `tune` of each test; a test whose factor does not scale its bounds around 0; healthy
            samples of an unknown mode that every mode refutes.
    """
    stated = {test.name: test for test in bank.plant.tests}
    if tuple(stated) != bank.names:
        raise ValueError("tune needs a monitor of tests that its model states, from jb.monitor")
    good, bad = both_recordings(bank.plant, bank.horizon, healthy, faulty)
    start = {name: test.factor for name, test in stated.items()}
    tunings: dict[str, TuneResult] = {}
    notes: list[str] = []
    factors = dict(start)
    for number, (name, test) in enumerate(stated.items()):
        watched = _watched(bank, number, good)
        if not watched:
            notes.append(f"test {name!r} watches no healthy sample: its factor stays {float(test.factor):g}")
            continue
        faults = None
        if bad is not None:
            faults = _watched(bank, number, bad) or None
        relations = _scalable(bank, test)
        scaled = tuple(name for name in relations.bounds if name != UNSCALED)
        progress = partial(in_part, report, number / len(stated), 1 / len(stated))
        try:
            one = tune_one(relations, watched, faults, bounds=scaled, progress=progress)
        except ValueError as e:
            raise ValueError(f"test {name!r}: {e}") from None
        tunings[name] = one
        # rounded up: what healthy data proved holds under wider bounds
        factors[name] = short_factor(test.factor * _grown(one))
        notes += one.notes
    if not tunings:
        raise ValueError("no test of this monitor watches a sample of the healthy data")
    model, tuned = _accepted(bank, stated, factors, good)
    return MonitorTuneResult(
        tests=tunings,
        factors={test.name: test.factor for test in model.tests},
        start=start,
        counts=dict(detect(tuned, good).counts),
        faulty_counts=None if bad is None else dict(detect(tuned, bad).counts),
        model=model,
        relations=tuned,
        notes=tuple(dict.fromkeys(notes)),
    )


def _watched(bank: MonitorBank, number: int, given: JoinedRecordings) -> list[JoinedRecordings]:
    """Return the recordings as a test sees them, without those of which it sees nothing.

    Where its condition is not known it proves nothing by itself: nothing has to be explained there.
    """
    horizon = bank.watches[number].relations.horizon
    seen: list[JoinedRecordings] = []
    for entry in range(len(given.entries)):
        recording, _ = given.split(entry)
        modes = bank.modes_of(recording.u)
        own = bank.seen_by(number, recording, np.where(modes == UNKNOWN, NO, modes))
        if not own.without(horizon).all():
            seen.append(own)
    return seen


def _scalable(bank: MonitorBank, test: StatedTest) -> Tunable:
    """Return the relations of a test, whose bounds its factor scales.

    Raises:
        ValueError: a disturbance that does not lie around 0.
    """
    relations = cast(Tunable, relations_of_test(bank.plant, test))  # there are no others
    for lo, hi in tuned_model(relations).disturbance:
        if lo + hi != 0:
            raise ValueError(
                f"test {test.name!r}: its factor widens the disturbance from {float(lo):g} to {float(hi):g} "
                f"around its middle, which is not 0: state it as an offset and a disturbance around 0"
            )
    return relations


def _grown(one: TuneResult) -> Fraction:
    """Return how many times as wide as the starting bounds those that were found are."""
    ratios = []
    for name, smallest in one.smallest.items():
        begun, least = np.ravel(one.start[name]), np.ravel(smallest)
        moved = (begun != 0) & (least != begun)
        ratios.extend((least[moved] / begun[moved]).tolist())
    return Fraction(max(ratios, default=1.0)) * Fraction(one.factor * one.safety)


def short_factor(factor: Fraction) -> Fraction:
    """Return a factor that is not smaller, as a short decimal.

    Example:
        >>> short_factor(Fraction(4, 3))
        Fraction(667, 500)
    """
    up = Context(prec=DIGITS, rounding=ROUND_CEILING)
    return Fraction(up.divide(Decimal(factor.numerator), Decimal(factor.denominator)))


def _accepted(
    bank: MonitorBank,
    stated: Mapping[str, StatedTest],
    factors: Mapping[str, Fraction],
    good: JoinedRecordings,
) -> tuple[LinearSystem, MonitorBank]:
    """Return the model with these factors and its monitor, which finds no FAULT in healthy samples; a little
    wider where rounding, or a set that does not grow with its bounds, asks for it.
    """
    extra = Fraction(1)
    while extra <= 2:
        tests = []
        for name, test in stated.items():
            factor = factors[name]
            if factor != test.factor:
                factor = short_factor(factor * extra)
            tests.append(replace(test, factor=factor))
        model = bank.plant.replace(tests=tests)
        tuned = monitor(model)
        if not detect(tuned, good).counts["FAULT"]:
            return model, tuned
        extra *= Fraction(1001, 1000)
    raise ValueError(
        "the monitor refutes a healthy sample whose mode is not known, whatever the mode: give recordings "
        "with values of all that the conditions read"
    )
