"""The one fingerprint of a model, and of whatever else decides verdicts: what was kept is taken up by nothing
else.

A field that is forgotten lets the state of one model be taken up by another, so nothing is listed here: all
fields of a thing count.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from fractions import Fraction

import jax
import numpy as np

from jaxbound.models.system import LinearSystem


def fingerprint(*things: object) -> str:
    """Return a text that differs where any of the things differs, exactly: a model in any field, an array in
    type, shape or an entry.

    Args:
        things: LinearSystems, dataclasses, arrays, numbers, texts, and tuples, lists and dicts of them.

    Raises:
        TypeError: anything else, of which nobody knows what it depends on.

    Example:
        >>> plain = LinearSystem([["1/3"]], None, [[1]], noise="0.1")
        >>> louder = LinearSystem([["1/3"]], None, [[1]], noise="0.10000000000000000001")
        >>> fingerprint(plain) == fingerprint(plain), fingerprint(plain) == fingerprint(louder)
        (True, False)
    """
    digest = hashlib.sha256()
    for piece in _bytes_of(things):
        digest.update(b"%d:" % len(piece))  # no two sequences of pieces run together
        digest.update(piece)
    return digest.hexdigest()


def _bytes_of(x: object) -> Iterator[bytes]:
    """Yield the parts of a thing as bytes."""
    if isinstance(x, np.generic):
        x = x.item()
    if x is None or isinstance(x, bool | int | float | complex | str | Fraction):
        yield f"{type(x).__name__} {x!r}".encode()
    elif isinstance(x, np.ndarray | jax.Array):
        x = np.asarray(x)
        yield f"array {x.dtype} {x.shape}".encode()
        if x.dtype == object:
            yield from _bytes_of(x.tolist())
        else:
            yield x.tobytes()
    elif isinstance(x, tuple | list):
        yield f"{len(x)} things".encode()
        for entry in x:
            yield from _bytes_of(entry)
    elif isinstance(x, dict):
        yield f"{len(x)} names".encode()
        for name in sorted(x):
            yield from _bytes_of((name, x[name]))
    elif isinstance(x, LinearSystem):
        compared = [getattr(x, f.name) for f in fields(LinearSystem)]  # by equality
        yield from _bytes_of(("LinearSystem", compared))
    elif is_dataclass(x) and not isinstance(x, type):
        yield from _bytes_of((type(x).__name__, [(f.name, getattr(x, f.name)) for f in fields(x)]))
    else:
        raise TypeError(f"there is no fingerprint of a {type(x).__name__}")
