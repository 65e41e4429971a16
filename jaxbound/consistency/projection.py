"""Easy windows first: one fixed projection settles most windows of long relations, before any search.

`sets.strips.projection` has the idea and the proof. Here a stretch of samples becomes the rows of its
windows: what belongs to one sample (middle, radius, input) is worked out once and serves all windows that the
sample is in. A radius here is that of the sample alone, which is not above that of `sensor.true_value` for
the whole window: what it proves CONSISTENT is.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.check import contradicted_by
from jaxbound.consistency.interface import Array, Arrays, Easy, LinearRelations, Run, SignedTest
from jaxbound.consistency.reading import AVERAGING, Block, Reading
from jaxbound.models import sensor
from jaxbound.models.rows import Kind, Row, WeightedSum
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.unrolled import most, stored, total
from jaxbound.sets.strips.projection import (
    Projection,
    Rows,
    clipped_margin,
    projection_of,
)

__all__ = [
    "EasyStretches",
    "EasyWindows",
    "Given",
    "easy_by",
    "projection",
    "rows_of",
]

BLOCK = 4096
COLUMNS = 64
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
        relations, dtype: as of `ExchangeTest`. given: from `projection`. reading: how windows are read.
    """

    confirms = True

    def __init__(
        self, relations: LinearRelations, dtype: DTypeLike, given: Projection, reading: Reading
    ) -> None:
        super().__init__(relations, "joint", dtype)
        self.projection, self.reading = given, reading

    @property
    def constants(self) -> Given:
        """The reading, and the projection."""
        return Given(self.reading, self.projection)


