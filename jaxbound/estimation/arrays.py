"""Arrays in the PyTrees of kernels: of JAX while a kernel is traced, of NumPy on the host.

One PyTree serves both, so that its fields have no narrower type: a union would have to be narrowed at every
    use.
"""

from typing import Any, TypeAlias

__all__ = ["Array"]

Array: TypeAlias = Any
