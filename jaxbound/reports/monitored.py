"""Sections of the page of a monitor: its tests beside each other, and who watched when."""

from collections.abc import Callable

import numpy as np

from jaxbound.consistency.monitorbank import NO, UNKNOWN, YES, MonitorBank
from jaxbound.diagnosis.monitored import MonitorResult
from jaxbound.runs.summary import OfTest, evidence
from jaxbound.sets.floats.status import Status
from jaxbound.text.quantities import percent

__all__ = ["monitor_sections"]

STRETCHES = 10
"""Stretches that nobody watched, of which the page shows the longest."""
ORDER = ("FAULT", "CONSISTENT", "UNDECIDED", "MISSING")
Label = Callable[[int], str]
"""The function that writes the time of a sample, from its number."""
Section = tuple[str, None, str, list[tuple[object, ...]]]
"""(title, no picture, text, rows of a table, the first of them its head)."""


def monitor_sections(res: MonitorResult, label: Label) -> list[Section]:
    """Return the sections on the tests of a monitor, and on the samples that none of them watched.

    Args:
        res: of one recording. label: number of a sample -> text of its time.
    """
    tests = evidence(res, ()).tests or {}
    bank: MonitorBank = res.relations
    rows: list[tuple[object, ...]] = [
        ("test", "looks back over", "watches", *ORDER, "speaks", "first FAULT", "least margin")
    ]
    for watch in bank.watches:
        rows.append((watch.name, watch.about, watch.when or "always", *_cells(tests[watch.name], label)))
    text = (
        "A sample is FAULT where any test proves it. The test that speaks is the one with the least margin, "
        "of those that prove a FAULT, else of all."
    )
    if bank.observes:
        text += " UNDECIDED of an observer is not refuted, which is what a healthy sample is."
    return [("Tests", None, text, rows), _coverage(res, bank, label)]


def _cells(test: OfTest, label: Label) -> list[object]:
    """Return the cells of a test: its counts, how often it speaks, its first FAULT, its least margin."""
    counts: list[object] = [test.counts[name] for name in ORDER]
    first, margin = "", ""
    if test.first is not None:
        first = label(test.first)
    if np.isfinite(test.margin):
        margin = f"{test.margin:.3g}"
    return [*counts, test.speaks, first, margin]


def _coverage(res: MonitorResult, bank: MonitorBank, label: Label) -> Section:
    """Return the section on modes, and on the stretches in which no test has a verdict."""
    samples, modes = len(res.status), bank.modes_of(np.asarray(res.u))
    missing = res.status == Status.MISSING
    edges = np.flatnonzero(np.diff(missing, prepend=False, append=False)).reshape(-1, 2)
    longest = edges[np.argsort(edges[:, 0] - edges[:, 1], kind="stable")[:STRETCHES]]
    rows: list[tuple[object, ...]] = [("", "from", "to", "samples", "share")]
    for c, condition in enumerate(bank.conditions):
        for value, words in ((YES, "holds"), (NO, "does not hold"), (UNKNOWN, "is unknown")):
            count = int(np.count_nonzero(modes[:, c] == value))
            if not count:
                continue
            rows.append((f"{condition} {words}", "", "", count, percent(count / max(samples, 1))))
    for first, stop in longest[np.argsort(longest[:, 0])].tolist():
        share = percent((stop - first) / max(samples, 1))
        rows.append(("nobody watched", label(first), label(stop - 1), stop - first, share))
    count = int(np.count_nonzero(missing))
    stretches = f"{len(edges)} stretch{'es' * (len(edges) != 1)}"
    text = f"No test has a verdict at {count} of {samples} samples, in {stretches}."
    if len(edges) > STRETCHES:
        text += f" The {STRETCHES} longest are in the table."
    return "Who watched when", None, text, rows
