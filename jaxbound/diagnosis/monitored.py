"""The result of a detection by a monitor: one verdict a sample, and the Result of each test behind it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from jaxbound.certificates.interface import WindowCertificate, nothing_to_explain
from jaxbound.consistency.interface import EXACT, Judged
from jaxbound.consistency.monitorbank import MonitorBank, combined
from jaxbound.diagnosis.result import Result, found_by, result_of
from jaxbound.diagnosis.units import unit_hints
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.sample_axis import Place
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable

if TYPE_CHECKING:
    import pandas as pd


@readable
@dataclass(frozen=True, eq=False)
class MonitorResult(Result):
    """A Result of a monitor, `jb.monitor`: the verdict of all its tests together, and of each.

    Fields beside those of Result: by: (..., T) int16, the number of the test that speaks, the name of which
    is .names[by]: where a FAULT is proved, of the tests that prove it the one with the least margin, else of
    all tests; -1 where none has a verdict. statuses (..., T, tests) int8, test_margins (..., T, tests): of
    each test. Where the mode is not known a FAULT stands at a test only if every mode is refuted.
    """

    by: np.ndarray = field(kw_only=True)
    statuses: np.ndarray = field(kw_only=True)
    test_margins: np.ndarray = field(kw_only=True)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the tests, in the order of `by`."""
        names: tuple[str, ...] = self.relations.names
        return names

    def _rows(self) -> dict[str, str]:
        rows = super()._rows()
        for i, name in enumerate(self.names):
            counts = np.bincount(self.statuses[..., i].ravel(), minlength=len(Status))
            rows[name] = ", ".join(f"{counts[s]} {s.name}" for s in Status if counts[s])
        return rows

    @cached_property
    def tests(self) -> Mapping[str, Result]:
        """The Result of each test by its name, with the samples as the test saw them: those at which its
        condition fails are left out.
        """
        results = {name: self._result_of(i) for i, name in enumerate(self.names)}
        return MappingProxyType(results)

    def _result_of(self, number: int) -> Result:
        """Return the Result of one test."""
        bank: MonitorBank = self.relations
        relations, before = bank.watches[number].relations, None
        if bank.begun is not None:  # of one recording: it goes on behind another
            before = bank.begun.modes
            if relations.observer is not None:
                relations = relations.observer.continued(bank.begun.tests[number])
        lead = self.status.shape[:-1]
        us, ys, seams = [], [], []
        for at in np.ndindex(*lead):
            u = np.asarray(self.u)[at]
            piece = Recording(u, np.asarray(self.y)[at], np.asarray(self.starts, np.int64))
            seen = bank.seen_by(number, piece, bank.modes_of(u), before)
            us.append(seen.u)
            ys.append(seen.y)
            seams.append(tuple(np.asarray(seen.starts).tolist()))
        u, y = (np.stack(x).reshape(*lead, *x[0].shape) for x in (us, ys))
        starts = tuple(sorted(set().union(*seams)))
        apart: tuple[tuple[int, ...], ...] = ()
        if len(set(seams)) > 1:  # a mode of each recording changes when it does
            apart = tuple(seams)
        test = relations.test("joint", y.dtype)
        kind = EXACT
        if self.margins != EXACT:
            kind = test.margins_are
        judged = Judged(self.statuses[..., number], self.test_margins[..., number])
        recording = Recording(u, y, np.array(starts, np.int64), index=self.index)
        result = found_by(test, recording, judged, self.outside_is, relations)
        return replace(result, recorded=self.recorded, device=self.device, margins=kind, apart=apart)

    def test_at(self, at: Place) -> str:
        """Return the name of the test that speaks at a sample, see `explain`; "" where none does."""
        return ("", *self.names)[int(self.by[self._place(at)]) + 1]

    def judged(self, at: tuple[int, ...] | slice = ()) -> Judged:
        """Return the verdicts of one recording, or of some samples, with those of each test."""
        judged = super().judged(at)
        by, statuses, margins = self.by[at], self.statuses[at], self.test_margins[at]
        return judged._replace(by=by, names=self.names, statuses=statuses, test_margins=margins)

    def measured(self, where: np.ndarray) -> np.ndarray:
        """Return the margins (..., T) with exact ones where (..., T) bool says."""
        if self.margins == EXACT or not where.any():
            return self.margin
        margins = self.test_margins.copy()
        for i, test in enumerate(self.tests.values()):
            margins[..., i] = test.measured(where)
        exact = np.empty_like(self.margin)
        bank: MonitorBank = self.relations
        for at in np.ndindex(*self.status.shape[:-1]):
            modes = bank.modes_of(np.asarray(self.u)[at])
            together = combined(self.statuses[at], margins[at], bank.conditions_of, modes, bank.complete)
            exact[at] = together.margin
        return np.where(where, exact, self.margin)

    @cached_property
    def worst(self) -> tuple[int, float] | None:
        """The FAULT sample of the smallest margin, else the sample of the smallest: (its index in the flat
        .margin, this margin, exact); None where no margin is known.
        """
        if self.margins == EXACT or (self.status == Status.FAULT).any():
            return super().worst
        found = [test.worst for test in self.tests.values() if test.worst is not None]
        return min(found, key=lambda one: one[1], default=None)

    def explain(self, at: Place) -> WindowCertificate:
        """Return the Certificate of the test that speaks at a sample, `test_at`, as the Result of this test
        gives it. Where the mode is not known it speaks of the mode of this test.

        Args:
            at: as `Result.explain` takes it.

        Raises:
            ValueError: no such sample; it is MISSING. NotImplementedError: as of the Result of this test.
        """
        place = self._place(at)
        if self.status[place] == Status.MISSING:
            raise nothing_to_explain(place)
        test = self.test_at(place)
        return self.tests[test].explain(place).of_test(test)

    def to_pandas(self) -> "pd.DataFrame":
        """Return the DataFrame of a Result with the columns test, the name of the test that speaks (None
        where none does), and "margin of NAME" of each test.

        Raises:
            ValueError: a batch of recordings.
        """
        import pandas as pd

        frame = super().to_pandas()
        frame["test"] = pd.Categorical.from_codes(self.by, list(self.names))
        for i, name in enumerate(self.names):
            frame[f"margin of {name}"] = self.test_margins[:, i]
        return frame


@unit_hints.register
def _(result: MonitorResult) -> list[str]:
    """Return the sentence of the first test by windows that has one."""
    for test in result.tests.values():
        if sentences := unit_hints(test):
            return sentences
    return []


@result_of.register
def _(family: MonitorBank, judged: Judged, result: Result) -> MonitorResult:
    statuses, margins, by = judged.statuses, judged.test_margins, judged.by
    assert statuses is not None and margins is not None and by is not None, "a monitor has tests"
    return MonitorResult(**vars(result), by=by, statuses=statuses, test_margins=margins)
