"""One list of boxes for all targets of a batch, worked off level by level: the host only drives.

A level is judged as a whole; what is neither excluded nor settled is cut in two. That gives the same boxes
and counts as one target at a time, first in, first out. Compiled kernels judge blocks of one size
(`judged_in_blocks`).
"""

from collections.abc import Callable, Iterator
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

import jax
import numpy as np

from jaxbound.sets.floats.status import Status

BLOCK = 2**10  # the only size that is compiled
MOST = 10**8  # boxes of all targets together: what memory holds


Array = TypeVar("Array", np.ndarray, jax.Array)


class Boxes(NamedTuple):
    """Boxes lo, hi (n, N) of targets owner (N,)."""

    lo: np.ndarray
    hi: np.ndarray
    owner: np.ndarray

    @classmethod
    def repeated(cls, lo: np.ndarray, hi: np.ndarray, count: int) -> "Boxes":
        """Return one box (n,) for each of `count` targets."""
        owner = np.arange(count, dtype=np.int32)
        return cls(np.repeat(lo[:, None], count, 1), np.repeat(hi[:, None], count, 1), owner)

    def chosen(self, which: np.ndarray) -> "Boxes":
        """Return some of them."""
        return Boxes(*(x[..., which] for x in self))

    def beside(self, *more: "Boxes") -> "Boxes":
        """Return these and others."""
        return Boxes(*(np.concatenate(x, -1) for x in zip(self, *more, strict=True)))


class Verdicts(NamedTuple, Generic[Array]):
    """The verdicts on N boxes (n, N). None: nothing to say.

    Fields: keep (N,): neither excluded nor settled; proved (N,): `proof` holds a solution of the box's
    target; proof: (lo, hi) (n, N);
    rest: (lo, hi) (n, N), the box without parts that hold no solution; axis (N,): along which to cut, -1
    where a box stays as it is.
    """

    keep: Array
    proved: Array | None = None
    proof: tuple[Array, Array] | None = None
    rest: tuple[Array, Array] | None = None
    axis: Array | None = None


Kernel: TypeAlias = Callable[..., Verdicts[jax.Array] | tuple[Any, ...] | jax.Array]
"""Judges the boxes lo, hi (n, N) of owner (N,)."""


class Cover(NamedTuple):
    """The state of an exploration: boxes left, proofs, counts evaluated (B,), levels."""

    boxes: Boxes
    proofs: Boxes
    evaluated: np.ndarray
    levels: int

    @property
    def status(self) -> np.ndarray:
        """The status (B,): FAULT where no box is left, CONSISTENT where one is a proof."""
        left = np.bincount(self.boxes.owner, minlength=len(self.evaluated))
        status = np.where(left == 0, np.int8(Status.FAULT), np.int8(Status.UNDECIDED))
        status[self.proofs.owner] = Status.CONSISTENT
        return status


def explore(
    judge: Callable[[np.ndarray, np.ndarray, np.ndarray], Verdicts[np.ndarray]],
    now: Boxes,
    depth: int,
    max_boxes: int,
    axis: str = "kernel",
    first: bool = False,
) -> Iterator[Cover]:
    """Judge and cut boxes until none is left or the budget is spent: yield a Cover before each level, and the
    last one.

    Args:
        judge: of (lo, hi, owner) of a level.
        now: the first box of each target.
        depth, max_boxes: no more levels than this; a target is left as it is before a level that would bring
            its boxes evaluated above.
        axis: "alternate", "widest" (the first if equal) or "kernel": where boxes are cut. But for
            "alternate", one too narrow to be cut in floats stays as it is.
        first: drop all boxes of a target once one solution is proved.
    """
    count = len(now.owner)
    aside = proofs = now.chosen(np.zeros(count, bool))
    evaluated, solved, level = np.zeros(count, np.int64), np.zeros(count, bool), 0
    while True:
        # a target is left as a whole: part of a level would be no cover of it
        spent = (evaluated + np.bincount(now.owner, minlength=count) > max_boxes)[now.owner]
        aside, now = aside.beside(now.chosen(spent)), now.chosen(~spent)
        if first:
            aside, now = (x.chosen(~solved[x.owner]) for x in (aside, now))
        yield Cover(now.beside(aside), proofs, evaluated, level)
        number = len(now.owner)
        if level == depth or not number or evaluated.sum() + number > max(max_boxes, MOST):
            return
        evaluated = evaluated + np.bincount(now.owner, minlength=count)
        verdicts = judge(*now)
        if verdicts.proved is not None and verdicts.proof is not None:
            found = Boxes(*verdicts.proof, now.owner).chosen(verdicts.proved)
            solved[found.owner] = True
            # proofs may have other unknowns beside those of boxes
            proofs = proofs.beside(found) if len(proofs.owner) else found
        if verdicts.rest is not None:
            now = Boxes(*verdicts.rest, now.owner)
        now = now.chosen(verdicts.keep)
        along = np.full(len(now.owner), level % len(now.lo))
        if axis != "alternate":
            along = np.argmax(now.hi - now.lo, 0)
            if verdicts.axis is not None:
                along = verdicts.axis[verdicts.keep]
            cut = (along >= 0) & _cuttable(now, along)
            aside, now, along = aside.beside(now.chosen(~cut)), now.chosen(cut), along[cut]
        now = _bisected(now, along)
        level += 1


def judged_in_blocks(
    kernel: Kernel, lo: np.ndarray, hi: np.ndarray, owner: np.ndarray, size: int = BLOCK
) -> tuple[Any, ...]:
    """Return the verdicts of a kernel on boxes (n, N), calling it with blocks of one size only: a tuple, N
    the last axis of everything.
    """
    total = lo.shape[1]
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


def _middle(boxes: Boxes, axis: np.ndarray) -> np.ndarray:
    columns = np.arange(len(axis))
    return boxes.lo[axis, columns] * 0.5 + boxes.hi[axis, columns] * 0.5


def _cuttable(boxes: Boxes, axis: np.ndarray) -> np.ndarray:
    middle, columns = _middle(boxes, axis), np.arange(len(axis))
    return (boxes.lo[axis, columns] < middle) & (middle < boxes.hi[axis, columns])


def _bisected(boxes: Boxes, axis: np.ndarray) -> Boxes:
    """Cut each box in two, along its axis; children follow each other."""
    columns, middle = np.arange(len(axis)), _middle(boxes, axis)
    both = boxes.chosen(np.repeat(columns, 2))
    both.hi[axis, 2 * columns] = middle
    both.lo[axis, 2 * columns + 1] = middle
    return both
