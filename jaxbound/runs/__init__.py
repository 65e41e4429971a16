"""From a source of recordings to verdicts on a disk: parts, summaries, output folders, fleets."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxbound.runs.digest import Digest

__all__ = ["Digest"]


def __getattr__(name: str) -> object:
    """Import a public name when it is first asked for: `jaxbound --help` wants the refusals alone."""
    if name != "Digest":
        raise AttributeError(f"module 'jaxbound.runs' has no attribute {name!r}")
    from jaxbound.runs.digest import Digest

    return Digest
