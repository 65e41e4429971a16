"""Alarms: FAULT windows grouped for people. Separate from the proof, which they never change."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.certificates.diagnosis import Diagnosis
from jaxbound.certificates.interface import WindowCertificate
from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.causes import Judged, diagnose
from jaxbound.diagnosis.region import farthest_of
from jaxbound.diagnosis.suspects import Suspect
from jaxbound.diagnosis.watch import ENDS, NO_DATA, NO_SAMPLE, OTHER, Event, Raised, Seen, Watch
from jaxbound.models.named_faults import NamedFault
from jaxbound.models.region import Departure
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable

__all__ = [
    "BEGAN_ANEW",
    "ENDINGS",
    "GAP",
    "NO_DATA",
    "NO_LONGER",
    "ONSET_LEFT",
    "OTHER",
    "Alarm",
    "alarm_of",
    "endings",
    "forgets_after",
    "follows",
    "group_alarms",
    "over_of",
    "stretches",
]

ENDINGS = (
    "still on at the last sample",
    "no data after it",
    "its onset may have left the window: repaired or lasting",
    "seen beyond its onset and no longer: repaired or hidden",
    "the observer began anew behind it: repaired or lasting",
    "a gap ended it, FAULT stays until one: repaired or lasting",
)
ONSET_LEFT, NO_LONGER, BEGAN_ANEW, GAP = ENDINGS[2:]
Blame = Callable[[tuple[int, ...]], Suspect]
LATCHED = -1
"""In place of the horizon of windows: an observer whose FAULT stays until a gap."""


class Explained(Protocol):
    """Verdicts whose windows are explained."""

    def explain(self, at: int) -> WindowCertificate:
        """Return the certificate of the window that ends at a sample; of a batch `at` is a tuple."""


class Grouped(Explained, Protocol):
    """Verdicts that are grouped into alarms, as a Result has them."""

    @property
    def status(self) -> np.ndarray:
        """(..., T)."""

    @property
    def margin(self) -> np.ndarray:
        """(..., T)."""

    @property
    def departure(self) -> Departure | None:
        """(..., T), from the region of training; None: it is not known."""


@runtime_checkable
class Isolated(Protocol):
    """Verdicts that leave some single faults."""

    def remaining(self, start: int, end: int, recording: tuple[int, ...] = ()) -> tuple[str, ...]:
        """Return the single faults that can explain every FAULT window between two samples."""


@readable
@dataclass(frozen=True)
class Alarm:
    """A stretch of FAULT windows.

    Fields: start, end: first and last sample (inclusive); windows: how many are FAULT; depth: the worst
    margin (< 0), reached at sample `worst`; recording: index of the recording in a batch, () for a single
    one; result: what the alarm was found in; outside: how many of its FAULT windows lie outside the region of
    training, None where there is none; outside_by: the farthest of them in words; suspects: the signals that
    alone could be wrong in its first window, the most plausible first, where the rule names them; size:
    errors of the first of up to this size, another at each sample, explain this window, no smaller ones, in
    its unit, NaN where it is none of a sensor (`diagnose` has the sizes of a constant one);
    cause: in this window, too, the most plausible of the faults that the model names, with its sizes;
    `diagnose` looks at more windows of the alarm; test: of a monitor the name of the test that speaks at
    sample `worst`, else ""; ended: why it is over, of
    which no verdict is a proof, one of

    - "still on at the last sample", "no data after it";
    - "its onset may have left the window: repaired or lasting": every FAULT window reaches back to the first
      one, so a fault that lasts would look the same. From which size on a lasting one is sure to be seen:
      `detectable`;
    - "seen beyond its onset and no longer: repaired or hidden": a window without the onset is FAULT too, so
      the fault was seen while it lasted; now it is gone, or noise within the bounds hides it;
    - "the observer began anew behind it: repaired or lasting": an observer forgets what was contradicted, and
      may take what lasts for the state;
    - "a gap ended it, FAULT stays until one: repaired or lasting": of an observer with restart=False;
    - "ended by an opposite jump of T1", "acknowledged", "open at the end: nothing speaks for a repair": of a
      rule with latch.
    """

    start: int
    end: int
    windows: int
    depth: float
    worst: int
    recording: tuple[int, ...] = ()
    result: Explained | None = field(default=None, repr=False, compare=False)
    ended: str = field(default="", repr=False)
    outside: int | None = field(default=None, repr=False)
    outside_by: str = field(default="", repr=False)
    suspects: tuple[str, ...] = ()
    size: float = field(default=math.nan, compare=False)
    test: str = ""
    cause: str = field(default="", compare=False)

    @property
    def suspect(self) -> str:
        """The most plausible of the suspects, "" where there is none, or the rule names none."""
        return (*self.suspects, "")[0]

    @cached_property
    def certificate(self) -> WindowCertificate:
        """The Certificate of the worst window, worked out at the first call."""
        if self.result is None:
            raise ValueError(
                "this alarm came without the result it was found in: ask that to explain its worst window"
            )
        at: Any = self.worst  # a tuple is for those alone that have recordings side by side
        if self.recording:
            at = (*self.recording, self.worst)
        return self.result.explain(at)

    def diagnose(self, faults: Sequence[NamedFault] | None = None) -> Diagnosis:
        """Return the Diagnosis of the alarm: see `Result.diagnose`. Of an alarm that was found in pieces of a
        file it is that of its worst window.
        """
        if isinstance(self.result, Judged):
            return diagnose(self.result, self.start, self.end, faults, self.recording)
        return self.certificate.diagnose(faults)

    @property
    def errors(self) -> Mapping[str, Fraction | float]:
        """{output: the smallest error of that sensor alone that would explain the worst window}, exact; see
        `Certificate.errors`.
        """
        return self.certificate.errors

    @property
    def candidates(self) -> tuple[str, ...]:
        """The outputs whose sensor alone could be wrong in the worst window, the most plausible first, then
        inputs whose actuator could.

        Of any other signal it is proved that no error of it alone explains the alarm.
        """
        if isinstance(self.result, Isolated):  # a bank says it of all windows of the alarm at once
            return self.result.remaining(self.start, self.end, self.recording)
        return self.certificate.candidates


def group_alarms(
    result: Grouped,
    rule: AlarmRule,
    horizon: int | None,
    margin: np.ndarray | None = None,
    counts: np.ndarray | None = None,
    blame: Blame | None = None,
    instants: np.ndarray | None = None,
) -> list[Alarm]:
    """Group the FAULT windows of a Result: see `Result.alarms`. Array operations over time; the loop is over
    alarms.

    Args:
        rule: that is `fitted`.
        horizon: of the windows; 0 where verdicts rest on all samples before, so that an onset leaves no
            window; of an observer None, or LATCHED.
        margin: (..., T), by which the worst window of an alarm is chosen; None: that of the result.
        counts: (..., T) bool, the FAULT windows that the rule counts; None: all.
        blame: the suspects of the FAULT window at an index; None: nothing tells them.
        instants: (T,) times by which alarms are acknowledged; None: nobody does.
    """
    *batch, T = result.status.shape
    recordings = math.prod(batch)
    if margin is None:
        margin = result.margin
    status, margin = result.status.reshape(recordings, T), margin.reshape(recordings, T)
    fault, missing = status == Status.FAULT, status == Status.MISSING
    if counts is not None:
        fault = counts.reshape(recordings, T)
    alarms = []
    for row in np.flatnonzero(fault.any(1)):
        recording = tuple(map(int, np.unravel_index(row, tuple(batch))))
        if rule.names:
            about = result, recording, rule, horizon, blame, instants
            alarms += _by_suspect(*about, fault[row], margin[row], missing[row])
            continue
        *columns, first, last = stretches(fault[row], margin[row], rule.k, rule.n, rule.hold, rule.clear)
        codes = endings(first, last, follows(missing[row], columns[1]), horizon)
        outside = _outside(result, recording, fault[row], columns[0], columns[1])
        rows = zip(*map(np.ndarray.tolist, columns), codes.tolist(), *outside, strict=True)
        for start, end, windows, depth, worst, code, count, words in rows:
            why = ENDINGS[code]
            alarms.append(Alarm(start, end, windows, depth, worst, recording, result, why, count, words))
    return alarms


def _by_suspect(
    result: Grouped,
    recording: tuple[int, ...],
    rule: AlarmRule,
    horizon: int | None,
    blame: Blame | None,
    instants: np.ndarray | None,
    fault: np.ndarray,
    margin: np.ndarray,
    missing: np.ndarray,
) -> list[Alarm]:
    """Return the alarms of one recording by a rule that names suspects, in the order in which they begin."""
    watch = Watch(rule)
    if blame is not None:
        of_batch = blame

        def blamed(sample: int) -> Suspect:
            return of_batch((*recording, sample))

        watch.blame = blamed
    departure = result.departure
    if departure is not None:
        departure = departure.cut(recording)
    over = [*watch.add(Seen.of(fault, margin, missing, departure, instants)), *watch.finish()]
    found = []
    for raised in sorted(over_of(over), key=lambda alarm: alarm.number):
        found.append(alarm_of(raised, horizon, departure, recording, result))
    return found


def over_of(events: Sequence[Event]) -> list[Raised]:
    """Return the alarms that end among events."""
    return [event.alarm for event in events if event.kind == ENDS]


def alarm_of(
    raised: Raised,
    horizon: int | None,
    departure: Departure | None = None,
    recording: tuple[int, ...] = (),
    result: Explained | None = None,
) -> Alarm:
    """Return the Alarm of one that is over.

    Args:
        horizon: as for `endings`. departure: of any windows of the recording; None: there is no region.
    """
    why = raised.ended
    if not why:
        why = ENDINGS[int(endings(raised.first, raised.last, np.array([raised.after]), horizon)[0])]
    outside, words = None, ""
    if departure is not None:
        outside = raised.outside
        share, by, reading = raised.farthest
        if share > 0:
            words = departure.region.words(by, reading)
    about = raised.start, raised.end, raised.windows, raised.depth, raised.worst
    suspect = raised.suspect
    named = suspect.names, suspect.size
    return Alarm(*about, recording, result, why, outside, words, *named, cause=suspect.cause)


def _outside(
    result: Grouped, recording: tuple[int, ...], fault: np.ndarray, start: np.ndarray, end: np.ndarray
) -> tuple[Sequence[int | None], Sequence[str]]:
    """Return (how many FAULT windows of each alarm lie outside the region of training, the farthest in
    words).
    """
    departure = result.departure
    if departure is None:
        return [None] * len(start), [""] * len(start)
    counts, farthest = farthest_of(departure.cut(recording), fault, start, end)
    return counts.tolist(), farthest.words()


def forgets_after(relations: Relations) -> int | None:
    """Return how many samples after an onset no window of relations holds it any more: their horizon.

    Of an observer None, LATCHED where its FAULT stays until a gap; of a monitor as of its longest test.
    """
    if relations.parts:
        ends = [forgets_after(test) for test in relations.parts.values()]
        if None in ends:
            return None
        if LATCHED in ends:
            return LATCHED
        return max(end for end in ends if end is not None)
    if relations.latched:
        return LATCHED
    if relations.remembers:
        return None
    return relations.horizon


def follows(missing: np.ndarray, end: ArrayLike) -> np.ndarray:
    """Return NO_SAMPLE, NO_DATA or OTHER: what comes after each alarm that ends at samples `end`.

    Args: missing: (T,) bool, windows without data.
    """
    after = np.append(np.where(missing, NO_DATA, OTHER), NO_SAMPLE)
    return np.asarray(after[np.asarray(end, int) + 1])


def endings(
    first: int | np.ndarray, last: int | np.ndarray, after: np.ndarray, horizon: int | None
) -> np.ndarray:
    """Return for each alarm the number of its entry in ENDINGS.

    Args:
        first, last: its first and last FAULT window. after: NO_SAMPLE, NO_DATA or OTHER. horizon: of the
            windows. The onset is no later than `first`, and a window that ends at `first + horizon` or later
            has no sample before that. None: of an observer, which leaves what it contradicts only to begin
            anew; LATCHED: only at a gap.
    """
    if horizon is None:
        return np.where(after == NO_SAMPLE, 0, ENDINGS.index(BEGAN_ANEW))
    if horizon == LATCHED:
        return np.where(after == NO_SAMPLE, 0, ENDINGS.index(GAP))
    return np.where(after == OTHER, np.where(last - first < horizon, 2, 3), after)


def stretches(
    fault: np.ndarray,
    margin: np.ndarray,
    k: int,
    n: int,
    hold: int,
    clear: int,
    before: Sequence[bool] | np.ndarray = (),
) -> tuple[np.ndarray, ...]:
    """Return (start, end, windows, depth, worst, first, last) of the alarms of one recording, an array each:
    as in `Alarm`, and the first and the last FAULT window that made it.

    Args:
        fault: (T,) bool. margin: (T,). k, n, hold, clear: see `Result.alarms`.
        before: the entries of `fault` that came before, n - 1 at most.
    """
    count = np.cumsum(np.concatenate([np.zeros(n - len(before), int), before, fault]).astype(int))
    on = np.flatnonzero(count[n:] - count[:-n] >= k)
    if not len(on):
        return on, on, on, margin[on], on, on, on
    breaks = np.flatnonzero(np.diff(on) > hold + clear)  # quiet samples between two: their distance - 1
    starts = on[np.concatenate([[0], breaks + 1])]
    ends = np.minimum(on[np.concatenate([breaks, [len(on) - 1]])] + hold, len(fault) - 1)
    lengths = ends - starts + 1
    alarm = np.repeat(np.arange(len(starts)), lengths)
    rows = np.arange(len(alarm)) + np.repeat(starts - np.cumsum(lengths) + lengths, lengths)
    depth = np.where(fault, np.where(np.isnan(margin), -np.inf, margin), np.inf)[rows]
    first = np.cumsum(lengths) - lengths
    deepest = np.flatnonzero(depth == np.minimum.reduceat(depth, first)[alarm])
    worst = rows[deepest[np.searchsorted(alarm[deepest], np.arange(len(starts)))]]
    # of all FAULT windows: the rule counts some that an alarm begins after
    at = np.flatnonzero(np.concatenate([before, fault])) - len(before)
    made = at[np.searchsorted(at, starts - n + 1)], at[np.searchsorted(at, ends, "right") - 1]
    return starts, ends, np.add.reduceat(fault[rows].astype(int), first), margin[worst], worst, *made
