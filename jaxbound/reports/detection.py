"""The report: one self-contained HTML file that a plant engineer can read, mail and print."""

import contextlib
import time as clock
from pathlib import Path

from jaxbound.plots.canvas import distinct_relations, plot_residuals, plot_result, plot_timeline, to_png
from jaxbound.recordings.plaintext import duration, escape, percent, times
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.reports.page import GUARANTEE, about, figure, frame, model_tables, opening, section, table, tiles
from jaxbound.runs.digest import Digest
from jaxbound.runs.endings import sizes_text
from jaxbound.runs.summary import alarm_total, bound_hints, coverage, samples, summary, worst_window
from jaxbound.sets.floats.status import Status

__all__ = ["write_report"]

ROWS = 200  # alarms in the table
PATIENCE = 1.0  # seconds for the exact certificates of the table
MEANING = {
    Status.FAULT: "proved: no state and no sensor error inside the stated bounds explains the samples of this window",
    Status.CONSISTENT: "proved: the model explains the samples with every error inside its bounds; that is no proof that a fault "
    "before it is repaired",
    Status.UNDECIDED: "not settled by the method that was chosen, or on the boundary within rounding",
    Status.MISSING: "no usable data: the first samples of a recording or after a gap in time, or missing values",
}


def write_report(directory, res, recording, alarms, *, hints=(), seconds=None, min_coverage=0.5, extra=(), sizes=None, progress=None):
    """Write report.html, margin.png and residuals.png.

    Args:
        directory: an existing folder. res: a Result of one recording, or a Digest. alarms: its alarms.
        recording: with .label(k), .axis and .time, as `read_recording` returns it; for a Digest itself.
        hints: sentences for the reader. seconds: {stage: seconds}. min_coverage: as for `summary`.
        extra: (title, picture as PNG bytes or None, text, table as rows of cells or None) for sections of one's own.
        sizes: from `sizes_seen`. progress: called with the share of the work done.

    Returns:
        The names of the files written.
    """
    directory, report = Path(directory), progress or (lambda share: None)
    if isinstance(res, Digest):
        margin, (part, near) = plot_timeline(res.line, res, res.alarm_count), res.around(worst_window(res) or 0)
    else:
        margin, part, near = plot_result(res, recording.axis, alarms), res, recording
    pictures = {"margin.png": to_png(margin)}
    report(0.35)
    pictures["residuals.png"] = to_png(plot_residuals(part, near.axis))
    report(0.7)
    for name, data in pictures.items():
        (directory / name).write_bytes(data)
    page = _page(res, recording, alarms, [*hints, *bound_hints(res.relations.model)], seconds or {}, min_coverage, pictures, extra, sizes)
    (directory / "report.html").write_text(page, encoding="utf-8")
    report(1.0)
    return ["report.html", *pictures]


def _page(res, recording, alarms, hints, seconds, min_coverage, pictures, extra, sizes):
    model, s = res.relations.model, res.relations.horizon
    verdict, sentence = summary(res, alarms, recording.label, min_coverage)
    counted = tiles(res.counts, s, MEANING, f"{percent(coverage(res))} of all full windows are decided by proof.")
    sections = opening(model, verdict, sentence, recording, samples(res), [counted], hints)
    for title, picture, text, rows in extra:
        sections.append(section(title, figure(picture, title, text) if picture else f"<p>{escape(text)}</p>", rows))
    sections += [
        section("Margin", figure(pictures["margin.png"], "margin over time",
            "How far each window is inside (above 0) or outside (below 0) of what the bounds allow. At a margin of -1, all bounds would "
            "have to be twice as wide to explain the samples.")),
        section(f"Alarms ({alarm_total(res, alarms)})", _alarms(res, recording, alarms, sizes)),
        section("Residuals" + ", around the worst window" * isinstance(res, Digest),
                 figure(pictures["residuals.png"], "residuals and their envelopes",
            "Each residual is computed from measurements alone; the blue band is what healthy sensors inside their bounds can make of it. "
            + ("All residuals are tested together, so a window can be FAULT with every residual inside its band."
               if res.method != "box" else "Each residual is tested alone."))),
        section("Model and bounds", _model(res)),
        section("How this was computed",
                 about(res.method, s, (res.data if isinstance(res, Digest) else res.y).dtype, seconds)),
        f'<section class="guarantee"><h2>What is guaranteed</h2><p>{GUARANTEE}</p></section>',
    ]  # fmt: skip
    return frame(model.name, verdict, sections)


