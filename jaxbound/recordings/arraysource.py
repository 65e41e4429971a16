"""Arrays and tables in memory as a source, so that what takes a file takes them too."""

from os import PathLike

from jaxbound.recordings.recording import Recording
from jaxbound.recordings.source import Progress, Source

__all__ = ["Arrays"]


class Arrays(Source):
    """A table or a Recording that holds both inputs and outputs, or a tuple (u, y) or (u, y, starts)."""

    label = "recording"

    @classmethod
    def takes(cls, data: object) -> bool:
        """Return whether data are no path."""
        return not isinstance(data, str | PathLike)

    @classmethod
    def digest(cls, data: object) -> None:
        """Return None: nothing on a disk will be the same later."""
        return None

    def whole(self, progress: Progress | None = None) -> Recording:
        """Return the Recording."""
        if isinstance(self.data, tuple):
            return Recording.of(self.model, *self.data)
        return Recording.of(self.model, self.data)
