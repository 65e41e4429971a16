"""Recordings as values: signals, time, gaps, what does not count; and where they come from."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxbound.recordings.look import Look

__all__ = ["Look"]


def __getattr__(name: str) -> object:
    """Import a public name when it is first asked for: rooms below read a value without any file."""
    if name != "Look":
        raise AttributeError(f"module 'jaxbound.recordings' has no attribute {name!r}")
    from jaxbound.recordings.look import Look

    return Look
