"""The report: one self-contained HTML file that a plant engineer can read, mail and print."""

import base64
import contextlib
import platform
import re
import time as clock
from html import escape
from pathlib import Path

import numpy as np

from jaxbound.digest import Digest
from jaxbound.modelfile import number_text
from jaxbound.plots import distinct_relations, plot, plot_residuals, plot_timeline, to_png
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.sets.status import Status

__all__ = ["bound_hints", "coverage", "summary", "worst_window", "write_report"]

ROWS = 200  # alarms in the table
PATIENCE = 1.0  # seconds for the exact certificates of the table
MEANING = {
    Status.FAULT: "proved: no state and no sensor error inside the stated bounds explains the samples of this window",
    Status.CONSISTENT: "proved: the model explains the samples with every error inside its bounds",
    Status.UNDECIDED: "not settled by the method that was chosen, or on the boundary within rounding",
    Status.MISSING: "no usable data: the first samples of a recording or after a gap in time, or missing values",
}
TITLE = {"fault": "Fault proved", "no fault": "No fault found", "too little evidence": "Too little evidence"}
GUARANTEE = (
    "A FAULT is a mathematical proof, floating-point rounding included: as long as the model and its bounds are true, a healthy plant "
    "never raises one. The proof is as good as the bounds it rests on, which are listed above with their origin; a small fault may hide "
    "inside them, so no FAULT does not prove that there is no fault."
)


def coverage(res):
    """Return the share of windows, warm-up left out, that are proved one way or the other."""
    counts, windows = res.counts, samples(res) - res.relations.horizon
    return (counts["CONSISTENT"] + counts["FAULT"]) / windows if windows > 0 else 0.0


def samples(res):
    """Return how many samples were tested."""
    return sum(res.counts.values())


def worst(res):
    """Return (index, margin) of the FAULT window with the smallest margin (without FAULT: of any window), (None, NaN) if there is none."""
    if isinstance(res, Digest):
        return res.worst or (None, np.nan)
    fault = res.status == Status.FAULT
    margin = np.where(fault if fault.any() else True, res.margin, np.nan)
    if not np.isnan(margin).all():
        k = int(np.nanargmin(margin))
        return k, float(res.margin[k])
    return (int(np.argmax(fault)) if fault.any() else None), np.nan


def worst_window(res):
    """Return the index of the worst window, or None. See `worst`."""
    return worst(res)[0]


def alarm_total(res, alarms):
    """Return how many alarms there are; a Digest keeps the deepest only."""
    return res.alarm_count if isinstance(res, Digest) else len(alarms)


def summary(res, alarms, label, min_coverage=0.5):
    """Return (verdict, sentence): "fault", "too little evidence" or "no fault", and what a plant engineer should know in a sentence.

    Args:
        res: a Result of one recording, or a Digest. alarms: its alarms. label: index -> text of its time.
        min_coverage: below it, no fault is no news.
    """
    counts, share, (at, margin) = res.counts, coverage(res), worst(res)
    windows, faults, alarm_count = samples(res) - res.relations.horizon, counts["FAULT"], alarm_total(res, alarms)
    decided = counts["CONSISTENT"] + faults
    factor = None if np.isnan(margin) else 1 - margin
    if faults > 1 and faults == decided + counts["UNDECIDED"]:
        by = f": all bounds times about {times(factor).removesuffix(' times')} would make every window consistent" if factor else ""
        return "fault", f"Every one of the {faults} windows with data is FAULT: the model or its bounds do not fit this recording{by}."
    if faults:
        many = f"{faults} of {windows} windows ({percent(faults / windows)}) cannot be explained by any behaviour inside the bounds"
        need = f"; the first is at {label(at)}"
        if factor:
            need = f"; the worst, at {label(at)}, would need bounds {times(factor)} as wide"
        grouped = f", in {alarm_count} alarm{'s' * (alarm_count != 1)}" if alarm_count else ", too scattered for an alarm"
        return "fault", f"Fault proved: {many}{grouped}{need}."
    if share < min_coverage:
        return "too little evidence", (
            f"Too little evidence: only {decided} of {windows} windows ({percent(share)}) could be decided, "
            f"at least {percent(min_coverage)} are asked for."
        )
    used = f"; the tightest, at {label(at)}, uses {percent(factor)} of them" if factor is not None else ""
    every = f"all {windows} windows" if decided == windows else f"{decided} of {windows} windows ({percent(share)})"
    return "no fault", f"No fault found: the model explains {every} within its bounds{used}."


