"""The charts of a detection: the whole recording, stretches around the deepest alarms, and the combinations
of samples that were violated there.
"""

import contextlib
import time as clock_time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import singledispatch
from typing import Any, cast

import numpy as np

from jaxbound.certificates.certificate import Certificate
from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.observed import ObserverResult
from jaxbound.diagnosis.result import Result
from jaxbound.models.system import LinearSystem
from jaxbound.plots.combination import combination, expected_readings
from jaxbound.plots.result import drawn_margins
from jaxbound.recordings.recording import Recording
from jaxbound.reports.chart import ChartPiece, ChartRow, Charts, band_key, coded, median_step, piece_of, plain
from jaxbound.reports.clock import AxisClock, axis_of, clock_of
from jaxbound.runs.digest import Digest
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.characters import clipped, printable

SIGNALS, STATES = 12, 6  # charts of signals, and of states that an observer encloses
RELATIONS = 6  # charts of relations that no certificate combines
NEAR = 60  # stretches around alarms
SPAN, ASIDE = 160, 10  # samples of a stretch, and how close to its ends an alarm may be
BEFORE = 20  # samples of a stretch before the alarm that it is made for
BANDS = 50_000  # samples up to which windows say of every reading what they expect
PATIENCE = 1.0  # seconds to read such stretches of a recording that is not in memory
COMBINED = "combination of relations, in what its bounds allow"
COLUMN = "column "  # the first word of the keys of numbers that a test hands over
TITLE = 120  # characters of a relation


@dataclass(frozen=True)
class Shown:
    """The alarms of a page.

    Fields: alarms: all of them. chosen: the numbers of those in the table, the deepest first. why: {number:
    certificate}. worst: the sample at which the worst window ends, None: no window has data.
    """

    alarms: Sequence[Alarm] = ()
    chosen: Sequence[int] = ()
    why: Mapping[int, Any] = field(default_factory=dict)
    worst: int | None = None


def charts(res: Result | Digest, recording: Recording | Digest, shown: Shown) -> Charts:
    """Return the charts of a report. res: a Result of one recording, or a Digest. recording: as for
    `write_report`.
    """
    signals = signal_rows(res)[:SIGNALS]
    states = state_rows(res)
    if isinstance(res, Digest):
        whole, x, clock = _digested(res, signals)
        samples = res.samples
    else:
        whole, x, clock = _whole(res, cast(Recording, recording), signals)
        samples = len(res.status)

    about = "the tightest window"
    if isinstance(res, Digest) and res.bounded:  # another one may be tighter
        about = "the window with the lowest bound"
    near = _stretches(res, x, signals, shown)
    close, times = near[0].piece, []
    verdicts = [ChartRow("margin", "margin", kind="margin")]
    for name in near[0].res.columns:  # of a Digest too, whose stretches are judged anew
        verdicts.append(ChartRow(f"{COLUMN}{name}", name))
    begin = float(close.x[0])
    if shown.chosen:
        begin = max(begin, float(x(max(shown.alarms[shown.chosen[0]].start - BEFORE, 0))))
    for i in sorted(shown.chosen):
        alarm = shown.alarms[i]
        times.append([i, *(float(x(k)) for k in (alarm.start, alarm.end, alarm.worst))])
    return Charts(
        rows=[*_combined_rows(res.relations), *verdicts, *signals, *states],
        clock=clock,
        samples=samples,
        last=float(x(samples - 1)),
        step=median_step(close.x),
        whole=whole,
        near=[stretch.plain() for stretch in near],
        begin=begin,
        end=float(close.x[-1]),
        about=about,
        alarms=times,
        alarm=(*shown.chosen, -1)[0],
    )


def signal_rows(res: Result | Digest) -> list[ChartRow]:
    """Return a ChartRow for each output and each input; an input holds until its next sample."""
    model = res.relations.model
    outputs = [ChartRow(f"s{i}", name, model.unit(name)) for i, name in enumerate(model.outputs)]
    inputs = []
    for i, name in enumerate(model.inputs):
        training = _training(res, name)
        inputs.append(ChartRow(f"s{model.p + i}", name, model.unit(name), steps=True, training=training))
    return outputs + inputs


def _training(res: Result | Digest, name: str) -> tuple[float, float] | None:
    """Return the range of an input in training, None where it is not stated."""
    model = res.relations.model
    if not isinstance(model, LinearSystem) or name not in model.ranges:
        return None
    lo, hi = model.ranges[name]
    return float(lo), float(hi)


def _whole(
    res: Result, recording: Recording, signals: Sequence[ChartRow]
) -> tuple[ChartPiece, Callable[[int], float], AxisClock]:
    """Return the ChartPiece of a Result, the time of a sample by its number, and the AxisClock."""
    time, clock = axis_of(recording, len(res.status), res.relations.model.dt)
    margin = drawn_margins(res)
    series = {"margin": margin, **_signals(res.u, res.y, signals), **_number_series(res)}
    bands = bands_of(res, slice(0, len(time)))
    return piece_of(time, res.status, series, bands).fitting(), time.__getitem__, clock


