"""One list of boxes for all targets of a batch, worked off level by level: the host only drives.

A level judges all its boxes in blocks of fixed sizes, by one compiled kernel; what is neither excluded nor
settled is cut in two. That gives the same boxes and counts as one target at a time, first in, first out.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

import jax
import numpy as np

from jaxbound.sets.floats.status import Status

__all__ = ["BLOCKS", "Cover", "Verdicts", "bisected", "explore", "in_blocks"]

BLOCKS = (2**10,)  # the only sizes that are compiled, the smaller for levels that fit into one
MOST = 10**8  # boxes of all targets together: what memory holds


Array = TypeVar("Array", np.ndarray, jax.Array)
Boxes: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
"""lo, hi (n, N) and owner (N,)."""


class Verdicts(NamedTuple, Generic[Array]):
    """The verdicts of a kernel on N boxes (n, N). None: nothing to say.

    Fields: keep (N,): neither excluded nor settled; proved (N,): `proof` holds a solution of the box's
    target; proof: (lo, hi) (n, N);
    rest: (lo, hi) (n, N), the box without parts that hold no solution; axis (N,): along which to cut.
    """

    keep: Array
    proved: Array | None = None
    proof: tuple[Array, Array] | None = None
    rest: tuple[Array, Array] | None = None
    axis: Array | None = None


Kernel: TypeAlias = Callable[..., Verdicts[jax.Array] | tuple[Any, ...] | jax.Array]
"""Judges the boxes lo, hi (n, N) of owner (N,)."""


@dataclass(frozen=True, eq=False)
class Cover:
    """The end of an exploration. lo, hi (n, N), owner (N,): boxes left; proofs: (lo (n, K), hi, owner (K,));
    counts (B,); levels.
    """

    lo: np.ndarray
    hi: np.ndarray
    owner: np.ndarray
    proofs: Boxes
    evaluated: np.ndarray
    levels: int

    def status(self, count: int) -> np.ndarray:
        """Return the status (count,): FAULT where no box is left, CONSISTENT where one is a proof."""
        left = np.bincount(self.owner, minlength=count)
        status = np.where(left == 0, np.int8(Status.FAULT), np.int8(Status.UNDECIDED))
        status[self.proofs[2]] = Status.CONSISTENT
        return status


def explore(
    kernel: Kernel,
    lo: np.ndarray,
    hi: np.ndarray,
    count: int,
    depth: int,
    max_boxes: int,
    axis: str = "alternate",
    first: bool = False,
    progress: Callable[[float], object] | None = None,
    sizes: Sequence[int] = BLOCKS,
) -> Cover:
    """Judge and cut boxes until none is left or the budget is spent.

    Args:
        kernel: of (lo, hi, owner) of a block; returns Verdicts of arrays, or keep alone.
        lo, hi: the first box (n,), the same for all `count` targets.
        depth, max_boxes: no more levels than this; a target is left as it is before a level that would bring
            its boxes evaluated above.
        axis: "alternate", "widest" (the first if equal) or "kernel": where boxes are cut.
        first: drop all boxes of a target once one solution is proved.
        progress: called with the share of levels done. sizes: of blocks, the smaller for levels that fit into
            one.

    Returns:
        A Cover. A box too narrow to be cut in floats stays as it is.
    """
    n = len(lo)
    lo, hi = (np.repeat(x[:, None], count, 1) for x in (lo, hi))
    owner = np.arange(count, dtype=np.int32)
    evaluated, solved = np.zeros(count, np.int64), np.zeros(count, bool)
    aside: list[Boxes] = []
    proofs: list[Boxes] = []
    level = 0
    while level < depth and len(owner) and evaluated.sum() + len(owner) <= max(max_boxes, MOST):
        more = np.bincount(owner, minlength=count)
        if (spent := (evaluated + more > max_boxes)[owner]).any():
            aside.append((lo[:, spent], hi[:, spent], owner[spent]))
            lo, hi, owner = lo[:, ~spent], hi[:, ~spent], owner[~spent]
            continue
        evaluated += more
        verdicts: Verdicts[np.ndarray] = Verdicts(*in_blocks(kernel, lo, hi, owner, sizes))
        keep = verdicts.keep
        if verdicts.proved is not None and verdicts.proof is not None:
            which = np.flatnonzero(verdicts.proved)
            proofs.append((verdicts.proof[0][:, which], verdicts.proof[1][:, which], owner[which]))
            solved[owner[which]] = True
            keep = keep & ~solved[owner] if first else keep
        lo, hi = (lo, hi) if verdicts.rest is None else verdicts.rest
        going_on = np.flatnonzero(keep)
        lo, hi, owner = lo[:, going_on], hi[:, going_on], owner[going_on]
        if axis == "alternate":
            along = np.full(len(going_on), level % n)
        else:
            along = np.argmax(hi - lo, 0) if verdicts.axis is None else verdicts.axis[going_on]
            stuck = ~_cuttable(lo, hi, along)
            if stuck.any():
                aside.append((lo[:, stuck], hi[:, stuck], owner[stuck]))
                lo, hi, owner, along = lo[:, ~stuck], hi[:, ~stuck], owner[~stuck], along[~stuck]
        lo, hi, owner = bisected(lo, hi, owner, along)
        level += 1
        if progress is not None:
            progress(level / depth)
    lo, hi, owner = _join([(lo, hi, owner), *aside])
    if first and solved.any():
        open_ = ~solved[owner]
        lo, hi, owner = lo[:, open_], hi[:, open_], owner[open_]
    return Cover(lo, hi, owner, _join(proofs or [(lo[:, :0], hi[:, :0], owner[:0])]), evaluated, level)


def in_blocks(
    kernel: Kernel, lo: np.ndarray, hi: np.ndarray, owner: np.ndarray, sizes: Sequence[int] = BLOCKS
) -> tuple[Any, ...]:
    """Return the verdicts of a kernel on boxes (n, N), calling it with blocks of fixed sizes only: a tuple, N
    the last axis of everything.
    """
    total = lo.shape[1]
    size = sizes[0] if total <= sizes[0] else sizes[-1]
    running = []
    for start in range(0, total, size):
        block = [x[..., start : start + size] for x in (lo, hi, owner)]
        count = len(block[2])
        if count < size:
            block = [np.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, size - count)], mode="edge") for x in block]
        running.append((kernel(*block), count))  # runs while the host prepares the next one
    parts = []
    for said, count in running:
        fields = said if isinstance(said, tuple) else (said,)
        parts.append(jax.tree.map(lambda x, count=count: np.asarray(x)[..., :count], fields))
    whole: tuple[Any, ...] = jax.tree.map(lambda *x: np.concatenate(x, -1), *parts)
    return whole


def _join(parts: Iterable[Boxes]) -> Boxes:
    lo, hi, owner = (np.concatenate(x, -1) for x in zip(*parts, strict=True))
    return lo, hi, owner


def _middle(lo: np.ndarray, hi: np.ndarray, axis: np.ndarray) -> np.ndarray:
    columns = np.arange(lo.shape[1])
    return lo[axis, columns] * 0.5 + hi[axis, columns] * 0.5


def _cuttable(lo: np.ndarray, hi: np.ndarray, axis: np.ndarray) -> np.ndarray:
    middle, columns = _middle(lo, hi, axis), np.arange(lo.shape[1])
    return (lo[axis, columns] < middle) & (middle < hi[axis, columns])


def bisected(lo: np.ndarray, hi: np.ndarray, owner: np.ndarray, axis: np.ndarray) -> Boxes:
    """Cut boxes (n, N) in two, each along its axis; children follow each other."""
    columns, middle = np.arange(lo.shape[1]), _middle(lo, hi, axis)
    lo, hi = np.repeat(lo, 2, 1), np.repeat(hi, 2, 1)
    hi[axis, 2 * columns] = middle
    lo[axis, 2 * columns + 1] = middle
    return lo, hi, np.repeat(owner, 2)
