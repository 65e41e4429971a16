"""Windows in blocks of one fixed size through one compiled kernel, so that recordings of any length share a compilation, on all devices."""

import math

import numpy as np

from jaxbound.consistency.devices import everywhere, on_devices
from jaxbound.sets.floats.probe import usable_devices
from jaxbound.sets.strips.separation import Frame
from jaxbound.sets.strips.strips import UNROLLED

__all__ = ["block_size", "in_blocks", "padded"]


def block_size(test):
    """Return how many windows a kernel takes at once: a fixed function of the shape of the test, whatever the recording."""
    if isinstance(test.shape, Frame):
        return 2**14
    return 2**16 if len(test.shape.h) <= UNROLLED else 2**14


def in_blocks(kernel, test, u, y, dtypes, warm_up, progress):
    """Run a kernel over all windows of (..., T, .) arrays and return one array (..., T) for each of its outputs."""
    shape, s = y.shape[:-1], test.horizon
    u, y = (x.reshape(math.prod(shape), x.shape[-1]) for x in (u, y))
    samples, block = len(y), block_size(test)
    outs = [_aligned(samples, d) for d in dtypes]
    for out, first in zip(outs, warm_up, strict=True):
        out[:s] = first
    starts = range(0, max(samples - s, 0), block)
    devices = usable_devices()[: None if len(starts) > 1 else 1]
    on_device, pending = everywhere(test, devices), []
    for i in range(0, len(starts), len(devices)):
        chosen = starts[i : i + len(devices)]
        blocks = [tuple(padded(x, start, min(start + block, samples - s) + s, block + s) for x in (u, y)) for start in chosen]
        pending.append((chosen, on_devices(kernel, on_device, blocks, devices)))
        if len(pending) > 2:
            _collect(outs, pending.pop(0), block, s, progress)
    for done in pending:
        _collect(outs, done, block, s, progress)
    outs = [out.reshape(shape) for out in outs]
    for out, first in zip(outs, warm_up, strict=True):
        out[..., :s] = first  # windows across the seam of two recordings
    return outs


def _collect(outs, done, block, s, progress):
    for start, values in zip(*done, strict=True):
        values = values if isinstance(values, tuple) else (values,)
        for out, value in zip(outs, values, strict=True):
            rest = out[start + s : start + s + block]
            rest[:] = np.asarray(value)[: len(rest)]
        if progress is not None:
            progress(min(start + s + block, len(outs[0])) / len(outs[0]))


def padded(x, start, stop, length):
    """Return rows start..stop, filled up with NaN to a fixed length."""
    part = x[start:stop]
    return part if len(part) == length else np.concatenate([part, np.full((length - len(part), x.shape[1]), np.nan, x.dtype)])


def _aligned(count, dtype):
    """Return an uninitialised array that a CPU device can adopt without a copy."""
    size = count * np.dtype(dtype).itemsize
    raw = np.empty(size + 64, np.uint8)
    start = -raw.ctypes.data % 64
    return raw[start : start + size].view(dtype)
