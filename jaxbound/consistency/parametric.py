"""Models with uncertain parameters: windows are refuted by strips or at vertices, explained by a point, else
bisected.
"""

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.bisection import whole_budget
from jaxbound.consistency.drive import raw_outputs
from jaxbound.consistency.interface import (
    Again,
    Array,
    Arrays,
    Budget,
    Cases,
    Open,
    Outs,
    Progress,
    Run,
    WindowTest,
)
from jaxbound.consistency.parametric_margins import parametric_margins
from jaxbound.consistency.parametric_windows import (
    BLOCK,
    LEAST,
    SEARCHED,
    Leaves,
    bisected,
    by_vertices,
    cases,
    finite,
    judged_whole,
    refuted,
)
from jaxbound.consistency.polynomial_reading import PolynomialReading, PolynomialRelations
from jaxbound.consistency.reading import Block, gather
from jaxbound.consistency.twice import warn_doubtful
from jaxbound.consistency.unproved import is_traced, within
from jaxbound.recordings.arrays import refuse_infinite
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla
from jaxbound.sets.floats.status import Status

__all__ = ["ParametricTest"]

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
        self.lacking = lacking
        # by vertices, or relation by relation, many windows are seen again at once, behind the driver
        self.confirms = not self.is_alone or self.budget > 1

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

    @cached_property
    def reading(self) -> PolynomialReading:
        """How kernels read a window."""
        return self.relations.reading(self.dtype, self.method)

    @cached_property
    def _on_device(self) -> PolynomialReading:
        on_device: PolynomialReading = jax.device_put(self.reading)
        return on_device

    @property
    def _read(self) -> PolynomialReading:
        """The reading where kernels take it: outside XLA that of the host, which no device has copied."""
        if is_outside_xla():
            return self.reading
        return self._on_device

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

    def _where(self) -> AbstractContextManager[None]:
        """Return the context in which kernels run."""
        return outside_xla() if self.lacking else nullcontext()

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (status, margin, open) of blocks of windows; open is what more boxes may decide."""
        # all blocks are under way before the host waits for the first
        with self._where():
            whole = [judged_whole(self._read, finite(block), self.is_alone, self.proved) for block in blocks]
        judged: list[Arrays] = []
        for block, (said, margin, h) in zip(blocks, whole, strict=True):
            status, doubtful = np.array(said), self._doubtful(finite(block), said, h)
            status[doubtful] = Status.UNDECIDED
            left = (status == Status.UNDECIDED) & (self.budget > 1)
            judged.append((status, np.where(doubtful, 0, margin), left))
        return judged

    def _doubtful(self, samples: Block, status: Array, h: Array | None) -> np.ndarray:
        """Return (N,) bool: which FAULT windows of a block NumPy does not refute from their samples."""
        fault: np.ndarray = np.asarray(status) == Status.FAULT
        if self.lacking or is_outside_xla() or not self.confirms or not fault.any():
            return np.zeros(len(fault), bool)
        at = np.flatnonzero(fault)
        if h is None:
            chosen = np.resize(at, len(fault))
            with outside_xla():
                u, y = samples
                again = judged_whole(self.reading, (u[..., chosen], y[..., chosen]), self.is_alone, False)
            proved = np.asarray(again[0])[: len(at)] == Status.FAULT
        else:
            one = np.ones((len(self.reading.size), len(at)), self.dtype)
            proved = refuted(self.reading, samples, Leaves(at, -one, one, np.asarray(h)[:, at]))
        fault[at[proved]] = False
        if fault.any():
            warn_doubtful(f"{fault.sum()} windows of a block are FAULT by XLA")
        return fault

    def settle(
        self, u: np.ndarray, y: np.ndarray, outs: Outs, left: np.ndarray, again: Again, progress: Progress
    ) -> None:
        """Bisect the parameters of windows that were left open."""
        status, margin = outs
        for first in range(0, len(left), SEARCHED):
            at = left[first : first + SEARCHED] + self.horizon
            windows = finite(gather(u, y, at - self.horizon, self.lags, self.horizon))
            with self._where():
                now, leaves, _ = bisected(self.reading, windows, self.proved, self.budget)
                now = self._confirmed(now, windows, leaves)
            status[at] = now
            margin[at] = np.where(now == Status.FAULT, np.minimum(margin[at], -LEAST), margin[at])
            margin[at] = np.where(now == Status.CONSISTENT, np.maximum(margin[at], LEAST), margin[at])
            progress((first + len(at)) / len(left))

    def _confirmed(self, status: np.ndarray, samples: Block, leaves: Leaves) -> np.ndarray:
        """Return the status of windows, UNDECIDED where NumPy does not refute each leaf of a FAULT."""
        if is_outside_xla():
            return status
        leaves = leaves.chosen(status[leaves.owner] == Status.FAULT)
        doubtful = leaves.owner[~refuted(self.reading, samples, leaves)]
        if len(doubtful):
            status[doubtful] = Status.UNDECIDED
            warn_doubtful(f"{len(np.unique(doubtful))} windows are FAULT by boxes that XLA refuted")
        return status

    def margins(self, given: Recording) -> jax.Array:
        """Return the unproved margins (..., T); see `WindowTest.margins`."""
        if is_traced(given.u, given.y, *self.relations.bounds.values()):
            return within(parametric_margins(self.relations, given.u, given.y), given, self.horizon)
        test = ParametricTest(self.relations, self.method, self.dtype)
        _, margin = raw_outputs(test, given.u, given.y, given.starts)
        return jnp.asarray(margin)
