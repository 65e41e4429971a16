"""Verdicts of windows that a device searched which nobody has examined: it may lie, the host proves.

What such a device hands back are hints. Every FAULT is proved on the host from the samples, as any FAULT is
(`twice`), and the rest of its verdicts is cut down here to what the host knows: CONSISTENT becomes UNDECIDED,
with the margin that the device computed, and MISSING are the windows that the samples say are missing.
"""

import contextlib
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from jaxbound.consistency.interface import Judged, WindowTest
from jaxbound.sets.floats.kinds import kind_of_device, named
from jaxbound.sets.floats.probe import searching_device, usable_devices
from jaxbound.sets.floats.status import Status

NOT_REFUTED = "not refuted, by a device that was not examined"
PATTERNS = 256
"""Patterns of missing samples that the host looks at; windows with others are UNDECIDED."""
Look: TypeAlias = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Says in NumPy which windows, of samples (N, s + 1, m) and (N, s + 1, p), are MISSING."""


def only_searched(
    test: WindowTest, judged: Judged, u: np.ndarray, y: np.ndarray, ends: np.ndarray, missing: Look
) -> Judged:
    """Return the verdicts that are known on the host of those that a device searched.

    Args:
        test: the WindowTest. judged: its verdicts, each FAULT proved on the host. u (T, m), y (T, p): all
            samples. ends: (T,) bool, the samples at which windows end. missing: see `Look`.
    """
    judged = test.unproved(judged)
    status, margin = judged.status.reshape(-1), judged.margin.reshape(-1)
    fault = status == Status.FAULT
    lacking = ~ends
    unsure = ends & (status == Status.MISSING)
    if unsure.any():
        lacking |= _lacking(test, u, y, unsure, missing)
    if np.isnan(y.min(initial=0)):  # else each window has a sample
        lacking |= ends & ~fault & ~_any_sample(test.horizon, u, y)
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


def _lacking(
    test: WindowTest, u: np.ndarray, y: np.ndarray, doubtful: np.ndarray, missing: Look
) -> np.ndarray:
    """Return (T,) bool: which windows that a device calls MISSING lack the samples that a verdict needs.

    What is missing alone decides that: the host looks at one window a pattern, whose other samples are 0.
    """
    lacking = np.zeros(len(doubtful), bool)
    at = np.flatnonzero(doubtful)
    if not len(at):
        return lacking
    rows = at[:, None] + np.arange(-test.horizon, 1)
    absent = np.isnan(np.concatenate([y, u], 1))[rows]
    some = absent.any((1, 2))  # a whole window has its data
    patterns, which = np.unique(absent[some], axis=0, return_inverse=True)
    patterns = patterns[:PATTERNS]
    if not len(patterns):
        return lacking
    samples = np.where(patterns, np.nan, 0.0).astype(y.dtype)
    outputs = y.shape[1]
    # A primitive of a newer jax, which NumPy does not know, says nothing.
    with contextlib.suppress(NotImplementedError):
        silent = np.append(missing(samples[..., outputs:], samples[..., :outputs]), False)
        lacking[at[some]] = silent[np.minimum(which.ravel(), len(patterns))]
    return lacking


def _any_sample(horizon: int, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (T,) bool: whether the window that ends at a sample has any sample at all."""
    there = ~np.isnan(np.concatenate([y, u], 1)).all(1)
    count = np.cumsum(there)
    before = np.concatenate([np.zeros(horizon + 1, count.dtype), count])[: len(count)]
    return np.asarray(count > before)
