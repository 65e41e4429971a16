"""Arguments of a model that are tables or lists, refused by their names where they are something else."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

from jaxbound.models.numbers import is_whole

Name = TypeVar("Name")
Value = TypeVar("Value")
Element = TypeVar("Element")
Function = TypeVar("Function", bound=Callable[..., object])


def taking_fields(value: type[Any]) -> Callable[[Function], Function]:
    """Show the fields of a dataclass as the keywords that a function takes by its `**fields`.

    Example:
        >>> from dataclasses import make_dataclass
        >>> shown = taking_fields(make_dataclass("Way", ["order"]))(lambda x, **fields: x)
        >>> str(inspect.signature(shown))
        "(x, *, order: 'typing.Any')"
    """

    def shown(function: Function) -> Function:
        *own, _ = inspect.signature(function).parameters.values()
        names = {parameter.name for parameter in own}
        fields = inspect.signature(value).parameters.values()
        rare = [field.replace(kind=field.KEYWORD_ONLY) for field in fields if field.name not in names]
        # help, notebooks and editors that ask at run time read this
        function.__signature__ = inspect.Signature([*own, *rare])  # type: ignore[attr-defined]
        return function

    return shown


def table_argument(field: str, given: Mapping[Name, Value] | None, like: str) -> dict[Name, Value]:
    """Return a table as a dict, empty where it is left out.

    Raises:
        ValueError: something else, with an example of what is meant.

    Example:
        >>> table_argument("units", {"T": "degC"}, "{'T': 'degC'}"), table_argument("units", None, "")
        ({'T': 'degC'}, {})
    """
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise ValueError(f"{field} must be a table, like {like}, not {given!r}")
    return dict(given)


def listed_argument(field: str, given: Iterable[Element], like: str) -> tuple[Element, ...]:
    """Return the elements of a list.

    Raises:
        ValueError: something that has none, or a text, with an example of what is meant.

    Example:
        >>> listed_argument("lags", [0, 1, 4], "[0, 1, 4]")
        (0, 1, 4)
    """
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise ValueError(f"{field} must be a list, like {like}, not {given!r}")
    return tuple(given)


def whole_horizon(horizon: object, field: str = "horizon") -> int | None:
    """Return the horizon of a window, None where none is stated.

    Raises:
        ValueError: it is no whole number >= 0.
    """
    if horizon is None:
        return None
    if not is_whole(horizon) or horizon < 0:
        raise ValueError(f"{field} must be a whole number >= 0, not {horizon!r}")
    return int(horizon)


def whole_lags(lags: Sequence[int], field: str = "lags") -> tuple[int, ...]:
    """Return the lags of a window in order.

    Raises:
        ValueError: they are not different whole numbers >= 0, or 0 is not among them.
    """
    lags = listed_argument(field, lags, "[0, 1, 4]")
    whole = all(is_whole(x) and x >= 0 for x in lags)
    if not whole or len(set(lags)) < len(lags) or 0 not in lags:
        raise ValueError(f"{field} must be different whole numbers >= 0, 0 among them, not {list(lags)!r}")
    return tuple(sorted(map(int, lags)))
