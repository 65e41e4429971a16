"""The page of a fleet: one self-contained HTML file with a row a unit, the worst first."""

import math
import shlex
import time as clock

from jaxbound.recordings.plaintext import escape, percent, times
from jaxbound.reports.page import CSS, GUARANTEE

__all__ = ["fleet_page"]

TITLE = {"fault": "Fault proved", "not tested": "Not all units could be tested", "too little evidence": "Too little evidence",
         "no fault": "No fault found"}  # fmt: skip
CLASS = {"fault": "FAULT", "not tested": "untested", "too little evidence": "UNDECIDED", "no fault": "CONSISTENT"}
TILES = {
    "fault": "no behaviour inside the bounds explains at least one window",
    "not tested": "a file is missing or wrong: the row says what",
    "too little evidence": "too few windows could be decided",
    "no fault": "the model explains every decided window within its bounds",
}


def fleet_page(ordered, verdict, title):
    """Return the HTML text.

    Args:
        ordered: UnitResults, the worst first. verdict: (verdict, exit code, sentence) of the fleet. title: of the page.
    """
    kind, _, sentence = verdict
    tiles = "".join(
        f'<div class="tile"><b class="{CLASS[v]}">{sum(r.verdict == v for r in ordered)}</b><span>{v}</span><p>{text}</p></div>'
        for v, text in TILES.items()
    )
    first = next((r for r in ordered if r.verdict != "not tested"), None)
    more = ""
    if first:
        command = shlex.join(["jaxbound", "detect", str(first.unit.model), str(first.unit.recording), "--out", f"report-{first.unit.name}"])
        more = f"<p>The full report of a unit, with its alarms and pictures, for example:</p><pre>{escape(command)}</pre>"
    head = "".join(f"<th>{x}</th>" for x in ("unit", "verdict", "bounds needed", "windows", "alarms", "first alarm", "what was found"))
    rows = "\n".join(map(_row, ordered))
    guarantee = GUARANTEE.replace(", which are listed above with their origin", "")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<title>{escape(title)}: {escape(kind)}</title><style>{CSS}{OWN}</style></head>\n<body><main>"
        f'<header><p class="kind">jaxbound fleet</p><h1>{escape(title)}</h1><p>{clock.strftime("%Y-%m-%d %H:%M:%S %z")}</p></header>'
        f'<section class="verdict {kind.split()[0]}"><h2>{TITLE[kind]}</h2><p>{escape(sentence)}</p></section>'
        f'<section><div class="tiles">{tiles}</div></section>'
        f'<section><h2>Units, the worst first</h2><div class="scroll"><table class="units"><thead><tr>{head}</tr></thead>'
        f"<tbody>\n{rows}\n</tbody></table></div>"
        "<p>Bounds needed: the factor on all bounds at which the worst window of the unit just becomes explicable; above 1 is a fault. "
        "fleet.csv has the same rows with all numbers.</p>"
        f"{more}</section>"
        f'<section class="guarantee"><h2>What is guaranteed</h2><p>{guarantee}</p></section></main></body></html>\n'
    )


def _row(r):
    factor = "" if math.isnan(r.margin) else times(1 - r.margin).removesuffix(" times")
    total = sum(r.counts)
    bar = ""
    if total:
        missing, consistent, undecided, fault = r.counts
        parts = (("FAULT", fault), ("CONSISTENT", consistent), ("UNDECIDED", undecided), ("MISSING", missing))
        shares = "".join(f'<i class="{name}" style="width:{100 * n / total:.3f}%"></i>' for name, n in parts if n)
        bar = f'<div class="bar">{shares}</div><small>{total} samples, {fault} FAULT, {percent(r.decided)} decided</small>'
    plain = r.sentence.removeprefix(f"{TITLE[r.verdict]}: ")
    hints = ""
    if r.hints:
        items = "".join(f"<li>{escape(h)}</li>" for h in r.hints)
        hints = f"<details><summary>{len(r.hints)} hint{'s' * (len(r.hints) > 1)}</summary><ul>{items}</ul></details>"
    plain += f" The last alarm: {r.ended}." if r.ended else ""
    cells = (
        f"<b>{escape(r.unit.name)}</b>", f'<b class="{CLASS[r.verdict]}">{r.verdict}</b>', factor and f"× {factor}", bar,
        r.alarms or "", escape(r.first_alarm), escape(plain[:1].upper() + plain[1:]) + hints)  # fmt: skip
    return f"<tr>{''.join(f'<td>{c}</td>' for c in cells)}</tr>"


OWN = """
.verdict.not { border-color: var(--none) } .verdict.not h2, b.untested { color: var(--none) }
.units { width: 100% } .units td { padding-right: 14px } .units td:nth-child(-n+3), .units td:nth-child(6) { white-space: nowrap }
.units .bar { width: 150px; height: 9px; margin: 5px 0 1px } .units small { color: var(--soft) }
.units td:last-child { min-width: 240px; overflow-wrap: anywhere } details { color: var(--soft); font-size: 12.5px }
details ul { margin: 2px 0; padding-left: 18px }
"""
