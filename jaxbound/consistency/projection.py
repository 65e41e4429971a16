"""Easy windows first: one fixed projection settles most windows of long relations, before any search.

`sets.strips.projection` has the idea and the proof. Here a stretch of samples becomes the columns that it
reads: what belongs to one sample (middle, radius, input) is worked out once and serves all windows that the
sample is in. A radius here is that of the sample alone, which is not above that of `sensor.true_value` for
the whole window: what it proves CONSISTENT is.
"""

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.interface import Array, Arrays, Easy, LinearRelations, LinearTest, Outputs, Run
from jaxbound.consistency.reading import AVERAGING, Block, Reading
from jaxbound.consistency.strips_on_host import contradicted_by
from jaxbound.consistency.twice import Twice
from jaxbound.exact import linalg
from jaxbound.models import sensor, window
from jaxbound.models.rows import Kind, Row, WeightedSum
from jaxbound.models.system import LinearSystem
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.unrolled import most, stored, total
from jaxbound.sets.strips.projection import (
    Columns,
    Forced,
    Projection,
    Rows,
    WindowColumns,
    clipped_inside,
    clipped_margin,
    forced_outputs,
    projected_margin,
    projection_of,
)

__all__ = ["EasyStretches", "EasyWindows", "Given", "Steps", "columns_of", "easy_by", "projection", "rows_of"]

Steps: TypeAlias = Callable[..., tuple[jax.Array, jax.Array]]
BLOCK = 4096
COLUMNS = 64
"""Rows of a window up to which a stretch is projected: each is a column, and what compiles grows with the
square of their number.
"""
PART = 1024
"""Windows of a stretch that are searched together: their rows stay in the cache."""
FEWEST = 8
"""A part of which one window in so many is left open is searched as a whole."""


class Given(NamedTuple):
    """A reading and the projection of its windows."""

    reading: Reading
    projection: Projection


