"""Decoupled multiple models: sub-models that run side by side, and one output weighted by what the input says."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jaxbound.models.intervals import IntervalSystem, as_intervals
from jaxbound.sets.interval import Interval, interval

__all__ = ["MultiModel"]


@dataclass(frozen=True, eq=False)
class MultiModel:
    """x_i+ = A_i x_i + B_i u + w_i for every sub-model i, and y = sum_i mu_i(u) C_i x_i: only the weighted output is measured.

    Args:
        models: LinearSystems or interval systems with the same inputs and outputs, without feedthrough or offset. A disturbance of each
            is kept: without one the sub-models are nearly open-loop, and a plant that is 0.2 % off leaves the enclosure.
        weights: function of u (..., m) that returns mu (..., number of models) >= 0 with sum 1.

    Raises:
        ValueError: fewer than two models, inputs or outputs that differ in number, feedthrough or an offset. TypeError: no models.

    Source: the multiple-model paper, (3)-(5); the joint form over all states instead of its (7), which needs every C_i x_i measured.

    Example:
        >>> from jaxbound import interval_system
        >>> slow, fast = (interval_system([[a]], [[1 - a]], [[1]], noise=0.1) for a in (0.9, 0.5))
        >>> MultiModel([slow, fast], lambda u: np.stack([u[..., 0] < 0, u[..., 0] >= 0], -1)).n
        2
    """

    models: tuple
    weights: Callable

    def __post_init__(self):
        models = tuple(as_intervals(m) for m in self.models)
        if len(models) < 2:
            raise ValueError(f"a MultiModel needs at least two models, not {len(models)}")
        for field, letter in (("inputs", "m"), ("outputs", "p")):
            if len({getattr(m, letter) for m in models}) > 1:
                raise ValueError(f"all models need the same number of {field}: {[getattr(m, letter) for m in models]}")
        for i, m in enumerate(models):
            if any(np.any(np.asarray(X.lo) != 0) or np.any(np.asarray(X.hi) != 0) for X in (m.D, *m.offset.values())):
                raise ValueError(f"model {i + 1} has feedthrough or an offset: a MultiModel takes neither")
        object.__setattr__(self, "models", models)

    n = property(lambda self: sum(m.n for m in self.models), doc="Number of states of all sub-models.")

    def joined(self):
        """Return all sub-models as one IntervalSystem with C = [C_1 .. C_L], to be weighted at each sample, and with the widest noise."""
        models = self.models
        ends = lambda pick: interval(*(pick(side) for side in ("lo", "hi")))

        def diagonal(side):
            A, at = np.zeros((self.n, self.n), models[0].A.dtype), 0
            for m in models:
                A[at : at + m.n, at : at + m.n] = getattr(m.A, side)
                at += m.n
            return A

        beside = lambda letter, axis: ends(
            lambda side: np.concatenate([np.asarray(getattr(getattr(m, letter), side)) for m in models], axis)
        )
        first = models[0]
        noise, tolerance = (np.max([getattr(m, f) for m in models], 0) for f in ("noise", "tolerance"))
        states = tuple(f"{i + 1}.{name}" for i, m in enumerate(models) for name in m.states)
        return IntervalSystem(ends(diagonal), beside("B", 0), beside("C", 1), first.D, beside("w", 0), tolerance, noise, first.offset,
                              first.inputs, first.outputs, states)  # fmt: skip

    def columns(self, u):
        """Return the weight of each state's column of C, (..., n), for inputs u (..., m), as an Interval a few ulps wide.

        Raises:
            ValueError: weights of another shape, negative, or whose sum is not 1.
        """
        mu = np.asarray(self.weights(u), float)
        if mu.shape != (*u.shape[:-1], len(self.models)):
            raise ValueError(f"weights must return shape {(*u.shape[:-1], len(self.models))} for u of shape {u.shape}, not {mu.shape}")
        if not (mu >= 0).all() or not np.allclose(mu.sum(-1), 1):
            raise ValueError("weights must be >= 0 and sum to 1 at every sample")
        wide = np.repeat(mu, [m.n for m in self.models], axis=-1)
        return Interval(wide.astype(u.dtype), wide.astype(u.dtype))
