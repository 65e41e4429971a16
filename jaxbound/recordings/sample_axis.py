"""The samples of a recording by their number and by their time: of a file, of which only those that are asked
for are read, and of rows with labels in memory.

A time is datetime64 where the recording has stamps, else seconds as a float.
"""

from __future__ import annotations

import numbers
import operator
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from jaxbound.recordings.recording import Recording
from jaxbound.recordings.source import Source
from jaxbound.recordings.tabletime import RowTime, plain_labels, row_time
from jaxbound.recordings.timestamps import EPOCH, SECOND, instant_of, row_label
from jaxbound.text.quantities import decimal

if TYPE_CHECKING:
    import pandas as pd

Place: TypeAlias = Any
"""What names a sample: its number, or its time, as text, a datetime, a datetime64 or a Timestamp."""
Labels: TypeAlias = "pd.Index | np.ndarray | None"


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
        if _is_number(text):
            return self._numbered(text)
        k = self.source.find(text)
        if k is not None:
            return k
        time = self._parsed(text)
        nearest = self._nearest(time)
        step = abs(self._axis(self.samples - 1)[0] - self._axis(0)[0]) / max(self.samples - 1, 1)
        if abs(self._axis(nearest)[0] - time) > step / 2:
            raise ValueError(
                _nothing_at(text, self.label(nearest), self.label(0), self.label(self.samples - 1))
            )
        return nearest

    def _numbered(self, text: str) -> int:
        if 0 <= int(text) < self.samples:
            return int(text)
        other = f"; for the time write --at {text}s" if self.also_a_time(text) else ""
        raise ValueError(_no_number(int(text), self.samples) + other)

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
        if (
            not _is_number(text)
            or text.startswith("-")
            or self.is_stamped
            or not self.label(0).endswith(" s")
        ):
            return ""
        if not self._axis(0)[0] <= int(text) <= self._axis(self.samples - 1)[0]:
            return ""
        if self.label(min(int(text), self.samples - 1)) == f"{text} s":
            return ""
        return f"sample {text}; for the time write --at {text}s"

    def _parsed(self, text: str) -> np.datetime64 | float:
        try:
            if self.is_stamped:
                return np.datetime64(round(instant_of(text) * 1e6), "us")
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


def place_of(
    at: Place | tuple[Place, ...], shape: tuple[int, ...], index: Labels = None, dt: float | None = None
) -> tuple[int, ...]:
    """Return the index of one sample in arrays of recordings.

    Args:
        at: the sample, behind the numbers of its recording in a tuple where there are several. shape: of the
            arrays, (..., T). index: labels of the T rows, None: they have none. dt: sampling period in s.

    Raises:
        ValueError: no such recording or sample, with a sentence on what there is.
    """
    given: tuple[Place, ...] = (at,)
    if isinstance(at, tuple):
        given = at
    *recordings, samples = shape
    if len(given) != len(shape):
        there = "there is one recording, name the sample alone"
        if recordings:
            example = (*[0] * len(recordings), samples - 1)
            there = f"there are {tuple(recordings)} recordings, name one and its sample, like {example}"
        raise ValueError(f"{at!r} names no window: {there}")
    *which, sample = given
    place = [numbered(x, count, "recording") for x, count in zip(which, recordings, strict=True)]
    return (*place, row_of(sample, samples, index, dt))


def row_of(at: Place, samples: int, index: Labels = None, dt: float | None = None) -> int:
    """Return the number of the row that is named by its number, or by its time.

    A whole number in text is a number as well, as on the command line. A time without a zone is one of the
    zone of the index.

    Args:
        at: the number, from 0, or from the end where it is negative; or the time. samples: how many rows
            there are. index, dt: see `place_of`.

    Raises:
        ValueError: no such row, with a sentence on what there is.

    Example:
        >>> row_of("60 s", 4, np.arange(4) * 30.0), row_of(-1, 4), row_of("3", 4)
        (2, 3, 3)
    """
    if isinstance(at, str) and _is_number(at):
        return numbered(int(at), samples)
    if isinstance(at, numbers.Number) or (hasattr(at, "__index__") and not isinstance(at, np.timedelta64)):
        return numbered(at, samples)
    import pandas as pd

    if index is None:
        raise ValueError(f"{at!r} names no sample: nothing here tells times, give the number of a sample")
    labels = pd.Index(index)
    rows = row_time(labels, dt, "", regular=False)
    if rows.time is None:
        raise ValueError(f"{at!r} names no sample: the rows have labels that are no times, give a number")
    time = np.asarray(rows.time - rows.time[0], float)
    try:
        after = _behind_first(at, labels, rows)
    except (ValueError, TypeError, OverflowError):
        like = repr(row_label(index, 0))
        raise ValueError(f"{at!r} names no sample: give its number, or its time, like {like}") from None
    nearest = int(np.argmin(np.abs(time - after)))
    if not abs(time[nearest] - after) <= abs(time[-1]) / max(samples - 1, 1) / 2:
        first, last = row_label(index, 0), row_label(index, samples - 1)
        raise ValueError(_nothing_at(at, row_label(index, nearest), first, last))
    return nearest


def numbered(at: object, count: int, what: str = "sample") -> int:
    """Return the number of one of so many samples, or what else is counted from 0; from the end if negative.

    Raises:
        ValueError: no whole number; no such sample.
    """
    try:
        number = operator.index(at)  # type: ignore[arg-type]  # of a number of NumPy or JAX, too
    except TypeError:
        kind = f"{at!r} is no number of a {what}"
        raise ValueError(f"{kind}: give a whole one, or a time as text, like '60 s'") from None
    if not -count <= number < count:
        raise ValueError(_no_number(number, count, what))
    return number % count


def _behind_first(at: Place, labels: pd.Index, rows: RowTime) -> float:
    """Return how many seconds after the first row a time lies."""
    import pandas as pd

    if rows.stamps is None:
        assert rows.time is not None, "asked for before"
        return float(_seconds(at) - rows.origin - rows.time[0])
    if isinstance(at, str) and not at.strip()[:4].isdecimal():
        return instant_of(at) - float((rows.stamps[0] - EPOCH) / SECOND)  # refuses what has two readings
    stamp = pd.Timestamp(at)
    zone = getattr(plain_labels(labels), "tz", None)
    if stamp.tz is None and zone is not None:
        stamp = stamp.tz_localize(zone)
    if stamp.tz is not None:
        stamp = stamp.tz_convert("UTC").tz_localize(None)
    return float((stamp.to_datetime64() - rows.stamps[0]) / SECOND)


def _seconds(at: Place) -> float:
    """Return a time span in s: of "320 s", "320.5", "00:05:20", a timedelta."""
    import pandas as pd

    try:
        return float(str(at).strip().removesuffix("s"))
    except ValueError:
        return float(pd.Timedelta(at).total_seconds())


def _is_number(text: str) -> bool:
    """Return whether text is a whole number."""
    return text.isascii() and text.strip().removeprefix("-").isdecimal()


def _no_number(number: int, count: int, what: str = "sample") -> str:
    """Return the sentence on a number that is too large, or too small."""
    whole = {"sample": "recording", "recording": "batch"}[what]
    return f"there is no {what} {number}: the {whole} has {count}, numbered from 0"


def _nothing_at(at: Place, nearest: str, first: str, last: str) -> str:
    """Return the sentence on a time at which nothing was recorded."""
    return f"no sample lies at {at}: the nearest is at {nearest}; the recording runs from {first} to {last}"
