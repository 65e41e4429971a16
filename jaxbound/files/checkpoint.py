"""The checkpoint of a run: with it the same run goes on after a kill, and no other does.

With whatever is kept stands its identity: {what it depends on: text}, from `relations.identity`. A run with
another one is refused.
"""

import json
import zipfile
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TypeVar

import jax
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.files.whole import whole

IDENTITY = "identity"
Tree = TypeVar("Tree")


class Checkpoint:
    """The state of a run: arrays in one file.

    Args:
        path: of the file, which need not exist. identity: {what the run depends on: text}.
    """

    def __init__(self, path: str | PathLike[str], identity: Mapping[str, str]) -> None:
        self.path, self.identity = Path(path), identity

    def load(self) -> dict[str, np.ndarray] | None:
        """Return {name: array} as it was saved last, None if nothing was.

        Raises:
            ValueError: the file is damaged, or of a run that depends on something else.
        """
        if not self.path.exists():
            return None
        try:
            with open(self.path, "rb") as file, np.load(file, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files}
            before = json.loads(str(arrays.pop(IDENTITY, "{}")))
        except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as e:
            why = f"is damaged, or no state of jaxbound ({type(e).__name__})"
            raise ValueError(f"{self.path} {why}: choose another place, or delete it to begin anew") from None
        refuse_other(self.path, before, self.identity)
        return arrays

    def save(self, **arrays: ArrayLike) -> None:
        """Write arrays, completely or not at all, in the place of those from before."""
        identity = {IDENTITY: np.array(json.dumps(dict(self.identity)))}
        with whole(self.path, links=False) as file:
            np.savez(file, **(arrays | identity))  # type: ignore[arg-type]  # its last option is no array


def as_texts(state: object) -> list[str]:
    """Return the arrays of a PyTree as texts, fit for JSON."""
    return [np.asarray(x).tobytes().hex() for x in jax.tree.leaves(state)]


def from_texts(empty: Tree, texts: Sequence[str]) -> Tree:
    """Return the PyTree that `as_texts` wrote. empty: one of the same shapes and types."""
    leaves, tree = jax.tree.flatten(empty)
    read: list[np.ndarray] = []
    for leaf, text in zip(leaves, texts, strict=True):
        like = np.asarray(leaf)
        read.append(np.frombuffer(bytes.fromhex(text), like.dtype).reshape(like.shape))
    restored: Tree = jax.tree.unflatten(tree, read)
    return restored


def refuse_other(path: str | PathLike[str], before: object, now: Mapping[str, str]) -> None:
    """Raise ValueError if the identity kept in a file is not that of the run that is to go on there."""
    changed = differences(before, now)
    if changed:
        raise ValueError(f"{path} is of another {changed}: choose another place, or delete it to begin anew")


def differences(before: object, now: Mapping[str, str]) -> str:
    """Return the names of all entries in which two identities differ, as text; empty where they are the same.

    Anything that is no identity differs in all.
    """
    old = before if isinstance(before, dict) else {}
    return " and ".join(name for name in now if old.get(name) != now[name])
