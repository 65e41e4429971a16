"""The result of a detection: verdicts of all windows, and what they are of."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial, singledispatch
from typing import TYPE_CHECKING, Any, cast

import jax
import numpy as np

from jaxbound.certificates.diagnosis import Diagnosis
from jaxbound.certificates.interface import WindowCertificate, explain
from jaxbound.consistency.claims import CLAIMED, UNCLAIMED, unclaimed
from jaxbound.consistency.interface import EXACT, Columns, Judged, Observer, WindowTest
from jaxbound.consistency.searched import judging_device
from jaxbound.diagnosis.alarmrule import EVERY_FAULT, AlarmRule
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.causes import diagnose
from jaxbound.diagnosis.hints import bound_hints, device_hints, fit_hints
from jaxbound.diagnosis.measuring import exact_margins, tightest
from jaxbound.diagnosis.region import Excursions, Outside
from jaxbound.diagnosis.severity import fitted
from jaxbound.diagnosis.units import unit_hints
from jaxbound.diagnosis.watching import Watching
from jaxbound.models.named_faults import NamedFault
from jaxbound.models.region import Departure, Region
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.hints import missing_hints, rounding_hints
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.sample_axis import Labels, Place, place_of
from jaxbound.recordings.stillness import still_hints
from jaxbound.recordings.tabletime import instants_of
from jaxbound.recordings.timestamps import row_label
from jaxbound.relations.sentence import looked_at
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable

if TYPE_CHECKING:
    import pandas as pd


def suspected(status: np.ndarray, margin: np.ndarray) -> np.ndarray:
    """Return bool: outside the set as computed, proved or not; False where MISSING."""
    with np.errstate(invalid="ignore"):
        return np.asarray((status == Status.FAULT) | (margin < 0))


@readable
@dataclass(frozen=True, eq=False)
class Result:
    """Verdicts of all windows; entry k belongs to the window that ends at sample k.

    Fields:
        status: (..., T) int8, see `Status`. FAULT is a proof; so is CONSISTENT for method "joint" (or a
            single relation).
        margin: (..., T), 1 - t with t the common factor on all half-widths at which the window just becomes
            consistent; t = 3: the bounds would have to be three times as wide. For method "box" of the worst
            residual alone. Of a window outside of training of the bounds there. NaN where MISSING.
        method, relations: as given to `detect`.
        u, y: the recording as it was tested.
        index: the index of the DataFrame that y came from, or None.
        starts: numbers of the samples that do not follow the one before: windows across are MISSING.
        aside: how many windows are MISSING because the model's `where` leaves out a sample of theirs.
        recorded: what was to be said of a recording that came from a file, its .hints; None: it came as
            arrays.
        margins: "exact", or "bounds": of a CONSISTENT window .margin is then at most the exact one, of FAULT
            at least; `exact`, `reported`, `measured` and `worst` have exact ones. With constant tolerances
            these are of gains that were tried: bounds too.
        device: the device that judged, in words that say whether it was examined; "": a CPU.
        evaluated: who judged, "NumPy", "XLA" or both, see `jaxbound.compile`; "": it was not asked.
        outside_is: "fault", or "undecided": the word for FAULT outside the region of training, as given to
            `detect`.
        known: how many of the first samples were judged in a recording before, and are MISSING here.
        columns: {name: (..., T) numbers} that the test hands over beside, see `WindowTest.columns`.
        apart: of a batch whose recordings have seams of their own, as tests of a monitor see them, those of
            each in turn, and `starts` those of all; else empty.
    """

    status: np.ndarray
    margin: np.ndarray
    method: str
    relations: Any  # Relations; None: residuals from elsewhere. Of a kind that each subclass knows
    u: np.ndarray
    y: np.ndarray
    index: object = None
    starts: tuple[int, ...] = ()
    aside: int = field(default=0, kw_only=True)
    recorded: tuple[str, ...] | None = field(default=None, kw_only=True, repr=False)
    device: str = field(default="", kw_only=True, repr=False)
    evaluated: str = field(default="", kw_only=True, repr=False)
    margins: str = field(default=EXACT, kw_only=True, repr=False)
    outside_is: str = field(default=CLAIMED, kw_only=True, repr=False)
    known: int = field(default=0, kw_only=True, repr=False)
    columns: Columns = field(default_factory=dict, kw_only=True)
    apart: tuple[tuple[int, ...], ...] = field(default=(), kw_only=True, repr=False)

    def _head(self) -> str:
        counts = [f"{n} {name}" for name, n in self.counts.items() if n]
        return f"{type(self).__name__} {self.status.shape}: {', '.join(counts)}"

    def _rows(self) -> dict[str, str]:
        rows = {"method": self.method}
        if self.relations is not None:
            rows["method"] += f", {looked_at(self.relations)}"
        if self.relations is not None and hasattr(self.relations, "model"):
            rows["model"] = repr(self.relations.model)
        if not np.isnan(self.margin).all():
            rows["smallest margin"] = self._smallest()
        if self.beyond is not None:
            tested = int(np.count_nonzero(self.status != Status.MISSING))
            rows["training"] = self.beyond.shown(tested, self.relations.remembers)
        rows["samples"] = f"u {np.shape(self.u)}, y {np.shape(self.y)} {np.asarray(self.y).dtype}"
        if len(self.starts):
            rows["gaps"] = f"{len(self.starts)}, the first at {int(self.starts[0])}"
        return rows

    def _smallest(self) -> str:
        """Return the smallest margin as text; of bounds what they say of it, without a search."""
        number = int(np.nanargmin(self.margin))
        smallest = f"{self.margin.flat[number]:.4g}"
        if self.margins != EXACT:
            side = "at least"
            if self.margin.flat[number] < 0:
                side = "at most"
            return f"{side} {smallest}, see .worst"
        at: object = number
        if self.margin.ndim > 1:
            at = tuple(map(int, np.unravel_index(number, self.margin.shape)))
        return f"{smallest} at {at}"

    @cached_property
    def reported(self) -> np.ndarray:
        """(..., T): the margins as alarms and files report them, with exact ones at FAULT windows."""
        return self.measured(self.status == Status.FAULT)

    @cached_property
    def exact(self) -> np.ndarray:
        """(..., T): exact margins of all windows, searched where .margin has bounds."""
        fault = self.status == Status.FAULT
        return np.where(fault, self.reported, self.measured(~fault))

    def measured(self, where: np.ndarray) -> np.ndarray:
        """Return the margins (..., T) with exact ones where (..., T) bool says."""
        at = np.flatnonzero(where & ~np.isnan(self.margin))
        if self.margins == EXACT or not len(at):
            return self.margin
        margin = self.margin.copy()
        margin.flat[at] = exact_margins(self.relations, self.method, self.u, self.y, margin, at)
        return margin

    @cached_property
    def worst(self) -> tuple[int, float] | None:
        """The FAULT window of the smallest margin, else the window of the smallest: (its index in the flat
        .margin, this margin, exact); None where no margin is known.
        """
        fault = self.status == Status.FAULT
        margin = self.margin
        if fault.any():
            margin = np.where(fault, self.reported, np.nan)
        if np.isnan(margin).all():
            return None
        if self.margins == EXACT or fault.any():
            at = int(np.nanargmin(margin))
            return at, float(margin.flat[at])
        return tightest(self.relations, self.method, self.u, self.y, margin)

    @cached_property
    def departure(self) -> Departure | None:
        """How far each window lies outside the region of training, by which input, and this input's sample;
        None: the model states no ranges of its inputs.
        """
        if self.relations is None:
            return None
        region = Region.of(self.relations)
        if region is None:
            return None
        return region.departure(self.u, self.status == Status.MISSING)

    @property
    def outside(self) -> np.ndarray:
        """(..., T): how far a window lies outside the region of training, the largest excess of an input over
        the samples that the window reads, in widths of the range between which it moved in training.

        0 inside; inf of an input that never moved there; NaN where the window is MISSING, or the model states
        no ranges (`fit` writes them). Of an observer, which rests on all samples before, it is said of the
        step that led to the sample. A FAULT outside is a proof too, of a model that is extrapolated.
        """
        if self.departure is None:
            return np.full(self.status.shape, np.nan)
        return self.departure.share

    @property
    def outside_by(self) -> np.ndarray:
        """(..., T): the number of the input that lies farthest outside; -1 where none does."""
        if self.departure is None:
            return np.full(self.status.shape, -1, np.int16)
        return self.departure.by

    @cached_property
    def beyond(self) -> Outside | None:
        """The windows outside the region of training, counted; None: there is no region."""
        return self.beyond_of(())

    def beyond_of(self, at: tuple[int, ...]) -> Outside | None:
        """Return the same of one recording of a batch."""
        if self.departure is None:
            return None
        counts = Excursions(self.departure.region)
        counts.add(self.status[at], self.margin[at], self.departure.cut(at))
        return counts.total(self.outside_is)

    @property
    def suspect(self) -> np.ndarray:
        """(..., T) bool: outside the set as computed, proved or not. Every FAULT is suspect."""
        return suspected(self.status, self.margin)

    @property
    def counts(self) -> dict[str, int]:
        """{status name: number of windows}."""
        counts = np.bincount(self.status.ravel(), minlength=len(Status))
        return {s.name: int(counts[s]) for s in Status}

    @property
    def hints(self) -> tuple[str, ...]:
        """Sentences for whoever acts on the verdicts: where the recording was split, which signal stands
        still, when and how long; bounds that are not stated, or were found for shorter windows; whether model
        and bounds fit at all; which signal seems to be in another unit than the model's. A report shows the
        same.

        A frozen or saturated sensor can look consistent. No verdict uses these. A batch has a sentence for
        each of its recordings.
        """
        sentences: Iterable[str] = self._of_the_recording()
        if self.recorded is not None:
            sentences = self.recorded
        model = self.relations.model
        sentences = (*sentences, *device_hints(self.device))
        return (*sentences, *bound_hints(model, self.relations), *fit_hints(self), *unit_hints(self))

    def _of_the_recording(self) -> Iterator[str]:
        """Yield sentences on the samples themselves."""
        label, model = partial(row_label, self.index), self.relations.model
        if len(self.starts):
            yield (
                f"the recording is split in {len(self.starts) + 1}, first at {label(int(self.starts[0]))}: "
                f"windows across are MISSING"
            )
        for at in np.ndindex(self.status.shape[:-1]):
            which = ""
            if at:
                which = f"recording {', '.join(map(str, at))}: "
            u, y = self.u[at], self.y[at]
            hints = [*missing_hints(model, u, y), *still_hints(model, u, y, label)]
            if isinstance(model, LinearSystem):
                hints += rounding_hints(model, y)
            for hint in hints:
                yield which + hint

    def alarms(
        self, k: int = 1, n: int = 1, hold: int = 0, clear: int = 1, rule: AlarmRule | None = None
    ) -> list[Alarm]:
        """Group FAULT windows into alarms; the verdicts themselves stay as they are.

        An alarm starts where k of the last n windows are FAULT, stays on for `hold` samples after that
        ceases, and ends once `clear` samples in a row are quiet. An AlarmRule says more: alarms that latch,
        that are merged, that begin from a size on, that name their suspect.

        Args:
            k, n: 1 <= k <= n. hold: >= 0. clear: >= 1. All in samples.
            rule: in their place.

        Returns:
            A list of Alarm in order of time (of recording and time for a batch).

        Raises:
            ValueError: numbers outside these ranges; a rule that names an output which is none, or asks of
                windows for errors of single sensors that they do not tell.
        """
        if isinstance(k, AlarmRule):
            raise ValueError("an alarm rule is given by its name: alarms(rule=..)")
        given = AlarmRule(k, n, hold, clear)
        if rule is None:
            rule = given
        elif given != EVERY_FAULT:
            raise ValueError("an alarm rule says k, n, hold and clear itself: give the rule alone")
        dt = None
        if self.relations is not None:
            rule, dt = fitted(rule, self.relations), self.relations.model.dt
        elif rule.suspects or rule.least is not None:
            raise ValueError(
                "residuals that were computed elsewhere tell no errors of sensors: leave out suspects and "
                "least"
            )
        instants = None
        if rule.acknowledgements.is_given:
            instants = instants_of(self.index, self.status.shape[-1], dt)
        alarms: list[Alarm] = []
        for at in np.ndindex(self.status.shape[:-1]):
            if (self.status[at] == Status.FAULT).any():
                watching = Watching(rule, self.relations, self.method, self.u[at], self.y[at])
                alarms += watching.whole(self.judged(at), instants, self, at)
        return alarms

    def judged(self, at: tuple[int, ...] | slice = ()) -> Judged:
        """Return the verdicts of one recording, or of some samples, as alarms and files report them: margins
        of FAULT windows are exact.
        """
        whole = Judged(self.status, self.reported, departure=self.departure, columns=self.columns)
        cut: Judged = jax.tree.map(lambda x: x[at], whole)
        return cut

    def when(self, k: int) -> object:
        """Return the time of sample k as the index has it: a Timestamp, a datetime64, seconds; None: there is
        no index.
        """
        if self.index is None:
            return None
        return cast(Sequence[object], self.index)[k]

    def _place(self, at: Place) -> tuple[int, ...]:
        """Return the index of the window that ends at a sample, which its number or its time names.

        Raises:
            ValueError: as `explain`.
        """
        dt = None
        if self.relations is not None:
            dt = self.relations.model.dt
        return place_of(at, self.status.shape, cast(Labels, self.index), dt)

    def explain(self, at: Place) -> WindowCertificate:
        """Return the Certificate of the window that ends at sample `at`, in exact rationals.

        Args:
            at: the number of the sample, or its time, as text like "2026-03-01 12:00:07" or a datetime, where
                the index tells it; of a batch a tuple, (recording, sample).

        For FAULT the violated relation with its coefficients, bounds and excess, and .errors, the smallest
        error of each sensor alone that would explain the window; for CONSISTENT a behaviour that explains it.
        .to_json() is complete in itself. With uncertain parameters an UncertainCertificate: ranges of
        polynomials, or parameters that explain the window. Of a residual a ResidualCertificate, with an
        Interval of unknowns that explains a CONSISTENT window.

        Raises:
            ValueError: no such sample; the window is MISSING. NotImplementedError: with uncertain parameters
                a window for which neither proof is found.

        Example:
            >>> import jaxbound as jb
            >>> m = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)
            >>> print(jb.detect(jb.parity_relations(m), None, [[1.0], [0.8]]).explain(1))
            y1[k-1] - 2 y1[k] = 0 cannot hold: it would need bounds 2 times as wide
        """
        return explain(self, self._place(at))

    def diagnose(
        self,
        start: Place,
        end: Place | None = None,
        faults: Sequence[NamedFault] | None = None,
        recording: tuple[int, ...] = (),
    ) -> Diagnosis:
        """Return the Diagnosis of an alarm: which named faults alone explain its windows, and of which it is
        proved that they do not.

        Looked at are the window of the smallest margin and four more that are spread over the alarm; a fault
        has to explain each of them, beginning at any sample of it; its sizes are those that explain each,
        from the smallest to the largest. One that does not is excluded by proof; that one explains the
        windows in between as well is not looked at.

        Args:
            start, end: the samples at which the first and the last window end, as of an Alarm, by number or
                time; end None: one window. faults: a list of NamedFault; None: those of the model, or a bias
                of every sensor and an offset of every actuator. recording: of a batch, its index.

        Raises:
            ValueError: no FAULT among them. NotImplementedError: as `WindowCertificate.diagnose`.

        Example:
            >>> import jaxbound as jb
            >>> m = jb.LinearSystem([[0.5]], [[1]], [[1], [1]], noise=0.1, outputs=["T1", "T2"])
            >>> y = [[1.0, 1.0], [0.5, 1.0], [0.25, 0.75]]
            >>> print(jb.detect(jb.parity_relations(m, 1), [[0.0]] * 3, y).diagnose(1, 2))
            bias of T2: +0.35 to +0.65 of T2 explains it; excluded: bias of T1, offset of u1
        """
        *_, first = self._place((*recording, start))
        last = first
        if end is not None:
            *_, last = self._place((*recording, end))
        return diagnose(self, first, last, faults, recording)

    def to_pandas(self) -> "pd.DataFrame":
        """Return a DataFrame with the columns status (names), margin, suspect and .columns, one row a sample;
        and outside, where there is a region of training.

        Its attrs["margins"] says whether margins are exact or bounds.

        Raises:
            ValueError: a batch of recordings; index the result's arrays instead.
        """
        import pandas as pd

        if self.status.ndim != 1:
            raise ValueError(
                f"to_pandas is for one recording, this result has the shape {self.status.shape}: build a "
                f"frame for each"
            )
        names = pd.Categorical.from_codes(self.status, [s.name for s in Status])
        frame = pd.DataFrame(
            {"status": names, "margin": self.margin, "suspect": self.suspect, **self.columns},
            index=self.index,
        )
        if self.departure is not None:
            frame["outside"] = self.outside
        frame.attrs["margins"] = self.margins
        return frame


@singledispatch
def result_of(family: object, judged: Judged, result: Result) -> Result:
    """Return a Result as the kind that the relations which a user gave have of their own.

    Args:
        family: as given to `detect`. judged: the verdicts. result: of them.
    """
    return result


def found_by(
    test: WindowTest | Observer[Any], recording: Recording, judged: Any, outside: str, given: object
) -> Result:
    """Return the Result of verdicts, of the kind that the relations have which a user gave.

    Args:
        test: that judged. judged: its verdicts of a recording. outside: see `detect`.
    """
    region = Region.of(test.relations)
    if region is not None and outside == UNCLAIMED:
        missing = judged.status == Status.MISSING
        judged = unclaimed(judged, region.departure(recording.u, missing))
    recorded = None
    if recording.source:
        recorded = recording.hints
    result = Result(
        judged.status,
        judged.margin,
        test.method,
        test.relations,
        recording.u,
        recording.y,
        recording.index,
        tuple(recording.starts.tolist()),
        aside=recording.aside(test.horizon),
        recorded=recorded,
        device=judging_device(test.remembers),
        margins=test.margins_are,
        outside_is=outside,
        columns=getattr(judged, "columns", {}),
    )
    return result_of(given, judged, result)
