"""Severity: which FAULT windows no error of one sensor below a size explains.

An error of up to e in the samples of an output is a noise bound larger by e, on that output alone. So a
window that is FAULT under such a bound is proved to need a larger error of that sensor, or another fault. The
test is the same compiled kernel as that of the verdicts, over FAULT windows alone.
"""

from collections.abc import Mapping

import numpy as np

from jaxbound.consistency.drive import windows
from jaxbound.consistency.interface import Relations, WindowTest
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.suspects import nameless
from jaxbound.sets.floats.status import Status

__all__ = ["Severity", "fitted"]


class Severity:
    """The test by which FAULT windows count.

    Args:
        relations, method: as tested. least: {output: size}, in units.

    Raises:
        ValueError: relations that do not tell the errors of single sensors.
    """

    def __init__(self, relations: Relations, method: str, least: Mapping[str, float]) -> None:
        self.horizon, self.method = relations.horizon, method
        refused = (
            f"a least size of an alarm is for windows of a plant with bounds on its noise, not for "
            f"{type(relations).__name__}: leave it out"
        )
        if relations.remembers or "noise" not in relations.bounds:
            raise ValueError(refused)
        self.wider: list[Relations] = []
        outputs = list(relations.model.outputs)
        for name, size in least.items():
            noise = np.array(relations.bounds["noise"], float)
            own = outputs.index(name)
            noise[own] = np.nextafter(noise[own] + size, np.inf)
            try:
                self.wider.append(relations.with_bounds({"noise": noise}))
            except NotImplementedError:
                raise ValueError(refused) from None

    def reached(self, u: np.ndarray, y: np.ndarray, fault: np.ndarray) -> np.ndarray:
        """Return the FAULT windows that count, (T,) bool.

        Args:
            u (T, m), y (T, p): samples in which those windows lie as a whole. fault: (T,) bool, the windows
                that are FAULT.
        """
        counts = fault.copy()
        for relations in self.wider:
            at = np.flatnonzero(counts)
            if not len(at):
                break
            first, samples = _around(at, self.horizon)
            test = relations.test(self.method, y.dtype)
            assert isinstance(test, WindowTest), "an observer was refused"
            judged = windows(test, np.asarray(u)[samples], np.asarray(y)[samples], first[1:])
            counts[at] = judged.status[np.searchsorted(samples, at)] == Status.FAULT
        return counts


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


def _around(at: np.ndarray, horizon: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (where stretches of samples begin, the samples that windows at `at` need, each once)."""
    begins = at - horizon
    apart = np.flatnonzero(begins[1:] > at[:-1]) + 1  # windows that share no sample with those before
    starts = np.concatenate([begins[:1], begins[apart]])
    stops = np.concatenate([at[apart - 1], at[-1:]]) + 1
    lengths = stops - starts
    samples = np.arange(lengths.sum()) + np.repeat(starts - np.cumsum(lengths) + lengths, lengths)
    return np.cumsum(lengths) - lengths, samples
