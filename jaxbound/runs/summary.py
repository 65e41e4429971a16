"""Summaries of tests: numbers, a verdict in a sentence, one JSON layout for all commands."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import Any, NamedTuple, Protocol

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.hints import never_seen, unfit
from jaxbound.diagnosis.monitored import MonitorResult
from jaxbound.diagnosis.result import Result
from jaxbound.recordings.recording import Recording
from jaxbound.runs.counts import Evidence, OfTest, Tally
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable
from jaxbound.text.quantities import finite, most_percent, percent, times

__all__ = [
    "CODES",
    "LAYOUT",
    "OUTSIDE",
    "Evidence",
    "OfTest",
    "Summary",
    "Window",
    "evidence",
    "rests_on_outgrown",
    "said",
    "summarised",
    "unsaid",
]

LAYOUT = 1  # of the JSON; it grows where a key goes or changes its meaning, not where one is added
OUTSIDE = "outside the bounds as fitted"
CODES = {
    "no fault": 0,
    "fault": 1,
    "not tested": 2,
    "too little evidence": 3,
    OUTSIDE: 3,
}  # at which a command ends
NOTHING_COUNTED = {status.name: 0 for status in Status}
Label = Callable[[Any], str]
"""The function that writes the time of a sample: of its number, or of what an Evidence has in its place."""
Plain = dict[str, Any]
"""An object of JSON."""


class Window(NamedTuple):
    """A window by its last sample: its number, the time as text, the margin (NaN: none is measured)."""

    sample: int
    time: str
    margin: float


@readable
@dataclass(frozen=True)
class Summary:
    """The summary of the test of one recording. Made by `summarised`.

    Fields:
        verdict: "fault", "outside the bounds as fitted" (FAULT, by bounds from data for shorter windows), "no
            fault", "too little evidence" or "not tested"; sentence: what a plant engineer should know.
        found: the Evidence; None where nothing was tested. worst: the worst Window, or None; first_alarm:
            text of the time at which the first alarm begins, last_ended: why the last one is over,
            first_cause: the cause of the first, see `Alarm`; "" where there is none.
        hints: sentences to check. sizes: {output: smallest lasting error that is always seen}, or None.
            model: its name.
    """

    verdict: str
    sentence: str
    found: Evidence | None = None
    worst: Window | None = None
    first_alarm: str = ""
    last_ended: str = ""
    hints: tuple[str, ...] = ()
    sizes: Mapping[str, float] | None = None
    model: str = ""
    first_cause: str = ""

    @property
    def exit_code(self) -> int:
        """The code at which a command ends."""
        return CODES[self.verdict]

    @property
    def counts(self) -> dict[str, int]:
        """{status name: number of windows}."""
        return dict(self._evidence.counts)

    @property
    def decided(self) -> float:
        """The share of windows that are proved one way or the other."""
        return self._evidence.decided

    @property
    def alarms(self) -> int:
        """How many alarms there are."""
        return self._evidence.alarms

    @property
    def margin(self) -> float:
        """The margin of the worst window, NaN if there is none."""
        if self.worst is None:
            return np.nan
        return self.worst.margin

    @property
    def _evidence(self) -> Evidence:
        """The Evidence, without any window where nothing was tested."""
        return self.found or Evidence("", 0, 0, NOTHING_COUNTED)

    def plain(self, **also: object) -> Plain:
        """Return the summary as JSON has it, in the layout that docs/commands.md describes. also: what a
        command adds.
        """
        about = self._evidence
        horizon = None
        if self.found is not None:
            horizon = about.horizon
        validated: Plain = {}
        if about.faulty is not None:
            validated = {"tested": about.tested, "faulty": about.faulty}
        monitored: Plain = {}
        if about.tests is not None:
            monitored = {"tests": {name: test.plain() for name, test in about.tests.items()}}
        caused: Plain = {}
        if self.first_cause:
            caused = {"first_cause": self.first_cause}
        return {
            "layout": LAYOUT,
            "verdict": self.verdict,
            "exit_code": self.exit_code,
            "summary": self.sentence,
            "model": self.model or None,
            "method": about.method or None,
            "horizon": horizon,
            "samples": about.samples,
            "counts": self.counts,
            "decided": self.decided,
            "margin": finite(self.margin),
            "worst": self._plain_worst(),
            "alarms": self.alarms,
            "first_alarm": self.first_alarm or None,
            "last_ended": self.last_ended or None,
            "hints": list(self.hints),
            **validated,
            **also,
            "ended": about.ended or {},
            "always_seen": self._plain_sizes(),
            "margins": about.margins,
            "outside": about.outside and about.outside.plain(),
            **monitored,
            **caused,
        }

    def _plain_worst(self) -> Plain | None:
        if self.worst is None:
            return None
        sample, time, margin = self.worst
        test = {"test": self._evidence.test} if self._evidence.test else {}
        return {
            "sample": sample,
            "time": time,
            "margin": finite(margin),
            "factor": finite(1 - margin),
            "exact": not self._evidence.bounded,
            **test,
        }

    def _plain_sizes(self) -> Plain | None:
        if self.sizes is None:
            return None
        return {name: finite(size) for name, size in self.sizes.items()}


class Tested(Protocol):
    """A test of one recording that has Evidence: a Result, a Digest or a Validated."""

    @property
    def relations(self) -> Relations:
        """The relations, or the observer, that it was tested by."""


@singledispatch
def evidence(res: Tested, alarms: Sequence[Alarm]) -> Evidence:
    """Return the Evidence in the outcome of a test of one recording; a type of outcome registers how.

    Args:
        res: a Result, a Digest or a Validated. alarms: its alarms.
    """
    raise NotImplementedError(f"a {type(res).__name__} registers no evidence")


@evidence.register(Result)
def _(res: Result, alarms: Sequence[Alarm]) -> Evidence:
    tally = Tally(res.relations, lambda piece, k: k)  # a number in place of the time
    tally.add(Recording(np.asarray(res.u), np.asarray(res.y)), res.judged())
    ended = Counter(alarm.ended for alarm in alarms)
    found = tally.evidence(res.method, res.outside_is, len(alarms), ended)
    found = replace(found, aside=res.aside, margins=res.margins, known=res.known)
    if tally.first is not None:
        found = replace(found, first=tally.first.sample)
    if res.worst is not None:
        at, margin = res.worst
        found = replace(found, at=at, margin=margin)
    return found


@evidence.register(MonitorResult)
def _(res: MonitorResult, alarms: Sequence[Alarm]) -> Evidence:
    whole = evidence.dispatch(Result)(res, alarms)
    if whole.at is None:
        return whole
    return replace(whole, test=res.test_at(whole.at))


def summarised(
    res: Tested,
    alarms: Sequence[Alarm],
    label: Label,
    min_coverage: float = 0.5,
    hints: Iterable[str] = (),
    sizes: Mapping[str, float] | None = None,
    outgrown: bool = False,
) -> Summary:
    """Return the Summary of a test.

    Args:
        res: a Result of one recording, a Digest or a Validated. alarms: its alarms. label: number of a sample
            -> text of its time.
        min_coverage: below this share of windows, no fault is no news. hints, sizes: see `Summary`; a hint
            that the sentence says is left out. outgrown: see `Evidence`; of a monitor a FAULT counts that
            rests on no bounds which a test has outgrown.
    """
    found = evidence(res, alarms)
    if outgrown:
        found = replace(found, outgrown=rests_on_outgrown(found.tests))
    worst = None
    if found.at is not None:
        worst = Window(found.at, label(found.at), found.margin)
    first = last = cause = ""
    if alarms:
        first, last, cause = label(alarms[0].start), alarms[-1].ended, alarms[0].cause
    verdict, sentence = said(found, label, min_coverage)
    model = res.relations.model.name
    return Summary(verdict, sentence, found, worst, first, last, unsaid(hints, sentence), sizes, model, cause)


def rests_on_outgrown(tests: Mapping[str, OfTest] | None) -> bool:
    """Return whether each FAULT of a monitor rests on bounds that a test has outgrown; True of another test,
    which has outgrown its own.
    """
    return not any(test.within for test in (tests or {}).values())


def unsaid(hints: Iterable[str], sentence: str) -> tuple[str, ...]:
    """Return the hints that a verdict's sentence does not say already, but for their first letter."""
    return tuple(hint for hint in hints if hint[1:] not in sentence)


