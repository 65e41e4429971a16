"""A FAULT of a set observer, decided a second time outside XLA: see `consistency.twice`.

The observer follows the last samples before a FAULT once more, its kernels evaluated in NumPy: 4 of them,
then 16, 64, 256, 1024, as far back as it began, knowing nothing of the state before. A contradiction among
them stands. What is left is followed from where the observer began: behind a gap, or behind a FAULT, again
knowing nothing, so that no set of before a gap is believed twice; of more than 1024 samples XLA follows the
first. Only a FAULT that rests on samples of a piece before, which nobody keeps, begins with the set that was
carried to there.
"""

from typing import Any, Protocol, Self

import jax
import numpy as np

from jaxbound.estimation.arrays import Array
from jaxbound.estimation.contradictions import staying
from jaxbound.estimation.observation import State
from jaxbound.estimation.observed_plant import ObservedPlant
from jaxbound.estimation.piece import Piece
from jaxbound.estimation.zonotope_steps import Found
from jaxbound.sets.floats.kernel import outside_xla
from jaxbound.sets.floats.status import Status

__all__ = ["doubtful", "ignorant"]

LENGTHS = (4, 16, 64, 256, 1024)
"""Samples that are followed once more."""
BESIDE = 128
"""Stretches that are followed side by side, at most."""


class Repeatable(Protocol[State]):
    """An observer whose FAULTs can be decided again: plant, restart, weights as of SetObserver."""

    @property
    def plant(self) -> ObservedPlant: ...
    @property
    def restart(self) -> bool: ...
    @property
    def weights(self) -> np.ndarray: ...
    def begin(self) -> State:
        """Return the state before the first sample."""

    def found(self, carry: State, samples: Piece) -> tuple[State, Found]:
        """Return (state, Found) of samples, decided once."""

    def forgetful(self) -> Self:
        """Return the same observer, which begins knowing nothing."""


def doubtful(watch: Repeatable[State], carry: State, samples: Piece, fault: np.ndarray) -> np.ndarray:
    """Return (T, N) bool: which of the FAULTs are not proved outside XLA.

    Args:
        carry: what the observer carried to the samples. fault (T, N): where these are FAULT by XLA.
    """
    anew, first = samples.fresh.copy(), fault
    if watch.restart:
        anew[1:] |= fault[:-1]
    else:  # of a FAULT that stays, the first
        empty = np.asarray(carry.carry.empty).reshape(len(watch.weights), -1)
        first = fault & ~staying(np.asarray(empty.any(0)), fault, samples.fresh)
    begins = np.maximum.accumulate(np.where(anew, np.arange(len(fault))[:, None], 0))
    left = np.argwhere(first)
    shorter: float = watch.plant.past  # as many show the state, if samples do
    if watch.plant.start is None:
        shorter = np.inf
    for length in LENGTHS:
        long_enough = np.flatnonzero(left[:, 0] - begins[tuple(left.T)] >= shorter)
        proved = []
        for some in np.split(long_enough, range(BESIDE, len(long_enough), BESIDE)):
            proved.append(_by_samples(watch, samples, left[some], begins, length))
        left = np.delete(left, long_enough[np.concatenate(proved)], 0)
        shorter = length
    gone = np.zeros(fault.shape, bool)
    for end, number in left:
        begin = int(begins[end, number])
        own, alone = ignorant(watch, carry.samples + begin), watch.forgetful()
        if not anew[begin, number]:
            own, alone = _carried_of(watch, carry, number), watch
        piece = samples.of_recordings(np.array([number])).cut(begin, end + 1)
        gone[end, number] = not _from_begin(alone, own, piece)
    if watch.restart:
        return gone
    # a FAULT that stays goes as a whole
    gone |= staying(np.zeros_like(fault[0]), gone, samples.fresh | ~fault)
    return gone


def _by_samples(
    watch: Repeatable[State], samples: Piece, ends: np.ndarray, begins: np.ndarray, length: int
) -> np.ndarray:
    """Return (K,) bool: which FAULTs so many last samples show.

    Args:
        ends (K, 2): their samples, and their recordings. begins (T, N): where these began.
    """
    if not len(ends):
        return np.zeros(0, bool)
    end, number = ends.T
    rows = end - length + 1 + np.arange(length)[:, None]
    absent = (rows < begins[end, number])[:, None]

    def last(x: np.ndarray) -> np.ndarray:
        return np.moveaxis(np.moveaxis(x, -1, 1)[np.maximum(rows, 0), number], 1, -1)

    some = samples.mapped(last)
    u, y = np.where(absent, np.nan, some.u), np.where(absent, np.nan, some.y)
    some = some._replace(u=u, y=y, fresh=np.zeros(rows.shape, bool))
    alone = watch.forgetful()
    with outside_xla():
        _, found = alone.found(alone.begin(), some)
    return np.asarray((np.asarray(found.status) == Status.FAULT).any(0))


def _from_begin(watch: Repeatable[State], own: State, samples: Piece) -> bool:
    """Return whether the last sample of one recording is FAULT again, where it is followed from a state."""
    near = max(0, len(samples.fresh) - LENGTHS[-1])
    if near:
        own, _ = watch.found(own, samples.cut(0, near))
    with outside_xla():
        _, found = watch.found(own, samples.cut(near, len(samples.fresh)))
    return bool(found.status[-1, 0] == Status.FAULT)


def ignorant(watch: Repeatable[State], samples: np.int64) -> State:
    """Return the state of an observer that knows nothing behind so many samples."""
    nothing: Any = watch.forgetful().begin()  # a NamedTuple, whatever fields a method has
    state: State = nothing._replace(samples=np.int64(samples))
    return state


def _carried_of(watch: Repeatable[State], carry: State, number: int) -> State:
    """Return the carry of one recording; one of a single recording is that of all."""
    count = carry.carry.age.shape[-1] // len(watch.weights)

    def own(x: Array) -> np.ndarray:
        x = np.asarray(x)
        if not x.ndim:
            return x
        return np.asarray(x.reshape(*x.shape[:-1], x.shape[-1] // count, count)[..., number % count])

    alone: State = jax.tree.map(own, carry)
    return alone
