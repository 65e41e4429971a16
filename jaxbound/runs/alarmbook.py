"""Alarms of a recording whose verdicts come in parts."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.alarmrule import RuleLike, rule_of
from jaxbound.diagnosis.alarms import ENDINGS, Alarm, endings, follows, forgets_after, stretches
from jaxbound.diagnosis.region import farthest_of
from jaxbound.models.region import Departure, Region
from jaxbound.recordings.columns import to_arrow, write_columns
from jaxbound.recordings.recording import Recording
from jaxbound.runs.loop import Quiet
from jaxbound.runs.sink import Verdicts
from jaxbound.runs.verdictfiles import alarm_columns
from jaxbound.sets.floats.status import Status

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["AlarmBook", "speakers"]

Column: TypeAlias = "np.ndarray | pa.Array"
Columns = dict[str, Any]
"""{name: array}, an entry an alarm; times as their owner wrote them are arrays of pyarrow."""
OLDER = frozenset({"start", "from", "first_sample", "begun"})
"""What an alarm over two parts has from the first of them."""
WORST = frozenset({"worst", "at", "worst_sample", "depth", "test"})
"""What it has from the deeper of them."""
FARTHEST = frozenset({"share", "by", "reading"})
"""What it has from the part of which a FAULT window lies farther outside the region of training."""
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
    "test",
)  # of an Alarm, and their seconds


class AlarmBook(Quiet):
    """Alarms of a recording that comes in parts, a sink.

    An alarm that reaches the end of its part is held until the next shows how it goes on.

    Args:
        rule: of `Result.alarms`, of which k and n are obeyed here. dt: sampling period in s. relations: that
            were tested. path: where to write all of them, or None. mark: called with the samples at which
            alarms that are over are deepest.

    Fields: ended: {ending of an Alarm: number of alarms}; count: of all of them; first: the first; kept: the
    deepest.
    """

    def __init__(
        self,
        rule: RuleLike,
        dt: float,
        relations: Relations,
        path: Path | None,
        mark: Callable[[np.ndarray], object],
    ) -> None:
        self.rule, self.dt, self.horizon, self.path = rule_of(rule), dt, forgets_after(relations), path
        self.mark = mark
        self.ended: dict[str, int] = {}
        self.samples = self.count = 0
        self.region, self.has_tests = Region.of(relations), bool(relations.parts)
        self.before = np.zeros(0, bool)
        self.open: Columns | None = None
        self.kept: list[tuple[Alarm, list[float]]] = []
        self.first: list[tuple[Alarm, list[float]]] = []

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        """Take the next part."""
        missing = verdicts.status == Status.MISSING
        alarms = self._alarms_in(piece, verdicts, missing)
        if self.open is not None:
            if len(alarms["start"]) and alarms["first_sample"][0] == self.samples:
                alarms = _joined_first(self.open, alarms)
            else:
                self._close(self.open | {"after": follows(missing[:1], [-1])})
            self.open = None
        self.samples += len(missing)
        if len(alarms["last_sample"]) and alarms["last_sample"][-1] == self.samples - 1:
            self.open = {name: x[-1:] for name, x in alarms.items()}
            alarms = {name: x[:-1] for name, x in alarms.items()}
        self._close(alarms)

    def close(self) -> None:
        """Close the alarm that is on."""
        if self.open is not None:
            self._close(self.open)

    def _alarms_in(self, piece: Recording, verdicts: Verdicts, missing: np.ndarray) -> Columns:
        """Return the alarms of a part by themselves."""
        k, n = self.rule.k, self.rule.n
        fault, time, first = verdicts.status == Status.FAULT, piece.time, self.samples
        written = piece.column
        start, end, windows, depth, worst, begun, last = stretches(
            fault, verdicts.margin, k, n, 0, 1, self.before
        )
        self.before = np.concatenate([self.before, fault])[max(len(self.before) + len(fault) - n + 1, 0) :]
        counts, farthest = np.zeros(len(start), np.int64), None
        if verdicts.departure is not None:
            counts, farthest = farthest_of(verdicts.departure, fault, start, end)
        return {
            "outside": counts,
            **_far(farthest, len(start)),
            "start": written.take(to_arrow(start)),
            "end": written.take(to_arrow(end)),
            "worst": written.take(to_arrow(worst)),
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
            "test": speakers(verdicts)[worst],
        }

    def _close(self, alarms: Columns) -> None:
        """Say why alarms are over, and write them."""
        codes = endings(alarms["begun"], alarms["last"], alarms["after"], self.horizon)
        alarms["ended"] = np.array(ENDINGS, object)[codes]
        self._write(alarms)

    def _write(self, alarms: Columns) -> None:
        """Count and write alarms that are over in words, and keep the deepest."""
        count = len(alarms["windows"])
        for why in alarms["ended"].tolist():
            self.ended[why] = self.ended.get(why, 0) + 1
        columns = self._in_words(alarms)
        if self.path is not None:
            write_columns(self.path, alarm_columns(columns, self.dt), append=self.count > 0)
        self.count += count
        # the first of all is kept too, however shallow: sentences name it
        picked = np.unique([*np.argsort(alarms["depth"])[:DEEPEST], *range(min(1, count))]).astype(int)
        fresh: list[tuple[Alarm, list[float]]] = []
        outside: list[tuple[int | None, str]] = [(None, "")] * len(picked)
        if self.region is not None:
            outside = [(int(columns["outside"][i]), columns["outside_by"][i]) for i in picked]
        rows = zip(*(alarms[name][picked].tolist() for name in FIELDS), outside, strict=True)
        for start, end, n, depth, worst, *times, why, test, (beyond, by) in rows:
            alarm = Alarm(start, end, n, depth, worst, ended=why, outside=beyond, outside_by=by, test=test)
            fresh.append((alarm, times))
        if "suspects" in alarms:
            named = zip(fresh, picked, strict=True)
            fresh = [(_named(alarm, alarms, i), times) for (alarm, times), i in named]
        self.first = self.first or fresh[:1]
        self.kept = sorted([*self.kept, *fresh], key=lambda pair: pair[0].depth)[:DEEPEST]
        self.mark(alarms["worst_sample"])

    def _in_words(self, alarms: Columns) -> Columns:
        """Return alarms with words on the farthest FAULT window of each; without a region nothing of it, of
        one test no name.
        """
        unsaid = set()
        if not self.has_tests:
            unsaid.add("test")
        if self.region is None:
            unsaid.add("outside")
        alarms = {name: x for name, x in alarms.items() if name not in unsaid}
        if self.region is None:
            return alarms
        farthest = Departure(alarms["share"], alarms["by"], alarms["reading"], self.region)
        return alarms | {"outside_by": farthest.words()}

    def alarms(self) -> tuple[list[Alarm], dict[int, float]]:
        """Return ([Alarm], {sample: seconds}) of the first and the deepest in order of time."""
        pairs = {alarm.start: (alarm, times) for alarm, times in (*self.first, *self.kept)}
        named: dict[int, float] = {}
        for a, times in pairs.values():
            named |= dict(zip((a.start, a.end, a.worst), times, strict=True))
        return [pairs[start][0] for start in sorted(pairs)], named


def speakers(verdicts: Verdicts) -> np.ndarray:
    """Return the name of the test that speaks at each sample, of a monitor; else ""."""
    by, names = getattr(verdicts, "by", None), getattr(verdicts, "names", ())
    if by is None:
        return np.full(len(verdicts.status), "", object)
    return np.asarray(np.array(["", *names], object)[by + 1])


def _named(alarm: Alarm, alarms: Columns, i: int) -> Alarm:
    """Return an alarm with its suspects, entry i of the columns."""
    size, cause = float(alarms["size"][i]), ""
    if "cause" in alarms:
        cause = alarms["cause"][i]
    return replace(alarm, suspects=alarms["suspects"][i], size=size, cause=cause)


def _far(farthest: Departure | None, count: int) -> Columns:
    """Return the columns of the FAULT windows that lie farthest outside, one an alarm."""
    if farthest is None:
        return {name: np.zeros(count) for name in FARTHEST}
    return {"share": farthest.share, "by": farthest.by, "reading": farthest.reading}


def _joined_first(open_alarm: Columns, alarms: Columns) -> Columns:
    """Return alarms, the first of them joined with the one that was open."""
    windows = alarms["windows"]
    deeper = not open_alarm["windows"][0]
    if windows[0] and alarms["depth"][0] < open_alarm["depth"][0]:
        deeper = True
    older = OLDER if deeper else OLDER | WORST
    if open_alarm["share"][0] >= alarms["share"][0]:
        older |= FARTHEST
    joined = dict(alarms)
    for name in older:
        joined[name] = _in_front(open_alarm[name], alarms[name][1:])
    for name in ("windows", "outside"):
        joined[name] = np.concatenate([open_alarm[name] + alarms[name][:1], alarms[name][1:]])
    return joined


def _in_front(one: Column, others: Column) -> Column:
    """Return two columns as one."""
    if isinstance(others, np.ndarray):
        return np.concatenate([one, others])
    import pyarrow as pa

    return pa.concat_arrays([one, others])
