"""The verdicts of set computations."""

from enum import IntEnum


class Status(IntEnum):
    """The verdict on one window, one point or one paving.

    `MISSING`: no usable data. `CONSISTENT`: proved to be explained by some value inside the bounds.
    `UNDECIDED`: rounding or the effort allowed did not settle it. `FAULT`: proved that nothing inside the
    bounds explains it.

    Example:
        >>> Status.FAULT > Status.CONSISTENT
        True
    """

    MISSING = 0
    CONSISTENT = 1
    UNDECIDED = 2
    FAULT = 3
