"""Alarms: FAULT windows grouped for people. Separate from the proof, which they never change."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

from jaxbound.certificates.diagnosis import Diagnosis
from jaxbound.certificates.interface import WindowCertificate
from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.causes import Explained, Judged, diagnose
from jaxbound.diagnosis.watch import NO_DATA, NO_SAMPLE, Raised
from jaxbound.models.named_faults import NamedFault
from jaxbound.recordings.timestamps import label_text
from jaxbound.text.objects import readable

ENDINGS = (
    "still on at the last sample",
    "no data after it",
    "its onset may have left the window: repaired or lasting",
    "seen beyond its onset and no longer: repaired or hidden",
    "the observer began anew behind it: repaired or lasting",
    "a gap ended it, FAULT stays until one: repaired or lasting",
)
ONSET_LEFT, NO_LONGER, BEGAN_ANEW, GAP = ENDINGS[2:]
LATCHED = -1
"""In place of the horizon of windows: an observer whose FAULT stays until a gap."""


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
    alone could be wrong in the window in which its FAULT began, the most plausible first, where the rule
    names them; size:
    errors of the first of up to this size, another at each sample, explain the window at `worst`, no smaller
    ones, in its unit, NaN where it is none of a sensor (`diagnose` has the sizes of a constant one); cause:
    in this window, too, the most plausible of the faults that the model names, with its sizes; the size is
    that of the first window where this signal does not explain the worst one alone. `diagnose` looks at more
    windows of the alarm; test: of a monitor the name of the test that speaks at sample `worst`, else "";
    ended: why it is over, of which no verdict is a proof, one of

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
    result: Explained | None = field(default=None, compare=False)
    ended: str = ""
    outside: int | None = None
    outside_by: str = ""
    suspects: tuple[str, ...] = ()
    size: float = field(default=math.nan, compare=False)
    test: str = ""
    cause: str = field(default="", compare=False)

    @property
    def times(self) -> tuple[object, ...]:
        """The times of its first and its last sample, as the index of the recording has them: Timestamps,
        datetime64, seconds; () where nothing tells them.
        """
        if self.result is None:
            return ()
        times = self.result.when(self.start), self.result.when(self.end)
        if times[0] is None:
            return ()
        return times

    def __repr__(self) -> str:
        known = [f"{name}={value!r}" for name, value in self._known().items()]
        return f"Alarm({', '.join(known)})"

    def _rows(self) -> dict[str, str]:
        return {name: str(value) for name, value in self._known().items()}

    def _known(self) -> dict[str, object]:
        """Return the fields that say something, by their names, with numbers as a reader wants them."""
        known: dict[str, object] = {"start": self.start, "end": self.end}
        if self.times:
            first, last = map(label_text, self.times)
            known["times"] = f"{first} to {last}"
        known |= {"windows": self.windows, "depth": float(f"{self.depth:.4g}"), "worst": self.worst}
        for name in ("recording", "outside", "outside_by", "suspects"):
            known[name] = getattr(self, name)
        if not math.isnan(self.size):
            known["size"] = float(f"{self.size:.4g}")
        for name in ("cause", "test", "ended"):
            known[name] = getattr(self, name)
        return {name: value for name, value in known.items() if value not in ("", (), None)}

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


def ending_of(raised: Raised, horizon: int | None) -> str:
    """Return why an alarm is over, one of ENDINGS.

    Args:
        horizon: of the windows. The onset is no later than `first`, and a window that ends at `first +
            horizon` or later has no sample before that. None: of an observer, which leaves what it
            contradicts only to begin anew; LATCHED: only at a gap.
    """
    if raised.after == NO_SAMPLE:
        return ENDINGS[0]
    if horizon is None:
        return BEGAN_ANEW
    if horizon == LATCHED:
        return GAP
    if raised.after == NO_DATA:
        return ENDINGS[1]
    if raised.last - raised.first < horizon:
        return ONSET_LEFT
    return NO_LONGER
