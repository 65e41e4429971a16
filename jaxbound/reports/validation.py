"""The page of a validated recording: which sensors were faulty when, and what the true values were."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np

from jaxbound.plots.canvas import PANELS, to_png
from jaxbound.plots.validation import plot_output
from jaxbound.recordings.plaintext import duration
from jaxbound.reports.clock import clock_of
from jaxbound.reports.page import TITLE, render
from jaxbound.reports.parts import computed, model_values
from jaxbound.runs.summary import Evidence, Summary

__all__ = ["write_page"]

ROWS = 200  # stretches in the table


def write_page(
    directory: str | Path,
    res: Any,
    recording: Any,
    summary: Summary,
    *,
    seconds: dict[str, float] | None = None,
    progress: Callable[[float], object] | None = None,
) -> list[str]:
    """Write report.html and a picture for each output. Args: as for `detection.write_report`.

    Returns:
        The names of the files written.
    """
    model, pictures = res.model, {}
    shown = model.outputs[:PANELS]
    for i in range(len(shown)):
        name = f"output{i + 1}.png"
        pictures[name] = to_png(_as_written(plot_output(res, i, recording.axis), recording))
        (Path(directory) / name).write_bytes(pictures[name])
        if progress:
            progress((i + 1) / (len(shown) + 1))
    stretches = res.stretches()
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
        outputs=zip(shown, pictures.values(), strict=True),
        others=model.p - len(shown),
        model=model_values(model, {"tolerance": model.tolerance, "noise": model.noise}),
        computed=computed(res.method, res.horizon, np.asarray(res.found.state.lo).dtype, seconds or {}),
    )
    (Path(directory) / "report.html").write_text(page, encoding="utf-8")
    if progress:
        progress(1.0)
    return ["report.html", *pictures]


def _as_written(fig, recording):
    """Write dates on the axes of a Figure as the recording does; return it."""
    stamps = getattr(recording, "stamps", None)
    if stamps is None:
        return fig
    from matplotlib.ticker import FuncFormatter

    step = float(np.median(np.diff(recording.time))) if len(recording.time) > 1 else 1.0
    clock = clock_of(recording.label, recording.time, stamps[0], len(stamps), step)
    first = float(stamps[0].astype("datetime64[ns]").astype(np.int64)) / 1e9 - float(recording.time[0])
    for ax in fig.axes:
        ax.xaxis.get_major_locator().maxticks.update(dict.fromkeys(ax.xaxis.get_major_locator().maxticks, 8))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda day, at: clock.text(86400 * day - first).replace(" ", "\n", 1)))
    return fig


def _row(res, recording, i, first, last):
    """Return the row of a faulty stretch, with what the sensor showed and should have shown in its middle."""
    name, k = res.model.outputs[i], (first + last) // 2
    unit, corrected = res.model.unit(name), res.found.corrected
    lo, hi = float(np.asarray(corrected.lo)[k, i]), float(np.asarray(corrected.hi)[k, i])
    lasts = float(recording.time[last] - recording.time[first]) + res.model.dt
    showed, true = f"{res.y[k, i]:.5g} {unit}".strip(), f"{lo:.5g} to {hi:.5g} {unit}".strip()
    begun, ended = recording.label(first), recording.label(last)
    return name, begun, ended, duration(lasts), last - first + 1, showed, true
