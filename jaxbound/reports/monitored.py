"""Sections of the page of a monitor: its tests beside each other, and who watched when."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from jaxbound.consistency.monitorbank import MonitorBank
from jaxbound.diagnosis.monitored import MonitorResult
from jaxbound.diagnosis.result import Result
from jaxbound.models.watched import NO, UNKNOWN, YES
from jaxbound.recordings.recording import Recording
from jaxbound.runs.counts import STRETCHES, CountsByTest, OfTest, Unwatched
from jaxbound.runs.digest import Digest
from jaxbound.text.quantities import percent, three_digits

ORDER = ("FAULT", "CONSISTENT", "UNDECIDED", "MISSING")
Label = Callable[[int], str]
"""The function that writes the time of a sample, from its number."""
Section = tuple[str, None, str, list[tuple[object, ...]]]
"""(title, no picture, text, rows of a table, the first of them its head)."""


class _Watched(NamedTuple):
    """The counts of a monitor over a recording.

    Fields: by_test: of each test. unwatched: the stretches without a verdict. known: how many samples before
    the first that is counted.
    """

    by_test: CountsByTest
    unwatched: Unwatched
    known: int = 0


def monitor_sections(res: Result | Digest, label: Label) -> list[Section]:
    """Return the sections on the tests of a monitor, and on the samples that none of them watched; none where
    another test judged.

    Args:
        res: of one recording. label: number of a sample -> text of its time.
    """
    watched = _monitor_counts(res)
    if watched is None:
        return []
    bank: MonitorBank = res.relations  # type: ignore[assignment]  # it was watched

    def fresh_label(k: int) -> str:
        return label(watched.known + k)

    tests: Mapping[str, OfTest] = watched.by_test.tests()
    rows: list[tuple[object, ...]] = [
        ("test", "looks back over", "watches", *ORDER, "speaks", "first FAULT", "least margin")
    ]
    for watch in bank.watches:
        cells = _cells(tests[watch.name], fresh_label)
        rows.append((watch.name, watch.about, watch.when or "always", *cells))
    text = (
        "A sample is FAULT where any test proves it. The test that speaks is the one with the least margin, "
        "of those that prove a FAULT, else of all."
    )
    if bank.observes:
        text += " UNDECIDED of an observer is not refuted, which is what a healthy sample is."
    return [("Tests", None, text, rows), _coverage(watched, bank, fresh_label)]


def _monitor_counts(res: Result | Digest) -> _Watched | None:
    """Return the counts of a monitor; None where another test judged."""
    if isinstance(res, MonitorResult):
        counted, unwatched, fresh = CountsByTest(res.relations), Unwatched(), slice(res.known, None)
        piece, judged = Recording(np.asarray(res.u)[fresh], np.asarray(res.y)[fresh]), res.judged(fresh)
        counted.add(piece, judged)
        unwatched.add(piece, judged)
        return _Watched(counted, unwatched.finish(), res.known)
    if isinstance(res, Digest) and res.by_test is not None and res.unwatched is not None:
        return _Watched(res.by_test, res.unwatched)
    return None


def _cells(test: OfTest, label: Label) -> list[object]:
    """Return the cells of a test: its counts, how often it speaks, its first FAULT, its least margin."""
    counts: list[object] = [test.counts[name] for name in ORDER]
    first, margin = "", ""
    if test.first is not None:
        first = label(test.first)
    if np.isfinite(test.margin):
        margin = three_digits(test.margin)
    return [*counts, test.speaks, first, margin]


def _coverage(watched: _Watched, bank: MonitorBank, label: Label) -> Section:
    """Return the section on modes, and on the stretches in which no test has a verdict."""
    unwatched, modes = watched.unwatched, watched.by_test.modes
    samples = unwatched.samples
    rows: list[tuple[object, ...]] = [("", "from", "to", "samples", "share")]
    for c, condition in enumerate(bank.conditions):
        for value, words in ((YES, "holds"), (NO, "does not hold"), (UNKNOWN, "is unknown")):
            count = int(modes[c, value])
            if not count:
                continue
            rows.append((f"{condition} {words}", "", "", count, percent(count / max(samples, 1))))
    for first, stop in unwatched.longest.tolist():
        share = percent((stop - first) / max(samples, 1))
        rows.append(("nobody watched", label(first), label(stop - 1), stop - first, share))
    stretches = f"{unwatched.count} stretch{'es' * (unwatched.count != 1)}"
    text = f"No test has a verdict at {unwatched.missing} of {samples} samples, in {stretches}."
    if unwatched.count > STRETCHES:
        text += f" The {STRETCHES} longest are in the table."
    return "Who watched when", None, text, rows
