"""Margins without proof: those of the verdicts, and differentiable ones where something is traced."""

import math
from collections.abc import Callable
from functools import partial
from typing import Protocol, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.drive import raw_outputs
from jaxbound.consistency.interface import Array, LinearTest
from jaxbound.consistency.reading import Reading
from jaxbound.recordings.recording import Recording
from jaxbound.sets.strips.separation import Frame
from jaxbound.sets.strips.strips import UNROLLED, Strips

__all__ = ["is_traced", "stretch_block", "unproved_margins", "within"]

Search: TypeAlias = Callable[[Reading, jax.Array, jax.Array], jax.Array]


class Smooth(Protocol):
    """Margins (N,) of the windows of a stretch, to be differentiated."""

    def __call__(self, reading: Reading, u: jax.Array, y: jax.Array, /, *found: jax.Array) -> jax.Array:
        """Return the margins; found: the result of a search, if there is one."""


def is_traced(*trees: object) -> bool:
    """Return whether anything in these PyTrees is traced."""
    return any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(trees))


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


QUICK = {"xla_cpu_use_fusion_emitters": False}
"""XLA's former way to write loops for a CPU: a search compiles in half of the time and runs as fast. No proof
rests on what runs so. jaxlib 0.12 no longer has it; kernels that prove would run up to 44 % slower.
"""


def unproved_margins(
    test: LinearTest, smooth: Smooth, given: Recording, search: Search | None = None
) -> jax.Array:
    """Return the margins (..., T) of windows; see `WindowTest.margins`.

    Args:
        smooth: of (reading, u (N + s, m), y (N + s, p)), to be differentiated. search: of the same arguments,
            returns an array that smooth takes last and nothing is differentiated through: compiled alone,
            once for values and derivatives.
    """
    margins: jax.Array
    reading = test.reading
    if not is_traced(given.u, given.y, reading):
        *_, on_host = raw_outputs(test.measured(), given.u, given.y, given.starts)
        margins = jax.device_put(on_host)
        return margins
    found = []
    if search is not None:
        found.append(_searched(search, reading, given.u, given.y))
    margins = _whole(smooth, reading, given.u, given.y, _gone(given, test.horizon), *found)
    return margins


@partial(jax.jit, static_argnums=0)
def _whole(
    kernel: Smooth, reading: Reading, u: jax.Array, y: jax.Array, gone: np.ndarray, *found: jax.Array
) -> jax.Array:
    """Return the margins (..., T) of recordings u (..., T, m), y (..., T, p), NaN where `gone` (T,): one
    program, none op by op.
    """
    shape = y.shape[:-1]
    margin = jnp.pad(kernel(reading, *_flat(u, y), *found), (reading.horizon, 0)).reshape(shape)
    return jnp.where(gone.reshape((1,) * (y.ndim - 2) + gone.shape), jnp.nan, margin)


def _searched(search: Search, reading: Reading, u: Array, y: Array) -> jax.Array:
    """Return the result of a search as constants for a derivative: where jax.grad alone traces, they are
    numbers.
    """
    arguments = jax.tree.map(_constant, (reading, u, y))
    best: jax.Array
    if is_traced(arguments):
        best = _alone(search, *arguments)
        return best
    try:
        best = _alone_quickly(search, *arguments)
    except jax.errors.JaxRuntimeError as refused:
        if "compile option" not in str(refused):  # of another jaxlib, or another device
            raise
        best = _alone(search, *arguments)
    return best


def _constant(x: Array) -> Array:
    """Return an array through which nothing is differentiated."""
    return jax.lax.stop_gradient(x) if is_traced(x) else x


def _search_flat(search: Search, reading: Reading, u: jax.Array, y: jax.Array) -> jax.Array:
    return search(reading, *_flat(u, y))


_alone = jax.jit(_search_flat, static_argnums=0)
_alone_quickly = jax.jit(_search_flat, static_argnums=0, compiler_options=QUICK)  # only as the outermost jit


def _flat(u: jax.Array, y: jax.Array) -> list[jax.Array]:
    """Return samples (..., T, n) laid end to end."""
    return [x.reshape(math.prod(y.shape[:-1]), x.shape[-1]) for x in (u, y)]


def within(margin: jax.Array, given: Recording, horizon: int) -> jax.Array:
    """Return margins (..., T) with NaN at samples at which no window of a recording ends."""
    return margin.at[..., np.flatnonzero(_gone(given, horizon))].set(jnp.nan)


def _gone(given: Recording, horizon: int) -> np.ndarray:
    """Say at which samples (T,) no window of a recording ends."""
    return given.across(horizon) | (np.arange(given.y.shape[-2]) < horizon)
