"""Sizes of arrays that kernels are compiled for: few of them, so that few are compiled."""


def power(count: int, base: int = 2) -> int:
    """Return the smallest power of `base` that is not below count.

    Example:
        >>> power(5), power(16), power(17, 4)
        (8, 16, 64)
    """
    power = 1
    while power < count:
        power *= base
    return power
