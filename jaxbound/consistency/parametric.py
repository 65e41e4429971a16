"""Models with uncertain parameters: windows are refuted by strips or at vertices, explained by a point, else
bisected.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import jax
import numpy as np

from jaxbound.consistency.bisection import whole_budget
from jaxbound.consistency.interface import Open, WindowTest
from jaxbound.consistency.parametric_margins import parametric_margins
from jaxbound.consistency.parametric_windows import (
    BLOCK,
    LEAST,
    SEARCHED,
    bisected,
    cases,
    finite,
    judged_by,
    judged_whole,
)
from jaxbound.consistency.reading import gather
from jaxbound.consistency.unproved import within
from jaxbound.recordings.arrays import refuse_infinite
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips.polynomials import multiaffine

__all__ = ["BUDGET", "ParametricTest"]

BUDGET = 10_000
"""Boxes that "paving" may evaluate for a window."""


class ParametricTest(WindowTest):
    """Tests windows of a model with uncertain parameters; see `parametric_windows`.

    The sign of the margin is the verdict's. Its size is that of the zonotope, with which the neglected
    monomials grow as one: for an UNDECIDED window the true margin is not above it. For "linearized" it is the
    gauge of the paper's set, and no proof.

    Args:
        budget: boxes a window that "paving" may evaluate; None: `BUDGET`. allowance: what each relation may
            be off by, for "linearized".
        whole: for windows that lack samples, the test of those that lack none.

    Raises:
        ValueError: a budget that is no whole number >= 1, an allowance that is none.
    """

    relations: Any  # UncertainRelations, of the floor above
    sharded = False
    constants = None

    def __init__(
        self,
        relations: Any,
        method: str,
        dtype: Any,
        budget: Any = None,
        allowance: Any = 0.0,
        whole: "ParametricTest | None" = None,
    ) -> None:
        super().__init__(relations, method, dtype)
        self.budget = BUDGET if budget is None else whole_budget(budget)
        self.allowance = np.asarray(allowance, float)
        fits = (
            self.allowance.shape in ((), (relations.count,))
            and (self.allowance >= 0).all()
            and np.isfinite(self.allowance).all()
        )
        if not fits:
            raise ValueError(
                f"compensation must be one finite number >= 0, or one for each of {relations.count} "
                f"relations, not {allowance}"
            )
        self.kind, self.proved, self.whole = (
            judged_by(relations, method),
            relations.complete == "proved",
            whole,
        )

    @property
    def block(self) -> int:
        """How many windows are judged at once."""
        return SEARCHED if self.kind == "zonotope" else BLOCK

    short = block

    @property
    def lags(self) -> int:
        """How many samples of u a window has."""
        return self.reading.window.lags

    @cached_property
    def reading(self) -> Any:
        """How kernels read a window: where samples are missing, in the shape of others that lack some, if it
        fits.
        """
        read, whole = self.relations.reading(self.dtype, self.method), self.whole
        if whole is None:
            return read
        exponents, count = (
            whole.relations.exponents_of_losses,
            1 if self.kind == "vertices" else whole.relations.count,
        )
        fits = (
            read.count <= count
            and set(read.exponents) <= set(exponents)
            and (self.kind != "vertices" or multiaffine(exponents))
        )
        return read.filled(count, exponents, whole.reading.noisy) if fits else read

    @cached_property
    def _on_device(self):
        return jax.device_put(self.reading)

    def cases(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> list:
        """Return a test for each pattern of missing samples; the rarest stay open."""
        refuse_infinite("u", u, self.relations.model.inputs)
        refuse_infinite("y", y, self.relations.model.outputs)
        found: list[tuple[WindowTest, np.ndarray]] = []
        for case, chosen in cases(self.relations, u, y, starts):
            if case is None:
                found.append((Open(self, 0.0), starts[chosen]))
            else:
                whole = None if case is self.relations else self
                allowance = self.allowance if case.count == self.relations.count else self.allowance.max()
                found.append(
                    (
                        ParametricTest(case, self.method, self.dtype, self.budget, allowance, whole),
                        starts[chosen],
                    )
                )
        return found

    def judge(self, run: Callable, blocks: list) -> list:
        """Return (status, margin, open) of blocks of windows; open is what paving may decide."""
        found = [
            judged_whole(self._on_device, finite(block), self.kind, self.proved, self.allowance)
            for block in blocks
        ]
        left = lambda status: (
            np.asarray(status) == Status.UNDECIDED if self.method == "paving" else np.zeros(len(status), bool)
        )
        return [(status, margin, left(status)) for status, margin in found]

    def settle(
        self, u: np.ndarray, y: np.ndarray, outs: list, left: np.ndarray, again: Callable, progress: Callable
    ) -> None:
        """Bisect the parameters of windows that were left open."""
        if self.method != "paving":
            return
        status, margin = outs
        for first in range(0, len(left), SEARCHED):
            at = left[first : first + SEARCHED] + self.horizon
            windows = finite(gather(u, y, at - self.horizon, self.lags, self.horizon))
            status[at] = found = bisected(self.reading, windows, self.proved, self.budget)
            margin[at] = np.where(found == Status.FAULT, np.minimum(margin[at], -LEAST), margin[at])
            margin[at] = np.where(found == Status.CONSISTENT, np.maximum(margin[at], LEAST), margin[at])
            progress((first + len(at)) / len(left))

    def margins(self, given: Recording) -> jax.Array:
        """Return the unproved margins (..., T); see `WindowTest.margins`."""
        return within(parametric_margins(self.relations, given.u, given.y), given, self.horizon)
