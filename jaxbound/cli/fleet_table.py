"""The results of a fleet: a table and a page with the worst unit first, and pages of faulty units."""

import csv
import json
import math
import re
from collections.abc import Sequence
from pathlib import Path

from jaxbound.cli.terminal import show, write
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.result import Result
from jaxbound.recordings.recording import Recording
from jaxbound.reports.detection import write_report
from jaxbound.reports.fleet import fleet_page
from jaxbound.runs.fleet import Unit, UnitResult, fleet_verdict, worst_first
from jaxbound.runs.summary import LAYOUT, OUTSIDE, Summary
from jaxbound.text.characters import cell
from jaxbound.text.quantities import percent

__all__ = ["PAGES", "SHOWING", "UNITS", "UnitPages", "conclude_fleet", "write_fleet"]

UNITS = "units"  # the folder of their pages
SHOWING = ("fault", OUTSIDE)
COLOUR = {
    "fault": "bold red",
    "not tested": "bold magenta",
    OUTSIDE: "bold yellow",
    "too little evidence": "bold yellow",
    "no fault": "bold green",
}
PAGES = 100  # faulty units that get a page of their own
SHOWN = 10  # units in the table on the terminal
FIELDS = (
    "unit",
    "verdict",
    "margin",
    "factor",
    "FAULT",
    "CONSISTENT",
    "UNDECIDED",
    "MISSING",
    "decided",
    "alarms",
    "first_alarm",
    "worst",
    "sentence",
    "hints",
    "model",
    "recording",
    "ended",
)


def write_fleet(directory: str | Path, results: Sequence[UnitResult], title: str = "fleet") -> None:
    """Write fleet.csv, a row a unit, and fleet.html, both with the worst unit first.

    Args:
        directory: an existing folder. results: UnitResults in any order. title: for the page.
    """
    ordered = worst_first(results)
    number = lambda x: "" if math.isnan(x) else repr(float(x))
    with open(
        Path(directory) / "fleet.csv", "w", newline="", encoding="utf-8", errors="backslashreplace"
    ) as f:
        table = csv.writer(f, lineterminator="\n")
        table.writerow(FIELDS)
        for r in ordered:
            found = r.summary
            texts = (
                found.first_alarm,
                found.worst.time if found.worst else "",
                found.sentence,
                " | ".join(found.hints),
            )
            files = str(r.unit.model), str(r.unit.recording)
            counts = (found.counts[name] for name in FIELDS[4:8])
            table.writerow(
                (
                    cell(r.unit.name),
                    r.verdict,
                    number(r.margin),
                    number(1 - r.margin),
                    *counts,
                    number(found.decided),
                    found.alarms,
                    *map(cell, (*texts, *files)),
                    found.last_ended,
                )
            )
    (Path(directory) / "fleet.html").write_text(
        fleet_page(ordered, fleet_verdict(results), title), encoding="utf-8"
    )


class UnitPages:
    """Writes the pages of units with a fault, as many as have room, into a folder; a call returns the name of
    a page.

    Args:
        work: the folder of the run, in which they get one of their own.
    """

    def __init__(self, work: Path) -> None:
        self.work = work
        self.numbers: dict[str, int] = {}

    def number(self, units: Sequence[Unit]) -> None:
        """Give units their numbers, and no others, before several processes write their pages."""
        (self.work / UNITS).mkdir(exist_ok=True)
        self.numbers = {unit.name: i for i, unit in enumerate(units, 1)}

    def __call__(
        self, unit: Unit, res: Result, recording: Recording, alarms: Sequence[Alarm], summary: Summary
    ) -> str:
        """Write the page of a unit; return its name in the folder of the run, "" without one."""
        is_full = len(self.numbers) == PAGES and unit.name not in self.numbers
        if summary.verdict not in SHOWING or is_full:
            return ""
        number = self.numbers.setdefault(unit.name, len(self.numbers) + 1)
        (self.work / UNITS).mkdir(exist_ok=True)
        name = f"{number}-{re.sub(r'[^A-Za-z0-9._-]+', '_', unit.name)[:60]}.html"
        write_report(self.work / UNITS, res, recording, alarms, summary, file=name)
        return f"{UNITS}/{name}"


def conclude_fleet(results: Sequence[UnitResult], out: Path, as_json: bool) -> int:
    """Print what was found; return the exit code."""
    verdict, code, sentence = fleet_verdict(results)
    ordered = worst_first(results)
    if as_json:
        found = {"layout": LAYOUT, "verdict": verdict, "exit_code": code, "summary": sentence}
        found |= {"units": list(map(_plain, ordered)), "out": str(out)}
        write(json.dumps(found, indent=2, allow_nan=False) + "\n")
        return code
    table = [("unit", "verdict", "margin", "FAULT", "decided", "first alarm", "the last alarm")]
    for r in ordered[:SHOWN]:
        margin = "" if math.isnan(r.margin) else f"{r.margin:.3g}"
        faults, s = str(r.summary.counts["FAULT"]), r.summary
        table.append(
            (r.unit.name, r.verdict, margin, faults, percent(s.decided), s.first_alarm, s.last_ended)
        )
    rows = [
        ("not tested", f"{r.unit.name}: {r.summary.sentence}") for r in ordered if r.verdict == "not tested"
    ][:SHOWN]
    rows += [("", f"and {len(ordered) - SHOWN} more units")] if len(ordered) > SHOWN else []
    rows += [("table", str(out / "fleet.csv")), ("page", str(out / "fleet.html"))]
    show(sentence, COLOUR[verdict], rows, table)
    return code


def _plain(r):
    """Return a UnitResult as JSON has it."""
    about = {"model": str(r.unit.model), "recording": str(r.unit.recording)}
    return {"unit": r.unit.name} | r.summary.plain() | about
