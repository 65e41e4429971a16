"""The page of a validated recording: which sensors were faulty when, and where the samples accepted put the
true values.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np

from jaxbound.relations.sentence import looked_at
from jaxbound.reports.chart import POINTS, Piece, Row, drawn
from jaxbound.reports.clock import axis_of
from jaxbound.reports.page import TITLE, render
from jaxbound.reports.parts import computed, model_values
from jaxbound.runs.summary import Evidence, Summary
from jaxbound.text.quantities import duration

__all__ = ["write_page"]

ROWS = 200  # stretches in the table
OUTPUTS = 12  # charts
NEAR = 600  # samples around the first faulty one of a long recording, drawn one by one


def write_page(
    directory: str | Path,
    res: Any,
    recording: Any,
    summary: Summary,
    *,
    seconds: dict[str, float] | None = None,
    progress: Callable[[float], object] | None = None,
) -> list[str]:
    """Write report.html: one file that asks nobody, with its charts. Args: as for `detection.write_report`.

    Returns:
        The names of the files written.
    """
    model = res.model
    shown = model.outputs[:OUTPUTS]
    drawings = list(_charts(res, recording, shown))
    if progress:
        progress(0.5)
    stretches, first = res.stretches(), res.first_fault
    page = render(
        "validation.html",
        name=model.name,
        verdict=summary.verdict,
        title=TITLE[summary.verdict],
        sentence=summary.sentence,
        recording=recording,
        samples=len(res.y),
        counts=summary.counts,
        warm_up=res.horizon,
        share=cast(Evidence, summary.found).tested,
        hints=summary.hints,
        stretches=[_row(res, recording, *stretch) for stretch in stretches[:ROWS]],
        stretch_total=len(stretches),
        charts=drawings,
        first_fault="" if first is None else recording.label(first),
        others=model.p - len(shown),
        model=model_values(model, {"tolerance": model.tolerance, "noise": model.noise}),
        computed=computed(res.method, looked_at(res), np.asarray(res.found.state.lo).dtype, seconds or {}),
    )
    (Path(directory) / "report.html").write_text(page, encoding="utf-8")
    if progress:
        progress(1.0)
    return ["report.html"]


def _charts(res, recording, shown):
    """Yield (title, chart) of the whole recording, and of the samples around the first faulty one if it is
    long.
    """
    found, (time, clock) = res.found, axis_of(recording, len(res.y), res.model.dt)
    faulty = np.asarray(found.faulty)
    low: dict[str, np.ndarray] = {}
    high: dict[str, np.ndarray] = {}
    finite = lambda end, i: np.where(np.isfinite(end := np.asarray(end)[:, i]), end, np.nan)
    for i in range(len(shown)):
        y, lo, hi = res.y[:, i], finite(found.corrected.lo, i), finite(found.corrected.hi, i)
        centre = np.where(faulty[:, i] | np.isnan(y), lo / 2 + hi / 2, np.nan)
        lines = {f"y{i}": y, f"y{i}:faulty": np.where(faulty[:, i], y, np.nan), f"y{i}:instead": centre}
        low |= lines | {f"y{i}:band": finite(found.output.lo, i)}
        high |= lines | {f"y{i}:band": finite(found.output.hi, i)}
    rows = [Row(f"y{i}", name, res.model.unit(name), "enclosed") for i, name in enumerate(shown)]
    whole = Piece(time, res.status, low, high)
    yield "The whole recording", drawn(rows, whole, clock)
    if len(time) > POINTS:
        first = max(min(int(np.argmax(faulty.any(1))) - NEAR // 4, len(time) - NEAR), 0)
        title = "The samples around the first faulty one" if faulty.any() else "The first samples"
        yield title, drawn(rows, whole.cut(first, first + NEAR), clock)


def _row(res, recording, i, first, last):
    """Return the row of a faulty stretch, with what the sensor showed and should have shown in its middle."""
    name, k = res.model.outputs[i], (first + last) // 2
    unit, corrected = res.model.unit(name), res.found.corrected
    lo, hi = float(np.asarray(corrected.lo)[k, i]), float(np.asarray(corrected.hi)[k, i])
    lasts = float(recording.time[last] - recording.time[first]) + res.model.dt
    showed, true = f"{res.y[k, i]:.5g} {unit}".strip(), f"{lo:.5g} to {hi:.5g} {unit}".strip()
    begun, ended = recording.label(first), recording.label(last)
    return name, begun, ended, duration(lasts), last - first + 1, showed, true
