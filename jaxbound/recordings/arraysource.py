"""Arrays and tables in memory as a source, so that what takes a file takes them too."""

from collections.abc import Callable
from os import PathLike

from jaxbound.recordings.recording import Recording
from jaxbound.recordings.source import Source

__all__ = ["Arrays"]


class Arrays(Source):
    """What `Recording.of` takes: a table or a Recording that holds both inputs and outputs, or a tuple (u, y)
    or (u, y, starts).
    """

    label = "recording"

    @classmethod
    def takes(cls, data: object) -> bool:
        """Return whether data are no path."""
        return not isinstance(data, str | PathLike)

    @classmethod
    def digest(cls, data: object) -> None:
        """Return None: nothing on a disk will be the same later."""
        return None

    def whole(self, progress: Callable | None = None) -> Recording:
        """Return the Recording."""
        parts = self.data if isinstance(self.data, tuple) else (self.data,)
        return Recording.of(self.model, *parts)
