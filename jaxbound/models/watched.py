"""A model whose recordings carry, behind the inputs, all that the tests of a monitor read of them."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from jaxbound.models.statedtests import OTHERWISE
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.factors import IN_PART, Condition, Factor, factors_of, known
from jaxbound.recordings.signals import SignalModel

NO, YES, UNKNOWN = np.int8(0), np.int8(1), np.int8(2)
"""Whether a condition holds at a sample."""


class WatchedSystem(LinearSystem):
    """A LinearSystem with columns of others behind its inputs; build it with `watched`.

    Fields beside those of LinearSystem: carried: the factors, and conditions, that its recordings carry.
    """

    carried: tuple[Factor, ...]

    @cached_property
    def factors(self) -> tuple[Factor, ...]:
        """The columns behind the inputs of a Recording."""
        return self.carried

    def __repr__(self) -> str:
        return super().__repr__().replace(type(self).__name__, "LinearSystem", 1)


def watched(
    model: LinearSystem, models: Sequence[SignalModel], conditions: Sequence[str | None]
) -> LinearSystem:
    """Return a model with the same signals whose recordings carry what its tests read; itself where they do.

    Args:
        models: of the tests, whose noise may be times factors. conditions: of the tests, None: it always
            watches.
    """
    carried: dict[str, Factor] = {}
    for each in (model, *models):
        carried |= {factor.name: factor for factor in factors_of(each)}
    for text in conditions:
        if text not in (None, OTHERWISE):
            condition = Condition(text=str(text))
            carried[condition.name] = condition
    columns = tuple(carried.values())
    if columns == model.factors:
        return model
    # fields are checked already: a copy of them, and no second construction
    same = WatchedSystem.__new__(WatchedSystem)
    vars(same).update(vars(model), carried=columns, factors=columns)
    return same


def modes_at(model: LinearSystem, conditions: Sequence[str], u: np.ndarray) -> np.ndarray:
    """Return (T, C) int8: whether each condition holds at each sample; NO, YES or UNKNOWN.

    NO to all, "otherwise" among them, where one is `IN_PART`: no mode holds all along.

    Args:
        model: `watched`, for these conditions among others. u: (T, .), of its recordings.
    """
    modes = np.full((len(u), len(conditions)), UNKNOWN, np.int8)
    names, in_part = known(model), np.zeros(len(u), bool)
    for c, text in enumerate(conditions):
        if text != OTHERWISE:
            value = u[:, names.index(Condition(text=text).name)]
            # a column that lacks its sample leaves the mode open
            modes[:, c] = np.where(np.isnan(value), UNKNOWN, np.where(value != 0, YES, NO))
            in_part |= value == IN_PART
    if OTHERWISE in conditions:
        c = conditions.index(OTHERWISE)
        others = np.delete(modes, c, 1)
        # one unknown condition leaves "otherwise" unknown too, unless another holds
        modes[(others == NO).all(1), c] = YES
        modes[(others == YES).any(1), c] = NO
    modes[in_part] = NO
    return modes
