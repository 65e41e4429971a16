"""Bounds of rounding in the steps of sets: one share of all magnitudes, and factors that cover sums."""

from typing import NamedTuple

import numpy as np

from jaxbound.sets.floats import rounding


class SetRounding(NamedTuple):
    """The factors of bounds of rounding.

    Fields: gamma: share of all magnitudes that one result may be off by; up: factor that covers the rounding
    of a sum of non-negative numbers; least: more than underflow costs; most, steepest: largest numbers, and
    gains.
    """

    gamma: np.floating
    up: np.ndarray
    least: np.ndarray
    most: np.ndarray
    steepest: np.ndarray


def set_rounding(products: int, sums: int, dtype: np.dtype) -> SetRounding:
    """Return the factors for sums of so many products, and of so many numbers >= 0, in a dtype."""
    least, steepest = 2.0**-46, 2.0**20
    if dtype == np.float64:
        least, steepest = 2.0**-500, 2.0**60
    return SetRounding(
        gamma=rounding.product_error(products, dtype)[0],
        up=np.asarray(1 + 4 * sums * float(rounding.unit(dtype)), dtype),
        least=np.asarray(least, dtype),
        most=largest_number(dtype),
        steepest=np.asarray(steepest, dtype),
    )


def largest_number(dtype: np.dtype) -> np.ndarray:
    """Return the largest number that a set may speak of: no product of two overflows."""
    if dtype == np.float64:
        return np.asarray(2.0**300, dtype)
    return np.asarray(2.0**40, dtype)
