"""What `jaxbound detect --method validation` found: its verdict in a sentence, its columns in a file."""

from collections import Counter
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from jaxbound.diagnosis.alarms import Alarm, group_alarms
from jaxbound.estimation.validation import Validation
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.columns import to_arrow, words
from jaxbound.runs.summary import Evidence, evidence
from jaxbound.runs.verdictfiles import columns_of
from jaxbound.sets.floats.status import Status

__all__ = ["Validated"]


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

    relations = property(lambda self: self, doc="Where reports look for the model and the horizon.")
    status = property(lambda self: np.asarray(self.found.status), doc="(T,) int8.")
    margin = property(lambda self: np.full(len(self.y), np.nan), doc="(T,): validation measures none.")

    @property
    def counts(self) -> dict[str, int]:
        """{status name: number of windows}."""
        return {s.name: int(np.sum(self.status == s)) for s in Status}

    @property
    def blamed(self) -> dict[str, int]:
        """{output: number of its faulty samples}, those without any left out."""
        return {
            name: int(n)
            for name, n in zip(self.model.outputs, np.asarray(self.found.faulty).sum(0), strict=True)
            if n
        }

    @property
    def first_fault(self) -> int | None:
        """The first sample that is FAULT, None if there is none."""
        fault = self.status == Status.FAULT
        return int(np.argmax(fault)) if fault.any() else None

    def alarms(self, k: int = 1, n: int = 1) -> list[Alarm]:
        """Group FAULT windows. See `Result.alarms`."""
        return group_alarms(self, k, n, 0, 1, 0)

    def explain(self, at: int) -> NoReturn:
        """Refuse: there is no certificate of a verdict that rests on all samples before it."""
        raise NotImplementedError(
            "validation has no certificate of a single window: its verdict rests on all samples before it"
        )

    def stretches(self) -> list[tuple[int, int, int]]:
        """Return [(index of the output, first, last sample)] of the faulty stretches, in order of time."""
        faulty, out = np.asarray(self.found.faulty), []
        for i in range(faulty.shape[1]):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], faulty[:, i].astype(int), [0]])))
            out += [(i, int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
        return sorted(out, key=lambda s: s[1:])


@evidence.register(Validated)
def _(res, alarms):
    first = res.first_fault
    ended = dict(Counter(a.ended for a in alarms))
    about = dict(aside=res.aside, at=first, first=first, alarms=len(alarms), ended=ended, faulty=res.blamed)
    return Evidence(res.method, res.horizon, len(res.y), res.counts, **about)


@columns_of.register
def _(res: Validated):
    """Return status, and for each output whether it is faulty, its band and its corrected value; the states'
    bands.

    A bound that is not known, as in the first samples, is blank.
    """
    blank = lambda x: to_arrow(np.where(np.isfinite(x), x, np.nan))
    band = lambda name, x, i: {
        f"{name}.lo": blank(np.asarray(x.lo)[:, i]),
        f"{name}.hi": blank(np.asarray(x.hi)[:, i]),
    }
    columns = {"status": words([s.name for s in Status], res.status)}
    found = res.found
    for i, name in enumerate(res.model.outputs):
        lo, hi = (np.asarray(end)[:, i] for end in (found.corrected.lo, found.corrected.hi))
        known = np.isfinite(lo) & np.isfinite(hi)
        columns[f"faulty.{name}"] = to_arrow(np.asarray(found.faulty)[:, i])
        columns |= band(f"output.{name}", found.output, i)
        columns[f"corrected.{name}"] = blank(
            np.where(known, np.where(known, lo, 0) / 2 + np.where(known, hi, 0) / 2, np.nan)
        )
        columns |= band(f"corrected.{name}", found.corrected, i)
    for i, name in enumerate(res.model.states):
        columns |= band(f"state.{name}", found.state, i)
    return columns
