"""Recordings side by side on the last axis of arrays, and in blocks of one size on all cores: a block's work
stays in the cache, more recordings trace nothing.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import jax
import numpy as np

from jaxbound.consistency.interface import Array
from jaxbound.sets.floats.threads import inherited

T = TypeVar("T")


def chosen(tree: T, lanes: np.ndarray) -> T:
    """Return some recordings of arrays, in the order of memory that all have."""
    some: T = jax.tree.map(lambda x: np.take(x, lanes, -1), tree)
    return some


def recordings_of(tree: T, count: int, numbers: np.ndarray) -> T:
    """Return recordings of the carry of `count`, of each of which as many entries follow each other; all of a
    number that they share.

    Args:
        numbers: of the recordings; one of a single recording is that of all.
    """

    def own(x: Array) -> np.ndarray:
        x = np.asarray(x)
        if not x.ndim:
            return x
        *lead, entries = x.shape
        each = entries // count
        rows = x.reshape(*lead, count, each)
        return np.take(rows, numbers % count, -2).reshape(*lead, len(numbers) * each)

    some: T = jax.tree.map(own, tree)
    return some


def repeated(tree: T, count: int) -> T:
    """Return arrays of `count` recordings: of one recording, as many copies."""
    copies: T = jax.tree.map(lambda x: np.repeat(x, count // x.shape[-1], -1), tree)
    return copies


def in_blocks(job: Callable[[np.ndarray], T], count: int, size: int) -> list[T]:
    """Return [job(numbers of recordings) for each block of `count` recordings]; the last one is repeated
    until its block is full.
    """
    starts = range(0, max(count, 1), size)
    first, *others = (np.minimum(np.arange(start, start + size), count - 1) for start in starts)
    done = [job(first)]  # compiled here, once
    if not others:
        return done
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # compiled code runs outside the interpreter's lock
        return done + list(threads.map(inherited(job), others))


def in_lanes(
    job: Callable[[np.ndarray], Sequence[np.ndarray]], count: int, size: int
) -> tuple[np.ndarray, ...]:
    """Return the arrays of `job`, recordings last, of all `count` recordings, from those of blocks."""
    parts = zip(*in_blocks(job, count, size), strict=True)
    return tuple(np.concatenate(part, -1)[..., :count] for part in parts)
