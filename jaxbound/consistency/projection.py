"""Easy windows first: one fixed projection settles most windows of long relations, before any search.

`sets.strips.projection` has the idea and the proof. Here a stretch of samples becomes the columns that it
reads: what belongs to one sample (middle, radius, input) is worked out once and serves all windows that the
sample is in. A radius here is that of the sample alone, which is not above that of `sensor.true_value` for
the whole window: what it proves CONSISTENT is.
"""

from collections.abc import Sequence
from functools import cached_property, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.interface import Array, Arrays, LinearRelations, LinearTest, Outputs, Run
from jaxbound.consistency.reading import Block, Reading
from jaxbound.consistency.strips_on_host import contradicted_by
from jaxbound.consistency.twice import Twice
from jaxbound.exact import linalg
from jaxbound.models import sensor, window
from jaxbound.models.rows import Kind
from jaxbound.models.system import LinearSystem
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.unrolled import total
from jaxbound.sets.strips.projection import (
    Columns,
    Forced,
    Projection,
    Rows,
    WindowColumns,
    clipped_margin,
    forced_outputs,
    projected_margin,
    projection_of,
)

__all__ = ["EasyStretches", "EasyWindows", "projection"]

BLOCK = 4096


class Given(NamedTuple):
    """A reading and the projection of its windows."""

    reading: Reading
    projection: Projection


class _Easy(LinearTest):
    """Settles easy windows and says nothing of the others: their margin is 0.

    Args:
        relations, dtype: as of `ExchangeTest`. projection: from `projection`.
    """

    twice = True

    def __init__(self, relations: LinearRelations, dtype: DTypeLike, given: Projection) -> None:
        super().__init__(relations, "joint", dtype)
        self.projection = given

    @property
    def constants(self) -> Given:
        """The reading, and the projection."""
        return Given(self.reading, self.projection)

    @property
    def outputs(self) -> Outputs:
        """The margins."""
        return ((self.dtype, np.nan),)


class EasyStretches(_Easy):
    """Proves windows of contiguous samples CONSISTENT, by one projection."""

    gathered = False
    block = BLOCK

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (margin,) of all windows of stretches."""
        return [(margin,) for margin in run(_of_stretch, blocks)]


class EasyWindows(_Easy):
    """Decides windows by a few steps of a clipped search; both verdicts are proofs."""

    threads = True
    block = BLOCK // 4

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (margin, open) of windows."""
        judged = []
        for block, (margin, h) in zip(blocks, run(_of_windows, blocks), strict=True):
            again = partial(self._again, block)
            decided = self._twice.decided(margin, again, partial(self._contradicted, block, h))
            judged.append((decided, decided == 0))
        return judged

    @cached_property
    def _twice(self) -> Twice:
        return Twice(self.block)

    def _again(self, block: Block, at: np.ndarray) -> np.ndarray:
        """Return the margins of some windows of a block, in NumPy."""
        margin: np.ndarray = _of_windows(self.constants, *(x[..., at] for x in block))[0]
        return margin

    def _contradicted(self, block: Block, h: Array, at: np.ndarray) -> np.ndarray:
        """Return which windows of a block the combinations of the search contradict: `contradicted_by`."""
        u, y = (x[..., at] for x in block)
        frame = self.reading.frame
        whole = np.zeros((len(frame.outer), len(at)), self.dtype)
        whole[[list(frame.outer).index(row) for row in self.projection.outer]] = np.asarray(h)[:, at]
        return contradicted_by(self.reading, frame, u, y, whole)


@kernel
def _of_stretch(given: Given, u: jax.Array, y: jax.Array) -> jax.Array:
    """Return the margins (N,) of the windows of a stretch u (N + s, m), y (N + s, p)."""
    reading, projection = given
    rows, count, s = reading.window.all, len(y) - reading.horizon, reading.horizon

    def later(x: jax.Array, j: int) -> jax.Array:
        return x[j : j + count]

    samples = [_sample(reading, i, y[:, i]) for i in range(y.shape[1])]
    one = jnp.ones_like(y[:count, 0])
    scale = _running(_largest([x.scale for x in samples]), s + 1)[:count]
    heaviest = _running(_largest([x.weight for x in samples]), s + 1)[:count]
    pushed = _sample_of(*(part[:, 0] for part in reading._disturbance(one[:1])))
    if len(reading.disturbance):
        scale = jnp.maximum(scale, jnp.max(pushed.scale))
        heaviest = jnp.maximum(heaviest, jnp.max(pushed.weight))
    f, known = None, 0 * one
    if projection.forced is not None:
        f = _forced_columns(
            projection.forced, [u[:, b] - reading.offset_u[b] for b in range(u.shape[1])], s, count
        )
        sizes = [abs(u[:, b]) + abs(reading.offset_u[b]) for b in range(u.shape[1])]
        known = _running(_largest(sizes), reading.lags)[:count]
    mid, weight = [], []
    for number in (*projection.outer, *projection.inner):
        row = rows[number]
        if row.kind is Kind.DISTURBANCE:
            mid.append(pushed.mid[row.number] * one)
            weight.append(pushed.weight[row.number] * one)
            continue
        column = later(samples[row.number].mid, row.first)
        mid.append(column if f is None else column - f[row.first][row.number])
        weight.append(later(samples[row.number].weight, row.first))
    return projected_margin(projection, WindowColumns(mid, weight, scale, heaviest, known))


