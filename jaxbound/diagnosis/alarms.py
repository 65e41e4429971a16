"""Alarms: FAULT windows grouped for people. Separate from the proof, which they never change."""

import math
from dataclasses import dataclass

import numpy as np

from jaxbound.sets.status import Status

__all__ = ["Alarm", "group_alarms"]


@dataclass(frozen=True)
class Alarm:
    """A stretch of FAULT windows.

    Fields: start, end: first and last sample (inclusive); windows: how many are FAULT; depth: the worst margin (< 0), reached
    at sample `worst`; recording: index of the recording in a batch, () for a single one.
    """

    start: int
    end: int
    windows: int
    depth: float
    worst: int
    recording: tuple = ()


def group_alarms(result, k, n, hold, clear):
    """See `Result.alarms`. Array operations over time; the loop is over alarms."""
    for name, value, low in (("k", k, 1), ("n", n, 1), ("hold", hold, 0), ("clear", clear, 1)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < low:
            raise ValueError(f"{name} must be a whole number >= {low}, not {value!r}")
    if k > n:
        raise ValueError(f"k of n needs k <= n: {k} of {n}")
    shape = result.status.shape
    recordings = math.prod(shape[:-1])
    fault = (result.status == Status.FAULT).reshape(recordings, shape[-1])
    margin = result.margin.reshape(recordings, shape[-1])
    alarms = []
    for row in np.flatnonzero(fault.any(1)):
        recording = tuple(int(i) for i in np.unravel_index(row, shape[:-1])) if len(shape) > 1 else ()
        alarms += [Alarm(*a, recording) for a in _stretches(fault[row], margin[row], k, n, hold, clear)]
    return alarms


def _stretches(fault, margin, k, n, hold, clear):
    count = np.cumsum(np.concatenate([np.zeros(n, int), fault]))
    on = np.flatnonzero(count[n:] - count[:-n] >= k)
    if not len(on):
        return []
    breaks = np.flatnonzero(np.diff(on) > hold + clear)  # the quiet samples between two on-samples: their distance - 1
    starts = on[np.concatenate([[0], breaks + 1])]
    ends = np.minimum(on[np.concatenate([breaks, [len(on) - 1]])] + hold, len(fault) - 1)
    depth = np.where(fault, margin, np.inf)
    edges = np.column_stack([starts, ends + 1]).ravel()
    edges = edges[:-1] if edges[-1] == len(fault) else edges
    windows = np.add.reduceat(fault.astype(int), edges)[::2]
    worst = [int(a + np.argmin(depth[a : b + 1])) for a, b in zip(starts, ends, strict=True)]
    return [(int(a), int(b), int(w), float(margin[i]), i) for a, b, w, i in zip(starts, ends, windows, worst, strict=True)]
