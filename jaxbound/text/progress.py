"""The progress of long work: a function that is called with the share that is done."""

from collections.abc import Callable
from typing import TypeAlias

__all__ = ["Progress", "in_part", "reporter"]

Progress: TypeAlias = Callable[[float], object]
"""Called with the share of the work done, 0 to 1."""


def reporter(progress: Progress | None) -> Progress:
    """Return the function that takes the share of the work done: of nobody who asks, one that drops it.

    Raises:
        ValueError: something that cannot be called.

    Example:
        >>> reporter(None)(0.5)
        >>> reporter(print)(0.5)
        0.5
    """
    if progress is None:
        return _nobody
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


def _nobody(share: float) -> None:
    """Report to nobody."""
