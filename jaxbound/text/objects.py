"""The text of an object at a prompt and its table in a notebook: a few lines, however much it holds.

Arrays are shown by their type and shape; an object of a few numbers is shown whole, as Python would build it.
"""

import dataclasses
import html
from collections.abc import Callable, Mapping
from typing import Any, TypeVar, cast

import numpy as np

from jaxbound.text.characters import printable

Class = TypeVar("Class", bound=type)
Rows = list[tuple[str, str]]

FEW = 8
"""Numbers that are written out."""
ROWS, HEAD, CELL = 12, 300, 110
"""Most rows; most characters of the first line and of another."""


def readable(cls: Class) -> Class:
    """Give a class `__repr__` and `_repr_html_` of at most 2 kB; a decorator above `@dataclass`.

    The class may define its first line, `_head(self)`, and the rows that follow, `_rows(self)`: {label:
    text}. A `__repr__` of its own stays, and is the first line of the table.

    Example:
        >>> @readable
        ... @dataclasses.dataclass
        ... class Found:
        ...     status: np.ndarray
        ...     method: str
        >>> Found(np.zeros(300), "joint")
        Found (300,)
          status: float64 (300,)
          method: 'joint'
    """
    plain = cast(Callable[[object], str], cls.__repr__)
    # dataclasses and named tuples get a `__repr__` made for them: it is not the author's
    has_own = "__repr__" in vars(cls) and not hasattr(plain, "__wrapped__") and not issubclass(cls, tuple)

    def shown(self: object) -> str:
        if has_own:
            return _clipped(plain(self), HEAD)
        whole = _whole_text(self, plain)
        if whole:
            return whole
        lines = [f"  {label}: {text}" for label, text in _further_lines(self)]
        return "\n".join([_first_line(self), *lines])

    def table(self: object) -> str:
        head = _clipped(plain(self), HEAD) if has_own else _first_line(self)
        cells = "".join(map(_table_row, _further_lines(self)))
        return f"<table><caption>{html.escape(head)}</caption><tbody>{cells}</tbody></table>"

    cls.__repr__, cls._repr_html_ = shown, table  # type: ignore[assignment,attr-defined]
    return cls


def _whole_text(thing: object, plain: Callable[[object], str]) -> str:
    """Return the plain text of an object of a few numbers; "" for any other."""
    if hasattr(thing, "_head") or sum(map(_count, _visible_fields(thing).values())) > FEW:
        return ""
    text = plain(thing)
    if len(text) > HEAD or "\n" in text:
        return ""
    return text


def _first_line(thing: object) -> str:
    """Return the first line: the object's own, or its type and the shape of its first array."""
    if hasattr(thing, "_head"):
        return _clipped(thing._head(), HEAD)
    name = type(thing).__name__
    for value in map(_lead, _visible_fields(thing).values()):
        if np.ndim(value):
            return _clipped(f"{name} {np.shape(value)}", HEAD)
    return _clipped(name, HEAD)


def _further_lines(thing: object) -> Rows:
    """Return (label, text) of the rows below the first line."""
    if hasattr(thing, "_rows"):
        rows = thing._rows()
    else:
        rows = {
            label: _in_few_words(value)
            for label, value in _visible_fields(thing).items()
            if not _is_empty(value)
        }
    return [(label, _clipped(text, CELL)) for label, text in list(rows.items())[:ROWS]]


def _table_row(row: tuple[str, str]) -> str:
    label, text = map(html.escape, row)
    return f'<tr><th scope="row">{label}</th><td>{text}</td></tr>'


def _visible_fields(thing: object) -> Mapping[str, Any]:
    """Return {name: value} of an object's visible fields."""
    if dataclasses.is_dataclass(thing):
        return {f.name: getattr(thing, f.name) for f in dataclasses.fields(thing) if f.repr}
    if hasattr(thing, "_asdict"):
        fields: Mapping[str, Any] = thing._asdict()
        return fields
    attributes = getattr(thing, "__dict__", {})
    return {name: value for name, value in attributes.items() if not name.startswith("_")}


def _is_array(value: object) -> bool:
    return hasattr(value, "shape") and hasattr(value, "dtype")


def _is_record(value: object) -> bool:
    return dataclasses.is_dataclass(value) and not isinstance(value, type)


def _lead(value: object) -> Any:
    """Return the array that leads a value: itself, or the first one of a small object; 0 without one."""
    if _is_record(value):
        return next(iter(_visible_fields(value).values()), value)
    if _is_array(value):
        return value
    return 0


def _count(value: object) -> int:
    """Return the number of numbers in a value, or more than a few."""
    if hasattr(value, "shape"):
        return int(np.prod(value.shape, dtype=np.int64))
    if isinstance(value, Mapping):
        return sum(map(_count, value.values()))
    if isinstance(value, list | tuple):
        if len(value) > FEW:
            return len(value)
        return sum(map(_count, value))
    if _is_record(value):
        return sum(map(_count, _visible_fields(value).values()))
    if isinstance(value, str | int | float | None):
        return 1
    return FEW + 1


def _is_empty(value: object) -> bool:
    return value is None or (isinstance(value, str | list | tuple | Mapping) and not len(value))


def _in_few_words(value: Any) -> str:
    """Return a value in a few words."""
    if _is_array(value):
        return _short_array(value)
    if isinstance(value, Mapping):
        return _short_mapping(value)
    if isinstance(value, list | tuple) and not hasattr(value, "_fields"):
        if _count(value) <= FEW:
            return ", ".join(map(_in_few_words, value))
        return f"{len(value)} of {type(value[0]).__name__}"
    if _is_record(value) and not isinstance(value, str):
        lead = _lead(value)
        shape = np.shape(lead) if np.ndim(lead) else ""
        return f"{type(value).__name__} {shape}".strip()
    is_fraction = hasattr(value, "numerator") and hasattr(value, "denominator") and not isinstance(value, int)
    if is_fraction or isinstance(value, float):
        return f"{float(value):.6g}"
    return repr(value)


def _short_array(value: np.ndarray) -> str:
    if not 0 < np.size(value) <= FEW or _is_abstract(value):
        return f"{value.dtype} {tuple(value.shape)}"
    return " ".join(map(_short_number, np.asarray(value).ravel().tolist()))


def _short_number(x: object) -> str:
    if isinstance(x, float):
        return f"{x:.6g}"
    return str(x)


def _short_mapping(value: Mapping[Any, Any]) -> str:
    items = [f"{key} {_in_few_words(x)}" for key, x in list(value.items())[:FEW]]
    if len(value) > FEW:
        items.append(f"... ({len(value)})")
    return ", ".join(items)


def _is_abstract(value: np.ndarray) -> bool:
    """Return whether an array has no numbers yet: inside jit or vmap."""
    try:
        np.asarray(value)
    except Exception:  # whatever a tracer raises, a repr never does
        return True
    return bool(value.dtype == object)


def _clipped(text: str, most: int) -> str:
    text = printable(text.replace("\n", "; "))
    if len(text) <= most:
        return text
    return f"{text[: most - 4]} ..."
