"""From a source of recordings to verdicts on a disk: parts, summaries, output folders, fleets."""

from jaxbound.runs.digest import Digest

__all__ = ["Digest"]
