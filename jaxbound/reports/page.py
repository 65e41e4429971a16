"""The parts of a page: one self-contained HTML file that a plant engineer can read, mail and print."""

import base64
import platform
import re
import time as clock

import numpy as np

from jaxbound.models.modelfile import number_text
from jaxbound.recordings.plaintext import escape, percent
from jaxbound.sets.floats.status import Status

__all__ = ["CSS", "GUARANTEE", "TITLE", "about", "figure", "frame", "model_tables", "opening", "section", "table", "tiles"]  # fmt: skip

TITLE = {"fault": "Fault proved", "no fault": "No fault found", "too little evidence": "Too little evidence"}
GUARANTEE = (
    "A FAULT is a mathematical proof, floating-point rounding included: as long as the model and its bounds are true, a healthy plant "
    "never raises one. The proof is as good as the bounds it rests on, which are listed above with their origin; a small fault may hide "
    "inside them, so no FAULT does not prove that there is no fault."
)


def section(title, body, rows=None):
    """Return a section of HTML; rows: a table below it, its head first."""
    return f"<section><h2>{escape(title)}</h2>{body}{table(rows[0], rows[1:]) if rows else ''}</section>"


def figure(png, alt, caption):
    """Return a picture in the page itself, with a caption."""
    data = base64.b64encode(png).decode()
    return f'<figure><img alt="{escape(alt)}" src="data:image/png;base64,{data}"><figcaption>{escape(caption)}</figcaption></figure>'


def table(head, rows, kind=""):
    """Return a table of texts."""
    cells = lambda row, tag: "".join(f"<{tag}>{escape(str(c))}</{tag}>" for c in row)
    body = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows)
    return f'<div class="scroll"><table class="{kind}"><thead><tr>{cells(head, "th")}</tr></thead><tbody>{body}</tbody></table></div>'


def tiles(counts, warm_up, meaning, decided):
    """Return a bar and a tile for each verdict.

    Args:
        counts: {status name: number of windows}. warm_up: samples before the first full window. meaning: {Status: sentence}.
        decided: sentence below them.
    """
    total = sum(counts.values())
    order = (Status.FAULT, Status.CONSISTENT, Status.UNDECIDED, Status.MISSING)
    bar = "".join(f'<i class="{x.name}" style="width:{100 * counts[x.name] / total:.4f}%"></i>' for x in order)
    out = []
    for x in order:
        share = f" <small>{percent(counts[x.name] / (total - warm_up))}</small>" if x else ""  # of the full windows, as in the summary
        note = f" (here the first {warm_up})" if x is Status.MISSING and counts[x.name] == warm_up > 0 else ""
        number = f'<b class="{x.name}">{counts[x.name]}</b>'
        out.append(f'<div class="tile">{number}<span>{x.name}{share}</span><p>{meaning[x]}{note}</p></div>')
    return f'<section><div class="bar">{bar}</div><div class="tiles">{"".join(out)}</div><p>{decided}</p></section>'


def opening(model, verdict, sentence, recording, samples, parts, hints):
    """Return the first sections of a report: what was tested, the verdict, `parts`, and sentences to check."""
    plain = sentence.removeprefix(f"{TITLE[verdict]}: ")
    plain = plain[0].upper() + plain[1:]
    first, last = recording.label(0), recording.label(samples - 1)
    out = [
        f'<header><p class="kind">jaxbound report</p><h1>{escape(model.name)}</h1>'
        f"<p>{escape(recording.source or 'recording')}: {samples} samples from {escape(first)} to {escape(last)}</p></header>",
        f'<section class="verdict {verdict.split()[0]}"><h2>{escape(TITLE[verdict])}</h2><p>{escape(plain)}</p></section>',
        *parts,
    ]
    if hints:
        code = lambda text: re.sub("`([^`]*)`", r"<code>\1</code>", text)
        items = "".join(f"<li>{code(escape(h))}</li>" for h in hints)
        out.append(f'<section class="hints"><h2>Please check</h2><ul>{items}</ul></section>')
    return out


def frame(name, verdict, sections):
    """Return the whole page."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<title>{escape(name)}: {escape(verdict)}</title><style>{CSS}</style></head>\n"
        f"<body><main>{chr(10).join(sections)}</main></body></html>\n"
    )


def model_tables(model, bounds):
    """Return equations, signals, disturbances, parameters and matrices of a model as HTML, with bounds {"tolerance", "noise"} (p,)."""
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
    return (
        f"<p>x<sub>k+1</sub> = A x<sub>k</sub> + B u<sub>k</sub>{' + G w<sub>k</sub>' if model.g else ''}"
        f"{' + F v<sub>k</sub>' if model.d else ''}, y<sub>k</sub> = C x<sub>k</sub> + D u<sub>k</sub>"
        f"{' + D<sub>v</sub> v<sub>k</sub>' if model.has_direct_unknown else ''}{', v unknown' if model.d else ''}, "
        f"one sample every {model.dt:g} s; states {escape(', '.join(model.states))}; numbers: {escape(origin('model'))}.</p>"
        + table(head, rows)
        + (table(("input", "column", "unit", "offset"), inputs) if inputs else "")
        + (table(("disturbance", "from", "to", "origin"), disturbances) if disturbances else "")
        + (table(("uncertain parameter", "from", "to", "over a window", "acts on"), parameters) if parameters else "")
        + f'<div class="matrices">{matrices}</div>'
    )


def about(method, horizon, dtype, seconds):
    """Return the table of what a report was computed with."""
    import jax

    from jaxbound import __version__

    device = jax.devices()[0]
    rows = [
        ("method", f"{method}, windows of {horizon + 1} samples"),
        ("versions", f"jaxbound {__version__}, jax {jax.__version__}, numpy {np.__version__}, Python {platform.python_version()}"),
        ("device and numbers", f"{' '.join(dict.fromkeys((device.platform, device.device_kind)))}, {dtype.name}"),
        ("seconds", ", ".join(f"{k} {v:.2f}" for k, v in seconds.items()) or "not measured"),
        ("written", clock.strftime("%Y-%m-%d %H:%M:%S %z")),
    ]
    return table(("", ""), rows, "about")


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
.alarms td:nth-child(8) { font: 12px/1.45 ui-monospace, "DejaVu Sans Mono", monospace }
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
