"""Text that people read: names that users wrote without control characters, formulas or end, and numbers that
read well.
"""

__all__ = ["cell", "clipped", "duration", "factor", "percent", "printable", "times"]

FORMULAS = ("=", "+", "-", "@")
"""A cell that begins so is computed, not shown, by a spreadsheet."""
LONGEST = 2000  # characters of a sentence


def printable(text: str, keep: str = "") -> str:
    r"""Return a text with control characters, and what UTF-8 cannot hold, written as escapes; those in `keep`
    stay.

    A name from a file may hold what would move the cursor of a terminal, or hide what follows.

    Example:
        >>> printable("y1\x1b[2J")
        'y1\\x1b[2J'
    """
    if text.isprintable():
        return text
    return "".join(c if c in keep or _harmless(c) else c.encode("unicode_escape").decode() for c in text)


def _harmless(c):
    code = ord(c)
    control = code < 32 or 127 <= code < 160 or code in (0x2028, 0x2029)
    return not (
        control
        or 0xD800 <= code < 0xE000
        or 0x200E <= code <= 0x200F
        or 0x202A <= code <= 0x202E
        or 0x2066 <= code <= 0x2069
    )


def clipped(text: str) -> str:
    """Return a text without its middle if it is very long."""
    if len(text) <= LONGEST:
        return text
    return f"{text[: LONGEST // 2]} [.. {len(text) - LONGEST} characters ..] {text[-LONGEST // 2 :]}"


def cell(text: str) -> str:
    """Return a text as a cell of CSV that no spreadsheet takes for a formula: an apostrophe before = + - @,
    control characters escaped.

    Source: OWASP, CSV injection.

    Example:
        >>> cell("=1+1"), cell("pump 7")
        ("'=1+1", 'pump 7')
    """
    text = printable(text)
    return f"'{text}" if text.startswith(FORMULAS) else text


def factor(x: float) -> str:
    """Return "2.2" for a factor, with no more digits than matter."""
    if x >= 1000:
        return f"{x:,.0f}" if x < 1e9 else f"{x:.2g}"
    short = f"{x:.3g}"
    return short if short != "1" else f"{x:.7g}"  # just above 1 is not 1


def times(x: float) -> str:
    """Return "2.2 times" for a factor."""
    return f"{factor(x)} times"


def percent(share: float) -> str:
    """Return a share as text that is 0 % or 100 % only where it is exactly that."""
    if share in (0, 1):
        return f"{share:.0%}".replace("%", " %")
    return "<0.1 %" if share < 0.001 else ">99.9 %" if 0.999 < share < 1 else f"{100 * share:.3g} %"


def duration(seconds: float) -> str:
    """Return a time span in units that read well."""
    for unit, size, limit in (("d", 86400, 172800), ("h", 3600, 7200), ("min", 60, 120)):
        if seconds >= limit:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.3g} s"
