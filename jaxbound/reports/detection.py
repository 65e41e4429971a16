"""The page of a detection: verdict, charts, alarms with their proofs, model and bounds."""

import contextlib
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any, cast

import numpy as np

from jaxbound.certificates.interface import WindowCertificate
from jaxbound.consistency.interface import BOUNDS, Relations
from jaxbound.consistency.monitorbank import MonitorBank
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.observed import ObserverResult, shown_name
from jaxbound.diagnosis.result import Result
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.models.system import LinearSystem
from jaxbound.plots.result import draws_bounds, timeline_of
from jaxbound.recordings.recording import Recording
from jaxbound.relations.sentence import looked_at
from jaxbound.reports.causes import Cause, causes_of
from jaxbound.reports.chartdata import Shown, charts
from jaxbound.reports.clock import shown_time
from jaxbound.reports.monitored import monitor_sections
from jaxbound.reports.overview import overview
from jaxbound.reports.page import render
from jaxbound.reports.parts import computed, distinct_relations, model_values
from jaxbound.runs.digest import Digest
from jaxbound.runs.endings import sizes_text
from jaxbound.runs.summary import Evidence, Summary
from jaxbound.sets.floats.status import Status
from jaxbound.text.names import one_of
from jaxbound.text.quantities import duration, factor, three_digits

ROWS = 200  # alarms in the table
SUSPECT = 5  # the cell of a row that has its suspects
LINES = 20  # relations in words
PATIENCE = 1.0  # seconds for the exact certificates of the table
ACTUATED = 256
"""Readings times inputs from which on actuators are left to `explain`: an exact program each."""
LARGE = 64  # readings from which on the errors of single sensors are left to `explain`: 122 take a minute


def write_report(
    file: Path,
    res: Result | Digest,
    recording: Recording | Digest,
    alarms: Sequence[Alarm],
    summary: Summary,
    seconds: Mapping[str, float] | None = None,
    extra: Sequence[tuple[object, ...]] = (),
) -> None:
    """Write a page: one file that asks nobody, with its charts, and a script of its own that moves one of
    them.

    Args:
        file: its path. res: a Result of one recording, or a Digest. alarms: its alarms.
        recording: with .label(k), .axis and .time, as `read` returns it; for a Digest itself.
        summary: from `summarised`. seconds: {stage: seconds}.
        extra: (title, picture as PNG bytes or None, text, table as rows of cells or None) for sections
            of one's own.
    """
    relations, part = res.relations, isinstance(res, Digest)
    model = cast(LinearSystem, relations.model)  # a page is of a plant
    dtype = res.data.dtype if isinstance(res, Digest) else res.y.dtype
    tested = cast(Evidence, summary.found)
    worst = summary.worst.sample if summary.worst else None
    chosen = sorted(range(len(alarms)), key=lambda i: _depth(alarms[i]))[:ROWS]
    shown = Shown(alarms, chosen, _certified(res, alarms, chosen), worst)
    causes = causes_of(model, alarms, chosen)
    extra = [*monitor_sections(res, recording.label), *extra]
    rows = list(_alarm_rows(res, recording, shown, causes))
    drawn = charts(res, recording, shown)
    template, values = about(relations)
    page = render(
        template,
        name=model.name,
        verdict=summary.verdict,
        sentence=summary.sentence,
        summary=summary,
        tested=tested,
        recording=recording,
        extra=extra,
        charts=drawn,
        picture=_picture(res, recording, alarms),
        bounded=res.margins == BOUNDS and (isinstance(res, Digest) or draws_bounds(res)),
        signals=(len([row for row in drawn.rows if row.key.startswith("s")]), model.p + model.m),
        combined=any(stretch["combined"] for stretch in drawn.near),
        relations_alone=relations.uncertain,
        bands=_has_bands(drawn.near[0]["series"]),
        bands_of_all=_has_bands(drawn.whole.low),
        alarms=rows,
        suspected=any(row[SUSPECT] for row in rows),
        caused=bool(causes),
        uncaused=len(chosen) - len(causes),
        most=ROWS,
        sizes=sizes_text(res, summary.sizes),
        part=part,
        model=model_values(model, cast(Mapping[str, np.ndarray], relations.bounds)),
        shown={status.name: shown_name(status, relations.observes) for status in Status},
        observes=relations.observes,
        **values,
        computed=computed(res.method, looked_at(relations), dtype, seconds or {}, res.evaluated),
    )
    file.write_text(page, encoding="utf-8")


def _picture(res: Result | Digest, recording: Recording | Digest, alarms: Sequence[Alarm]) -> bytes:
    """Return the picture of the whole recording for readers without scripts."""
    relations, bounded = res.relations, res.margins == BOUNDS
    if isinstance(res, Digest):
        line, count = res.line, res.alarm_count
    else:
        line = timeline_of(res, shown_time(cast(Recording, recording), len(res.status)), alarms)
        count, bounded = len(alarms), draws_bounds(res)
    name = relations.model.name
    if bounded:
        name = f"{name}, above 0 a lower bound"
    ends = recording.label(0), recording.label(line.samples - 1)
    return overview(line, name, ends, count, relations.observes)


