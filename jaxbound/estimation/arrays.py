"""Arrays that a kernel takes: of JAX while it is traced, of NumPy on the host."""

from typing import TypeAlias

import jax
import numpy as np

__all__ = ["Array"]

Array: TypeAlias = jax.Array | np.ndarray
