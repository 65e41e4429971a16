"""The page of a validated recording: which sensors were faulty when, and where the samples accepted put the
true values.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jax.typing import ArrayLike

from jaxbound.diagnosis.observed import shown_name
from jaxbound.plots.validation import plot_validation
from jaxbound.recordings.recording import Recording
from jaxbound.relations.sentence import looked_at
from jaxbound.reports.chart import ChartPiece, ChartRow, Charts, band_key, median_step, picture_of, plain
from jaxbound.reports.clock import axis_of, shown_time
from jaxbound.reports.page import render
from jaxbound.reports.parts import computed, model_values
from jaxbound.reports.validated import Validated
from jaxbound.runs.summary import Summary
from jaxbound.sets.floats.status import Status
from jaxbound.text.quantities import duration

ROWS = 200  # stretches in the table
OUTPUTS = 12  # charts
NEAR = 600  # samples around the first faulty one of a long recording, drawn one by one


def write_page(
    file: Path,
    res: Validated,
    recording: Recording,
    summary: Summary,
    seconds: Mapping[str, float] | None = None,
) -> None:
    """Write a page: one file that asks nobody, with its charts. Args: as for `detection.write_report`."""
    model = res.model
    shown = model.outputs[:OUTPUTS]
    drawn = output_charts(res, recording, shown)
    time = shown_time(recording, len(res.y))
    stretches, first = res.stretches(), res.first_fault
    page = render(
        "validation.html",
        name=model.name,
        verdict=summary.verdict,
        sentence=summary.sentence,
        summary=summary,
        tested=summary.found,
        recording=recording,
        shown={status.name: shown_name(status, True) for status in Status},
        stretches=[_row(res, recording, *stretch) for stretch in stretches[:ROWS]],
        stretch_total=len(stretches),
        charts=drawn,
        picture=picture_of(plot_validation(res.found, time, res.y)),
        first_fault="" if first is None else recording.label(first),
        others=model.p - len(shown),
        model=model_values(model, {"tolerance": model.tolerance, "noise": model.noise}),
        computed=computed(res.method, looked_at(res), np.asarray(res.found.state.lo).dtype, seconds or {}),
    )
    file.write_text(page, encoding="utf-8")


def output_charts(res: Validated, recording: Recording, shown: Sequence[str]) -> Charts:
    """Return the charts of the outputs shown: the whole recording, and the samples around the first faulty
    one.
    """
    time, clock = axis_of(recording, len(res.y), res.model.dt)
    piece = ChartPiece(time, res.status, *_extremes(res, len(shown)))
    whole = piece.fitting()
    faulty = np.asarray(res.found.faulty).any(1)
    first = max(min(int(np.argmax(faulty)) - NEAR // 4, len(time) - NEAR), 0)
    close = piece.cut(first, first + NEAR)
    return Charts(
        rows=[ChartRow(f"y{i}", name, res.model.unit(name), "enclosed") for i, name in enumerate(shown)],
        clock=clock,
        samples=len(time),
        last=float(time[-1]),
        step=median_step(time),
        whole=whole,
        near=[plain(close)] if whole.binned else [],
        begin=float(close.x[0]),
        end=float(close.x[-1]),
        about="the first faulty sample" if faulty.any() else "the first samples",
    )


def _extremes(res: Validated, outputs: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return ({key: (T,)}, {key: (T,)}): the least and the most of what is drawn of each output."""
    low: dict[str, np.ndarray] = {}
    high: dict[str, np.ndarray] = {}
    output, corrected, faulty = res.found.output, res.found.corrected, np.asarray(res.found.faulty)
    for i in range(outputs):
        y, lo, hi = res.y[:, i], _finite_end(corrected.lo, i), _finite_end(corrected.hi, i)
        replaced = faulty[:, i] | np.isnan(y)
        lines = {
            f"y{i}": y,
            f"y{i}:faulty": np.where(faulty[:, i], y, np.nan),
            f"y{i}:instead": np.where(replaced, lo / 2 + hi / 2, np.nan),
        }
        low |= lines | {band_key(f"y{i}"): _finite_end(output.lo, i)}
        high |= lines | {band_key(f"y{i}"): _finite_end(output.hi, i)}
    return low, high


def _finite_end(end: ArrayLike, i: int) -> np.ndarray:
    """Return an end of the bands of output i, NaN where it is infinite."""
    values = np.asarray(end)[:, i]
    return np.where(np.isfinite(values), values, np.nan)


def _row(res: Validated, recording: Recording, i: int, first: int, last: int) -> tuple[object, ...]:
    """Return the row of a faulty stretch, with what the sensor showed and should have shown in its middle."""
    name, k = res.model.outputs[i], (first + last) // 2
    unit, corrected = res.model.unit(name), res.found.corrected
    lo, hi = float(np.asarray(corrected.lo)[k, i]), float(np.asarray(corrected.hi)[k, i])
    lasts = float(recording.time[last] - recording.time[first]) + res.model.dt
    showed, true = f"{res.y[k, i]:.5g} {unit}".strip(), f"{lo:.5g} to {hi:.5g} {unit}".strip()
    begun, ended = recording.label(first), recording.label(last)
    return name, begun, ended, duration(lasts), last - first + 1, showed, true
