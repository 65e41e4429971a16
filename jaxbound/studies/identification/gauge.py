"""The factor on all bounds that explains a window, in floats: what `WindowJudge` proves, searched without its
proof and without relations.

Errors of a certain plant whose sensors alone err are known up to the first state x of the window,

    v = r - O x,    r: outputs less what the inputs do to them,

so the least factor t with |v_i| <= t b_i, and |mean of v| <= t a where means have bounds, is the best
approximation in the maximum norm of r by the columns of O, each row over its bound: a linear program with few
unknowns. Exchanges solve it for many windows at once (`sets.strips.chebyshev`). Where only the largest factor
counts, most windows need no program: with the residual e of least squares, orthogonal to O,

    |e|_2^2 / |e|_1 <= t <= |e|_inf

Where bounds follow factors, a row has a width of its own in each window, its bound there over b_i: then it is
|r_i - (O x)_i| <= t w_i, and |e|_2^2 / sum w_i |e_i| <= t <= max |e_i| / w_i.

Source: Cheney 1966 (duality of approximation in the maximum norm).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxbound.models.average import Average
from jaxbound.models.system import LinearSystem
from jaxbound.models.window import model_matrices
from jaxbound.recordings.factors import by_name
from jaxbound.sets.floats.one_thread import times
from jaxbound.sets.strips.chebyshev import fitted
from jaxbound.studies.identification.judging import Judge, Sizes
from jaxbound.studies.identification.records import Record, Records
from jaxbound.studies.identification.regression import Scales, complete_windows, courses

CHUNK, BATCH = 2_048, 64
"""Windows whose residuals are looked at together; whose programs are solved together."""
RANK = 1e-11
"""Share of the largest singular value below which a direction of the first state shows nowhere."""


class Gauge(NamedTuple):
    """Windows of a model whose sensors alone err.

    Fields: over (R, (s + 1) p): errors of a window on its rows, each over its bound. free (R, r): orthonormal
    columns that span what the first state does to these rows. fixed (R,): the share of the bound of a row
    that is what the recorder rounds away, which factors do not widen.
    """

    model: LinearSystem
    horizon: int
    over: np.ndarray
    free: np.ndarray
    fixed: np.ndarray

    def rows(self, record: Record, first: np.ndarray) -> np.ndarray:
        """Return the rows (N, R) of windows that begin at samples first (N,), without what the first state
        explains of their squares.
        """
        u, y, _ = record
        at = first[:, None] + np.arange(self.horizon + 1)
        left = y[at] - np.array(self.model.offset["y"], float) - self._driven(u[at])
        rows = times(left.reshape(len(first), -1), self.over.T)
        return np.asarray(rows - times(times(rows, self.free), self.free.T))

    def factors(self, record: Record) -> np.ndarray | None:
        """Return (T, p), the factors on the noise of each sample; None: there are none."""
        model, u = self.model, record[0]
        if not model.times:
            return None
        factors = np.ones((len(u), model.p))
        for factor in model.factors:
            factors[:, factor.number] = factor.expression.values(by_name(model, u))
        return factors

    def widths(self, factors: np.ndarray | None, first: np.ndarray) -> np.ndarray | None:
        """Return the widths (N, R) of the rows of windows that begin at samples first (N,)."""
        if factors is None:
            return None
        size = np.abs(self.over)
        at = factors[first[:, None] + np.arange(self.horizon + 1)].reshape(len(first), -1)
        return np.asarray(self.fixed + (1 - self.fixed) * times(at, (size / size.sum(1, keepdims=True)).T))

    def _driven(self, u: np.ndarray) -> np.ndarray:
        """Return the outputs (N, s + 1, p) of windows whose first state is 0, by inputs (N, s + 1, m)."""
        A, B, C, D = model_matrices(self.model, "ABCD")
        u = u - np.array(self.model.offset["u"], float)
        x, out = np.zeros((len(u), len(A))), np.zeros((*u.shape[:2], self.model.p))
        for k in range(u.shape[1]):
            out[:, k] = x @ C.T + u[:, k] @ D.T
            x = x @ A.T + u[:, k] @ B.T
        return out

    def largest(self, record: Record, every: bool = False, most: int | None = None) -> np.ndarray:
        """Return (T,): of each complete window a lower bound on its factor, of the one that needs most its
        factor; nan elsewhere. every: of each its factor. most: so many windows at most, spread evenly.
        """
        u, y, starts = record
        first = complete_windows(u, y, starts, self.horizon)
        if most is not None and len(first) > most:
            first = first[np.linspace(0, len(first) - 1, most).astype(int)]
        need = np.full(len(y), np.nan)
        least, above, factors = np.zeros(len(first)), np.zeros(len(first)), self.factors(record)
        for begin in range(0, len(first), CHUNK):
            part = slice(begin, begin + CHUNK)
            wide = self.widths(factors, first[part])
            least[part], above[part] = _bracket(self.rows(record, first[part]), wide)
        order = np.argsort(-above)
        for begin in range(0, len(order), BATCH):
            some = order[begin : begin + BATCH]
            level = 0.0 if every else least.max()
            some = some[above[some] > level]
            if not len(some):
                break
            wide = self.widths(factors, first[some])
            found = best_approximations(self.rows(record, first[some]), self.free, wide)
            least[some] = np.where(found > level, found, least[some])
        need[first + self.horizon] = least
        return need

    def unexplained(self, record: Record, first: np.ndarray) -> np.ndarray:
        """Return (1,) one of the windows, which begin at samples first (N,), that needs more than its bounds;
        (0,) where none does.
        """
        factors = self.factors(record)
        for begin in range(0, len(first), CHUNK):
            part = first[begin : begin + CHUNK]
            least, most = _bracket(self.rows(record, part), self.widths(factors, part))
            doubtful = part[np.argsort(-most)[: (most > 1).sum()]]
            if (least > 1).any():
                return part[least > 1][:1]
            for at in range(0, len(doubtful), BATCH):
                some = doubtful[at : at + BATCH]
                wide = self.widths(factors, some)
                found = best_approximations(self.rows(record, some), self.free, wide)
                if (found > 1).any():
                    worst = int(np.argmax(found))
                    return some[worst : worst + 1]
        return first[:0]


def gauge_of(model: LinearSystem, averages: Sequence[Average] | None = None) -> Gauge:
    """Return the Gauge of the windows of a model: its horizon or lags, noise and averages of outputs, or
    other averages in their place.
    """
    assert model.horizon is not None, "a model that is fitted for windows has one"
    horizon, samples = model.horizon, list(range(model.horizon + 1))
    if model.lags is not None:
        samples = [horizon - lag for lag in reversed(model.lags)]
    if averages is None:
        averages = model.averages
    over, fixed = _over_bounds(model, averages, horizon + 1, samples)
    A, C = model_matrices(model, "AC")
    blocks = [C]
    for _ in range(horizon):
        blocks.append(blocks[-1] @ A)
    free = over @ np.concatenate(blocks)
    if not free.size:
        return Gauge(model, horizon, over, np.zeros((len(over), 0)), fixed)
    free = free / np.maximum(np.abs(free).max(0), 1e-300)  # of states that grow out of reach
    left, singular, _ = np.linalg.svd(free, full_matrices=False)
    return Gauge(model, horizon, over, left[:, singular > RANK * singular[0]], fixed)


def _over_bounds(
    model: LinearSystem, averages: Sequence[Average], count: int, samples: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of windows, each error that is looked at over its bound and each run of an average, and
    the share of each bound that is what the recorder rounds away.
    """
    p, rounded = model.p, np.array(model.resolution, float)
    bounds = np.array(model.noise, float) + rounded
    single = np.zeros((len(samples), p, count, p))
    for number, sample in enumerate(samples):
        single[number, :, sample] = np.diag(1 / bounds)
    rows, fixed = [single.reshape(-1, count * p)], [np.tile(rounded / bounds, len(samples))]
    for average in averages:
        _, i = average.place(model.outputs)
        weights = np.array(list(map(float, average.weights)))
        rounds = rounded[i] * np.abs(weights).sum()
        bound = float(average.bound) + rounds
        runs = np.zeros((count - len(weights) + 1, count, p))
        first = np.arange(len(runs))[:, None]
        runs[first, first + np.arange(len(weights)), i] = weights / bound
        rows.append(runs.reshape(len(runs), -1))
        fixed.append(np.full(len(runs), rounds / bound))
    return np.concatenate(rows), np.concatenate(fixed)


