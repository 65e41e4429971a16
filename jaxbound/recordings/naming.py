"""Names in sentences: the first few of many, and no name without end."""

from collections.abc import Callable, Iterable

__all__ = ["listed", "shown"]

FEW, LONG = 12, 80


def listed(names: Iterable[str], each: Callable[[str], str] | None = None) -> str:
    """Return names for a sentence: all, or the first few and how many there are.

    Args:
        names: a sequence of names. each: how one is written; None: in quotes.

    Example:
        >>> listed(["a", "b"]), listed([f"c{i}" for i in range(100)], str)
        ("'a', 'b'", 'c0, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10, c11 and 88 more')
    """
    names, each = list(names), each or shown
    more = f" and {len(names) - FEW} more" if len(names) > FEW + 1 else ""
    return ", ".join(map(each, names[:FEW] if more else names)) + more


def shown(name: str) -> str:
    """Return a name in quotes, of a very long one its beginning and its length."""
    name = str(name)
    return repr(name) if len(name) <= LONG else f"{name[:LONG]!r} .. ({len(name)} characters)"
