"""Intervals of the clock as they are written: 15min, 2s, 1h."""

import re
from fractions import Fraction

UNITS = {"ms": 10**6, "s": 10**9, "min": 60 * 10**9, "h": 3600 * 10**9, "d": 86400 * 10**9}
"""Nanoseconds of each."""
INTERVAL = re.compile(r"\s*(\d+(?:\.\d+)?)?\s*(ms|s|min|h|d)\s*", re.ASCII)
USUAL = {"ms": (1, 2, 5, 10, 20, 50, 100, 200, 500), "s": (1, 2, 3, 5, 10, 15, 20, 30)}
USUAL |= {"min": USUAL["s"], "h": (1, 2, 3, 4, 6, 8, 12), "d": (1, 7, 30)}
"""Numbers of each unit that a clock is usually divided by."""
SLACK = 1.02  # jitter of a recorder that an interval need not hold


def seconds_of(text: str) -> float:
    """Return the length of an interval in s.

    Raises:
        ValueError: it is none, or nothing.

    Example:
        >>> seconds_of("15min"), seconds_of("2 s"), seconds_of("h"), seconds_of("250ms")
        (900.0, 2.0, 3600.0, 0.25)
    """
    return nanoseconds(text) / 1e9


def nanoseconds(text: str) -> int:
    """Return the length of an interval in ns; errors as of `seconds_of`."""
    found = INTERVAL.fullmatch(str(text))
    length = 0
    if found is not None:
        length = round(Fraction(found[1] or "1") * UNITS[found[2]])
    if length <= 0:
        raise ValueError(
            f"every needs a number and a unit, ms, s, min, h or d, like '15min' or '2s': not {text!r}"
        )
    return length


def every_text(seconds: float) -> str:
    """Return an interval as a user writes it, in the largest unit of which it is a whole number.

    Example:
        >>> every_text(900), every_text(2), every_text(0.25), every_text(7200)
        ('15min', '2s', '250ms', '2h')
    """
    length = round(seconds * 1e9)
    for unit, size in reversed(UNITS.items()):
        if length >= size and length % size == 0:
            return f"{length // size}{unit}"
    return f"{seconds:g}s"


def next_interval(seconds: float) -> str:
    """Return the first interval by which clocks are usually divided that is no shorter.

    Example:
        >>> next_interval(1.99), next_interval(61), next_interval(11), next_interval(0.4)
        ('2s', '1min', '15s', '500ms')
    """
    for unit, numbers in USUAL.items():
        for number in numbers:
            if number * UNITS[unit] * SLACK >= seconds * 1e9:
                return f"{number}{unit}"
    return every_text(86400.0 * -(-seconds // 86400))