def _forced_columns(forced: Forced, v: Columns, s: int, count: int) -> list[list[jax.Array]]:
    """Return f of all windows of a stretch with inputs v, [sample][output]: what inputs add is worked out
    once a sample.
    """
    first = [[x[j : j + count] for x in v] for j in range(min(forced.order + 1, s + 1))]
    later = s - forced.order
    if later < 0:
        return forced_outputs(forced, first, [])
    terms = []
    for j in range(forced.driven.shape[1] // len(v)):
        terms += [x[j : j + count + later] for x in v]
    added = [total([row[j] * x for j, x in enumerate(terms)]) for row in forced.driven]
    return forced_outputs(forced, first, [[x[j : j + count] for x in added] for j in range(later + 1)])


@kernel
def _of_windows(given: Given, u: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (margins (N,), h (c, N)) of windows u (lags, m, N), y (s + 1, p, N)."""
    rows = given.reading.block(u, y)
    numbers = (*given.projection.outer, *given.projection.inner)

    def ordered(x: jax.Array) -> jax.Array:
        return jnp.stack([x[i] for i in numbers])

    known, known_scale = rows.known, rows.known_scale
    of_rows = Rows(*map(ordered, (rows.mid, rows.rad, rows.scale)), known, known_scale)
    return clipped_margin(given.projection, of_rows)


class _Sample(NamedTuple):
    """What belongs to each sample of an output, or to each disturbance: weight = 1 / radius."""

    mid: jax.Array
    weight: jax.Array
    scale: jax.Array


def _sample(reading: Reading, i: int, y: jax.Array) -> _Sample:
    bounds = reading.tolerance[i], reading.noise[i], reading.resolution[i], reading.offset_y[i]
    (mid,), (radius,), (scale,) = sensor.true_value([y], *bounds)
    return _sample_of(mid, radius, scale)


def _sample_of(mid: jax.Array, radius: jax.Array, scale: jax.Array) -> _Sample:
    return _Sample(mid, 1 / radius, scale)


def _largest(rows: Sequence[jax.Array]) -> jax.Array:
    top = rows[0]
    for x in rows[1:]:
        top = jnp.maximum(top, x)
    return top


def _running(x: jax.Array, lags: int) -> jax.Array:
    """Return the largest of so many entries from each one on, of few doublings; shorter by lags - 1."""
    reach = 1
    while 2 * reach <= lags:
        x, reach = jnp.maximum(x[:-reach], x[reach:]), 2 * reach
    rest = lags - reach
    return jnp.maximum(x[: len(x) - rest], x[rest:]) if rest else x


def projection(relations: LinearRelations, reading: Reading, dtype: DTypeLike) -> Projection | None:
    """Return the projection of windows; None where there is none of use.

    Bounds of sums have rows of several samples, which no column here stands for.
    """
    frame, model, horizon = relations.frame, relations.model, relations.horizon
    rows = reading.window.all
    if frame is None or reading.window.sums or not frame.inner:
        return None
    if not all(rows[number].seen for number in frame.inner):
        return None
    kept = [j for j, number in enumerate(frame.outer) if frame.used[j] and rows[number].seen]
    outer = [frame.outer[j] for j in kept]
    R, K = (np.asarray(matrix)[kept] for matrix in (reading.frame.R, reading.frame.K))
    radius = np.array([_typical(reading, rows[number]) for number in (*outer, *frame.inner)])
    forced = None
    if model.m and any(map(any, frame.K)):
        forced = _forced(model, dtype)
        if forced is None:
            return None
    return projection_of(R, K, radius, outer, frame.inner, forced, horizon + 1, dtype)


def _typical(reading: Reading, row) -> float:
    """Return a radius for the weight of a row."""
    if row.kind is Kind.DISTURBANCE:
        lo, hi = np.asarray(reading.disturbance, np.float64)[row.number]
        return 0.5 * (hi - lo)
    i = row.number
    return float(reading.noise[i] + reading.resolution[i] + reading.tolerance[i])


def _forced(model: LinearSystem, dtype: DTypeLike) -> Forced | None:
    """Return how outputs answer to inputs from rest: exact, then rounded once."""
    p, m = model.p, model.m
    O, _ = window.first_form(model, model.n)
    reduced, basis = linalg.row_reduce(linalg.transpose(O))
    if not basis:
        return None
    order = max(basis, default=-1) // p + 1
    own = [[row[order * p + i] for row in reduced] for i in range(p)]
    _, H = window.first_form(model, order)
    through = linalg.matmul(own, [H[j] for j in basis])
    driven = [linalg.add_multiple(H[order * p + i], -1, row) for i, row in enumerate(through)]
    # without D the newest input does not act: whether it is missing is no matter
    first = [row[: order * m] for row in H[: order * p]]
    pairs = tuple((j // p, j % p) for j in basis)
    return Forced(
        _rounded(first, order * p, dtype),
        _rounded(own, p, dtype),
        _rounded(driven, p, dtype),
        pairs,
        order,
        int(model.has_feedthrough),
    )


def _rounded(rows, count: int, dtype: DTypeLike) -> np.ndarray:
    return np.asarray(rounding.nearest_normals([x for row in rows for x in row], dtype)).reshape(count, -1)
