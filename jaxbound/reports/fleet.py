"""The page of a fleet: a row a unit, the worst first."""

import shlex
import time
from collections.abc import Sequence

from jaxbound.reports.page import render
from jaxbound.runs.fleet import UnitResult


def fleet_page(ordered: Sequence[UnitResult], verdict: tuple[str, int, str], title: str) -> str:
    """Return the HTML text.

    Args:
        ordered: UnitResults, the worst first. verdict: (verdict, exit code, sentence) of the fleet.
        title: of the page.
    """
    kind, _, sentence = verdict
    return render(
        "fleet.html",
        name=title,
        verdict=kind,
        sentence=sentence,
        written=time.strftime("%Y-%m-%d %H:%M:%S %z"),
        units=ordered,
        command=_command(ordered),
    )


def _command(ordered: Sequence[UnitResult]) -> str | None:
    """Return the command that makes the full report of the worst unit that was tested, if there is one."""
    for r in ordered:
        if r.verdict != "not tested":
            files = str(r.unit.model), str(r.unit.recording)
            return shlex.join(("jaxbound", "detect", *files, "--out", f"report-{r.unit.name}"))
    return None