def bound_hints(model):
    """Return sentences on bounds that nobody can mean."""
    bare = [s for s, *b in zip(model.outputs, model.tolerance, model.noise, model.resolution, strict=True) if not any(b)]
    none = f"the model states no tolerance, noise or resolution for {', '.join(bare)}: any measuring error there is a FAULT"
    return [none] if bare else []


def write_report(directory, res, recording, alarms, *, hints=(), seconds=None, min_coverage=0.5, extra=(), progress=None):
    """Write report.html, margin.png and residuals.png.

    Args:
        directory: an existing folder. res: a Result of one recording, or a Digest. alarms: its alarms.
        recording: with .label(k), .axis and .time, as `read_recording` returns it; for a Digest itself.
        hints: sentences for the reader. seconds: {stage: seconds}. min_coverage: as for `summary`.
        extra: (title, picture as PNG bytes or None, text, table as rows of cells or None) for sections of one's own.
        progress: called with the share of the work done.

    Returns:
        The names of the files written.
    """
    directory, report = Path(directory), progress or (lambda share: None)
    if isinstance(res, Digest):
        margin, (part, near) = plot_timeline(res.line, res, res.alarm_count), res.around(worst_window(res) or 0)
    else:
        margin, part, near = plot(res, recording.axis, alarms), res, recording
    pictures = {"margin.png": to_png(margin)}
    report(0.35)
    pictures["residuals.png"] = to_png(plot_residuals(part, near.axis))
    report(0.7)
    for name, data in pictures.items():
        (directory / name).write_bytes(data)
    page = _page(res, recording, alarms, [*hints, *bound_hints(res.relations.model)], seconds or {}, min_coverage, pictures, extra)
    (directory / "report.html").write_text(page, encoding="utf-8")
    report(1.0)
    return ["report.html", *pictures]


def times(factor):
    """Return "2.2 times", with no more digits than matter."""
    if factor >= 1000:
        return f"{factor:,.0f} times" if factor < 1e9 else f"{factor:.2g} times"
    short = f"{factor:.3g}"
    return f"{short if short != '1' else f'{factor:.7g}'} times"  # just above 1 is not 1


def percent(share):
    """Return a share as text that is 0 % or 100 % only where it is exactly that."""
    if share in (0, 1):
        return f"{share:.0%}".replace("%", " %")
    return "<0.1 %" if share < 0.001 else ">99.9 %" if 0.999 < share < 1 else f"{100 * share:.3g} %"


def duration(seconds):
    """Return a time span in units that read well."""
    for unit, size, limit in (("d", 86400, 172800), ("h", 3600, 7200), ("min", 60, 120)):
        if seconds >= limit:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.3g} s"


def _page(res, recording, alarms, hints, seconds, min_coverage, pictures, extra):
    model = res.relations.model
    verdict, sentence = summary(res, alarms, recording.label, min_coverage)
    plain = sentence.removeprefix(f"{TITLE[verdict]}: ")
    plain = plain[0].upper() + plain[1:]
    first, last = recording.label(0), recording.label(samples(res) - 1)
    sections = [
        f'<header><p class="kind">jaxbound report</p><h1>{escape(model.name)}</h1>'
        f"<p>{escape(recording.source or 'recording')}: {samples(res)} samples from {escape(first)} to {escape(last)}</p></header>",
        f'<section class="verdict {verdict.split()[0]}"><h2>{escape(TITLE[verdict])}</h2><p>{escape(plain)}</p></section>',
        _counts(res),
    ]
    if hints:
        code = lambda text: re.sub("`([^`]*)`", r"<code>\1</code>", text)
        items = "".join(f"<li>{code(escape(h))}</li>" for h in hints)
        sections.append(f'<section class="hints"><h2>Please check</h2><ul>{items}</ul></section>')
    for title, picture, text, rows in extra:
        sections.append(_section(title, _figure(picture, title, text) if picture else f"<p>{escape(text)}</p>", rows))
    sections += [
        _section("Margin", _figure(pictures["margin.png"], "margin over time",
            "How far each window is inside (above 0) or outside (below 0) of what the bounds allow. At a margin of -1, all bounds would "
            "have to be twice as wide to explain the samples.")),
        _section(f"Alarms ({alarm_total(res, alarms)})", _alarms(res, recording, alarms)),
        _section("Residuals" + ", around the worst window" * isinstance(res, Digest),
                 _figure(pictures["residuals.png"], "residuals and their envelopes",
            "Each residual is computed from measurements alone; the blue band is what healthy sensors inside their bounds can make of it. "
            + ("All residuals are tested together, so a window can be FAULT with every residual inside its band."
               if res.method != "box" else "Each residual is tested alone."))),
        _section("Model and bounds", _model(res)),
        _section("How this was computed", _about(res, seconds)),
        f'<section class="guarantee"><h2>What is guaranteed</h2><p>{GUARANTEE}</p></section>',
    ]  # fmt: skip
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<title>{escape(model.name)}: {escape(verdict)}</title><style>{CSS}</style></head>\n"
        f"<body><main>{chr(10).join(sections)}</main></body></html>\n"
    )


