"""The one driver of windows: a WindowTest over a Recording, in blocks of a fixed size.

Recordings of any length share a compilation. Those of a batch are laid end to end; windows across two of
them, or across a gap, are MISSING like any warm-up. Short windows are tested on contiguous stretches, since
gathering costs the speed of the memory; of other windows those that count are gathered.
"""

import contextlib
import math
import os
from collections import deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.devices import everywhere, on_devices
from jaxbound.consistency.interface import Arrays, Block, Judged, Kernel, Observer, Progress, Run, WindowTest
from jaxbound.consistency.reading import gather
from jaxbound.consistency.twice import decided_twice
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.recordings.seams import crossing
from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla
from jaxbound.sets.floats.probe import default_device, usable_devices
from jaxbound.sets.floats.status import Status
from jaxbound.sets.floats.threads import inherited

__all__ = ["drive", "windows"]

CORES = os.cpu_count() or 1
AHEAD = 3  # groups of blocks that are under way at once
AGAIN = 2**12  # windows that are evaluated in NumPy at once, where there are as many
SMALL = 2**10  # arrays below this are not worth an alignment
ALIGNMENT = 64  # bytes, at which XLA adopts an array of the host

Devices = tuple[jax.Device, ...]


def drive(
    test: WindowTest | Observer[Any],
    given: Recording,
    progress: Progress | None = None,
    size: int | None = None,
) -> Any:
    """Return the verdicts (..., T) of all windows of a recording, or of a batch of one length.

    Args:
        test: from `relations.test`, or an Observer, which returns its own verdicts. progress: called with the
            share of the work done.
        size: windows at once; None: as the test says.
    """
    if isinstance(test, Observer):
        return _folded(test, given)
    return windows(test, given.u, given.y, given.starts, progress, size)


def _folded(observer: Observer[Any], given: Recording) -> Any:
    """Return the verdicts of an observer on one recording, or on each recording of a batch."""
    lead = given.y.shape[:-2]
    if not lead or observer.batched:
        return observer.fold(observer.begin(), given)[1]
    each = []
    for at in np.ndindex(*lead):
        one = replace(given, u=np.asarray(given.u)[at], y=np.asarray(given.y)[at])
        each.append(observer.fold(observer.begin(), one)[1])
    if not each:
        nothing = np.empty(given.y.shape[:-1])
        return Judged(nothing.astype(np.int8), nothing)

    def beside(*parts: np.ndarray) -> np.ndarray:
        return np.stack(parts).reshape(*lead, *np.shape(parts[0]))

    return jax.tree.map(beside, *each)


def windows(
    test: WindowTest,
    u: np.ndarray | jax.Array,
    y: np.ndarray | jax.Array,
    starts: np.ndarray,
    progress: Progress | None = None,
    size: int | None = None,
) -> Any:
    """Return the verdicts that `drive` gives for a Recording of these samples.

    Args:
        test, progress, size: as for `drive`. u: (..., T, m). y: (..., T, p). starts: of that Recording.
    """
    horizon, shape, block = test.horizon, y.shape[:-1], size or test.block
    length = shape[-1]
    u, y = _end_to_end(u), _end_to_end(y)
    report = _nothing if progress is None else _rising(progress)
    judge_all = _gathered if test.gathered else _stretches
    outs = judge_all(test, u, y, length, _endless(starts, horizon, length), block, report)
    report(1.0)
    judged = test.judged([out.reshape(shape) for out in outs])
    if test.twice or is_outside_xla() or not isinstance(judged, Judged):
        return judged

    def contradicted(ends: np.ndarray) -> np.ndarray:
        return _contradicted(test, u, y, ends - horizon, block)

    return decided_twice(test, judged, u, y, contradicted)


def _endless(starts: np.ndarray, horizon: int, length: int) -> np.ndarray | slice:
    """Return the samples of a recording at which no window ends: the warm-up, and behind each seam."""
    if not len(starts):
        return slice(0, horizon)
    return np.flatnonzero(crossing(starts, horizon, 0, length) | (np.arange(length) < horizon))


