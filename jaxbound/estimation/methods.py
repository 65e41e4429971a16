"""The table of methods of set observers, and how a method is chosen by name."""

import dataclasses

from jaxbound.estimation.joint import Joint
from jaxbound.estimation.method import ObserverMethod, ShellOption
from jaxbound.estimation.zonotopes import LeastZonotope, WeightedZonotopes

__all__ = ["OBSERVERS", "observer_method", "shell_options"]

OBSERVERS: dict[str, type[ObserverMethod]] = {
    kind.name: kind for kind in (WeightedZonotopes, LeastZonotope, Joint)
}
"""Every method of `observer`, by the name that it has in keywords and on the command line."""
GONE = "constrained"
"""A method of before, whose name is refused with the way on."""


def shell_options() -> list[ShellOption]:
    """Return the options of all methods on the command line."""
    return [option for kind in OBSERVERS.values() for option in kind.shell]


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
        raise ValueError(f"method must be one of {', '.join(OBSERVERS)}, not {method!r}")
    kind = OBSERVERS[method]
    own = {field.name for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    return kind(**{field: value for field, value in given.items() if field in own})
