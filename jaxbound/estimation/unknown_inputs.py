"""An interval of each unknown input at every sample, from the windows that determine it.

An unknown input v is determined by a window if some h gives h E = e_v, with E as in `models.window.unknowns`:
then v = h (Y, w) - k U for an exact plant, and the samples' intervals give one for v. Every vector of minimal
support among these h is used, so that the intersection of their intervals is all that the window says of v.

Source: Ragot 1993, (4b), whose left inverse N of F is one such h; the intersection over circuits is the exact
projection.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from math import comb

import jax
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.consistency.drive import raw_outputs
from jaxbound.consistency.folded import tested
from jaxbound.consistency.interface import Arrays, Block, LinearRelations, LinearTest, Run
from jaxbound.consistency.reading import Reading
from jaxbound.consistency.unproved import stretch_block
from jaxbound.exact import linalg
from jaxbound.exact.circuits import circuits
from jaxbound.exact.linalg import Matrix, Vector
from jaxbound.models import window
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.numbers import is_whole
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.table import Data
from jaxbound.relations.cost import affordable
from jaxbound.relations.parity import SUBSETS, stated_relations
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.sets.intervals.interval import Interval
from jaxbound.sets.strips.bank import bank_range
from jaxbound.sets.strips.strips import strips_of
from jaxbound.text.objects import readable
from jaxbound.text.progress import Progress, in_part, reporter

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
    recording = Recording.of(model, u, y, starts).finite()
    samples, dtype = np.shape(recording.y)[:-1], recording.y.dtype
    lo = np.full((*samples, model.d), -np.inf, dtype)
    hi = np.full((*samples, model.d), np.inf, dtype)
    lags: list[int | None] = [None] * model.d
    for j, position in enumerate(positions):
        if position is None:
            continue
        lag = lags[j] = horizon - position
        test = _test(model, horizon, position, j, dtype)
        share = partial(in_part, report, j / model.d, 1 / model.d)
        least, most = raw_outputs(test, recording.u, recording.y, recording.starts, share)
        empty = least > most
        least[empty], most[empty] = np.inf, -np.inf
        at = ..., slice(position, samples[-1] - lag), j
        lo[at], hi[at] = least[..., horizon:], most[..., horizon:]
    return UnknownInputs(Interval(lo, hi), horizon, tuple(lags))


def _positions(model: LinearSystem, horizon: int | None) -> tuple[int, list[int | None]]:
    """Return (horizon, for each unknown input the last sample of a window at which it is determined, or
    None).
    """
    if horizon is not None:
        if not is_whole(horizon) or horizon < 0:
            raise ValueError(f"horizon must be a whole number >= 0, not {horizon!r}")
        affordable(model, int(horizon))
        return int(horizon), _determined(model, int(horizon))
    longest = _determined(model, model.n + 1)
    wanted = [place is not None for place in longest]
    for s in range(model.n + 2):
        if [place is not None for place in _determined(model, s)] == wanted:
            return s + 1, _determined(model, s + 1)
    return model.n + 1, longest


def _determined(model: LinearSystem, s: int) -> list[int | None]:
    """Return for each unknown input the last sample of s + 1 at which these determine it, or None."""
    E = window.unbounded(model, s)
    rank = linalg.rank(E)
    places: list[int | None] = [None] * model.d
    for j in range(model.d):
        for t in reversed(range(window.unknown_lags(model, s))):
            unit = _unit(len(E[0]), model.n + t * model.d + j)
            if linalg.rank((*E, unit)) == rank:
                places[j] = t
                break
    return places


def _unit(length: int, place: int) -> tuple[Fraction, ...]:
    """Return a row with 1 at one place and 0 elsewhere."""
    return tuple(Fraction(int(c == place)) for c in range(length))


def _test(model: LinearSystem, s: int, position: int, j: int, dtype: np.dtype) -> _RangeTest:
    """Return a WindowTest whose strips are ways to work out v_j at a position of the window: h (Y, w) - k U =
    v.
    """
    E, K = window.unknowns(model, s)
    column = model.n + model.g * s + position * model.d + j
    extended = (*E, _unit(len(E[0]), column))
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
    count = (s + 1) * model.p
    return _RangeTest(stated_relations(model, s, tuple(h[:count] for h in ways), known), ways, known, dtype)


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

    ways = [tuple(-x / h[-1] for x in h[:-1]) for h in combinations if h[-1]]
    return tuple(sorted(ways, key=width)[:KEPT])


class _RangeTest(LinearTest):
    """Says in which interval a number is, of which each strip is a way to work it out."""

    gathered = False

    def __init__(self, relations: LinearRelations, ways: Matrix, known: Matrix, dtype: np.dtype) -> None:
        super().__init__(relations, "box", dtype)
        shape = strips_of(ways, known, unrolled=KEPT).astype(dtype)
        self.reading = dataclasses.replace(relations.reading(dtype, "box"), shape=shape)

    @property
    def block(self) -> int:
        """How many windows are judged at once."""
        return stretch_block(self.reading)

    @property
    def outputs(self) -> tuple[tuple[np.dtype, float], ...]:
        """Lowest and highest, infinite where there is no window."""
        return (self.dtype, -np.inf), (self.dtype, np.inf)

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (lo, hi) of each block."""
        return run(_ranges, blocks)


@kernel
def _ranges(reading: Reading, u: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (lo, hi) (N,) of what the strips say together."""
    return bank_range(tested(reading, *reading.columns(u, y)), y[reading.horizon :, 0])