class _Easy(LinearTest):
    """Settles easy windows and says nothing of the others: their margin is 0.

    Args:
        relations, dtype: as of `ExchangeTest`. given: from `projection`. reading: how windows are read;
            None: as relations say.
    """

    twice = True

    def __init__(
        self, relations: LinearRelations, dtype: DTypeLike, given: Projection, reading: Reading | None = None
    ) -> None:
        super().__init__(relations, "joint", dtype)
        self.projection = given
        if reading is not None:
            self.reading = reading

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

    @property
    def steps(self) -> Steps:
        """The kernel that returns (margins (N,), h (c, N)) of windows."""
        return _of_windows

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (margin, open) of windows."""
        judged = []
        for block, (margin, h) in zip(blocks, run(self.steps, blocks), strict=True):
            again = partial(self._again, block)
            decided = self._twice.decided(margin, again, partial(self._contradicted, block, h))
            judged.append((decided, decided == 0))
        return judged

    @cached_property
    def _twice(self) -> Twice:
        return Twice(self.block)

    def _again(self, block: Block, at: np.ndarray) -> np.ndarray:
        """Return the margins of some windows of a block, in NumPy."""
        margin: np.ndarray = self.steps(self.constants, *(x[..., at] for x in block))[0]
        return margin

    def _contradicted(self, block: Block, h: Array, at: np.ndarray) -> np.ndarray:
        """Return which windows of a block the combinations of the search contradict: `contradicted_by`."""
        u, y = (x[..., at] for x in block)
        frame = self.reading.frame
        whole = np.zeros((len(frame.outer), len(at)), self.dtype)
        whole[[list(frame.outer).index(row) for row in self.projection.outer]] = np.asarray(h)[:, at]
        return contradicted_by(self.reading, frame, u, y, whole)


@kernel(wide=True)
def _of_stretch(given: Given, u: jax.Array, y: jax.Array) -> jax.Array:
    """Return the margins (N,) of the windows of a stretch u (N + s, m), y (N + s, p).

    Where many windows of a part are left open, a few clipped steps are taken for all of it: nothing is
    gathered.
    """
    margin = projected_margin(given.projection, columns_of(given, u, y))
    s, count = given.reading.horizon, len(margin)
    size = count
    if count % PART == 0:
        size = PART

    def settled(i: jax.Array) -> jax.Array:
        first = i * size
        own = jax.lax.dynamic_slice_in_dim(margin, first, size)
        samples = [jax.lax.dynamic_slice_in_dim(x, first, size + s) for x in (u, y)]

        def search(samples: list[jax.Array]) -> jax.Array:
            rows = _rows(given, *samples)
            return jnp.maximum(own, clipped_inside(given.projection, rows))

        return jax.lax.cond(jnp.sum(own <= 0) * FEWEST > size, search, lambda _: own, samples)

    if size == count:
        return settled(jnp.zeros((), jnp.int32))
    return jax.lax.map(settled, jnp.arange(count // size)).reshape(-1)


class _Stretch(NamedTuple):
    """What belongs to the samples of a stretch, whichever window reads them.

    Fields: samples: of each output (N + s,), then of each disturbance, then of the runs of each sum; v: the
    inputs (N + s,) less their offsets; scale, heaviest, known: (N,), the largest of windows, see
    `WindowColumns`.
    """

    samples: list["_Sample"]
    v: list[jax.Array]
    scale: jax.Array
    heaviest: jax.Array
    known: jax.Array


def _stretch_of(reading: Reading, u: jax.Array, y: jax.Array) -> _Stretch:
    """Return what belongs to the samples u (N + s, m), y (N + s, p) of a stretch."""
    s, count = reading.horizon, len(y) - reading.horizon
    samples = [_sample(reading, i, y[:, i]) for i in range(y.shape[1])]
    mid, radius, scale = reading._disturbance(jnp.ones_like(y[:, 0]))
    samples += [_sample_of(*parts) for parts in zip(mid, radius, scale, strict=True)]
    largest = _running(most([x.scale for x in samples]), s + 1)[:count]
    heaviest = _running(most([x.weight for x in samples]), s + 1)[:count]
    for number, values in enumerate(reading.window.sums):
        part = _sum(reading, number, y)
        samples.append(part)
        largest = jnp.maximum(largest, _scale_of_sum(values, largest, part.radius[0]))
        heaviest = jnp.maximum(heaviest, part.weight[0])
    v = [u[:, b] - reading.offset_u[b] for b in range(u.shape[1])]
    known = jnp.zeros_like(largest)
    if v:
        sizes = [abs(u[:, b]) + abs(reading.offset_u[b]) for b in range(u.shape[1])]
        known = _running(most(sizes), reading.lags)[:count]
    return _Stretch(samples, v, largest, heaviest, known)


def columns_of(given: Given, u: jax.Array, y: jax.Array) -> WindowColumns:
    """Return what a projection reads of the windows of a stretch u (N + s, m), y (N + s, p)."""
    reading, projection = given
    count, s = len(y) - reading.horizon, reading.horizon
    stretch = _stretch_of(reading, u, y)
    f = None
    if projection.forced is not None:
        f = _forced_columns(projection.forced, stretch.v, s, count)
    mid, weight = [], []
    for number in (*projection.outer, *projection.inner):
        row = reading.window.all[number]
        sample = stretch.samples[_series(reading, row)]
        own = sample.mid[row.first : row.first + count]
        if f is not None and row.kind is Kind.READING:
            own = own - f[row.first][row.number]
        if f is not None and row.kind is Kind.SUM:
            own = own - _forced_sum(row, f)
        mid.append(own)
        weight.append(sample.weight[row.first : row.first + count])
    return WindowColumns(mid, weight, stretch.scale, stretch.heaviest, stretch.known)


def _rows(given: Given, u: jax.Array, y: jax.Array) -> Rows:
    """Return what a search reads of the windows of a stretch u (N + s, m), y (N + s, p)."""
    reading, projection = given
    count = len(y) - reading.horizon
    stretch = _stretch_of(reading, u, y)
    rows = [reading.window.all[number] for number in (*projection.outer, *projection.inner)]
    at = np.array([(_series(reading, row), row.first) for row in rows])
    lags = np.array([(b, j) for j in range(reading.lags) for b in range(u.shape[1])]).reshape(-1, 2)
    mid = _taken(jnp.stack([x.mid for x in stretch.samples]), at, count)
    radius = _taken(jnp.stack([x.radius for x in stretch.samples]), at, count)
    known = jnp.zeros((0, count), y.dtype)
    if len(lags):
        known = _taken(jnp.stack(stretch.v), lags, count)
    return Rows(mid, radius, known, *stretch[2:])


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


def rows_of(given: Given, u: jax.Array, y: jax.Array) -> Rows:
    """Return the rows of windows u (lags, m, N), y (s + 1, p, N) for a search."""
    rows = given.reading.block(u, y)
    numbers = (*given.projection.outer, *given.projection.inner)

    def ordered(x: jax.Array) -> jax.Array:
        return jnp.stack([x[i] for i in numbers])

    mid, radius, scale = stored(tuple(map(ordered, (rows.mid, rows.rad, rows.scale))))
    heaviest, known_size = 1 / jnp.min(radius, 0), jnp.max(rows.known_scale, 0, initial=0)
    return Rows(mid, radius, rows.known, jnp.max(scale, 0), heaviest, known_size)


@kernel(wide=True)
def _of_windows(given: Given, u: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (margins (N,), h (c, N)) of windows u (lags, m, N), y (s + 1, p, N)."""
    return clipped_margin(given.projection, rows_of(given, u, y))


