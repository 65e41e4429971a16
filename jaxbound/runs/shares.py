"""Shares of a recording: the parts that belong to the i-th of n, and parts in words."""

from collections.abc import Callable, Sequence

import numpy as np

from jaxbound.models.numbers import is_whole

NAMED = 4  # stretches in a sentence


def check_share(part: tuple[int, int]) -> None:
    """Raise ValueError if a share is none."""
    is_pair = isinstance(part, tuple | list) and len(part) == 2
    if not is_pair or not all(map(is_whole, part)) or not 1 <= part[0] <= part[1]:
        raise ValueError(f"part is (i, n), the i-th of n shares with 1 <= i <= n, not {part!r}")


def part_numbers(part: tuple[int, int], count: int) -> range:
    """Return the range of numbers, from 0, of the parts in share (i, n) of so many; some are empty where n >
    count.
    """
    i, n = part
    return range(count * (i - 1) // n, count * i // n)


def stretches_listed(numbers: Sequence[int], name: Callable[[int], str]) -> str:
    """Return numbers in words: those that follow each other as "a to b".

    Example:
        >>> stretches_listed([1, 2, 5, 7, 8, 9], str)
        '1, 2, 5 and 7 to 9'
    """
    stretches = np.split(np.asarray(numbers), np.flatnonzero(np.diff(numbers) > 1) + 1)
    words: list[str] = []
    for x in stretches[:NAMED]:
        if len(x) > 2:
            words.append(f"{name(x[0])} to {name(x[-1])}")
        else:
            words += map(name, x)
    if len(stretches) > NAMED:
        words.append(f"{sum(map(len, stretches[NAMED:]))} more")
    if len(words) == 1:
        return words[0]
    return f"{', '.join(words[:-1])} and {words[-1]}"
