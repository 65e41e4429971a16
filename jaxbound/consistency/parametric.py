"""Models with uncertain parameters: windows are refuted by strips or at vertices, explained by a point, else
bisected.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.bisection import whole_budget
from jaxbound.consistency.drive import raw_outputs
from jaxbound.consistency.interface import (
    Array,
    Arrays,
    Budget,
    Cases,
    Open,
    Outs,
    Relations,
    Run,
    WindowTest,
)
from jaxbound.consistency.parametric_margins import parametric_margins
from jaxbound.consistency.parametric_windows import (
    BLOCK,
    LEAST,
    SEARCHED,
    Leaves,
    alone,
    bisected,
    by_vertices,
    cases,
    finite,
    refuted_boxes,
    terms_of,
)
from jaxbound.consistency.polynomial_reading import PolynomialReading, PolynomialRelations
from jaxbound.consistency.reading import Block, gather
from jaxbound.consistency.twice import warn_doubtful
from jaxbound.consistency.unproved import within
from jaxbound.recordings.arrays import refuse_infinite
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.equations import is_traced
from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla
from jaxbound.sets.floats.status import Status
from jaxbound.text.progress import Progress

LACKING = 2**5
"""Windows at once that lack the same samples, where they are few."""


class ParametricTest(WindowTest):
    """Tests windows of a model with uncertain parameters; see `parametric_windows`.

    The sign of the margin is the verdict's. Its size is that of the zonotope, with which the neglected
    monomials grow as one: for an UNDECIDED window the true margin is not above it.

    No fixed projection settles easy windows first (`WindowTest.easy`): the nominal model explains few of them
    (none of the example of Ploix 2006, whose parameters move outputs by far more than the noise), and a point
    of least squares in parameters and errors costs as much to prove as the one that is searched for.

    Args:
        budget: boxes into which the parameters of a window that stays open may be cut; None: one.
        lacking: whether windows lack samples: each pattern has kernels of its own, for too few windows to
            compile them.

    Raises:
        ValueError: a budget that is no whole number >= 1.
    """

    by_kernels = True
    weight = 16
    relations: PolynomialRelations
    sharded = False
    constants = None

    def __init__(
        self,
        relations: PolynomialRelations,
        method: str,
        dtype: DTypeLike,
        budget: Budget = None,
        lacking: bool = False,
    ) -> None:
        super().__init__(relations, method, dtype)
        self.budget = 1 if budget is None else whole_budget(budget)
        self.is_alone, self.proved = method == "box" or by_vertices(relations), relations.complete == "proved"
        self.confirms = not self.is_alone or self.budget > 1  # else all FAULT windows are asked at once
        self.lacking = lacking

    @property
    def block(self) -> int:
        """How many windows are judged at once; fewer where they lack samples."""
        if self.lacking:
            return 8 * LACKING
        return BLOCK if self.is_alone else SEARCHED

    @property
    def short(self) -> int:  # type: ignore[override]  # nobody sets it, here least of all
        """How many windows are judged at once where there are few: no fewer where kernels are compiled."""
        return LACKING if self.lacking else self.block

    def under(self, relations: Relations) -> WindowTest:
        """Return the same test under other bounds, with as many boxes."""
        return type(self)(cast(PolynomialRelations, relations), self.method, self.dtype, self.budget)

    @cached_property
    def reading(self) -> PolynomialReading:
        """How kernels read a window."""
        return self.relations.reading(self.dtype, self.method)

    def cases(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> Cases:
        """Return a test for each pattern of missing samples; the rarest stay open."""
        refuse_infinite("u", u, self.relations.model.inputs)
        refuse_infinite("y", y, self.relations.model.outputs)
        tests: list[tuple[WindowTest, np.ndarray]] = []
        for case, chosen in cases(self.relations, u, y, starts):
            test: WindowTest = self
            if case is None:
                test = Open(self, 0.0)
            elif case is not self.relations:
                test = ParametricTest(case, self.method, self.dtype, self.budget, lacking=True)
            tests.append((test, starts[chosen]))
        return tests

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (status, margin, open) of blocks of windows; open is what more boxes may decide."""
        judged: list[Arrays] = []
        for samples in map(finite, blocks):
            with outside_xla(self.lacking or is_outside_xla()):
                if self.is_alone:
                    said, margin, leaves = *self._alone(samples), None
                else:
                    size = samples[1].shape[-1]
                    said, margin, leaves, _ = bisected(self.reading, samples, self.proved, 1, size)
            status = self._confirmed(np.array(said), samples, leaves)
            margin = np.where((status != Status.FAULT) & (margin < 0), 0, margin)
            judged.append((status, margin, (status == Status.UNDECIDED) & (self.budget > 1)))
        return judged

    def _alone(self, samples: Block) -> tuple[Array, Array]:
        """Return (status, margin) of windows by each relation alone."""
        status, margin = alone(self.reading, terms_of(self.reading, *samples), self.proved)
        return status, margin

    def settle(self, u: np.ndarray, y: np.ndarray, outs: Outs, left: np.ndarray, progress: Progress) -> None:
        """Bisect the parameters of windows that were left open."""
        status, margin, *_ = outs
        for first in range(0, len(left), SEARCHED):
            at = left[first : first + SEARCHED] + self.horizon
            windows = finite(gather(u, y, at - self.horizon, self.lags, self.horizon))
            with outside_xla(self.lacking or is_outside_xla()):
                now, _, leaves, _ = bisected(self.reading, windows, self.proved, self.budget)
                now = self._confirmed(now, windows, leaves)
            status[at] = now
            margin[at] = np.where(now == Status.FAULT, np.minimum(margin[at], -LEAST), margin[at])
            margin[at] = np.where(now == Status.CONSISTENT, np.maximum(margin[at], LEAST), margin[at])
            progress((first + len(at)) / len(left))

    def _confirmed(self, status: np.ndarray, samples: Block, leaves: Leaves | None) -> np.ndarray:
        """Return the status of windows, UNDECIDED where NumPy does not refute each leaf of a FAULT; None:
        where no relation alone does.
        """
        fault = status == Status.FAULT
        if self.lacking or is_outside_xla() or not self.confirms or not fault.any():
            return status
        if leaves is None:
            at = np.flatnonzero(fault)
            chosen = np.resize(at, 2 ** len(at).bit_length())  # few sizes: each is a program to write down
            u, y = samples
            with outside_xla():
                again, _ = self._alone((u[..., chosen], y[..., chosen]))
            doubtful = at[np.asarray(again)[: len(at)] != Status.FAULT]
        else:
            leaves = leaves.chosen(fault[leaves.owner])
            doubtful = leaves.owner[~refuted_boxes(self.reading, samples, leaves)]
        if len(doubtful):
            status[doubtful] = Status.UNDECIDED
            warn_doubtful(f"{len(np.unique(doubtful))} windows of a block are FAULT by XLA")
        return status

    def margins(self, given: Recording) -> jax.Array:
        """Return the unproved margins (..., T); see `WindowTest.margins`."""
        if is_traced(given.u, given.y, *self.relations.bounds.values()):
            return within(parametric_margins(self.relations, given.u, given.y), given, self.horizon)
        test = ParametricTest(self.relations, self.method, self.dtype)
        _, margin = raw_outputs(test, given)
        return jnp.asarray(margin)
