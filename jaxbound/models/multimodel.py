"""Decoupled multiple models: sub-models that run side by side, and one output weighted by what the input
says.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import jax
import numpy as np

from jaxbound.models.intervals import IntervalSystem, as_intervals
from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals.interval import Interval, interval
from jaxbound.text.objects import readable

__all__ = ["MultiModel"]

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
    weights: Callable[..., Any]
    partial: bool = False

    def __post_init__(self) -> None:
        models = tuple(as_intervals(m) for m in self.models)
        if len(models) < 2:
            raise ValueError(f"a MultiModel needs at least two models, not {len(models)}")
        for field, letter in (("inputs", "m"), ("outputs", "p")):
            if len({getattr(m, letter) for m in models}) > 1:
                raise ValueError(
                    f"all models need the same number of {field}: {[getattr(m, letter) for m in models]}"
                )
        for i, m in enumerate(models):
            if any(
                np.any(np.asarray(X.lo) != 0) or np.any(np.asarray(X.hi) != 0)
                for X in (m.D, *m.offset.values())
            ):
                raise ValueError(f"model {i + 1} has feedthrough or an offset: a MultiModel takes neither")
        object.__setattr__(self, "models", models)

    n = property(lambda self: sum(m.n for m in self.models), doc="Number of states of all sub-models.")

    def joined(self) -> IntervalSystem:
        """Return all sub-models as one IntervalSystem with C = [C_1 .. C_L], to be weighted at each sample,
        and with the widest noise.
        """
        models, first = self.models, self.models[0]
        ends = lambda pick: interval(*(pick(side) for side in ("lo", "hi")))
        row = lambda matrices, axis: ends(
            lambda side: np.concatenate([np.asarray(getattr(X, side)) for X in matrices], axis)
        )
        beside = lambda letter, axis: row([getattr(m, letter) for m in models], axis)

        def diagonal(matrices):
            out = np.zeros((2, *np.sum([X.shape for X in matrices], 0)), matrices[0].dtype)
            i = j = 0
            for X in matrices:
                (a, b), sides = X.shape, (X.lo, X.hi)
                out[:, i : i + a, j : j + b] = sides
                i, j = i + a, j + b
            return interval(*out)

        noise, tolerance = (np.max([getattr(m, f) for m in models], 0) for f in ("noise", "tolerance"))
        states = tuple(f"{i + 1}.{name}" for i, m in enumerate(models) for name in m.states)
        moves = None
        if any(m.moves for m in models):
            identity = lambda m: interval(np.eye(m.n).astype(m.A.dtype))
            E, K, H, d = zip(*(m.moves or (m.A, identity(m), m.B, m.w) for m in models), strict=True)
            moves = diagonal(E), diagonal(K), row(H, 0), row(d, 0)
        return IntervalSystem(
            diagonal([m.A for m in models]),
            beside("B", 0),
            beside("C", 1),
            first.D,
            beside("w", 0),
            tolerance,
            noise,
            first.offset,
            first.inputs,
            first.outputs,
            states,
            moves,
        )

    def mu(self, u: np.ndarray) -> Interval:
        """Return the weights (..., L) for inputs u (..., m), as an Interval in the type of u.

        Raises:
            ValueError: weights of another shape, negative, or whose sum is not 1.
        """
        given = self.weights(u)
        certain = not isinstance(given, Interval)
        lo, hi = (np.asarray(x) for x in ((given, given) if certain else (given.lo, given.hi)))
        if lo.shape != (*u.shape[:-1], len(self.models)):
            raise ValueError(
                f"weights must return shape {(*u.shape[:-1], len(self.models))} for u of shape {u.shape}, "
                f"not {lo.shape}"
            )
        holds = np.allclose(lo.sum(-1), 1) if certain else (lo.sum(-1) <= 1).all() and (hi.sum(-1) >= 1).all()
        if not ((lo >= 0) & (hi >= lo)).all() or not holds:
            raise ValueError("weights must be >= 0 and sum to 1 at every sample")
        coarse = (
            rounding.unit(lo.dtype) / rounding.unit(u.dtype) if np.issubdtype(lo.dtype, np.floating) else 1
        )
        low, high = rounding.outward(lo.astype(u.dtype), hi.astype(u.dtype), UNITS * max(float(coarse), 1))
        return Interval(cast("jax.Array", np.maximum(low, 0)), cast("jax.Array", np.asarray(high)))

    def columns(self, u: np.ndarray) -> Interval:
        """Return the weight of each state's column of C, (..., n), for inputs u (..., m). See `mu`."""
        mu, times = self.mu(u), [m.n for m in self.models]
        lo, hi = (cast("jax.Array", np.repeat(side, times, axis=-1)) for side in (mu.lo, mu.hi))
        return Interval(lo, hi)
