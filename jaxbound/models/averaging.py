"""Draw errors that average out: from draws within the box of every sample, the nearest ones that keep the
averages too.

Sample by sample, a draw is moved to the nearest value with which every run that ends there keeps its bound:
so errors stay at the limits of a sample until an average holds them back, which is what they do at worst. A
single mean can always be kept so (repeat the sample that leaves the run). Several, or other weights, may
leave no such value: the recording's draws are then shrunk together towards a constant that keeps all of them,
by the one factor that is needed. Runs that begin before the recording count with that constant.
"""

from functools import partial
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.random.threefry import Array
from jaxbound.sets.floats import rounding

Places: TypeAlias = tuple[tuple[bool, int, int], ...]
"""(whether of an output, number of the signal, samples) of each average."""
AverageNumbers: TypeAlias = tuple[tuple[np.ndarray, np.ndarray], ...]
"""(weights (n,), bound) of each average."""


def places_of(model: LinearSystem, dtype: np.dtype) -> tuple[Places, AverageNumbers]:
    """Return the places of a model's averages, and their numbers in floats, bounds rounded down."""
    places, numbers = [], []
    for average in model.averages:
        weights = np.array(list(map(float, average.weights)), dtype)
        places.append((*average.place(model.outputs), len(weights)))
        numbers.append((weights, rounding.round_down(average.bound, dtype)))
    return tuple(places), tuple(numbers)


@partial(jax.jit, static_argnums=0)
def kept_averages(
    places: Places,
    averages: AverageNumbers,
    noise: jax.Array,
    w: jax.Array,
    bounds: tuple[jax.Array, jax.Array, jax.Array],
) -> tuple[jax.Array, jax.Array]:
    """Return noise (N, T, p) and disturbances w (N, T, g) that keep every average.

    Args:
        places, averages: from `places_of`. noise, w: draws within their boxes. bounds: noise (p,), lo (g,),
            hi (g,).
    """
    top, lo, hi = bounds
    noise = _kept_on_one_side(noise, (-top, top), _by_signal(places, averages, measured=True))
    w = _kept_on_one_side(w, (lo, hi), _by_signal(places, averages, measured=False))
    return noise, w


_Averages: TypeAlias = list[tuple[int, Array, Array]]
"""(samples n, weights (n,), bound) of each average of one signal."""


def _by_signal(places: Places, averages: AverageNumbers, measured: bool) -> dict[int, _Averages]:
    """Return the averages of outputs, or of disturbances, by the number of their signal."""
    found: dict[int, _Averages] = {}
    for (of_output, signal, samples), (weights, bound) in zip(places, averages, strict=True):
        if of_output is measured:
            found.setdefault(signal, []).append((samples, weights, bound))
    return dict(sorted(found.items()))


def _kept_on_one_side(
    values: jax.Array, ends: tuple[jax.Array, jax.Array], averages: dict[int, _Averages]
) -> jax.Array:
    """Return draws (N, T, c), of outputs or of disturbances, that keep the averages of each signal."""
    for i, mine in averages.items():
        kept = _one_signal(values[:, :, i], ends[0][i], ends[1][i], mine)
        values = values.at[:, :, i].set(kept)
    return values


def _one_signal(x: jax.Array, lo: jax.Array, hi: jax.Array, averages: _Averages) -> jax.Array:
    """Return draws x (N, T) of one signal in [lo, hi] that keep averages [(n, weights (n,), bound)]."""
    dtype, longest = x.dtype, max(n for n, _, _ in averages)
    size = jnp.maximum(jnp.abs(lo), jnp.abs(hi))
    # the constant nearest to 0: the model has made sure that it keeps all averages
    rest = jnp.clip(jnp.zeros((), dtype), lo, hi)
    slack = [8 * n * rounding.unit(dtype) * jnp.sum(jnp.abs(f)) * size for n, f, _ in averages]
    held = [jnp.maximum(b - 2 * e, 0) for (_, _, b), e in zip(averages, slack, strict=True)]

    def step(past: jax.Array, now: jax.Array) -> tuple[jax.Array, jax.Array]:
        low, high = jnp.full_like(now, lo), jnp.full_like(now, hi)
        for (n, f, _), b in zip(averages, held, strict=True):
            # all of the run but its newest sample, which is what is chosen now
            before = jnp.sum(past[longest - n :] * f[:-1, None], 0)
            # a negative weight turns the ends round
            ends = (-b - before) / f[-1], (b - before) / f[-1]
            low, high = jnp.maximum(low, jnp.minimum(*ends)), jnp.minimum(high, jnp.maximum(*ends))
        # where bounds leave no value, the middle of what they ask for spoils each least
        value = jnp.where(low <= high, jnp.clip(now, low, high), jnp.clip(0.5 * (low + high), lo, hi))
        return jnp.concatenate([past[1:], value[None]]), value

    before = jnp.full((longest - 1, len(x)), rest, dtype)
    out = jax.lax.scan(step, before, x.T)[1]  # (T, N)
    share = jnp.ones((len(x),), dtype)
    whole = jnp.concatenate([before, out])
    for (n, f, b), e in zip(averages, slack, strict=True):
        moved = jnp.max(jnp.abs(_run_sums(f, n, whole, longest - n, rest, out)), 0)
        room = jnp.maximum(b - e - jnp.abs(rest * jnp.sum(f)), 0)
        share = jnp.minimum(share, jnp.where(moved > room, room / jnp.where(moved > 0, moved, 1), 1))
    # what rounding adds to a run must not lead out of its bound: a draw has to be healthy
    share = jnp.where(share < 1, share * (1 - 8 * rounding.unit(dtype)), 1)
    return jnp.where(share[:, None] < 1, jnp.clip(rest + share[:, None] * (out.T - rest), lo, hi), out.T)


def _run_sums(
    weights: Array, n: int, whole: jax.Array, begin: int, rest: jax.Array, like: jax.Array
) -> jax.Array:
    """Return the weighted sums (T, N) of runs of n values less rest, the first run from `begin` on."""

    def add(k: jax.Array, total: jax.Array) -> jax.Array:
        # the whole column at once, one weight after the other
        run = jax.lax.dynamic_slice_in_dim(whole, begin + k, len(like), 0)
        return total + weights[k] * (run - rest)

    sums: jax.Array = jax.lax.fori_loop(0, n, add, jnp.zeros_like(like))
    return sums
