"""What the test of a recording comes to: how much is decided, the worst window, and the verdict in a sentence."""

import numpy as np

from jaxbound.recordings.plaintext import percent, times
from jaxbound.runs.digest import Digest
from jaxbound.sets.floats.status import Status

__all__ = ["CODES", "alarm_total", "bound_hints", "coverage", "samples", "summary", "windows", "worst", "worst_window"]

CODES = {"no fault": 0, "fault": 1, "too little evidence": 3}  # at which a command ends


def coverage(res):
    """Return the share of windows that are proved one way or the other."""
    counts, count = res.counts, windows(res)
    return (counts["CONSISTENT"] + counts["FAULT"]) / count if count > 0 else 0.0


def windows(res):
    """Return how many windows there are: the warm-up is none, nor is what the model's `where` leaves out."""
    return samples(res) - res.relations.horizon - res.aside


def samples(res):
    """Return how many samples were tested."""
    return sum(res.counts.values())


def worst(res):
    """Return (index, margin) of the FAULT window with the smallest margin (without FAULT: of any window), (None, NaN) if there is none."""
    if isinstance(res, Digest):
        return res.worst or (None, np.nan)
    fault = res.status == Status.FAULT
    margin = np.where(fault if fault.any() else True, res.margin, np.nan)
    if not np.isnan(margin).all():
        k = int(np.nanargmin(margin))
        return k, float(res.margin[k])
    return (int(np.argmax(fault)) if fault.any() else None), np.nan


def worst_window(res):
    """Return the index of the worst window, or None. See `worst`."""
    return worst(res)[0]


def alarm_total(res, alarms):
    """Return how many alarms there are; a Digest keeps the deepest only."""
    return res.alarm_count if isinstance(res, Digest) else len(alarms)


def summary(res, alarms, label, min_coverage=0.5):
    """Return (verdict, sentence): "fault", "too little evidence" or "no fault", and what a plant engineer should know in a sentence.

    Args:
        res: a Result of one recording, or a Digest. alarms: its alarms. label: index -> text of its time.
        min_coverage: below it, no fault is no news.
    """
    counts, share, (at, margin) = res.counts, coverage(res), worst(res)
    count, faults, alarm_count = windows(res), counts["FAULT"], alarm_total(res, alarms)
    decided = counts["CONSISTENT"] + faults
    factor = None if np.isnan(margin) else 1 - margin
    if faults > 1 and faults == decided + counts["UNDECIDED"]:
        by = f": all bounds times about {times(factor).removesuffix(' times')} would make every window consistent" if factor else ""
        return "fault", f"Every one of the {faults} windows with data is FAULT: the model or its bounds do not fit this recording{by}."
    if faults:
        many = f"{faults} of {count} windows ({percent(faults / count)}) cannot be explained by any behaviour inside the bounds"
        need = f"; the first is at {label(at)}"
        if factor:
            need = f"; the worst, at {label(at)}, would need bounds {times(factor)} as wide"
        grouped = f", in {alarm_count} alarm{'s' * (alarm_count != 1)}" if alarm_count else ", too scattered for an alarm"
        return "fault", f"Fault proved: {many}{grouped}{need}."
    if share < min_coverage:
        return "too little evidence", (
            f"Too little evidence: only {decided} of {count} windows ({percent(share)}) could be decided, "
            f"at least {percent(min_coverage)} are asked for."
        )
    used = f"; the tightest, at {label(at)}, uses {percent(factor)} of them" if factor is not None else ""
    every = f"all {count} windows" if decided == count else f"{decided} of {count} windows ({percent(share)})"
    return "no fault", f"No fault found: the model explains {every} within its bounds{used}."


def bound_hints(model):
    """Return sentences on bounds that nobody can mean."""
    bare = [s for s, *b in zip(model.outputs, model.tolerance, model.noise, model.resolution, strict=True) if not any(b)]
    none = f"the model states no tolerance, noise or resolution for {', '.join(bare)}: any measuring error there is a FAULT"
    return [none] if bare else []
