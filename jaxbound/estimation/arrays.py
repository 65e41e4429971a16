"""Arrays in the PyTrees of kernels: of JAX while a kernel is traced, of NumPy on the host."""

from typing import TypeAlias

import jax
import numpy as np

Array: TypeAlias = np.ndarray | jax.Array
