"""The judges of the loop: by windows, an observer, a Monitor, a test in memory, or a look at verdicts."""

import itertools
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import ClassVar, Generic, TypeVar, cast

import jax
import numpy as np

from jaxbound.consistency.claims import CLAIMED, placed
from jaxbound.consistency.interface import Judged, Observer, Relations
from jaxbound.consistency.interface import Verdicts as OfObserver
from jaxbound.consistency.monitor import Monitor
from jaxbound.diagnosis.result import Result
from jaxbound.files.checkpoint import as_texts, from_texts
from jaxbound.models.region import Region
from jaxbound.recordings.factors import known
from jaxbound.recordings.recording import Recording
from jaxbound.runs.loop import Laps, Memory
from jaxbound.runs.sink import Verdicts
from jaxbound.sets.floats.kernel import compiles_later, sparing
from jaxbound.sets.floats.threads import inherited

AHEAD = 5.0
"""Seconds behind which samples that still come are those of a live stream."""
Numbered = tuple[int, Recording]
"""A piece of a recording: the number of its first sample, and its samples."""
Piece = TypeVar("Piece")
State = TypeVar("State")
"""The carry of an observer."""


class Windows:
    """The judge of the windows that end in a piece; they reach back into the piece before.

    Fields: overlap: so many samples of it are needed. begins: and of those before the first piece.

    Args:
        test: of a Recording. horizon: of its windows. done: so many samples are judged already. laps: gets
            the seconds of the stage "transfer".
    """

    remembers: ClassVar[bool] = False

    def __init__(self, test: Callable[[Recording], Result], horizon: int, done: int, laps: Laps) -> None:
        self.test, self.done = test, done
        self.overlap = self.begins = horizon
        self.laps = laps

    def __call__(self, piece: Numbered) -> Iterator[tuple[Recording, Verdicts]]:
        """Judge the samples that are new in a piece."""
        first, recording = piece
        with sparing(False):  # the same bytes however the recording is cut
            result = self.test(on_device(recording, self.laps))
        fresh = slice(self.done - first, recording.samples)
        self.done = first + recording.samples
        yield recording.cut(fresh.start, fresh.stop), result.judged(fresh)

    def memory(self) -> None:
        """Return None: windows carry nothing."""


