"""Verdicts for relations whose circuits are too many to enumerate: the exchange search of `sets.strips.separation` over blocks of windows.

Windows are gathered into blocks of one fixed size. Those that a first, short search leaves open are gathered again and searched on; those
that lack a sample on which the search is built get an exact frame without it, shared by all windows that it fits.
"""

import dataclasses
import math
import os
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency import whole_numbers
from jaxbound.consistency.devices import everywhere, on_devices
from jaxbound.exact import linalg
from jaxbound.sets.floats.probe import usable_devices
from jaxbound.sets.strips import separation
from jaxbound.sets.strips.strips import status_of

__all__ = ["candidates", "exchange_margins", "exchange_windows", "verdicts"]

SLAB = 2**16
PATIENCE = 10
"""Exchanges per inner row after which a search is given up; it takes 2 to 4."""
FINER = (1.0, 3e-4, 1e-5, 0.03, 0.0, 0.3, 1e-4, 3e-6, 3e-3)
"""Searches after which a window stays undecided, see `separation_search`: one in some thousands needs more than the first."""


def exchange_windows(relations, u, y, progress):
    """Return (status, margin), each (..., T), of NumPy recordings. See `consistency.detect`."""
    test, s = relations.test("joint", y.dtype), relations.horizon
    shape, k = y.shape[:-1], len(test.shape.inner)
    u, y = (x.reshape(math.prod(shape), x.shape[-1]) for x in (u, y))
    margin = np.full(shape, np.nan, y.dtype)
    flat, left_open = margin.reshape(-1), []
    for first in range(0, len(y), SLAB):
        starts = test.starts(first, min(first + SLAB, len(y)), shape[-1])
        left_open.append(_run(test, u, y, starts, flat, 2 * k + 6))
        if progress is not None:
            progress(0.95 * min(first + SLAB, len(y)) / len(y))
    starts = np.concatenate([*left_open, np.zeros(0, np.int64)])
    _settle(relations, test, u, y, flat)
    for frame, chosen in _frames(relations, test, u, y, starts):
        again, frame = starts[chosen], _rounded(relations, frame, y.dtype)
        for finer in FINER:
            again = _run(dataclasses.replace(test, shape=frame), u, y, again, flat, PATIENCE * (k + 10), finer)
            again = again[flat[again + s] == 0]  # what is proved needs no other search
    if progress is not None:
        progress(1.0)
    return np.asarray(status_of(margin)), margin


def _settle(relations, test, u, y, margin):
    """Decide what rounding leaves open far from the boundary."""
    starts = np.flatnonzero(margin == 0) - test.horizon
    if len(starts):
        starts = starts[whole_numbers.thin(test, *test.gather(u, y, starts))]
    for frame, chosen in _frames(relations, test, u, y, starts):
        margin[starts[chosen] + test.horizon] = whole_numbers.exact_search(relations, test, frame, *test.gather(u, y, starts[chosen]))


