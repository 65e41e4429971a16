"""Verdicts on a user's own residual: adaptive bisection of its unknowns, all windows on one list of boxes.

CONSISTENT is proved for the samples that are computed with: as recorded, in the type of y. FAULT is proved
for all samples within what a recording rounds away, like everywhere in this library: a window that only its
last digits put outside is UNDECIDED.
"""

# mypy: allow-empty-bodies
# of members that are declared for whoever checks types, and have their values elsewhere

import contextlib
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.interface import Arrays, Budget, Cases, Open, Relations, Run, WindowTest
from jaxbound.consistency.reading import Block
from jaxbound.models.sensor import RECORDER_ULPS, input_slip
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import outside_xla
from jaxbound.sets.floats.status import Status
from jaxbound.sets.inclusion.functions import frozen
from jaxbound.sets.inclusion.inclusion import inclusion
from jaxbound.sets.intervals.interval import Interval
from jaxbound.sets.paving.paving import Paving, pave

BUDGET = 1000
"""Boxes that may be evaluated for a window."""
Function: TypeAlias = Callable[..., Any]
"""f(z, u_window, y_window) -> arrays that are all 0 for some z, as a user writes it."""


class ResidualRelations(Relations):
    """f(z, u_window, y_window) = 0 for some z in a box: `relations.residual` has them."""

    untuned: ClassVar[str | None] = (
        ", whose verdict comes from bisection, with no margin to scale or to derive: try boxes by "
        "with_bounds and detect"
    )

    if TYPE_CHECKING:

        @property
        def f(self) -> Function:
            """The residual."""

        @property
        def box(self) -> Interval:
            """(n,): the unknowns."""

    def shape(self, m: int, p: int) -> int:
        """Return the number of residuals for windows of m inputs and p outputs."""
        raise NotImplementedError


@dataclass(frozen=True)
class Thick:
    """The residual over boxes and intervals of samples, as a function of Intervals: it can exclude, and needs
    no slopes of the samples.
    """

    f: Function

    def __call__(
        self, z: Interval, u_lo: jax.Array, u_hi: jax.Array, y_lo: jax.Array, y_hi: jax.Array
    ) -> Interval:
        """Return an enclosure of the residual."""
        enclosure: Interval = inclusion(flat(self.f), "best")(z, Interval(u_lo, u_hi), Interval(y_lo, y_hi))
        return enclosure


