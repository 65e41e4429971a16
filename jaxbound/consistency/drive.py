"""The one driver of windows: a WindowTest over a Recording, in blocks of a fixed size.

Recordings of any length share a compilation. Those of a batch are laid end to end; windows across two of
them, or across a gap, are MISSING like any warm-up. Short windows are tested on contiguous stretches, since
gathering costs the speed of the memory; of other windows those that count are gathered.
"""

import contextlib
import math
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeVar, overload

import jax
import numpy as np

from jaxbound.consistency.devices import everywhere, on_devices
from jaxbound.consistency.extrapolated import outside_test
from jaxbound.consistency.interface import (
    Array,
    Arrays,
    Easy,
    Judged,
    Observer,
    Run,
    Verdicts,
    WindowTest,
    window_count,
)
from jaxbound.consistency.reading import Block, gather
from jaxbound.consistency.searched import only_searched
from jaxbound.consistency.twice import warn_of
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.recordings.seams import crossing
from jaxbound.sets.floats.kernel import (
    UNCOUNTED,
    is_outside_xla,
    is_sparing,
    judged_by,
    outside_xla,
    tried_in_numpy,
)
from jaxbound.sets.floats.probe import (
    default_device,
    refuse_unverified,
    searching,
    searching_device,
    usable_devices,
)
from jaxbound.sets.floats.status import Status
from jaxbound.sets.floats.threads import inherited
from jaxbound.text.progress import Progress, in_part, reporter

CORES = os.cpu_count() or 1
AHEAD = 3  # groups of blocks that are under way at once
AGAIN = 2**12  # windows that are evaluated in NumPy at once, where there are as many
TOGETHER = 2**15  # windows of which the first ones say whether easy ones are among them
ASKED = 2**11  # so many of these
FEWEST = 8  # where not one in so many of them is easy, no other is asked
EASY = 0.5  # the progress that goes to easy windows

Devices = tuple[jax.Device, ...]
Part = tuple[np.ndarray, Arrays]
"""(starts of windows, what is judged of them)."""
T = TypeVar("T")


@overload
def drive(test: WindowTest, given: Recording, progress: Progress | None = None) -> Judged: ...


@overload
def drive(test: Observer[Any], given: Recording, progress: Progress | None = None) -> Any: ...


def drive(test: WindowTest | Observer[Any], given: Recording, progress: Progress | None = None) -> Verdicts:
    """Return the verdicts (..., T) of all windows of a recording, or of a batch of one length.

    Args:
        test: from `relations.test`, or an Observer, which returns its own verdicts. progress: called with the
            share of the work done.
    """
    if test.remembers:
        return _folded(test, given)
    return windows(test, given, progress)


def _folded(observer: Observer[Any], given: Recording) -> Verdicts:
    """Return the verdicts of an observer on one recording, or on each recording of a batch.

    A gap ends what is carried: a batch is followed as one recording, with a gap before each of its own,
    unless the observer knows more of a first sample than of one behind a gap.
    """
    *lead, length, _ = given.y.shape
    if not lead or observer.batched:
        return observer.followed(observer.begin(), given)[1]
    if given.y.size and (observer.informed or observer.begun is not None):
        each = []
        for at in np.ndindex(*lead):
            one = replace(given, u=np.asarray(given.u)[at], y=np.asarray(given.y)[at])
            each.append(observer.followed(observer.begin(), one)[1])
        stacked: Verdicts = jax.tree.map(
            lambda *parts: np.stack(parts).reshape(*lead, *np.shape(parts[0])), *each
        )
        return stacked
    begins = length * np.arange(math.prod(lead))
    # the first sample of each recording follows nothing
    starts = (np.concatenate([[0], given.starts]) + begins[:, None]).ravel()
    excluded = given.excluded
    if excluded is not None:
        excluded = np.broadcast_to(excluded, given.y.shape[:-1]).reshape(-1)
    u, y = end_to_end(given.u), end_to_end(given.y)
    one = replace(given, u=u, y=y, starts=np.unique(starts[starts > 0]), excluded=excluded)
    verdicts = observer.followed(observer.init(), one)[1]

    def apart(x: Array) -> Array:
        if np.shape(x)[:1] != (len(y),):
            return x
        return np.asarray(x).reshape(*lead, length, *np.shape(x)[1:])

    out: Verdicts = jax.tree.map(apart, verdicts)
    return out


