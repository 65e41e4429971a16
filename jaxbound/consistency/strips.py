"""Short windows: every circuit, or every relation alone, is a strip, tested over contiguous samples in one
pass.
"""

from collections.abc import Sequence
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.folded import folded_verdict, folds, known_columns
from jaxbound.consistency.interface import Arrays, LinearTest, Outs, Run
from jaxbound.consistency.reading import Block, Reading, gather
from jaxbound.consistency.strips_on_host import HostStrips, host_strips
from jaxbound.consistency.unproved import stretch_block, unproved_margins
from jaxbound.consistency.whole_numbers import BLOCK, exact_strip_margins, thin
from jaxbound.exact.linalg import Matrix
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips.strips import status_of, strip_margin, strip_verdict
from jaxbound.text.progress import Progress, reporter

UNDECIDED = np.int8(Status.UNDECIDED)  # an enumeration would be three times as slow to compare


class StripsTest(LinearTest):
    """Tests windows circuit by circuit ("joint": both verdicts are proofs) or relation by relation
    ("box").
    """

    by_kernels = by_strips = True
    gathered = False

    @property
    def block(self) -> int:
        """How many windows are judged at once."""
        return stretch_block(self.reading)

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (status, margin) of stretches of samples."""
        return run(verdicts, blocks)

    def settle(self, u: np.ndarray, y: np.ndarray, outs: Outs, left: np.ndarray, progress: Progress) -> None:
        """Decide in whole numbers what rounding leaves open far from the boundary."""
        status, margin, *_ = outs
        starts = np.flatnonzero((status == UNDECIDED) & (margin == 0)) - self.horizon
        if len(starts):
            starts = starts[thin(self.reading, *gather(u, y, starts, self.lags, self.horizon))]
        if not len(starts):  # of a stream nearly always, whose samples come one by one
            return
        margin[starts + self.horizon] = self._exactly(u, y, starts, progress)
        status[starts + self.horizon] = status_of(margin[starts + self.horizon])

    def contradicted(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return (N,) bool: which windows one strip contradicts, in NumPy, else in whole numbers; see
        `WindowTest.contradicted`.
        """
        seen = np.asarray(self._host.contradicted(u, y, starts).any(0))
        left = np.flatnonzero(~seen)
        seen[left] = self._exactly(u, y, starts[left], reporter(None)) < 0
        return seen

    def _exactly(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray, progress: Progress) -> np.ndarray:
        """Return the margins of windows that start at these samples, in whole numbers."""
        margins = np.zeros(len(starts), self.dtype)
        for first in range(0, len(starts), BLOCK):
            part = slice(first, first + BLOCK)
            windows = gather(u, y, starts[part], self.lags, self.horizon)
            margins[part] = exact_strip_margins(self.relations, self.reading, self._exact, *windows)
            progress(min(first + BLOCK, len(starts)) / len(starts))
        return margins

    @cached_property
    def _exact(self) -> tuple[Matrix, Matrix]:
        """The exact strips: rows over (Y, w), and over U."""
        return self.relations.strips(self.method)

    @cached_property
    def _host(self) -> HostStrips:
        h, k = self._exact
        return host_strips(self.relations.reading(np.float64, self.method), h, k)

    def margins(self, given: Recording) -> jax.Array:
        """Return the unproved margins (..., T); see `WindowTest.margins`."""
        return unproved_margins(self, _smooth_margins, given)


@kernel(wide=True)
def verdicts(reading: Reading, u: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (status, margin) of the windows of one stretch of samples, tested circuit by circuit."""
    known: Sequence[jax.Array] | jax.Array
    if folds(reading):
        columns = reading.columns(u, y)
        margin = folded_verdict(reading, *columns)
        known = known_columns(reading, columns[0])
    else:
        mid, rad, scale, known, known_scale = reading.block(*reading.windows(u, y))
        margin = strip_verdict(reading.strips, mid, rad, scale, known, known_scale, reading.lift)
    # else the compiler works out everything once for each of the two results
    margin = jax.lax.optimization_barrier(margin)  # type: ignore[no-untyped-call]  # of JAX
    status = status_of(margin)
    unsure = reading.silenced(known) & (status == Status.CONSISTENT)
    return jnp.where(unsure, Status.UNDECIDED, status).astype(jnp.int8), margin


def _differentiable(reading: Reading, u: jax.Array, y: jax.Array) -> jax.Array:
    """Return the margins of the windows of one stretch, unproved, of operations that have derivatives
    everywhere.
    """
    rows = reading.block(*reading.windows(u, y))
    return strip_margin(reading.strips, rows.mid, rows.rad, rows.known)


# to keep what a derivative needs of every window takes longer, and much longer to compile
_smooth_margins = jax.checkpoint(jax.jit(_differentiable))
