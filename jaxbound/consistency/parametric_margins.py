"""Numbers to tune by, for models with uncertain parameters: how far out a window is. No
proofs.

The margin is that of the joint test, 1 - t with t = min { max_j |z_j| : c + G z = 0 } = max over h of |h c| /
sum_j |h g_j|. Its derivative is that of a linear program, h (dc + dG z) / sum_j |h g_j| with both optima
held.
"""

import math
from collections.abc import Iterable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.interface import Array
from jaxbound.consistency.parametric_windows import SEARCHED, by_vertices, cases, terms_of
from jaxbound.consistency.polynomial_reading import PolynomialReading, PolynomialRelations
from jaxbound.consistency.unproved import over_blocks
from jaxbound.sets.floats.equations import is_traced
from jaxbound.sets.strips import polynomials, varying


def parametric_margins(relations: PolynomialRelations, u: Array, y: Array) -> jax.Array:
    """Return the unproved margins (..., T), NaN where a window has no usable data. See `consistency.margins`.

    Where u or y are traced nobody knows what is missing: windows that lack a sample which a relation needs
    are NaN.
    """
    shape, s = y.shape[:-1], relations.horizon
    u, y = (x.reshape(math.prod(shape), x.shape[-1]) for x in (u, y))
    out = jnp.full(len(y), jnp.nan, y.dtype)
    samples = np.arange(len(y))
    starts = samples[samples % shape[-1] < shape[-1] - s] if len(y) else samples
    chosen: Iterable[tuple[PolynomialRelations | None, np.ndarray]] = [(relations, np.arange(len(starts)))]
    if not is_traced(u, y):
        chosen = cases(relations, np.asarray(u), np.asarray(y), starts)
    for case, own in chosen:
        found: Array | float = 0.0
        if case is not None and len(own):
            reading = case.reading(y.dtype)
            smooth = partial(_vertex_margins, reading, by_vertices(case))
            found = over_blocks(smooth, reading, jnp.asarray(u), jnp.asarray(y), starts[own], SEARCHED)
        out = out.at[starts[own] + s].set(found)
    return out.reshape(shape)


def _vertex_margins(reading: PolynomialReading, vertices: bool, u: jax.Array, y: jax.Array) -> jax.Array:
    """Return 1 - gauge (N,) of windows u (lags, m, N), y (s + 1, p, N), with derivatives; a missing sample
    that matters gives NaN.
    """
    value, _, spread, rad = terms_of(reading, u, y)
    gone = jnp.isnan(value[:, 0])
    value = jnp.where(gone[:, None], 0, value)
    if vertices:
        t = polynomials.vertex_gauge(value, spread, rad, reading.exponents)[0]
    else:
        c, G = polynomials.image(value, spread, rad, reading.exponents)
        # the envelope theorem: the optimum moves, its value changes as if it stood
        h, z = jax.lax.stop_gradient(varying.farthest(*jax.lax.stop_gradient((c, G, 0 * c))))
        residual = jnp.abs(jnp.sum(jax.lax.stop_gradient(h * c), 0))
        width = jnp.sum(jnp.abs(jnp.sum(jax.lax.stop_gradient(h[:, None] * G), 0)), 0)
        change = jnp.sum(h * (c + jnp.sum(G * z[None], 1)), 0) * jnp.where(jnp.sum(h * c, 0) < 0, -1, 1)
        # the value of the one, the derivative of the other: what is added is 0
        t = _ratio(residual, width) + _ratio(change - jax.lax.stop_gradient(change), width)
    return jnp.where(jnp.any(gone, 0), jnp.nan, 1 - t)


def _ratio(a: jax.Array, b: jax.Array) -> jax.Array:
    """Return a / b; a / 0 = inf for a > 0, else 0."""
    return jnp.where(b > 0, a / jnp.where(b > 0, b, 1), jnp.where(a > 0, jnp.inf, 0))
