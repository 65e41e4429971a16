"""Easy windows first: least squares and a few clipped steps settle most windows of long relations.

`sets.strips.projection` has the idea and the proof.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.check import contradicted_by
from jaxbound.consistency.interface import Arrays, Easy, LinearRelations, Run, SignedTest
from jaxbound.consistency.reading import Block, Reading
from jaxbound.models.rows import Kind, Row
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.unrolled import stored
from jaxbound.sets.strips.projection import Projection, Rows, clipped_margin, projection_of

BLOCK = 4096
ROWS = 64
"""Rows of a window up to which a stretch is settled as a whole: windows of more are gathered as fast."""
PART = 1024
"""Windows of a stretch that are searched together: their rows stay in the cache."""
SMALL = 8
"""Inner rows above which fewer are searched together."""


class Given(NamedTuple):
    """A reading and the projection of its windows."""

    reading: Reading
    projection: Projection


class _Easy(SignedTest):
    """Settles easy windows and says nothing of the others: their margin is 0.

    Args:
        relations, dtype: as of `ExchangeTest`. projection: from `easy_by`. reading: how windows are read.
    """

    confirms = True

    def __init__(
        self, relations: LinearRelations, dtype: DTypeLike, projection: Projection, reading: Reading
    ) -> None:
        super().__init__(relations, "joint", dtype)
        self.projection, self.reading = projection, reading

    @property
    def constants(self) -> Given:
        """The reading, and the projection."""
        return Given(self.reading, self.projection)


class EasyStretches(_Easy):
    """Proves windows of contiguous samples CONSISTENT, by fewer steps."""

    gathered = False
    block = BLOCK

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (margin,) of all windows of stretches."""
        return list(zip(run(_of_stretch, blocks), strict=True))


class EasyWindows(_Easy):
    """Decides windows by a few steps of a clipped search; both verdicts are proofs."""

    threads = True
    block = BLOCK // 4

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (margin, open, h) of windows."""
        return [(margin, np.asarray(margin) == 0, h) for margin, h in run(_of_windows, blocks)]

    def refuted(self, u: np.ndarray, y: np.ndarray, *hints: np.ndarray) -> np.ndarray:
        """Return which windows the combinations of the search contradict: `contradicted_by`."""
        frame, (h,) = self.reading.frame, hints
        # the projection left out rows that the window does not look at
        whole = np.zeros((len(frame.outer), y.shape[2]), self.dtype)
        whole[np.isin(frame.outer, self.projection.outer)] = h
        return contradicted_by(self.reading, u, y, whole)


@kernel(wide=True)
def _of_stretch(given: Given, u: jax.Array, y: jax.Array) -> jax.Array:
    """Return the margins (N,) of the windows of a stretch u (N + s, m), y (N + s, p), of which none is
    gathered: 0 of those that are left open.
    """
    s, count = given.reading.horizon, len(y) - given.reading.horizon
    size = PART
    if len(given.projection.inner) > SMALL:
        # more inner rows, fewer windows: what a part holds has to stay in the cache
        size = PART // 4
    if count % size:
        size = count

    def part(i: jax.Array) -> jax.Array:
        samples = jax.tree.map(
            partial(jax.lax.dynamic_slice_in_dim, start_index=i * size, slice_size=size + s), (u, y)
        )
        rows = rows_of(given, *given.reading.windows(*samples))
        return clipped_margin(given.projection, rows, stretch=True)[0]

    margins: jax.Array = jax.lax.map(part, jnp.arange(count // size))
    return margins.reshape(-1)


def rows_of(given: Given, u: jax.Array, y: jax.Array) -> Rows:
    """Return the rows of windows u (lags, m, N), y (s + 1, p, N) for a search."""
    rows = given.reading.block(u, y)
    numbers = (*given.projection.outer, *given.projection.inner)

    def ordered(x: jax.Array) -> jax.Array:
        return jnp.stack(list(map(x.__getitem__, numbers)))

    mid, radius, scale = stored(tuple(map(ordered, (rows.mid, rows.rad, rows.scale))))
    heaviest, known_size = 1 / jnp.min(radius, 0), jnp.max(rows.known_scale, 0, initial=0)
    return Rows(mid, radius, rows.known, jnp.max(scale, 0), heaviest, known_size)


@kernel(wide=True)
def _of_windows(given: Given, u: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (margins (N,), h (c, N)) of windows u (lags, m, N), y (s + 1, p, N)."""
    return clipped_margin(given.projection, rows_of(given, u, y))


def easy_by(relations: LinearRelations, reading: Reading, dtype: DTypeLike) -> Easy | None:
    """Return the tests that settle easy windows by a projection; None where there is none of use."""
    frame, rows = relations.frame, reading.window.all
    if frame is None or not frame.inner:
        return None
    looked, typical = np.array([(row.seen, _typical(reading, row)) for row in rows]).T
    outer, inner = np.array(frame.outer, int), list(frame.inner)
    if not looked[inner].all():
        return None
    kept = looked[outer] > 0
    outer = outer[kept]
    R, K = np.asarray(reading.frame.R)[kept], np.asarray(reading.frame.K)[kept]
    # radii of a window's own: one matrix for all would settle a fifth fewer, and leave them to the search
    radius, weighted = typical[[*outer, *inner]], bool(np.any(reading.tolerance)) or bool(reading.times)
    projection = projection_of(R, K, radius, outer.tolist(), inner, dtype, weighted)
    if projection is None:
        return None
    stretches = None
    if len(radius) <= ROWS:  # half the time that windows take which are gathered
        stretches = EasyStretches(relations, dtype, projection, reading)
    return Easy(stretches, EasyWindows(relations, dtype, projection, reading))


def _typical(reading: Reading, row: Row) -> float:
    """Return a radius for the weight of a row."""
    if row.kind is Kind.SUM:
        return float(reading.average[row.number])
    if row.kind is Kind.DISTURBANCE:
        lo, hi = np.asarray(reading.disturbance, np.float64)[row.number]
        return float(0.5 * (hi - lo))
    i = row.number
    return float(reading.noise[i] + reading.resolution[i] + reading.tolerance[i])
