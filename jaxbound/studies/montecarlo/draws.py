"""Random numbers by counting: what is drawn depends on the key, the scenario and the step alone, never on how
the work is cut up.

Threefry-2x32 with 13 rounds, a function of 64 bits of key and 64 of counter that passes every test of
BigCrush at 13 rounds and upwards. Written for arrays over scenarios it is some 75 integer operations that the
compiler vectorises, for two draws of 32 bits.
Source: J. Salmon, M. Moraes, R. Dror, D. Shaw, *Parallel random numbers: as easy as 1, 2, 3*, SC 2011,
section 4.2.
"""

import jax
import jax.numpy as jnp
import numpy as np

__all__ = ["INPUTS", "ONSETS", "STEPS", "share", "threefry", "words"]

Array = jax.Array | np.ndarray
"""What a kernel is called with, or sees."""

ROTATIONS = (13, 15, 26, 6, 17, 29, 16, 24)
STEPS, INPUTS, ONSETS = np.uint32(0), np.uint32(2**31), np.uint32(3 * 2**30)
"""Where the counters of the unknowns of each step, of the levels of the inputs and of the onsets begin."""


def threefry(key: tuple[Array, Array], counter: tuple[Array, Array], rounds: int = 13) -> tuple[Array, Array]:
    """Return two arrays of 32 random bits.

    Args:
        key, counter: pairs of uint32 arrays that broadcast.
    """
    k0, k1 = key
    keys = k0, k1, k0 ^ k1 ^ np.uint32(0x1BD11BDA)
    a, b = counter[0] + k0, counter[1] + k1
    for r in range(rounds):
        left = ROTATIONS[r % 8]
        a = a + b
        b = ((b << np.uint32(left)) | (b >> np.uint32(32 - left))) ^ a
        if r % 4 == 3:
            j = r // 4 + 1
            a, b = a + keys[j % 3], b + (keys[(j + 1) % 3] + np.uint32(j))
    return a, b


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


def share(bits: Array, dtype: np.dtype, vertices: bool = False) -> Array:
    """Return numbers in [-1, 1] made of random bits: the middles of 2^32 equal parts, or -1 and 1 for
    `vertices`; symmetric about 0.
    """
    signed = jax.lax.bitcast_convert_type(bits, jnp.int32)
    if vertices:
        return jnp.where(signed < 0, -1, 1).astype(dtype)
    return signed.astype(dtype) * np.asarray(2.0**-31, dtype) + np.asarray(2.0**-32, dtype)
