"""Bounds that are a factor wider, exactly: of a test that states the factor, and outside of training."""

from fractions import Fraction

from jaxbound.exact.linalg import Vector


def widened(bounds: Vector, factor: Fraction, rounds: Vector | None = None) -> list[Fraction]:
    """Return half-widths that are so many times as wide.

    Args:
        rounds: what is rounded away beside each; it stays, and the bound grows for it. None: the factor is on
            the bounds alone.

    Example:
        >>> widened((Fraction(3),), Fraction(2), rounds=(Fraction(1),))
        [Fraction(7, 1)]
    """
    if rounds is None:
        return [factor * bound for bound in bounds]
    return [factor * (bound + beside) - beside for bound, beside in zip(bounds, rounds, strict=True)]


def widened_ends(ends: Vector, factor: Fraction) -> tuple[Fraction, Fraction]:
    """Return (lo, hi) so many times as far apart, around their middle."""
    lo, hi = ends
    more = (factor - 1) * (hi - lo) / 2
    return lo - more, hi + more
