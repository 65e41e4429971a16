"""Numbers to tune by, for models with uncertain parameters: how far out a window is. No
proofs.

The margin is that of the joint test, 1 - t with t = min { max_j |z_j| : c + G z = 0 } = max over h of |h c| /
sum_j |h g_j|. Its derivative is that of a linear program, h (dc + dG z) / sum_j |h g_j| with both optima
held.
"""

import math
from collections.abc import Callable, Iterable
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.interface import Array
from jaxbound.consistency.parametric_windows import (
    at_vertices,
    block_of,
    cases,
    judged_by,
    on_whole,
    samples_of,
    terms_of,
)
from jaxbound.consistency.polynomial_reading import PolynomialReading, PolynomialRelations
from jaxbound.consistency.unproved import is_traced
from jaxbound.sets.strips import polynomials, varying

__all__ = ["parametric_margins"]

Measure: TypeAlias = Callable[[PolynomialReading, Array, Array, str], jax.Array]
"""Of (reading, u (lags, m, N), y (s + 1, p, N), kind): a number (N,) for each window."""


def parametric_margins(relations: PolynomialRelations, u: Array, y: Array) -> jax.Array:
    """Return the unproved margins (..., T), NaN where a window has no usable data. See `consistency.margins`.

    Where u or y are traced nobody knows what is missing: windows that lack a sample which a relation needs
    are NaN.
    """
    shape, s = y.shape[:-1], relations.horizon
    u, y = (x.reshape(math.prod(shape), x.shape[-1]) for x in (u, y))
    out = jnp.full(len(y), jnp.nan, y.dtype)
    if not len(y):
        return out.reshape(shape)
    samples = np.arange(len(y))
    starts = samples[samples % shape[-1] < shape[-1] - s]
    chosen: Iterable[tuple[PolynomialRelations | None, np.ndarray]]
    if not is_traced(u, y):
        u, y = np.asarray(u), np.asarray(y)
        chosen = cases(relations, u, y, starts)
    elif len(starts):
        chosen = [(relations, np.arange(len(starts)))]
    else:
        chosen = []
    for case, own in chosen:
        found: Array | float = 0.0
        if case is not None:
            found = _over_blocks(_margins, case, u, y, starts[own])
        out = out.at[starts[own] + s].set(found)
    return out.reshape(shape)


def _over_blocks(
    measure: Measure, relations: PolynomialRelations, u: Array, y: Array, starts: np.ndarray
) -> jax.Array:
    """Return the numbers of the windows that start at `starts`: compiled blocks, one loop inside where
    something is traced.
    """
    kind = judged_by(relations, "joint")
    block, test = block_of(kind), relations.reading(y.dtype)
    filled = np.concatenate([starts, np.repeat(starts[:1], -len(starts) % block)]).reshape(-1, block)
    if not is_traced(u, y, *relations.bounds.values()):
        assert isinstance(u, np.ndarray) and isinstance(y, np.ndarray)
        test = jax.device_put(test)
        blocks = [measure(test, *samples_of(test, u, y, chosen), kind) for chosen in filled]
        return jnp.concatenate(blocks)[: len(starts)]
    u, y = jnp.asarray(u), jnp.asarray(y)

    def taken(x: jax.Array, first: jax.Array, lags: int) -> jax.Array:
        return jnp.moveaxis(x[first[None] + np.arange(lags)[:, None]], 1, 2)

    def one_block(first: jax.Array) -> jax.Array:
        return measure(test, taken(u, first, test.lags), taken(y, first, test.horizon + 1), kind)

    numbers: jax.Array = jax.lax.map(one_block, jnp.asarray(filled))
    return numbers.reshape(-1)[: len(starts)]


def _margins(reading: PolynomialReading, u: Array, y: Array, kind: str) -> jax.Array:
    """Return 1 - gauge (N,) of windows u (lags, m, N), y (s + 1, p, N): outside of a trace by the kernels
    that `detect` has compiled already.
    """
    if is_traced(u, y, reading):
        return _smooth_margins(reading, u, y, kind)
    margin: jax.Array
    terms = terms_of(reading, u, y)
    if kind == "vertices":
        _, margin = at_vertices(reading, terms, False)
    else:
        _, margin, *_ = on_whole(reading, terms, False)
    return margin


def _smooth_margins(reading: PolynomialReading, u: Array, y: Array, kind: str) -> jax.Array:
    """Return the same, with derivatives; a missing sample that matters gives NaN."""
    value, spread, rad, _ = terms_of(reading, u, y)
    gone = jnp.isnan(value[:, 0])
    value = jnp.where(gone[:, None], 0, value)
    if kind == "vertices":
        t = polynomials.vertex_gauge(value, spread, rad, reading.exponents)[0]
    else:
        c, G = polynomials.image(value, spread, rad, reading.exponents)
        h, z = jax.lax.stop_gradient(varying.farthest(*jax.lax.stop_gradient((c, G, 0 * c))))
        residual, width = jax.lax.stop_gradient(_across(h, c, G))
        change = jnp.sum(h * (c + jnp.sum(G * z[None], 1)), 0) * jnp.where(jnp.sum(h * c, 0) < 0, -1, 1)
        t = _ratio(residual, width) + _ratio(change - jax.lax.stop_gradient(change), width)
    return jnp.where(jnp.any(gone, 0), jnp.nan, 1 - t)


def _across(h: jax.Array, c: jax.Array, G: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (|h c|, sum_j |h g_j|)."""
    return jnp.abs(jnp.sum(h * c, 0)), jnp.sum(jnp.abs(jnp.sum(h[:, None] * G, 0)), 0)


def _ratio(a: jax.Array, b: jax.Array) -> jax.Array:
    """Return a / b; a / 0 = inf for a > 0, else 0."""
    return jnp.where(b > 0, a / jnp.where(b > 0, b, 1), jnp.where(a > 0, jnp.inf, 0))
