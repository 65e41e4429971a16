"""Numbers to tune by, for models with uncertain parameters: how far out a window is, and what the linearized
test lacks. No proofs.

The margin is that of the joint test, 1 - t with t = min { max_j |z_j| : c + G z = 0 } = max over h of |h c| /
sum_j |h g_j|. Its derivative is that of a linear program, h (dc + dG z) / sum_j |h g_j| with both optima
held. The compensation that a window needs is the largest excess of |h c| over sum_j |h g_j| beside sum_i
|h_i|,

    e = max over h of (|h c| - sum_j |h g_j|) / sum_i |h_i|,

found by Newton's method: h is the worst direction of the set widened by the e so far, a convex problem with
finitely many h.
Source: Dinkelbach 1967.
"""

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.parametric_windows import (
    BLOCK,
    SEARCHED,
    at_vertices,
    cases,
    farthest,
    judged_by,
    linear_image,
    on_whole,
    samples_of,
    terms_of,
)
from jaxbound.recordings.recording import Recording
from jaxbound.sets.strips import polynomials

__all__ = ["needed_compensation", "parametric_margins"]

STEPS = 30
"""Newton steps of a compensation; 3 to 5 are usual."""


def parametric_margins(relations: Any, u: Any, y: Any) -> jax.Array:
    """Return the unproved margins (..., T), NaN where a window has no usable data. See `consistency.margins`.

    Where u or y are traced nobody knows what is missing: windows that lack a sample which a relation needs
    are NaN.
    """
    shape, s = y.shape[:-1], relations.horizon
    u, y = (x.reshape(math.prod(shape), x.shape[-1]) for x in (u, y))
    out = jnp.full(len(y), jnp.nan, y.dtype)
    samples = np.arange(len(y))
    starts = samples[samples % shape[-1] < shape[-1] - s] if len(y) else samples
    if any(isinstance(x, jax.core.Tracer) for x in (u, y)):
        chosen: Any = [(relations, np.arange(len(starts)))] if len(starts) else []
    else:
        u, y = np.asarray(u), np.asarray(y)
        chosen = cases(relations, u, y, starts)
    for case, own in chosen:
        found = 0.0 if case is None else _over_blocks(_margins, case, u, y, starts[own])
        out = out.at[starts[own] + s].set(found)
    return out.reshape(shape)


def needed_compensation(relations: Any, given: Recording, share: float) -> Any:
    """Return the least compensation that is enough for all windows of a Recording but a share of them; see
    `compensation`.
    """
    u, y, across = np.asarray(given.u), np.asarray(given.y), given.across(relations.horizon)
    T = y.shape[-2]
    u, y = (x.reshape(math.prod(y.shape[:-1]), x.shape[-1]) for x in (u, y))
    across[: relations.horizon] = True
    starts = np.flatnonzero(~np.tile(across, len(y) // T)) - relations.horizon
    parts = [
        np.zeros(len(own)) if case is None else np.asarray(_over_blocks(_needs, case, u, y, starts[own]))
        for case, own in cases(relations, u, y, starts)
    ]
    needs = np.sort(np.concatenate([*parts, np.zeros(0)]))
    if not len(needs):
        raise ValueError(
            f"no window of {relations.horizon + 1} samples has data: nothing says what compensation is needed"
        )
    return float(needs[len(needs) - 1 - math.floor(share * len(needs))])


def _over_blocks(kernel, relations, u, y, starts):
    """Return what a kernel says of the windows that start at `starts`: compiled blocks, one loop inside where
    something is traced.
    """
    kind = judged_by(relations, "joint")
    block = SEARCHED if kind == "zonotope" else BLOCK
    test = relations.reading(y.dtype)
    filled = np.concatenate([starts, np.repeat(starts[:1], -len(starts) % block)]).reshape(-1, block)
    if not any(isinstance(x, jax.core.Tracer) for x in (u, y, *relations.bounds.values())):
        test = jax.device_put(test)
        return jnp.concatenate([kernel(test, *samples_of(test, u, y, chosen), kind) for chosen in filled])[
            : len(starts)
        ]
    u, y = jnp.asarray(u), jnp.asarray(y)

    def one_block(first):
        take = lambda x, lags: jnp.moveaxis(x[first[None] + np.arange(lags)[:, None]], 1, 2)
        return kernel(test, take(u, test.window.lags), take(y, test.horizon + 1), kind)

    return jax.lax.map(one_block, jnp.asarray(filled)).reshape(-1)[: len(starts)]


def _margins(test, u, y, kind):
    """Return 1 - gauge (N,) of windows u (lags, m, N), y (s + 1, p, N): outside of a trace by what `detect`
    has compiled already.
    """
    if any(isinstance(x, jax.core.Tracer) for x in (u, y, *jax.tree.leaves(test))):
        return _smooth_margins(test, u, y, kind)
    terms = terms_of(test, u, y)
    return at_vertices(test, terms, False)[1] if kind == "vertices" else on_whole(test, terms, False)[1]


def _smooth_margins(test, u, y, kind):
    """Return the same, with derivatives; a missing sample that matters gives NaN."""
    value, spread, rad, _ = terms_of(test, u, y)
    gone = jnp.isnan(value[:, 0])
    value = jnp.where(gone[:, None], 0, value)
    if kind == "vertices":
        t = polynomials.vertex_gauge(value, spread, rad, test.exponents)[0]
    else:
        c, G = polynomials.image(value, spread, rad, test.exponents)
        h, z = jax.lax.stop_gradient(farthest(*jax.lax.stop_gradient((c, G))))
        residual, width = jax.lax.stop_gradient(_across(h, c, G))
        change = jnp.sum(h * (c + jnp.sum(G * z[None], 1)), 0) * jnp.where(jnp.sum(h * c, 0) < 0, -1, 1)
        t = _ratio(residual, width) + _ratio(change - jax.lax.stop_gradient(change), width)
    return jnp.where(jnp.any(gone, 0), jnp.nan, 1 - t)


@partial(jax.jit, static_argnums=3)
def _needs(test, u, y, kind):
    """Return the compensation (N,) that each window needs."""
    c, G, _ = linear_image(test, terms_of(test, u, y), 0.0)
    G = G[:, : G.shape[1] - len(c)]  # without the compensation's own columns
    needed = jnp.max(jnp.maximum(jnp.abs(c) - jnp.sum(jnp.abs(G), 1), 0), 0)

    def step(carry):
        e, _, count = carry
        own = jnp.where(np.eye(len(c), dtype=bool)[:, :, None], e[None, None], 0)
        h, _ = farthest(c, jnp.concatenate([G, own], 1))
        residual, width = _across(h, c, G)
        more = jnp.maximum(e, _ratio(residual - width, jnp.sum(jnp.abs(h), 0)))
        return more, more > e * (1 + 4 * jnp.finfo(e.dtype).eps), count + 1

    going = lambda carry: jnp.any(carry[1]) & (carry[2] < STEPS)
    return jax.lax.while_loop(going, step, (needed, needed >= 0, 0))[0]


def _across(h, c, G):
    """Return (|h c|, sum_j |h g_j|)."""
    return jnp.abs(jnp.sum(h * c, 0)), jnp.sum(jnp.abs(jnp.sum(h[:, None] * G, 0)), 0)


def _ratio(a, b):
    """Return a / b; a / 0 = inf for a > 0, else 0."""
    return jnp.where(b > 0, a / jnp.where(b > 0, b, 1), jnp.where(a > 0, jnp.inf, 0))
