"""Whole numbers that a user gives: horizons, windows, constraints."""

from numbers import Integral

__all__ = ["is_whole"]


def is_whole(value: object) -> bool:
    """Return whether a value is a whole number, of Python or of NumPy; True and False are none."""
    return isinstance(value, Integral) and not isinstance(value, bool)
