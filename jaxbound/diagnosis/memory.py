"""Lags of windows that see a lasting fault, and the worth of each choice.

A lasting fault hides behind a first state that nobody knows for about as long as the plant remembers it: the
slowest time constant. Fewer samples, the farther back the fewer, see nearly as much as all of them, at a
fraction of the work; disturbances of every step between make a window forget, whatever it looks at. Sizes
here come from linear programs in floats: they help to choose, `detectable` proves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from jaxbound.diagnosis.detectability import OperatingRange, operating_reach, window_shift
from jaxbound.diagnosis.observer_sizes import time_constants
from jaxbound.exact.linalg import Vector
from jaxbound.exact.price import SECONDS
from jaxbound.models import window
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.system import LinearSystem
from jaxbound.relations.cost import relation_cost

SHORTEST, LONGEST = 8, 512
"""Spans that are tried, in samples; each is half of the one before."""
ENOUGH = 1.25
"""A span that sees faults this many times as large as the best of all is taken if it is shorter."""


class SuggestedLags(tuple[int, ...]):
    """Lags, a tuple for `parity_relations(model, lags=...)`.

    Attributes: sizes: {lags: {signal: size}} of all that were tried, the longest first: about the size from
    which on a constant fault that fills the window is always seen (`detectable` proves it), inf for never.
    """

    sizes: dict[tuple[int, ...], dict[str, float]]

    def text(self) -> str:
        """Return a table: a line for each choice, what is suggested marked by a star."""
        signals = next(iter(self.sizes.values()))
        table = [["", "span", "looks", *signals]]
        for lags, sizes in self.sizes.items():
            star = ""
            if lags == self:
                star = "*"
            table.append([star, str(lags[-1] + 1), str(len(lags)), *map(_shown, sizes.values())])
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = []
        for line in table:
            cells = map(str.rjust, line, widths)
            lines.append(" ".join(cells).rstrip())
        return "\n".join(lines)


def _shown(size: float) -> str:
    if math.isinf(size):
        return "never"
    return f"{size:.3g}"


def suggest_lags(
    model: ModelLike, count: int = 16, longest: int | None = None, operating_range: OperatingRange = None
) -> SuggestedLags:
    """Suggest the lags of windows that see lasting faults of a plant.

    Args:
        model: a LinearSystem without uncertainties.
        count: so many samples at most are looked at: 0, 1, 2 and then farther and farther back.
        longest: the longest span that is tried, in samples; None: the slowest time constant of the plant, of
            an integrating or unstable one its fastest but 64 samples at least.
        operating_range: as for `detectable`, needed with tolerances.

    Returns:
        SuggestedLags: the shortest span of those that see within 25 % of what the best sees, with a table of
            all. Bounds must hold over the
        whole span: those that were found for short windows may be too tight for long ones (`jb.tune(...,
            lags)` or `jb.fit(lags=...)`).

    Raises:
        ValueError: no whole number >= 2 of samples, an operating range that is missing, no span with a
            relation.
        NotImplementedError: an uncertain model.

    Example:
        >>> from jaxbound import LinearSystem
        >>> found = suggest_lags(LinearSystem([["0.98"]], [[1]], [[1]], noise=0.1, outputs="T"), count=6)
        >>> found, round(found.sizes[found]["T"], 2)
        ((0, 1, 3, 7, 19, 50), 0.43)
    """
    model = as_model(model)
    if model.uncertainties:
        raise NotImplementedError(
            "lags are for models without uncertainties: leave them out, or decouple them"
        )
    if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 2:
        raise ValueError(f"count must be a whole number of samples >= 2, not {count!r}")
    reach = operating_reach(model, operating_range)
    top = _span_of(model)
    if longest is not None:
        top = int(longest)
    least = max(min(SHORTEST, top), 1)
    sizes: dict[tuple[int, ...], dict[str, float]] = {}
    while top >= least:
        if relation_cost(model, top)[0] < SECONDS:
            lags = spread_lags(top, int(count))
            sizes.setdefault(lags, _sizes(model, lags, reach))
        top //= 2
    chosen = SuggestedLags(_chosen_lags(sizes))
    chosen.sizes = sizes
    return chosen


def _chosen_lags(sizes: Mapping[tuple[int, ...], Mapping[str, float]]) -> tuple[int, ...]:
    """Return the shortest lags among those that see nearly as much as the best."""
    able = {lags: own for lags, own in sizes.items() if any(map(math.isfinite, own.values()))}
    if not able:
        raise ValueError(
            "no window of these spans is sure to see a lasting fault, whatever its size: its bounds or "
            "disturbances hide it"
        )
    score = {lags: _mean_log_ratio(own, list(able.values())) for lags, own in able.items()}
    enough = min(score.values()) + math.log(ENOUGH)
    return min((lags for lags in able if score[lags] <= enough), key=lambda lags: lags[-1])


def slowest(model: LinearSystem) -> float:
    """Return the slowest time constant of a plant in samples, inf if it integrates or is unstable, 0 without
    states.
    """
    return max(time_constants(model), default=0.0)


def _span_of(model: LinearSystem) -> int:
    """Return the longest span that is worth a look."""
    memory = slowest(model)
    if math.isinf(memory):
        memory = max([64.0, *(slow for slow in time_constants(model) if math.isfinite(slow))])
    return min(max(math.ceil(memory), 2 * model.n + 1, SHORTEST), LONGEST)


def spread_lags(span: int, count: int) -> tuple[int, ...]:
    """Return lags up to span, all of them or at most `count`, each farther back by about the same factor."""
    if span < count:
        return tuple(range(span + 1))
    return tuple(np.unique(np.round([0, *np.geomspace(1, span, count - 1)])).astype(int).tolist())


def _sizes(model: LinearSystem, lags: tuple[int, ...], reach: Vector) -> dict[str, float]:
    """Return {signal: about the size of a constant fault that is always seen}: 1 / t, with

    t = min over z of max_i |phi_i - (E z)_i| / width_i    (`detectability`, widths twice the half-widths)
    """
    from scipy.optimize import linprog
    from scipy.sparse import csr_array, hstack, vstack

    s = lags[-1]
    looked_at = window.window_rows(model, s, lags).seen
    rows = window.unknowns(model, s)[0]
    E = np.array([rows[i] for i in looked_at], float)
    E = csr_array(E / np.maximum(np.abs(E).max(0, initial=0), 1e-300))  # of columns that grow out of reach
    cost, free = np.append(np.zeros(E.shape[1]), 1.0), [(None, None)] * E.shape[1] + [(0, None)]
    sizes = {}
    for name in model.outputs + model.inputs:
        shift, widths, _ = window_shift(model, name, s, reach, lags)
        phi, width = np.array(shift, float), np.array(widths, float)
        most = np.abs(phi).max(initial=0) or 1.0
        upper = vstack([hstack([sign * E, csr_array(-width[:, None])]) for sign in (1, -1)])
        t = linprog(cost, upper, np.concatenate([phi, -phi]) / most, bounds=free, method="highs").fun
        sizes[name] = math.inf
        if t is not None and t * width.max() >= 1e-9:
            sizes[name] = float(1 / (t * most))
    return sizes


def _mean_log_ratio(sizes: Mapping[str, float], others: Sequence[Mapping[str, float]]) -> float:
    """Return the mean logarithm of sizes over the smallest of each signal; what is never seen counts ten
    times the worst.
    """
    logarithms = []
    for name, size in sizes.items():
        finite = [other[name] for other in others if math.isfinite(other[name])]
        if not finite:
            continue
        if math.isinf(size):
            size = 10 * max(finite)
        logarithms.append(math.log(size / min(finite)))
    return sum(logarithms) / len(logarithms)
