"""Verdicts on a user's own residual: adaptive bisection of its unknowns, all windows on one list of boxes.

CONSISTENT is proved for the samples that are computed with: as recorded, in the type of y. FAULT is proved
for all samples within what a recording rounds away, like everywhere in this library: a window that only its
last digits put outside is UNDECIDED.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.gridding import whole_windows
from jaxbound.consistency.interface import Budget, Relations, WindowTest
from jaxbound.models.sensor import RECORDER_ULPS, input_slip
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.status import Status
from jaxbound.sets.inclusion.inclusion import inclusion
from jaxbound.sets.intervals.interval import Interval
from jaxbound.sets.paving.paving import pave

__all__ = ["BUDGET", "BisectionTest", "flat", "search", "whole_budget"]

BUDGET = 1000
"""Boxes that may be evaluated for a window."""


@dataclass(frozen=True)
class _Thick:
    """The residual over boxes and intervals of samples, as a function of Intervals: it can exclude, and needs
    no slopes of the samples.
    """

    f: Callable

    def __call__(self, z, u_lo, u_hi, y_lo, y_hi):
        return inclusion(flat(self.f), "best")(z, Interval(u_lo, u_hi), Interval(y_lo, y_hi))


class BisectionTest(WindowTest):
    """Bisects the unknowns of a residual: FAULT and CONSISTENT are proofs. No gauge is measured, the margin
    is NaN.

    Args:
        budget: boxes that may be evaluated for a window; None: `BUDGET`.

    Raises:
        ValueError: a budget that is no whole number >= 1.
    """

    padded = sharded = False
    block, short = 2**13, 2**8
    constants = None

    def __init__(self, relations: Relations, method: str, dtype: DTypeLike, budget: Budget = None) -> None:
        super().__init__(relations, method, dtype)
        self.budget = BUDGET if budget is None else whole_budget(budget)
        _ = relations.count  # refuses a function that gives nothing to be zero, and signals without names

    @property
    def lags(self) -> int:
        """How many samples of u a window has: all."""
        return self.horizon + 1

    def cases(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> list:
        """Leave out windows with missing samples."""
        return whole_windows(self, u, y, starts)

    def judge(self, run: Callable, blocks: list) -> list:
        """Return (status, margin) of windows."""
        found = [self._judged(*(np.moveaxis(x, -1, 0) for x in block)) for block in blocks]
        return [(status, np.full(len(status), np.nan, self.dtype)) for status in found]

    def margins(self, given: Recording) -> jax.Array:
        """Raise: a residual is any function of its unknowns, and what is no set of half-widths has no common
        factor on them.
        """
        raise NotImplementedError(
            "a residual has no margin: its unknowns are a box, with no common factor on half-widths to be "
            "found"
        )

    def _judged(self, U, Y):
        """Return the status of windows (N, s + 1, channels), their number filled up to one of two sizes,
        which alone are compiled.
        """
        size = self.short if len(Y) <= self.short else self.block
        status = search(self.relations, U, Y, self.budget, size).status.copy()
        outside = np.flatnonzero(status == Status.FAULT)
        if len(outside):
            status[outside] = _exclude(self.relations, U[outside], Y[outside], self.budget, size).status
        return status


def whole_budget(budget: Any) -> int:
    """Return a budget of boxes a window; raise ValueError if it is none."""
    if isinstance(budget, bool) or not isinstance(budget, int | np.integer) or budget < 1:
        raise ValueError(f"budget must be a whole number of boxes a window >= 1, not {budget!r}")
    return int(budget)


def search(relations: Any, U: np.ndarray, Y: np.ndarray, budget: int, size: int = BisectionTest.short) -> Any:
    """Search for unknowns that explain each window."""
    return _pave(relations, flat(relations.f), (U, Y), budget, size, solutions="one", cut="smear")


def _exclude(relations, U, Y, budget, size):
    """Exclude unknowns for all samples that round to the recorded ones, and all inputs that round to what is
    computed with.
    """
    samples, slip = recorded(Y, RECORDER_ULPS + 2), 2 * input_slip(U)  # 2: for this computation
    return _pave(
        relations,
        _Thick(relations.f),
        (U - slip, U + slip, *samples),
        budget,
        size,
        solutions="none",
        cut="widest",
    )


def _pave(relations, f, windows, budget, size, **options):
    """Pave for every window, their number filled up to `size` by targets that are empty, which the first box
    excludes.
    """
    count, dtype = len(windows[0]), np.result_type(relations.box.dtype, windows[-1].dtype)
    box = Interval(*(np.asarray(end).astype(dtype) for end in (relations.box.lo, relations.box.hi)))
    args = tuple(np.concatenate([x, np.zeros((size - count, *x.shape[1:]), x.dtype)]) for x in windows)
    filler = np.repeat(
        (np.arange(size) >= count)[:, None], relations.shape(windows[0].shape[-1], windows[-1].shape[-1]), 1
    )
    target = Interval(np.where(filler, np.inf, 0).astype(dtype), np.where(filler, -np.inf, 0).astype(dtype))
    depth = box.shape[0] * (np.finfo(dtype).nmant + 1) // 2
    found = pave(f, box, target, max_boxes=budget, max_depth=depth, args=args, **options)
    return dataclasses.replace(
        found, status=np.asarray(found.status)[:count], evaluated=found.evaluated[:count]
    )


@dataclass(frozen=True)
class flat:
    """f with everything it returns in one array; two of one f are equal, so that they share a compilation."""

    f: Callable

    def __call__(self, z: Any, u: Any, y: Any) -> Any:
        """Return what f returns, end to end."""
        parts = [jnp.ravel(x) for x in jax.tree.leaves(self.f(z, u, y))]
        return jnp.concatenate(parts) if parts else jnp.zeros(0, z.dtype)


def recorded(y: Any, ulps: float) -> tuple[Any, Any]:
    """Return (lo, hi) of what was recorded as y (N, s + 1, p): samples are known to so many unit roundoffs of
    the largest in the window.
    """
    spread = ulps * rounding.unit(y.dtype) * np.abs(y).max(1, keepdims=True) + 2 * rounding.tiny(y.dtype)
    return y - spread, y + spread
