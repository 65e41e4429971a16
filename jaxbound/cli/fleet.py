"""The command `jaxbound fleet`: many units in one command, a table and a page with the worst first."""

import argparse

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import CLAIMS, COVERAGE, ENGINE, JSON, RULE, Options, test
from jaxbound.cli.terminal import door, progress_bars, usable_device

NAME = "fleet"
HELP = "test many units listed in a table"
EXAMPLES = (
    (
        "jaxbound fleet units.csv --out fleet/",
        "units.csv has the columns unit, model and recording, a row a unit",
    ),
)
CODES = (
    "exit codes, the first that applies: 1 fault found in some unit, 2 some unit could not be tested (its "
    "row says why) or bad input or usage, 3 too little evidence for some unit or outside bounds that were "
    "fitted to shorter windows, 0 no fault; 70 internal error, 130 interrupted, 129 by SIGHUP, 143 by "
    "SIGTERM (what was tested is written)"
)


def _of_units(text: str) -> None:
    """Refuse fields of a recording: units of a fleet are written in ways of their own."""
    raise argparse.ArgumentTypeError("is said by [recording] of each unit's model file")


OPTIONS = Options(
    {
        "manifest MANIFEST": "CSV or TOML with a unit, a model and a recording in each row; a column "
        "acknowledged names the unit's own file of acknowledgements; how recordings are read is said by "
        "[recording] of each unit's model file",
        "--out DIR": "folder for fleet.csv and its page, worst units first",
        "--state DIR": "folder in which it is kept how each unit goes on: its next recording, in a later "
        "run, is judged as if it followed in one file",
        **test(CLAIMS),
        **RULE,
        **JSON,
        "--recording WORDS": argparse.SUPPRESS,
    },
    {"recording": _of_units},
    required=("out",),
    more={**COVERAGE, **ENGINE},
)


def run(args: argparse.Namespace) -> int:
    """Test the units of a manifest and write their table; return the exit code."""
    with swift_imports():
        from jaxbound.cli.engine import engine
        from jaxbound.cli.fleet_table import PAGES, SHOWING, UNITS, UnitPages, conclude_fleet, write_fleet
        from jaxbound.cli.window import asked_test
        from jaxbound.models.statedalarms import stated_alarms
        from jaxbound.runs.fleet import FleetTest, UnitResult, detect_fleet, read_manifest
        from jaxbound.runs.outputs import output_folder, refuse_among_inputs
        from jaxbound.runs.refusals import Interrupted

    ask = asked_test(args, claims=True)
    with door():
        stated_alarms(args.alarm, "--alarm")
        units = read_manifest(args.manifest)
        usable_device()
    results: list[UnitResult] = []
    stopped: Interrupted | None = None
    inputs = [args.manifest, *(path for unit in units for path in unit[1:] if path is not None)]
    with (
        door(OSError),
        output_folder(args.out, ("fleet.csv", "fleet.html", UNITS), inputs) as folder,
        folder.work() as work,
    ):
        if args.state is not None:
            refuse_among_inputs(args.state, inputs)
        folder.remove(UNITS)  # pages of an earlier run
        try:
            with progress_bars(("units",)) as step, engine(args.workers) as client:
                pages = UnitPages(work)
                how = FleetTest(ask, args.alarm, args.min_coverage, args.state)
                report = lambda share: step("units", share)
                own = pages if client is None else None
                for result in detect_fleet(units, how, own, report, client):
                    results.append(result)
                if client is not None:  # which units get a page is known once all are tested
                    faulty = [r.unit for r in results if r.verdict in SHOWING][:PAGES]
                    pages.number(faulty)
                    again = detect_fleet(faulty, how, pages, client=client) if faulty else ()
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
    return conclude_fleet(results, args.out, args.json)
