"""An interval of each unknown input at every sample, from the windows that determine it.

An unknown input v is determined by a window if some h gives h E = e_v, with E as in `models.window.unknowns`:
then v = h (Y, w) - k U for an exact plant, and the samples' intervals give one for v. Every vector of minimal
support among these h is used, so that the intersection of their intervals is all that the window says of v.

Source: Ragot 1993, (4b), whose left inverse N of F is one such h; the intersection over circuits is the exact
projection.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from math import comb

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.consistency.drive import end_to_end
from jaxbound.consistency.host_rows import HostRows
from jaxbound.consistency.strips_on_host import BLOCK, HostStrips, host_strips
from jaxbound.exact import linalg
from jaxbound.exact.circuits import circuits
from jaxbound.exact.linalg import Matrix, Vector
from jaxbound.models import window
from jaxbound.models.arguments import whole_horizon
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.read import recorded
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.table import Data
from jaxbound.relations.cost import affordable
from jaxbound.relations.parity import SUBSETS, stated_relations
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.objects import readable
from jaxbound.text.progress import Progress, in_part, reporter

KEPT = 48
"""Ways to work an unknown input out that are used at most: the tightest ones."""


@readable
@dataclass(frozen=True, eq=False)
class UnknownInputs:
    """Intervals of the unknown inputs.

    Fields: values: Interval (..., T, d); entry k encloses v[k]. It is entire where v[k] is not determined, as
    at the end of a recording, and empty (lo = inf, hi = -inf) where no value explains the samples. horizon:
    of the windows. lags: for each unknown input, how many samples after it its window ends; None where it is
    never determined.
    """

    values: Interval
    horizon: int
    lags: tuple[int | None, ...]


@where_proofs_hold()
def unknown_inputs(
    model: ModelLike,
    u: Data,
    y: Data = None,
    horizon: int | None = None,
    progress: Progress | None = None,
    starts: ArrayLike = (),
) -> UnknownInputs:
    """Return intervals that contain the unknown inputs of a healthy plant.

    Args:
        model: a LinearSystem with unknown inputs. u, y: (..., T, m) and (..., T, p) as for `detect`.
        horizon: windows of horizon + 1 samples; None: one more than the shortest that determines all that can
            be determined. Longer ones are tighter, and take more time.
        progress: called with the share of the work done.
        starts: as for `detect`: no window across says anything.

    Returns:
        UnknownInputs.

    Encloses: every v[k] of every behaviour within the bounds that gives these samples, rounding included.

    Raises:
        ValueError: a model without unknown inputs, none of them determined by windows of this horizon, a
            horizon that is too long.
        NotImplementedError: an uncertain model.

    Example:
        >>> from jaxbound import LinearSystem
        >>> tank = LinearSystem([[0.9]], None, [[1]], noise=0.01, unknown_inputs=[[-1]])
        >>> leak = unknown_inputs(tank, None, [[1.0], [0.9], [0.31]], horizon=1).values
        >>> [(round(float(a), 3), round(float(b), 3)) for a, b in zip(leak.lo[:2, 0], leak.hi[:2, 0])]
        [(-0.019, 0.019), (0.481, 0.519)]
    """
    model = as_model(model, factors=True)
    if not model.d:
        raise ValueError("the model has no unknown inputs")
    report = reporter(progress, "unknown_inputs")
    if model.uncertainties:
        raise NotImplementedError(
            "unknown inputs of an uncertain model are not estimated yet: leave its uncertainties out, or "
            "decouple them"
        )
    horizon, positions = _positions(model, horizon)
    if not any(x is not None for x in positions):
        raise ValueError(
            f"no window of horizon {horizon} determines an unknown input: other unknown inputs or the state "
            f"can do the same"
        )
    recording = recorded(model, u, y, starts).finite()
    samples, dtype = np.shape(recording.y)[:-1], recording.y.dtype
    lo = np.full((*samples, model.d), -np.inf, dtype)
    hi = np.full((*samples, model.d), np.inf, dtype)
    lags: list[int | None] = [None] * model.d
    for j, position in enumerate(positions):
        if position is None:
            continue
        lag = lags[j] = horizon - position
        share = partial(in_part, report, j / model.d, 1 / model.d)
        least, most = _way_ranges(_strips_at(model, horizon, position, j), recording, share)
        # ways that contradict each other: the window is refuted
        empty = least > most
        least[empty], most[empty] = np.inf, -np.inf
        at = ..., slice(position, max(position, samples[-1] - lag)), j
        lo[at], hi[at] = least[..., horizon:], most[..., horizon:]
    return UnknownInputs(Interval(lo, hi), horizon, tuple(lags))


def _positions(model: LinearSystem, horizon: int | None) -> tuple[int, list[int | None]]:
    """Return (horizon, for each unknown input the last sample of a window at which it is determined, or
    None).
    """
    horizon = whole_horizon(horizon)
    if horizon is not None:
        affordable(model, horizon)
        return horizon, _determined(model, horizon)
    s, never = 0, _determined(model, model.n + 1).count(None)
    while _determined(model, s).count(None) > never:  # longer windows determine what shorter ones do
        s += 1
    return s + 1, _determined(model, s + 1)


def _determined(model: LinearSystem, s: int) -> list[int | None]:
    """Return for each unknown input the last sample of s + 1 at which these determine it, or None."""
    E = window.unbounded(model, s)
    rank = linalg.rank(E)
    places: list[int | None] = [None] * model.d
    for j in range(model.d):
        for t in reversed(range(window.unknown_lags(model, s))):
            # v_j is determined iff its unit row is a combination of rows that samples show
            unit = _unit_row(len(E[0]), model.n + t * model.d + j)
            if linalg.rank((*E, unit)) == rank:
                places[j] = t
                break
    return places


def _unit_row(length: int, place: int) -> tuple[Fraction, ...]:
    """Return a row with 1 at one place and 0 elsewhere."""
    return tuple(Fraction(int(c == place)) for c in range(length))


def _strips_at(model: LinearSystem, s: int, position: int, j: int) -> HostStrips:
    """Return strips that are ways to work out v_j at a position of the window: h (Y, w) - k U = v."""
    E, K = window.unknowns(model, s)
    column = model.n + model.g * s + position * model.d + j
    extended = (*E, _unit_row(len(E[0]), column))
    rank = linalg.rank(E)
    if comb(len(extended), rank + 1) > 10 * SUBSETS:
        raise ValueError(
            f"windows of horizon {s} are too long to work out the unknown inputs of this model: choose a "
            f"shorter horizon"
        )
    ways = _tightest_ways(model, s, circuits(extended))
    known: Matrix = tuple(() for _ in ways)
    if K[0]:
        known = linalg.matmul(ways, K)
    relations = stated_relations(model, s, tuple(h[: (s + 1) * model.p] for h in ways), known)
    return host_strips(relations.reading(np.float64, "box"), ways, known)


def _tightest_ways(model: LinearSystem, s: int, combinations: Iterable[Vector]) -> Matrix:
    """Return the ways to work a number out, from combinations whose last entry is that of the number: the
    `KEPT` that errors make least uncertain.
    """
    noise = [float(a + b) or 1.0 for a, b in zip(model.noise, model.resolution, strict=True)]
    disturbance = [float(hi - lo) / 2 for lo, hi in model.disturbance]
    half = [*noise * (s + 1), *disturbance * s]

    def width(h: Vector) -> float:
        """Return half the width of the interval that a way gives."""
        return sum(abs(float(x)) * r for x, r in zip(h, half, strict=True))

    # scaled so that the sum is v itself
    ways = [tuple(-x / h[-1] for x in h[:-1]) for h in combinations if h[-1]]
    return tuple(sorted(ways, key=width)[:KEPT])


def _way_ranges(ways: HostStrips, recording: Recording, report: Progress) -> tuple[np.ndarray, np.ndarray]:
    """Return (lo, hi), each (..., T): what all ways that have their data say together of each window;
    infinite where none has.

    A sum is off by less than its error bound, which covers the roundings here too.
    """
    u, y, s = end_to_end(recording.u), end_to_end(recording.y), ways.reading.horizon
    lo, hi = np.full(len(y), -np.inf), np.full(len(y), np.inf)
    for first in range(0, len(y) - s, BLOCK):
        stop = min(first + s + BLOCK, len(y))
        low, high = lo[first + s : stop], hi[first + s : stop]
        for below, above, error in ways.sums(HostRows(ways.reading, u[first:stop], y[first:stop])):
            np.fmax(low, below - error, out=low)
            np.fmin(high, above + error, out=high)
        report(stop / len(y))
    shape, dtype = recording.y.shape[:-1], recording.y.dtype
    least, most = rounding.round_down(lo, dtype).reshape(shape), rounding.round_up(hi, dtype).reshape(shape)
    gone = recording.across(s) | (np.arange(shape[-1]) < s)
    least[..., gone], most[..., gone] = -np.inf, np.inf
    return least, most
