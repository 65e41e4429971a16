"""Verdicts for relations whose circuits are too many to enumerate: the exchange search of
`sets.strips.separation` over blocks of windows.

Windows are gathered into blocks of one fixed size. Those that the search leaves open, one in some thousands,
and those that lack a sample on which it is built, are decided in NumPy (`search_on_host`).
"""

import copy
from collections.abc import Sequence
from functools import cached_property
from typing import Self

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.check import contradicted_by
from jaxbound.consistency.interface import Arrays, Cases, Easy, LinearRelations, Outs, Run, SignedTest
from jaxbound.consistency.projection import easy_by
from jaxbound.consistency.reading import Block, Reading, gather
from jaxbound.consistency.search_on_host import HolesTest, whole_margins
from jaxbound.consistency.unproved import over_blocks, unproved_margins
from jaxbound.consistency.whole_numbers import finite, thin
from jaxbound.exact.frames import ExactFrame
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.kernel import is_outside_xla, kernel
from jaxbound.sets.strips import separation
from jaxbound.text.progress import Progress

LARGE = 2048
"""Numbers of a window that an exchange changes, above which fewer stand side by side."""
TOUCHED = 2**14
"""Windows at once in which missing samples are looked for."""
TOGETHER = 2**10
"""Windows that are searched in NumPy at once."""