def _has_bands(keys: Iterable[str]) -> bool:
    return any(key.endswith(":band") for key in keys)


def _depth(alarm: Alarm) -> float:
    """Return the margin of the worst window, 0 where the test measures none."""
    return 0.0 if math.isnan(alarm.depth) else alarm.depth


def _alarm_rows(
    res: Result | Digest, recording: Recording | Digest, shown: Shown, causes: Mapping[int, Cause]
) -> Iterator[tuple[object, ...]]:
    """Yield the rows of the deepest alarms in order of time."""
    for i in sorted(shown.chosen):
        a, why = shown.alarms[i], shown.why.get(i)
        lasts = float(recording.time[a.end] - recording.time[a.start]) + (res.relations.model.dt or 0.0)
        needed, wrong, violated, since = "", "", "", ""
        if not math.isnan(a.depth):
            needed = f"× {factor(1 - a.depth)}"
        if why is not None:
            wrong, violated = _sensor_errors(why), why.relation
        if isinstance(res, ObserverResult):
            since = _since(res, recording, a.worst)
        begun, ended = recording.label(a.start), recording.label(a.end)
        yield (
            i + 1,
            begun,
            ended,
            duration(lasts),
            a.windows,
            _suspects(a, why),
            needed,
            wrong,
            violated,
            a.ended,
            since,
            _outside(a),
            a.test,
            causes.get(i),
        )


def _suspects(alarm: Alarm, why: WindowCertificate | None) -> str:
    """Return the signals that alone could be wrong, of the rule that names them, else sensors in the worst
    window; "" where none is known.
    """
    names = alarm.suspects
    if not names and why is not None:
        names = why.sensor_candidates
    return " or ".join(names)


def _outside(alarm: Alarm) -> str:
    """Return how much of an alarm lies outside the region of training; "" for nothing."""
    if not alarm.outside:
        return ""
    return f"outside training: {alarm.outside} of its FAULT windows, by {alarm.outside_by}"


def _since(res: ObserverResult, recording: Recording | Digest, k: int) -> str:
    """Return the time of the first sample that the verdict of an observer on sample k rests on."""
    first = int(res.observation.since[k]) - int(res.relations.begin().samples)
    if first < 0:
        return "a recording before"
    return recording.label(first)


def _certified(res: Result | Digest, alarms: Sequence[Alarm], chosen: Sequence[int]) -> dict[int, Any]:
    """Return {i: certificate of the worst window}, of as many alarms as patience allows."""
    stop = time.perf_counter() + PATIENCE
    why: dict[int, Any] = {}
    for i in chosen:
        if time.perf_counter() >= stop:
            break
        with contextlib.suppress(NotImplementedError):
            why[i] = res.explain(alarms[i].worst)
    return why


def _sensor_errors(certificate: Any) -> str:
    """Return the smallest single-sensor errors as text, the most plausible first, where they are known."""
    if len(certificate.window.y) > LARGE or not certificate.errors:
        return ""
    model, wrong = certificate.window.model, []
    is_asked = len(certificate.window.y) * model.m <= ACTUATED
    names = certificate.sensor_candidates
    if is_asked:
        names = certificate.candidates
    for name in names:
        how = f"{name} (actuator)"
        if name in certificate.errors:
            least = three_digits(float(certificate.errors[name]))
            how = f"{name} by {least} {model.unit(name)}".strip()
        wrong.append(how)
    if is_asked:
        return one_of(wrong) or "none alone"
    return f"{one_of(wrong) or 'no sensor alone'}; actuators: see explain"


@singledispatch
def about(relations: Relations) -> tuple[str, dict[str, object]]:
    """Return (template of a page, values that describe relations: their number and text, how they are
    tested).
    """
    lines, distinct = relations.text().splitlines(), distinct_relations(relations)
    shown = [lines[j] for j in distinct[:LINES]]
    if len(distinct) > LINES:
        shown.append("...")
    return "detection.html", {
        "relations": relations.count,
        "distinct": len(distinct),
        "lines": shown,
        "tested_how": "; ".join(filter(None, (relations.tested, *relations.notes))),
    }


@about.register(MonitorBank)
def _(bank: MonitorBank) -> tuple[str, dict[str, object]]:
    """Return those of a monitor: its tests."""
    return "monitor.html", {"relations": bank.count, "lines": bank.text().splitlines()}


@about.register(SetObserver)
def _(observer: SetObserver[Any]) -> tuple[str, dict[str, object]]:
    """Return those of an observer: its order, its weights, whether it begins anew."""
    return "observation.html", {
        "order": f"{observer.order:g}",
        "weights": ", ".join(f"{w:g}" for w in observer.weights),
        "restart": observer.restart,
    }
