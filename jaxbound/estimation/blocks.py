"""Recordings side by side in blocks of one size, on all cores: what a block works on stays in the cache, more
recordings trace nothing.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from jaxbound.sets.floats.threads import inherited

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
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # compiled code runs outside the interpreter's lock
        return done + list(threads.map(inherited(job), others))
