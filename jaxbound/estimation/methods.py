"""The methods of set observers: the options of each as a frozen value, their words for the command line, and
how one is chosen by name.

A command line builds its options from this file before anything is computed: it imports nothing heavy.
"""

import dataclasses
import html
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from jaxbound.estimation.set_observer import SetObserver, ZonotopeObserver


class ObserverMethod(ABC):
    """A way to observe: options that are checked when they are given, and the observer that they make.

    A new method is a frozen dataclass of this kind, and an entry of `OBSERVERS`. Its fields are its options.

    name: of `observer(model, method=name)` and of the command line. about: a few words for the help.
    sharp: whether it tests windows of samples together, which sees smaller faults than zonotopes do.
    """

    name: ClassVar[str]
    about: ClassVar[str]
    sharp: ClassVar[bool] = False

    def _repr_html_(self) -> str:
        return f"<code>{html.escape(repr(self))}</code>"

    @abstractmethod
    def observer(self, zonotopes: "ZonotopeObserver") -> "SetObserver[Any]":
        """Return the observer of this method, of the choices that all methods share: those of an observer
        that carries zonotopes.
        """


@dataclass(frozen=True)
class WeightedZonotopes(ObserverMethod):
    """Carry one zonotope for each weight, side by side: the fast method, and the usual one."""

    name: ClassVar[str] = "zonotope"
    about: ClassVar[str] = "fast"

    def observer(self, zonotopes: "ZonotopeObserver") -> "SetObserver[Any]":
        """Return the observer of this method."""
        return zonotopes


@dataclass(frozen=True)
class LeastZonotope(ObserverMethod):
    """Carry the zonotope that is least after every sample, whatever weights are asked for."""

    name: ClassVar[str] = "strips"
    about: ClassVar[str] = "one set, least after every sample"

    def observer(self, zonotopes: "ZonotopeObserver") -> "SetObserver[Any]":
        """Return the observer of this method."""
        return dataclasses.replace(zonotopes, weights=zonotopes.weights[:1] ** 0)


WINDOW, SHORTEST = 32, 4
"""Samples of a window of "joint": the usual number, the least."""


@dataclass(frozen=True)
class Joint(ObserverMethod):
    """Test every window of up to `window` samples exactly, beside zonotopes.

    Fields: window: samples, even and at least 4.

    Raises:
        ValueError: another window.
    """

    window: int = WINDOW

    name: ClassVar[str] = "joint"
    about: ClassVar[str] = "exact tests of windows that remember: slow faults, some hundred times slower"
    sharp: ClassVar[bool] = True

    def __post_init__(self) -> None:
        from jaxbound.models.numbers import is_whole

        if not is_whole(self.window) or self.window < SHORTEST or self.window % 2:
            raise ValueError(f"window must be an even number of samples >= 4, not {self.window!r}")

    def observer(self, zonotopes: "ZonotopeObserver") -> "SetObserver[Any]":
        """Return the observer of this method."""
        from jaxbound.estimation.joint_observer import joint_observer

        return joint_observer(zonotopes, int(self.window))


OBSERVERS: dict[str, type[ObserverMethod]] = {
    kind.name: kind for kind in (WeightedZonotopes, LeastZonotope, Joint)
}
"""Every method of `observer`, by the name that it has in keywords and on the command line."""
GONE = "constrained"
"""A method of before, whose name is refused with the way on."""


def observer_method(method: str | ObserverMethod, **options: int | None) -> ObserverMethod:
    """Return the options of a method that is given by its name and keywords.

    Args:
        method: a name, or options as they are.
        options: fields of any of the methods; those of other methods, and None, say nothing.

    Raises:
        ValueError: an unknown method, an option that its method refuses, keywords beside options.
    """
    if method == GONE:
        raise ValueError(
            f'{GONE!r} is no method any more, "joint" sees at least as much: observer(model, method="joint")'
        )
    given = {field: value for field, value in options.items() if value is not None}
    if isinstance(method, ObserverMethod):
        if given:
            raise ValueError(f"{', '.join(given)} belongs to a method given by name: {method!r} says it")
        return method
    if not isinstance(method, str) or method not in OBSERVERS:
        raise ValueError(f"an observer is one of {', '.join(OBSERVERS)}, not {method!r}")
    kind = OBSERVERS[method]
    own = {field.name for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    return kind(**{field: value for field, value in given.items() if field in own})
