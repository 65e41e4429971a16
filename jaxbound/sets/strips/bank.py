"""Many strips, each with a verdict of its own: which relations of a bank hold, in one pass over the samples.

The test of each strip is that of `strips`. Verdicts are packed, two bits each, and travel with the margin in
one complex number: a kernel with two results does its work twice.
"""

from collections.abc import Iterable
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.sets.floats.status import Status

PACKED = 16
"""Statuses in a word of 32 bits."""
Tested: TypeAlias = Iterable[tuple[jax.Array, jax.Array, jax.Array]]
"""(residual, width, error bound of their comparison), (N,) each, of every strip; NaN in the last where data
are missing."""


def bank_verdicts(tested: Tested, like: jax.Array) -> tuple[jax.Array, ...]:
    """Return the proved Status of each strip alone and the margin of the tightest one, packed as `unpacked`
    reads it.

    like: (N,), of the type of results.
    """
    words: list[jax.Array] = []
    gauge = jnp.full_like(like, -1)
    for c, (residual, width, error) in enumerate(tested):
        size, absent = jnp.abs(residual), jnp.isnan(error)
        fault, holds = size - width > error, width - size > error
        code = (jnp.where(fault, 3, 0) | jnp.where(holds, 1, 0)).astype(
            jnp.uint32
        )  # both comparisons are false for NaN
        code = jnp.where(
            code == 0, jnp.where(absent, jnp.uint32(Status.MISSING), jnp.uint32(Status.UNDECIDED)), code
        )
        code <<= np.uint32(2 * (c % PACKED))
        words = [*words, code] if c % PACKED == 0 else [*words[:-1], words[-1] | code]
        ratio = jnp.where(jnp.abs(size - width) > error, size / width, 1)
        gauge = jnp.maximum(gauge, jnp.where(absent, -1, ratio))
    margin = jnp.where(gauge < 0, jnp.nan, 1 - gauge)
    bits = words[0].astype(_bits(margin.dtype))
    return jax.lax.complex(margin, jax.lax.bitcast_convert_type(bits, margin.dtype)), *words[1:]


def unpacked(first: np.ndarray, *others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the words (words, ...) uint32, strip c in two bits of word c // PACKED, and the margins (...),
    its sign as proved.
    """
    word = np.ascontiguousarray(first.imag).view(_bits(first.real.dtype)).astype(np.uint32)
    return np.stack([word, *others]), np.ascontiguousarray(first.real)


def verdict_dtypes(count: int, dtype: DTypeLike) -> tuple[DTypeLike, ...]:
    """Return the dtypes of what `bank_verdicts` gives of so many strips, for samples of a dtype."""
    return (np.result_type(dtype, np.complex64), *[np.uint32] * (-(-count // PACKED) - 1))


def _bits(dtype: DTypeLike) -> type[np.unsignedinteger]:
    sizes: dict[int, type[np.unsignedinteger]] = {4: np.uint32, 8: np.uint64}
    return sizes[np.dtype(dtype).itemsize]
