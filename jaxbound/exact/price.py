"""The price of exact numbers, said or refused before they are worked out: nobody waits in silence for what
will not end.
"""

from jaxbound.text.quantities import rough_duration
from jaxbound.text.warned import warn

__all__ = ["SECONDS", "refuse_or_say"]

SECONDS = 600.0
"""What exact numbers may take at most."""
SILENCE = 60.0
"""What they may take without a word."""


def refuse_or_say(seconds: float, what: str, do: str) -> None:
    """Warn of work that takes more than a minute, and refuse work that takes more than `SECONDS`.

    Args:
        seconds: about how long it takes.
        what: is worked out, as the subject of a sentence, in the plural.
        do: what to do instead.

    Raises:
        ValueError: it would take too long.
    """
    span = rough_duration(seconds)
    if seconds > SECONDS:
        raise ValueError(f"{what} would take {span} in exact numbers: {do}")
    if seconds > SILENCE:
        warn(f"{what} take {span} in exact numbers; if that is too long, {do}")
