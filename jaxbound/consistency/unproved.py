"""Margins without proof: those of the verdicts, and differentiable ones where something is traced."""

import math
from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.drive import raw_outputs
from jaxbound.consistency.interface import Array, LinearTest, WindowReading
from jaxbound.consistency.reading import Reading
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.equations import is_traced
from jaxbound.sets.strips.separation import Frame
from jaxbound.sets.strips.strips import UNROLLED, Strips

Smooth: TypeAlias = Callable[[Reading, jax.Array, jax.Array], jax.Array]
"""Margins (N,) of the windows of a stretch (reading, u, y), to be differentiated."""


def stretch_block(reading: Reading) -> int:
    """Return how many windows a kernel takes at once from contiguous samples: a function of the shape of the
    test alone.
    """
    shape = reading.shape
    if isinstance(shape, Strips) and shape.supports is None:
        return 2**12  # their rows are arrays, which should stay in the cache: twice as fast as 2**14
    if isinstance(shape, Frame) or len(shape.h) > UNROLLED:
        return 2**14
    return 2**17  # to start a block takes as long as some 10^4 windows of it; a short recording fills one


def unproved_margins(test: LinearTest, smooth: Smooth, given: Recording) -> jax.Array:
    """Return the margins (..., T) of windows; see `WindowTest.margins`. smooth: of u (N + s, m), y (N + s,
    p).
    """
    margins: jax.Array
    if not is_traced(given.u, given.y, test.reading):
        # margins are the last of the arrays, be there a status before them or not
        *_, on_host = raw_outputs(test.measured(), given)
        margins = jax.device_put(on_host)
        return margins
    margins = _whole(smooth, test.reading, given.u, given.y, _gone(given, test.horizon))
    return margins


@partial(jax.jit, static_argnums=0)
def _whole(kernel: Smooth, reading: Reading, u: jax.Array, y: jax.Array, gone: np.ndarray) -> jax.Array:
    """Return the margins (..., T) of recordings u (..., T, m), y (..., T, p), NaN where `gone` (T,): one
    program, none op by op.
    """
    # laid end to end: -1 in place of the count would not do without inputs
    count = math.prod(y.shape[:-1])
    margin = kernel(reading, u.reshape(count, u.shape[-1]), y.reshape(count, y.shape[-1]))
    margin = jnp.pad(margin, (reading.horizon, 0)).reshape(y.shape[:-1])
    return jnp.where(gone.reshape((1,) * (y.ndim - 2) + gone.shape), jnp.nan, margin)


def over_blocks(
    margins: Callable[[jax.Array, jax.Array], jax.Array],
    reading: WindowReading,
    u: jax.Array,
    y: jax.Array,
    starts: Array,
    size: int,
) -> jax.Array:
    """Return the margins of windows u (lags, m, size), y (s + 1, p, size), of all that start at some samples
    of u (T, m), y (T, p), block after block.
    """
    # the last window again and again: blocks of one size are one program
    filled = jnp.pad(starts, (0, -len(starts) % size), mode="edge").reshape(-1, size)

    def taken(x: jax.Array, first: jax.Array, lags: int) -> jax.Array:
        return jnp.moveaxis(x[first[None] + np.arange(lags)[:, None]], 1, 2)

    def one_block(first: jax.Array) -> jax.Array:
        return margins(taken(u, first, reading.lags), taken(y, first, reading.horizon + 1))

    found: jax.Array = jax.lax.map(one_block, filled)
    return found.reshape(-1)[: len(starts)]


def within(margin: jax.Array, given: Recording, horizon: int) -> jax.Array:
    """Return margins (..., T) with NaN at samples at which no window of a recording ends."""
    return margin.at[..., np.flatnonzero(_gone(given, horizon))].set(jnp.nan)


def _gone(given: Recording, horizon: int) -> np.ndarray:
    """Say at which samples (T,) no window of a recording ends."""
    return given.across(horizon) | (np.arange(given.y.shape[-2]) < horizon)
