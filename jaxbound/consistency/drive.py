"""The one driver of windows: a WindowTest over a Recording, in blocks of a fixed size: recordings of any
length share a compilation.

The recordings of a batch are laid end to end; windows across two of them, or across a gap, are MISSING like
any warm-up. Short windows are tested on contiguous stretches, since gathering costs the speed of the memory;
others are gathered, only those that count.
"""

import contextlib
import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxbound.consistency.devices import everywhere, on_devices
from jaxbound.consistency.interface import Judged, Observer, WindowTest
from jaxbound.consistency.reading import gather
from jaxbound.consistency.twice import decided_twice
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.recordings.seams import crossing
from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla
from jaxbound.sets.floats.probe import default_device, usable_devices
from jaxbound.sets.floats.status import Status

__all__ = ["drive", "windows"]

CORES = os.cpu_count() or 1
AHEAD = 3  # groups of blocks that are under way at once
AGAIN = 2**12  # windows that are evaluated in NumPy at once, where there are as many


def drive(
    test: WindowTest | Observer, given: Recording, progress: Callable | None = None, size: int | None = None
) -> Any:
    """Return the verdicts (..., T) of all windows of a recording, or of a batch of one length; of an Observer
    what it judges of one.

    Args:
        test: from `relations.test`, or an Observer. progress: called with the share of the work done.
        size: windows at once; None: as the test says.
    """
    if isinstance(test, Observer):
        return _folded(test, given)
    return windows(test, given.u, given.y, given.starts, progress, size)


def _folded(observer: Observer[Any], given: Recording) -> Any:
    """Return what an observer judges of one recording, or of each recording of a batch."""
    lead = given.y.shape[:-2]
    if not lead or observer.batched:
        return observer.fold(observer.begin(), given)[1]
    each = [observer.fold(observer.begin(), _alone(given, at))[1] for at in np.ndindex(*lead)]
    if not each:
        nothing = np.empty(given.y.shape[:-1])
        return Judged(nothing.astype(np.int8), nothing)
    join = lambda *parts: np.stack(parts).reshape(*lead, *np.shape(parts[0]))
    return jax.tree.map(join, *each)


def _alone(given: Recording, at: tuple[int, ...]) -> Recording:
    """Return one recording of a batch."""
    return replace(given, u=np.asarray(given.u)[at], y=np.asarray(given.y)[at])


def windows(
    test: WindowTest,
    u: Any,
    y: Any,
    starts: np.ndarray,
    progress: Callable | None = None,
    size: int | None = None,
) -> Any:
    """Return what `drive` does of a Recording of these samples, u (..., T, m), y (..., T, p), with these
    starts.
    """
    s, shape = test.horizon, y.shape[:-1]
    u, y = _end_to_end(u), _end_to_end(y)
    gone: np.ndarray | slice
    if len(starts):
        gone = np.flatnonzero(crossing(starts, s, 0, shape[-1]) | (np.arange(shape[-1]) < s))
    else:
        gone = slice(0, s)  # the warm-up alone
    report = _nothing if progress is None else _rising(progress)
    over = _gathered if test.gathered else _stretches
    outs = over(test, u, y, shape[-1], gone, size or test.block, report)
    report(1.0)
    judged = test.judged([out.reshape(shape) for out in outs])
    if test.twice or is_outside_xla() or not isinstance(judged, Judged):
        return judged
    return decided_twice(
        test, judged, u, y, lambda ends: _contradicted(test, u, y, ends - s, size or test.block)
    )


def _contradicted(test, u, y, starts, size):
    """Return which windows that start at these samples contradict their bounds, without XLA."""
    found = test.contradicted(u, y, starts)
    if not test.replayed:
        return test.exactly(found, u, y, starts)
    left = np.flatnonzero(~found)
    size = (
        max(size, AGAIN) if len(left) >= AGAIN and test.block < AGAIN else size
    )  # another one is another program to write down
    for first in range(0, len(left), size):
        chosen = left[first : first + size]
        at = starts[chosen, None] + np.arange(test.horizon + 1)
        with (
            outside_xla(),
            contextlib.suppress(NotImplementedError),
        ):  # a primitive of a newer jax: then nothing is confirmed
            judged = windows(test, u[at], y[at], NOWHERE, size=size)
            found[chosen] = judged.status[:, -1] == Status.FAULT
    return found


class _Run(NamedTuple):
    """Runs kernels on blocks, one a device."""

    constants: object
    devices: tuple
    axis: int

    def __call__(self, kernel, blocks):
        return on_devices(kernel, self.constants, blocks, self.devices, self.axis)


def _end_to_end(x):
    """Return samples (..., T, n) as (N, n), on the host."""
    x = np.asarray(x)
    return x if x.ndim == 2 else x.reshape(math.prod(x.shape[:-1]), x.shape[-1])


def _nothing(share):
    """Report nothing."""


def _rising(progress):
    """Return a callback that passes on shares of work that are larger than the one before."""
    last = 0.0

    def report(share):
        nonlocal last
        if share > last:
            last = share
            progress(share)

    return report