def _contradicted(
    test: WindowTest, u: np.ndarray, y: np.ndarray, starts: np.ndarray, size: int
) -> np.ndarray:
    """Return which windows that start at these samples contradict their bounds, without XLA."""
    found = test.contradicted(u, y, starts)
    if not test.replayed:
        return test.exactly(found, u, y, starts)
    left = np.flatnonzero(~found)
    if len(left) >= AGAIN and test.block < AGAIN:  # each size is another program to write down
        size = max(size, AGAIN)
    for first in range(0, len(left), size):
        chosen = left[first : first + size]
        at = starts[chosen, None] + np.arange(test.horizon + 1)
        # A primitive of a newer jax, which NumPy does not know, confirms nothing.
        with outside_xla(), contextlib.suppress(NotImplementedError):
            judged = windows(test, u[at], y[at], NOWHERE, size=size)
            found[chosen] = judged.status[:, -1] == Status.FAULT
    return found


def _runner(test: WindowTest, devices: Devices, axis: int) -> Run:
    """Return the function that runs kernels of a test on blocks, one a device; axis: of the windows."""
    constants = _placed(test, devices)

    def run(kernel: Kernel, blocks: Sequence[Block]) -> list[Any]:
        return on_devices(kernel, constants, list(blocks), devices, axis)

    return run


def _run_nothing(kernel: Kernel, blocks: Sequence[Block]) -> list[Any]:
    """Stand in for `_runner` where a test calls its kernels itself."""
    raise NotImplementedError("a test that is not sharded calls its kernels itself")


def _end_to_end(x: np.ndarray | jax.Array) -> np.ndarray:
    """Return samples (..., T, n) as (N, n), on the host."""
    x = np.asarray(x)
    return x if x.ndim == 2 else x.reshape(math.prod(x.shape[:-1]), x.shape[-1])


def _nothing(share: float) -> None:
    """Report nothing."""


def _rising(progress: Progress) -> Progress:
    """Return a callback that passes on shares of work that are larger than the one before."""
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
    outs = [_aligned(samples, dtype) for dtype, _ in kinds]
    firsts = range(0, samples - s, size)
    devices = usable_devices()[: None if len(firsts) > 1 else 1]
    run = _runner(test, devices, 0)
    pending: deque[tuple[range, list[Any]]] = deque()

    def collect(chosen: range, judged: list[Any]) -> None:
        for first, found in zip(chosen, judged, strict=True):
            stop = min(first + s + size, samples)
            for out, value in zip(outs, found, strict=True):
                out[first + s : stop] = np.asarray(value)[: stop - first - s]
            report(stop / samples)

    for i in range(0, len(firsts), len(devices)):
        chosen = firsts[i : i + len(devices)]
        blocks = [(_padded(u, first, size + s), _padded(y, first, size + s)) for first in chosen]
        pending.append((chosen, test.judge(run, blocks)))
        if len(pending) >= AHEAD:
            collect(*pending.popleft())
    for done in pending:
        collect(*done)
    for out, (_, nothing) in zip(outs, kinds, strict=True):
        recordings = out if samples == length else out.reshape(-1, length)
        recordings[..., endless] = nothing
    test.settle(u, y, outs, NOWHERE, _left_open, report)
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
    total, done = max(len(ends), 1), 0

    def again(other: WindowTest, chosen: np.ndarray) -> np.ndarray:
        return _Gathering(other, u, y, outs, other.block, _nothing).judge_all(chosen)

    for case, starts in test.cases(u, y, ends - s):
        # Nine tenths of the progress of a case go to judging, the rest to settling.
        share = len(starts) / total
        judging = _part(report, done / total, 0.9 * share)
        left = _Gathering(case, u, y, outs, size, judging).judge_all(starts)
        case.settle(u, y, outs, left, again, _part(report, done / total + 0.9 * share, 0.1 * share))
        done += len(starts)
    return outs


def _part(report: Progress, before: float, share: float) -> Progress:
    """Return a callback for a part of the work: its share, behind what was done before."""
    return lambda done: report(before + share * done)


