"""What multipliers of the samples of a window prove: an enclosure of one direction of one state, rounding included.

States x_(j+1) = A x_j + B v_j + w_j, samples m_j = C x_j + D v_j + delta_j, |delta_j| <= s_j, and a first state in a set. For every l:

    d x_J  =  sum_j l_j (m_j - D v_j - delta_j)  -  p_0 x_0  -  sum_j p_(j+1) (B v_j + w_j),
    p_j    =  C' l_j + A' p_(j+1) - d [j = J],

in which only delta, x_0 and w are unknown, each within its bounds. So d x_J lies in value +- bound; with d = 0 a value beyond its bound is
a contradiction. Where p_j is rounded, or A and C are intervals, the difference acts on x_j, of which bounds are known beforehand.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.estimation.window_search import Window
from jaxbound.estimation.zonotope_steps import Numbers
from jaxbound.sets.floats import rounding

__all__ = ["Prior", "Samples", "enclosed", "window_of"]


class Prior(NamedTuple):
    """A set {c + S xi + diag(r) eta} of first states. Fields: c (n, N), S (n, n, N), r (n, N)."""

    c: Any
    S: Any
    r: Any


class Samples(NamedTuple):
    """What L samples say. Fields: mid, rad (L, p, N), v, slip (L, m, N): see `zonotope_steps.Read`; reach (L, n, N): at least |x|."""

    mid: Any
    rad: Any
    v: Any
    slip: Any
    reach: Any


@jax.jit
def window_of(plant: Numbers, prior: Prior, samples: Samples) -> Window:
    """Return the Window that a search takes, rounded to nearest."""
    dot = lambda M, x: jnp.sum(M[..., None] * x[None], 1)

    def step(x, now):
        mid, v = now
        e = mid - dot(plant.C, x) - dot(plant.D, v)
        return dot(plant.A, x) + dot(plant.B, v) + plant.w[:, None], e

    _, e = jax.lax.scan(step, prior.c, (samples.mid, samples.v))
    seen = jnp.isfinite(samples.rad)
    least = 1e-9 * jnp.max(jnp.where(seen, samples.rad, 0), (0, 1), keepdims=True) + 1e-30  # a search divides by it
    S = prior.S + jnp.eye(len(prior.r), dtype=prior.r.dtype)[:, :, None] * prior.r[None]
    return Window(plant.A, plant.C, plant.W, S, jnp.where(seen, e, 0), jnp.where(seen, jnp.maximum(samples.rad, least), jnp.inf))


@jax.jit
def enclosed(plant: Numbers, prior: Prior, samples: Samples, weight: jax.Array, d: jax.Array, J: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (value, bound), each (N,): d x_J lies in value +- bound for all that explains the samples; infinite where nothing is shown.

    Args:
        weight (L, p, N): multipliers, any. d (n, N), J (N,).
    """
    (L, p, N), (n, m), g = samples.mid.shape, plant.B.shape, plant.W.shape[1]
    dtype = d.dtype
    gamma = rounding.product_error(L * (n + m + p + g + 8) + n, dtype)[0]
    up = np.asarray(1 + 8 * (L * (n + m + p + g + 8) + n) * float(rounding.unit(dtype)), dtype)
    least = np.asarray(2.0**-500 if dtype == np.float64 else 2.0**-46, dtype)
    most = np.asarray(2.0**60 if dtype == np.float64 else 2.0**20, dtype)
    seen = jnp.isfinite(samples.rad)
    weight = jnp.where(seen & (jnp.abs(weight) < most), weight, 0)
    mid, rad = jnp.where(seen, samples.mid, 0), jnp.where(seen, samples.rad, 0)
    sizes = Numbers(*(jnp.abs(jnp.asarray(x)) for x in plant))
    into = lambda M, x: jnp.sum(M[..., None] * x[:, None], 0)  # M' x
    column = lambda x: x[:, None]
    spread = jnp.sum(sizes.W, 1)

    def step(j, state):
        q, value, bound, size = state
        i = L - 1 - j
        take = lambda x: jax.lax.dynamic_index_in_dim(x, i, 0, keepdims=False)
        l, middle, s, v, slip, reach = (take(x) for x in (weight, mid, rad, samples.v, samples.slip, samples.reach))
        a, b, V = jnp.abs(q), jnp.abs(l), jnp.abs(v)  # q is 0 after the last sample
        value = value - jnp.sum(q * (into(plant.B.T, v) + column(plant.w)), 0) + jnp.sum(l * (middle - into(plant.D.T, v)), 0)
        bound = bound + jnp.sum(jnp.abs(into(plant.W, q)), 0)
        bound = bound + jnp.sum(a * (column(sizes.wide_w) + into(sizes.wide_B.T, V) + into(sizes.B.T, slip)), 0)
        bound = bound + jnp.sum(b * (s + into(sizes.wide_D.T, V) + into(sizes.D.T, slip)), 0)
        size = size + jnp.sum(a * (into(sizes.B.T, V) + column(sizes.w + spread)), 0)
        size = size + jnp.sum(b * (jnp.abs(middle) + s + into(sizes.D.T, V)), 0)
        pull = jnp.where((i == J)[None], d, 0)
        off = into(sizes.wide_C + gamma * sizes.C, b) + into(sizes.wide_A + gamma * sizes.A, a) + gamma * jnp.abs(pull)
        acts = jnp.where(off > 0, off, 0) * jnp.where(off > 0, reach, 0)
        bound = bound + jnp.sum(acts, 0)
        return into(plant.C, l) + into(plant.A, q) - pull, value, bound, size

    zero = jnp.zeros(N, dtype)
    q, value, bound, size = jax.lax.fori_loop(0, L, step, (jnp.zeros((n, N), dtype), zero, zero, zero))
    a = jnp.abs(q)
    value = value - jnp.sum(q * prior.c, 0)
    bound = bound + jnp.sum(jnp.abs(jnp.sum(prior.S * q[:, None], 0)), 0) + jnp.sum(a * prior.r, 0)
    size = size + jnp.sum(a * (jnp.abs(prior.c) + jnp.sum(jnp.abs(prior.S), 1) + prior.r), 0)
    bound = up * (bound + gamma * size) + least
    shown = (bound < np.inf) & (jnp.abs(value) < np.inf)
    return jnp.where(shown, value, 0), jnp.where(shown, bound, np.inf)
