"""The command `jaxbound fleet`: many units in one command, a table and a page with the worst first."""

import argparse
import csv
import json
import math
import re
from collections.abc import Sequence
from pathlib import Path

from jaxbound.cli.engine import engine_of
from jaxbound.cli.terminal import door, progress_bars, show, usable_device, write
from jaxbound.cli.window import OBSERVER, observer_options, refuse_options
from jaxbound.consistency.interface import METHODS
from jaxbound.reports.detection import write_report
from jaxbound.reports.fleet import fleet_page
from jaxbound.runs.fleet import UnitResult, detect_fleet, fleet_verdict, read_manifest, worst_first
from jaxbound.runs.outputs import output_folder
from jaxbound.runs.refusals import Interrupted, Refused
from jaxbound.runs.summary import LAYOUT, OUTSIDE
from jaxbound.text.characters import cell
from jaxbound.text.quantities import percent

__all__ = ["run", "write_fleet"]

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


def run(args: argparse.Namespace) -> int:
    """Run `jaxbound fleet`; return the exit code."""
    if args.method not in (*METHODS, OBSERVER):
        raise Refused(f"--method must be one of {', '.join((*METHODS, OBSERVER))}, not {args.method!r}")
    with door():
        refuse_options(args)
        units = read_manifest(args.manifest)
        usable_device()
    results = []
    stopped: Interrupted | None = None
    inputs = [args.manifest, *(path for unit in units for path in (unit.model, unit.recording))]
    with (
        door(OSError),
        output_folder(args.out, ("fleet.csv", "fleet.html", UNITS), inputs) as folder,
        folder.work() as work,
    ):
        folder.remove(UNITS)  # pages of an earlier run
        try:
            with progress_bars(("units",)) as step, engine_of(args) as client:
                how = args.method, args.horizon, args.alarm, args.min_coverage
                report, pages = lambda share: step("units", share), _Pages(work)
                more = _options(args), client, args.state
                for result in detect_fleet(
                    units, *how, report, args.lags, pages if client is None else None, *more
                ):
                    results.append(result)
                if client is not None:  # which units get a page is known once all are tested
                    faulty = [r.unit for r in results if r.verdict in SHOWING][:PAGES]
                    pages.number(faulty)
                    again = detect_fleet(faulty, *how, None, args.lags, pages, *more) if faulty else ()
                    told = {r.unit.name: r for r in again}
                    results = [told.get(r.unit.name, r) for r in results]
        except KeyboardInterrupt:
            done = len(results)
            results += [UnitResult.untested(unit, "interrupted before its turn") for unit in units[done:]]
            write_fleet(work, results, args.manifest.stem)
            stopped = Interrupted(
                f"interrupted: {done} of {len(units)} units were tested; {args.out / 'fleet.csv'} has them"
            )
        else:
            write_fleet(work, results, args.manifest.stem)
    if stopped is not None:
        raise stopped
    return _conclude(args, results)


def _options(args):
    """Return what is said of an observer beside its horizon."""
    return {name: value for name, value in observer_options(args).items() if name != "horizon"}


class _Pages:
    """Writes the pages of units with a fault, as many as have room, into a folder; a call returns the name of
    a page.

    Args:
        work: the folder of the run, in which they get one of their own.
    """

    def __init__(self, work):
        self.work, self.numbers = work, {}

    def number(self, units):
        """Give units their numbers, and no others, before several processes write their pages."""
        (self.work / UNITS).mkdir(exist_ok=True)
        self.numbers = {unit.name: i for i, unit in enumerate(units, 1)}

    def __call__(self, unit, res, recording, alarms, summary):
        if summary.verdict not in SHOWING or (unit.name not in self.numbers and len(self.numbers) == PAGES):
            return ""
        number = self.numbers.setdefault(unit.name, len(self.numbers) + 1)
        (self.work / UNITS).mkdir(exist_ok=True)
        name = f"{number}-{re.sub(r'[^A-Za-z0-9._-]+', '_', unit.name)[:60]}.html"
        write_report(self.work / UNITS, res, recording, alarms, summary, file=name)
        return f"{UNITS}/{name}"


def _conclude(args, results):
    verdict, code, sentence = fleet_verdict(results)
    ordered = worst_first(results)
    if args.json:
        found = {"layout": LAYOUT, "verdict": verdict, "exit_code": code, "summary": sentence}
        found |= {"units": list(map(_plain, ordered)), "out": str(args.out)}
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
    rows += [("table", str(args.out / "fleet.csv")), ("page", str(args.out / "fleet.html"))]
    show(sentence, COLOUR[verdict], rows, table)
    return code


def _plain(r):
    """Return a UnitResult as JSON has it."""
    about = {"model": str(r.unit.model), "recording": str(r.unit.recording)}
    return {"unit": r.unit.name} | r.summary.plain() | about
