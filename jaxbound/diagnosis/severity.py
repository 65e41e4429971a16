"""Severity: which FAULT windows no error of one sensor below a size explains.

An error of up to e in the samples of an output is a noise bound larger by e, on that output alone. So a
window that is FAULT under such a bound is proved to need a larger error of that sensor, or another fault. The
test is the same compiled kernel as that of the verdicts, over FAULT windows alone.

A FAULT of a monitor counts where the test that speaks proves the size: windows do, observers prove none.
"""

from collections.abc import Mapping
from typing import cast

import numpy as np

from jaxbound.consistency.drive import stretches_around, windows
from jaxbound.consistency.interface import METHODS, Relations
from jaxbound.consistency.monitorbank import MonitorBank
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.suspects import nameless
from jaxbound.models.watched import YES
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.kernel import sparing
from jaxbound.sets.floats.status import Status


class Severity:
    """The tests by which FAULT windows of relations, or of a monitor, count.

    Args:
        relations, method: as tested. least: {output: size}, in units.

    Fields: wider: {number of a test: its relations under a wider bound, one for each size}.

    Raises:
        ValueError: relations that do not tell the errors of single sensors.
    """

    def __init__(self, relations: Relations, method: str, least: Mapping[str, float]) -> None:
        self.relations, self.method = relations, method
        if relations.parts:
            self.method = METHODS[0]
        self.wider: dict[int, list[Relations]] = {}
        for number, watch in enumerate(relations.watches):
            try:
                self.wider[number] = _wider(watch.relations, least)
            except ValueError as e:
                refused = e
        if not self.wider and relations.parts:
            raise ValueError(f"no test of this monitor proves a size: {refused}")
        if not self.wider:
            raise refused

    def reached(
        self, u: np.ndarray, y: np.ndarray, fault: np.ndarray, by: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the FAULT windows that count, (T,) bool.

        Args:
            u (T, m), y (T, p): samples in which those windows lie as a whole. fault: (T,) bool, the windows
                that are FAULT. by: (T,), of a monitor the number of the test that speaks.
        """
        if by is None:
            return self._reached(0, np.asarray(u), np.asarray(y), fault)
        bank = cast(MonitorBank, self.relations)
        modes = bank.modes_of(np.asarray(u))
        piece = Recording(np.asarray(u), np.asarray(y))
        counts = np.zeros(len(fault), bool)
        for number in self.wider:
            own = fault & (by == number)
            condition = bank.conditions_of[number]
            if condition >= 0:  # of an unknown mode one test alone proves nothing
                own &= modes[:, condition] == YES
            if own.any():
                seen = bank.seen_by(number, piece, modes)
                counts |= self._reached(number, seen.u, seen.y, own)
        return counts

    def _reached(self, number: int, u: np.ndarray, y: np.ndarray, fault: np.ndarray) -> np.ndarray:
        """Return the FAULT windows of one test that count."""
        counts = fault.copy()
        for relations in self.wider[number]:
            at = np.flatnonzero(counts)
            if not len(at):
                break
            test = relations.test(self.method, y.dtype)
            assert not test.remembers, "an observer was refused"
            first, samples = stretches_around(at, relations.horizon)
            with sparing():
                judged = windows(test, Recording(u[samples], y[samples], first[1:]))
            counts[at] = judged.status[np.searchsorted(samples, at)] == Status.FAULT
        return counts


def _wider(relations: Relations, least: Mapping[str, float]) -> list[Relations]:
    """Return relations under the noise bound of each output of least sizes, wider by its size."""
    refused = (
        f"a least size of an alarm is for windows of a plant with bounds on its noise, not for "
        f"{type(relations).__name__}: leave it out, or state windows beside it as a [[test]]"
    )
    if relations.remembers or "noise" not in relations.bounds:
        raise ValueError(refused)
    outputs, wider = list(relations.model.outputs), []
    for name, size in least.items():
        noise = np.array(relations.bounds["noise"], float)
        own = outputs.index(name)
        noise[own] = np.nextafter(noise[own] + size, np.inf)
        try:
            wider.append(relations.with_bounds({"noise": noise}))
        except NotImplementedError:
            raise ValueError(refused) from None
    return wider


def fitted(rule: AlarmRule, relations: Relations) -> AlarmRule:
    """Return a rule for alarms of relations, see `AlarmRule.fitted`.

    Raises:
        ValueError: as there; suspects, or sizes, are asked of windows that do not tell them.
    """
    why = nameless(relations)
    if rule.suspects and why:
        raise ValueError(f"these alarms name no suspects: {why}; leave out suspects")
    rule = rule.fitted(relations.model)
    if isinstance(rule.least, Mapping):
        Severity(relations, "joint", rule.least)
    return rule
