"""Threefry-2x32: random numbers as a cipher of a count, the same in NumPy and in a compiled kernel.

The authors' tests of BigCrush pass from 13 rounds on; `jax.random` uses 20. Written for arrays, 13 rounds are
some 75 integer operations that the compiler vectorises, for two words of 32 bits.
Source: J. Salmon, M. Moraes, R. Dror, D. Shaw, *Parallel random numbers: as easy as 1, 2, 3*, SC 2011,
section 4.2.
"""

import jax
import numpy as np

Array = jax.Array | np.ndarray
"""What a kernel is called with, or sees."""

JAX_ROUNDS = 20
"""Rounds with which `jax.random` draws."""
ROTATIONS = (13, 15, 26, 6, 17, 29, 16, 24)
PARITY = np.uint32(0x1BD11BDA)


def threefry(key: tuple[Array, Array], counter: tuple[Array, Array], rounds: int = 13) -> tuple[Array, Array]:
    """Return two arrays of 32 random bits.

    Args:
        key, counter: pairs of uint32 arrays that broadcast.
    """
    k0, k1 = key
    keys = k0, k1, k0 ^ k1 ^ PARITY
    a, b = counter[0] + k0, counter[1] + k1
    for r in range(rounds):
        left = ROTATIONS[r % 8]
        a = a + b
        b = ((b << np.uint32(left)) | (b >> np.uint32(32 - left))) ^ a
        if r % 4 == 3:  # the key goes in again after every fourth round
            j = r // 4 + 1
            a, b = a + keys[j % 3], b + (keys[(j + 1) % 3] + np.uint32(j))
    return a, b
