"""The price of exact numbers, said or refused before they are worked out: nobody waits in silence for what
will not end.
"""

from jaxbound.text.progress import LOG, PATIENCE
from jaxbound.text.quantities import rough_duration
from jaxbound.text.warned import warn

SECONDS = 600.0
"""What exact numbers may take at most."""
SILENCE = 60.0
"""What they may take without a warning; a line of the log comes from `PATIENCE` on."""


def refuse_or_say(seconds: float, what: str, do: str) -> None:
    """Log work that takes more than some seconds, warn of more than a minute, and refuse more than
    `SECONDS`.

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
    elif seconds > PATIENCE:
        LOG.warning("%s take %s in exact numbers", what, span)
