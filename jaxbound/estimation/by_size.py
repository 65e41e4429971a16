"""Orders of numbers >= 0 on the last digits of their keys: one sort of integers, no pairs, no ties."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats.sizes import power

__all__ = ["ascending"]


def ascending(sizes: jax.Array) -> jax.Array:
    """Return the numbers of the rows of sizes (Q, N) >= 0, the smallest first, for each of N."""
    # floats >= 0 are ordered as their bits are; the last digits count the rows
    bits, below = np.dtype(f"i{sizes.dtype.itemsize}").type, power(len(sizes)) - 1
    key = jax.lax.bitcast_convert_type(sizes, bits) & bits(~below)
    order: jax.Array = jnp.sort(key | jnp.arange(len(sizes), dtype=bits)[:, None], 0) & bits(below)
    return order
