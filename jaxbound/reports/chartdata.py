"""Which charts a report of a detection has: the whole recording, stretches around the deepest alarms, what
was violated there.
"""

import contextlib
import time as clock_time
from collections.abc import Mapping, Sequence
from functools import singledispatch
from typing import Any

import numpy as np

from jaxbound.certificates.certificate import Certificate
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.observed import ObserverResult
from jaxbound.plots.combination import combination
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.reports.chart import VALUES, Piece, Row, band_key, coded, drawn, piece_of, pieces_of, plain
from jaxbound.reports.clock import axis_of, clock_of
from jaxbound.runs.digest import Digest
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.characters import clipped, printable

__all__ = ["charts"]

SIGNALS, STATES = 12, 6  # charts of signals, and of states that an observer encloses
RELATIONS = 6  # charts of relations that no certificate combines
NEAR, SPAN, ASIDE = (
    60,
    160,
    10,
)  # stretches around alarms, their samples, and how close to an end an alarm may be
PATIENCE = 1.0  # seconds to read such stretches of a recording that is not in memory
COMBINED = "violated combination, in what its bounds allow"


def charts(
    res: Any,
    recording: Any,
    alarms: Sequence[Alarm],
    chosen: Sequence[int],
    why: Mapping[int, Any],
    worst: int | None,
) -> dict[str, Any]:
    """Return what the templates of a report show over time.

    Args:
        res: a Result of one recording, or a Digest. recording: as for `write_report`. alarms: all of them.
        chosen: the numbers of those in the table, the deepest first. why: {number: certificate}. worst: the
            sample at which the worst window ends, None: no window has data.

    Returns:
        overview, zoom: of `drawn`. numbers: for the script. about: what the zoom shows. signals: (shown,
            all).
    """
    model, part = res.relations.model, isinstance(res, Digest)
    signals = [Row(f"s{i}", name, model.unit(name)) for i, name in enumerate((*model.outputs, *model.inputs))]
    signals, every = signals[:SIGNALS], len(signals)
    whole, x, clock = _digested(res, signals) if part else _whole(res, recording, signals)
    near: list[_Near] = []
    begun = clock_time.perf_counter()
    for i, at in [(i, alarms[i].worst) for i in chosen] or [(-1, 0 if worst is None else worst)]:
        home = next((n for n in near if n.first + ASIDE <= at < n.stop - ASIDE), None)
        if home is None and (
            len(near) == NEAR or (part and near and clock_time.perf_counter() - begun > PATIENCE)
        ):
            continue
        if home is None:
            home = _near(res, x, at, signals)
            near.append(home)
        home.combine(i, why.get(i) if i >= 0 else _explained(res, worst))
    first = chosen[0] if chosen else -1
    over = _Near(res, 0, len(whole.x), whole)
    if not part and len(whole.x) == len(res.status):  # sample by sample
        over.combine(first, near[0].certificates.get(first))
    piece, relation = near[0].complete(first), near[0].relation(first)
    margin = Row("margin", "margin", kind="margin")
    states = bands_of(res)[0]
    rows = [*_combinations(res.relations), margin, *signals, *states]
    samples = res.samples if part else len(res.status)
    numbers = {
        "clock": clock.plain()
        | {"tokens": list(map(printable, clock.tokens)), "before": printable(clock.before)},
        "samples": samples,
        "last": float(x(samples - 1)),
        "step": float(np.median(np.diff(piece.x))) if len(piece.x) > 1 else 1.0,
        "whole": over.plain(),
        "near": [n.plain() for n in near],
        "alarms": [
            [i, *(float(x(k)) for k in (alarms[i].start, alarms[i].end, alarms[i].worst))]
            for i in sorted(chosen)
        ],
        "alarm": first,
        "from": float(piece.x[0]),
        "to": float(piece.x[-1]),
    }
    what = f"around alarm {first + 1}" if first >= 0 else "around the tightest window"
    return {
        "overview": drawn(
            [margin, *signals, *states], whole, clock, [float(x(alarms[i].worst)) for i in chosen]
        ),
        "zoom": drawn(rows, piece, clock),
        "numbers": numbers,
        "about": {"shown": what, "relation": relation, "deepest": first >= 0},
        "signals": (len(signals), every),
    }


def _whole(res, recording, signals):
    """Return (Piece, time of a sample, Clock) of a Result."""
    time, clock = axis_of(recording, len(res.status), res.relations.model.dt)
    series = {"margin": res.margin, **_signals(res.u, res.y, signals)}
    return pieces_of(time, res.status, series, bands_of(res)[1]), time.__getitem__, clock


