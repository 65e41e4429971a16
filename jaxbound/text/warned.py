"""Warnings at the line of a user: the one that called the package, not the one inside it that found out."""

import os
import sys
import warnings
from functools import cache
from pathlib import Path
from types import FrameType

PACKAGE = f"{Path(__file__).parents[1]}{os.sep}"


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """Warn with the line by which the package was entered: Python names it, and filters go by it."""
    warnings.warn(message, category, stacklevel=2 + _frames_above(sys._getframe(1)))


@cache  # an exception, where a filter makes one of the warning, is not kept: it comes again
def warn_once(message: str) -> None:
    """Warn, once a process: what holds of each call is said at the first."""
    warn(message)


def _frames_above(inner: FrameType) -> int:
    """Return how many frames above a frame the user's is: the one above the outermost of the package."""
    depth, outermost = 0, 0
    frame: FrameType | None = inner
    while frame is not None:
        if frame.f_code.co_filename.startswith(PACKAGE):
            outermost = depth
        frame, depth = frame.f_back, depth + 1
    return outermost + 1
