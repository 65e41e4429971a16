"""The random numbers of a simulation: drawn on the host where they are few, by a compiled program where they
are many; the same ones.

What `jax.random` draws with its default keys is a cipher of a count, Threefry. Compiling it takes longer than
a simulation does: a few numbers are worked out by NumPy instead, bit for bit the same.
"""

from functools import partial
from typing import cast

import jax
import numpy as np

from jaxbound.random.threefry import JAX_ROUNDS, Array, threefry

FEW = 2**18
"""Numbers up to which the host draws them: some ten milliseconds."""


def uniform_draws(
    key: jax.Array, streams: tuple[int, ...], recordings: int, size: int, dtype: np.dtype
) -> Array:
    """Return draws (streams, recordings, size), uniform in [-1, 1), on the host but inside jit.

    More recordings, and longer ones, begin with the same numbers.
    """
    within = isinstance(key, jax.core.Tracer)
    if not within and len(streams) * recordings * size <= FEW and _is_threefry(key):
        return _drawn(np.asarray(jax.random.key_data(key)), streams, recordings, size, dtype)
    drawn: jax.Array = _compiled(key, np.array(streams), recordings, size, dtype)
    return drawn if within else np.asarray(drawn)


def normal_draws(key: jax.Array, recordings: int, shape: tuple[int, int], dtype: np.dtype) -> Array:
    """Return draws (recordings, *shape) of a standard normal distribution."""
    if not shape[1]:
        return np.zeros((recordings, *shape), dtype)
    drawn: jax.Array = _normal(key, recordings, shape, dtype)
    if isinstance(key, jax.core.Tracer):
        return drawn
    return np.asarray(drawn)


def _is_threefry(key: jax.Array) -> bool:
    """Return whether `jax.random` draws with this key as `_drawn` does."""
    # jax makes an attribute of each option
    partitionable: bool = jax.config.jax_threefry_partitionable  # type: ignore[attr-defined]
    return partitionable and jax.random.key_impl(key) == "threefry2x32"


def _drawn(
    key: np.ndarray, streams: tuple[int, ...], recordings: int, size: int, dtype: np.dtype
) -> np.ndarray:
    """Draw the same numbers as `_compiled`, on the host."""
    count = np.arange(max(recordings, size), dtype=np.uint32)
    k0, k1 = threefry((key[:1], key[1:]), (count[:1] * 0, count[:recordings]), JAX_ROUNDS)
    stream = np.array(streams, np.uint32)[:, None]
    k0, k1 = threefry((k0, k1), (stream * 0, stream), JAX_ROUNDS)
    words = threefry((k0[..., None], k1[..., None]), (count[:1] * 0, count[:size]), JAX_ROUNDS)
    high, low = cast("tuple[np.ndarray, np.ndarray]", words)  # of arrays of the host
    if dtype == np.float64:
        # 52 random bits behind the exponent of 1: a float in [1, 2)
        word = high.astype(np.uint64) << np.uint64(32) | low
        bits = word >> np.uint64(12) | np.uint64(0x3FF) << np.uint64(52)
    else:
        bits = (high ^ low) >> np.uint32(9) | np.uint32(0x3F800000)
    between: np.ndarray = bits.view(dtype)  # numbers in [1, 2) of random digits
    return (between - 1) * 2 - 1


@partial(jax.jit, static_argnums=(2, 3, 4))
def _compiled(key: jax.Array, streams: Array, recordings: int, size: int, dtype: np.dtype) -> jax.Array:
    keys = jax.random.split(key, recordings)
    keys = jax.vmap(lambda stream: jax.vmap(lambda k: jax.random.fold_in(k, stream))(keys))(streams)
    return jax.vmap(jax.vmap(lambda k: jax.random.uniform(k, (size,), dtype, -1, 1)))(keys)


@partial(jax.jit, static_argnums=(1, 2, 3))
def _normal(key: jax.Array, recordings: int, shape: tuple[int, int], dtype: np.dtype) -> jax.Array:
    def drawn(one: jax.Array) -> jax.Array:
        return jax.random.normal(jax.random.fold_in(one, 4), shape, dtype)

    return jax.vmap(drawn)(jax.random.split(key, recordings))