def _digested(res, signals):
    """Return (Piece, time of a sample, Clock) of a Digest, whose signals are in a file: their extremes are
    known.
    """
    line = res.line
    dates = np.issubdtype(line.x.dtype, np.datetime64)
    x = (line.x - line.x[0]) / np.timedelta64(1, "s") + res.time[0] if dates else np.asarray(line.x, float)
    ends = np.array([res.time[0], res.time[res.samples - 1]])
    clock = clock_of(res.label, ends, line.x[0] if dates else None, res.samples, res.relations.model.dt)
    low, high = {"margin": line.low}, {"margin": line.high}
    for row, least, most in zip(signals, *(res.signals or ((), ())), strict=False):
        low[row.key], high[row.key] = least, most
    piece, numbers = Piece(x, line.status, low, high, len(x) < res.samples), 2 * len(low)
    if len(x) * numbers > VALUES:
        piece = piece.reduced(VALUES // numbers)
    return piece, lambda k: res.time[k], clock


def _signals(u, y, signals):
    """Return {key: (T,)} of the signals shown: outputs, then inputs."""
    return {row.key: (y[:, i] if i < y.shape[1] else u[:, i - y.shape[1]]) for i, row in enumerate(signals)}


class _Near:
    """A stretch sample by sample, with what was violated by each alarm in it. first, stop: its samples;
    piece: their Piece.
    """

    def __init__(self, res, first, stop, piece, begin=None):
        self.res, self.first, self.stop, self.piece, self.begin = (
            res,
            first,
            stop,
            piece,
            first if begin is None else begin,
        )
        self.certificates, self.shares = {}, {}

    def combine(self, i, certificate):
        """Add the combination of samples that a certificate of alarm i states, if it states one."""
        if isinstance(certificate, Certificate) and any(certificate.h) and not certificate.window.constant:
            s, stop = certificate.window.horizon, self.begin + len(self.piece.x)
            before = max(self.begin - s, 0)
            with np.errstate(over="ignore", invalid="ignore"):  # samples near the largest numbers
                value, width = combination(certificate, self.res.u[before:stop], self.res.y[before:stop])
                share = (value / width)[self.begin - before :]
            self.shares[i] = np.where(self.piece.status == Status.MISSING, np.nan, share)
            self.certificates[i] = certificate

    def relation(self, i):
        return clipped(printable(self.certificates[i].relation)) if i in self.certificates else ""

    def complete(self, i):
        """Return the Piece with the combination of alarm i."""
        added = {"combination": self.shares[i]} if i in self.shares else {}
        return Piece(
            self.piece.x,
            self.piece.status,
            added | self.piece.low,
            added | self.piece.high,
            self.piece.binned,
        )

    def plain(self):
        return plain(self.piece) | {
            "combined": [[i, self.relation(i), coded(share)] for i, share in self.shares.items()]
        }


def _near(res, x, at, signals):
    """Return the _Near of the samples around one window."""
    samples = res.samples if isinstance(res, Digest) else len(res.status)
    first = max(min(at - SPAN // 2, samples - SPAN), 0)
    stop, begin = min(first + SPAN, samples), first
    if isinstance(res, Digest):
        res, recording = res.around(at, SPAN)
        begin = len(res.status) - (stop - first)  # the window before needs samples of its own
        time = recording.time[begin:]
    else:
        time = np.array([x(k) for k in range(first, stop)])
    ends = slice(begin, begin + stop - first)
    series = {
        "margin": res.margin[ends],
        **_signals(res.u[ends], res.y[ends], signals),
        **_uncertain(res, ends),
    }
    bands = {key: Interval(band.lo[ends], band.hi[ends]) for key, band in bands_of(res)[1].items()}
    return _Near(res, first, stop, piece_of(time, res.status[ends], series, bands), begin)


@singledispatch
def bands_of(res: Any) -> tuple[list[Row], dict[str, Interval]]:
    """Return (Rows of what is enclosed and not measured, {key: band (T,)} of what is drawn behind rows): none
    of windows.
    """
    return [], {}


@bands_of.register
def _(res: ObserverResult):
    """Return what an observer encloses: each output as the samples before allow, and each state."""
    model, states = res.relations.model, res.observation.state
    shown = min(SIGNALS, model.p), min(STATES, model.n)
    one = lambda band, i: Interval(np.asarray(band.lo)[:, i], np.asarray(band.hi)[:, i])
    rows = [
        Row(f"x{i}", f"state {name}", model.unit(name)) for i, name in enumerate(model.states[: shown[1]])
    ]
    bands = {band_key(f"s{i}"): one(res.readings, i) for i in range(shown[0])}
    return rows, bands | {band_key(row.key): one(states, i) for i, row in enumerate(rows)}


def _uncertain(res, ends):
    """Return {key: share} of each relation with uncertain parameters, which no certificate combines with
    others.
    """
    if not isinstance(res.relations, UncertainRelations):
        return {}
    before = max(ends.start - res.relations.horizon, 0)
    u, y = res.u[before : ends.stop], res.y[before : ends.stop]
    allowed = res.relations.internal(u, y)
    lo, hi, value = (
        np.asarray(z)[ends.start - before :, :RELATIONS]
        for z in (allowed.lo, allowed.hi, res.relations.external(u, y))
    )
    with np.errstate(over="ignore", invalid="ignore"):
        shares = ((value - (lo + hi) / 2) / ((hi - lo) / 2)).T
    return {
        f"c{j}": np.where(res.status[ends] == Status.MISSING, np.nan, share) for j, share in enumerate(shares)
    }


def _explained(res, worst):
    """Return the certificate of the tightest window where there is no alarm, or None."""
    if worst is None:
        return None
    with contextlib.suppress(NotImplementedError, ValueError):
        return res.explain(worst)
    return None


def _combinations(relations):
    """Return the Rows of what `_combined` gives."""
    if not isinstance(relations, UncertainRelations):
        return [Row("combination", COMBINED, kind="combination")]
    lines = relations.text().splitlines()[:RELATIONS]
    return [
        Row(f"c{j}", line if len(line) <= 120 else f"{line[:117]}...", kind="combination")
        for j, line in enumerate(lines)
    ]