@dataclass(frozen=True)
class _Gathering:
    """The work on windows that are gathered, group by group of blocks.

    Fields: test; u, y: all samples; outs: the arrays that are filled; size: of a block; report: takes the
    share of the windows done.
    """

    test: WindowTest
    u: np.ndarray
    y: np.ndarray
    outs: list[np.ndarray]
    size: int
    report: Progress

    def judge_all(self, starts: np.ndarray) -> np.ndarray:
        """Judge the windows that start at `starts`, write what is found, return the starts left open."""
        test, size = self.test, self.size
        devices = usable_devices()
        if len(starts) <= size or is_outside_xla():
            devices = devices[:1]
        together = size * len(devices) if test.sharded else size
        groups = [starts[i : i + together] for i in range(0, len(starts), together)]
        workers = self._workers(devices)
        if workers == 1 or len(groups) < 2 or is_outside_xla():
            judged = self._in_turn(groups, devices)
        else:
            judged = self._on_threads(groups, devices, workers)
        left, finished = [NOWHERE], 0
        for parts in judged:
            for chosen, found in parts:
                left.append(self._write(chosen, found))
                finished += len(chosen)
                self.report(finished / len(starts))
        return np.concatenate(left)

    def _workers(self, devices: Devices) -> int:
        """Return how many threads judge at once."""
        if self.test.threads:  # where the host waits, others use the cores
            return max(2, CORES // len(devices))
        return 1 if self.test.sharded else len(devices)

    def _in_turn(self, groups: list[np.ndarray], devices: Devices) -> Any:
        """Yield what is judged of each group; the next ones are gathered while one is under way."""
        pending: deque[list[tuple[np.ndarray, Arrays]]] = deque()
        for group in groups:
            pending.append(self._judge(group, devices))
            if len(pending) >= AHEAD:
                yield pending.popleft()
        yield from pending

    def _on_threads(self, groups: list[np.ndarray], devices: Devices, workers: int) -> Any:
        """Yield the same from threads: compiled code runs outside the interpreter's lock."""
        default = default_device()

        def judge(number: int, group: np.ndarray) -> list[tuple[np.ndarray, Arrays]]:
            own = default if self.test.sharded else devices[number % len(devices)]
            with jax.default_device(own):
                return self._judge(group, devices)

        with ThreadPoolExecutor(workers) as pool:
            yield from pool.map(inherited(judge), range(len(groups)), groups)

    def _judge(self, group: np.ndarray, devices: Devices) -> list[tuple[np.ndarray, Arrays]]:
        """Return [(starts, what is judged of their windows)], a block each."""
        test, size = self.test, self.size
        run = _runner(test, devices, -1) if test.sharded else _run_nothing
        parts = [group[i : i + size] for i in range(0, len(group), size)]
        blocks = []
        for part in parts:
            if test.padded:  # the last window again and again
                part = part.take(np.arange(size), mode="clip")
            blocks.append(gather(self.u, self.y, part, test.lags, test.horizon))
        return list(zip(parts, test.judge(run, blocks), strict=True))

    def _write(self, chosen: np.ndarray, found: Arrays) -> np.ndarray:
        """Write what was found of the windows that start at `chosen`; return the starts left open."""
        values = [np.asarray(x)[..., : len(chosen)] for x in found]
        count = len(self.outs)
        self.test.write(self.outs, chosen + self.test.horizon, tuple(values[:count]))
        return chosen[values[-1]] if len(values) > count else chosen[:0]


def _placed(test: WindowTest, devices: Devices) -> Any:
    """Return the constants of a test on devices; a test remembers them."""
    if devices not in test.placed:
        test.placed[devices] = everywhere(test.constants, devices)
    return test.placed[devices]


def _left_open(test: WindowTest, starts: np.ndarray) -> np.ndarray:
    """Return the starts of windows that no other test judges: all."""
    return starts


def _padded(x: np.ndarray, first: int, length: int) -> np.ndarray:
    """Return a fixed number of rows from the first on, NaN where there are none."""
    part = x[first : first + length]
    if len(part) == length:
        return part
    full = np.empty((length, x.shape[1]), x.dtype)
    full[: len(part)], full[len(part) :] = part, np.nan
    return full


def _aligned(count: int, dtype: DTypeLike) -> np.ndarray:
    """Return an uninitialised array that a CPU device can adopt without a copy."""
    if count < SMALL:
        return np.empty(count, dtype)
    size = count * np.dtype(dtype).itemsize
    raw = np.empty(size + ALIGNMENT, np.uint8)
    start = -raw.ctypes.data % ALIGNMENT
    return raw[start : start + size].view(dtype)
