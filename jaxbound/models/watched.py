"""A model whose recordings carry, behind the inputs, all that the tests of a monitor read of them."""

from collections.abc import Sequence
from functools import cached_property

from jaxbound.models.statedtests import OTHERWISE
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.factors import Condition, Factor, factors_of
from jaxbound.recordings.signals import SignalModel

__all__ = ["WatchedSystem", "watched"]


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
    same = WatchedSystem.__new__(WatchedSystem)
    vars(same).update(vars(model), carried=columns, factors=columns)
    return same