def _section(title, body, rows=None):
    return f"<section><h2>{escape(title)}</h2>{body}{_table(rows[0], rows[1:]) if rows else ''}</section>"


def _figure(png, alt, caption):
    data = base64.b64encode(png).decode()
    return f'<figure><img alt="{escape(alt)}" src="data:image/png;base64,{data}"><figcaption>{escape(caption)}</figcaption></figure>'


def _table(head, rows, kind=""):
    cells = lambda row, tag: "".join(f"<{tag}>{escape(str(c))}</{tag}>" for c in row)
    body = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows)
    return f'<div class="scroll"><table class="{kind}"><thead><tr>{cells(head, "th")}</tr></thead><tbody>{body}</tbody></table></div>'


def _counts(res):
    counts, total, s = res.counts, samples(res), res.relations.horizon
    order = (Status.FAULT, Status.CONSISTENT, Status.UNDECIDED, Status.MISSING)
    bar = "".join(f'<i class="{x.name}" style="width:{100 * counts[x.name] / total:.4f}%"></i>' for x in order)
    tiles = []
    for x in order:
        share = f" <small>{percent(counts[x.name] / (total - s))}</small>" if x else ""  # of the full windows, as in the summary
        note = f" (here the first {s})" if x is Status.MISSING and counts[x.name] == s > 0 else ""
        number = f'<b class="{x.name}">{counts[x.name]}</b>'
        tiles.append(f'<div class="tile">{number}<span>{x.name}{share}</span><p>{MEANING[x]}{note}</p></div>')
    decided = f"<p>{percent(coverage(res))} of all full windows are decided by proof.</p>"
    return f'<section><div class="bar">{bar}</div><div class="tiles">{"".join(tiles)}</div>{decided}</section>'


