"""Verdicts of windows that a device searched which nobody has examined: it may lie, the host proves.

What such a device hands back are hints. Every FAULT is proved on the host from the samples, as any FAULT is
(`twice`), and the rest of its verdicts is cut down here to what the host knows: CONSISTENT becomes UNDECIDED,
with the margin that the device computed, and MISSING are windows without any sample, and of those that lack
some the ones of which the device says so: a lie there is no verdict.
"""

import numpy as np

from jaxbound.consistency.interface import Judged, WindowTest
from jaxbound.sets.floats.kinds import named
from jaxbound.sets.floats.probe import kind_of_device, searching_device, usable_devices
from jaxbound.sets.floats.status import Status

__all__ = ["NOT_REFUTED", "judging_device", "only_searched"]

NOT_REFUTED = "not refuted, by a device that was not examined"


def only_searched(test: WindowTest, judged: Judged, u: np.ndarray, y: np.ndarray, ends: np.ndarray) -> Judged:
    """Return the verdicts that are known on the host of those that a device searched.

    Args:
        test: the WindowTest. judged: its verdicts, each FAULT proved on the host. u (T, m), y (T, p): all
            samples. ends: (T,) bool, the samples at which windows end.
    """
    judged = test.unproved(judged)
    status, margin = judged.status.reshape(-1), judged.margin.reshape(-1)
    fault, said, lacking = status == Status.FAULT, status == Status.MISSING, ~ends
    if said[ends].any() or np.isnan(y.min(initial=0)):  # else each window has a sample
        absent = np.isnan(np.concatenate([y, u], 1))
        lacking |= said & _any_of(test.horizon, absent.any(1))
        lacking |= ~fault & ~_any_of(test.horizon, ~absent.all(1))
    np.putmask(status, ~fault, np.int8(Status.UNDECIDED))
    np.putmask(status, lacking, np.int8(Status.MISSING))
    np.putmask(margin, lacking, np.nan)
    if fault.any():  # a sign is known on the host, a size is not
        np.putmask(margin, fault & (margin >= 0), np.nan)
    return judged


def judging_device(remembers: bool = False) -> str:
    """Return the device that judges, in words that say whether it was examined; "" where it is a CPU.

    Args:
        remembers: whether an observer judges, which follows on the CPU beside a device that nobody examined.
    """
    if card := searching_device():
        if remembers:
            return f"the CPU, since what an observer carries has to be proved, and {card} was not examined"
        return f"{card}, {NOT_REFUTED}"
    names = []
    for device in usable_devices():
        kind = kind_of_device(device)
        if kind["platform"] == "cpu":
            continue
        names.append(named(kind))
    return ", ".join(sorted(set(names)))


def _any_of(horizon: int, samples: np.ndarray) -> np.ndarray:
    """Return (T,) bool: whether any of the samples of the window that ends at one is among these (T,)."""
    count = np.cumsum(samples)
    before = np.concatenate([np.zeros(horizon + 1, count.dtype), count])[: len(count)]
    return np.asarray(count > before)
