"""How numbers tell the time: in seconds, unless the name of their column, their range and their step say
otherwise.

A name may end in a unit, as in `Time [h]` or `t_ms`. Large numbers are an epoch. Numbers of some ten thousand
whose fractions are seconds of a day are the days of a spreadsheet. Whole numbers that jump from 59 to 100 are
the digits of a clock. Where two readings are left, a sentence asks for the unit.
"""

import re
from typing import NamedTuple

import numpy as np

from jaxbound.recordings.seams import TOLERATED_DT
from jaxbound.recordings.timestamps import EPOCHS, from_epoch, scale_of, since_epoch, uneven_steps
from jaxbound.text.units import time_unit

DAY = 86400.0
SCALES = {"ns": 1e9, "us": 1e6, "ms": 1e3, "s": 1.0, "min": 1 / 60, "h": 1 / 3600, "d": 1 / DAY}
"""Units of times, and how many a second has."""
LONGEST = 1e11  # seconds: no recording is older than 3000 years
CALENDARS = {
    "a spreadsheet counts them": (25569.0, 7305, 29220),
    "MATLAB counts them": (719529.0, 0, 47482),
    "astronomers count them": (2440587.5, 0, 47482),
}
"""Days since some year: {who: (the number of 1 January 1970, days from there to the first and last one)}."""
OF_DAYS = re.compile(r"(date|datum|fecha|data)\b.*")
EVEN = [1, 2, 5, 10, 15, 20, 30, *(60 * k for k in (1, 2, 3, 4, 5, 6, 10, 12, 15, 20, 30)), 3600, 7200]
"""Sampling periods in s that a clock is divided by."""
SECONDS_HAVE = 3  # decimals: of days, the third is 86 seconds
SHORT = 0.01  # days: in seconds, samples that came so fast would be rare
DECIMALS = (4, 5, 6)  # of days that somebody rounded: a spreadsheet writes five
DIGITS = {"hhmm": 100, "hhmmss": 10000}
"""Clocks that are written as one number, and what an hour adds to it."""


class Counting(NamedTuple):
    """How a column of numbers counts the time.

    Fields: scale: units a second. zero: the number of 1 January 1970, 0 where the column does not say. step:
    sampling period in s of numbers that are rounded, 0 of others; slack: seconds that they are off. unit: in
    words, "" of seconds.
    """

    scale: float = 1.0
    zero: float = 0.0
    step: float = 0.0
    slack: float = 0.0
    unit: str = ""

    def seconds(self, values: np.ndarray) -> np.ndarray:
        """Return numbers of the column in s, since 1970 where they have a calendar."""
        if not self.unit:
            return values
        seconds = (values - self.zero) / self.scale
        if self.zero:
            seconds = np.round(seconds, 4)  # floats of days, and their texts, hold no more
        if self.step:
            even = self.step * np.round(seconds / self.step)
            seconds = np.where(np.abs(seconds - even) <= self.slack, even, seconds)
        return seconds

    @property
    def hint(self) -> str:
        """A sentence on the unit, "" of seconds."""
        if not self.unit:
            return ""
        return f"the time column is read in {self.unit}"


SECONDS = Counting()


