"""Random numbers of a study: drawn by the key, the scenario and the step alone, never by how the work is cut.

Each call of Threefry, with 13 rounds, gives two words of 32 random bits for every scenario.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.random.threefry import Array, threefry

STEPS, INPUTS, ONSETS = np.uint32(0), np.uint32(2**31), np.uint32(3 * 2**30)
"""Where the counters of the unknowns of each step, of the levels of the inputs and of the onsets begin."""


def words(key: tuple[Array, Array], numbers: Array, first: Array | np.uint32, count: int) -> list[Array]:
    """Return `count` arrays of 32 random bits, of the shape of `numbers` (uint32, of the scenarios), from the
    counter `first` on.
    """
    out: list[Array] = []
    for i in range(-(-count // 2)):
        out += threefry(
            key, (numbers, jnp.zeros_like(numbers) + (jnp.asarray(first, jnp.uint32) + np.uint32(i)))
        )
    return out[:count]


def numbers_from_bits(bits: Array, dtype: np.dtype, vertices: bool = False) -> Array:
    """Return numbers in [-1, 1] made of random bits: the middles of 2^32 equal parts, or -1 and 1 for
    `vertices`; symmetric about 0.
    """
    signed = jax.lax.bitcast_convert_type(bits, jnp.int32)
    if vertices:
        return jnp.where(signed < 0, -1, 1).astype(dtype)
    return signed.astype(dtype) * np.asarray(2.0**-31, dtype) + np.asarray(2.0**-32, dtype)
