"""Times on an axis as the recording's owner wrote them: found from labels, one pattern serves text, axes and
script.
"""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from jaxbound.recordings.recording import Recording
from jaxbound.recordings.timestamps import EPOCH, SECOND
from jaxbound.text.characters import printable

ORDERS = ("Ymd", "dmY", "mdY", "")
ISO = ("Y4", "-", "m2", "-", "d2", " ", "H2", ":", "M2", ":", "S2")
TRIED = 9  # labels that a pattern is checked with


@dataclass(frozen=True)
class AxisClock:
    """How the time x of a sample, in s, is written.

    Fields: tokens: ("d2", ".", "m2", ...), a field and its least number of digits, or text as it is; empty:
    numbers. base: s from 1970 to x = 0, as the fields count them. digits: behind the point of a number. unit:
    what stands behind it; before: what stands before it.
    """

    tokens: Sequence[str] = ()
    base: float = 0.0
    digits: int = 0
    before: str = ""
    unit: str = ""

    def text(self, x: float) -> str:
        """Return a time as text.

        Example:
            >>> AxisClock(ISO, 1.7e9).text(60.0), AxisClock(unit=" s", digits=2).text(0.30000001)
            ('2023-11-14 22:14:20', '0.3 s')
        """
        if self.tokens:
            return _time_text(self.tokens, self.base + x)
        short = f"{x:.{self.digits}f}"
        if "." in short:
            short = short.rstrip("0").rstrip(".")
        return f"{self.before}{short}{self.unit}"

    def plain(self) -> dict[str, Any]:
        """Return the fields as JSON has them."""
        shown = {"tokens": [printable(token) for token in self.tokens], "before": printable(self.before)}
        return vars(self) | shown


def axis_of(recording: Recording, samples: int, step: float) -> tuple[np.ndarray, AxisClock]:
    """Return (time of each sample, AxisClock) of a recording in memory. step: usual seconds between two, of a
    recording of one sample.
    """
    if not _goes_on(recording.time):
        time = np.arange(samples, dtype=float)
        return time, clock_of(lambda k: f"sample {k}", time, None, samples, 1.0)
    time = np.arange(samples, dtype=float)
    if recording.time is not None:
        time = np.asarray(recording.time, float)
    if samples > 1:
        step = float(np.median(np.diff(time)))
    stamp = None if recording.stamps is None else recording.stamps[0]
    return time, clock_of(recording.label, time, stamp, samples, step)


def shown_time(recording: Recording, samples: int) -> np.ndarray:
    """Return the time (T,) of a picture: datetime64, else s; numbers of samples where a clock goes back."""
    time = recording.time if recording.stamps is None else recording.stamps
    if time is None or not _goes_on(time):
        return np.arange(samples, dtype=float)
    return np.asarray(time)


def _goes_on(time: np.ndarray | None) -> bool:
    """Return whether times grow: a clock that goes back is no axis, the samples in their order are."""
    return time is None or bool((np.asarray(time)[1:] > np.asarray(time)[:-1]).all())


def clock_of(
    label: Callable[[int], str], time: np.ndarray, stamp: np.datetime64 | None, samples: int, step: float
) -> AxisClock:
    """Return the AxisClock of a recording.

    Args:
        label: text of the time of a sample. time: (k,) s of the samples `0 .. samples - 1`, evenly picked,
            the first and the last among them. stamp: datetime64 of the first; None: there are no dates.
            samples: how many. step: usual seconds between two.
    """
    picked = np.linspace(0, samples - 1, min(samples, TRIED)).astype(int)
    at = np.asarray(time)[np.linspace(0, len(time) - 1, len(picked)).astype(int)] - time[0]
    texts = [label(int(k)) for k in picked]
    if len(time) != samples:  # the times of samples between the ends are not at hand
        texts, at = [texts[0], texts[-1]], at[[0, -1]]
    return _dated(texts, at, stamp, float(time[0])) or _counted(texts[0], step)


def _dated(
    texts: Sequence[str], at: np.ndarray, stamp: np.datetime64 | None, first: float
) -> AxisClock | None:
    """Return the clock whose pattern gives all texts at their times, ISO where none does; None: no clock."""
    base = _midnight(texts[0]) if stamp is None else float((stamp - EPOCH) / SECOND)
    if base is None:
        return None
    body, zone = _zone(texts[0])
    shifted = base + _offset(zone)
    bodies = [text.removesuffix(zone) for text in texts]
    for tokens in _possible_patterns(body):
        if all(_time_text(tokens, shifted + x) == text for x, text in zip(at, bodies, strict=True)):
            return AxisClock((*tokens, zone) if zone else tokens, shifted - first)
    if stamp is None:
        return None
    return AxisClock((*ISO, " UTC") if zone else ISO, base - first)


def _counted(text: str, step: float) -> AxisClock:
    """Return the clock of times that are numbers, written as in a text; step: usual seconds between two."""
    if text.startswith("sample "):
        return AxisClock(before="sample ")
    digits = max(0, 2 - math.floor(math.log10(step or 1.0)))
    return AxisClock(digits=digits, unit=" s" if text.endswith(" s") else "")


def _zone(text: str) -> tuple[str, str]:
    """Return a text without its zone, and the zone."""
    found = re.search(r"(?<=[\d ])(Z|UTC|[+-]\d\d:?\d\d)$", text)
    if not found or ":" not in text:
        return text, ""
    return text[: found.start()], found[0]


def _offset(zone: str) -> float:
    """Return the seconds by which a zone is ahead of UTC."""
    digits = re.sub(r"\D", "", zone)
    if not digits:
        return 0.0
    ahead = int(digits[:2]) * 3600.0 + int(digits[2:]) * 60.0
    return -ahead if zone.startswith("-") else ahead


def _midnight(text: str) -> float | None:
    """Return the seconds since midnight of a clock without a date, or None."""
    found = re.fullmatch(r"(\d\d?):(\d\d)(?::(\d\d(?:\.\d+)?))?", text)
    if not found:
        return None
    return int(found[1]) * 3600 + int(found[2]) * 60 + float(found[3] or 0)


def _possible_patterns(text: str) -> Iterator[list[str]]:
    """Yield the patterns that a text could have: its numbers as fields, in the usual orders, with and without
    leading zeros.
    """
    parts = re.split(r"(\d+)", text)
    groups = parts[1::2]
    for order in ORDERS:
        fields = order + "HMSf"[: max(len(groups) - len(order), 0)]
        if len(fields) != len(groups) or len(groups) < 2:
            continue
        for days, hours in ((2, 2), (1, 1), (1, 2), (2, 1)):  # digits at least
            digits = dict(m=days, d=days, H=hours, M=2, S=2)
            tokens = [parts[0]]
            for field, group, gap in zip(fields, groups, parts[2::2], strict=True):
                tokens += [f"{field}{digits.get(field, len(group))}", gap]
            yield [token for token in tokens if token]


def _time_text(tokens: Sequence[str], seconds: float) -> str:
    """Return a time, in s from 1970, by a pattern."""
    whole = math.floor(round(seconds, 3))
    at = datetime(1970, 1, 1) + timedelta(seconds=whole)
    fields = {"Y": at.year, "m": at.month, "d": at.day, "H": at.hour, "M": at.minute, "S": at.second}
    out = ""
    for token in tokens:
        if token[0] in fields and token[1:].isdigit():
            out += f"{fields[token[0]]:0{token[1:]}d}"
        elif token[0] == "f" and token[1:].isdigit():
            out += f"{round(seconds, 3) - whole:.{token[1:]}f}"[2:]
        else:
            out += token
    return out
