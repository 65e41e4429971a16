"""What `jaxbound detect --method validation` found: its verdict in a sentence, its columns in a file."""

from dataclasses import dataclass

import numpy as np

from jaxbound.diagnosis.alarms import group_alarms
from jaxbound.estimation.validation import Validation
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.columns import to_arrow, words, write_columns
from jaxbound.recordings.plaintext import percent
from jaxbound.sets.floats.status import Status

__all__ = ["Validated", "write_columns_of"]


@dataclass(frozen=True, eq=False)
class Validated:
    """A Validation of one recording with what a report needs beside it.

    Fields: model: LinearSystem. horizon: windows have horizon + 1 samples. y: (T, p) as recorded. found: Validation, NumPy inside.
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
    def counts(self):
        """{status name: number of windows}."""
        return {s.name: int(np.sum(self.status == s)) for s in Status}

    @property
    def windows(self):
        """How many windows there are: the warm-up is none, nor is what the model's `where` leaves out."""
        return len(self.y) - self.horizon - self.aside

    @property
    def tested(self):
        """The share of windows that have data."""
        return 1 - (self.counts["MISSING"] - self.horizon - self.aside) / self.windows if self.windows > 0 else 0.0

    @property
    def blamed(self):
        """{output: number of its faulty samples}, those without any left out."""
        return {name: int(n) for name, n in zip(self.model.outputs, np.asarray(self.found.faulty).sum(0), strict=True) if n}

    def alarms(self, k=1, n=1):
        """Group FAULT windows. See `Result.alarms`."""
        return group_alarms(self, k, n, 0, 1, 0)

    def explain(self, at):
        """Refuse: there is no certificate of a verdict that rests on all samples before it."""
        raise NotImplementedError("validation has no certificate of a single window: its verdict rests on all samples before it")

    def summary(self, alarms, label, min_coverage):
        """Return (verdict, sentence). See `report.summary`."""
        windows, faults, tested = self.windows, self.counts["FAULT"], self.tested
        if faults:
            whom = ", ".join(f"{name} in {count} sample{'s' * (count > 1)}" for name, count in self.blamed.items())
            whom = f"; faulty: {whom}" if whom else "; no single sensor explains it"
            grouped = f", in {len(alarms)} alarm{'s' * (len(alarms) != 1)}" if alarms else ", too scattered for an alarm"
            if faults > 1 and faults == round(tested * windows):
                return "fault", f"Every one of the {faults} windows with data is FAULT: the model or its bounds do not fit this recording."
            return "fault", (f"Fault proved: {faults} of {windows} windows ({percent(faults / windows)}) contradict the model and the "
                             f"samples accepted before{grouped}; the first is at {label(int(np.argmax(self.status == Status.FAULT)))}"
                             f"{whom}.")  # fmt: skip
        if tested < min_coverage:
            return "too little evidence", (f"Too little evidence: only {percent(tested)} of {windows} windows have data, at least "
                                           f"{percent(min_coverage)} are asked for.")  # fmt: skip
        return "no fault", f"No fault found: every sample of {round(tested * windows)} windows fits what the samples before it allow."

    def stretches(self):
        """Return [(index of the output, first, last sample)] of the faulty stretches, in order of time."""
        faulty, out = np.asarray(self.found.faulty), []
        for i in range(faulty.shape[1]):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], faulty[:, i].astype(int), [0]])))
            out += [(i, int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
        return sorted(out, key=lambda s: s[1:])


def write_columns_of(path, res, recording):
    """Write one row a sample: time, status, and for each output whether it is faulty, its band and its corrected value; the states' bands.

    A bound that is not known, as in the first samples, is blank.
    """
    blank = lambda x: to_arrow(np.where(np.isfinite(x), x, np.nan))
    band = lambda name, x, i: {f"{name}.lo": blank(np.asarray(x.lo)[:, i]), f"{name}.hi": blank(np.asarray(x.hi)[:, i])}
    columns = {
        "time": recording.column,
        "status": words([s.name for s in Status], res.status),
    }
    found = res.found
    for i, name in enumerate(res.model.outputs):
        lo, hi = (np.asarray(end)[:, i] for end in (found.corrected.lo, found.corrected.hi))
        known = np.isfinite(lo) & np.isfinite(hi)
        columns[f"faulty.{name}"] = to_arrow(np.asarray(found.faulty)[:, i])
        columns |= band(f"output.{name}", found.output, i)
        columns[f"corrected.{name}"] = blank(np.where(known, np.where(known, lo, 0) / 2 + np.where(known, hi, 0) / 2, np.nan))
        columns |= band(f"corrected.{name}", found.corrected, i)
    for i, name in enumerate(res.model.states):
        columns |= band(f"state.{name}", found.state, i)
    write_columns(path, columns)
