"""The rule by which FAULT windows become alarms: one value for recordings, Parquet, fleets and pipes."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from jaxbound.diagnosis.acknowledged import Acknowledged, Times
from jaxbound.models.statedalarms import PLAIN, stated_alarms
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.clockintervals import seconds_of
from jaxbound.recordings.signals import SignalModel
from jaxbound.text.names import listed
from jaxbound.text.objects import readable

LOWEST = {"k": 1, "n": 1, "hold": 0, "clear": 1}
Sizes: TypeAlias = "float | Mapping[str, float] | None"
"""One size for all outputs, or {output: size}, in their units; None: any."""


def _refuse_number(name: str, value: object, low: int) -> None:
    """Raise ValueError for a value that is no whole number of at least `low`."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < low:
        raise ValueError(f"{name} must be a whole number >= {low}, not {value!r}")


@readable
@dataclass(frozen=True)
class AlarmRule:
    """A rule by which FAULT windows become alarms. It never changes a verdict.

    Args:
        k, n: an alarm starts where k of the last n windows are FAULT. hold: it stays on for so many samples
            after that ceases. clear: it ends once so many samples in a row are quiet.
        merge: alarms of one suspect at most so far apart are one alarm: samples, or an interval of the clock
            like "10min".
        latch: an alarm stays on until an opposite jump of its suspect speaks for a repair, or until it is
            acknowledged, else to the end of the recording. Any FAULT windows may show the jump, whatever
            the rule asks of those that an alarm begins with: of two rules that differ in k, n, merge, least
            or latch, no sample is in alarm by the stricter one alone.
        least: FAULT windows that an error of one output below this size explains do not count: one number, or
            {output: size}, in units. It is proved of every window that counts, by the test itself under a
            noise bound of that output which is wider by the size.
        suspects: name the signals that alone could be wrong, the most plausible first; alarms of different
            suspects are different alarms. merge and latch do it too.
        acknowledged: times at which an operator acknowledged the alarms that had begun and were open: they
            end there. Dates in any usual format or as datetime, seconds where the recording counts these,
            numbers of samples where it has no times; or the path of a file with a time a line, which is read
            again as samples come (what follows a comma is the operator's own). FAULT behind it makes a new
            alarm, for which k of n are counted anew. Of a rule with latch.

    Suspects are worked out in exact rationals, at the first and the last of FAULT windows in a row, and at
    the worst. Of windows that do not tell them all alarms are of one component. Of a monitor suspects and
    sizes are those of the test that speaks: an observer names no suspect, which is one component more, and
    proves no size, so that with `least` its FAULT makes no alarm.

    Raises:
        ValueError: a number outside its range, an interval that is none.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[1.0]], None, [[1]], noise=0.1, outputs=["T1"])
        >>> res = jb.detect(jb.parity_relations(m), None, [[0.0], [0.0], [3.0], [3.0], [3.0]])
        >>> [(a.start, a.end, a.suspect, a.ended) for a in res.alarms(rule=jb.AlarmRule(latch=True))]
        [(2, 4, 'T1', 'open at the end: nothing speaks for a repair')]
        >>> [(a.end, a.ended) for a in res.alarms(rule=jb.AlarmRule(latch=True, acknowledged=[3]))]
        [(3, 'acknowledged')]
    """

    k: int = 1
    n: int = 1
    hold: int = 0
    clear: int = 1
    merge: int | str = 0
    latch: bool = False
    least: Sizes = None
    suspects: bool = False
    acknowledged: Times | Acknowledged = ()

    def __post_init__(self) -> None:
        """Refuse numbers and intervals that make no rule."""
        for name, low in LOWEST.items():
            _refuse_number(name, getattr(self, name), low)
        if self.k > self.n:
            raise ValueError(f"k of n needs k <= n: {self.k} of {self.n}")
        if isinstance(self.merge, str):
            try:
                seconds_of(self.merge)
            except ValueError as e:
                raise ValueError(f"merge: {str(e).removeprefix('every ')}") from None
        else:
            _refuse_number("merge", self.merge, 0)
        if self.acknowledgements.is_given and not self.latch:
            raise ValueError("acknowledged ends alarms that latch: give latch, too")
        for name, size in self._sizes().items():
            if isinstance(size, bool) or not isinstance(size, int | float | np.number) or not 0 < size:
                raise ValueError(f"a least size is a number > 0 in the unit of its output: {name} {size!r}")
            if size > sys.float_info.max:
                raise ValueError(f"a least size is finite: {name} {str(size)[:40]}")

    def _sizes(self) -> Mapping[str, object]:
        """Return the least sizes by name."""
        if isinstance(self.least, Mapping):
            return self.least
        if self.least is None:
            return {}
        return {"least": self.least}

    @property
    def names(self) -> bool:
        """Whether alarms name their suspects."""
        return bool(self.suspects or self.latch or self.merge)

    @cached_property
    def acknowledgements(self) -> Acknowledged:
        """The times of `acknowledged`, which are read once."""
        if isinstance(self.acknowledged, Acknowledged):
            return self.acknowledged
        return Acknowledged(self.acknowledged)

    def fitted(self, model: SignalModel) -> "AlarmRule":
        """Return the same rule with `merge` in samples and `least` as {output: size} of a model's signals.

        Raises:
            ValueError: an output that the model does not have; an interval of the clock for a model without a
                sampling period; a file of acknowledgements that is not there, or has a line without a time.
        """
        self.acknowledgements.check()
        merge, least = self.merge, self.least
        if isinstance(merge, str):
            if not model.dt:
                raise ValueError(
                    f"merge={merge!r} needs the sampling period, which this model does not state: give a "
                    f"number of samples"
                )
            merge = round(seconds_of(merge) / float(model.dt))
        if least is not None and not isinstance(least, Mapping):
            least = dict.fromkeys(model.outputs, float(least))
        for name in least or ():
            if name not in model.outputs:
                raise ValueError(
                    f"a least size is one of an output: {name!r} is none of {listed(model.outputs)}"
                )
        return replace(self, merge=merge, least=least, acknowledged=self.acknowledgements)

    def plain(self) -> dict[str, Any]:
        """Return the fields that differ from `EVERY_FAULT`, as JSON holds them; acknowledgements come later
        and are none of them.
        """
        found = {}
        for field in fields(self):
            name, value = field.name, getattr(self, field.name)
            if name != "acknowledged" and value != getattr(EVERY_FAULT, name):
                found[name] = value
        if isinstance(self.least, Mapping):
            found["least"] = dict(self.least)
        return found