def _stretches(test, u, y, length, gone, size, report):
    """Judge all windows of contiguous samples, those that do not count among them."""
    s, samples, kinds = test.horizon, len(y), test.outputs
    outs = [_aligned(samples, dtype) for dtype, _ in kinds]
    firsts = range(0, samples - s, size)
    devices = usable_devices()[: None if len(firsts) > 1 else 1]
    run, pending = _Run(_placed(test, devices), devices, 0), []

    def collect(chosen, judged):
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
            collect(*pending.pop(0))
    for done in pending:
        collect(*done)
    for out, (_, nothing) in zip(outs, kinds, strict=True):
        (out if samples == length else out.reshape(-1, length))[..., gone] = nothing
    test.settle(u, y, outs, NOWHERE, _left_open, report)
    return outs


def _gathered(test, u, y, length, gone, size, report):
    """Judge the windows that count, and settle what is left open."""
    s = test.horizon
    outs = [np.full(len(y), nothing, dtype) for dtype, nothing in test.outputs]
    ends = np.arange(s, length) if isinstance(gone, slice) else np.delete(np.arange(length), gone)
    if 0 < length < len(y):
        ends = (ends + np.arange(0, len(y), length)[:, None]).ravel()
    cases, total, done = test.cases(u, y, ends - s), max(len(ends), 1), 0
    for case, starts in cases:
        before, share = done / total, len(starts) / total
        step = lambda part, before=before, share=share: report(before + 0.9 * share * part)
        left = _over_windows(case, u, y, starts, outs, size, step)
        again = lambda other, chosen: _over_windows(other, u, y, chosen, outs, other.block, _nothing)
        late = lambda part, before=before, share=share: report(before + share * (0.9 + 0.1 * part))
        case.settle(u, y, outs, left, again, late)
        done += len(starts)
    return outs


def _over_windows(test, u, y, starts, outs, size, report):
    """Judge the windows that start at `starts`, write what is found, and return the starts of those that are
    left open.
    """
    s, devices = test.horizon, usable_devices()[: None if len(starts) > size else 1]
    devices = devices[:1] if is_outside_xla() else devices
    together = size * len(devices) if test.sharded else size
    groups = [starts[i : i + together] for i in range(0, len(starts), together)]
    run = _Run(_placed(test, devices), devices, -1) if test.sharded else None
    finished = 0

    def work(_, group):
        parts = [group[i : i + size] for i in range(0, len(group), size)]
        full = [
            c.take(np.arange(size), mode="clip") if test.padded else c for c in parts
        ]  # the last window again and again
        return list(zip(parts, test.judge(run, [gather(u, y, c, test.lags, s) for c in full]), strict=True))

    def beside(number, group, wide, default):
        own = default if test.sharded else devices[number % len(devices)]
        with jax.enable_x64(wide), jax.default_device(own):
            return work(number, group)

    def collect(judged):
        nonlocal finished
        left = []
        for chosen, found in judged:
            found = [np.asarray(x)[..., : len(chosen)] for x in found]
            test.write(outs, chosen + s, tuple(found[: len(outs)]))
            left.append(chosen[found[-1]] if len(found) > len(outs) else chosen[:0])
            finished += len(chosen)
            report(finished / len(starts))
        return np.concatenate(left) if len(left) > 1 else left[0]

    numbers = range(len(groups))
    workers = max(2, CORES // len(devices)) if test.threads else 1 if test.sharded else len(devices)
    if workers == 1 or len(groups) < 2 or is_outside_xla():  # of this thread alone
        left, pending = [], []
        for number, group in zip(numbers, groups, strict=True):
            pending.append(work(number, group))  # runs while the host gathers the next ones
            if len(pending) >= AHEAD:
                left.append(collect(pending.pop(0)))
        left += [collect(judged) for judged in pending]
    else:
        wide = (
            jax.dtypes.canonicalize_dtype(float) == np.float64
        )  # of this thread, perhaps, like the default device
        job = partial(beside, wide=bool(wide), default=default_device())
        with ThreadPoolExecutor(workers) as pool:  # compiled code runs outside the interpreter's lock
            left = [collect(found) for found in pool.map(job, numbers, groups)]
    return np.concatenate(left) if left else NOWHERE


def _placed(test, devices):
    """Return the constants of a test on devices; a test remembers them."""
    known = test.__dict__.setdefault("_on", {})
    if devices not in known:
        known[devices] = everywhere(test.constants, devices)
    return known[devices]


def _left_open(test, starts):
    """Return the starts of windows that no other test judges: all."""
    return starts


def _padded(x, first, length):
    """Return a fixed number of rows from the first on, NaN where there are none."""
    part = x[first : first + length]
    if len(part) == length:
        return part
    full = np.empty((length, x.shape[1]), x.dtype)
    full[: len(part)], full[len(part) :] = part, np.nan
    return full


def _aligned(count, dtype):
    """Return an uninitialised array that a CPU device can adopt without a copy."""
    if count < 2**10:
        return np.empty(count, dtype)
    size = count * np.dtype(dtype).itemsize
    raw = np.empty(size + 64, np.uint8)
    start = -raw.ctypes.data % 64
    return raw[start : start + size].view(dtype)