class ExchangeTest(SignedTest):
    """Searches for the combination of relations that speaks most against a window, or the behaviour that
    explains it.

    Both verdicts are proofs. What the search leaves open is searched in NumPy, one window in some thousands.
    """

    threads = confirms = by_kernels = by_strips = True
    short = 16  # the work grows with the block

    def __init__(self, relations: LinearRelations, dtype: DTypeLike) -> None:
        super().__init__(relations, "joint", dtype)
        rows, unknowns = len(self.exact_frame.outer), len(self.exact_frame.inner)
        self.weight = 1 + rows * unknowns**2 // 2**13  # a step for each unknown, all of them in it

    @property
    def exact_frame(self) -> ExactFrame:
        """The frame of the relations, in fractions."""
        frame = self.relations.frame
        assert frame is not None
        return frame

    @property
    def block(self) -> int:
        """How many windows are judged at once: their inverses should stay in the cache."""
        return _block_of(self.reading.frame)

    @cached_property
    def easy(self) -> Easy | None:
        """One fixed projection, which settles most windows of most recordings."""
        return easy_by(self.relations, self.reading, self.dtype)

    def measured(self) -> Self:
        """Return a test that searches every window for its margin; easy ones are asked of what that leaves
        open.
        """
        test = copy.copy(self)
        test.easy_first = False
        return test

    def cases(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> Cases:
        """Return [(test, starts)]: the windows that lack a sample on which the search is built, then all
        others.
        """
        if not len(starts):
            return []
        if is_outside_xla():  # what is written for NumPy takes it a tenth of what kernels do
            return [(self._holes, starts), (self, starts[:0])]
        lacking = self._lacking(u, y, starts)
        return [(self._holes, starts[lacking]), (self, starts[~lacking])]

    @cached_property
    def _holes(self) -> HolesTest:
        return HolesTest(self.relations, self.dtype)

    def _lacking(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return which windows that start at `starts` lack an inner row, or an input that relations use."""
        lacking = np.zeros(len(starts), bool)
        if not len(starts):
            return lacking
        gone = np.zeros(len(y), bool)
        for column in (*u.T, *y.T):  # a tenth of the time that rows take
            gone |= np.isnan(column)
        if not gone.any():
            return lacking
        so_far = np.concatenate([[0], np.cumsum(gone)])
        touched = np.flatnonzero(so_far[starts + self.horizon + 1] > so_far[starts])
        frame = self.reading.frame
        needed = np.any(np.asarray(frame.K) != 0, 0)
        for first in range(0, len(touched), TOUCHED):
            chosen = touched[first : first + TOUCHED]
            inputs, outputs = gather(u, y, starts[chosen], self.lags, self.horizon)
            missing = np.isnan(self.reading.inputs(inputs)).reshape(-1, len(chosen))
            absent = self.reading.window.absent(outputs)
            lacking[chosen] = absent[frame.inner].any(0) | missing[needed].any(0)
        return lacking

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (margin, open, h): proofs, in a second kernel, of the hints of a first one; between them are
        real arrays, as proofs need.
        """
        asked = [(np.ones(y.shape[-1], self.dtype), u, y) for u, y in blocks]
        searched = run(candidates, asked)
        proved = run(
            proved_margins, [(one, *hints) for (one, *_), hints in zip(asked, searched, strict=True)]
        )
        judged = []
        for (h, *_), (margin, settled) in zip(searched, proved, strict=True):
            judged.append((margin, ~np.asarray(settled), h))
        return judged

    def refuted(self, u: np.ndarray, y: np.ndarray, *hints: np.ndarray) -> np.ndarray:
        """Return which windows the combinations of a search contradict; see `contradicted_by`."""
        return contradicted_by(self.reading, u, y, hints[0])

    def settle(self, u: np.ndarray, y: np.ndarray, outs: Outs, left: np.ndarray, progress: Progress) -> None:
        """Decide in whole numbers what rounding leaves open far from the boundary, and in NumPy what the
        search does, be it the size of a margin: as where all windows are searched there.
        """
        margin, *_ = outs
        starts = np.flatnonzero(margin == 0) - self.horizon
        lacking = self._lacking(u, y, starts)
        if len(starts):  # where bounds are as thin as rounding no search in floats decides, however long
            some = lacking | thin(self.reading, *self._gather(u, y, starts))
            margin[starts[some] + self.horizon] = self.exactly(u, y, starts[some])
        if is_outside_xla():  # all windows were searched in NumPy
            return
        # a search that ended at its last step may know a sign, and no size; it was given whole windows alone
        open_ = np.union1d(left, starts[~lacking & (margin[starts + self.horizon] == 0)])
        for first in range(0, len(open_), TOGETHER):
            part = open_[first : first + TOGETHER]
            searched = self._holes.searched(*gather(u, y, part, self.lags, self.horizon))
            ends = part + self.horizon
            margin[ends] = np.where(searched == 0, margin[ends], searched)

    def margins(self, given: Recording) -> jax.Array:
        """Return the unproved margins (..., T); see `WindowTest.margins`."""
        return unproved_margins(self, _smooth_margins, given)

    def exactly(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return (N,) margins in whole numbers, 0 where these do not tell either."""
        margin = np.zeros(len(starts), self.dtype)
        if not len(starts):
            return margin
        at = np.flatnonzero(finite(*self._gather(u, y, starts)))
        windows = gather(u, y, starts[at], self.lags, self.horizon)
        margin[at] = whole_margins(self.relations, self.reading, *windows)
        return margin

    def _gather(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> Block:
        u, y = gather(u, y, starts, self.lags, self.horizon)
        return u, self.reading.seen(y)


def _smooth_margins(reading: Reading, u: jax.Array, y: jax.Array) -> jax.Array:
    """Return the unproved margins (T - s,) of one recording u (T, m), y (T, p), differentiable, NaN where
    data are missing: those of the combinations that speak most against each window, which are searched for as
    numbers.
    """

    def margins(u: jax.Array, y: jax.Array) -> jax.Array:
        rows = reading.block(u, y)
        return separation.separation_margin(reading.frame, rows.mid, rows.rad, rows.known)

    starts = jnp.arange(len(y) - reading.horizon)
    return over_blocks(margins, reading, u, y, starts, _block_of(reading.frame))


@kernel
def candidates(reading: Reading, one: jax.Array, u: jax.Array, y: jax.Array) -> tuple[jax.Array, ...]:
    """Return the combinations (h, d, done) that speak most against each window of a block, and their `Image`;
    nothing is proved yet.
    """
    image, steps = imaged(reading, one, u, y), 2 * reading.frame.R.shape[1] + 6
    found = separation.exchange_search(reading.frame.R, image.z, image.radius, image.present, one, steps)
    return *found, *image


def imaged(reading: Reading, one: jax.Array, u: jax.Array, y: jax.Array) -> separation.Image:
    """Return the `Image` of the windows of a block."""
    mid, rad, scale, known, known_scale = (x / one[None] for x in reading.block(u, y))
    return separation.separation_image(reading.frame, mid, rad, scale, known, known_scale, reading.lift, one)


@kernel
def proved_margins(
    reading: Reading, one: jax.Array, h: jax.Array, d: jax.Array, done: jax.Array, *image: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return (margin, settled) of the windows of a block, proved from the `candidates` of a search."""
    return separation.separation_verdict(reading.frame, separation.Image(*image), one, h, d, done)


def _block_of(frame: separation.Frame) -> int:
    """Return how many windows stand side by side: what their exchanges change should stay in the cache."""
    c, k = frame.R.shape
    if k <= 8:
        return 1024
    if min(c, k) * k <= LARGE:
        return 64
    return 16
