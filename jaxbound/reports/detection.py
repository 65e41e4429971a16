"""The page of a detection, with pictures of the margin and of the residuals beside it."""

import contextlib
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

from jaxbound.diagnosis.alarms import Alarm
from jaxbound.plots.canvas import to_png
from jaxbound.plots.plot import plot
from jaxbound.plots.residuals import distinct_relations, plot_residuals
from jaxbound.recordings.plaintext import duration, factor
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.reports.page import TITLE, render
from jaxbound.reports.parts import computed, model_values
from jaxbound.runs.digest import Digest
from jaxbound.runs.endings import sizes_text
from jaxbound.runs.summary import Evidence, Summary

__all__ = ["write_report"]

ROWS = 200  # alarms in the table
LINES = 20  # relations in words
PATIENCE = 1.0  # seconds for the exact certificates of the table


def write_report(
    directory: str | Path,
    res: Any,
    recording: Any,
    alarms: Sequence[Alarm],
    summary: Summary,
    *,
    seconds: dict[str, float] | None = None,
    extra: Sequence[tuple] = (),
    progress: Callable[[float], object] | None = None,
) -> list[str]:
    """Write report.html, margin.png and residuals.png.

    Args:
        directory: an existing folder. res: a Result of one recording, or a Digest. alarms: its alarms.
        recording: with .label(k), .axis and .time, as `read` returns it; for a Digest itself.
        summary: from `summarised`. seconds: {stage: seconds}.
        extra: (title, picture as PNG bytes or None, text, table as rows of cells or None) for sections
            of one's own.
        progress: called with the share of the work done.

    Returns:
        The names of the files written.
    """
    pictures = {}
    for share, (name, data) in zip((0.35, 0.7), _pictures(res, recording, alarms, summary), strict=True):
        pictures[name] = data
        (Path(directory) / name).write_bytes(data)
        if progress:
            progress(share)
    relations, model, part = res.relations, res.relations.model, isinstance(res, Digest)
    dtype = res.data.dtype if part else res.y.dtype
    page = render(
        "detection.html",
        name=model.name,
        verdict=summary.verdict,
        title=TITLE[summary.verdict],
        sentence=summary.sentence,
        recording=recording,
        samples=cast(Evidence, summary.found).samples,
        counts=summary.counts,
        warm_up=relations.horizon,
        decided=summary.decided,
        hints=summary.hints,
        extra=extra,
        pictures=pictures,
        alarms=_alarm_rows(res, recording, alarms),
        alarm_total=summary.alarms,
        most=ROWS,
        sizes=sizes_text(res, summary.sizes),
        part=part,
        method=res.method,
        model=model_values(model, relations.bounds),
        **_relations(relations),
        computed=computed(res.method, relations.horizon, dtype, seconds or {}),
    )
    (Path(directory) / "report.html").write_text(page, encoding="utf-8")
    if progress:
        progress(1.0)
    return ["report.html", *pictures]


def _pictures(res, recording, alarms, summary):
    """Yield (file name, PNG) of the margin and of the residuals, of a Digest around the worst window."""
    if isinstance(res, Digest):
        yield "margin.png", to_png(plot(res))
        res, recording = res.around(summary.worst.sample if summary.worst else 0)
    else:
        yield "margin.png", to_png(plot(res, recording.axis, alarms))
    yield "residuals.png", to_png(plot_residuals(res, recording.axis))


def _alarm_rows(res, recording, alarms):
    """Return the rows of the deepest alarms in order of time."""

    def depth(i):  # NaN where the test measures no margin
        return alarms[i].depth if alarms[i].depth == alarms[i].depth else 0.0

    chosen = sorted(range(len(alarms)), key=depth)[:ROWS]
    why = _certified(res, alarms, chosen)
    rows = []
    for i in sorted(chosen):
        a = alarms[i]
        lasts = float(recording.time[a.end] - recording.time[a.start]) + res.relations.model.dt
        needed = "" if a.depth != a.depth else f"× {factor(1 - a.depth)}"
        begun, ended = recording.label(a.start), recording.label(a.end)
        wrong, violated = why.get(i, ("", ""))
        rows.append((i + 1, begun, ended, duration(lasts), a.windows, needed, wrong, violated, a.ended))
    return rows


def _certified(res, alarms, chosen):
    """Return {i: (errors of single sensors, violated relation)}, of as many alarms as patience allows."""
    stop, why = time.perf_counter() + PATIENCE, {}
    for i in chosen:
        if time.perf_counter() >= stop:
            break
        with contextlib.suppress(NotImplementedError):
            certificate = res.explain(alarms[i].worst)
            why[i] = _sensor_errors(certificate), certificate.relation
    return why


def _sensor_errors(certificate):
    """Return the smallest single-sensor errors as text, the most plausible first, where they are known."""
    errors, unit = certificate.errors, certificate.window.model.unit
    if not errors:
        return ""
    wrong = []
    for name in certificate.candidates:
        size = f"{float(errors[name]):.3g} {unit(name)}".strip() if name in errors else "(actuator)"
        wrong.append(f"{name} {size}")
    return ", ".join(wrong) or "none alone"


def _relations(relations):
    """Return what the page says of them: how many, those that differ, how they are tested."""
    lines, distinct = relations.text().splitlines(), distinct_relations(relations)
    shown = [lines[j] for j in distinct[:LINES]]
    if len(distinct) > LINES:
        shown.append("...")
    return {
        "relations": relations.count,
        "distinct": len(distinct),
        "lines": shown,
        "tested_how": _tested(relations),
    }


def _tested(relations):
    """Say how their combinations are tested."""
    if isinstance(relations, UncertainRelations):
        count = len(relations.variables)
        about = f"they are polynomials of order {relations.order} in {count} uncertain numbers"
        return "; ".join((about, *relations.notes))
    if relations.frame is None:
        return f"{len(relations.circuits)} combinations are tested"
    most = "the combination that speaks most against a window is searched for"
    return f"{most}, there are too many to test one by one"
