"""A validated recording: its verdicts and faulty stretches, its counts, and the columns of its file."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn, cast

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.alarmrule import EVERY_FAULT, AlarmRule
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.watching import Watching
from jaxbound.estimation.validation import Validation
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.columns import Arrow, Words, to_arrow
from jaxbound.recordings.sample_axis import Place
from jaxbound.runs.summary import Evidence, evidence
from jaxbound.runs.verdictfiles import Columns, verdict_columns
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval


@dataclass(frozen=True, eq=False)
class Validated:
    """A Validation of one recording with what a report needs beside it.

    Fields: model: LinearSystem. horizon: windows have horizon + 1 samples. y: (T, p) as recorded. found:
    Validation, NumPy inside.
    aside: how many windows are MISSING because the model's `where` leaves out a sample of theirs.
    """

    model: LinearSystem
    horizon: int
    y: np.ndarray
    found: Validation
    aside: int = 0
    method = "validation"
    remembers = False  # a page says of it that it looks at windows

    @property
    def relations(self) -> Relations:
        """The value itself, in which reports look for the model and the horizon."""
        return cast(Relations, self)  # it has those two, and `remembers`: no more is asked of it there

    @property
    def status(self) -> np.ndarray:
        """(T,) int8."""
        return np.asarray(self.found.status)

    @property
    def margin(self) -> np.ndarray:
        """(T,): validation measures none."""
        return np.full(len(self.y), np.nan)

    @property
    def departure(self) -> None:
        """None: of a validation it is not said where its inputs lie."""

    @property
    def counts(self) -> dict[str, int]:
        """{status name: number of windows}."""
        return {s.name: int(np.sum(self.status == s)) for s in Status}

    @property
    def blamed(self) -> dict[str, int]:
        """{output: number of its faulty samples}, those without any left out."""
        counts = np.asarray(self.found.faulty).sum(0).tolist()
        return {name: n for name, n in zip(self.model.outputs, counts, strict=True) if n}

    @property
    def first_fault(self) -> int | None:
        """The first sample that is FAULT, None if there is none."""
        fault = self.status == Status.FAULT
        if not fault.any():
            return None
        return int(np.argmax(fault))

    def alarms(self, rule: AlarmRule = EVERY_FAULT, instants: np.ndarray | None = None) -> list[Alarm]:
        """Group FAULT windows. See `Result.alarms`; a validation says which sensors are faulty itself.
        instants: (T,) times by which alarms are acknowledged.
        """
        if rule.suspects or rule.least is not None:
            raise ValueError(
                "validation names the faulty sensors itself, and no sizes: leave out suspects and least"
            )
        return Watching(rule.fitted(self.model), None, self.method).whole(self, instants, self)

    def when(self, k: int) -> None:
        """Return None: a validation is given the samples alone."""

    def explain(self, at: Place) -> NoReturn:
        """Refuse: there is no certificate of a verdict that rests on all samples before it."""
        raise NotImplementedError(
            "validation has no certificate of a single window: its verdict rests on all samples before it"
        )

    def stretches(self) -> list[tuple[int, int, int]]:
        """Return [(index of the output, first, last sample)] of the faulty stretches, in order of time."""
        faulty, stretches = np.asarray(self.found.faulty), []
        for i in range(faulty.shape[1]):
            # A stretch begins where the flag rises and ends before it falls.
            edges = np.flatnonzero(np.diff(np.concatenate([[0], faulty[:, i].astype(int), [0]])))
            for begin, end in edges.reshape(-1, 2):
                stretches.append((i, int(begin), int(end) - 1))
        return sorted(stretches, key=lambda stretch: stretch[1:])


@evidence.register(Validated)
def _(res: Validated, alarms: Sequence[Alarm]) -> Evidence:
    first = res.first_fault
    return Evidence(
        res.method,
        res.horizon,
        len(res.y),
        res.counts,
        aside=res.aside,
        at=first,
        first=first,
        alarms=len(alarms),
        ended=dict(Counter(a.ended for a in alarms)),
        faulty=res.blamed,
    )


@verdict_columns.register(Validated)
def _(res: Validated) -> Columns:
    """Return the status, for each output its faults, its band and its corrected value, and bands of states.

    A bound that is not known, as in the first samples, is blank.
    """
    columns = {"status": to_arrow(Words([s.name for s in Status], res.status))}
    validation = res.found
    for i, name in enumerate(res.model.outputs):
        lo, hi = _ends(validation.corrected, i)
        is_known = np.isfinite(lo) & np.isfinite(hi)
        middle = np.where(is_known, lo, 0) / 2 + np.where(is_known, hi, 0) / 2
        columns[f"faulty.{name}"] = to_arrow(np.asarray(validation.faulty)[:, i])
        columns |= _band(f"output.{name}", validation.output, i)
        columns[f"corrected.{name}"] = _blank(np.where(is_known, middle, np.nan))
        columns |= _band(f"corrected.{name}", validation.corrected, i)
    for i, name in enumerate(res.model.states):
        columns |= _band(f"state.{name}", validation.state, i)
    return columns


def _band(name: str, bounds: Interval, i: int) -> Columns:
    """Return the two columns of the bounds of signal i."""
    lo, hi = _ends(bounds, i)
    return {f"{name}.lo": _blank(lo), f"{name}.hi": _blank(hi)}


def _ends(bounds: Interval, i: int) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(bounds.lo)[:, i], np.asarray(bounds.hi)[:, i]


def _blank(x: np.ndarray) -> Arrow:
    """Return numbers as a column, nothing where they are not finite."""
    return to_arrow(np.where(np.isfinite(x), x, np.nan))
