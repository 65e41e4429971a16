"""Keys of random numbers: a whole number will do as well as a key."""

from typing import cast

import jax
import numpy as np


def key_of(seed: jax.Array | int) -> jax.Array:
    """Return a jax.random key of a whole number, and a key as it is.

    Raises:
        TypeError: neither.

    Example:
        >>> bool(jax.random.key_data(key_of(3))[1] == 3)
        True
    """
    if isinstance(seed, int | np.integer) and not isinstance(seed, bool):
        return jax.random.key(seed)
    if not hasattr(seed, "dtype") or not hasattr(seed, "shape"):
        raise TypeError(f"key must be a jax.random key or a whole number, not {type(seed).__name__}")
    return cast(jax.Array, seed)