class BisectionTest(WindowTest):
    """Bisects the unknowns of a residual: FAULT and CONSISTENT are proofs. No gauge is measured, the margin
    is NaN.

    Args:
        budget: boxes that may be evaluated for a window; None: `BUDGET`.

    Raises:
        ValueError: a budget that is no whole number >= 1.
    """

    relations: ResidualRelations
    confirms = by_kernels = True
    weight = 16
    block, short = 2**13, 2**8
    padded = sharded = False
    constants = None

    def __init__(
        self, relations: ResidualRelations, method: str, dtype: DTypeLike, budget: Budget = None
    ) -> None:
        super().__init__(relations, method, dtype)
        self.budget = BUDGET if budget is None else whole_budget(budget)
        _ = relations.count  # refuses a function that gives nothing to be zero, and signals without names

    @cached_property
    def kind(self) -> Hashable:
        """The function, which programs are made for, and their size."""
        return type(self), self.horizon, self.budget, str(self.dtype), self.relations.f

    @property
    def lags(self) -> int:
        """How many samples of u a window has: all."""
        return self.horizon + 1

    def margins(self, given: Recording) -> jax.Array:
        """Raise NotImplementedError: the unknowns of a residual are a box, not a set of half-widths."""
        raise NotImplementedError(
            "a residual has no margin: its unknowns are a box, with no common factor on half-widths to be "
            "found"
        )

    def cases(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> Cases:
        """Leave out windows that miss samples; what is infinite leaves them open."""
        samples = np.concatenate([u, y], 1)
        lacking = span(np.isnan(samples), starts, self.lags)
        endless = span(np.isinf(samples), starts, self.lags)
        cases: list[tuple[WindowTest, np.ndarray]] = []
        whole = starts[~lacking & ~endless]
        if len(whole):
            cases.append((self, whole))
        # an infinite sample is a sample, which no inclusion of f can follow
        if endless.any():
            cases.append((Open(self, np.nan), starts[endless]))
        return cases

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (status, margin) of windows."""
        judged = []
        for u, y in blocks:
            status = self._judged(np.moveaxis(u, -1, 0), np.moveaxis(y, -1, 0))
            judged.append((status, np.full(len(status), np.nan, self.dtype)))
        return judged

    def _judged(self, U: np.ndarray, Y: np.ndarray) -> np.ndarray:
        """Return the status of windows (N, s + 1, channels): FAULT where NumPy excludes all unknowns."""
        status = np.array(search_unknowns(self.relations, U, Y, self.budget).status)
        outside = np.flatnonzero(status == Status.FAULT)
        if len(outside):
            # until NumPy has excluded all unknowns for everything that rounds to these samples
            status[outside] = Status.UNDECIDED
            # a primitive of a newer jax, which NumPy does not know, excludes nothing
            with outside_xla(), contextlib.suppress(NotImplementedError):
                # all unknowns, for all that rounds to the recorded samples
                f, samples = Thick(frozen(self.relations.f)), thick(U[outside], Y[outside])
                status[outside] = _paved(self.relations, f, samples, self.budget, "none", "widest").status
        return status


def span(bad: np.ndarray, starts: np.ndarray, length: int) -> np.ndarray:
    """Return whether any of so many samples from each of `starts` on is bad (T, channels)."""
    counted = np.concatenate([[0], np.cumsum(bad.any(1))])
    return np.asarray(counted[starts + length] > counted[starts])


def whole_budget(budget: object) -> int:
    """Return a budget of boxes a window; raise ValueError if it is none."""
    if isinstance(budget, bool) or not isinstance(budget, int | np.integer) or budget < 1:
        raise ValueError(f"budget must be a whole number of boxes a window >= 1, not {budget!r}")
    return int(budget)


def search_unknowns(relations: ResidualRelations, U: np.ndarray, Y: np.ndarray, budget: int) -> Paving:
    """Search for unknowns that explain each window."""
    return _paved(relations, flat(frozen(relations.f)), (U, Y), budget, solutions="one", cut="smear")


def thick(U: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return (lo, hi) of all inputs that round to ours, then of all samples that round to the recorded
    ones.
    """
    slip = 2 * input_slip(U)  # 2, here and below: for this computation
    ulps = RECORDER_ULPS + 2  # unit roundoffs of the largest sample in the window
    spread = ulps * rounding.unit(Y.dtype) * np.abs(Y).max(1, keepdims=True) + 2 * rounding.tiny(Y.dtype)
    return U - slip, U + slip, Y - spread, Y + spread


def _paved(
    relations: ResidualRelations,
    f: Callable[..., Any],
    windows: tuple[np.ndarray, ...],
    budget: int,
    solutions: str,
    cut: str,
) -> Paving:
    """Pave for every window."""
    inputs, outputs = windows[0], windows[-1]
    dtype = np.result_type(relations.box.dtype, outputs.dtype)
    lo, hi = np.asarray(relations.box.lo, dtype), np.asarray(relations.box.hi, dtype)
    box = Interval(lo, hi)
    zero = np.zeros((len(inputs), relations.shape(inputs.shape[-1], outputs.shape[-1])), dtype)
    depth = box.shape[0] * (np.finfo(dtype).nmant + 1) // 2
    return pave(
        f,
        box,
        Interval(zero, zero),
        max_boxes=budget,
        max_depth=depth,
        args=windows,
        solutions=solutions,
        cut=cut,
    )


@dataclass(frozen=True)
class flat:
    """f with all its results in one array; two of one f are equal, so that they share a compilation."""

    f: Function

    def __call__(self, z: jax.Array, u: jax.Array, y: jax.Array) -> jax.Array:
        """Return the results of f end to end."""
        parts = [jnp.ravel(x) for x in jax.tree.leaves(self.f(z, u, y))]
        return jnp.concatenate(parts) if parts else jnp.zeros(0, z.dtype)
