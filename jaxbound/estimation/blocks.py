"""Recordings side by side in blocks of one size, on all cores: what a block works on stays in the cache, more
recordings trace nothing.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import jax
import numpy as np

from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla

__all__ = ["in_blocks"]

T = TypeVar("T")


def in_blocks(job: Callable[[np.ndarray], T], count: int, size: int) -> list[T]:
    """Return [job(numbers of recordings) for each block of `count` recordings]; the last one is repeated
    until its block is full.
    """
    first, *others = (np.minimum(np.arange(a, a + size), count - 1) for a in range(0, max(count, 1), size))
    done = [job(first)]  # compiled here, once
    if not others:
        return done
    wide, outside = (
        bool(jax.dtypes.canonicalize_dtype(float) == np.float64),
        is_outside_xla(),
    )  # of this thread, perhaps

    def beside(block):
        with jax.enable_x64(wide), outside_xla(outside):
            return job(block)

    with ThreadPoolExecutor(os.cpu_count()) as threads:  # compiled code runs outside the interpreter's lock
        return done + list(threads.map(beside, others))