def _alarms(res, recording, alarms, sizes):
    if not alarms:
        return "<p>None.</p>"
    depth = [a.depth if a.depth == a.depth else 0.0 for a in alarms]
    chosen = sorted(range(len(alarms)), key=lambda i: depth[i])[:ROWS]
    stop, why = clock.perf_counter() + PATIENCE, {}
    for i in chosen:  # the deepest first, as long as patience lasts
        if clock.perf_counter() < stop:
            with contextlib.suppress(NotImplementedError):
                certificate = res.explain(alarms[i].worst)
                why[i] = _sensor_errors(certificate), certificate.relation
    rows = []
    for i in sorted(chosen):
        a = alarms[i]
        factor = "" if a.depth != a.depth else f"× {times(1 - a.depth).removesuffix(' times')}"
        lasts = duration(float(recording.time[a.end] - recording.time[a.start]) + res.relations.model.dt)
        rows.append((i + 1, recording.label(a.start), recording.label(a.end), lasts, a.windows, factor, *why.get(i, ("", "")), a.ended))
    total = alarm_total(res, alarms)
    note = f"<p>The {ROWS} deepest of {total} alarms; alarms.csv has all of them, and a larger n in --alarm k/n joins neighbours.</p>"
    note = note if total > ROWS else ""
    text = ("<p>Bounds needed: by how much all bounds would have to be widened to explain the worst window of the alarm. One sensor wrong: "
            "the smallest error of that sensor alone that would explain it too, or an actuator that did something else than was recorded; "
            "a signal that is not named cannot explain it, whatever its error. "
            "Violated relation: what those samples contradict most; it must hold for some true values inside the bounds. The whole proof "
            "of a window: <code>jaxbound explain DIR --at TIME</code>, with the folder of this report. "
            f"Ended: {escape(sizes_text(res, sizes))}; the alarm of a smaller one may end when its onset leaves the window, "
            "while the fault lasts.</p>")  # fmt: skip
    return (
        note
        + table(
            ("", "from", "to", "lasts", "FAULT windows", "bounds needed", "one sensor wrong by", "violated relation", "ended"),
            rows,
            "alarms",
        )
        + text
    )


def _sensor_errors(certificate):
    """Return the smallest single-sensor errors as text, the most plausible first; nothing where they are not known."""
    unit = certificate.window.model.unit
    if not certificate.errors:
        return ""
    errors = certificate.errors
    wrong = lambda name: f"{name} {float(errors[name]):.3g} {unit(name)}".strip() if name in errors else f"{name} (actuator)"
    return ", ".join(map(wrong, certificate.candidates)) or "none alone"


def _model(res):
    distinct = distinct_relations(res.relations)
    lines = res.relations.text().splitlines()
    relations = "\n".join(lines[j] for j in distinct[:20])
    relations += "\n..." if len(distinct) > 20 else ""
    copies = f", of which {len(distinct)} differ by more than a shift in time" if len(distinct) < res.relations.count else ""
    return (
        model_tables(res.relations.model, res.relations.bounds)
        + f"<p>{res.relations.count} independent relations over {res.relations.horizon + 1} samples{copies}; "
        f"{_tested(res.relations)}.</p><pre>{escape(relations)}</pre>"
    )


def _tested(relations):
    """Say how their combinations are tested."""
    if isinstance(relations, UncertainRelations):
        about = f"they are polynomials of order {relations.order} in {len(relations.variables)} uncertain numbers"
        return "; ".join((about, *relations.notes))
    if relations.frame is None:
        return f"{len(relations.circuits)} combinations are tested"
    return "the combination that speaks most against a window is searched for, there are too many to test one by one"
