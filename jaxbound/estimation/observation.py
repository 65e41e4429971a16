"""States and outputs that an observer encloses, its verdicts, and the protocol of the state it carries."""

from dataclasses import dataclass
from typing import Protocol, TypeVar

import jax
import numpy as np

from jaxbound.estimation.zonotope_steps import ZonotopeCarry
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.objects import readable


class CarriedState(Protocol):
    """The state of any set observer, a NamedTuple: its zonotopes, and how many samples there were."""

    @property
    def carry(self) -> ZonotopeCarry:
        """The zonotopes, recordings on the last axis."""

    @property
    def samples(self) -> np.int64:
        """How many samples there were."""


State = TypeVar("State", bound=CarriedState)


@readable
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Observation:
    """The states and outputs that `observe` encloses, and its verdicts, time first.

    Fields:
        status (..., T) int8, see `Status`: FAULT is a proof that no behaviour explains all samples from
            `since` to this one. CONSISTENT that one does: a trajectory, of method "joint" with x0 alone.
            UNDECIDED: neither is proved. MISSING: nothing to test against (the state is not known yet), or no
            sample.
        margin (..., T): 1 - t, t the factor on the set before this sample and on its own bounds at which the
            two would just touch, by the worst output: < 0 where FAULT. It is about this sample given those
            before, not comparable with the margin of a window. NaN where nothing was tested.
        since (..., T) int: the first sample that the enclosure rests on; -1: there is none.
        state Interval (..., T, n): holds the state of every behaviour that explains the samples from `since`
            on, this one included; entire where there is none. Of a FAULT: the states that the samples before
            it allowed. NaN, like the others, where nothing is left: behind a FAULT that stays
            (restart=False).
        predicted Interval (..., T, p): of a perfect sensor, as far as the samples before this one tell.
        output Interval (..., T, p): with this sample.
    """

    status: np.ndarray
    margin: np.ndarray
    since: np.ndarray
    state: Interval
    predicted: Interval
    output: Interval