class _Sample(NamedTuple):
    """What belongs to each sample of an output, or to each disturbance: weight = 1 / radius."""

    mid: jax.Array
    radius: jax.Array
    weight: jax.Array
    scale: jax.Array


def _sample(reading: Reading, i: int, y: jax.Array) -> _Sample:
    bounds = reading.tolerance[i], reading.noise[i], reading.resolution[i], reading.offset_y[i]
    (mid,), (radius,), (scale,) = sensor.true_value([y], *bounds)
    return _sample_of(mid, radius, scale)


def _sum(reading: Reading, number: int, y: jax.Array) -> _Sample:
    """Return the runs (N + s,) of one bounded sum in samples y (N + s, p), as of `Reading.block`, from each
    sample on; behind the last one 0, which no window reads. Their scale is left to `_scale_of_sum`.

    The radius is below that of any window: it lacks what recorders round away.
    """
    values, dtype = reading.window.sums[number], y.dtype
    mid, count, radius = jnp.zeros_like(y[:, 0]), len(y) - values.samples + 1, reading.average[number]
    if values.measured:
        terms = []
        for i, weights in values.parts:
            d = y[:, i] - reading.offset_y[i]
            for a, weight in enumerate(weights):
                terms.append(jnp.asarray(float(weight), dtype) * d[a : a + count])
            radius = radius + np.asarray(float(values.size_of(i)), dtype) * reading.resolution[i]
        mid = jnp.pad(total(terms), (0, len(y) - count))
    return _sample_of(mid, radius * jnp.ones_like(mid), mid)


def _scale_of_sum(values: WeightedSum, largest: jax.Array, radius: jax.Array) -> jax.Array:
    """Return at least the scale that runs of a sum have in `Reading.block`, where that of samples is at most
    `largest`.
    """
    return (2 + values.terms / AVERAGING) * (float(values.size) * largest + radius)


def _forced_sum(row: Row, f: Sequence[Sequence[jax.Array]]) -> jax.Array:
    """Return the share of inputs in a run: the weighted sum of f, [sample][output]; 0 of disturbances."""
    if not row.values.measured:
        return jnp.zeros(())
    dtype, terms = f[-1][0].dtype, []
    for i, weights in row.values.parts:
        for sample, weight in enumerate(weights, row.first):
            terms.append(jnp.asarray(float(weight), dtype) * f[sample][i])
    return total(terms)


def _sample_of(mid: jax.Array, radius: jax.Array, scale: jax.Array) -> _Sample:
    return _Sample(mid, radius, 1 / radius, scale)


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
    windows: type[EasyWindows] = EasyWindows,
    stretched: Reading | None = None,
) -> Easy | None:
    """Return the tests that settle easy windows by a projection; None where there is none of use.

    Args:
        windows: the test of those that are gathered. stretched: how stretches are read; None: as windows are.
    """
    given = projection(relations, reading, dtype)
    if given is None:
        return None
    stretches = None
    if len(given.outer) + len(given.inner) <= COLUMNS:
        stretches = EasyStretches(relations, dtype, given, stretched)
    return Easy(stretches, windows(relations, dtype, given, reading))


def projection(relations: LinearRelations, reading: Reading, dtype: DTypeLike) -> Projection | None:
    """Return the projection of windows; None where there is none of use."""
    frame, model, horizon = relations.frame, relations.model, relations.horizon
    rows = reading.window.all
    if frame is None or not frame.inner:
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
    sums = [values for values in reading.window.sums if values.measured]
    spread = max([1.0, *(float(values.size) for values in sums)])
    terms = max([1, *(values.terms for values in sums)])
    return projection_of(R, K, radius, outer, frame.inner, forced, horizon + 1, dtype, spread, terms)


def _typical(reading: Reading, row: Row) -> float:
    """Return a radius for the weight of a row."""
    if row.kind is Kind.SUM:
        return _typical_of_sum(reading, row)
    if row.kind is Kind.DISTURBANCE:
        lo, hi = np.asarray(reading.disturbance, np.float64)[row.number]
        return 0.5 * (hi - lo)
    i = row.number
    return float(reading.noise[i] + reading.resolution[i] + reading.tolerance[i])


def _typical_of_sum(reading: Reading, row: Row) -> float:
    """Return the same for the run of a sum."""
    bound = float(reading.average[row.number])
    if row.values.measured:
        for i, _ in row.values.parts:
            bound += float(row.values.size_of(i)) * float(reading.resolution[i])
    return bound


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
