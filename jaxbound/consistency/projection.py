"""Easy windows first: one fixed projection settles most windows of long relations, before any search.

`sets.strips.projection` has the idea and the proof. Here a stretch of samples becomes the columns that it
reads: what belongs to one sample (middle, radius, input) is worked out once and serves all windows that the
sample is in. A radius here is that of the sample alone, which is not above that of `sensor.true_value` for
the whole window: what it proves CONSISTENT is.
"""

from collections.abc import Sequence
from functools import lru_cache, partial
from operator import mul
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.check import contradicted_by
from jaxbound.consistency.interface import Array, Arrays, Easy, LinearRelations, Run, SignedTest
from jaxbound.consistency.reading import AVERAGING, Block, Reading
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
    clipped_margin,
    forced_outputs,
    projected_margin,
    projection_of,
)

__all__ = [
    "EasyStretches",
    "EasyWindows",
    "Given",
    "columns_of",
    "easy_by",
    "projection",
    "rows_of",
]

BLOCK = 4096
COLUMNS = 64
"""Rows of a window up to which a stretch is projected: each is a column, and what compiles grows with the
square of their number.
"""
PART = 1024
"""Windows of a stretch that are searched together: their rows stay in the cache."""
SMALL = 8
"""Inner rows above which fewer are searched together."""
FEWEST = 8
"""A part of which one window in so many is left open is searched as a whole."""


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
    """Return the margins (N,) of the windows of a stretch u (N + s, m), y (N + s, p).

    Where many windows of a part are left open, or have weights of their own, a few clipped steps are taken
    for all of it: nothing is gathered.
    """
    s, count, weighted = given.reading.horizon, len(y) - given.reading.horizon, given.projection.weighted
    margin = jnp.zeros_like(y[s:, 0])
    if not weighted:
        margin = projected_margin(given.projection, columns_of(given, u, y))
    size = PART
    if len(given.projection.inner) > SMALL:
        size = PART // 4
    if count % size:
        size = count

    def search(own: jax.Array, u: jax.Array, y: jax.Array) -> jax.Array:
        return jnp.maximum(own, clipped_margin(given.projection, _rows(given, u, y), stretch=True)[0])

    def settled(i: jax.Array) -> jax.Array:
        first = i * size
        own = jax.lax.dynamic_slice_in_dim(margin, first, size)
        samples = jax.tree.map(
            partial(jax.lax.dynamic_slice_in_dim, start_index=first, slice_size=size + s), (u, y)
        )
        if weighted:
            return search(own, *samples)
        many = jnp.sum(own <= 0) * FEWEST > size
        out: jax.Array = jax.lax.cond(many, search, _unchanged, own, *samples)
        return out

    if size == count:
        return settled(jnp.zeros((), jnp.int32))
    margins: jax.Array = jax.lax.map(settled, jnp.arange(count // size))
    return margins.reshape(-1)


def _unchanged(own: jax.Array, u: jax.Array, y: jax.Array) -> jax.Array:
    """Return the margins as they are."""
    return own


class _Stretch(NamedTuple):
    """The samples of a stretch, as every window that reads them needs them.

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
    """Return the _Stretch of samples u (N + s, m), y (N + s, p)."""
    s, count = reading.horizon, len(y) - reading.horizon
    samples = []
    for i, values in enumerate(y.T):
        samples.append(_sample(reading, i, u, values))
    samples += map(_sample_of, *reading._disturbance(jnp.ones_like(y[:, 0])))
    _, _, weights, scales = zip(*samples, strict=True)
    largest, heaviest = (_running(most(x), s + 1)[:count] for x in (scales, weights))
    for number, values in enumerate(reading.window.sums):
        part = _sum(reading, number, y)
        samples.append(part)
        largest = jnp.maximum(largest, _scale_of_sum(values, largest, part.radius[0]))
        heaviest = jnp.maximum(heaviest, part.weight[0])
    v, sizes = [], []
    for now, offset in zip(reading.known_inputs(u).T, reading.offset_u, strict=True):
        v.append(now - offset)
        sizes.append(abs(now) + abs(offset))
    known = jnp.zeros_like(largest)
    if v:
        known = _running(most(sizes), _acting(reading))[:count]
    return _Stretch(samples, v, largest, heaviest, known)


def columns_of(given: Given, u: jax.Array, y: jax.Array) -> WindowColumns:
    """Return the columns of the windows of a stretch u (N + s, m), y (N + s, p)."""
    reading, projection, stretch = given.reading, given.projection, _stretch_of(given.reading, u, y)
    numbers, count = (*projection.outer, *projection.inner), len(stretch.scale)
    rows = _taken_columns(reading, [sample.mid for sample in stretch.samples], numbers, count)
    weights = _taken_columns(reading, [sample.weight for sample in stretch.samples], numbers, count)
    mid = _less_forced(given, stretch, rows, numbers)
    return WindowColumns(mid, weights, stretch.scale, stretch.heaviest, stretch.known)


def _taken_columns(
    reading: Reading, series: Sequence[jax.Array], numbers: Sequence[int], count: int
) -> list[jax.Array]:
    """Return of each row of windows its column (count,) of the series (N + s,) that it reads."""
    columns = []
    for number in numbers:
        row = reading.window.all[number]
        columns.append(series[_series(reading, row)][row.first : row.first + count])
    return columns


def _less_forced(
    given: Given, stretch: _Stretch, columns: Sequence[jax.Array], numbers: Sequence[int]
) -> list[jax.Array]:
    """Return columns of rows, less what inputs add to them from rest."""
    reading, forced = given.reading, given.projection.forced
    if forced is None:
        return list(columns)
    f = _forced_columns(forced, stretch.v, reading.horizon, len(columns[0]))
    less = []
    for own, number in zip(columns, numbers, strict=True):
        row = reading.window.all[number]
        if row.kind is Kind.READING:
            own = own - f[row.first][row.number]
        if row.kind is Kind.SUM:
            own = own - _forced_sum(row, f)
        less.append(own)
    return less


def _rows(given: Given, u: jax.Array, y: jax.Array) -> Rows:
    """Return the rows of the windows of a stretch u (N + s, m), y (N + s, p)."""
    reading, projection = given
    count = len(y) - reading.horizon
    stretch = _stretch_of(reading, u, y)
    at = []
    for number in (*projection.outer, *projection.inner):
        row = reading.window.all[number]
        at.append((_series(reading, row), row.first))
    mids, radii, _, _ = zip(*stretch.samples, strict=True)
    mid, radius = _taken(jnp.stack(mids), np.array(at), count), _taken(jnp.stack(radii), np.array(at), count)
    known = jnp.zeros((0, count), y.dtype)
    if stretch.v and _acting(reading):
        places = np.indices((_acting(reading), len(stretch.v))).reshape(2, -1)
        known = _taken(jnp.stack(stretch.v), places[::-1].T, count)
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
    first = [_cut(v, j, count) for j in range(min(forced.order + 1, s + 1))]
    later = s - forced.order
    if later < 0:
        return forced_outputs(forced, first, [])
    terms = []
    for j in range(forced.driven.shape[1] // len(v)):
        terms += _cut(v, j, count + later)
    added = []
    for row in forced.driven:
        added.append(total(map(mul, row, terms)))
    driven = [_cut(added, j, count) for j in range(later + 1)]
    return forced_outputs(forced, first, driven)


def _cut(series: Columns, first: int, count: int) -> list[jax.Array]:
    """Return so many entries of each series, from one on."""
    return [x[first : first + count] for x in series]


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
    """Samples of an output, or of a disturbance, as rows: weight = 1 / radius."""

    mid: jax.Array
    radius: jax.Array
    weight: jax.Array
    scale: jax.Array


def _acting(reading: Reading) -> int:
    """Return at how many samples of a window inputs act."""
    if reading.acting is None:
        return reading.lags
    return reading.acting


def _sample(reading: Reading, i: int, u: jax.Array, y: jax.Array) -> _Sample:
    bounds = reading.tolerance[i], reading.noise_at(u, i), reading.resolution[i], reading.offset_y[i]
    (mid,), (radius,), (scale,) = sensor.true_value([y], *bounds)
    return _sample_of(mid, radius, scale)


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
    return _sample_of(mid, jnp.ones_like(mid) * _bound_of_sum(reading, number), mid)


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
    frame, model, horizon = relations.frame, relations.model, relations.horizon
    rows = reading.window.all
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
    forced = None
    if model.m and any(map(any, frame.K)):
        forced = _forced(model, np.dtype(dtype))
        if forced is None:
            return None
    spread, terms = 1.0, 1
    for values in reading.window.sums:
        if values.measured:
            spread, terms = max(spread, float(values.size)), max(terms, values.terms)
    numbers = outer.tolist(), inner
    return projection_of(R, K, radius, *numbers, forced, horizon + 1, dtype, spread, terms, weighted)


def _typical(reading: Reading, row: Row) -> float:
    """Return a radius for the weight of a row."""
    if row.kind is Kind.SUM:
        return float(_bound_of_sum(reading, row.number))
    if row.kind is Kind.DISTURBANCE:
        lo, hi = np.asarray(reading.disturbance, np.float64)[row.number]
        return float(0.5 * (hi - lo))
    i = row.number
    return float(reading.noise[i] + reading.resolution[i] + reading.tolerance[i])


@lru_cache(maxsize=64)
def _forced(model: LinearSystem, dtype: np.dtype) -> Forced | None:
    """Return how outputs answer to inputs from rest: exact, then rounded once."""
    p, m = model.p, model.m
    O, _ = window.first_form(model, model.n)
    reduced, basis = linalg.row_reduce(linalg.transpose(O))
    if not basis:
        return None
    order = max(basis) // p + 1
    now = slice(order * p, (order + 1) * p)
    own = np.array(reduced, object)[:, now].T
    H = np.array(window.first_form(model, order)[1], object)
    driven = H[now] - own @ H[list(basis)]
    # without D the newest input does not act: whether it is missing is no matter
    first = H[: order * p, : order * m]
    samples, outputs = np.divmod(basis, p)
    pairs = tuple(zip(samples.tolist(), outputs.tolist(), strict=True))
    return Forced(
        _rounded(first, dtype),
        _rounded(own, dtype),
        _rounded(driven, dtype),
        pairs,
        order,
        int(model.has_feedthrough),
    )


def _rounded(matrix: np.ndarray, dtype: DTypeLike) -> np.ndarray:
    """Return a matrix of fractions in floats."""
    return np.asarray(rounding.nearest_normals(matrix.ravel().tolist(), dtype)).reshape(matrix.shape)