def windows(
    test: WindowTest, given: Recording, progress: Progress | None = None, size: int | None = None
) -> Judged:
    """Return the verdicts that `drive` gives: of windows outside the region of training under the bounds that
    they have there.

    Args:
        test, given, progress: as for `drive`. size: windows at once; None: as the test says.
    """
    judged = as_stated(test, given, progress, size)
    outside = outside_test(test)
    if outside is None:
        return judged
    departure = outside.beyond.region.departure(np.asarray(given.u), judged.status == Status.MISSING)
    grades = departure.grade
    for grade in np.unique(grades[grades >= 0]).tolist():
        at = np.flatnonzero(grades == grade)
        first, samples = stretches_around(at, test.horizon)
        beyond = Recording(end_to_end(given.u)[samples], end_to_end(given.y)[samples], first[1:])
        wide = as_stated(outside.test(grade), beyond, size=size)
        judged = _with_those(judged, wide, at, np.searchsorted(samples, at))
    return judged


def _with_those(judged: Judged, others: Judged, at: np.ndarray, here: np.ndarray) -> Judged:
    """Return verdicts where those of windows `at`, counted end to end, are those that others have `here`."""

    def both(mine: np.ndarray, theirs: np.ndarray) -> np.ndarray:
        flat = np.array(mine).reshape(*mine.shape[: theirs.ndim - 1], -1)  # words of relations stand first
        flat[..., at] = theirs[..., here]
        return flat.reshape(mine.shape)

    words = judged.words
    if words is not None and others.words is not None:
        words = both(words, others.words)
    columns = {name: both(numbers, others.columns[name]) for name, numbers in judged.columns.items()}
    status, margin = both(judged.status, others.status), both(judged.margin, others.margin)
    return judged._replace(status=status, margin=margin, words=words, columns=columns)


