"""Leaving recordings out: what bounds that were tuned to all others are worth on one that had no part in it.

The factor of a recording is how many times as wide as the smallest bounds of the others its own would have to
be. n recordings that are like the next one promise no more than one in n + 1, whatever is computed from them.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.studies.tuning.parametrization import Moving
from jaxbound.studies.tuning.scaling import JoinedRecordings, factors, smallest_scale

UNKNOWN = float("nan")


def factors_left_out(
    relations: ParityRelation | UncertainRelations,
    moved: Moving,
    recordings: JoinedRecordings,
    direction: Callable[[int, JoinedRecordings], np.ndarray],
) -> tuple[float, ...]:
    """Return the factor of each recording, left out in turn; () of a single one.

    Args:
        direction: of (number of the recording that is left out, all others), the values (b,) of the bounds
            that move, whose size does not matter.

    Returns:
        nan where a recording, or all others together, hold no window, or nothing but the bounds that stay is
        needed for the others.
    """
    count = len(recordings.entries)
    if count < 2:
        return ()
    found = []
    for number in range(count):
        own, others = recordings.split(number)
        found.append(_factor(relations, moved, own, others, partial(direction, number, others)))
    return tuple(found)


def _factor(
    relations: ParityRelation | UncertainRelations,
    moved: Moving,
    own: JoinedRecordings,
    others: JoinedRecordings,
    direction: Callable[[], np.ndarray],
) -> float:
    """Return the factor that some recordings need on the smallest bounds of others."""
    if own.without(relations.horizon).all() or others.without(relations.horizon).all():
        return UNKNOWN
    values = direction()
    try:
        _, high = smallest_scale(relations, moved, values, others)
    except ValueError:  # the bounds that stay explain the others alone
        return UNKNOWN
    needs = factors(relations.with_bounds(moved.bounds(np.nextafter(high * values, np.inf))), own)
    if np.isnan(needs).all():
        return UNKNOWN
    return float(np.nanmax(needs))


def of_needs(needs: Sequence[float]) -> tuple[float, ...]:
    """Return the factor of each recording where one number scales all bounds and each recording's need of it
    is known; () of a single one.

    Example:
        >>> of_needs([1.0, 2.0, 0.5])
        (0.5, 2.0, 0.25)
    """
    if len(needs) < 2:
        return ()
    found = []
    for number, need in enumerate(needs):
        found.append(need / max(*needs[:number], *needs[number + 1 :], 0.0))
    return tuple(found)
