"""What the test of a recording comes to, whatever tested it: numbers, a verdict in a sentence, and one JSON
layout for all commands.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np

from jaxbound.diagnosis.hints import unfit
from jaxbound.relations.sentence import remembers
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable
from jaxbound.text.quantities import percent, times

__all__ = [
    "CODES",
    "LAYOUT",
    "OUTSIDE",
    "Evidence",
    "Summary",
    "Window",
    "evidence",
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


class Window(NamedTuple):
    """A window by its last sample: its number, the time as text, the margin (NaN: none is measured)."""

    sample: int
    time: str
    margin: float


@readable
@dataclass(frozen=True)
class Evidence:
    """The numbers that a verdict on a recording rests on.

    Fields:
        method: of the test. horizon: windows have horizon + 1 samples. samples: how many were tested.
        counts: {status name: number of windows}. aside: how many are MISSING because the model's `where`
            leaves out a sample of theirs.
        at, margin: sample (or whatever has a label) and margin of the FAULT window with the smallest margin
            (without FAULT: of any window);
            None, NaN: there is none.
        first: sample of the first FAULT window, None where it is not known. alarms: how many. ended: {why an
            alarm is over: how many}.
        faulty: {output: number of its faulty samples}, of a validation; else None.
        remembers: whether verdicts rest on all samples since the start (an observer): UNDECIDED then is what
            healthy samples are.
        outgrown: whether the bounds were found from data for shorter windows than these: FAULT then proves no
            fault.
    """

    method: str
    horizon: int
    samples: int
    counts: dict
    aside: int = 0
    at: int | None = None
    margin: float = np.nan
    first: int | None = None
    alarms: int = 0
    ended: dict | None = None
    faulty: dict | None = None
    remembers: bool = False
    outgrown: bool = False

    @property
    def windows(self) -> int:
        """How many windows there are: the warm-up is none, nor is what the model's `where` leaves out."""
        return max(self.samples - self.horizon - self.aside, 0)

    @property
    def decided(self) -> float:
        """The share of windows that are proved one way or the other."""
        return (self.counts["CONSISTENT"] + self.counts["FAULT"]) / self.windows if self.windows else 0.0

    @property
    def tested(self) -> float:
        """The share of windows that have data."""
        return (
            1 - (self.counts["MISSING"] - self.horizon - self.aside) / self.windows if self.windows else 0.0
        )


@readable
@dataclass(frozen=True)
class Summary:
    """What the test of one recording comes to. Made by `summarised`.

    Fields:
        verdict: "fault", "outside the bounds as fitted" (FAULT, by bounds from data for shorter windows), "no
            fault", "too little evidence" or "not tested"; sentence: what a plant engineer should know.
        found: the Evidence; None where nothing was tested. worst: the worst Window, or None; first_alarm:
            text of the time at which the first alarm begins, last_ended: why the last one is over; "" where
                there is none.
        hints: sentences to check. sizes: {output: smallest lasting error that is always seen}, or None.
            model: its name.
    """

    verdict: str
    sentence: str
    found: Evidence | None = None
    worst: Window | None = None
    first_alarm: str = ""
    last_ended: str = ""
    hints: tuple = ()
    sizes: dict | None = None
    model: str = ""

    @property
    def exit_code(self) -> int:
        """The code at which a command ends."""
        return CODES[self.verdict]

    @property
    def counts(self) -> dict:
        """{status name: number of windows}."""
        return self.found.counts if self.found else dict.fromkeys((s.name for s in Status), 0)

    @property
    def decided(self) -> float:
        """The share of windows that are proved one way or the other."""
        return self.found.decided if self.found else 0.0

    @property
    def alarms(self) -> int:
        """How many alarms there are."""
        return self.found.alarms if self.found else 0

    @property
    def margin(self) -> float:
        """The margin of the worst window, NaN if there is none."""
        return self.worst.margin if self.worst else np.nan

    def plain(self, **also: Any) -> dict:
        """Return the summary as JSON has it, in the layout that docs/summary.md describes. also: what a
        command adds.
        """
        found = self.found or Evidence("", 0, 0, self.counts)  # nothing was tested
        worst = None
        if self.worst is not None:
            sample, time, margin = self.worst
            worst = {"sample": sample, "time": time, "margin": finite(margin), "factor": finite(1 - margin)}
        validated = {} if found.faulty is None else {"tested": found.tested, "faulty": found.faulty}
        return {
            "layout": LAYOUT,
            "verdict": self.verdict,
            "exit_code": self.exit_code,
            "summary": self.sentence,
            "model": self.model or None,
            "method": found.method or None,
            "horizon": found.horizon if self.found else None,
            "samples": found.samples,
            "counts": self.counts,
            "decided": self.decided,
            "margin": finite(self.margin),
            "worst": worst,
            "alarms": self.alarms,
            "first_alarm": self.first_alarm or None,
            "last_ended": self.last_ended or None,
            "hints": list(self.hints),
            **validated,
            **also,
            "ended": found.ended or {},
            "always_seen": self.sizes and {name: finite(size) for name, size in self.sizes.items()},
        }


def finite(x: float) -> float | None:
    """Return a number that JSON has, None for any other."""
    return float(x) if np.isfinite(x) else None


@singledispatch
def evidence(res: Any, alarms: Sequence) -> Evidence:
    """Return the Evidence in what a test returns, of one recording; a type of result registers how, this is a
    Result's.

    Args:
        res: a Result. alarms: its alarms.
    """
    fault = res.status == Status.FAULT
    margin = np.where(fault if fault.any() else True, res.margin, np.nan)
    first = int(np.argmax(fault)) if fault.any() else None
    at = first if np.isnan(margin).all() else int(np.nanargmin(margin))
    ended = dict(Counter(a.ended for a in alarms))
    smallest = np.nan if at is None else float(margin[at])
    return Evidence(
        res.method,
        res.relations.horizon,
        len(res.status),
        res.counts,
        res.aside,
        at,
        smallest,
        first,
        len(alarms),
        ended,
        remembers=remembers(res.relations),
    )