def said(found: Evidence, label: Label, min_coverage: float = 0.5) -> tuple[str, str]:
    """Return (verdict, sentence). Args: as for `summarised`."""
    if found.counts["FAULT"]:
        return _proved_fault(found, label)
    # UNDECIDED is what healthy samples are to an observer: there data are all one can ask for
    share, deed = found.tested, "have data"
    if found.faulty is None and (found.covered is not None or not found.remembers):
        share, deed = found.decided, "could be decided"
    if share < min_coverage:
        return "too little evidence", _too_little(found, share, deed, min_coverage)
    return "no fault", _healthy(found, label)


def _proved_fault(found: Evidence, label: Label) -> tuple[str, str]:
    """Return (verdict, sentence) where windows are FAULT: proved, as far as the bounds hold over such
    windows, and where they are.
    """
    every, faults, beyond = _unfit_windows(found), found.counts["FAULT"], found.outside
    verdict, title = "fault", "Fault proved"
    if found.outgrown:
        verdict = OUTSIDE
        title = "Outside the bounds as fitted"
    if beyond is not None and beyond.holds(faults):
        what = "windows"
        if found.remembers:
            what = "samples"
        sentence = _fault_sentence(found, label)
        new = never_seen(beyond, faults, what)
        return verdict, f"{title}, outside training: {new}. {sentence}."
    if every and not found.outgrown and beyond is None:
        return verdict, f"{every[:1].upper()}{every[1:]}."
    sentence = every or _fault_sentence(found, label)
    if beyond is not None and beyond.faults:
        lie = f"lie{'s' * (beyond.faults == 1)} outside training, most by {beyond.words}"
        sentence += f"; {beyond.faults} of the FAULT ones {lie}"
    return verdict, f"{title}: {sentence}."


