"""The random numbers of a simulation: drawn on the host where they are few, by a compiled program where they
are many; the same ones.

What `jax.random` draws with its default keys is a cipher of a count, Threefry. Compiling it takes longer than
a simulation does: a few numbers are worked out by NumPy instead, bit for bit the same.
"""

from functools import partial
from typing import Any

import jax
import numpy as np

from jaxbound.random.threefry import JAX_ROUNDS, threefry

__all__ = ["normal_draws", "uniform_draws"]

FEW = 2**18
"""Numbers up to which the host draws them: some ten milliseconds."""


def uniform_draws(
    key: jax.Array, streams: tuple[int, ...], recordings: int, size: int, dtype: np.dtype
) -> Any:
    """Return draws (streams, recordings, size), uniform in [-1, 1), on the host but inside jit.

    More recordings, and longer ones, begin with the same numbers.
    """
    if isinstance(key, jax.core.Tracer):
        return _compiled(key, np.array(streams), recordings, size, dtype)
    if len(streams) * recordings * size <= FEW and _is_threefry(key):
        return _drawn(np.asarray(jax.random.key_data(key)), streams, recordings, size, dtype)
    return np.asarray(_compiled(key, np.array(streams), recordings, size, dtype))


def normal_draws(key: jax.Array, recordings: int, shape: tuple[int, int], dtype: np.dtype) -> Any:
    """Return draws (recordings, *shape) of a standard normal distribution."""
    if not shape[1]:
        return np.zeros((recordings, *shape), dtype)
    drawn = _normal(key, recordings, shape, dtype)
    return drawn if isinstance(key, jax.core.Tracer) else np.asarray(drawn)


def _is_threefry(key):
    """Return whether `jax.random` draws with this key as `_drawn` does."""
    partitionable = jax.config.jax_threefry_partitionable  # type: ignore[attr-defined]  # jax makes an attribute of each option
    return partitionable and jax.random.key_impl(key) == "threefry2x32"


def _drawn(key, streams, recordings, size, dtype):
    """Draw the same numbers as `_compiled`, on the host."""
    count = np.arange(max(recordings, size), dtype=np.uint32)
    k0, k1 = threefry((key[:1], key[1:]), (count[:1] * 0, count[:recordings]), JAX_ROUNDS)
    stream = np.array(streams, np.uint32)[:, None]
    k0, k1 = threefry((k0, k1), (stream * 0, stream), JAX_ROUNDS)
    high, low = threefry((k0[..., None], k1[..., None]), (count[:1] * 0, count[:size]), JAX_ROUNDS)
    if dtype == np.float64:
        bits = (high.astype(np.uint64) << np.uint64(32) | low) >> np.uint64(12) | np.uint64(
            0x3FF
        ) << np.uint64(52)
    else:
        bits = (high ^ low) >> np.uint32(9) | np.uint32(0x3F800000)
    return (bits.view(dtype) - 1) * 2 - 1  # a number in [1, 2) of random digits, moved


@partial(jax.jit, static_argnums=(2, 3, 4))
def _compiled(key, streams, recordings, size, dtype):
    keys = jax.random.split(key, recordings)
    keys = jax.vmap(lambda stream: jax.vmap(lambda k: jax.random.fold_in(k, stream))(keys))(streams)
    return jax.vmap(jax.vmap(lambda k: jax.random.uniform(k, (size,), dtype, -1, 1)))(keys)


@partial(jax.jit, static_argnums=(1, 2, 3))
def _normal(key, recordings, shape, dtype):
    return jax.vmap(lambda k: jax.random.normal(jax.random.fold_in(k, 4), shape, dtype))(
        jax.random.split(key, recordings)
    )
