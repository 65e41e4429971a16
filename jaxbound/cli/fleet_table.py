"""The results of a fleet: a table and a page with the worst unit first, and pages of faulty units."""

import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxbound.cli.terminal import Conclusion, Row, Table
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.result import Result
from jaxbound.recordings.recording import Recording
from jaxbound.reports.detection import write_report
from jaxbound.reports.fleet import fleet_page
from jaxbound.reports.monitored import ORDER
from jaxbound.runs.fleet import Unit, UnitResult, fleet_verdict, worst_first
from jaxbound.runs.summary import LAYOUT, OUTSIDE, Summary
from jaxbound.text.characters import cell
from jaxbound.text.quantities import percent

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


def write_fleet(directory: str | Path, results: Sequence[UnitResult], title: str = "fleet") -> None:
    """Write fleet.csv, a row a unit, and fleet.html, both with the worst unit first.

    Args:
        directory: an existing folder. results: UnitResults in any order. title: for the page.
    """
    directory = Path(directory)
    ordered = worst_first(results)
    file = directory / "fleet.csv"
    with open(file, "w", newline="", encoding="utf-8", errors="backslashreplace") as f:
        rows = list(map(_cells, ordered))
        table = csv.DictWriter(f, rows[0], lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    page = fleet_page(ordered, fleet_verdict(results), title)
    (directory / "fleet.html").write_text(page, encoding="utf-8")


def _cells(result: UnitResult) -> dict[str, object]:
    """Return the row of a unit by the names of its columns."""
    summary = result.summary
    return {
        "unit": cell(result.unit.name),
        "verdict": result.verdict,
        "margin": _number_cell(result.margin),
        "factor": _number_cell(1 - result.margin),
        **{name: summary.counts[name] for name in ORDER},
        "decided": _number_cell(summary.decided),
        "alarms": summary.alarms,
        "first_alarm": cell(summary.first_alarm),
        "worst": cell(summary.worst.time) if summary.worst else "",
        "sentence": cell(summary.sentence),
        "hints": cell(" | ".join(summary.hints)),
        "model": cell(str(result.unit.model)),
        "recording": cell(str(result.unit.recording)),
        "ended": summary.last_ended,
        **_outside_cells(summary),
    }


def _outside_cells(summary: Summary) -> dict[str, object]:
    """Return the cells on the region of training: windows and FAULT windows outside, and the farthest in
    words; empty where the model states no ranges.
    """
    outside = None
    if summary.found is not None:
        outside = summary.found.outside
    if outside is None:
        return dict.fromkeys(("outside", "FAULT_outside", "outside_by"), "")
    cells = {"outside": outside.windows, "FAULT_outside": outside.faults}
    return cells | {"outside_by": cell(outside.words)}


def _number_cell(x: float) -> str:
    """Return a number in full, NaN as nothing."""
    if math.isnan(x):
        return ""
    return repr(float(x))


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
        write_report(self.work / UNITS / name, res, recording, alarms, summary)
        return f"{UNITS}/{name}"


@dataclass(frozen=True)
class FleetConclusion(Conclusion):
    """The conclusion of a fleet. Fields: results: the worst first. verdict: of all. out: its folder."""

    results: Sequence[UnitResult]
    verdict: tuple[str, int, str]
    out: Path

    @property
    def headline(self) -> str:
        """The sentence of the verdict."""
        return self.verdict[2]

    def table(self) -> Table:
        """Return the worst units."""
        head = ("unit", "verdict", "margin", "FAULT", "outside", "decided", "first alarm", "the last alarm")
        return [head, *map(_shown_row, self.results[:SHOWN])]

    def rows(self) -> Iterator[Row]:
        """Yield why units were not tested, and where all units are."""
        untested = [result for result in self.results if result.verdict == "not tested"]
        for result in untested[:SHOWN]:
            yield "not tested", f"{result.unit.name}: {result.summary.sentence}"
        if len(self.results) > SHOWN:
            yield "", f"and {len(self.results) - SHOWN} more units"
        yield "table", str(self.out / "fleet.csv")
        yield "page", str(self.out / "fleet.html")

    def plain(self) -> dict[str, Any]:
        """Return all units."""
        verdict, code, sentence = self.verdict
        units = list(map(_plain, self.results))
        return {
            "layout": LAYOUT,
            "verdict": verdict,
            "exit_code": code,
            "summary": sentence,
            "units": units,
            "out": str(self.out),
        }


def conclude_fleet(results: Sequence[UnitResult], out: Path, as_json: bool) -> int:
    """Print the conclusion of a fleet; return the exit code."""
    verdict = fleet_verdict(results)
    FleetConclusion(worst_first(results), verdict, out, style=COLOUR[verdict[0]]).show(as_json)
    return verdict[1]


def _shown_row(result: UnitResult) -> tuple[str, ...]:
    """Return the row of a unit on the terminal."""
    summary = result.summary
    return (
        result.unit.name,
        result.verdict,
        "" if math.isnan(result.margin) else f"{result.margin:.3g}",
        str(summary.counts["FAULT"]),
        str(_outside_cells(summary)["FAULT_outside"]),
        percent(summary.decided),
        summary.first_alarm,
        summary.last_ended,
    )


def _plain(result: UnitResult) -> dict[str, Any]:
    """Return a UnitResult as JSON has it."""
    files = {"model": str(result.unit.model), "recording": str(result.unit.recording)}
    return {"unit": result.unit.name} | result.summary.plain() | files
