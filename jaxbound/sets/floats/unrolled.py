"""Sums and extremes over a few rows, written out term by term: with the windows on the last axis the
compiler fuses them.

And what keeps it from fusing: `stored` and `apart` make a number one number for all its uses. No rule of the
compiler says so, its heuristics do: `probe` asks each time, the tests at several sizes.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from typing import TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.xla_metadata import set_xla_metadata

FEW = 8
"""Rows up to which a sum is written out; more are added in a loop, four at a time: it compiles to no more
with their number.
"""
TOGETHER = 4


Kernel = TypeVar("Kernel", bound=Callable[..., object])
Tree = TypeVar("Tree")


def stored(x: Tree) -> Tree:
    """Return x, divided by ones that the compiler takes for numbers: it stores a quotient, not to work it out
    for each of its uses again.

    (A barrier does not stop it from doing so, and a division by a broadcast becomes a product.)
    """
    with jax.named_scope("stored"):  # so that a test finds these quotients in what was compiled
        return jax.tree.map(lambda a: a / jnp.where(a == a, np.ones((), a.dtype), 0), x)


def apart(f: Kernel) -> Kernel:
    """Compile f as a function of its own: what it returns is stored.

    Within one function the compiler works a value out anew for each of its uses, which doubles at every step
    of a chain, and rounds it as it likes each time. An `optimization_barrier` does not keep it from that.
    """

    @jax.jit
    def compiled(*args):
        with set_xla_metadata(inlineable=None):  # f alone, not what it calls
            return f(*args)

    @wraps(f)
    def call(*args):
        with set_xla_metadata(inlineable="false"):
            return compiled(*args)

    return cast(Kernel, call)


def total(terms: Iterable[jax.Array]) -> jax.Array:
    """Return the sum of one or more terms, added up in order."""
    first, *rest = terms
    for x in rest:
        first = first + x
    return first


def most(rows: Sequence[jax.Array] | jax.Array) -> jax.Array:
    """Return the largest of the rows."""
    top = rows[0]
    for x in rows[1:]:
        top = jnp.maximum(top, x)
    return top


def largest(rows: Sequence[jax.Array] | jax.Array, one: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the largest of the rows and the first row that has it. one: N ones, traced, see `separation`."""
    top = most(rows) / one
    first = jnp.full_like(top, len(rows) - 1)
    for i in reversed(range(len(rows) - 1)):
        first = jnp.where(rows[i] == top, i, first)
    return top, (first / one).astype(jnp.int32)


def summed(
    term: Callable[..., jax.Array],
    *rows: jax.Array | np.ndarray,
    axes: Sequence[int] | None = None,
    few: int = FEW,
) -> jax.Array:
    """Return the sum of term(*row) over the rows of arrays, added up in order.

    Args:
        axes: along which each has its rows; the first. few: up to how many rows the sum is written out.
    """
    places = (0,) * len(rows) if axes is None else axes
    count = rows[0].shape[places[0]]

    def at(i):
        if isinstance(i, int):
            return term(
                *(
                    jax.lax.index_in_dim(x, i, axis, keepdims=False)
                    for x, axis in zip(rows, places, strict=True)
                )
            )
        take = lambda x, axis: jax.lax.dynamic_index_in_dim(
            x, i, axis, keepdims=False, allow_negative_indices=False
        )
        return term(*map(take, rows, places))

    whole = count // TOGETHER if count > few else 0
    so_far = at(0)
    if whole:
        add = lambda some, so_far: total([so_far, *(at(some * TOGETHER + i) for i in range(TOGETHER))])
        so_far = jax.lax.fori_loop(0, whole, add, jnp.zeros_like(so_far))
    return total([so_far, *(at(i) for i in range(max(whole * TOGETHER, not whole), count))])


def product(A: jax.Array | np.ndarray, x: jax.Array | np.ndarray, few: int = FEW) -> jax.Array:
    """Return A x (a, N) of a matrix (a, b) and rows (b, N), added up in order; few: as of `summed`."""
    if not A.shape[1]:
        return jnp.zeros((len(A), x.shape[1]), x.dtype)
    return summed(lambda column, row: column[:, None] * row[None], A, x, axes=(1, 0), few=few)


def highest(rows: jax.Array) -> jax.Array:
    """Return the largest of the rows (n, N); a NaN among them may be left out, so that no proof rests on
    it.
    """
    return most(rows) if len(rows) <= FEW else jnp.max(rows, 0)


def foremost(rows: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the largest of the rows (n, N), as `highest`, and the first row that has it."""
    top, numbers = highest(rows), jnp.arange(len(rows), dtype=jnp.int32)[:, None]
    return top, jnp.min(jnp.where(rows == top[None], numbers, len(rows) - 1), 0)
