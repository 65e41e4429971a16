"""Which parts of a recording belong to the i-th of n shares, and which shares make the parts that are missing."""

from collections.abc import Callable, Sequence

import numpy as np

__all__ = ["Incomplete", "check_share", "numbers_of", "shares_that_make"]

NAMED = 4  # stretches in a sentence


class Incomplete(ValueError):
    """Parts of a recording are missing.

    Fields: lacking: which, in words; shares: the (i, n) that make them and touch no other part.
    """

    def __init__(self, lacking: str, shares: Sequence[tuple[int, int]]) -> None:
        self.lacking, self.shares = lacking, shares
        super().__init__(self.says("part=", "({}, {})"))

    def says(self, command: str, share: str) -> str:
        """Return the sentence; command: that makes a share, without its numbers; share: pattern of these."""
        n = self.shares[0][1]
        return f"{self.lacking}: make them with {command}{listed([i for i, _ in self.shares], lambda i: share.format(i, n))}"


def check_share(part: tuple[int, int]) -> None:
    """Raise ValueError if a share is none."""
    whole = lambda x: isinstance(x, int | np.integer) and not isinstance(x, bool)
    if not (isinstance(part, tuple | list) and len(part) == 2 and all(map(whole, part)) and 1 <= part[0] <= part[1]):
        raise ValueError(f"part is (i, n), the i-th of n shares with 1 <= i <= n, not {part!r}")


def numbers_of(part: tuple[int, int], count: int) -> range:
    """Return the range of numbers, from 0, of the parts in share (i, n) of so many; some are empty where n > count."""
    i, n = part
    return range(count * (i - 1) // n, count * i // n)


def shares_that_make(missing: Sequence[int], count: int) -> list[tuple[int, int]]:
    """Return shares (i, n) that hold all missing parts and no other, n as small as can be.

    Args:
        missing: numbers of parts, at least one. count: of all parts.

    Example:
        >>> shares_that_make([2, 3], 6), shares_that_make([0, 5], 6)
        ([(2, 3)], [(1, 6), (6, 6)])
    """
    before = np.concatenate([[0], np.cumsum(np.isin(np.arange(count), missing))])  # how many are missing before each part
    for n in range(1, count + 1):
        ends = count * np.arange(n + 1) // n
        lost, size = np.diff(before[ends]), np.diff(ends)
        if ((lost == 0) | (lost == size)).all():
            return [(int(i) + 1, n) for i in np.flatnonzero(lost)]
    raise AssertionError("of as many shares as there are parts each is one part")


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