class Carried(Generic[State]):
    """The judge of the samples of a piece by an observer, part by part.

    Fields: overlap: the sample before says whether the first one follows it.

    Args:
        observer, carry: the observer and its carry. size: of a part, in samples. done: so many samples are
            judged already. laps: as for `Windows`. warm: samples before the first part that it is given, in
            the first piece; None: it goes on with the carry. outside: as of `detect`.
    """

    remembers: ClassVar[bool] = True
    overlap: int = 1

    def __init__(
        self,
        observer: Observer[State],
        carry: State,
        size: int,
        done: int,
        laps: Laps,
        warm: int | None = None,
        outside: str = CLAIMED,
    ) -> None:
        self.observer, self.carry, self.size, self.done, self.warm = observer, carry, size, done, warm
        self.begins = max(warm or 0, self.overlap)
        self.laps, self.outside, self.region = laps, outside, Region.of(observer)
        if self.region is not None:
            self.overlap = max(self.overlap, self.region.horizon)
            self.begins = max(self.begins, self.overlap)

    def __call__(self, piece: Numbered) -> Iterator[tuple[Recording, Verdicts]]:
        """Judge the samples that are new in a piece, those of each part by themselves."""
        first, recording = piece
        _, given = self.observer.recording(on_device(recording, self.laps))
        stop = first + recording.samples
        if self.warm and self.done > first:
            self._follow(given.cut(max(self.done - self.warm - first, 0), self.done - first))
        self.warm = None
        # each part by itself: its bytes are the same whichever pieces it came in
        edges = [self.done, *range((self.done // self.size + 1) * self.size, stop, self.size), stop]
        for begin, end in itertools.pairwise(edges):
            found = self._follow(given.cut(begin - first, end - first))
            self.done = end
            verdicts = _judged(self.observer, found)
            before = max(begin - first - self.overlap, 0)  # windows of the first sample reach back so far
            u = np.asarray(recording.u)[before : end - first]
            verdicts = placed(verdicts, self.region, u, self.outside)
            yield recording.cut(begin - first, end - first), verdicts

    def _follow(self, samples: Recording) -> OfObserver:
        """Carry on over samples; return their verdicts."""
        with sparing(False):  # the same bytes whoever makes which part
            self.carry, found = self.observer.followed(self.carry, samples)
        return found

    def memory(self) -> Memory:
        """Return the carry behind the last sample."""
        return as_texts(self.carry)


def _judged(relations: Relations, verdicts: OfObserver) -> Judged:
    """Return the verdicts of an observer, of a monitor with the tests that speak."""
    if isinstance(verdicts, Judged):
        return verdicts._replace(names=tuple(relations.parts))
    return Judged(np.asarray(verdicts.status), np.asarray(verdicts.margin))


class Live:
    """The judge of samples as they come, by a Monitor.

    Args:
        outside: of a Monitor of an observer, as of `detect`; that of windows has its own.

    Fields: last: (k, m) the inputs of the last samples, of an observer; NaN before there are some.
    """

    def __init__(self, monitor: Monitor, outside: str = CLAIMED) -> None:
        self.monitor, self.outside = monitor, outside
        self.state = monitor.init()
        self.region = Region.of(monitor.relations)
        back = 1
        if self.region is not None:
            back = max(back, self.region.horizon)
        self.last = np.full((back, len(known(monitor.relations.model))), np.nan)
        self._begun: float | None = None
        self._ahead: threading.Thread | None = None

    def __call__(self, piece: Numbered) -> Iterator[tuple[Recording, Verdicts]]:
        """Judge the samples of a piece."""
        _, recording = piece
        self._compile_ahead()
        if recording.samples:
            self.state, verdicts = self.monitor.run(
                self.state, recording.u, recording.y, starts=recording.starts
            )
            u = np.concatenate([self.last, recording.u])
            self.last = u[-len(self.last) :]
            yield recording, self._with_departure(verdicts, u)

    def _with_departure(self, verdicts: OfObserver, u: np.ndarray) -> Verdicts:
        """Return verdicts with their departure, which a Monitor of windows says itself. u: see `placed`."""
        if self.monitor.relations.remembers:
            verdicts = placed(_judged(self.monitor.relations, verdicts), self.region, u, self.outside)
        return cast(Verdicts, verdicts)

    def _compile_ahead(self) -> None:
        """Compile beside a live stream what judges its later samples, while NumPy judges the first ones."""
        self._begun = self._begun or time.monotonic()
        if self._ahead is None and time.monotonic() > self._begun + AHEAD and compiles_later():
            self._ahead = threading.Thread(target=inherited(sparing(False)(self.compile)))
            self._ahead.start()

    def compile(self) -> Verdicts:
        """Judge samples of zeros, so that no sample waits for a compiler; return their verdicts."""
        relations = self.monitor.relations
        windows = [test.horizon for test in relations.parts.values()]
        model, window = relations.model, max([relations.horizon, *windows]) + 1
        u, y = np.zeros((window, len(known(model)))), np.zeros((window, model.p))
        return self._with_departure(self.monitor.run(self.monitor.init(), u, y)[1], u)

    def memory(self) -> Memory:
        """Return the state of the Monitor, of an observer the last inputs too."""
        if self._looks_back:
            return as_texts((self.state, self.last))
        return as_texts(self.state)

    def resume(self, memory: Sequence[str]) -> None:
        """Go on from a memory."""
        begun = self.monitor.init(), self.last
        if self._looks_back:
            self.state, self.last = from_texts(begun, memory)
        else:
            self.state = from_texts(begun[0], memory)

    @property
    def _looks_back(self) -> bool:
        """Whether the state of the Monitor lacks the last inputs, which the region is asked for."""
        return self.monitor.relations.remembers and self.region is not None


def as_judged(piece: Piece) -> Iterator[Piece]:
    """Yield a piece that has its verdicts with it."""
    yield piece


def on_device(recording: Recording, laps: Laps) -> Recording:
    """Return a recording whose samples are where the kernel reads them.

    On a CPU that is the copying of columns into arrays.
    """
    laps("read")
    if jax.default_backend() != "cpu":  # a card gets blocks, of samples that it has never held as a whole
        return replace(recording, u=np.ascontiguousarray(recording.u), y=np.ascontiguousarray(recording.y))
    placed = jax.device_put((recording.u, recording.y))
    u, y = jax.block_until_ready(placed)  # type: ignore[no-untyped-call]  # jax gives it no types
    laps("transfer")
    return replace(recording, u=u, y=y)
