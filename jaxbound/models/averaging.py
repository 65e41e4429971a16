"""Draw errors that average out: from draws within the box of every sample, the nearest ones that keep the
averages too.

Sample by sample, a draw is moved to the nearest value with which every run that ends there keeps its bound:
so errors stay at the limits of a sample until an average holds them back, which is what they do at worst. A
single mean can always be kept so (repeat the sample that leaves the run). Several, or other weights, may
leave no such value: the recording's draws are then shrunk together towards a constant that keeps all of them,
by the one factor that is needed. Runs that begin before the recording count with that constant.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.sets.floats import rounding

__all__ = ["kept_averages", "places_of"]

Places = tuple[tuple[bool, int, int], ...]


def places_of(model: LinearSystem, dtype: np.dtype) -> tuple[Places, tuple]:
    """Return ((of an output, number, samples) of each average, [(weights (n,), bound)] in floats, bounds
    rounded down).
    """
    places = tuple((*a.place(model.outputs), len(a.weights)) for a in model.averages)
    numbers = tuple(
        (np.array([float(x) for x in a.weights], dtype), rounding.round_down(a.bound, dtype))
        for a in model.averages
    )
    return places, numbers


@partial(jax.jit, static_argnums=0)
def kept_averages(
    places: Places, averages: Sequence, noise: jax.Array, w: jax.Array, bounds: tuple[Any, Any, Any]
) -> tuple[jax.Array, jax.Array]:
    """Return noise (N, T, p) and disturbances w (N, T, g) that keep every average.

    Args:
        places, averages: from `places_of`. noise, w: draws within their boxes. bounds: noise (p,), lo (g,),
            hi (g,).
    """
    top, lo, hi = bounds
    for measured, ends in ((True, (-top, top)), (False, (lo, hi))):
        values = noise if measured else w
        for i in sorted({i for of, i, _ in places if of is measured}):
            mine = [
                (n, *a) for (of, j, n), a in zip(places, averages, strict=True) if of is measured and j == i
            ]
            values = values.at[:, :, i].set(_one_signal(values[:, :, i], ends[0][i], ends[1][i], mine))
        noise, w = (values, w) if measured else (noise, values)
    return noise, w


def _one_signal(x, lo, hi, averages):
    """Return draws x (N, T) of one signal in [lo, hi] that keep averages [(n, weights (n,), bound)]."""
    dtype, longest = x.dtype, max(n for n, _, _ in averages)
    size = jnp.maximum(jnp.abs(lo), jnp.abs(hi))
    rest = jnp.clip(
        jnp.zeros((), dtype), lo, hi
    )  # the constant nearest to 0: the model has made sure that it keeps all averages
    slack = [8 * n * rounding.unit(dtype) * jnp.sum(jnp.abs(f)) * size for n, f, _ in averages]
    held = [jnp.maximum(b - 2 * e, 0) for (_, _, b), e in zip(averages, slack, strict=True)]

    def step(past, now):
        low, high = jnp.full_like(now, lo), jnp.full_like(now, hi)
        for (n, f, _), b in zip(averages, held, strict=True):
            before = jnp.sum(past[longest - n :] * f[:-1, None], 0)
            ends = (-b - before) / f[-1], (b - before) / f[-1]
            low, high = jnp.maximum(low, jnp.minimum(*ends)), jnp.minimum(high, jnp.maximum(*ends))
        value = jnp.where(low <= high, jnp.clip(now, low, high), jnp.clip(0.5 * (low + high), lo, hi))
        return jnp.concatenate([past[1:], value[None]]), value

    before = jnp.full((longest - 1, len(x)), rest, dtype)
    out = jax.lax.scan(step, before, x.T)[1]  # (T, N)
    share = jnp.ones((len(x),), dtype)
    whole = jnp.concatenate([before, out])
    for (n, f, b), e in zip(averages, slack, strict=True):
        begin, runs = longest - n, len(out)
        add = lambda k, total, f=f, begin=begin, runs=runs: (
            total + f[k] * (jax.lax.dynamic_slice_in_dim(whole, begin + k, runs, 0) - rest)
        )
        moved = jnp.max(jnp.abs(jax.lax.fori_loop(0, n, add, jnp.zeros_like(out))), 0)
        room = jnp.maximum(b - e - jnp.abs(rest * jnp.sum(f)), 0)
        share = jnp.minimum(share, jnp.where(moved > room, room / jnp.where(moved > 0, moved, 1), 1))
    share = jnp.where(share < 1, share * (1 - 8 * rounding.unit(dtype)), 1)
    return jnp.where(share[:, None] < 1, jnp.clip(rest + share[:, None] * (out.T - rest), lo, hi), out.T)
