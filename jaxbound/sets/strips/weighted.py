"""Least squares with weights of each window's own: many small systems with one matrix side by side.

    (A' W_n A) x_n = b_n,    n = 1..N,    A (r, k) the same, W_n diagonal

is factorised as L D L' column by column. Windows are the last axis. Nothing is proved: whoever uses a
solution takes it for a guess.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats.unrolled import product, stored

TERMS = 48
"""Terms of a sum that are written out in a search."""


class Factor(NamedTuple):
    """L D L' of N matrices: columns (k, k, N), column j of L below its diagonal, D on it, 0 above."""

    columns: jax.Array


def factored(A: jax.Array, weights: jax.Array) -> Factor:
    """Return the Factor of A' diag(weights) A, A (r, k) and weights (r, N) > 0."""
    k = A.shape[1]
    i, j = np.tril_indices(k)
    entries = stored(product((A[:, i] * A[:, j]).T, weights, TERMS))
    place = np.zeros((k, k), int)
    place[i, j] = place[j, i] = np.arange(len(i))
    row = np.arange(k)[:, None]

    def column(c: jax.Array, columns: jax.Array) -> jax.Array:
        def less(j: jax.Array, left: jax.Array) -> jax.Array:
            own = columns[j]
            return left - own * (_entry(own, c) * _entry(own, j))

        left = jax.lax.fori_loop(0, c, less, columns[c])
        below = jnp.where(row > c, left / _entry(left, c), jnp.where(row == c, left, 0))
        return jax.lax.dynamic_update_index_in_dim(columns, below, c, 0)

    return Factor(jax.lax.fori_loop(0, k, column, entries[place]))


def solved(factor: Factor, b: jax.Array) -> jax.Array:
    """Return the solutions (k, N) of right sides b (k, N)."""
    columns = factor.columns
    k = len(columns)
    row = np.arange(k)[:, None]

    def forward(c: jax.Array, x: jax.Array) -> jax.Array:
        return x - jnp.where(row > c, columns[c], 0) * _entry(x, c)

    def backward(done: jax.Array, x: jax.Array) -> jax.Array:
        c = k - 1 - done
        later = jnp.sum(jnp.where(row > c, columns[c], 0) * x, 0)
        return jax.lax.dynamic_update_index_in_dim(x, _entry(x, c)[0] - later, c, 0)

    x = jax.lax.fori_loop(0, k, forward, b) / jnp.stack([columns[i, i] for i in range(k)])
    return stored(jax.lax.fori_loop(0, k, backward, x))


def _entry(x: jax.Array, i: jax.Array) -> jax.Array:
    """Return row i of x (k, N), as (1, N)."""
    return jax.lax.dynamic_index_in_dim(x, i, 0)