def _digested(
    res: Digest, signals: Sequence[ChartRow]
) -> tuple[ChartPiece, Callable[[int], float], AxisClock]:
    """Return the same of a Digest: its signals are in a file, of which the extremes are known."""
    line = res.line
    assert line.x is not None, "a Digest has all of its samples in its line"
    dates = np.issubdtype(line.x.dtype, np.datetime64)
    x, stamp = np.asarray(line.x, float), None
    if dates:
        x, stamp = (line.x - line.x[0]) / np.timedelta64(1, "s") + res.time[0], line.x[0]
    ends = np.array([res.time[0], res.time[res.samples - 1]])
    clock = clock_of(res.label, ends, stamp, res.samples, res.data.dt)

    low, high = {"margin": line.low}, {"margin": line.high}
    least, most = res.signals or ((), ())
    for row, lowest, highest in zip(signals, least, most, strict=False):
        low[row.key], high[row.key] = lowest, highest
    piece = ChartPiece(x, line.status, low, high, len(x) < res.samples)
    return piece.fitting(), res.time.__getitem__, clock


def _signals(u: np.ndarray, y: np.ndarray, signals: Sequence[ChartRow]) -> dict[str, np.ndarray]:
    """Return {key: (T,)} of the signals shown: outputs, then inputs."""
    columns = np.concatenate([y, u], 1).T
    return {row.key: column for row, column in zip(signals, columns, strict=False)}


def _number_series(res: Result, ends: slice = slice(None)) -> dict[str, np.ndarray]:
    """Return {key: numbers} that a test hands over beside its verdicts."""
    return {f"{COLUMN}{name}": x[ends] for name, x in res.columns.items()}


class ChartStretch:
    """Samples one by one, with the combination that each alarm among them violates.

    first, stop: numbers of the samples; piece: their ChartPiece. begin: the number of the first one in `res`.
    """

    def __init__(self, res: Result, first: int, stop: int, piece: ChartPiece, begin: int) -> None:
        """Begin without alarms."""
        self.res, self.first, self.stop, self.piece, self.begin = res, first, stop, piece, begin
        self.combined: dict[int, tuple[str, np.ndarray]] = {}

    def holds(self, sample: int) -> bool:
        """Return whether a sample is among those in the middle."""
        return self.first + ASIDE <= sample < self.stop - ASIDE

    def combine(self, i: int, certificate: object) -> None:
        """Add the combination of samples that a certificate of alarm i states, if it states one."""
        if not isinstance(certificate, Certificate) or not any(certificate.h) or certificate.window.constant:
            return
        stop = self.begin + len(self.piece.x)
        before = max(self.begin - certificate.window.horizon, 0)
        with np.errstate(over="ignore", invalid="ignore"):  # samples near the largest numbers
            value, width = combination(certificate, self.res.u[before:stop], self.res.y[before:stop])
            share = (value / width)[self.begin - before :]
        relation = clipped(printable(certificate.relation))
        self.combined[i] = relation, np.where(self.piece.status == Status.MISSING, np.nan, share)

    def plain(self) -> dict[str, Any]:
        """Return the stretch as JSON has it."""
        combined = [[i, relation, coded(share)] for i, (relation, share) in self.combined.items()]
        return plain(self.piece) | {"combined": combined}


def _stretches(
    res: Result | Digest, x: Callable[[int], float], signals: Sequence[ChartRow], shown: Shown
) -> list[ChartStretch]:
    """Return the stretches around alarms, as many as patience allows, or that around the tightest window."""
    if not shown.chosen:
        only = _stretch(res, x, shown.worst or 0, signals)
        only.combine(-1, _explained(res, shown.worst))
        return [only]
    begun = clock_time.perf_counter()
    stretches: list[ChartStretch] = []
    for i in shown.chosen:
        worst = shown.alarms[i].worst
        home = next((stretch for stretch in stretches if stretch.holds(worst)), None)
        if home is None:
            late = isinstance(res, Digest) and clock_time.perf_counter() - begun > PATIENCE
            if len(stretches) == NEAR or (stretches and late):
                continue
            middle = shown.alarms[i].start - BEFORE + SPAN // 2
            if abs(worst - middle) >= SPAN // 2 - ASIDE:  # too long after the begin
                middle = worst
            home = _stretch(res, x, middle, signals)
            stretches.append(home)
        home.combine(i, shown.why.get(i))
    return stretches


