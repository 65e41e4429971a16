"""What a run keeps so that the same run goes on after a kill, and no other does.

With whatever is kept stands its identity: {what it depends on: text}, from `relations.identity`. A run with
another one is refused.
"""

import json
import zipfile
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxbound.recordings.whole import whole

__all__ = ["Checkpoint", "as_texts", "differences", "from_texts", "refuse_other"]

IDENTITY = "identity"


class Checkpoint:
    """The state of a run: arrays in one file.

    Args:
        path: of the file, which need not exist. identity: {what the run depends on: text}.
    """

    def __init__(self, path: str | PathLike, identity: Mapping[str, str]) -> None:
        self.path, self.identity = Path(path), identity

    def load(self) -> dict[str, np.ndarray] | None:
        """Return {name: array} as it was saved last, None if nothing was.

        Raises:
            ValueError: the file is damaged, or of a run that depends on something else.
        """
        if not self.path.exists():
            return None
        try:
            with open(self.path, "rb") as file, np.load(file, allow_pickle=False) as kept:
                arrays = {name: kept[name] for name in kept.files}
            before = json.loads(str(arrays.pop(IDENTITY, "{}")))
        except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as e:
            why = f"is damaged, or no state of jaxbound ({type(e).__name__})"
            raise ValueError(f"{self.path} {why}: choose another place, or delete it to begin anew") from None
        refuse_other(self.path, before, self.identity)
        return arrays

    def save(self, **arrays: Any) -> None:
        """Write arrays, completely or not at all, in the place of those from before."""
        with whole(self.path, links=False) as f:
            np.savez(f, **(arrays | {IDENTITY: np.array(json.dumps(self.identity))}))


def as_texts(state: Any) -> list[str]:
    """Return the arrays of a PyTree as texts, fit for JSON."""
    return [np.asarray(x).tobytes().hex() for x in jax.tree.leaves(state)]


def from_texts(empty: Any, texts: Sequence[str]) -> Any:
    """Return the PyTree that `as_texts` wrote. empty: one of the same shapes and types."""
    leaves, tree = jax.tree.flatten(empty)
    read = lambda old, text: np.frombuffer(bytes.fromhex(text), np.asarray(old).dtype).reshape(np.shape(old))
    return jax.tree.unflatten(tree, list(map(read, leaves, texts)))


def refuse_other(path: str | PathLike, before: Any, now: Mapping[str, str]) -> None:
    """Raise ValueError if what is kept in a file is of another identity than what is to go on there."""
    if changed := differences(before, now):
        raise ValueError(f"{path} is of another {changed}: choose another place, or delete it to begin anew")


def differences(before: Any, now: Mapping[str, str]) -> str:
    """Return what two identities differ in, as text; empty where they are the same. What is no identity
    differs in all.
    """
    before = before if isinstance(before, dict) else {}
    return " and ".join(what for what in now if before.get(what) != now[what])