EVERY_FAULT = AlarmRule()
"""Each stretch of FAULT windows is an alarm."""
Stated: TypeAlias = AlarmRule | Mapping[str, Any] | None
"""A rule, or fields of an `[alarms]` table, which win over those of the model."""


def stated_rule(said: Stated, model: LinearSystem, file: str | PathLike[str]) -> AlarmRule:
    """Return a rule as it is, or that of a model with other fields, if any are said.

    Args:
        said: see `Stated`; "plain" in place of k/n: nothing that the model states. file: of the model,
            beside which its file of acknowledgements is.

    Raises:
        ValueError: fields that make no rule.
    """
    if isinstance(said, AlarmRule):
        return said
    table = dict(model.alarms)
    if "acknowledged" in table:
        table["acknowledged"] = Path(file).parent / table["acknowledged"]
    told = stated_alarms(said, "--alarm")
    if told.get("rule") == PLAIN:
        table = {}
    table |= told
    rule = table.pop("rule", PLAIN).replace(PLAIN, "1/1")
    k, _, n = rule.partition("/")
    return AlarmRule(int(k), int(n), **table)


RuleLike: TypeAlias = AlarmRule | tuple[int, int]
"""A rule, or (k, n)."""


def rule_of(alarm: RuleLike) -> AlarmRule:
    """Return the rule that a user gives.

    Raises:
        ValueError: no rule.

    Example:
        >>> rule_of((3, 5)) == AlarmRule(3, 5)
        True
    """
    if isinstance(alarm, AlarmRule):
        return alarm
    k, n = alarm
    return AlarmRule(k, n)
