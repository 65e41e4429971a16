"""The linear programs of windows: searched for in floats (`window_search`), and what was found is checked
(`window`).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxbound.estimation.blocks import chosen, in_lanes
from jaxbound.estimation.window import Prior, Samples, WindowPlant, through
from jaxbound.estimation.window_search import followed, middle, program_of, searched

__all__ = ["ROOM", "Gauges", "WindowPrograms"]

ROOM = 32
"""Windows side by side in the one kernel there is: see `set_observer.BLOCK`. A search ends with the slowest
of them.
"""
AGAIN, LOST = 2, 1e-3
"""Searches after the first where that lost its trajectory; how far a sample may be off it, as a share of the
largest unknown.
"""
CLOSE = 0.02
"""Gap, relative, at which the search for a gauge is done: far enough for a verdict."""


class Gauges(NamedTuple):
    """The gauges of N windows, and the trajectories that were found.

    Fields: value, bound, t (N,): |value| > bound is a contradiction, t < 1 explains in plain floats; z (K,
    N): the unknowns of the trajectory.
    """

    value: np.ndarray
    bound: np.ndarray
    t: np.ndarray
    z: np.ndarray


@dataclass(frozen=True, eq=False)
class WindowPrograms:
    """The programs of windows of one plant. Fields: plant; dtype: of searches."""

    plant: WindowPlant
    dtype: np.dtype

    def gauges(self, prior: Prior, samples: Samples) -> Gauges:
        """Return the gauges of windows.

        A search that proved nothing and lost its trajectory begins again from the one that its first state
        and disturbances make.
        """

        def job(lanes: np.ndarray) -> Gauges:
            return self._gauges(chosen(prior, lanes), chosen(samples, lanes))

        return Gauges(*in_lanes(job, prior.c.shape[-1], ROOM))

    def _gauges(self, prior: Prior, samples: Samples) -> Gauges:
        """Return the gauges of a block of windows."""
        image = self.plant.image(prior, samples)
        program = program_of(self.plant, image, self.dtype)
        nowhere, first = np.zeros(prior.c.shape), np.zeros(prior.c.shape[-1])

        def found(z: np.ndarray) -> Gauges:
            weight, t, z = searched(program, z, CLOSE)
            return Gauges(*self.plant.enclosed(image, weight, nowhere, first), t, z)

        best = found(middle(program))
        for _ in range(AGAIN):
            lost = (np.abs(best.value) <= best.bound) & ~(best.t < 1)
            if lost.any():
                near, off = followed(program, best.z)
                lost &= ~(off <= LOST * best.t)
            if not lost.any():
                break
            best = Gauges(*(np.where(lost, x, y) for x, y in zip(found(near), best, strict=True)))
        return best

    def supports(
        self,
        prior: Prior,
        samples: Samples,
        z: np.ndarray,
        D: np.ndarray,
        width: np.ndarray,
        J: np.ndarray,
        before: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return (lo, hi), each (r, N), of D x_J over all that explains windows.

        Args:
            z (K, N): trajectories, of gauges. D (r, n): directions. width (r, N): about the widths. J (N,):
            steps of the state. before: whether it is the state before its sample is looked at.
        """
        rows, N = width.shape
        # without unknown inputs the state before its sample is the state
        earlier = before and bool(self.plant.taking[-1].any())
        usual = np.where((width > 0) & np.isfinite(width), width, 1)
        scale = np.tile(np.ldexp(1.0, -np.frexp(usual)[1]), (2, 1)).ravel()
        directions, close = np.concatenate([-D, D]), self._close(prior)

        def job(lanes: np.ndarray) -> tuple[np.ndarray]:
            # one direction of all windows after the other
            way, of = np.divmod(lanes, N)
            image = self.plant.image(chosen(prior, of), chosen(samples, of))
            d = (directions[way].T * scale[lanes]).astype(self.dtype)
            pull = d
            if earlier:
                pull = through(self.plant.plant.A.T, d.astype(np.float64)).astype(self.dtype)
            program = program_of(self.plant, image, self.dtype)
            weight, *_ = searched(program, z[:, of], close, pull, J[of] - earlier)
            value, bound = self.plant.enclosed(image, weight, d, J[of], before)
            return (np.where(np.isfinite(bound), np.nextafter(value + bound, np.inf) / scale[lanes], np.inf),)

        (ends,) = in_lanes(job, 2 * rows * N, ROOM)
        low, high = ends.reshape(2, rows, N)
        return -low, high

    def _close(self, prior: Prior) -> float:
        """Return the gap at which the search for a support is done.

        Several bounds of one first state are nearly parallel: closer to the optimum their multipliers lose
        their digits.
        """
        if self.dtype == np.float32:
            return 1e-4
        if np.isfinite(prior.rad).any():
            return 1e-6
        return 1e-9
