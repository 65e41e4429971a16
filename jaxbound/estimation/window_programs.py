"""The linear programs of windows: searched for in floats (`window_search`), and what was found is checked
(`window`).
"""

from collections.abc import Sequence

import numpy as np

from jaxbound.estimation.blocks import chosen, in_lanes
from jaxbound.estimation.window import Prior, Samples, WindowPlant, through
from jaxbound.estimation.window_search import program_of, searched

ROOM = 32
"""Windows side by side in the one kernel there is: see `set_observer.BLOCK`. A search ends with the slowest
of them.
"""
AGAIN = 2
"""Searches after the first where that lost its trajectory."""


def gauges(plant: WindowPlant, prior: Prior, samples: Samples) -> tuple[np.ndarray, ...]:
    """Return (value, bound, t (N,), z (K, N)) of windows: |value| > bound is a contradiction, t < 1 explains
    in plain floats, by the trajectory of the unknowns z.

    A search that proved nothing and lost its trajectory begins again from the one that its first state and
    disturbances make.
    """

    def job(lanes: np.ndarray) -> Sequence[np.ndarray]:
        some = chosen(prior, lanes)
        image = plant.image(some, chosen(samples, lanes))
        program = program_of(plant, image, some.c.dtype)
        nowhere, first = np.zeros(some.c.shape), np.zeros(len(lanes))

        def found(z: np.ndarray | None) -> tuple[Sequence[np.ndarray], np.ndarray]:
            weight, t, z, parted = searched(program, z)
            value, bound = plant.enclosed(image, weight, nowhere, first)
            return (value, bound, t, z), parted & (np.abs(value) <= bound) & ~(t < 1)

        best, lost = found(None)
        for _ in range(AGAIN):
            if not lost.any():
                break
            other, again = found(best[-1])
            best, lost = [np.where(lost, *pair) for pair in zip(other, best, strict=True)], lost & again
        return best

    return in_lanes(job, prior.c.shape[-1], ROOM)


def supports(
    plant: WindowPlant,
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
        z (K, N): trajectories, of gauges. D (r, n): directions. width (r, N): about the widths. J (N,): steps
            of the state. before: whether it is the state before its sample is looked at.
    """
    rows, N = width.shape
    # without unknown inputs the state before its sample is the state
    earlier = before and bool(plant.taking[-1].any())
    usual = np.where((width > 0) & np.isfinite(width), width, 1)
    # by powers of two: nothing is rounded, and every program has a width of about 1
    scale = np.tile(np.ldexp(1.0, -np.frexp(usual)[1]), (2, 1)).ravel()
    directions, dtype = np.concatenate([-D, D]), prior.c.dtype

    def job(lanes: np.ndarray) -> tuple[np.ndarray]:
        # one direction of all windows after the other
        way, of = np.divmod(lanes, N)
        image = plant.image(chosen(prior, of), chosen(samples, of))
        d = (directions[way].T * scale[lanes]).astype(dtype)
        pull = d
        if earlier:
            pull = through(plant.plant.A.T, d.astype(np.float64))
        weight, *_ = searched(program_of(plant, image, dtype), z[:, of], pull, J[of] - earlier)
        value, bound = plant.enclosed(image, weight, d, J[of], before)
        return (np.where(np.isfinite(bound), np.nextafter(value + bound, np.inf) / scale[lanes], np.inf),)

    (ends,) = in_lanes(job, 2 * rows * N, ROOM)
    low, high = ends.reshape(2, rows, N)
    return -low, high
