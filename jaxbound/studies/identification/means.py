"""How far errors average out in recordings: the smallest bounds of the means of consecutive errors that
explain every window.

The bounds of single samples stay where they are, and those of the means are lowered: first together, in the
ratio of the bounds of single samples, then each output's alone. A window that is explained stays so if a
bound grows, so each is found by bisection.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.relations.parity import ParityRelation, parity_relations
from jaxbound.relations.uncertain import UncertainRelations

LEAST, STEPS = 1e-3, 10
"""The least share of the bound of a sample that is tried, and halvings of the logarithm from there to 1: to
about 1 %.
"""
LOOSE = 1 + 1e-6
"""On the bounds of single samples, the smallest that explain all: the worst window lies on their edge."""


def smallest_means(
    model: LinearSystem,
    noise: np.ndarray,
    samples: int,
    explained: Callable[[ParityRelation | UncertainRelations], bool],
    step: Callable[[float], object],
    guess: np.ndarray | None = None,
) -> np.ndarray:
    """Return the smallest bound of the mean of so many consecutive errors of each output (p,), that of a
    sample where it says nothing.

    Args:
        model: without averages. noise: (p,), bounds of single samples. samples: >= 2. explained: whether all
            windows are. step: called with the share of the work done. guess: (p,), bounds that a search in
            floats found for means: the smallest, if they explain all.
    """
    noise = np.asarray(noise) * LOOSE
    means = {name: {samples: float(b)} for name, b in zip(model.outputs, noise, strict=True)}
    relations = parity_relations(model.replace(noise=noise.tolist(), averages=means))

    def under(bounds: np.ndarray) -> bool:
        return explained(relations.with_bounds({"average": bounds}))

    if guess is not None and under(guess * LOOSE):
        return guess
    return lowered(noise, under, step)


def lowered(
    noise: np.ndarray,
    explained: Callable[[np.ndarray], bool],
    step: Callable[[float], object],
    hard: Callable[[np.ndarray], bool] | None = None,
) -> np.ndarray:
    """Return the smallest bounds (p,) of means that explain all windows.

    Args:
        noise: (p,), bounds of single samples, where the search begins. explained: whether all windows are, of
            bounds (p,) of means. step: as of `smallest_means`. hard: whether those are that spoke against
            bounds before, which is sooner known; None: it is not.
    """
    p = len(noise)
    share = np.ones(p)
    groups = [list(range(p))]
    if p > 1:
        groups += [[i] for i in range(p)]
    for number, group in enumerate(groups):

        def asked(every: Callable[[np.ndarray], bool], logarithm: float, group: list[int] = group) -> bool:
            trial = share.copy()
            trial[group] = np.exp(logarithm)
            return every(trial * noise)

        ends = np.log(LEAST), np.log(share[group[0]])
        least = _bisected(partial(asked, hard or explained), *ends)
        while hard is not None and least < ends[1] and not asked(explained, least):
            # what spoke against them is hard now; what was refused is so beside more windows
            least = _bisected(partial(asked, hard), *ends, refused=least)
        share[group] = np.exp(least)
        step((number + 1) / len(groups))
    return np.asarray(share * noise)


def _bisected(holds: Callable[[float], bool], low: float, high: float, refused: float = -np.inf) -> float:
    """Return the least number within [low, high] that holds, as near as STEPS halvings come; none up to
    `refused` does.
    """
    if low >= high:
        return high
    for _ in range(STEPS):
        middle = (low + high) / 2
        if middle > refused and holds(middle):
            high = middle
        else:
            low = middle
    return high
