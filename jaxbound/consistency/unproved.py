"""Margins without proof, of contiguous samples: the fast path of `margins`, differentiable where something is traced."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.drive import drive
from jaxbound.consistency.interface import WindowTest
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.probe import usable_devices
from jaxbound.sets.strips.separation import Frame
from jaxbound.sets.strips.strips import UNROLLED

__all__ = ["is_traced", "stretch_block", "unproved_margins", "within"]


def is_traced(*trees: Any) -> bool:
    """Return whether anything in these PyTrees is traced."""
    return any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(trees))


def stretch_block(reading: Any) -> int:
    """Return how many windows a kernel takes at once from contiguous samples: a function of the shape of the test alone."""
    return 2**16 if not isinstance(reading.shape, Frame) and len(reading.shape.h) <= UNROLLED else 2**14


def unproved_margins(test: WindowTest, kernel: Callable, given: Recording) -> jax.Array:
    """Return the margins (..., T) that a jitted kernel(reading, u (N + s, m), y (N + s, p)) gives; see `WindowTest.margins`."""
    reading, devices = test.reading, usable_devices()
    if not is_traced(given.u, given.y, reading) and (devices[0].platform == "cpu" or len(devices) > 1):
        return jax.device_put(drive(_Unproved(test, kernel), given))
    shape = given.y.shape[:-1]
    u, y = (jnp.asarray(x).reshape(math.prod(shape), x.shape[-1]) for x in (given.u, given.y))
    return within(jnp.pad(kernel(reading, u, y), (test.horizon, 0), constant_values=jnp.nan).reshape(shape), given, test.horizon)


def within(margin: jax.Array, given: Recording, horizon: int) -> jax.Array:
    """Return margins (..., T) with NaN at samples at which no window of a recording ends."""
    gone = given.across(horizon) | (np.arange(margin.shape[-1]) < horizon)
    return margin.at[..., np.flatnonzero(gone)].set(jnp.nan)


class _Unproved(WindowTest):
    """Gives margins alone."""

    gathered = False

    def __init__(self, test, kernel):
        super().__init__(test.relations, test.method, test.dtype)
        self.reading, self.kernel = test.reading, kernel

    @property
    def block(self):
        return stretch_block(self.reading)

    @property
    def outputs(self):
        return ((self.dtype, np.nan),)

    def judge(self, run, blocks):
        return [(margin,) for margin in run(self.kernel, blocks)]

    def judged(self, outs):
        return outs[0]