def stretches_around(at: np.ndarray, horizon: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (where stretches of samples begin, the samples that windows at `at` need, each once)."""
    begins = at - horizon
    apart = np.flatnonzero(begins[1:] > at[:-1]) + 1  # windows that share no sample with those before
    starts = np.concatenate([begins[:1], begins[apart]])
    stops = np.concatenate([at[apart - 1], at[-1:]]) + 1
    lengths = stops - starts
    samples = np.arange(lengths.sum()) + np.repeat(starts - np.cumsum(lengths) + lengths, lengths)
    return np.cumsum(lengths) - lengths, samples


def as_stated(
    test: WindowTest, given: Recording, progress: Progress | None = None, size: int | None = None
) -> Judged:
    """Return the verdicts of windows under the bounds of a test, wherever they lie. Args: as of `windows`."""
    flat_u, flat_y, block = end_to_end(given.u), end_to_end(given.y), size or test.block
    shape, report = given.y.shape[:-1], _rising(progress)
    decided = partial(_decided, test, flat_u, flat_y, shape, given.starts, report, block)
    if is_outside_xla():
        return decided()
    if test.by_kernels:
        believed = None
        if is_sparing() == UNCOUNTED or not test.confirms:  # a window of a stream is looked at again
            believed = _decided_all
        work = window_count(shape, test.horizon) * test.weight
        tried = tried_in_numpy(decided, work, test.kind, believed)
        if tried is not None:
            return tried
    else:
        judged_by().add("NumPy")
    if not searching_device():
        if not test.on_host:
            refuse_unverified()
        return decided()

    def missing(some_u: np.ndarray, some_y: np.ndarray) -> np.ndarray:
        with outside_xla():
            alone = as_stated(test, Recording(some_u, some_y), size=block)
        return np.asarray(alone.status[:, -1] == Status.MISSING)

    with searching():
        judged = decided()
        ends = np.ones(shape, bool)
        ends[..., _endless(given.starts, test.horizon, shape[-1])] = False
        return only_searched(test, judged, flat_u, flat_y, ends.reshape(-1), missing)


def _decided_all(judged: Judged) -> bool:
    """Return whether no window is open within rounding, which another way to compute may decide."""
    return not ((judged.status == Status.UNDECIDED) & (judged.margin == 0)).any()


def _decided(
    test: WindowTest,
    u: np.ndarray,
    y: np.ndarray,
    shape: tuple[int, ...],
    starts: np.ndarray,
    report: Progress,
    size: int,
) -> Judged:
    """Return the verdicts (*shape) of samples that are laid end to end, each FAULT decided twice: UNDECIDED
    where a second look does not confirm it.
    """
    judged = test.judged(_filled(test, u, y, shape, starts, report, size))
    status = judged.status.reshape(-1)
    # of nearly all recordings the maximum alone is asked for
    if test.confirms or is_outside_xla() or status.max(initial=0) < Status.FAULT:
        return judged
    faulty = np.flatnonzero(status == Status.FAULT)
    proved = _contradicted(test, u, y, faulty - test.horizon, size)
    if proved.all():
        return judged
    judged, doubtful = test.withdrawn(judged, faulty, proved, u, y)
    if doubtful.any():
        warn_of(faulty[doubtful], len(faulty))
    return judged


def raw_outputs(test: WindowTest, given: Recording) -> list[np.ndarray]:
    """Return the `outputs` (..., T) of a test, without `columns`, before a FAULT is confirmed."""
    u, y, shape = end_to_end(given.u), end_to_end(given.y), given.y.shape[:-1]
    outs = _filled(test, u, y, shape, given.starts, reporter(None), test.block)
    return outs[: len(outs) - len(test.columns)]


def _filled(
    test: WindowTest,
    u: np.ndarray,
    y: np.ndarray,
    shape: tuple[int, ...],
    starts: np.ndarray,
    report: Progress,
    size: int,
) -> list[np.ndarray]:
    """Return the `outputs` (*shape) of a test of samples that are laid end to end."""
    length = shape[-1]
    fill = _gathered if test.gathered else _stretches
    outs = fill(test, u, y, length, _endless(starts, test.horizon, length), size, report)
    report(1.0)
    return [out.reshape(shape) for out in outs]


def _endless(starts: np.ndarray, horizon: int, length: int) -> np.ndarray | slice:
    """Return the samples of a recording at which no window ends: the warm-up, and behind each seam."""
    if not len(starts):
        return slice(0, horizon)
    return np.flatnonzero(crossing(starts, horizon, 0, length) | (np.arange(length) < horizon))


def _contradicted(
    test: WindowTest, u: np.ndarray, y: np.ndarray, starts: np.ndarray, size: int
) -> np.ndarray:
    """Return which windows that start at these samples contradict their bounds, without XLA."""
    seen = test.contradicted(u, y, starts)
    if seen is not None:
        return seen
    refuted = np.zeros(len(starts), bool)
    if len(starts) >= AGAIN and test.block < AGAIN:  # each size is another program to write down
        size = max(size, AGAIN)
    for first in range(0, len(starts), size):
        chosen = slice(first, first + size)
        # each window by itself, a recording of its own: seams between them are no matter
        at = starts[chosen, None] + np.arange(test.horizon + 1)
        # A primitive of a newer jax, which NumPy does not know, confirms nothing.
        with outside_xla(), contextlib.suppress(NotImplementedError):
            judged = as_stated(test, Recording(u[at], y[at]), size=size)
            refuted[chosen] = judged.status[:, -1] == Status.FAULT
    return refuted


def _runner(test: WindowTest, devices: Devices, axis: int) -> Run:
    """Return the function that runs kernels of a test on blocks, one a device; axis: of the windows."""

    def run(kernel: Callable[..., T], blocks: Sequence[Arrays]) -> list[T]:
        return on_devices(kernel, _placed(test, devices), blocks, devices, axis)

    return run


def _ahead(started: Iterable[T]) -> Iterator[T]:
    """Yield work in its turn; the next pieces are started while one is under way."""
    pending: deque[T] = deque()
    for work in started:
        pending.append(work)
        if len(pending) >= AHEAD:
            yield pending.popleft()
    yield from pending


def end_to_end(x: Array) -> np.ndarray:
    """Return samples (..., T, n) as (N, n), on the host."""
    x = np.asarray(x)
    if x.ndim == 2:
        return x
    return x.reshape(math.prod(x.shape[:-1]), x.shape[-1])


def _rising(progress: Progress | None) -> Progress:
    """Return a callback that passes on shares of work that are larger than the one before."""
    if progress is None:
        return reporter(None)
    last = 0.0

    def report(share: float) -> None:
        nonlocal last
        if share > last:
            last = share
            progress(share)

    return report


def _stretches(
    test: WindowTest,
    u: np.ndarray,
    y: np.ndarray,
    length: int,
    endless: np.ndarray | slice,
    size: int,
    report: Progress,
) -> list[np.ndarray]:
    """Judge all windows of contiguous samples, those that do not count among them."""
    s, samples, kinds = test.horizon, len(y), test.outputs
    outs = [np.empty(samples, dtype) for dtype, _ in kinds]
    firsts = range(0, samples - s, size)
    devices = usable_devices()
    if len(firsts) < 2:
        devices = devices[:1]
    run = _runner(test, devices, 0)

    def judge(i: int) -> list[tuple[int, Arrays]]:
        chosen = firsts[i : i + len(devices)]
        blocks = [(_rows_from(u, first, size + s), _rows_from(y, first, size + s)) for first in chosen]
        return list(zip(chosen, test.judge(run, blocks), strict=True))

    for parts in _ahead(map(judge, range(0, len(firsts), len(devices)))):
        for first, values in parts:
            stop = min(first + s + size, samples)
            for out, value in zip(outs, values, strict=True):
                out[first + s : stop] = np.asarray(value)[: stop - first - s]
            report(stop / samples)
    for out, (_, nothing) in zip(outs, kinds, strict=True):
        if samples:
            out.reshape(-1, length)[..., endless] = nothing
    test.settle(u, y, outs, NOWHERE, report)
    return outs


def _gathered(
    test: WindowTest,
    u: np.ndarray,
    y: np.ndarray,
    length: int,
    endless: np.ndarray | slice,
    size: int,
    report: Progress,
) -> list[np.ndarray]:
    """Judge the windows that count, and settle what is left open."""
    s = test.horizon
    outs = [np.full(len(y), nothing, dtype) for dtype, nothing in test.outputs]
    ends = np.delete(np.arange(length), endless)
    if 0 < length < len(y):
        ends = (ends + np.arange(0, len(y), length)[:, None]).ravel()
    every, filling = ends, _Filling(u, y, outs)
    if test.easy_first and test.easy is not None and not is_outside_xla():
        ends = _past_easy(test, test.easy, filling, length, ends, size, partial(in_part, report, 0, EASY))
        report = partial(in_part, report, EASY, 1 - EASY)
    total, done = max(len(ends), 1), 0

    for case, starts in test.cases(u, y, ends - s):
        # Nine tenths of the progress of a case go to judging, the rest to settling.
        share = len(starts) / total
        judging = partial(in_part, report, done / total, 0.9 * share)
        own = size if case is test else case.block
        left = _Gathering(case, filling, own, judging).judge_all(starts)
        settling = partial(in_part, report, done / total + 0.9 * share, 0.1 * share)
        case.settle(u, y, outs, left, settling)
        done += len(starts)
    _last_look(test, filling, every, size)
    _doubted(test, filling)
    return outs


def _last_look(test: WindowTest, filling: "_Filling", ends: np.ndarray, size: int) -> None:
    """Ask easy windows of what the search leaves open: verdicts do not depend on who is asked first, nor on
    the windows beside.
    """
    left = ends[filling.outs[0][ends] == 0]
    if not len(left) or test.easy is None:  # asked last: its matrix is worked out then
        return
    own = min(size, test.easy.windows.block)
    _Gathering(test.easy.windows, filling, own, reporter(None)).judge_all(left - test.horizon)


def _doubted(test: WindowTest, filling: "_Filling") -> None:
    """Ask whole numbers of windows that are FAULT by XLA alone, and that nothing after it decides."""
    margin, ends = filling.outs[0], np.unique(np.concatenate([NOWHERE, *filling.doubtful]))
    ends = ends[margin[ends] == 0]
    if not len(ends):
        return
    exact = test.exactly(filling.u, filling.y, ends - test.horizon)
    proved = exact < 0
    margin[ends[proved]] = exact[proved]
    if not proved.all():
        warn_of(ends[~proved], len(ends))


def _past_easy(
    test: WindowTest,
    easy: Easy,
    filling: "_Filling",
    length: int,
    ends: np.ndarray,
    size: int,
    report: Progress,
) -> np.ndarray:
    """Let easy windows be settled at once; return the ends of the others."""
    s, stretches, windows = test.horizon, easy.stretches, easy.windows
    own = size
    if size == test.block:
        own = (stretches or windows).block
    if stretches is not None and length >= 2 * s:  # of shorter recordings most windows would lie across two
        u, y = filling.u, filling.y
        found = _stretches(stretches, u, y, len(y), slice(0, s), own, partial(in_part, report, 0, 0.5))
        for out, values in zip(filling.outs, found, strict=True):
            out[ends] = values[ends]
        ends = ends[~(found[0][ends] > 0)]
    left, total = [NOWHERE], len(ends)
    for first in range(0, total, TOGETHER):
        part = ends[first : first + TOGETHER]
        done = partial(in_part, report, 0.5 + 0.5 * first / total, 0.5 * len(part) / total)
        gathering = _Gathering(windows, filling, min(own, windows.block), done)
        some = gathering.judge_all(part[:ASKED] - s) + s
        left.append(some)
        rest = part[ASKED:]
        if len(some) * FEWEST <= len(part[:ASKED]) * (FEWEST - 1):
            rest = gathering.judge_all(rest - s) + s
        left.append(rest)
    return np.concatenate(left)


@dataclass(frozen=True)
class _Filling:
    """The windows of a recording. Fields: u, y: all samples; outs: the arrays that are filled; doubtful: ends
    of those whose FAULT no hint proves.
    """

    u: np.ndarray
    y: np.ndarray
    outs: list[np.ndarray]
    doubtful: list[np.ndarray] = field(default_factory=list)


@dataclass(frozen=True)
class _Gathering:
    """The work on windows that are gathered, group by group of blocks.

    Fields: test; filling: the windows; size: of a block; report: takes the share of the windows done.
    """

    test: WindowTest
    filling: _Filling
    size: int
    report: Progress

    def judge_all(self, starts: np.ndarray) -> np.ndarray:
        """Judge the windows that start at `starts`, write their values, return the starts left open."""
        test, size = self.test, self.size
        devices = usable_devices()
        if len(starts) <= size or is_outside_xla():
            devices = devices[:1]
        together = size * len(devices) if test.sharded else size
        groups = [starts[i : i + together] for i in range(0, len(starts), together)]
        workers = len(devices)
        if test.threads:  # where the host waits, others use the cores
            # where devices are many each has threads of its own already
            workers = max(2, CORES // len(devices))
        elif test.sharded:
            workers = 1
        if workers == 1 or len(groups) < 2 or is_outside_xla():
            judged = _ahead(map(partial(self._judge, devices=devices), groups))
        else:
            judged = self._on_threads(groups, devices, workers)
        left, finished = [NOWHERE], 0
        for parts in judged:
            for chosen, values in parts:
                left.append(self._write(chosen, values))
                finished += len(chosen)
                self.report(finished / len(starts))
        return np.concatenate(left)

    def _on_threads(self, groups: list[np.ndarray], devices: Devices, workers: int) -> Iterator[list[Part]]:
        """Yield the same from threads: compiled code runs outside the interpreter's lock."""
        default = default_device()

        def judge(number: int, group: np.ndarray) -> list[Part]:
            own = default
            if not self.test.sharded:
                own = devices[number % len(devices)]
            with jax.default_device(own):
                return self._judge(group, devices)

        with ThreadPoolExecutor(workers) as pool:
            yield from pool.map(inherited(judge), range(len(groups)), groups)

    def _judge(self, group: np.ndarray, devices: Devices) -> list[Part]:
        """Return the parts of a group, a block each."""
        test, size = self.test, self.size
        run = _runner(test, devices, -1)
        parts = [group[i : i + size] for i in range(0, len(group), size)]
        blocks: list[Block] = []
        for part in parts:
            if test.padded:  # the last window again and again
                part = part.take(np.arange(size), mode="clip")
            blocks.append(gather(self.filling.u, self.filling.y, part, test.lags, test.horizon))
        proved = map(self._proved, parts, blocks, test.judge(run, blocks))
        return list(zip(parts, proved, strict=True))

    def _proved(self, part: np.ndarray, block: Block, judged: Arrays) -> Arrays:
        """Return the arrays of a block, with each FAULT left open that its hints do not prove."""
        count = len(self.filling.outs)
        if len(judged) <= count + 1:
            return judged
        margin, *numbers = judged[:count]
        open_, *hints = judged[count:]
        margin, open_ = np.asarray(margin)[: len(part)], np.asarray(open_)[: len(part)]
        faulty = np.flatnonzero(margin < 0)
        if not len(faulty) or is_outside_xla():  # where NumPy judged, nothing has to be seen again
            return margin, *numbers, open_
        proved = self.test.refuted(*(np.asarray(x)[..., faulty] for x in (*block, *hints)))
        wrong = faulty[~proved]
        if len(wrong):
            margin, open_ = margin.copy(), open_.copy()
            margin[wrong], open_[wrong] = 0, True
            self.filling.doubtful.append(part[wrong] + self.test.horizon)
        return margin, *numbers, open_

    def _write(self, chosen: np.ndarray, arrays: Arrays) -> np.ndarray:
        """Write the values of the windows that start at `chosen`; return the starts left open."""
        values = [np.asarray(x)[..., : len(chosen)] for x in arrays]
        outs, at = self.filling.outs, chosen + self.test.horizon
        for out, own in zip(outs, values, strict=False):
            out[at] = own
        if len(values) == len(outs):
            return chosen[:0]
        left: np.ndarray = chosen[values[-1]]
        return left


def _placed(test: WindowTest, devices: Devices) -> object:
    """Return the constants of a test on devices; a test remembers them. Outside XLA they are those of the
    host, which no device has copied.
    """
    if is_outside_xla():
        return test.constants
    if devices not in test.placed:
        test.placed[devices] = everywhere(test.constants, devices)
    return test.placed[devices]


def _rows_from(x: np.ndarray, first: int, length: int) -> np.ndarray:
    """Return a fixed number of rows from the first on, NaN where there are none."""
    part = x[first : first + length]
    if len(part) == length:
        return part
    full = np.empty((length, x.shape[1]), x.dtype)
    full[: len(part)], full[len(part) :] = part, np.nan
    return full
