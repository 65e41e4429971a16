"""A FAULT of a set observer, decided a second time outside XLA: see `consistency.twice`.

The observer follows the last samples before a FAULT once more, its kernels evaluated in NumPy: 4 of them,
then 16, 64, 256, 1024, as far back as it began, knowing nothing of the state before. A contradiction among
them stands. What is left is followed from where the observer began: behind a gap, or behind a FAULT, again
knowing nothing, so that no set of before a gap is believed twice; of more than 1024 samples XLA follows the
first. Only a FAULT that rests on samples of a piece before, which nobody keeps, begins with the set that was
carried to there.
"""

from typing import Any, Protocol

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

__all__ = ["doubtful"]

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
    def found(self, carry: State, samples: Piece) -> tuple[State, Found]:
        """Return (state, Found) of samples, decided once."""


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
    ends = np.argwhere(first)
    rounds = [(len(fault), 1)]
    if watch.plant.start is not None:  # samples show the state
        rounds = [*((length, BESIDE) for length in LENGTHS), *rounds]
    for length, beside in rounds:
        begin, gone = np.maximum(begins[tuple(ends.T)], ends[:, 0] - length + 1), np.ones(len(ends), bool)
        for part in range(0, len(ends), beside):
            some = slice(part, part + beside)
            gone[some] = ~_again(watch, carry, samples, begin[some], ends[some])
        ends = ends[gone]
    gone = np.zeros(fault.shape, bool)
    gone[tuple(ends.T)] = True
    if not watch.restart:  # a FAULT that stays goes as a whole
        gone |= staying(np.zeros_like(fault[0]), gone, samples.fresh | ~fault)
    return gone


def _again(
    watch: Repeatable[State], carry: State, samples: Piece, begin: np.ndarray, ends: np.ndarray
) -> np.ndarray:
    """Return (K,) bool: which FAULTs the samples from begin (K,) on show. ends (K, 2): their samples, and
    their recordings.
    """
    last, numbers = ends.T
    rows = np.minimum(begin + np.arange((last - begin).max() + 1)[:, None], last)
    some = jax.tree.map(lambda x: np.moveaxis(np.moveaxis(x, -1, 1)[rows, numbers], 1, -1), samples)
    some.fresh[0] |= begin > 0  # what is carried to the first sample of all is the only set that is believed
    own: Any = _of_recordings(watch, carry, numbers)  # a NamedTuple, whatever fields a method has
    if len(begin) == 1:  # windows begin where they began
        own = own._replace(samples=carry.samples + begin[0])
    state: State = own
    near = max(0, len(rows) - LENGTHS[-1])
    if near:
        state, _ = watch.found(state, some.cut(0, near))
    with outside_xla():
        _, found = watch.found(state, some.cut(near, len(rows)))
    shown = np.asarray(found.status) == Status.FAULT
    return np.asarray((shown & (begin + np.arange(near, len(rows))[:, None] <= last)).any(0))


def _of_recordings(watch: Repeatable[State], carry: State, numbers: np.ndarray) -> State:
    """Return the carry of some recordings; one of a single recording is that of all."""
    count = carry.carry.age.shape[-1] // len(watch.weights)

    def own(x: Array) -> np.ndarray:
        x = np.asarray(x)
        if not x.ndim:
            return x
        places = np.arange(x.shape[-1]).reshape(-1, count)[:, numbers % count]
        return x[..., places.ravel()]

    some: State = jax.tree.map(own, carry)
    return some
