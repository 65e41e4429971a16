"""The samples of a recording by their number and by their time.

A time is datetime64 where the recording has stamps, else seconds as a float.
"""

import re

import numpy as np

from jaxbound.recordings.recording import Recording
from jaxbound.recordings.source import Source
from jaxbound.text.quantities import decimal

__all__ = ["SampleAxis"]

ZONED = re.compile(r"(.+:[\d.]+)([+-]\d\d):?(\d\d)")  # a time with its offset from UTC


class SampleAxis:
    """The samples of a Source by number and by time; only those that are asked for are read, where it can."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.samples: int = source.samples or 0  # None where nobody has counted: a report has
        self.is_stamped = self._one(0).stamps is not None

    def label(self, k: int) -> str:
        """Return the time of sample k as text."""
        return self._one(k).label(0)

    def find(self, text: str) -> int:
        """Return the number of the sample that a text names: a whole number is a sample, anything else a
        time.

        Raises:
            ValueError: no such sample, with a sentence on what there is.
        """
        text = text.strip()
        if text.removeprefix("-").isdecimal() and text.isascii():
            return self._numbered(text)
        k = self.source.find(text)
        if k is not None:
            return k
        time = self._parsed(text)
        nearest = self._nearest(time)
        step = abs(self._axis(self.samples - 1)[0] - self._axis(0)[0]) / max(self.samples - 1, 1)
        if abs(self._axis(nearest)[0] - time) > step / 2:
            ends = f"the recording runs from {self.label(0)} to {self.label(self.samples - 1)}"
            raise ValueError(f"no sample lies at {text}: the nearest is at {self.label(nearest)}; {ends}")
        return nearest

    def _numbered(self, text: str) -> int:
        if 0 <= int(text) < self.samples:
            return int(text)
        other = f"; for the time write --at {text}s" if self.also_a_time(text) else ""
        raise ValueError(
            f"there is no sample {text}: the recording has {self.samples}, numbered from 0{other}"
        )

    def _nearest(self, time: np.datetime64 | float) -> int:
        """Return the number of the sample that lies nearest to a time."""
        low, high = 0, self.samples - 1  # the last sample that is not later is between them
        while low < high:
            middle = (low + high + 1) // 2
            if self._axis(middle)[0] <= time:
                low = middle
            else:
                high = middle - 1
        neighbours = [k for k in (low, low + 1) if k < self.samples]
        return min(neighbours, key=lambda k: abs(self._axis(k)[0] - time))

    def also_a_time(self, text: str) -> str:
        """Return a sentence where the number of a sample is a time of the recording, too, and of another
        sample; else "".
        """
        text = text.strip()
        if not (text.isascii() and text.isdecimal()) or self.is_stamped or not self.label(0).endswith(" s"):
            return ""
        if not self._axis(0)[0] <= int(text) <= self._axis(self.samples - 1)[0]:
            return ""
        if self.label(min(int(text), self.samples - 1)) == f"{text} s":
            return ""
        return f"sample {text}; for the time write --at {text}s"

    def _parsed(self, text: str) -> np.datetime64 | float:
        try:
            if self.is_stamped:
                return _moment(text.replace(" ", "T").removesuffix("Z"))
            return decimal(text.removesuffix("s"))
        except ValueError:
            like = f"its time as alarms.csv has it, like {self.label(0)}"
            raise ValueError(f"--at {text} names no sample: give its number, or {like}") from None

    def _axis(self, k: int) -> np.ndarray:
        """Return the time of sample k, (1,)."""
        axis = self._one(k).axis
        assert axis is not None, "a sample that is read has a time, or a number in its place"
        return axis

    def _one(self, k: int) -> Recording:
        return self.source.read(k, k + 1)


def _moment(text: str) -> np.datetime64:
    """Return a time in UTC from its text, which may have an offset; raise ValueError for none."""
    zoned = ZONED.fullmatch(text)
    if zoned is None:
        return np.datetime64(text, "ns")
    local, hours, minutes = zoned.groups()
    offset = np.timedelta64(int(hours), "h") + np.timedelta64(int(f"{hours[0]}{minutes}"), "m")
    moment: np.datetime64 = np.datetime64(local, "ns") - offset
    return moment
