"""Names in sentences: the first few of many, and no name without end."""

from collections.abc import Callable, Iterable, Sequence

FEW, LONG = 12, 80


def quoted(name: str) -> str:
    """Return a name in quotes, of a very long one its beginning and its length."""
    name = str(name)
    if len(name) <= LONG:
        return repr(name)
    return f"{name[:LONG]!r} .. ({len(name)} characters)"


def listed(names: Iterable[str], each: Callable[[str], str] = quoted) -> str:
    """Return names for a sentence: all, or the first few and how many there are.

    Args:
        names: the names. each: the function that writes one of them.

    Example:
        >>> listed(["a", "b"]), listed([f"c{i}" for i in range(100)], str)
        ("'a', 'b'", 'c0, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10, c11 and 88 more')
    """
    names = list(names)
    if len(names) <= FEW + 1:  # "and 1 more" would be no shorter than the name
        return ", ".join(map(each, names))
    return f"{', '.join(map(each, names[:FEW]))} and {len(names) - FEW} more"


def one_of(choices: Sequence[str]) -> str:
    """Return choices of which one holds, so that nobody takes them for a list of all that is wrong.

    Example:
        >>> one_of([]), one_of(["T1 by 2 degC"]), one_of(["T1 by 2 degC", "T2 by 3 degC", "Q"])
        ('', 'T1 by 2 degC', 'either T1 by 2 degC, or T2 by 3 degC, or Q')
    """
    if len(choices) < 2:
        return "".join(choices)
    return f"either {', or '.join(choices)}"
