"""Exact frames for windows that lack samples: made when they are first asked for, and kept."""

from typing import TypeAlias

import numpy as np

from jaxbound.exact.frames import ExactFrame, reframe

__all__ = ["KeptFrames", "Reframed"]

KEPT = 128
"""Frames that are kept: those made last."""
WORK = 2**14
"""Fractions that an elimination may change: some 5 us each, more in long windows. Beyond, none is made."""

Pattern: TypeAlias = tuple[frozenset[int], tuple[int, ...]]
"""The rows and inputs that are missing."""
Reframed: TypeAlias = dict[Pattern, ExactFrame]
"""Frames by what they were made without."""


class KeptFrames:
    """Frames for windows that lack samples.

    Fields: whole: that of windows that lack nothing. inner, needed: numbers of its inner rows, and of the
    inputs that it uses.

    Args:
        reframed: frames that were made before, and where those are put that are made here; None: none.
    """

    def __init__(self, whole: ExactFrame, reframed: Reframed | None = None) -> None:
        self.reframed: Reframed = {} if reframed is None else reframed
        self.whole = whole
        self.inner = np.array(whole.inner, int)
        self.needed = np.flatnonzero([any(column) for column in zip(*whole.K, strict=True)])

    def fitting(self, rows: list[int], inputs: list[int]) -> ExactFrame | None:
        """Return a frame without these rows and inputs, None where its elimination would take too long.

        It depends on them alone: not on the windows before, nor on how a recording is cut.
        """
        outer = set(rows) - set(self.whole.inner)
        used = self._used(outer)
        inner, missing = frozenset(rows) - outer, tuple(b for b in inputs if used[b])
        if not inner and not missing:
            return self.whole
        work = (len(inner) + len(missing)) * len(self.whole.outer) * (len(self.inner) + len(used))
        if work > WORK:
            return None
        key = frozenset(rows), missing
        if key not in self.reframed:
            if len(self.reframed) >= KEPT:
                self.reframed.pop(next(iter(self.reframed)))
            self.reframed[key] = reframe(self.whole, key[0], missing)
        return self.reframed[key]

    def _used(self, absent: set[int]) -> list[bool]:
        """Return which inputs a relation uses whose row is there."""
        there = [row for row, j in zip(self.whole.K, self.whole.outer, strict=True) if j not in absent]
        return [any(column) for column in zip(*there, strict=True)] or [False] * len(self.whole.K[0])
