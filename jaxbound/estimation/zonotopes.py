"""The methods "zonotope" and "strips": sets that are met with one sample after the other."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from jaxbound.estimation.method import ObserverMethod

if TYPE_CHECKING:
    from jaxbound.estimation.set_observer import ObserverSetup, SetObserver

__all__ = ["LeastZonotope", "WeightedZonotopes"]


@dataclass(frozen=True)
class WeightedZonotopes(ObserverMethod):
    """Carry one zonotope for each weight, side by side: the fast method, and the usual one."""

    name: ClassVar[str] = "zonotope"
    about: ClassVar[str] = "fast"

    def observer(self, setup: "ObserverSetup") -> "SetObserver[Any]":
        """Return the observer of this method."""
        from jaxbound.estimation.set_observer import zonotope_observer

        return zonotope_observer(setup)


@dataclass(frozen=True)
class LeastZonotope(ObserverMethod):
    """Carry the zonotope that is least after every sample, whatever weights are asked for."""

    name: ClassVar[str] = "strips"
    about: ClassVar[str] = "one set, least after every sample"

    def observer(self, setup: "ObserverSetup") -> "SetObserver[Any]":
        """Return the observer of this method."""
        from jaxbound.estimation.set_observer import zonotope_observer

        return zonotope_observer(setup._replace(weight=1.0))
