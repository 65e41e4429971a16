"""Numbers as people read them: factors, shares and spans of time."""

import math
from collections.abc import Mapping

UNITS = (("d", 86400, 172800), ("h", 3600, 7200), ("min", 60, 120))
"""A unit of time, its seconds, and the seconds from which on it is used."""
YEAR = 3.2e7
"""Seconds."""


def decimal(text: str) -> float:
    """Return the number that a text writes in digits 0 to 9, as files and other programs read it.

    Raises:
        ValueError: it is none, or written as only Python reads it: 1_0, or digits of another script.

    Example:
        >>> decimal(" -1.5e3 ")
        -1500.0
    """
    if not text.isascii() or "_" in text:
        raise ValueError(f"{text!r} is no number")
    return float(text)


def factor(x: float) -> str:
    """Return "2.2" for a factor, with no more digits than matter."""
    if x >= 1e9:
        return f"{x:.2g}"
    if x >= 1000:
        return f"{x:.0f}"
    short = f"{x:.3g}"
    if short == "1":  # just above 1 is not 1
        return f"{x:.7g}"
    return short


def three_digits(x: float) -> str:
    """Return a size in the unit of its signal as text: three digits, and whole ones from 1000 on.

    Example:
        >>> three_digits(0.07834), three_digits(-210.4), three_digits(1234.5)
        ('0.0783', '-210', '1234')
    """
    if 1000 <= abs(x) < 1e9:
        return f"{x:.0f}"
    return f"{x:.3g}"


def finite(x: float) -> float | None:
    """Return a number that JSON has, None for any other."""
    if not math.isfinite(x):
        return None
    return float(x)


def plain(value: object) -> object:
    """Return a value as JSON has it: fields by their names, None for a number that is not finite.

    Example:
        >>> plain({"sizes": (1.5, math.inf)})
        {'sizes': [1.5, None]}
    """
    if hasattr(value, "tolist"):
        value = value.tolist()
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return dict(zip(value, map(plain, value.values()), strict=True))
    if isinstance(value, list | tuple):
        return list(map(plain, value))
    if isinstance(value, float):
        return finite(value)
    return value


def times(x: float) -> str:
    """Return "2.2 times" for a factor."""
    return f"{factor(x)} times"


def percent(share: float) -> str:
    """Return a share as text that is 0 % or 100 % only where it is exactly that."""
    if share in (0, 1):
        return f"{100 * share:.0f} %"
    if share < 0.001:
        return "<0.1 %"
    if 0.999 < share < 1:
        return ">99.9 %"
    return f"{100 * share:.3g} %"


def most_percent(share: float) -> str:
    """Return a bound on a share as text, rounded up to hundredths of a percent.

    Example:
        >>> most_percent(0.95196), most_percent(0.99988), most_percent(1)
        ('95.2 %', '99.99 %', '100 %')
    """
    return f"{math.ceil(round(1e4 * share, 6)) / 100:g} %"


def duration(seconds: float) -> str:
    """Return a time span in units that read well."""
    for unit, size, least in UNITS:
        if seconds >= least:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.3g} s"


def rough_duration(seconds: float) -> str:
    """Return a duration that was only estimated, as text.

    Example:
        >>> rough_duration(5.2), rough_duration(500), rough_duration(2e4), rough_duration(1e12)
        ('about 5 seconds', 'about 8 minutes', 'about 6 hours', 'more than a year')
    """
    if seconds > YEAR:
        return "more than a year"
    for size, name in ((1, "second"), (60, "minute"), (3600, "hour")):
        if seconds < 100 * size:
            return _about(max(round(seconds / size), 1), name)
    return _about(round(seconds / 86400), "day")


def _about(count: int, name: str) -> str:
    if count == 1:
        return f"about 1 {name}"
    return f"about {count} {name}s"
