"""A device that nobody examined, and that lies: what it hands back is corrupted at random.

The lies depend on what the device was given and on nothing else, so that one device and eight tell the same.
"""

import contextlib
import threading
import zlib
from unittest.mock import patch

import jax
import numpy as np

from jaxbound.consistency import drive, searched
from jaxbound.sets.floats import kernel, probe
from jaxbound.sets.floats.status import Status

CARD = {"platform": "NVIDIA", "capability": "99.0", "driver": "of next year", "jaxlib": "0"}


@contextlib.contextmanager
def unexamined():
    """Let the devices of this process be cards that nobody examined, but for a CPU that is asked for by
    `jax.default_device`.
    """
    doubt, kind = probe._doubt, probe.kind_of_device

    def card(device):
        return kind(device) if probe.default_device() is not None else CARD

    def doubted(device):
        return doubt(device) if probe.default_device() is not None else "nobody has examined it"

    with (
        patch.object(probe, "_doubt", doubted),
        patch.object(probe, "is_cpu_default", lambda: False),
        patch.object(probe, "kind_of_device", card),
        patch.object(searched, "kind_of_device", card),
    ):
        yield


class Lies:
    """What a device makes of its results. Fields: share: of numbers that are wrong; seed; told: how many."""

    def __init__(self, share=0.2, seed=0):
        self.share, self.seed, self.told = share, seed, 0

    def about(self, given, result):
        """Return the results of a kernel with lies among them."""
        digest = self.seed
        for x in jax.tree.leaves(given):
            digest = zlib.crc32(np.ascontiguousarray(x).tobytes(), digest)
        rng = np.random.default_rng(digest)
        return jax.tree.map(lambda x: self._array(rng, np.array(x)), result)

    def _array(self, rng, x):
        if x.size > 1 and rng.random() < 0.1:  # another part of the array was copied
            return np.roll(x, int(rng.integers(x.size)), -1)
        wrong = rng.random(x.shape) < self.share
        if not x.ndim:
            return x  # how long to search, say: a lie there costs time alone
        self.told += int(wrong.sum())
        if x.dtype == np.int8:
            return np.where(wrong, rng.integers(0, len(Status), x.shape).astype(np.int8), x)
        if x.dtype == bool:
            return x ^ wrong
        if np.issubdtype(x.dtype, np.integer):
            return np.where(wrong, np.flip(x), x)
        with np.errstate(over="ignore"):
            lie = -x * rng.lognormal(0, 2, x.shape)
        lie = np.where(rng.random(x.shape) < 0.1, np.nan, lie)
        return np.where(wrong, lie, x).astype(x.dtype)


@contextlib.contextmanager
def lying(share=0.2, seed=0):
    """Let all devices lie but the CPU that is asked for by name; yields the `Lies`."""
    lies, call, spread = Lies(share, seed), kernel.Kernel.__call__, drive.on_devices
    placed = drive.everywhere

    def called(program, *args, **kwargs):
        out = call(program, *args, **kwargs)
        traced = any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(out))
        if traced or _proves() or kernel.is_outside_xla() or getattr(_within, "spread", False):
            return out
        return lies.about((args, kwargs), out)

    def on_devices(program, constants, blocks, devices, axis=0):
        _within.spread = True
        try:
            found = spread(program, constants, blocks, devices, axis)
        finally:
            _within.spread = False
        if _proves() or kernel.is_outside_xla():
            return found
        return [lies.about(block, x) for block, x in zip(blocks, found, strict=True)]

    def everywhere(constants, devices):
        if _proves():
            return placed(constants, devices)
        return placed(lies.about((), constants), devices)

    with (
        patch.object(kernel.Kernel, "__call__", called),
        patch.object(drive, "everywhere", everywhere),
        patch.object(drive, "on_devices", on_devices),
    ):
        yield lies


def _proves():
    """Say whether the CPU was asked for by name; a thread of the driver does so too, but it searches."""
    return probe.default_device() is not None and not probe.is_searching()


_within = threading.local()