def _stretch(
    res: Result | Digest, x: Callable[[int], float], sample: int, signals: Sequence[ChartRow]
) -> ChartStretch:
    """Return the ChartStretch around one sample."""
    samples = res.samples if isinstance(res, Digest) else len(res.status)
    first = max(min(sample - SPAN // 2, samples - SPAN), 0)
    stop, begin = min(first + SPAN, samples), first
    if isinstance(res, Digest):
        res, recording = res.around(sample, SPAN)
        begin = len(res.status) - (stop - first)  # the window before needs samples of its own
        time = recording.time[begin:]
    else:
        time = np.array([x(k) for k in range(first, stop)])
    ends = slice(begin, begin + stop - first)
    shown = np.zeros(len(res.status), bool)
    shown[ends] = True
    series = {
        "margin": res.measured(shown)[ends],
        **_signals(res.u[ends], res.y[ends], signals),
        **_uncertain_shares(res, ends),
        **_number_series(res, ends),
    }
    piece = piece_of(time, res.status[ends], series, bands_of(res, ends))
    return ChartStretch(res, first, stop, piece, begin)


@singledispatch
def state_rows(res: object) -> list[ChartRow]:
    """Return a ChartRow for each state that is enclosed: none of windows."""
    return []


@state_rows.register
def _(res: ObserverResult) -> list[ChartRow]:
    """Return those of an observer."""
    model = res.relations.model
    states = model.states[:STATES]
    return [ChartRow(f"x{i}", f"state {name}", model.unit(name)) for i, name in enumerate(states)]


@singledispatch
def bands_of(res: object, ends: slice) -> dict[str, Interval]:
    """Return {key: band} of the samples `ends` that are drawn behind rows: none."""
    return {}


@bands_of.register
def _(res: Result, ends: slice) -> dict[str, Interval]:
    """Return the readings that windows expect, by the other samples of each."""
    relations = res.relations
    linear = relations.linear
    if linear is None or linear.model.constant_tolerance or ends.stop - ends.start > BANDS:
        return {}
    before = max(ends.start - relations.horizon, 0)
    with np.errstate(over="ignore", invalid="ignore"):  # samples near the largest numbers
        bands = expected_readings(relations, res.u[before : ends.stop], res.y[before : ends.stop])
    judged = (res.status[ends] != Status.MISSING)[:, None]  # a window across a gap expects nothing
    lo, hi = (np.where(judged, end[ends.start - before :], np.nan) for end in (bands.lo, bands.hi))
    shown = [i for i in range(min(SIGNALS, relations.model.p)) if not np.isnan(lo[:, i]).all()]
    return {band_key(f"s{i}"): Interval(lo[:, i], hi[:, i]) for i in shown}


@bands_of.register
def _(res: ObserverResult, ends: slice) -> dict[str, Interval]:
    """Return the enclosures of an observer: each output as the samples before allow, and each state."""
    model, readings, states = res.relations.model, res.readings, res.observation.state
    bands = {}
    for i in range(min(SIGNALS, model.p)):
        bands[band_key(f"s{i}")] = _column(readings, i, ends)
    for i in range(min(STATES, model.n)):
        bands[band_key(f"x{i}")] = _column(states, i, ends)
    return bands


def _column(band: Interval, i: int, ends: slice) -> Interval:
    return Interval(np.asarray(band.lo)[ends, i], np.asarray(band.hi)[ends, i])


def _uncertain_shares(res: Result, ends: slice) -> dict[str, np.ndarray]:
    """Return {key: share} of each relation with uncertain parameters, which no certificate combines with
    others.
    """
    if not res.relations.uncertain:
        return {}
    before = max(ends.start - res.relations.horizon, 0)
    u, y = res.u[before : ends.stop], res.y[before : ends.stop]
    allowed, external = res.relations.internal(u, y), res.relations.external(u, y)
    lo, hi, value = (
        np.asarray(z)[ends.start - before :, :RELATIONS] for z in (allowed.lo, allowed.hi, external)
    )
    with np.errstate(over="ignore", invalid="ignore"):
        shares = ((value - (lo + hi) / 2) / ((hi - lo) / 2)).T
    missing = res.status[ends] == Status.MISSING
    return {f"c{j}": np.where(missing, np.nan, share) for j, share in enumerate(shares)}


def _explained(res: Result | Digest, worst: int | None) -> object:
    """Return the certificate of the tightest window where there is no alarm, or None."""
    if worst is None:
        return None
    with contextlib.suppress(NotImplementedError, ValueError):
        return res.explain(worst)
    return None


def _combined_rows(relations: Relations) -> Iterator[ChartRow]:
    """Yield the Rows of combinations: one that certificates state, or each relation alone."""
    if not relations.uncertain:
        yield ChartRow("combination", COMBINED, kind="combination")
        return
    for j, line in enumerate(relations.text().splitlines()[:RELATIONS]):
        name = line if len(line) <= TITLE else f"{line[: TITLE - 3]}..."
        yield ChartRow(f"c{j}", name, kind="combination")