def _alarms(res, recording, alarms):
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
        rows.append((i + 1, recording.label(a.start), recording.label(a.end), lasts, a.windows, factor, *why.get(i, ("", ""))))
    total = alarm_total(res, alarms)
    note = f"<p>The {ROWS} deepest of {total} alarms; alarms.csv has all of them, and a larger n in --alarm k/n joins neighbours.</p>"
    note = note if total > ROWS else ""
    text = ("<p>Bounds needed: by how much all bounds would have to be widened to explain the worst window of the alarm. One sensor wrong: "
            "the smallest error of that sensor alone that would explain it too, or an actuator that did something else than was recorded; "
            "a signal that is not named cannot explain it, whatever its error. "
            "Violated relation: what those samples contradict most; it must hold for some true values inside the bounds. The whole proof "
            "of a window: <code>jaxbound explain DIR --at TIME</code>, with the folder of this report.</p>")  # fmt: skip
    return (
        note
        + _table(("", "from", "to", "lasts", "FAULT windows", "bounds needed", "one sensor wrong by", "violated relation"), rows, "alarms")
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
    model, bounds = res.relations.model, res.relations.bounds
    origin = lambda field: model.provenance.get(field, "origin not stated")
    text = lambda x: number_text(x) if len(number_text(x)) <= 12 else f"{float(x):.6g}"
    head = ("output", "column", "unit", "offset", *(f"{b} ({origin(b)})" for b in ("tolerance", "noise", "resolution")))
    rows = [
        (name, model.column(name), model.unit(name), text(model.offset["y"][i]), f"{percent(float(bounds['tolerance'][i]))} of the value",
         f"± {float(bounds['noise'][i]):.6g}", f"± {text(model.resolution[i])}")
        for i, name in enumerate(model.outputs)
    ]  # fmt: skip
    inputs = [(name, model.column(name), model.unit(name), text(model.offset["u"][i])) for i, name in enumerate(model.inputs)]
    row = lambda numbers: f"<tr>{''.join(f'<td>{text(x)}</td>' for x in numbers)}</tr>"
    disturbances = [
        (f"w{j + 1}", f"{float(lo):g}", f"{float(hi):g}", origin("disturbance")) for j, (lo, hi) in enumerate(model.disturbance)
    ]
    matrices = "".join(
        f'<div class="matrix"><span>{letter} =</span><table>{"".join(map(row, a))}</table></div>'
        for letter, a in (("A", model.A), ("B", model.B), ("C", model.C), ("D", model.D), ("G", model.G), ("F", model.F),
                          ("D<sub>v</sub>", model.D_v))
        if a[0] and (letter[0] != "D" or any(map(any, a)))
    )  # fmt: skip
    acts = lambda u: ", ".join(letter for letter in "ABCD" if getattr(u, letter))
    parameters = [(u.name, *(f"{float(b):.6g}" for b in u.between), "varies" if u.varying else "is constant", acts(u))
                  for u in model.uncertainties]  # fmt: skip
    distinct = distinct_relations(res.relations)
    lines = res.relations.text().splitlines()
    relations = "\n".join(lines[j] for j in distinct[:20])
    relations += "\n..." if len(distinct) > 20 else ""
    copies = f", of which {len(distinct)} differ by more than a shift in time" if len(distinct) < res.relations.count else ""
    return (
        f"<p>x<sub>k+1</sub> = A x<sub>k</sub> + B u<sub>k</sub>{' + G w<sub>k</sub>' if model.g else ''}"
        f"{' + F v<sub>k</sub>' if model.d else ''}, y<sub>k</sub> = C x<sub>k</sub> + D u<sub>k</sub>"
        f"{' + D<sub>v</sub> v<sub>k</sub>' if model.has_direct_unknown else ''}{', v unknown' if model.d else ''}, "
        f"one sample every {model.dt:g} s; states {escape(', '.join(model.states))}; numbers: {escape(origin('model'))}.</p>"
        + _table(head, rows)
        + (_table(("input", "column", "unit", "offset"), inputs) if inputs else "")
        + (_table(("disturbance", "from", "to", "origin"), disturbances) if disturbances else "")
        + (_table(("uncertain parameter", "from", "to", "over a window", "acts on"), parameters) if parameters else "")
        + f'<div class="matrices">{matrices}</div>'
        f"<p>{res.relations.count} independent relations over {res.relations.horizon + 1} samples{copies}; "
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


def _about(res, seconds):
    import jax

    from jaxbound import __version__

    device, dtype = jax.devices()[0], (res.data if isinstance(res, Digest) else res.y).dtype
    rows = [
        ("method", f"{res.method}, windows of {res.relations.horizon + 1} samples"),
        ("versions", f"jaxbound {__version__}, jax {jax.__version__}, numpy {np.__version__}, Python {platform.python_version()}"),
        ("device and numbers", f"{' '.join(dict.fromkeys((device.platform, device.device_kind)))}, {dtype.name}"),
        ("seconds", ", ".join(f"{k} {v:.2f}" for k, v in seconds.items()) or "not measured"),
        ("written", clock.strftime("%Y-%m-%d %H:%M:%S %z")),
    ]
    return _table(("", ""), rows, "about")


CSS = """
:root { --ink: #1b2733; --soft: #5b6672; --page: #fff; --card: #f5f7f9; --line: #dde2e7; --accent: #16324f;
  --fault: #c04f00; --ok: #00795a; --open: #9a6b00; --none: #7b838c }
@media (prefers-color-scheme: dark) { :root { --ink: #e6eaee; --soft: #a3adb8; --page: #14181d; --card: #1e242b; --line: #343c45;
  --accent: #a9d0f5; --fault: #ff9655; --ok: #3fd0a4; --open: #f0b93a; --none: #9aa3ad } }
* { box-sizing: border-box }
body { margin: 0; background: var(--page); color: var(--ink); font: 15px/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif }
main { max-width: 1100px; margin: 0 auto; padding: 28px 24px 60px }
h1 { margin: 0; font-size: 30px; color: var(--accent); overflow-wrap: anywhere }
h2 { font-size: 18px; margin: 34px 0 8px; color: var(--accent) }
header p { margin: 2px 0; color: var(--soft); overflow-wrap: anywhere }
.kind { text-transform: uppercase; letter-spacing: .08em; font-size: 12px }
.verdict { margin-top: 20px; padding: 14px 20px; border-radius: 8px; background: var(--card); border-left: 7px solid var(--ok) }
.verdict h2 { margin: 0; font-size: 21px; color: var(--ok) }
.verdict p { margin: 4px 0 0; font-size: 17px }
.verdict.fault { border-color: var(--fault) } .verdict.fault h2 { color: var(--fault) }
.verdict.too { border-color: var(--open) } .verdict.too h2 { color: var(--open) }
.bar { display: flex; height: 14px; margin-top: 20px; border-radius: 7px; overflow: hidden; background: var(--line) }
.bar i { display: block; print-color-adjust: exact; -webkit-print-color-adjust: exact }
i.FAULT { background: #d55e00 } i.CONSISTENT { background: #009e73 } i.UNDECIDED { background: #e69f00 } i.MISSING { background: #c9ccd1 }
b.FAULT { color: var(--fault) } b.CONSISTENT { color: var(--ok) } b.UNDECIDED { color: var(--open) } b.MISSING { color: var(--none) }
.tiles { display: grid; grid-template-columns: repeat(4, 1fr); gap: 12px; margin: 14px 0 6px }
.tile { background: var(--card); border-radius: 8px; padding: 10px 14px }
.tile b { font-size: 24px; display: block; line-height: 1.2 }
.tile p { margin: 4px 0 0; font-size: 12.5px; color: var(--soft); line-height: 1.4 }
.tile small { color: var(--soft) }
.hints { border: 1px solid var(--line); border-left: 7px solid var(--open); border-radius: 8px; padding: 10px 20px; margin-top: 22px }
.hints h2 { margin: 0; font-size: 16px; color: var(--open) } .hints ul { margin: 4px 0; padding-left: 18px }
figure { margin: 8px 0 }
figure img { width: 100%; background: #fff; border: 1px solid var(--line); border-radius: 8px; display: block }
figcaption { color: var(--soft); font-size: 13.5px; margin-top: 6px }
.scroll { overflow-x: auto }
table { border-collapse: collapse; margin: 8px 0; font-size: 13.5px; font-variant-numeric: tabular-nums }
th { text-align: left; color: var(--soft); font-weight: 600 }
th, td { padding: 4px 18px 4px 0; border-bottom: 1px solid var(--line); vertical-align: top }
.alarms { width: 100% } .alarms td:nth-child(-n+7) { white-space: nowrap }
.alarms td:last-child { font: 12px/1.45 ui-monospace, "DejaVu Sans Mono", monospace }
.about td:first-child { color: var(--soft); white-space: nowrap } .about thead { display: none }
.matrices { display: flex; flex-wrap: wrap; gap: 10px 34px; margin: 12px 0 }
.matrix { display: flex; align-items: center; gap: 8px }
.matrix table { border-left: 2px solid var(--ink); border-right: 2px solid var(--ink); border-radius: 6px; margin: 0 }
.matrix td { border: 0; padding: 1px 9px; text-align: right }
pre { background: var(--card); padding: 12px 14px; border-radius: 8px; white-space: pre-wrap;
  font: 12.5px/1.6 ui-monospace, "DejaVu Sans Mono", monospace }
.guarantee { background: var(--card); border-radius: 8px; padding: 6px 20px 10px; margin-top: 34px } .guarantee h2 { margin-top: 10px }
@media (max-width: 760px) { .tiles { grid-template-columns: repeat(2, 1fr) } }
@media print { main { max-width: none; padding: 0 } .tile, figure, tr, pre { break-inside: avoid } h2 { break-after: avoid }
  .scroll { overflow: visible } body { font-size: 11pt } }
"""
