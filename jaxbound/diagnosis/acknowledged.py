"""The times at which an operator acknowledged the alarms that were open: a list, or a file that grows."""

import os
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TypeAlias

import numpy as np

from jaxbound.recordings.timestamps import instant_of

Times: TypeAlias = str | os.PathLike[str] | Sequence[str | float | datetime | np.datetime64]
"""Times, or the path of a file with one a line."""


class Acknowledged:
    """The times of acknowledgements.

    A line of a file begins with its time; what follows a comma is the operator's own. Blank lines and those
    that begin with # are none, and a line counts once its end is written.

    Args:
        given: see `Times`.

    Fields: path: of the file, None: there is none. troubles: {line that is no time: why}.

    Raises:
        ValueError: something in the list that is no time.
    """

    def __init__(self, given: Times) -> None:
        self.path: Path | None = None
        self.troubles: dict[str, str] = {}
        self.known = np.zeros(0)
        self.seen: tuple[int, ...] = ()  # size, time and number of the file as it was read
        self.read: dict[str, float] = {}  # the instants of lines
        if isinstance(given, str | os.PathLike):
            self.path = Path(given)
        else:
            self.known = np.unique(list(map(instant_of, given)))

    @property
    def is_given(self) -> bool:
        """Whether there may be acknowledgements."""
        return self.path is not None or bool(len(self.known))

    def instants(self) -> np.ndarray:
        """Return the times in s, ascending, as `Recording.instants` counts them; of a file as it is now."""
        if self.path is None:
            return self.known
        try:
            about = self.path.stat()
            seen = about.st_size, about.st_mtime_ns, about.st_ino
            if seen != self.seen:
                self._read(self.path.read_bytes())
                self.seen = seen
        except OSError:  # it is being replaced: what was acknowledged stays so
            pass
        return self.known

    def between(self, low: float, high: float) -> list[float]:
        """Return the last time before `low`, and all from there to `high`."""
        instants = self.instants()
        first = max(int(np.searchsorted(instants, low)) - 1, 0)
        return list(instants[first : np.searchsorted(instants, high, "right")].tolist())

    def check(self) -> None:
        """Raise ValueError for a file that is not there, or has a line that is no time or has no end."""
        if self.path is None:
            return
        if not self.path.is_file():
            raise ValueError(
                f"acknowledgements: {str(self.path)!r} is no file: make an empty one, or give a list of times"
            )
        self.instants()
        if self.path.read_bytes()[-1:] not in (b"", b"\n"):
            raise ValueError(f"{self.path}: the last line has no end, by which it counts: end it")
        for trouble in self.troubles.values():
            raise ValueError(trouble)

    def _read(self, data: bytes) -> None:
        """Take the complete lines of a file."""
        instants = []
        for line in data[: data.rfind(b"\n") + 1].decode(errors="replace").splitlines():
            text = line.split(",")[0].strip()
            if not text or text.startswith("#"):
                continue
            if text not in self.read and line not in self.troubles:
                try:
                    self.read[text] = instant_of(text)
                except ValueError as e:
                    self.troubles[line] = f"{self.path}: a line begins with no time: {e}"
            if text in self.read:
                instants.append(self.read[text])
        self.known = np.unique(np.array(instants, float))
