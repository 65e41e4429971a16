"""What exact numbers cost, said or refused before they are worked out: nobody waits in silence for what will
not end.
"""

import warnings

__all__ = ["SECONDS", "duration_text", "refuse_or_say"]

SECONDS = 600.0
"""What exact numbers may take at most."""
SILENCE = 60.0  # what they may take without a word


def refuse_or_say(seconds: float, what: str, do: str) -> None:
    """Say what takes more than a minute, and refuse what takes more than `SECONDS`.

    Args:
        seconds: about how long it takes. what: is worked out, as the subject of a sentence, in the plural.
            do: what to do instead.

    Raises:
        ValueError: it would take too long.
    """
    if seconds > SECONDS:
        raise ValueError(f"{what} would take {duration_text(seconds)} in exact numbers: {do}")
    if seconds > SILENCE:
        warnings.warn(
            f"{what} take {duration_text(seconds)} in exact numbers; if that is too long, {do}", stacklevel=4
        )


def duration_text(seconds: float) -> str:
    """Return a rough duration as text.

    Example:
        >>> duration_text(5.2), duration_text(500), duration_text(2e4), duration_text(1e12)
        ('about 5 seconds', 'about 8 minutes', 'about 6 hours', 'more than a year')
    """
    for size, name in ((1, "second"), (60, "minute"), (3600, "hour"), (86400, "day")):
        if seconds < 100 * size:
            count = max(round(seconds / size), 1)
            return f"about {count} {name}{'s' * (count != 1)}"
    return "more than a year" if seconds > 3.2e7 else f"about {round(seconds / 86400)} days"
