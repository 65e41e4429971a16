"""Names of signals in the options of a command, with commas between them."""

import re

COMMA = re.compile(r""",(?=(?:[^`"]|`[^`]*`|"[^"]*")*$)(?!(?:[^()`"]|`[^`]*`|"[^"]*")*\))""")
"""A comma outside of backticks, double quotes and brackets."""
TICKED = re.compile(r",(?=(?:[^`]|`[^`]*`)*$)(?!(?:[^()`]|`[^`]*`)*\))")
"""A comma outside of backticks and brackets, where a double quote is an inch."""
QUOTED = re.compile(r"""`([^`]+)`|"([^"]+)\"""")


def parted(text: str) -> list[str]:
    """Return the entries of a text with commas between them; no comma in backticks, double quotes or brackets
    parts two.

    Example:
        >>> parted('fan, `AHU: Valve, Signal`, lift=max(a, b), T="Room, north"')
        ['fan', '`AHU: Valve, Signal`', 'lift=max(a, b)', 'T="Room, north"']
    """
    comma = COMMA
    if text.count('"') % 2:
        comma = TICKED
    return [entry.strip() for entry in comma.split(text)]


def unquoted(name: str) -> str:
    """Return a name without the backticks, or double quotes, that it stands in.

    Example:
        >>> unquoted('`Q1=Heater 1`'), unquoted('"Room, north"'), unquoted("fan")
        ('Q1=Heater 1', 'Room, north', 'fan')
    """
    stands = QUOTED.fullmatch(name.strip())
    if stands is None:
        return name.strip()
    return stands[1] or stands[2]
