"""The linear programs of windows whose first state lies in a set: searched in floats (`window_search`), and
proved with rounding (`window_proof`).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxbound.estimation.blocks import chosen, in_blocks
from jaxbound.estimation.ordered import product
from jaxbound.estimation.window_proof import Prior, Samples, enclosed, window_of
from jaxbound.estimation.window_runs import AverageRows
from jaxbound.estimation.window_search import WindowProgram, followed, middle, searched
from jaxbound.estimation.zonotope_steps import Numbers

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
    N): the unknowns of the trajectory; window: the program.
    """

    value: np.ndarray
    bound: np.ndarray
    t: np.ndarray
    z: np.ndarray
    window: WindowProgram

    def replaced(self, where: np.ndarray, by: "Gauges") -> "Gauges":
        """Return these with others where (N,)."""
        return self._replace(
            value=np.where(where, by.value, self.value),
            bound=np.where(where, by.bound, self.bound),
            t=np.where(where, by.t, self.t),
            z=np.where(where, by.z, self.z),
        )


@dataclass(frozen=True, eq=False)
class WindowPrograms:
    """The programs of windows of one plant.

    Fields: plant: the numbers, in float64; strips T (t, n): what is known of a first state beside a
    parallelotope; runs: of averages in a window, or None; dtype: of searches.
    """

    plant: Numbers
    strips: np.ndarray
    runs: AverageRows | None
    dtype: np.dtype

    def gauges(self, prior: Prior, samples: Samples) -> Gauges:
        """Return the gauges of windows.

        A search that proved nothing and lost its trajectory begins again from the one that its first state
        and disturbances make.
        """
        window = window_of(self.plant, self.strips, prior, samples, self.runs)
        best = self._gauges_from(middle(window), prior, samples, window)
        for _ in range(AGAIN):
            near, lost = _lost(best)
            if not lost.any():
                break
            best = best.replaced(lost, self._gauges_from(near, prior, samples, window))
        return best

    def _gauges_from(self, z: np.ndarray, prior: Prior, samples: Samples, window: WindowProgram) -> Gauges:
        """Return the gauges, searched for from a trajectory z on."""
        n, N = prior.c.shape
        weight, t, z = searched(window, z, CLOSE)
        nowhere, first = np.zeros((n, N)), np.zeros(N)
        value, bound = enclosed(
            self.plant, self.strips, prior, samples, weight, nowhere, first, runs=self.runs
        )
        return Gauges(value, bound, t, z, window)

    def supports(
        self,
        prior: Prior,
        samples: Samples,
        D: np.ndarray,
        width: np.ndarray,
        J: np.ndarray,
        before: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return (lo, hi), each (r, N), of D x_J over all that explains windows.

        Args:
            D (r, n): directions. width (r, N): about the widths. J (N,): steps of the state. before: whether
                it is the state before its sample is looked at.
        """
        rows, N = len(D), prior.c.shape[-1]
        # without unknown inputs the state before its sample is the state
        earlier = before and self.plant.free is not None
        usual = np.where((width > 0) & np.isfinite(width), width, 1)
        scale = np.ldexp(1.0, -np.frexp(usual)[1])
        close = self._close(prior)

        def job(block: np.ndarray) -> np.ndarray:
            some, window_samples = chosen(prior, block), chosen(samples, block)
            gauges = self.gauges(some, window_samples)
            ends = []
            for sign in (-1, 1):
                for i in range(rows):
                    d = (sign * D[i][:, None] * scale[i, block]).astype(self.dtype)
                    pulled = d
                    if earlier:
                        pulled = product(self.plant.A.T, d.astype(np.float64)).astype(self.dtype)
                    weight, *_ = searched(gauges.window, gauges.z, close, pulled, J[block] - earlier)
                    value, bound = enclosed(
                        self.plant, self.strips, some, window_samples, weight, d, J[block], before, self.runs
                    )
                    end = _sum_up(value, bound) / scale[i, block]
                    ends.append(np.where(np.isfinite(bound), end, np.inf))
            return np.stack(ends, -1)

        ends = np.concatenate(in_blocks(job, N, ROOM))[:N].T.reshape(2, rows, N)
        return -ends[0], ends[1]

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


def _lost(gauges: Gauges) -> tuple[np.ndarray, np.ndarray]:
    """Return (trajectories to begin again from (K, N), the windows (N,) that need it)."""
    undecided = (np.abs(gauges.value) <= gauges.bound) & ~(gauges.t < 1)
    if not undecided.any():
        return gauges.z, undecided
    near, off = followed(gauges.window, gauges.z)
    return near, undecided & ~(off <= LOST * gauges.t)


def _sum_up(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return at least a + b."""
    return np.nextafter(a.astype(np.float64) + b.astype(np.float64), np.inf)
