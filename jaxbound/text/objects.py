"""How an object shows itself: a few lines at a prompt and a small table in a notebook, whatever it holds.

Arrays are told by their type and shape; an object of a few numbers is told whole, as Python would build it.
"""

import dataclasses
import html
from collections.abc import Mapping
from typing import TypeVar

import numpy as np

from jaxbound.text.characters import printable

__all__ = ["readable"]

Class = TypeVar("Class", bound=type)
FEW, ROWS, HEAD, CELL = (
    8,
    12,
    300,
    110,
)  # numbers told whole; lines; characters of the first line and of another


def readable(cls: Class) -> Class:
    """Give a class `__repr__` and `_repr_html_` of at most 2 kB; a decorator above `@dataclass`.

    The class may say what its first line is, `_head(self)`, and what follows, `_rows(self)`: {label: text}. A
    `__repr__` of its own stays, and is the first line of the table.

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
    plain = cls.__repr__
    own = (
        "__repr__" in vars(cls) and not hasattr(plain, "__wrapped__") and not issubclass(cls, tuple)
    )  # not the one that is made for it

    def told(self):
        return _told(self, plain, own)

    def shown(self):
        head, rows, whole = told(self)
        return (
            whole
            or (head if own else "")
            or "\n".join((head, *(f"  {label}: {text}" for label, text in rows)))
        )

    def table(self):
        head, rows, whole = told(self)
        cells = "".join(
            f'<tr><th scope="row">{html.escape(label)}</th><td>{html.escape(text)}</td></tr>'
            for label, text in rows
        )
        return f"<table><caption>{html.escape(head)}</caption><tbody>{cells}</tbody></table>"

    cls.__repr__, cls._repr_html_ = shown, table  # type: ignore[assignment,attr-defined]
    return cls


def _told(thing, plain, own):
    """Return (first line, [(label, text)], the whole text if it is short)."""
    parts = _parts(thing)
    whole = ""
    if not own and not hasattr(thing, "_head") and sum(map(_count, parts.values())) <= FEW:
        text = plain(thing)
        whole = text if len(text) <= HEAD and "\n" not in text else ""
    if own:
        head = plain(thing)
    elif hasattr(thing, "_head"):
        head = thing._head()
    else:
        shape = next((np.shape(value) for value in map(_lead, parts.values()) if np.ndim(value)), "")
        head = f"{type(thing).__name__} {shape}".strip()
    rows = (
        thing._rows()
        if hasattr(thing, "_rows")
        else {label: _short(value) for label, value in parts.items() if not _empty(value)}
    )
    lines = [(label, _clipped(text, CELL)) for label, text in list(rows.items())[:ROWS]]
    return _clipped(head, HEAD), lines, whole


def _parts(thing):
    """Return {name: value} of what an object holds and would show."""
    if dataclasses.is_dataclass(thing):
        return {f.name: getattr(thing, f.name) for f in dataclasses.fields(thing) if f.repr}
    if isinstance(thing, tuple) and hasattr(thing, "_asdict"):
        return thing._asdict()
    return {name: value for name, value in getattr(thing, "__dict__", {}).items() if not name.startswith("_")}


def _lead(value):
    """Return the array that a value is led by: itself, or the first one of a small object."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return next(iter(_parts(value).values()), value)
    return value if hasattr(value, "shape") and hasattr(value, "dtype") else 0


def _count(value):
    """Return how many numbers an object holds, or more than a few."""
    if hasattr(value, "shape"):
        return int(np.prod(value.shape, dtype=np.int64))
    if isinstance(value, Mapping):
        return sum(map(_count, value.values()))
    if isinstance(value, list | tuple):
        return sum(map(_count, value)) if len(value) <= FEW else len(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return sum(map(_count, _parts(value).values()))
    return 1 if isinstance(value, str | int | float | None) else FEW + 1


def _empty(value):
    return value is None or (isinstance(value, str | list | tuple | Mapping) and not len(value))


def _short(value):
    """Return a value in a few words."""
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        if 0 < np.size(value) <= FEW and not _abstract(value):
            return " ".join(
                f"{x:.6g}" if isinstance(x, float) else str(x) for x in np.asarray(value).ravel().tolist()
            )
        return f"{value.dtype} {tuple(value.shape)}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_short(x)}" for key, x in list(value.items())[:FEW]) + (
            f", ... ({len(value)})" if len(value) > FEW else ""
        )
    if isinstance(value, list | tuple) and not hasattr(value, "_fields"):
        return (
            ", ".join(map(_short, value))
            if _count(value) <= FEW
            else f"{len(value)} of {type(value[0]).__name__}"
        )
    if dataclasses.is_dataclass(value) and not isinstance(value, type) and not isinstance(value, str):
        lead = _lead(value)
        return f"{type(value).__name__} {np.shape(lead) if np.ndim(lead) else ''}".strip()
    if hasattr(value, "numerator") and hasattr(value, "denominator") and not isinstance(value, int):
        return f"{float(value):.6g}"
    return f"{value:.6g}" if isinstance(value, float) else repr(value)


def _abstract(value):
    """Say whether an array has no numbers yet: inside jit or vmap."""
    try:
        np.asarray(value)
    except Exception:  # whatever a tracer raises, a repr never does
        return True
    return value.dtype == object


def _clipped(text, most):
    text = printable(text.replace("\n", "; "))
    return text if len(text) <= most else f"{text[: most - 4]} ..."
