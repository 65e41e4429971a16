"""Arguments of a model that are tables or lists, refused by their names where they are something else."""

from collections.abc import Iterable, Mapping
from typing import TypeVar

__all__ = ["listed_argument", "table_argument"]

Name = TypeVar("Name")
Value = TypeVar("Value")
Element = TypeVar("Element")


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
