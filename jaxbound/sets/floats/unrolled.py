"""Sums and extremes over a few rows, written out term by term: with the windows on the last axis the compiler fuses them."""

from collections.abc import Iterable, Sequence
from typing import TypeVar

import jax
import jax.numpy as jnp

__all__ = ["largest", "most", "stored", "total"]


Tree = TypeVar("Tree")


def stored(x: Tree) -> Tree:
    """Return x, divided by ones that the compiler takes for numbers: it stores a quotient, not to work it out for each of its uses again.

    (A barrier does not stop it from doing so, and a division by a broadcast becomes a product.)
    """
    return jax.tree.map(lambda a: a / jnp.where(a == a, jnp.ones((), a.dtype), 0), x)


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
