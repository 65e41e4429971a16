"""Which parts of a recording belong to the i-th of n shares, and parts in words."""

from collections.abc import Callable, Sequence

import numpy as np

__all__ = ["check_share", "listed", "numbers_of"]

NAMED = 4  # stretches in a sentence


def check_share(part: tuple[int, int]) -> None:
    """Raise ValueError if a share is none."""
    whole = lambda x: isinstance(x, int | np.integer) and not isinstance(x, bool)
    if not (
        isinstance(part, tuple | list)
        and len(part) == 2
        and all(map(whole, part))
        and 1 <= part[0] <= part[1]
    ):
        raise ValueError(f"part is (i, n), the i-th of n shares with 1 <= i <= n, not {part!r}")


def numbers_of(part: tuple[int, int], count: int) -> range:
    """Return the range of numbers, from 0, of the parts in share (i, n) of so many; some are empty where n >
    count.
    """
    i, n = part
    return range(count * (i - 1) // n, count * i // n)


def listed(numbers: Sequence[int], name: Callable[[int], str]) -> str:
    """Return numbers in words: those that follow each other as "a to b".

    Example:
        >>> listed([1, 2, 5, 7, 8, 9], str)
        '1, 2, 5 and 7 to 9'
    """
    stretches = np.split(np.asarray(numbers), np.flatnonzero(np.diff(numbers) > 1) + 1)
    said: list[str] = []
    for x in stretches[:NAMED]:
        said += [f"{name(x[0])} to {name(x[-1])}"] if len(x) > 2 else map(name, x)
    if len(stretches) > NAMED:
        said.append(f"{sum(map(len, stretches[NAMED:]))} more")
    return " and ".join([", ".join(said[:-1]), said[-1]] if len(said) > 1 else said)
