"""Alarms of a recording whose verdicts come in parts."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxbound.diagnosis.alarms import ENDINGS, Alarm, endings, follows, forgets_after, stretches
from jaxbound.recordings.columns import to_arrow, write_columns
from jaxbound.runs.verdictfiles import alarm_columns
from jaxbound.sets.floats.status import Status

__all__ = ["AlarmBook"]

DEEPEST = 200  # alarms kept in memory
FIELDS = (
    "first_sample",
    "last_sample",
    "windows",
    "depth",
    "worst_sample",
    "from",
    "to",
    "at",
    "ended",
)  # of an Alarm, and their seconds


class AlarmBook:
    """Alarms of a recording that comes in parts; one that reaches the end of its part is held until the next
    shows how it goes on.

    Args:
        rule: (k, n) of `Result.alarms`. relations: that were tested. path: where to write all of them, or
            None.
    """

    def __init__(self, rule: tuple[int, int], relations: Any, path: Path | None) -> None:
        self.rule, self.dt, self.horizon, self.path = rule, relations.model.dt, forgets_after(relations), path
        self.ended: dict[str, int] = {}
        self.before, self.count = np.zeros(0, bool), 0
        self.held: dict[str, Any] | None = None
        self.kept: list[tuple] = []
        self.first: list[tuple] = []

    def add(
        self, first: int, written: Any, time: np.ndarray, status: np.ndarray, margin: np.ndarray
    ) -> np.ndarray:
        """Take the next part, which begins at sample `first`; return the samples at which alarms that ended
        are deepest.
        """
        (k, n), fault, missing = self.rule, status == Status.FAULT, status == Status.MISSING
        start, end, windows, depth, worst, begun, last = stretches(fault, margin, k, n, 0, 1, self.before)
        self.before = np.concatenate([self.before, fault])[max(len(self.before) + len(fault) - n + 1, 0) :]
        take = lambda at: written.take(to_arrow(at))
        found = {
            "start": take(start),
            "end": take(end),
            "worst": take(worst),
            "from": time[start],
            "to": time[end],
            "at": time[worst],
            "first_sample": start + first,
            "last_sample": end + first,
            "worst_sample": worst + first,
            "windows": windows,
            "depth": depth,
            "begun": begun + first,
            "last": last + first,
            "after": follows(missing, end),
        }
        closed: list[dict] = []
        if self.held is not None:
            if len(start) and start[0] == 0:
                found = _joined(self.held, found)
            else:
                closed = [self.held | {"after": follows(missing[:1], [-1])}]
            self.held = None
        if len(end) and end[-1] == len(fault) - 1:
            found, self.held = (
                {name: x[part] for name, x in found.items()} for part in (slice(0, -1), slice(-1, None))
            )
        return np.concatenate([self._close(x) for x in (*closed, found)])

    def close(self) -> np.ndarray:
        """Close what is open; return the sample at which it is deepest, if any."""
        return self._close(self.held) if self.held is not None else np.zeros(0, int)

    def _close(self, alarms):
        alarms["ended"] = endings(alarms["begun"], alarms["last"], alarms["after"], self.horizon)
        for code, n in enumerate(np.bincount(alarms["ended"], minlength=len(ENDINGS)).tolist()):
            self.ended |= {ENDINGS[code]: self.ended.get(ENDINGS[code], 0) + n} if n else {}
        if self.path is not None:
            write_columns(self.path, alarm_columns(alarms, self.dt), append=self.count > 0)
        self.count += len(alarms["windows"])
        deepest = np.argsort(alarms["depth"])[:DEEPEST]
        picked = np.unique([*deepest, *range(min(1, len(alarms["windows"])))]).astype(int)
        rows = zip(*(alarms[f][picked].tolist() for f in FIELDS), strict=True)
        fresh = [
            (Alarm(start, end, n, depth, worst, ended=ENDINGS[why]), times)
            for start, end, n, depth, worst, *times, why in rows
        ]
        self.first = self.first or fresh[:1]
        self.kept = sorted([*self.kept, *fresh], key=lambda pair: pair[0].depth)[:DEEPEST]
        return alarms["worst_sample"]

    def alarms(self) -> tuple[list[Alarm], dict[int, float]]:
        """Return ([Alarm], {sample: seconds}) of the first and the deepest in order of time."""
        pairs = {alarm.start: (alarm, times) for alarm, times in (*self.first, *self.kept)}
        named: dict[int, float] = {}
        for a, times in pairs.values():
            named |= dict(zip((a.start, a.end, a.worst), times, strict=True))
        return [pairs[start][0] for start in sorted(pairs)], named


def _joined(held, found):
    """Return alarms, the first of them joined with the one that was held."""
    import pyarrow as pa

    deeper = not held["windows"][0] or (found["windows"][0] and found["depth"][0] < held["depth"][0])
    keep = (
        "start",
        "from",
        "first_sample",
        "begun",
        *(() if deeper else ("worst", "at", "worst_sample", "depth")),
    )
    out = {}
    for name, x in found.items():
        if name == "windows":
            out[name] = np.concatenate([held[name] + x[:1], x[1:]])
        elif name in keep:
            out[name] = (np.concatenate if isinstance(x, np.ndarray) else pa.concat_arrays)(
                [held[name], x[1:]]
            )
        else:
            out[name] = x
    return out
