"""Live sources: a function in a Python file that yields recordings as they come, from a broker or a device.

    # plant.py
    def readings(model):
        for message in subscribe("plant/1"):
            yield {"time": [message.time], "u1": [message.u], "y1": [message.y]}

`jaxbound detect model.toml plant.py:readings` judges them as they come. What is yielded is anything that
`Recording.of` takes for one sample or many: a Recording, a table, a dict of columns. In Python the same
generator needs no more than `for piece in readings(model): state, verdicts = monitor.run(state, piece)`; and
one that ends is a recording: `detect(relations, read(readings(model), model))`.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import reduce
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np

from jaxbound.recordings.expressions import TIME_SINCE_START
from jaxbound.recordings.means import every_of
from jaxbound.recordings.meansource import means_source
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.recordings.seams import check_period
from jaxbound.recordings.selection import counted_from_start, looks_back
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.source import Progress, Source
from jaxbound.recordings.stream import Complain, Stream, Taken, digests_of

NAMED = re.compile(r"(.+\.py):([A-Za-z_]\w*)")


class LiveSource(Source):
    """A function that yields recordings, named as `file.py:function`, or an iterator of them.

    The file is run as Python runs a script that is imported: it is the user's own.
    """

    live = True

    @classmethod
    def takes(cls, data: object) -> bool:
        """Return whether data are an iterator, or the name of a function in a file that is there."""
        if isinstance(data, Iterator):
            return True
        if not isinstance(data, str):
            return False
        named = NAMED.fullmatch(data)
        return named is not None and Path(named[1]).is_file()

    @property
    def label(self) -> str:
        """The name of the function; of an iterator its kind."""
        if isinstance(self.data, str):
            return self.data
        return type(self.data).__name__

    def stream(
        self, complain: Complain, memory: dict[str, Any] | None = None, taken: Taken | None = None
    ) -> "Readings":
        """Return the Stream of the readings of the function, behind a memory. taken: see `Stream`."""
        if isinstance(self.data, Iterator):
            return Readings(self.model, self.data, complain, memory, taken)
        named = NAMED.fullmatch(str(self.data))
        assert named is not None, "the name was taken"
        function = run_path(named[1], run_name=Path(named[1]).stem).get(named[2])
        if not callable(function):
            raise ValueError(f"{named[1]} has no function {named[2]}")
        return Readings(self.model, function(self.model), complain, memory, taken)

    def whole(self, progress: Progress | None = None) -> Recording:
        """Return all readings of the function as one Recording, or their means; it has to end."""
        if every_of(self.model) is not None:
            return means_source(LiveSource, self.data, self.model).whole(progress)
        stream = self.stream(lambda kind, sentence: None)
        pieces = [piece for _, piece in stream.pieces(stream.raw) if piece.samples]
        if not pieces:
            raise ValueError("there is no reading: a recording has at least two samples")
        whole = reduce(Recording.followed, pieces)
        return replace(whole, stamps=whole.dates, hints=())


class Readings(Stream):
    """A stream of recordings.

    Args:
        model: whose signals are wanted. readings: what `Recording.of` takes, again and again, in order of
            time. complain, memory, taken: as for `PipeText`.
    """

    def __init__(
        self,
        model: SignalModel,
        readings: Iterable[Any],
        complain: Complain = lambda kind, sentence: None,
        memory: dict[str, Any] | None = None,
        taken: Taken | None = None,
    ) -> None:
        super().__init__(model, complain, taken)
        if counted_from_start(model):
            raise ValueError(
                f"{TIME_SINCE_START} is of a file or a pipe: a reading does not tell when others began"
            )
        if looks_back(model):
            raise ValueError(
                f"{looks_back(model)!r} is of a file or a pipe: a reading alone has no row before"
            )
        self.raw = iter(readings)
        self.resumed = memory is not None
        if memory is not None:
            self._resume_clock(memory)

    def memory(self) -> dict[str, Any] | None:
        """Return the memory of the clock; None before the first sample."""
        if not self.clock.samples:
            return None
        return self._clock_memory()

    def when(self, piece: Recording, k: int) -> str | float:
        """Return the time of a sample in s, since 1970 where there are dates."""
        assert piece.time is not None, "a piece of this stream has times"
        return float(piece.time[k])

    def take(self, arrival: object) -> Recording | None:
        """Return the samples of a reading that were not judged before, with the seams before and in them.

        Raises:
            ValueError: a reading that is no recording of this model.
        """
        piece = Recording.of(self.model, arrival, regular=False)
        counted = piece.time is None
        time = self._times(piece)
        digests = digests_of([time, *np.transpose(piece.u), *np.transpose(piece.y)])
        if self.resumed and not counted:
            old = self.old_ones(digests, time, lambda k: f"a reading at {self.label(time[k])}")
            piece, time, digests = piece.cut(old, piece.samples), time[old:], digests[old:]
        if not piece.samples:
            return None
        self.taken.add(digests)
        starts = [NOWHERE]
        if self.regular:
            check_period(time, self.dt)
            starts = [piece.starts]
        elif counted:
            raise ValueError("a reading has no times: means over intervals need a column of times")
        if self.resumed and counted:
            self.complain("replay", "no time says whether samples were lost between: windows begin anew")
            starts.append(np.zeros(1, np.int64))
        self.resumed = False
        starts += self.seams(time, piece.excluded)
        return replace(piece, time=time, origin=0.0, starts=np.unique(np.concatenate(starts)))

    def _times(self, piece: Recording) -> np.ndarray:
        """Return the times of samples in s, counted from one instant in all pieces."""
        if piece.time is None:
            return (self.clock.samples + np.arange(piece.samples)) * self.dt
        if np.isnan(piece.origin):
            return np.asarray(piece.time, float)
        return piece.origin + np.asarray(piece.time, float)