class Numbers(NamedTuple):
    """How the numbers of a time column tell the time.

    Fields: counting: in seconds, or an epoch; scale: units a second of an epoch, None: they are none; origin:
    the first number of an epoch.
    """

    counting: Counting
    scale: float | None
    origin: float

    def times(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Return (time in s, of an epoch since the first; datetime64[ns] of an epoch, else None)."""
        values = self.counting.seconds(values)
        if self.scale is None:
            return values, None
        return (values - self.origin) / self.scale, from_epoch(values, self.scale)


SECONDS_ALONE = Numbers(SECONDS, None, 0.0)


def numbers_of(values: np.ndarray, dt: float | None, name: str) -> tuple[Numbers, str]:
    """Return (how the first numbers of a time column tell the time, a sentence or ""); see `counting_of`."""
    counting = counting_of(values, dt, name)
    values, hint = counting.seconds(values), counting.hint
    scale = scale_of(float(values[0]))
    if scale not in (None, 1):
        hint = f"the time column is read as an epoch in {EPOCHS[scale]}"
    return Numbers(counting, scale, float(values[0])), hint


def counting_of(values: np.ndarray, dt: float | None, name: str) -> Counting:
    """Return how the numbers of a time column count.

    Args:
        values: (N,) the first of them. dt: sampling period in s, None: not known. name: of the column, "": it
            has none.

    Raises:
        ValueError: they may be days, or seconds.
    """
    unit, first = time_unit(name), float(values[0])
    for who, (zero, begin, end) in CALENDARS.items():
        if unit in ("", "d") and begin <= first - zero < end and _are_days(values, dt, name):
            step, slack = _rounded(values)
            return Counting(1 / DAY, zero, step, slack, f"days, as {who}")
    scale = SCALES.get(unit, 1.0)
    if scale == 1 or scale_of(first) == scale or abs(first) / scale > LONGEST:
        return SECONDS
    return Counting(scale, unit=unit)


def _are_days(values: np.ndarray, dt: float | None, name: str) -> bool:
    """Return whether numbers in the range of a calendar are days."""
    if time_unit(name) == "d":
        return True
    step = _usual_step(values)
    if dt is not None:
        return abs(step * DAY - dt) <= TOLERATED_DT * dt
    if OF_DAYS.fullmatch(name.strip().lower()) or _even_step(values):
        return True
    if 0 < step < SHORT and not _has_decimals(values, SECONDS_HAVE):
        may = f"the numbers of the time column, {values[0]:.10g} and so on, may be days or seconds"
        raise ValueError(f"{may}: say which by its name, like 'time [d]' or 'time [s]'")
    return False


def _quantum(days: np.ndarray) -> float:
    """Return the unit of the last decimal of rounded days, 0 of days with all digits."""
    for decimals in DECIMALS:
        if _has_decimals(days, decimals):
            return float(10.0**-decimals)
    return 0.0


def _has_decimals(values: np.ndarray, decimals: int) -> bool:
    """Return whether numbers have so many decimals at most."""
    least = values * 10**decimals
    return bool((np.abs(least - np.round(least)) < 1e-3).all())


def _usual_step(days: np.ndarray) -> float:
    """Return the usual step of days, from which gaps are left out and rounding is averaged; 0 of one."""
    if len(days) < 2:
        return 0.0
    steps = np.sort(np.diff(days))
    median = steps[len(steps) // 2]
    near = np.abs(steps - median) <= 1.5 * _quantum(days) + 1e-3 * abs(median)
    return float(np.mean(steps[near]))


def _even_step(days: np.ndarray) -> float:
    """Return the sampling period in s of days if a clock is divided by it, else 0."""
    step = DAY * _usual_step(days)
    spread = 1e-3 * step + 4 * DAY * _quantum(days) / len(days)
    near = [even for even in EVEN if abs(step - even) <= spread]
    if len(near) != 1:
        return 0.0
    return float(near[0])


def _rounded(days: np.ndarray) -> tuple[float, float]:
    """Return (sampling period in s, seconds that they may be off) of days that somebody rounded, else
    zeros.
    """
    step, off = _even_step(days), 0.51 * DAY * _quantum(days)
    if off < step / 4:
        return step, off
    return 0.0, 0.0


def read_numbers(
    values: np.ndarray, dt: float | None, name: str = ""
) -> tuple[np.ndarray, np.ndarray | None, str]:
    """Return (time, stamps, hint) of a numeric time column, as `parse_stamps` does of texts.

    Args, raises: as of `counting_of`.
    """
    values = since_epoch(values)
    if not len(values) or not np.isfinite(values).all():
        return values, None, ""
    clock = _of_clock(values, dt, name)
    if clock is not None:
        time, form = clock
        return time, None, f"the time column is read as the digits of a clock, {form}: it has no day"
    numbers, hint = numbers_of(values, dt, name)
    return *numbers.times(values), hint


def _of_clock(values: np.ndarray, dt: float | None, name: str) -> tuple[np.ndarray, str] | None:
    """Return (time since midnight in s, form) of numbers whose digits are those of a clock, 80130 for
    8:01:30; None where they are not.

    Numbers that are no digits have no reason to stop at 59 and go on at 100.
    """
    named = re.sub(r"[^a-z]", "", name.lower())
    uneven = min(uneven_steps(values, dt), uneven_steps(values, None))
    best, fewest = None, uneven
    for form, hour in DIGITS.items():
        time = _clock_seconds(values, hour)
        if time is None:
            continue
        if named.endswith(form):
            return time, form.upper()
        if uneven_steps(time, dt) < fewest:
            best, fewest = (time, form.upper()), uneven_steps(time, dt)
    if best is None or time_unit(name):
        return None
    if uneven - fewest == 1:
        may = (
            f"the numbers of the time column, {values[0]:.10g} and so on, may be seconds or digits of a clock"
        )
        raise ValueError(f"{may}: write 8:01:30 for those, or call seconds 'time [s]'")
    return best


def _clock_seconds(values: np.ndarray, hour: int) -> np.ndarray | None:
    """Return the seconds since the first midnight of digits with so much for an hour, or None."""
    if (values != np.floor(values)).any() or (values < 0).any() or (values >= 24 * hour).any():
        return None
    # an hour is 100 minutes of 100, or 1, each
    hours, minutes, seconds = values // hour, values * 100 // hour % 100, values * 10000 // hour % 100
    if (minutes > 59).any() or (seconds > 59).any():
        return None
    time = 3600 * hours + 60 * minutes + seconds
    return np.asarray(time + DAY * np.concatenate([[0], np.cumsum(np.diff(time) < -DAY / 2)]))
