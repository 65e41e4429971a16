"""The conclusion of a recording that was tested, on the terminal or as JSON."""

import json
import re
import shlex
from pathlib import Path
from typing import cast

import numpy as np

from jaxbound.cli.evaluation import Evaluation
from jaxbound.cli.terminal import show, write
from jaxbound.runs.summary import OUTSIDE, Evidence, Window
from jaxbound.text.quantities import percent, times

__all__ = ["conclude"]

COLOUR = {
    "no fault": "bold green",
    "fault": "bold red",
    "too little evidence": "bold yellow",
    OUTSIDE: "bold yellow",
}


def conclude(evaluation: Evaluation, data: Path | str, out: Path, as_json: bool = False) -> int:
    """Print what was found and return the exit code."""
    summary, model, seconds = evaluation.summary, evaluation.model, evaluation.seconds
    if as_json:
        rounded = {k: round(v, 3) for k, v in seconds.items()}
        plain = summary.plain(data=str(data), seconds=rounded, out=str(out))
        write(json.dumps(plain, indent=2, allow_nan=False) + "\n")
        return summary.exit_code
    found, counts = cast(Evidence, summary.found), summary.counts  # a recording was tested
    rows = [
        (
            "samples" if found.remembers else "windows",
            ", ".join(
                f"{counts[s]} {s}" for s in ("FAULT", "CONSISTENT", "UNDECIDED", "MISSING") if counts[s]
            ),
        )
    ]
    if found.remembers:
        rows.append(
            (
                "tested",
                f"{percent(found.tested)} of {found.windows} samples, by an observer of all samples before "
                f"them",
            )
        )
    elif found.faulty is None:
        by = f"by the {found.method} test over {found.horizon + 1} samples each"
        rows.append(("decided", f"{percent(found.decided)} of {found.windows} windows, {by}"))
    else:
        rows.append(
            ("faulty", ", ".join(f"{name} in {n} samples" for name, n in found.faulty.items()) or "no sensor")
        )
    proved = counts["FAULT"] and found.faulty is None and not model.uncertainties
    command = f"jaxbound explain {shlex.quote(str(out))} --at "
    first = summary.first_alarm
    rows.append(("alarms", f"{found.alarms}" + (f", the first at {first}" if found.alarms else "")))
    if proved and found.alarms and re.fullmatch(r"\S+ s|\d{4}-\d\d-\d\d[ T][\d:.]+", first):
        rows[-1] = (
            "alarms",
            f"{rows[-1][1]}: {command}{shlex.quote(first.removesuffix(' s') + 's' * first.endswith(' s'))}",
        )
    if np.isfinite(summary.margin):
        at, margin = cast(Window, summary.worst).time, summary.margin
        what = (
            f"bounds needed: {times(1 - margin)} the stated ones"
            if margin < 0
            else f"{percent(1 - margin)} of the bounds are used"
        )
        if found.remembers:
            what = (
                f"beyond what the samples before allow by {times(1 - margin)}"
                if margin < 0
                else f"{percent(1 - margin)} of it is used"
            )
        rows.append(
            (
                "worst" if found.remembers else "worst window" if margin < 0 else "tightest",
                f"{at}: margin {margin:.3g}, {what}",
            )
        )
    if proved:
        rows.append(("proof" if summary.verdict == "fault" else "why", f"{command}{found.at}"))
    rows += [("hint", h) for h in summary.hints]
    rows += [
        ("seconds", ", ".join(f"{name} {s:.1f}" for name, s in seconds.items())),
        ("report", str(out / "report.html")),
    ]
    show(summary.sentence, COLOUR[summary.verdict], rows)
    return summary.exit_code