def exchange_margins(test, u, y):
    """Return the unproved margins (T - s,) of one recording u (T, m), y (T, p): differentiable, NaN where data are missing."""
    count, size = y.shape[0] - test.horizon, _block_size(test)
    blocks = -(-count // size)
    fill = lambda x: jnp.pad(x, ((0, blocks * size - count), (0, 0)), mode="edge")
    u, y = fill(u), fill(y)

    def one_block(first):
        take = lambda x, lags: jnp.moveaxis(x[first + jnp.arange(lags)[:, None] + jnp.arange(size)[None]], 1, 2)
        mid, rad, _, known, _ = test.block(take(u, test.lags), take(y, test.horizon + 1))
        return separation.separation_margin(test.shape, mid, rad, known)

    return jax.lax.map(one_block, size * jnp.arange(blocks)).reshape(-1)[:count]


@jax.jit
def candidates(given, one, u, y):
    """Return the combinations (h, d, done) that speak most against each window of a block; nothing is proved yet."""
    test, steps, finer = given
    mid, rad, _, known, _ = (x / one[None] for x in test.block(u, y))
    return separation.separation_search(test.shape, mid, rad, known, one, steps, finer)


@jax.jit
def verdicts(given, one, u, y, h, d, done):
    """Return (margin, settled) of the windows of a block, proved from what `candidates` found."""
    test, *_ = given
    mid, rad, scale, known, known_scale = (x / one[None] for x in test.block(u, y))
    return separation.separation_verdict(test.shape, mid, rad, scale, known, known_scale, test.lift, one, h, d, done)


def _run(test, u, y, starts, margin, steps, finer=1.0):
    """Search the windows that start at the samples `starts`, write their margins, and return the starts of those left open."""
    size = _block_size(test)
    devices = usable_devices()[: None if len(starts) > size else 1]
    one, on_device = np.ones(size, y.dtype), everywhere((test, steps, finer), devices)

    def together(first):
        chosen = [starts[i : i + size] for i in range(first, min(first + size * len(devices), len(starts)), size)]
        full = [np.concatenate([c, np.repeat(c[:1], size - len(c))]) for c in chosen]
        given = [(one, *test.gather(u, y, c)) for c in full]
        searched = on_devices(candidates, on_device, given, devices, axis=-1)
        judged = on_devices(verdicts, on_device, [(*a, *b) for a, b in zip(given, searched, strict=True)], devices, axis=-1)
        return np.concatenate([collect(*pair) for pair in zip(chosen, judged, strict=True)])

    def collect(chosen, judged):
        found, settled = (np.asarray(x)[: len(chosen)] for x in judged)
        before = margin[chosen + test.horizon]
        margin[chosen + test.horizon] = np.where((found == 0) & (abs(before) > 0), before, found)  # a proof stays one
        return chosen[~settled]

    with ThreadPoolExecutor(max(2, os.cpu_count() // len(devices))) as threads:  # compiled code runs outside the interpreter's lock
        return np.concatenate([*threads.map(together, range(0, len(starts), size * len(devices))), np.zeros(0, starts.dtype)])


def _block_size(test):
    """Return how many windows a kernel takes at once, a function of the shape of the test: their inverses should stay in the cache."""
    return 1024 if len(test.shape.inner) <= 8 else 64


def _frames(relations, test, u, y, starts):
    """Return [(exact frame, numbers of windows)]: for every window a frame whose inner rows and inputs it has."""
    if not len(starts):
        return []
    missing, absent = (np.isnan(x).reshape(-1, len(starts)).T for x in test.gather(u, y, starts))
    patterns, which = np.unique(np.concatenate([absent, missing], 1), axis=0, return_inverse=True)
    rows = absent.shape[1]
    frames, numbers, by_inputs = [relations.frame], [], {(): [0]}
    for pattern in patterns:
        gone, inputs = set(np.flatnonzero(pattern[:rows]).tolist()), tuple(np.flatnonzero(pattern[rows:]).tolist())
        number = next((i for i in by_inputs.get(inputs, ()) if _fits(frames[i], gone, inputs)), None)
        if number is None:
            number = len(frames)
            frames.append(linalg.reframe(relations.frame, gone, inputs))
            by_inputs.setdefault(inputs, []).append(number)
        numbers.append(number)
    chosen = np.array(numbers)[which.ravel()]
    return [(frames[i], np.flatnonzero(chosen == i)) for i in np.unique(chosen).tolist()]


def _rounded(relations, frame, dtype):
    """Return a frame in floats, of one of few widths, so that few are compiled."""
    k, more = len(relations.frame.inner), len(frame.inner) - len(relations.frame.inner)
    return separation.frame_of(frame, dtype, k + (1 << (more - 1).bit_length() if more > 0 else 0))


def _fits(frame, gone, inputs):
    """Say whether a frame serves windows without the rows `gone` and the inputs `inputs`, which it was made without."""
    relations = zip(frame.used, frame.outer, frame.K, strict=True)
    return gone.isdisjoint(frame.inner) and not any(row[b] for used, j, row in relations if used and j not in gone for b in inputs)
