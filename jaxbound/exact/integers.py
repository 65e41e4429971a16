"""Arrays of Python's integers: floats made whole, and ratios back in floats."""

import numpy as np
from numpy.typing import ArrayLike

MANTISSA = 53
"""Bits of a float: times 2^53 its mantissa is whole."""
LARGEST = 1000
"""Bits up to which integers are converted to floats as they are."""


def places(x: ArrayLike) -> int:
    """Return the smallest n >= 0 for which all finite floats times 2^n are surely integers."""
    floats = np.asarray(x, np.float64)
    floats = floats[np.isfinite(floats) & (floats != 0)]
    if not floats.size:
        return 0
    exponent = np.frexp(floats)[1]
    return max(0, MANTISSA - int(exponent.min()))


def whole_floats(x: ArrayLike, power: int) -> np.ndarray:
    """Return finite floats times 2^power, which makes them integers, as an array of Python's."""
    mantissa, exponent = np.frexp(np.asarray(x, np.float64))
    whole = (mantissa * 2.0**MANTISSA).astype(np.int64).astype(object)
    shift = np.where(mantissa == 0, 0, exponent + (power - MANTISSA))
    return np.asarray(whole << shift.astype(object))


def ratios(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return x / y of integers >= 0 as floats, 0 where both are 0."""
    largest = int(max(x.max(), y.max()))
    cut = max(0, largest.bit_length() - LARGEST)
    above, below = ((v >> cut).astype(np.float64) for v in (x, y))
    both_zero = (above == 0) & (below == 0)
    with np.errstate(divide="ignore"):
        return np.where(above == 0, 0, above / np.where(both_zero, 1, below))