def _bracket(e: np.ndarray, widths: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Return (lower, upper) bounds (N,) on the best approximation, of least squares residuals (N, R) and
    widths of their rows.
    """
    size, allowed = np.abs(e), np.abs(e)
    if widths is not None:
        size, allowed = size / widths, size * widths
    total = np.maximum(allowed.sum(1), 1e-300)
    return np.square(e).sum(1) / total, size.max(1)


def best_approximations(r: np.ndarray, free: np.ndarray, widths: np.ndarray | None = None) -> np.ndarray:
    """Return min over x of max_i |r_i - (free x)_i| / widths_i for each of the rows of r (N, R); free (R, n)
    orthonormal; widths (N, R), None: 1.
    """
    r = r - (r @ free) @ free.T
    size = np.maximum(np.abs(r).max(1), 1e-300)
    r = r / size[:, None]
    N, (R, n) = len(r), free.shape
    values, radius = np.concatenate([r, np.zeros((N, n))], 1), np.ones((N, R + n))
    if widths is not None:
        radius[:, :R] = widths
    there, unbounded = np.ones((N, R), bool), np.ones((N, n), bool)
    x = fitted(np.broadcast_to(free, (N, R, n)), values, radius, there, unbounded, RANK).x
    return np.asarray((np.abs(r - x @ free.T) / radius[:, :R]).max(1) * size)


@dataclass(frozen=True)
class GaugeJudge(Judge):
    """Windows as a search in floats sees them: to choose by, not to prove. Incomplete windows do not count,
    and of all but the tightest a need is a lower bound.

    Fields: every: whether each need is searched for, not the largest alone. most: windows of a recording that
    are looked at, spread evenly; None: all.
    """

    every: bool = False
    most: int | None = None

    def needs(self, model: LinearSystem, parts: Records) -> list[np.ndarray]:
        """Return the need of the tightest window of each recording, and lower bounds on the others."""
        gauge = gauge_of(model)
        return [gauge.largest(part, self.every, self.most) for part in parts]

    def sizes(self, model: LinearSystem, scales: Scales) -> tuple[Sizes, Sizes]:
        """Return (jump, steady) as `WindowJudge` does."""
        gauge = gauge_of(model)
        jump, steady = _seen_sizes(gauge, scales, courses(gauge.horizon))
        return jump, steady


def seen_slopes(model: LinearSystem, scales: Scales) -> Sizes:
    """Return {output: slope a sample} of a ramp that fills a window, from which on it is sure to be seen."""
    gauge = gauge_of(model)
    (slopes,) = _seen_sizes(gauge, scales, np.arange(1.0, gauge.horizon + 2)[None])
    return slopes


def _seen_sizes(gauge: Gauge, scales: Scales, courses: np.ndarray) -> list[Sizes]:
    """Return of each course (s + 1,) of an error of size 1 {output: size that is sure to be seen}."""
    model, kinds = gauge.model, len(courses)
    wrong = courses[:, None, :, None] * np.diag(scales.y_spread)[None, :, None]  # (kinds, p, s + 1, p)
    rows = wrong.reshape(kinds * model.p, -1) @ gauge.over.T
    need = best_approximations(rows, gauge.free).reshape(kinds, model.p)
    with np.errstate(divide="ignore"):  # healthy noise takes 1 of a need
        sizes = np.where(need > 1e-9, 2 * scales.y_spread / need, np.inf)
    return [dict(zip(model.outputs, row, strict=True)) for row in sizes.tolist()]
