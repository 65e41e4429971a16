"""A FAULT of a set observer, decided a second time outside XLA: see `consistency.twice`.

The observer follows the last samples before a FAULT once more, its kernels evaluated in NumPy: 4 of them,
then 16, 64, 256, 1024, as far back as it began, knowing nothing of the state before. What contradicts then
contradicts. Only what rests on more samples than these, or on samples of a piece before that nobody keeps,
begins with the set that XLA carried to there.
"""

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import numpy as np

from jaxbound.consistency.interface import Judged
from jaxbound.consistency.twice import warn_doubtful
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla
from jaxbound.sets.floats.status import Status

__all__ = ["decided_twice"]

LENGTHS = (4, 16, 64, 256, 1024)
"""Samples that are followed once more."""
BESIDE = 128
"""Stretches that are followed side by side, at most."""


@dataclass(frozen=True)
class _Doubt:
    """A FAULT to be decided again. Fields: recording; begin, end: the first sample that it rests on, in its
    piece, and its own.
    """

    recording: int
    begin: int
    end: int


def decided_twice(watch: Any, carry: Any, piece: Recording) -> tuple[Any, Any]:
    """Return what `watch.judged` does, with UNDECIDED in place of a FAULT that is not proved outside XLA; a
    warning tells of them.

    Where one is taken back the observer goes on knowing nothing: what XLA carried is not to be trusted.

    Args:
        watch: a SetObserver. carry: what it carried to the piece.
    """
    after, told = watch.judged(carry, piece)
    status = np.asarray(told.status)
    if is_outside_xla() or not (status == Status.FAULT).any():
        return after, told
    gone = _doubtful(watch, carry, piece, status)
    if not gone.any():
        return after, told
    status = np.where(gone, np.int8(Status.UNDECIDED), status).astype(np.int8)
    margin = np.where(gone, 0, told.margin).astype(np.asarray(told.margin).dtype)
    changed: Any = told._replace if isinstance(told, Judged) else partial(replace, told)
    return _forgetful(watch).init(), changed(status=status, margin=margin)


def _doubtful(watch, carry, piece, status):
    """Return bool like status (..., T): which FAULTs of a piece are not proved outside XLA."""
    flat = status.reshape(-1, status.shape[-1])
    left = list(_doubts(watch, carry, piece, flat))
    shorter = watch.shown_after
    for length in LENGTHS:
        near = [doubt for doubt in left if doubt.end - doubt.begin >= shorter]
        refuted = _by_samples(watch, piece, near, length)
        left = [doubt for doubt in left if doubt not in refuted]
        shorter = length
    left = [doubt for doubt in left if not _by_carry(watch, carry, piece, doubt)]
    gone = np.zeros(flat.shape, bool)
    for doubt in left:
        behind = flat[doubt.recording, doubt.end :] != Status.FAULT
        count = (
            1 if watch.restart else int(np.append(behind, True).argmax())
        )  # a FAULT that stays goes as a whole
        gone[doubt.recording, doubt.end : doubt.end + count] = True
    if left:
        warn_doubtful(
            f"{len(left)} samples are FAULT by an observer in XLA, the first of them is sample {left[0].end} "
            f"of its piece"
        )
    return gone.reshape(status.shape)


def _forgetful(watch):
    """Return the same observer, which begins knowing nothing."""
    watch = copy.copy(watch)
    watch._x0 = watch._carried = None
    watch.__dict__.pop("_first", None)  # what "joint" works out of x0
    return watch


def _doubts(watch, carry, piece, status) -> Iterator[_Doubt]:
    """Yield the FAULTs of recordings (N, T); of one that stays, the first."""
    seams = {0, *np.asarray(piece.starts).tolist()}
    if piece.excluded is not None:
        seams.update(np.flatnonzero(piece.excluded).tolist())
    ordered = np.array(sorted(seams))
    before = np.broadcast_to(_ended(watch, carry), len(status))
    for recording, row in enumerate(status):
        begin, faulty = 0, bool(before[recording]) and not watch.restart
        for end in np.flatnonzero(row == Status.FAULT).tolist():
            seam = int(ordered[np.searchsorted(ordered, end, "right") - 1])
            lasting = not watch.restart and end and row[end - 1] == Status.FAULT and seam != end
            if not lasting and not (faulty and not end and 0 not in np.asarray(piece.starts)):
                yield _Doubt(recording, max(begin, seam), end)
            begin = end + 1 if watch.restart else begin


def _by_samples(watch, piece, doubts, length):
    """Return those of the FAULTs that so many last samples show, as a set."""
    u, y = _beside(piece)
    cut = lambda x, doubt: x[doubt.recording, max(doubt.begin, doubt.end - length + 1) : doubt.end + 1]
    filled = lambda part: np.concatenate(
        [np.full((length - len(part), part.shape[1]), np.nan, part.dtype), part]
    )
    found: set[_Doubt] = set()
    watch = _forgetful(watch)
    for first in range(0, len(doubts), BESIDE):
        some = doubts[first : first + BESIDE]
        us, ys = (np.stack([filled(cut(x, doubt)) for doubt in some]) for x in (u, y))
        with outside_xla():
            _, judged = watch.judged(watch.init(), Recording(us, ys, NOWHERE, piece.inputs, piece.outputs))
        shown = (judged.status == Status.FAULT).any(-1)
        found.update(doubt for doubt, yes in zip(some, shown, strict=True) if yes)
    return found


def _by_carry(watch, carry, piece, doubt):
    """Say whether a FAULT is seen again from what XLA carried to a sample not long before it, or to the
    piece.
    """
    alone, own = _of_recording(piece, doubt.recording), _carried_of(watch, carry, doubt.recording)
    near = max(0, doubt.end + 1 - LENGTHS[-1])
    if near:
        own, _ = watch.judged(own, alone.cut(0, near))
    with outside_xla():
        _, judged = watch.judged(own, alone.cut(near, doubt.end + 1))
    return bool(judged.status[-1] == Status.FAULT)


def _lanes(watch, x):
    """Return numbers with sets side by side and recordings as axes of their own, the last ones."""
    x, lanes = np.asarray(x), len(watch.weights)
    return x.reshape(*x.shape[:-1], lanes, x.shape[-1] // lanes)


def _ended(watch, carry):
    """Return for each recording that is carried whether it has contradicted before."""
    return _lanes(watch, carry.carry.empty).any(-2)


def _carried_of(watch, carry, number):
    """Return what is carried of one recording."""
    count = len(_ended(watch, carry))
    if count == 1:
        return carry
    own = carry._replace(carry=jax.tree.map(lambda x: _lanes(watch, x)[..., number], carry.carry))
    rest = {
        name: jax.tree.map(lambda x: np.asarray(x)[..., number : number + 1], x)
        for name, x in carry._asdict().items()
        if name not in ("carry", "samples")
    }
    return own._replace(**rest)


def _of_recording(piece, number):
    """Return one recording of a piece of several."""
    if piece.y.ndim == 2:
        return piece
    u, y = _beside(piece)
    return replace(piece, u=u[number], y=y[number])


def _beside(piece):
    """Return u (N, T, m), y (N, T, p) of a piece, whatever its leading axes."""
    count = math.prod(piece.y.shape[:-2])
    return [np.asarray(x).reshape(count, *x.shape[-2:]) for x in (piece.u, piece.y)]