def summarised(
    res: Any,
    alarms: Sequence,
    label: Callable,
    min_coverage: float = 0.5,
    hints: Iterable[str] = (),
    sizes: dict | None = None,
    outgrown: bool = False,
) -> Summary:
    """Return the Summary of a test.

    Args:
        res: a Result of one recording, a Digest or a Validated. alarms: its alarms. label: number of a sample
            -> text of its time.
        min_coverage: below this share of windows, no fault is no news. hints, sizes: see `Summary`; a hint
            that the sentence says is left out. outgrown: see `Evidence`.
    """
    found = replace(evidence(res, alarms), outgrown=outgrown)
    worst = None if found.at is None else Window(found.at, label(found.at), found.margin)
    first, last = (label(alarms[0].start), alarms[-1].ended) if alarms else ("", "")
    verdict, sentence = said(found, label, min_coverage)
    return Summary(
        verdict, sentence, found, worst, first, last, unsaid(hints, sentence), sizes, res.relations.model.name
    )


def unsaid(hints: Iterable[str], sentence: str) -> tuple[str, ...]:
    """Return the hints that a verdict's sentence does not say already, but for their first letter."""
    return tuple(hint for hint in hints if hint[1:] not in sentence)


def said(found: Evidence, label: Callable, min_coverage: float = 0.5) -> tuple[str, str]:
    """Return (verdict, sentence). Args: as for `summarised`."""
    if found.counts["FAULT"]:
        return _proved(found, label)
    windows = found.faulty is None and not found.remembers
    share, known = (found.decided, "could be decided") if windows else (found.tested, "have data")
    if share < min_coverage:
        number = round(share * found.windows)
        some = f"{number} of {found.windows} {'samples' if found.remembers else 'windows'} ({percent(share)})"
        return (
            "too little evidence",
            f"Too little evidence: only {some} {known}, at least {percent(min_coverage)} are asked for.",
        )
    return "no fault", _healthy(found, label)


def _proved(found, label):
    """Return (verdict, sentence) where windows are FAULT: proved, as far as the bounds hold over such
    windows.
    """
    if found.remembers:
        what, every = _contradicted(found, label), ""
    else:
        every = _unfit(found)
        what = every or (_fault(found, label) if found.faulty is None else _faulty(found, label))
    if found.outgrown:
        return OUTSIDE, f"Outside the bounds as fitted: {what}."
    return "fault", f"{what[:1].upper()}{what[1:]}." if every else f"Fault proved: {what}."


def _unfit(found):
    """Return a sentence where every window with data is FAULT."""
    every = not found.counts["CONSISTENT"] and not found.counts["UNDECIDED"]
    return next(iter(unfit(found.counts, found.margin)), "") if every else ""


def _grouped(found):
    return (
        f", in {found.alarms} alarm{'s' * (found.alarms != 1)}"
        if found.alarms
        else ", too scattered for an alarm"
    )


def _fault(found, label):
    """Return the sentence on windows that are proved faulty."""
    faults, count = found.counts["FAULT"], found.windows
    many = (
        f"{faults} of {count} windows ({percent(faults / count)}) cannot be explained by any behaviour "
        f"inside the bounds"
    )
    need = f"; the first is at {label(found.at)}"
    if np.isfinite(found.margin):
        need = f"; the worst, at {label(found.at)}, would need bounds {times(1 - found.margin)} as wide"
    return f"{many}{_grouped(found)}{need}"


def _faulty(found, label):
    """Return the sentence on a validation that found a fault."""
    faults, count = found.counts["FAULT"], found.windows
    whom = ", ".join(f"{name} in {n} sample{'s' * (n > 1)}" for name, n in found.faulty.items())
    whom = f"; faulty: {whom}" if whom else "; no single sensor explains it"
    many = (
        f"{faults} of {count} windows ({percent(faults / count)}) contradict the model and the samples "
        f"accepted before"
    )
    return f"{many}{_grouped(found)}; the first is at {label(found.first)}{whom}"


def _contradicted(found, label):
    """Return the sentence on what an observer found."""
    faults, count = found.counts["FAULT"], found.windows
    many = (
        f"{faults} of {count} samples ({percent(faults / count)}) contradict the model and the samples "
        f"before them"
    )
    first = (
        f"first is at {label(found.first)}" if found.first is not None else f"worst is at {label(found.at)}"
    )
    return f"{many}{_grouped(found)}; the {first}"


def _healthy(found, label):
    """Return the sentence on a recording without a fault."""
    if found.remembers:
        tested = round(found.tested * found.windows)
        return (
            f"No fault found: none of {tested} samples is proved to contradict the model and the samples "
            f"before it."
        )
    if found.faulty is not None:
        every = (
            f"every sample of {round(found.tested * found.windows)} windows fits what the samples "
            f"before "
            f"it allow"
        )
        slow = (
            ""
            if found.counts["CONSISTENT"]
            else "; a fault that grows slowly may hide, which windows (no --method) may show"
        )
        return f"No fault proved: {every}{slow}."
    decided, count = found.counts["CONSISTENT"], found.windows
    every = (
        f"all {count} windows"
        if decided == count
        else f"{decided} of {count} windows ({percent(found.decided)})"
    )
    used = ""
    if found.at is not None and np.isfinite(found.margin):
        used = f"; the tightest, at {label(found.at)}, uses {percent(1 - found.margin)} of them"
    return f"No fault found: the model explains {every} within its bounds{used}."
