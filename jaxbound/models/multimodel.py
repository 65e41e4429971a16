"""Decoupled multiple models: sub-models that run side by side, and one output weighted by what the input
says.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.models.intervals import IntervalSystem, Moves, as_intervals
from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals.interval import Interval, interval
from jaxbound.text.objects import readable

UNITS = 32
"""A weight is taken to be within so many units of roundoff (16 ulps) of the number that the user's function
returns.
"""


@readable
@dataclass(frozen=True, eq=False)
class MultiModel:
    """x_i+ = A_i x_i + B_i u + w_i for every sub-model i, and y = sum_i mu_i(u) C_i x_i: a plant that changes
    with its input.

    Args:
        models: L LinearSystems or interval systems with the same inputs and outputs, without feedthrough or
            offset. A disturbance of each is kept: without one the sub-models are nearly open-loop, and a
            plant that is 0.2 % off leaves the enclosure.
        weights: function of u (..., m) that returns mu (..., L) >= 0 with sum 1: numbers, which are taken to
            be right within 16 ulps, or an Interval where they are less certain.
        partial: False: only the weighted sum y (..., T, p) is measured; `validate` then looks for the states
            of all sub-models at once, and mostly needs x0, however wide: few samples of a mixture do not
            bound so many states.
            True: every C_i x_i is, y (..., T, L, p), as the paper's (7) assumes; `validate` then treats the
                sub-models one by one.

    Raises:
        ValueError: fewer than two models, inputs or outputs that differ in number, feedthrough or an offset.
            TypeError: no models.

    Source: the multiple-model paper, (3)-(5).

    Example:
        >>> from jaxbound import interval_system
        >>> slow, fast = (interval_system([[a]], [[1 - a]], [[1]], noise=0.1) for a in (0.9, 0.5))
        >>> MultiModel([slow, fast], lambda u: np.stack([u[..., 0] < 0, u[..., 0] >= 0], -1)).n
        2
    """

    models: tuple[IntervalSystem, ...]
    weights: Callable[[np.ndarray], ArrayLike | Interval]
    partial: bool = False

    def __post_init__(self) -> None:
        models = tuple(map(as_intervals, self.models))
        if len(models) < 2:
            raise ValueError(f"a MultiModel needs at least two models, not {len(models)}")
        counts = {"inputs": [m.m for m in models], "outputs": [m.p for m in models]}
        for field, numbers in counts.items():
            if len(set(numbers)) > 1:
                raise ValueError(f"all models need the same number of {field}: {numbers}")
        for i, m in enumerate(models):
            if not all(_is_zero(x) for x in (m.D, *m.offset.values())):
                raise ValueError(f"model {i + 1} has feedthrough or an offset: a MultiModel takes neither")
        object.__setattr__(self, "models", models)

    @property
    def n(self) -> int:
        """Number of states of all sub-models."""
        return sum(m.n for m in self.models)

    def joined(self) -> IntervalSystem:
        """Return all sub-models as one IntervalSystem with C = [C_1 .. C_L], to be weighted at each sample,
        and with the widest noise.
        """
        models, first = self.models, self.models[0]
        names = []
        for i, m in enumerate(models):
            names += [f"{i + 1}.{name}" for name in m.states]
        return IntervalSystem(
            A=_diagonal([m.A for m in models]),
            B=_joined([m.B for m in models], 0),
            C=_joined([m.C for m in models], 1),
            D=first.D,
            w=_joined([m.w for m in models], 0),
            # one sensor reads the sum: the widest bound holds whatever the weights are
            tolerance=np.max([m.tolerance for m in models], 0),
            noise=np.max([m.noise for m in models], 0),
            offset=first.offset,
            inputs=first.inputs,
            outputs=first.outputs,
            states=tuple(names),
            moves=self._moves(),
        )

    def _moves(self) -> Moves | None:
        """Return the moves of all sub-models, None where none has any."""
        if not any(m.moves for m in self.models):
            return None
        each = []
        for m in self.models:
            # of a sub-model without moves of its own: A x - x+ = -B u - w, all rows
            identity = interval(np.eye(m.n).astype(m.A.dtype))
            each.append(m.moves or (m.A, identity, m.B, m.w))
        E, K, H, d = zip(*each, strict=True)
        return _diagonal(E), _diagonal(K), _joined(H, 0), _joined(d, 0)

    def mu(self, u: np.ndarray) -> Interval:
        """Return the weights (..., L) for inputs u (..., m), as an Interval in the type of u.

        Raises:
            ValueError: weights of another shape, negative, or whose sum is not 1.
        """
        stated = self.weights(u)
        if isinstance(stated, Interval):
            lo, hi = np.asarray(stated.lo), np.asarray(stated.hi)
        else:
            lo = hi = np.asarray(stated)
        if lo.shape != (*u.shape[:-1], len(self.models)):
            raise ValueError(
                f"weights must return shape {(*u.shape[:-1], len(self.models))} for u of shape {u.shape}, "
                f"not {lo.shape}"
            )
        if isinstance(stated, Interval):
            sums_to_one = bool((lo.sum(-1) <= 1).all() and (hi.sum(-1) >= 1).all())
        else:
            # within the rounding of a user's own function, which the outward step below allows for
            sums_to_one = np.allclose(lo.sum(-1), 1)
        if not ((lo >= 0) & (hi >= lo)).all() or not sums_to_one:
            raise ValueError("weights must be >= 0 and sum to 1 at every sample")
        units = float(UNITS)
        if np.issubdtype(lo.dtype, np.floating):  # of the coarser of both types
            units *= max(float(rounding.unit(lo.dtype) / rounding.unit(u.dtype)), 1)
        low, high = rounding.outward(lo.astype(u.dtype), hi.astype(u.dtype), units)
        # a weight is >= 0, rounded or not
        return Interval(np.maximum(low, 0), np.asarray(high))

    def columns(self, u: np.ndarray) -> Interval:
        """Return the weight of each state's column of C, (..., n), for inputs u (..., m). See `mu`."""
        mu, times = self.mu(u), [m.n for m in self.models]
        return Interval(np.repeat(mu.lo, times, axis=-1), np.repeat(mu.hi, times, axis=-1))


def _is_zero(x: Interval) -> bool:
    return not (np.any(np.asarray(x.lo) != 0) or np.any(np.asarray(x.hi) != 0))


def _joined(matrices: Sequence[Interval], axis: int) -> Interval:
    """Return Intervals one after the other."""
    lo = np.concatenate([np.asarray(x.lo) for x in matrices], axis)
    hi = np.concatenate([np.asarray(x.hi) for x in matrices], axis)
    return interval(lo, hi)


def _diagonal(matrices: Sequence[Interval]) -> Interval:
    """Return matrices along the diagonal of one, zeros beside them."""
    shape = np.sum([x.shape for x in matrices], 0)
    out = np.zeros((2, *shape), matrices[0].dtype)
    i = j = 0
    for x in matrices:
        rows, columns = x.shape
        out[:, i : i + rows, j : j + columns] = x.lo, x.hi
        i, j = i + rows, j + columns
    return interval(*out)
