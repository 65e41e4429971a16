"""The page of a validated recording: which sensors were faulty when, and the band that holds the true value of each output."""

from pathlib import Path

import numpy as np

from jaxbound.plots.bands import plot_output
from jaxbound.plots.canvas import PANELS, to_png
from jaxbound.recordings.plaintext import duration, percent
from jaxbound.reports.page import about, figure, frame, model_tables, opening, section, table, tiles
from jaxbound.sets.floats.status import Status

__all__ = ["write_page"]

ROWS = 200  # stretches in the table
MEANING = {
    Status.FAULT: "proved: the samples of this window contradict the model, given what was accepted before",
    Status.CONSISTENT: "proved: the model explains the samples with every error inside its bounds",
    Status.UNDECIDED: "nothing contradicts the model; a fault too small to be proved may be there",
    Status.MISSING: "no usable data: the first samples of a recording, or missing values",
}
PROMISE = (
    "As long as the model and its bounds are true and the first window is free of faults, a healthy plant never raises a FAULT, and the "
    "bands hold the true values, floating-point rounding included, if every faulty sample was found. A fault too small to be proved is "
    "accepted as healthy and may push a band past the truth: nobody can promise more. A corrected value is the middle of its interval: "
    "the interval is the guarantee, the middle is convenience."
)


def write_page(directory, res, recording, alarms, *, hints=(), seconds=None, min_coverage=0.5, progress=None):
    """Write report.html and a picture for each output. Args: as for `report.write_report`.

    Returns:
        The names of the files written.
    """
    directory, model, report = Path(directory), res.model, progress or (lambda share: None)
    shown = model.outputs[:PANELS]
    pictures = {}
    for i in range(len(shown)):
        pictures[f"output{i + 1}.png"] = to_png(plot_output(res, i, recording.axis))
        report((i + 1) / (len(shown) + 1))
    for name, data in pictures.items():
        (directory / name).write_bytes(data)
    verdict, sentence = res.summary(alarms, recording.label, min_coverage)
    counted = tiles(res.counts, res.horizon, MEANING, f"{percent(res.tested)} of all full windows have data.")
    caption = (
        "Blue: where the true value of {0} is, by the model, the samples accepted before and this one. Orange: samples that are proved to "
        "be faulty, and where; the dark line is what is to be used in their place, the middle of the band."
    )
    sections = opening(model, verdict, sentence, recording, len(res.y), [counted], hints)
    sections.append(section("Faulty sensors", _faulty(res, recording)))
    sections += [
        section(f"Output {name}", figure(png, f"band of {name}", caption.format(name)))
        for name, png in zip(shown, pictures.values(), strict=True)
    ]
    if len(shown) < model.p:
        sections.append(section("Other outputs", f"<p>{model.p - len(shown)} more outputs are in verdicts.csv.</p>"))
    sections += [
        section("Model and bounds", model_tables(model, {"tolerance": model.tolerance, "noise": model.noise})),
        section("How this was computed", about(res.method, res.horizon, np.asarray(res.found.state.lo).dtype, seconds or {})),
        f'<section class="guarantee"><h2>What is guaranteed</h2><p>{PROMISE}</p></section>',
    ]
    (directory / "report.html").write_text(frame(model.name, verdict, sections), encoding="utf-8")
    report(1.0)
    return ["report.html", *pictures]


def _faulty(res, recording):
    """Return the table of faulty stretches with what each sensor showed and should have shown in the middle of it."""
    found = res.stretches()
    if not found:
        return "<p>None.</p>" if not res.counts["FAULT"] else "<p>No single sensor explains the windows that are FAULT.</p>"
    rows = []
    for i, first, last in found[:ROWS]:
        k, unit = (first + last) // 2, res.model.unit(res.model.outputs[i])
        lo, hi = (float(np.asarray(end)[k, i]) for end in (res.found.corrected.lo, res.found.corrected.hi))
        lasts = duration(float(recording.time[last] - recording.time[first]) + res.model.dt)
        rows.append((res.model.outputs[i], recording.label(first), recording.label(last), lasts, last - first + 1,
                     f"{res.y[k, i]:.5g} {unit}".strip(), f"{lo:.5g} to {hi:.5g} {unit}".strip()))  # fmt: skip
    note = f"<p>The first {ROWS} of {len(found)} stretches.</p>" if len(found) > ROWS else ""
    text = "<p>Shown and true: in the middle of the stretch. All samples are in <code>verdicts.csv</code>.</p>"
    return note + table(("sensor", "from", "to", "lasts", "samples", "shown", "true value within"), rows, "stretches") + text
