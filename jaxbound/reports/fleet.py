"""The page of a fleet: a row a unit, the worst first."""

import shlex
import time

from jaxbound.reports.page import TITLE, render

__all__ = ["fleet_page"]


def fleet_page(ordered, verdict, title):
    """Return the HTML text.

    Args:
        ordered: UnitResults, the worst first. verdict: (verdict, exit code, sentence) of the fleet. title: of the page.
    """
    kind, _, sentence = verdict
    return render(
        "fleet.html",
        name=title,
        verdict=kind,
        title=TITLE[kind],
        sentence=sentence,
        written=time.strftime("%Y-%m-%d %H:%M:%S %z"),
        units=ordered,
        command=_command(ordered),
    )


def _command(ordered):
    """Return the command line that makes the full report of the worst unit that was tested, None if there is none."""
    for r in ordered:
        if r.verdict != "not tested":
            parts = ("jaxbound", "detect", str(r.unit.model), str(r.unit.recording), "--out", f"report-{r.unit.name}")
            return shlex.join(parts)
    return None
