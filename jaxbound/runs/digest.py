"""Detection in recordings larger than memory: counts, worst window, alarms, timeline, from one pass over
verdicts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, cast

import numpy as np

from jaxbound.consistency.claims import CLAIMED, refuse_outside
from jaxbound.consistency.interface import AUTO, BOUNDS, EXACT, Relations
from jaxbound.diagnosis.alarmrule import RuleLike, rule_of
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.hints import bound_hints, device_hints, unfit_by
from jaxbound.diagnosis.region import Outside
from jaxbound.diagnosis.result import Result
from jaxbound.diagnosis.severity import fitted
from jaxbound.diagnosis.units import unit_hints
from jaxbound.models.region import Region
from jaxbound.plots.plot import plot
from jaxbound.plots.timeline import Timeline, plot_timeline
from jaxbound.recordings.factors import known
from jaxbound.recordings.hints import missing_sentences, rounding_hints
from jaxbound.recordings.parquet import PARTIAL, VERDICTS, ParquetSource
from jaxbound.recordings.read import open_source
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.sample_axis import Place, SampleAxis
from jaxbound.recordings.seams import Clock, irregular, seam_hints, tick
from jaxbound.recordings.selection import where_hints
from jaxbound.recordings.signals import Named
from jaxbound.recordings.stillness import Runs, signal_hints, windows_inside
from jaxbound.recordings.timestamps import time_label
from jaxbound.relations.sentence import looked_at
from jaxbound.runs.alarmbook import AlarmBook
from jaxbound.runs.ask import Ask
from jaxbound.runs.contradiction import REACHES, refuted_again
from jaxbound.runs.counts import CountsByTest, Tally, Unwatched
from jaxbound.runs.judges import as_judged
from jaxbound.runs.loop import Quiet, Taker, follow
from jaxbound.runs.outputs import output_folder, shared_folder
from jaxbound.runs.partnotes import read_by_test, read_devices, read_extremes, read_runs
from jaxbound.runs.parts import forget_parts, part_files, verdicts_of
from jaxbound.runs.shares import check_share, numbers_of
from jaxbound.runs.sink import Sink, Verdicts
from jaxbound.runs.streaming import CHUNK, Asked, all_parts, part_count, publish, write_parts
from jaxbound.runs.summary import Evidence, evidence
from jaxbound.sets.floats.probe import refuse_unusable
from jaxbound.text.objects import readable
from jaxbound.text.progress import Progress, reporter

if TYPE_CHECKING:
    from distributed import Client
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@readable
@dataclass(frozen=True, eq=False)
class Digest:
    """The outcome of a test of a recording larger than memory; the verdicts themselves are in files.

    Fields:
        asked: the test, of which relations and method are properties. data: the ParquetSource. found: the
            Evidence, of which samples, counts, worst, margins, aside, beyond, alarm_count and ended (of all
            alarms) are properties.
        alarms: the first and the 200 deepest Alarms in order of time. hints: sentences for the user.
        line: the Timeline to draw. time: {sample: seconds} of the samples named above, others are read when
            asked for.
        signals: (low, high), each (k, bins): extremes of the recorded signals in the bins of the line,
            outputs before inputs; or None.
        by_test, unwatched: of a monitor the counts of its tests, and the stretches without a verdict; else
            None.
    """

    asked: Asked
    data: ParquetSource
    found: Evidence
    alarms: list[Alarm]
    hints: tuple[str, ...]
    line: Timeline
    time: SampleTimes
    signals: tuple[np.ndarray, np.ndarray] | None = None
    by_test: CountsByTest | None = None
    unwatched: Unwatched | None = None
    evaluated: ClassVar[str] = "XLA"

    @property
    def samples(self) -> int:
        """The number of samples."""
        return self.found.samples

    @property
    def counts(self) -> Mapping[str, int]:
        """{status name: number of windows}."""
        return self.found.counts

    @property
    def aside(self) -> int:
        """How many windows are MISSING because the model's `where` leaves out a sample of theirs."""
        return self.found.aside

    @property
    def beyond(self) -> Outside | None:
        """The windows outside the region of training, counted; None: the model states no ranges."""
        return self.found.outside

    @property
    def ended(self) -> Mapping[str, int]:
        """{ending of an Alarm: how many of all alarms have it}."""
        return self.found.ended or {}

    @property
    def alarm_count(self) -> int:
        """How many alarms there are."""
        return self.found.alarms

    @property
    def worst(self) -> tuple[int, float] | None:
        """(sample, margin) of the FAULT window with the smallest margin (without FAULT: of any window)."""
        if self.found.at is None:
            return None
        return self.found.at, self.found.margin

    @property
    def margins(self) -> str:
        """Of the verdicts, "exact" or "bounds", see `Evidence`."""
        return self.found.margins

    @property
    def bounded(self) -> bool:
        """Whether the margin of `worst` is a bound: of windows alone those of FAULT are measured."""
        return self.found.bounded

    @property
    def relations(self) -> Relations:
        """As tested."""
        return self.asked.relations

    @property
    def method(self) -> str:
        """Of the test."""
        return self.asked.ask.method

    def _head(self) -> str:
        counts = ", ".join(f"{n} {name}" for name, n in self.counts.items() if n)
        return f"Digest ({self.samples},) of {self.source}: {counts}"

    def _rows(self) -> dict[str, str]:
        rows = {"method": f"{self.method}, {looked_at(self.relations)}", "model": repr(self.relations.model)}
        if self.worst is not None:
            least = ""
            if self.bounded and self.counts["FAULT"]:
                least = "at most "
            elif self.bounded:
                least = "at least "
            rows["worst"] = f"margin {least}{self.worst[1]:.4g} at {self.label(self.worst[0])}"
        if self.found.outside is not None:
            tested = self.samples - self.counts["MISSING"]
            rows["training"] = self.found.outside.shown(tested, self.relations.remembers)
        return rows | {"alarms": str(self.alarm_count)}

    def label(self, k: int) -> str:
        """Return the time of sample k as text."""
        return self.time.label(k)

    def when(self, k: int) -> np.datetime64 | float:
        """Return the time of sample k: a datetime64 where the file has dates, else seconds."""
        stamp = self.data.stamp(self.time[k])
        if stamp is None:
            return self.time[k]
        return stamp

    @property
    def _before(self) -> int:
        """How many samples before those of interest are read and tested with them."""
        if self.relations.remembers:
            return REACHES[1]
        return self.relations.horizon

    @property
    def source(self) -> str:
        """The name of the file or folder that was tested."""
        return self.data.path.name

    def around(self, k: int, samples: int = 600) -> tuple[Result, Recording]:
        """Return (Result, Recording) of so many samples around sample k, read and tested anew.

        An observer begins anew 4096 samples earlier: it knows less than at the first time, and may leave
        UNDECIDED what was FAULT.
        """
        r = self.near(k, samples)
        test = partial(detect, self.relations, method=self.method, outside=self.asked.ask.outside)
        return test(r.u, r.y, starts=r.starts, margins=EXACT), r

    def near(self, k: int, samples: int = 600) -> Recording:
        """Return so many samples around sample k, and those before them that `around` needs."""
        first = max(min(k - samples // 2, self.samples - samples), 0)
        return self.data.read(max(first - self._before, 0), min(first + samples, self.samples))

    def explain(self, at: Place) -> Any:
        """Return the Certificate of the window that ends at sample `at`, a number or a time. See
        `Result.explain`, of an observer `refuted_again`.
        """
        k = SampleAxis(self.data).find(str(at))
        if self.relations.remembers:
            return refuted_again(self.relations, self.data, k).certificate
        first = max(k - self._before, 0)
        r = self.data.read(first, k + 1)
        return detect(self.relations, r.u, r.y, method=self.method, starts=r.starts).explain(k - first)


@plot.register(Digest)
def plot_digest(found: Digest, ax: Axes | None = None) -> Figure | Axes:
    """Draw the whole recording as a Result of its verdicts would be drawn."""
    name, bounded = found.relations.model.name, found.margins == BOUNDS
    observes = found.relations.observes
    return plot_timeline(found.line, name, found.alarm_count, ax, bounded, observes)


@evidence.register(Digest)
def _(res: Digest, alarms: Sequence[Alarm]) -> Evidence:
    return res.found


def detect_dataset(
    relations: Relations,
    path: str | PathLike[str],
    out: str | PathLike[str],
    method: str = "joint",
    chunk: int = CHUNK,
    alarm: RuleLike = (1, 1),
    progress: Progress | None = None,
    part: tuple[int, int] | None = None,
    merge: bool = False,
    client: Client | None = None,
    overlap: int | None = None,
    margins: str = AUTO,
    outside: str = CLAIMED,
) -> Digest | list[Path]:
    """Test a Parquet recording of any size and write its verdicts as Parquet.

    Args:
        relations: from `parity_relations` or `structured_relations`, or an `observer`.
        path: a Parquet file, or a folder of them that follow each other by name.
        out: folder for `verdicts.parquet`, a folder of files with the columns time, status, margin and
            suspect, one row a sample; where the model states ranges also outside, outside_by, outside_at, as
            in verdicts.csv. A call that was stopped is continued by the same call.
        method: see `detect`.
        chunk: samples in memory at once, at least 65 536; verdicts do not depend on it.
        alarm: (k, n), an alarm needs k FAULT among n windows; or an AlarmRule.
        progress: called with the share of the work done.
        part: (i, n), test only the i-th of n shares of the recording; others may do theirs at the same time,
            on other machines too, where `out` is one folder for all or their files are brought together.
        merge: test nothing, report on the shares.
        client: of dask.distributed; its workers make the verdicts, and see the recording and `out` by the
            same paths as this process.
        overlap: of an observer, which otherwise is one from the first sample to the last: each part of a
            million samples gets one of its own that begins so many samples earlier, so that parts can be
            shared. It knows less: FAULT is a proof as ever, and may be missed where it rests on samples
            further back. Verdicts do not depend on how the parts are shared.
        margins: see `detect`; those of FAULT windows are always exact, but of a monitor. outside: see
            `detect`.

    Returns:
        A Digest: .counts, .worst (sample, margin), .alarms, .explain(k), .label(k); windows across a gap in
        time are MISSING. Of a share, the files with its verdicts, in the folder `verdicts.partial` of `out`,
        which is where `merge` looks for them.

    Raises:
        TypeError: other relations. OSError, ValueError: data that cannot be read; an unfinished run of other
            data, another model or other
        options in `out`; no alarm rule.

    Example:
        >>> import tempfile, pandas as pd, jaxbound as jb
        >>> m = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     pd.DataFrame({"y1": [1.0, 0.5, 0.9, 0.45]}).to_parquet(f"{folder}/run.parquet")
        ...     found = detect_dataset(jb.parity_relations(m), f"{folder}/run.parquet", f"{folder}/out")
        >>> found.counts["FAULT"], found.worst[0]
        (1, 2)
    """
    if getattr(relations, "made", None) is None:
        raise TypeError(
            f"detect_dataset needs relations of a model, whose verdicts can be kept, not "
            f"{type(relations).__name__}"
        )
    rule = fitted(rule_of(alarm), relations)
    refuse_outside(outside)
    if part is not None:
        check_share(part)
    if part is not None and merge:
        raise ValueError("part makes verdicts and merge reports on them: give one of the two")
    refuse_unusable()
    report = reporter(progress, "detect_dataset")
    how = Asked(relations, Ask(method, margins=margins, outside=outside), overlap, chunk)
    if part is not None:
        with shared_folder(out, (PARTIAL,), (path,)):
            source = _source_in_parts(path, relations.model)
            folder, _ = write_parts(how, source, out, report, part, client)
            return part_files(folder, numbers_of(part, part_count(source)))
    with output_folder(out, (VERDICTS,), (path,)) as place:
        source = _source_in_parts(path, relations.model)
        if merge:
            folder = all_parts(how, source, out)
        else:

            def most(share: float) -> None:
                report(0.95 * share)

            folder, _ = write_parts(how, source, out, most, client=client)
        found = digest(how, source, folder, rule)
        publish(place)
    report(1.0)
    return found


def _source_in_parts(path: str | PathLike[str], model: Named) -> ParquetSource:
    """Return the source of a recording; refuse one that is read as a whole."""
    source = open_source(path, model)
    if not source.parts:
        raise ValueError(f"{path} is read as a whole: give it to detect, or write it as Parquet")
    return cast(ParquetSource, source)  # or a user's kind that is read in parts, too


def digest(
    asked: Asked,
    source: ParquetSource,
    folder: Path,
    alarm: RuleLike = (1, 1),
    alarms_csv: Path | None = None,
    progress: Progress | None = None,
    also: Sequence[Sink] = (),
) -> Digest:
    """Read the verdicts of a ParquetSource once.

    Args:
        asked: as it was tested. source: the ParquetSource that was tested. folder: of the parts, as
            `write_parts` left it.
        alarm: (k, n), an alarm needs k FAULT among n windows; or an AlarmRule. alarms_csv: where to write all
            alarms, or None.
        progress: called with the share of the work done. also: sinks that take the verdicts too.

    Returns:
        A Digest.
    """
    report, relations = reporter(progress, "detect_dataset"), asked.relations
    region, parts = Region.of(relations), part_files(folder)
    tally, times = Tally(relations, lambda piece, k: float(piece.time[k])), SampleTimes(source)
    drawing = _Drawing(Timeline(source.samples))
    ticking = _Ticking(source.dt, times)
    rule = fitted(rule_of(alarm), relations)
    book = AlarmBook(rule, source, relations, asked.ask.method, alarms_csv, drawing.line.mark)
    unwatched = None
    sinks: list[Taker[Recording, Verdicts]] = [tally, ticking, drawing, book, *also]
    if relations.parts:
        unwatched = Unwatched()
        sinks.append(unwatched)
    for _ in follow(verdicts_of(folder, source, region), as_judged, sinks):
        report(tally.samples / source.samples)
    book.close()
    if unwatched is not None:
        tally.by_test = read_by_test(parts, relations)
        unwatched.finish()
    sentence = irregular(ticking.clock, times.label, source.row, source.probe().time)
    if sentence:
        forget_parts(folder)  # verdicts on such data are of no use
        raise ValueError(f"{source.path}: {sentence}")
    alarms, named = book.alarms()
    times |= named
    about = _about_signals(relations, source, tally.samples, read_runs(parts), times.label)
    margins = asked.test_of(source).margins_are
    numbers = tally.evidence(asked.ask.method, asked.ask.outside, book.total, book.ended)
    bounded = margins == BOUNDS and (not numbers.counts["FAULT"] or bool(relations.parts))
    numbers = replace(numbers, aside=about.aside, at=None, margins=margins, bounded=bounded)
    event = tally.worst or tally.tightest
    if event is not None:
        numbers = replace(numbers, at=event.sample, margin=event.margin)
        times[event.sample] = float(event.when)
    digested = Digest(
        asked,
        source,
        numbers,
        alarms,
        (),
        drawing.line,
        times,
        signals=read_extremes(parts, source.samples),
        by_test=tally.by_test,
        unwatched=unwatched,
    )
    hints = [*source.hints, *seam_hints(ticking.clock, times.label, source.row), *about.hints]
    for device in read_devices(parts):
        hints += device_hints(device)
    hints += bound_hints(relations.model, relations)
    hints += unfit_by(relations, numbers.counts, numbers.margin, numbers.outside)
    hints += _wrong_units(digested)
    digested = replace(digested, hints=tuple(hints))
    # an alarm explains its worst window by the Digest that it was found in
    return replace(digested, alarms=[replace(alarm, result=digested) for alarm in alarms])


def _wrong_units(found: Digest) -> list[str]:
    """Return the sentences on signals that may be in another unit, or another column, than the model's."""
    relations = found.relations
    by_windows = any(not test.remembers for test in (relations.parts or {"": relations}).values())
    if found.worst is None or not found.counts["FAULT"] or not by_windows:
        return []
    return unit_hints(found.around(found.worst[0])[0])


class _Ticking(Quiet):
    """A sink that finds the seams, and keeps the times that sentences name: of both ends and of seams."""

    def __init__(self, dt: float, times: SampleTimes) -> None:
        self.clock, self.times = Clock(dt), times

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        first = self.clock.samples
        self.clock, _ = tick(self.clock, piece.time)
        for k in (0, self.times.source.samples - 1, *(seam.sample for seam in self.clock.seams)):
            if first <= k < first + piece.samples:
                self.times[k] = float(piece.time[k - first])


class _Drawing(Quiet):
    """A sink that puts verdicts into a Timeline."""

    def __init__(self, line: Timeline) -> None:
        self.line, self.samples = line, 0

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        axis = piece.axis
        assert axis is not None, "parts have times"
        self.line.add(self.samples, axis, verdicts.status, verdicts.margin)
        self.samples += piece.samples


class SampleTimes(dict[int, float]):
    """{sample: seconds}; those of other samples are read when they are asked for."""

    def __init__(self, source: ParquetSource) -> None:
        self.source = source

    def __missing__(self, k: int) -> float:
        self[k] = self.source.time(k)
        return self[k]

    def label(self, k: int) -> str:
        """Return the time of a sample as text."""
        return time_label(self[k], self.source.stamp(self[k]), self.source.dt)


class _AboutSignals(NamedTuple):
    """Sentences on the signals of a recording, and how many windows are set aside by `where`."""

    hints: list[str]
    aside: int


def _about_signals(
    relations: Relations, source: ParquetSource, count: int, runs: list[Runs], label: Callable[[int], str]
) -> _AboutSignals:
    """Return sentences on missing samples, on a recorder that rounds and on signals that stand still.

    Args:
        count: of samples. runs: see `read_runs`. label: number of a sample -> text of its time.
    """
    model, where, horizon = relations.model, source.plan.where, relations.horizon
    samples, aside, hints = count, 0, []
    if where is not None:
        *runs, kept = runs
        samples = kept.present
        aside = count - horizon - windows_inside(kept, horizon)
        hints = where_hints(where.text, count - samples, count)
    named = dict(zip((*known(model), *model.outputs), runs, strict=True))
    still: list[str] = []
    for name in (*model.outputs, *model.inputs):
        still += signal_hints(name, named[name], label, driven=name in model.inputs)
    lacking = {name: samples - signal.present for name, signal in named.items()}
    missing = missing_sentences(model, lacking, samples)
    return _AboutSignals([*missing, *rounding_hints(model, source.probe().y), *still, *hints], aside)
