"""The progress of long work: a function that is called with the share that is done.

Where nobody gave one, work that takes long says by itself how far it is: a line of the log `jaxbound` after
five seconds, then one a minute. `logging.getLogger("jaxbound").setLevel("ERROR")` keeps it silent.
"""

import logging
import time
from collections.abc import Callable
from typing import TypeAlias

from jaxbound.text.quantities import duration, rough_duration

Progress: TypeAlias = Callable[[float], object]
"""Called with the share of the work done, 0 to 1."""
LOG = logging.getLogger("jaxbound")
PATIENCE, EVERY = 5.0, 60.0
"""Seconds that work may take without a word, and between two words on it."""


def reporter(progress: Progress | None, what: str = "") -> Progress:
    """Return the function that takes the share of the work done: of nobody who asks, one that speaks only of
    work that takes long.

    Args:
        what: is done, for that line.

    Raises:
        ValueError: something that cannot be called.

    Example:
        >>> reporter(None)(0.5)
        >>> reporter(print)(0.5)
        0.5
    """
    if progress is None:
        return _Patient(what)
    if not callable(progress):
        raise ValueError(
            f"progress must be a function of the share of the work done, like print, not {progress!r}"
        )
    return progress


def in_part(report: Progress, before: float, part: float, share: float) -> None:
    """Report the share that is done of a part of the work, behind the share before it.

    Example:
        >>> in_part(print, 0.5, 0.25, 1.0)
        0.75
    """
    report(before + part * share)


class _Patient:
    """Progress of work that nobody asked about: lines of the log where it takes long and is far from done."""

    def __init__(self, what: str) -> None:
        self.what, self.begun = what or "this", time.monotonic()
        self.next, self.first = self.begun + PATIENCE, (0.0, 0.0)

    def __call__(self, share: float) -> None:
        now = time.monotonic()
        begun, done = self.first
        if share > 0 and not done:  # what came before, as compiling, does not come again
            self.first = now, share
        if now < self.next or not 0 < done < share:
            return
        took = now - self.begun
        left = (now - begun) * (1 - share) / (share - done)
        if left < PATIENCE:  # it is there sooner than the line is read
            return
        self.next = now + EVERY
        LOG.warning(
            "%s: %.0f %% done after %s, %s to go",
            self.what,
            100 * share,
            duration(took),
            rough_duration(left),
        )
