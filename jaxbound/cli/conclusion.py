"""The conclusion of a recording that was tested, on the terminal or as JSON."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from typing import cast

import numpy as np

from jaxbound.cli.evaluation import Evaluation
from jaxbound.cli.terminal import Conclusion, Row
from jaxbound.cli.window import WINDOWS, DetectRun
from jaxbound.diagnosis.observed import shown_name
from jaxbound.diagnosis.watch import LASTING
from jaxbound.reports.monitored import ORDER
from jaxbound.runs.summary import OUTSIDE, Evidence, OfTest, Summary, Window
from jaxbound.sets.floats.status import Status
from jaxbound.text.quantities import most_percent, percent, three_digits, times

TIME = re.compile(r"\S+ s|\d{4}-\d\d-\d\d[ T][\d:.]+")  # of a sample, as `explain --at` takes it
COLOUR = {
    "no fault": "bold green",
    "fault": "bold red",
    "too little evidence": "bold yellow",
    OUTSIDE: "bold yellow",
}


@dataclass(frozen=True)
class Detected(Conclusion):
    """The conclusion of a run. Fields: evaluation: of its recording. run: what was asked for. replaces:
    whether another report was there.
    """

    evaluation: Evaluation
    run: DetectRun
    replaces: bool = False

    @property
    def headline(self) -> str:
        """The sentence of the verdict."""
        return self.evaluation.summary.sentence

    def rows(self) -> Iterator[Row]:
        """Yield counts, alarms, the worst window, and the command that explains it."""
        summary, out = self.evaluation.summary, self.run.out
        evidence = cast(Evidence, summary.found)  # a recording was tested
        explain = ""
        # A certificate of one window exists where windows, or an observer, were tested of a certain model.
        is_certain = evidence.faulty is None and not self.evaluation.model.uncertainties
        if evidence.counts["FAULT"] and is_certain:
            explain = f"jaxbound explain {shlex.quote(str(out))} --at "
        yield from (_counts_row(evidence), _tested_row(evidence), _alarms_row(summary, evidence, explain))
        for name, test in (evidence.tests or {}).items():
            yield f"test {name}", _test_verdicts(test)
        if np.isfinite(summary.margin):
            yield _worst_row(summary, evidence)
        if evidence.training:
            yield "training", evidence.training
        if explain:
            yield "proof" if summary.verdict == "fault" else "why", f"{explain}{evidence.at}"
        yield "seconds", ", ".join(f"{stage} {s:.1f}" for stage, s in self.evaluation.seconds.items())
        former = ", in place of the one that was there" * self.replaces
        yield "report", f"{out / 'report.html'}{former}"

    def plain(self) -> object:
        """Return the summary, with the files and the seconds of each stage."""
        seconds = {stage: round(time, 3) for stage, time in self.evaluation.seconds.items()}
        summary = self.evaluation.summary
        return summary.plain(data=str(self.run.data), seconds=seconds, out=str(self.run.out))


def conclude(evaluation: Evaluation, run: DetectRun, replaces: bool = False) -> int:
    """Print the conclusion of an evaluation; return the exit code. replaces: see `Detected`."""
    summary = evaluation.summary
    Detected(evaluation, run, replaces, hints=summary.hints, style=COLOUR[summary.verdict]).show(run.json)
    return summary.exit_code


def _counts_row(evidence: Evidence) -> tuple[str, str]:
    counts = []
    is_healthy = evidence.observes or evidence.faulty is not None  # UNDECIDED: what healthy samples are
    for name in ORDER:
        if evidence.counts[name]:
            counts.append(f"{evidence.counts[name]} {shown_name(Status[name], is_healthy)}")
    return "samples" if evidence.remembers else "windows", ", ".join(counts)


def _tested_row(evidence: Evidence) -> tuple[str, str]:
    """Return the share that was tested or decided, of a validation the sensors that are faulty."""
    if evidence.covered is not None:
        return "tested", f"{percent(evidence.tested)} of {evidence.windows} samples"
    if evidence.remembers:
        share = f"{percent(evidence.tested)} of {evidence.windows} samples"
        return "tested", f"{share}, by an observer of all samples before them"
    if evidence.faulty is None:
        each = f"{evidence.horizon + 1} samples each"
        if evidence.method != WINDOWS[1]:
            each = f"by the {evidence.method} test over {each}"
        return "decided", f"{percent(evidence.decided)} of {evidence.windows} windows, {each}"
    sensors = ", ".join(f"{name} in {n} samples" for name, n in evidence.faulty.items())
    return "faulty", sensors or "no sensor"


def _alarms_row(summary: Summary, evidence: Evidence, explain: str) -> tuple[str, str]:
    """Return the number of alarms and the first of them, with the command that explains it."""
    if not evidence.alarms:
        return "alarms", "0"
    first = summary.first_alarm
    text = f"{evidence.alarms}, the first at {first}"
    if explain and TIME.fullmatch(first):
        # the shell splits at a space: 5 s is typed 5s
        at = f"{first.removesuffix(' s')}s" if first.endswith(" s") else first
        text = f"{text}: {explain}{shlex.quote(at)}"
    lasting = (evidence.ended or {}).get(LASTING, 0)
    if lasting:
        text = f"{text}; {lasting} {LASTING}"
    return "alarms", text


def _test_verdicts(test: OfTest) -> str:
    """Return the verdicts of one test of a monitor."""
    some = [name for name in ORDER if test.counts[name]]
    counts = ", ".join(f"{test.counts[name]} {shown_name(Status[name], test.observes)}" for name in some)
    if np.isfinite(test.margin):
        return f"{counts}; least margin {three_digits(test.margin)}"
    return counts


def _worst_row(summary: Summary, evidence: Evidence) -> tuple[str, str]:
    """Return the window that comes nearest to a fault, or is the farthest in it."""
    margin = summary.margin
    is_outside = margin < 0
    if evidence.tests is not None:
        name, use = "worst", f"by test {evidence.test}"
    elif evidence.remembers:
        name = "worst"
        use = f"{percent(1 - margin)} of it is used"
        if is_outside:
            use = f"beyond what the samples before allow by {times(1 - margin)}"
    elif is_outside:
        name, use = "worst window", f"bounds needed: {times(1 - margin)} its own"
    else:
        name, use = "tightest", f"{percent(1 - margin)} of the bounds are used"
    if evidence.bounded:  # another window may be the tightest
        use = f"at most {most_percent(1 - margin)} of the bounds are used"
        return name, f"margin at least {three_digits(margin)}, {use}"
    return name, f"{cast(Window, summary.worst).time}: margin {three_digits(margin)}, {use}"