class EasyStretches(_Easy):
    """Proves windows of contiguous samples CONSISTENT, by one projection."""

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
        size = PART // 4
    if count % size:
        size = count

    def part(i: jax.Array) -> jax.Array:
        samples = jax.tree.map(
            partial(jax.lax.dynamic_slice_in_dim, start_index=i * size, slice_size=size + s), (u, y)
        )
        return clipped_margin(given.projection, _rows(given, *samples), stretch=True)[0]

    margins: jax.Array = jax.lax.map(part, jnp.arange(count // size))
    return margins.reshape(-1)


def _rows(given: Given, u: jax.Array, y: jax.Array) -> Rows:
    """Return the rows of the windows of a stretch u (N + s, m), y (N + s, p)."""
    reading, projection = given
    s, count = reading.horizon, len(y) - reading.horizon
    samples = [_sample(reading, i, u, values) for i, values in enumerate(y.T)]
    samples += map(_Sample, *reading._disturbance(jnp.ones_like(y[:, 0])))
    _, radii, scales = zip(*samples, strict=True)
    scale, heaviest = _running(most(scales), s + 1), _running(most([1 / r for r in radii]), s + 1)
    for number, values in enumerate(reading.window.sums):
        part = _sum(reading, number, y)
        samples.append(part)
        scale = jnp.maximum(scale, _scale_of_sum(values, scale, part.radius[0]))
        heaviest = jnp.maximum(heaviest, 1 / part.radius[0])
    at = []
    for number in (*projection.outer, *projection.inner):
        row = reading.window.all[number]
        at.append((_series(reading, row), row.first))
    mids, radii, _ = zip(*samples, strict=True)
    mid, radius = _taken(jnp.stack(mids), np.array(at), count), _taken(jnp.stack(radii), np.array(at), count)
    known, known_size = jnp.zeros((0, count), y.dtype), jnp.zeros_like(scale)
    inputs, acting = reading.known_inputs(u).T, _acting(reading)
    if len(inputs) and acting:
        offset = reading.offset_u[:, None]
        places = np.indices((acting, len(inputs))).reshape(2, -1)
        known = _taken(inputs - offset, places[::-1].T, count)
        known_size = _running(jnp.max(abs(inputs) + abs(offset), 0), acting)[:count]
    return Rows(mid, radius, known, scale, heaviest, known_size)


def _series(reading: Reading, row: Row) -> int:
    """Return the number of the samples of a stretch that a row reads."""
    if row.kind is Kind.DISTURBANCE:
        return len(reading.noise) + row.number
    if row.kind is Kind.SUM:
        return len(reading.noise) + len(reading.disturbance) + row.number
    return row.number


def _taken(x: jax.Array, at: np.ndarray, count: int) -> jax.Array:
    """Return rows (n, N) of x (r, N + s): of each of at (n, 2) = (row, first sample)."""

    def row(place: jax.Array) -> jax.Array:
        return jax.lax.dynamic_slice(x, (place[0], place[1]), (1, count))[0]

    rows: jax.Array = jax.lax.map(row, jnp.asarray(at))
    return rows


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


class _Sample(NamedTuple):
    """Samples of an output, or of a disturbance, or the runs of a sum, as rows."""

    mid: jax.Array
    radius: jax.Array
    scale: jax.Array


def _acting(reading: Reading) -> int:
    """Return at how many samples of a window inputs act."""
    if reading.acting is None:
        return reading.lags
    return reading.acting


def _sample(reading: Reading, i: int, u: jax.Array, y: jax.Array) -> _Sample:
    bounds = reading.tolerance[i], reading.noise_at(u, i), reading.resolution[i], reading.offset_y[i]
    (mid,), (radius,), (scale,) = sensor.true_value([y], *bounds)
    return _Sample(mid, radius, scale)


def _sum(reading: Reading, number: int, y: jax.Array) -> _Sample:
    """Return the runs (N + s,) of one bounded sum in samples y (N + s, p), as of `Reading.block`, from each
    sample on; behind the last one 0, which no window reads. Their scale is left to `_scale_of_sum`.

    The radius is below that of any window: it lacks what recorders round away.
    """
    values, dtype = reading.window.sums[number], y.dtype
    mid, count = jnp.zeros_like(y[:, 0]), len(y) - values.samples + 1
    if values.measured:
        terms = []
        for i, weights in values.parts:
            d = y[:, i] - reading.offset_y[i]
            for a, weight in enumerate(weights):
                terms.append(jnp.asarray(float(weight), dtype) * d[a : a + count])
        mid = jnp.pad(total(terms), (0, len(y) - count))
    return _Sample(mid, jnp.ones_like(mid) * _bound_of_sum(reading, number), mid)


def _bound_of_sum(reading: Reading, number: int) -> Array:
    """Return the bound of one sum, with what its sensors resolve."""
    values, bound = reading.window.sums[number], reading.average[number]
    if values.measured:
        for i, _ in values.parts:
            bound = bound + np.asarray(float(values.size_of(i)), bound.dtype) * reading.resolution[i]
    return bound


def _scale_of_sum(values: WeightedSum, largest: jax.Array, radius: jax.Array) -> jax.Array:
    """Return at least the scale that runs of a sum have in `Reading.block`, where that of samples is at most
    `largest`.
    """
    return (2 + values.terms / AVERAGING) * (float(values.size) * largest + radius)


def _running(x: jax.Array, lags: int) -> jax.Array:
    """Return the largest of so many entries from each one on, of few doublings; shorter by lags - 1."""
    reach = 1
    while 2 * reach <= lags:
        x, reach = jnp.maximum(x[:-reach], x[reach:]), 2 * reach
    rest = lags - reach
    return jnp.maximum(x[: len(x) - rest], x[rest:]) if rest else x


def easy_by(
    relations: LinearRelations,
    reading: Reading,
    dtype: DTypeLike,
) -> Easy | None:
    """Return the tests that settle easy windows by a projection; None where there is none of use."""
    weighted = bool(np.any(reading.tolerance)) or bool(reading.times)
    given = projection(relations, reading, dtype, weighted)
    if given is None:
        return None
    stretches = None
    if len(given.outer) + len(given.inner) <= COLUMNS:
        stretches = EasyStretches(relations, dtype, given, reading)
    return Easy(stretches, EasyWindows(relations, dtype, given, reading))


def projection(
    relations: LinearRelations, reading: Reading, dtype: DTypeLike, weighted: bool
) -> Projection | None:
    """Return the projection of windows; None where there is none of use. weighted: see `projection_of`."""
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
    radius = typical[[*outer, *inner]]
    return projection_of(R, K, radius, outer.tolist(), inner, dtype, weighted)


def _typical(reading: Reading, row: Row) -> float:
    """Return a radius for the weight of a row."""
    if row.kind is Kind.SUM:
        return float(_bound_of_sum(reading, row.number))
    if row.kind is Kind.DISTURBANCE:
        lo, hi = np.asarray(reading.disturbance, np.float64)[row.number]
        return float(0.5 * (hi - lo))
    i = row.number
    return float(reading.noise[i] + reading.resolution[i] + reading.tolerance[i])
