"""A FAULT of a set observer, decided a second time outside XLA: see `consistency.twice`.

The observer follows the last samples before a FAULT once more, its kernels evaluated in NumPy: 4 of them,
then 16, 64, 256, 1024, as far back as it began, knowing nothing of the state before. A contradiction among
them stands. What is left is followed from where the observer began: behind a gap, or behind a FAULT, again
knowing nothing, so that no set of before a gap is believed twice; of more than 1024 samples XLA follows the
first. Only a FAULT that rests on samples of a piece before, which nobody keeps, begins with the set that was
carried to there.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

import jax
import numpy as np

from jaxbound.consistency.interface import Judged
from jaxbound.consistency.twice import warn_doubtful
from jaxbound.estimation.arrays import Array
from jaxbound.estimation.observation import Observation, State
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla
from jaxbound.sets.floats.status import Status

__all__ = ["decided_twice"]

LENGTHS = (4, 16, 64, 256, 1024)
"""Samples that are followed once more."""
BESIDE = 128
"""Stretches that are followed side by side, at most."""


class Repeatable(Protocol[State]):
    """An observer whose FAULTs can be decided again.

    restart, weights, shown_after: as of SetObserver.
    """

    @property
    def restart(self) -> bool: ...
    @property
    def weights(self) -> np.ndarray: ...
    @property
    def shown_after(self) -> float: ...
    def begin(self) -> State:
        """Return the state before the first sample."""

    def judged(self, carry: State, piece: Recording) -> tuple[State, Observation | Judged]:
        """Return (carry, verdicts) of a piece, decided once."""

    def forgetful(self) -> Self:
        """Return the same observer, which begins knowing nothing."""


@dataclass(frozen=True)
class _Doubt:
    """A FAULT to be decided again.

    Fields: recording; begin, end: the first sample that it rests on, in its piece, and its own; anew: whether
    it rests on none before that one.
    """

    recording: int
    begin: int
    end: int
    anew: bool


def decided_twice(
    watch: Repeatable[State], carry: State, piece: Recording
) -> tuple[State, Observation | Judged]:
    """Return (carry, verdicts) of `watch.judged`, with UNDECIDED in place of a FAULT that is not proved
    outside XLA; a warning tells of them.

    Where one is taken back the observer goes on knowing nothing: the set that XLA carried is not to be
        trusted.

    Args:
        carry: what the observer carried to the piece.
    """
    after, judged = watch.judged(carry, piece)
    status = np.asarray(judged.status)
    if is_outside_xla() or not (status == Status.FAULT).any():
        return after, judged
    gone = _doubtful(watch, carry, piece, status)
    if not gone.any():
        return after, judged
    status = np.where(gone, np.int8(Status.UNDECIDED), status).astype(np.int8)
    margin = np.where(gone, 0, judged.margin).astype(np.asarray(judged.margin).dtype)
    return _ignorant(watch, after.samples), _with_verdicts(judged, status, margin)


def _with_verdicts(
    judged: Observation | Judged, status: np.ndarray, margin: np.ndarray
) -> Observation | Judged:
    """Return a Judged, or an Observation, with other verdicts."""
    if isinstance(judged, Judged):
        return judged._replace(status=status, margin=margin)
    return replace(judged, status=status, margin=margin)


def _doubtful(watch: Repeatable[State], carry: State, piece: Recording, status: np.ndarray) -> np.ndarray:
    """Return bool like status (..., T): which FAULTs of a piece are not proved outside XLA."""
    flat = status.reshape(-1, status.shape[-1])
    left = list(_doubts(watch, carry, piece, flat))
    shorter = watch.shown_after
    for length in LENGTHS:
        long_enough = [doubt for doubt in left if doubt.end - doubt.begin >= shorter]
        refuted = _by_samples(watch, piece, long_enough, length)
        left = [doubt for doubt in left if doubt not in refuted]
        shorter = length
    left = [doubt for doubt in left if not _from_begin(watch, carry, piece, doubt)]
    gone = np.zeros(flat.shape, bool)
    for doubt in left:
        count = 1
        if not watch.restart:  # a FAULT that stays goes as a whole
            behind = flat[doubt.recording, doubt.end :] != Status.FAULT
            count = int(np.append(behind, True).argmax())
        gone[doubt.recording, doubt.end : doubt.end + count] = True
    if left:
        warn_doubtful(
            f"{len(left)} samples are FAULT by an observer in XLA, the first of them is sample {left[0].end} "
            f"of its piece"
        )
    return gone.reshape(status.shape)


def _doubts(watch: Repeatable[State], carry: State, piece: Recording, status: np.ndarray) -> Iterator[_Doubt]:
    """Yield the FAULTs of recordings (N, T); of one that stays, the first."""
    starts = np.asarray(piece.starts).tolist()
    gaps = set(starts)
    if piece.excluded is not None:
        gaps.update(np.flatnonzero(piece.excluded).tolist())
    ordered = np.array(sorted({0, *gaps}))
    ended = np.broadcast_to(_ended(watch, carry), len(status))
    for recording, row in enumerate(status):
        begin = 0
        stays_from_before = bool(ended[recording]) and not watch.restart and 0 not in starts
        for end in np.flatnonzero(row == Status.FAULT).tolist():
            seam = int(ordered[np.searchsorted(ordered, end, "right") - 1])
            stays = not watch.restart and end > 0 and row[end - 1] == Status.FAULT and seam != end
            if end == 0:
                stays = stays_from_before
            if not stays:
                first = max(begin, seam)
                yield _Doubt(recording, first, end, anew=first > 0 or 0 in gaps)
            if watch.restart:
                begin = end + 1


def _by_samples(watch: Repeatable[State], piece: Recording, doubts: list[_Doubt], length: int) -> set[_Doubt]:
    """Return those of the FAULTs that so many last samples show."""
    u, y = _beside(piece)

    def last(x: np.ndarray, doubt: _Doubt) -> np.ndarray:
        """Return the last samples of a doubt, with absent ones before them where there are fewer."""
        part = x[doubt.recording, max(doubt.begin, doubt.end - length + 1) : doubt.end + 1]
        absent = np.full((length - len(part), part.shape[1]), np.nan, part.dtype)
        return np.concatenate([absent, part])

    proved: set[_Doubt] = set()
    ignorant = watch.forgetful()
    for first in range(0, len(doubts), BESIDE):
        some = doubts[first : first + BESIDE]
        us, ys = (np.stack([last(x, doubt) for doubt in some]) for x in (u, y))
        stretches = Recording(us, ys, NOWHERE, piece.inputs, piece.outputs)
        with outside_xla():
            _, judged = ignorant.judged(ignorant.begin(), stretches)
        shown = (judged.status == Status.FAULT).any(-1)
        proved.update(doubt for doubt, yes in zip(some, shown, strict=True) if yes)
    return proved


def _from_begin(watch: Repeatable[State], carry: State, piece: Recording, doubt: _Doubt) -> bool:
    """Return whether a FAULT is seen again where the observer is followed from where it began, or from the
    set that it carried to the piece.
    """
    alone, first = _of_recording(piece, doubt.recording), 0
    if doubt.anew:
        first = doubt.begin
        own = _ignorant(watch, carry.samples + first)  # blocks of samples begin where they did
        watch = watch.forgetful()
    else:
        own = _carried_of(watch, carry, doubt.recording)
    near = max(first, doubt.end + 1 - LENGTHS[-1])
    if near > first:
        own, _ = watch.judged(own, alone.cut(first, near))
    with outside_xla():
        _, judged = watch.judged(own, alone.cut(near, doubt.end + 1))
    return bool(judged.status[-1] == Status.FAULT)


def _ignorant(watch: Repeatable[State], samples: np.int64) -> State:
    """Return the state of an observer that knows nothing behind so many samples."""
    nothing: Any = watch.forgetful().begin()  # a NamedTuple, whatever fields a method has
    state: State = nothing._replace(samples=np.int64(samples))
    return state


def _lanes(watch: Repeatable[State], x: Array) -> np.ndarray:
    """Return numbers with sets side by side and recordings as axes of their own, the last ones."""
    x, lanes = np.asarray(x), len(watch.weights)
    return np.reshape(x, (*x.shape[:-1], lanes, x.shape[-1] // lanes))


def _ended(watch: Repeatable[State], carry: State) -> np.ndarray:
    """Return for each recording that is carried whether it has contradicted before."""
    return np.asarray(_lanes(watch, carry.carry.empty).any(-2))


def _carried_of(watch: Repeatable[State], carry: State, number: int) -> State:
    """Return the carry of one recording."""
    if len(_ended(watch, carry)) == 1:
        return carry
    state: Any = carry  # a NamedTuple, with whatever fields a method has beside the two that all have
    own: dict[str, Any] = {"carry": jax.tree.map(lambda x: _lanes(watch, x)[..., number], carry.carry)}
    for name, part in state._asdict().items():
        if name not in ("carry", "samples"):
            own[name] = jax.tree.map(lambda x: np.asarray(x)[..., number : number + 1], part)
    alone: State = state._replace(**own)
    return alone


def _of_recording(piece: Recording, number: int) -> Recording:
    """Return one recording of a piece of several."""
    if piece.y.ndim == 2:
        return piece
    u, y = _beside(piece)
    return replace(piece, u=u[number], y=y[number])


def _beside(piece: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Return u (N, T, m), y (N, T, p) of a piece, whatever its leading axes."""
    count = math.prod(piece.y.shape[:-2])
    u, y = np.asarray(piece.u), np.asarray(piece.y)
    return u.reshape(count, *u.shape[-2:]), y.reshape(count, *y.shape[-2:])
