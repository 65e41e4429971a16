"""An interval of each unknown input at every sample, from the windows that determine it.

An unknown input v is determined by a window if some h gives h E = e_v, with E as in `models.window.unknowns`:
then v = h (Y, w) - k U for an exact plant, and the samples' intervals give one for v. Every vector of minimal
support among these h is used, so that the intersection of their intervals is all that the window says of v.

Source: Ragot 1993, (4b), whose left inverse N of F is one such h; the intersection over circuits is the exact
projection.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from math import comb
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.consistency.drive import measured
from jaxbound.consistency.interface import LinearTest
from jaxbound.consistency.unproved import stretch_block
from jaxbound.exact import linalg
from jaxbound.exact.circuits import circuits
from jaxbound.models import window
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.recordings.recording import Recording
from jaxbound.relations.cost import affordable
from jaxbound.relations.parity import SUBSETS, stated_relations
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.intervals.interval import Interval
from jaxbound.sets.strips.bank import bank_of, bank_range
from jaxbound.text.objects import readable

__all__ = ["UnknownInputs", "unknown_inputs"]

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
    lags: tuple


def unknown_inputs(
    model: ModelLike,
    u: Any,
    y: Any = None,
    horizon: int | None = None,
    progress: Callable[[float], object] | None = None,
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
    refuse_unverified()
    model = as_model(model)
    if not model.d:
        raise ValueError("the model has no unknown inputs")
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
    given = Recording.of(model, u, y, starts).finite()
    y = np.asarray(given.y)
    lo, hi = (np.full((*y.shape[:-1], model.d), side, y.dtype) for side in (-np.inf, np.inf))
    lags = tuple(None if t is None else horizon - t for t in positions)
    for j, (position, lag) in enumerate(zip(positions, lags, strict=True)):
        if position is None:
            continue
        test = _test(model, horizon, position, j, y.dtype)
        report = None if progress is None else lambda share, j=j: progress((j + share) / model.d)
        found = measured(test, given.u, given.y, given.starts, report)
        empty = found[0] > found[1]
        for side, values, nothing in zip((lo, hi), found, (np.inf, -np.inf), strict=True):
            values[empty] = nothing
            side[..., position : y.shape[-2] - lag, j] = values[..., horizon:]
    return UnknownInputs(Interval(lo, hi), horizon, lags)


def _positions(model, horizon):
    """Return (horizon, for each unknown input the last sample of a window at which it is determined, or
    None).
    """
    if horizon is not None:
        if isinstance(horizon, bool) or not isinstance(horizon, (int, np.integer)) or horizon < 0:
            raise ValueError(f"horizon must be a whole number >= 0, not {horizon!r}")
        affordable(model, int(horizon))
        return int(horizon), _determined(model, int(horizon))
    longest = _determined(model, model.n + 1)
    wanted = [x is not None for x in longest]
    for s in range(model.n + 2):
        if [x is not None for x in _determined(model, s)] == wanted:
            return s + 1, _determined(model, s + 1)
    return model.n + 1, longest


def _determined(model, s):
    E = window.unbounded(model, s)
    lags, out = window.unknown_lags(model, s), []
    rank = linalg.rank(E)
    for j in range(model.d):
        unit = lambda t, j=j: tuple(Fraction(int(c == model.n + t * model.d + j)) for c in range(len(E[0])))
        out.append(next((t for t in reversed(range(lags)) if linalg.rank((*E, unit(t))) == rank), None))
    return out


def _test(model, s, position, j, dtype):
    """Return a WindowTest whose strips are ways to work out v_j at a position of the window: h (Y, w) - k U =
    v.
    """
    E, K = window.unknowns(model, s)
    column = model.n + model.g * s + position * model.d + j
    extended = (*E, tuple(Fraction(int(c == column)) for c in range(len(E[0]))))
    rank = linalg.rank(E)
    if comb(len(extended), rank + 1) > 10 * SUBSETS:
        raise ValueError(
            f"windows of horizon {s} are too long to work out the unknown inputs of this model: choose a "
            f"shorter horizon"
        )
    found = [tuple(-x / h[-1] for x in h[:-1]) for h in circuits(extended) if h[-1]]
    half = [*[float(a + b) or 1.0 for a, b in zip(model.noise, model.resolution, strict=True)] * (s + 1)]
    half += [float(hi - lo) / 2 for lo, hi in model.disturbance] * s
    found.sort(key=lambda h: sum(abs(float(x)) * r for x, r in zip(h, half, strict=True)))
    ways = tuple(found[:KEPT])
    known = linalg.matmul(ways, K) if K[0] else tuple(() for _ in ways)
    count = (s + 1) * model.p
    return _RangeTest(stated_relations(model, s, tuple(h[:count] for h in ways), known), ways, known, dtype)


class _RangeTest(LinearTest):
    """Says in which interval a number is, of which each strip is a way to work it out."""

    gathered = False

    def __init__(self, relations, ways, known, dtype):
        super().__init__(relations, "box", dtype)
        self.reading = dataclasses.replace(relations.reading(dtype, "box"), shape=bank_of(ways, known, dtype))

    @property
    def block(self):
        return stretch_block(self.reading)

    @property
    def outputs(self):
        return (self.dtype, -np.inf), (self.dtype, np.inf)

    def judge(self, run, blocks):
        return run(_ranges, blocks)


@kernel
def _ranges(test, u, y):
    """Return (lo, hi) (N,) of what the strips say together."""
    mid, rad, scale, known, known_scale = test.stretch(u, y)
    return bank_range(test.shape, mid, rad, scale, known, known_scale, test.lift)