def _unfit_windows(found: Evidence) -> str:
    """Return the sentence on windows that are all FAULT, "" where some are not, or an observer judged."""
    if found.remembers or found.counts["CONSISTENT"] or found.counts["UNDECIDED"]:
        return ""
    return "".join(unfit(found.counts, found.margin, beyond=found.outside))


def _fault_sentence(found: Evidence, label: Label) -> str:
    """Return how much is FAULT, in how many alarms, and the sample to look at first."""
    faults, count = found.counts["FAULT"], found.windows
    share = f"({percent(faults / count)})"
    if found.tests is not None:
        many = f"{faults} of {count} samples {share} contradict {_spoken(found.tests)}"
        where = _place_of_contradiction(found, label)
    elif found.remembers:
        many = f"{faults} of {count} samples {share} contradict the model and the samples before them"
        where = _place_of_contradiction(found, label)
    elif found.faulty is not None:
        many = f"{faults} of {count} windows {share} contradict the model and the samples accepted before"
        where = f"the first FAULT is at {label(found.first)}; {_blamed(found.faulty)}"
    else:
        many = f"{faults} of {count} windows {share} cannot be explained by any behaviour inside the bounds"
        where = _place_of_fault(found, label)
    return f"{many}, {_grouped(found.alarms)}; {where}"


def _spoken(tests: Mapping[str, OfTest]) -> str:
    """Return the tests of a monitor that prove a fault, each with how often."""
    counts = {name: test.counts["FAULT"] for name, test in tests.items()}
    return ", ".join(f"{name!r} ({count})" for name, count in counts.items() if count)


def _grouped(alarms: int) -> str:
    if not alarms:
        return "too scattered for an alarm"
    return f"in {alarms} alarm{'s' * (alarms != 1)}"


def _place_of_contradiction(found: Evidence, label: Label) -> str:
    if found.first is None:
        return f"the worst is at {label(found.at)}"
    return f"the first FAULT is at {label(found.first)}"


def _place_of_fault(found: Evidence, label: Label) -> str:
    if np.isfinite(found.margin):
        return f"the worst, at {label(found.at)}, would need bounds {times(1 - found.margin)} as wide"
    return f"the first FAULT is at {label(found.at)}"


def _blamed(faulty: Mapping[str, int]) -> str:
    """Return which outputs a validation found faulty. faulty: {output: number of its faulty samples}."""
    if not faulty:
        return "no single sensor explains it"
    return "faulty: " + ", ".join(f"{name} in {n} sample{'s' * (n > 1)}" for name, n in faulty.items())


def _too_little(found: Evidence, share: float, deed: str, least: float) -> str:
    """Return the sentence on a recording of which too small a share tells anything."""
    what = "windows"
    if found.remembers:
        what = "samples"
    some = f"{round(share * found.windows)} of {found.windows} {what} ({percent(share)})"
    asked = f"at least {percent(least)} are asked for"
    return f"Too little evidence: only {some} {deed}, {asked}{_unclaimed(found)}."


def _unclaimed(found: Evidence) -> str:
    """Return the end of a sentence on windows whose FAULT is not claimed outside the region of training."""
    if found.outside is None or not found.outside.unclaimed:
        return ""
    many = f"{found.outside.unclaimed} that the model does not explain"
    lie = f"lie{'s' * (found.outside.unclaimed == 1)} outside training"
    return f"; {many} {lie}, where no FAULT is claimed, most by {found.outside.words}"


def _most_used(margin: float) -> str:
    """Return the end of a sentence, by a bound on the smallest margin; nothing where it says nothing."""
    most = most_percent(1 - margin)
    if most == most_percent(1):
        return ""
    return f"; none uses more than {most} of them"


def _healthy(found: Evidence, label: Label) -> str:
    """Return the sentence on a recording without a fault."""
    tested = round(found.tested * found.windows)
    if found.tests is not None:
        return (
            f"No fault found: none of {tested} samples is proved to contradict one of {len(found.tests)} "
            f"tests{_unclaimed(found)}."
        )
    if found.remembers:
        return (
            f"No fault found: none of {tested} samples is proved to contradict the model and the samples "
            f"before it{_unclaimed(found)}."
        )
    if found.faulty is not None:
        every = f"every sample of {tested} windows fits what the samples before it allow"
        slow = "; a fault that grows slowly may hide, which windows (no --method) may show"
        if found.counts["CONSISTENT"]:
            slow = ""
        return f"No fault proved: {every}{slow}."
    decided, count = found.counts["CONSISTENT"], found.windows
    every = f"{decided} of {count} windows ({percent(found.decided)})"
    if decided == count:
        every = f"all {count} windows"
    used = ""
    if found.at is not None and np.isfinite(found.margin):
        used = f"; the tightest, at {label(found.at)}, uses {percent(1 - found.margin)} of them"
        if found.bounded:  # another window may be the tightest
            used = _most_used(found.margin)
    used = _unclaimed(found) or used
    return f"No fault found: the model explains {every} within its bounds{used}."
