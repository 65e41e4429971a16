"""Unknowns that hide a fault: chosen within their bounds by somebody who knows the fault, so that no window
shows it.

The factor t_k of a window (`strips`: the largest |residual| / width over its combinations) is lowered by the
unknowns xi in [-1, 1] of the whole scenario. A scenario is hidden as well as it can be where max over windows
of t_k is least: for sensors without tolerance a convex problem. It is solved by descent on the smooth maximum
tau log sum exp(t_k / tau), tau falling, with normalised steps, momentum and projection on the box; the best
xi of each scenario is kept. Nothing here is proved, and need not be: what comes out is a recording of
unknowns within their bounds, and the proved test judges it like any other.
"""

from functools import partial
from typing import TypeAlias, cast

import jax
import jax.numpy as jnp

from jaxbound.consistency.reading import Reading
from jaxbound.random.threefry import Array
from jaxbound.sets.floats.unrolled import stored
from jaxbound.sets.strips.separation import Frame, separation_margin
from jaxbound.sets.strips.strips import strip_margin
from jaxbound.studies.montecarlo import kernel
from jaxbound.studies.montecarlo.scenarios import Act

Descent: TypeAlias = tuple[jax.Array, jax.Array, jax.Array, jax.Array]
"""The unknowns, how fast they move, the best ones of each scenario, and their largest factors."""

STEPS = 240
SHARPEST, BLUNTEST = 0.003, 0.3
"""Temperatures tau at the end and at the beginning, in units of the factor."""


def _factors(reading: Reading, u: Array, y: Array) -> jax.Array:
    """Return t (T - s, N) of all windows, differentiable; NaN where no combination has its data."""
    count, N = y.shape[0] - reading.horizon, y.shape[2]
    # in a kernel these are traced
    inputs, outputs = cast("tuple[jax.Array, jax.Array]", (u, y))
    us, ys = _windows(inputs, reading.lags, count), _windows(outputs, reading.horizon + 1, count)
    flat = jnp.zeros((reading.lags, 0, count * N), y.dtype)
    if us and us[0]:
        flat = jnp.stack(list(map(jnp.stack, us)))
    mid, rad, _, known, _ = reading.block(flat, jnp.stack(list(map(jnp.stack, ys))))
    if isinstance(reading.shape, Frame):
        return 1 - separation_margin(reading.shape, mid, rad, known).reshape(count, N)
    t: jax.Array = 1 - strip_margin(reading.strips, stored(mid), stored(rad), known).reshape(count, N)
    return stored(t)


def _windows(x: jax.Array, lags: int, count: int) -> list[list[jax.Array]]:
    """Return each signal of x (T, c, N) at each of the `lags` samples of `count` windows, flat.

    stored: else the derivative is worked out anew for each sample of each window that it goes to
    """
    return [[stored(x[j : j + count, i].reshape(-1)) for i in range(x.shape[1])] for j in range(lags)]


def worst_factor(reading: Reading, act: Act, onset: Array, u: Array, y: Array) -> tuple[Array, Array]:
    """Return (t of every window (T - s, N), -inf where the fault does not touch it; the largest of each
    scenario (N,)).
    """
    t = _factors(reading, u, y)
    end = jnp.arange(t.shape[0])[:, None] + reading.horizon
    touched = (end >= onset[None]) & (end - reading.horizon < (onset + act.length)[None])
    t = jnp.where(touched & ~jnp.isnan(t), t, -jnp.inf)
    return t, jnp.max(t, 0)


@partial(jax.jit, static_argnums=3)
def attack_block(
    reading: Reading, scene: kernel.Scene, numbers: Array, steps: int = STEPS
) -> tuple[Array, Array, Array]:
    """Return recordings u (N, T, m), y (N, T, p) and onsets (N,) of N scenarios whose unknowns hide the fault
    as well as was found.

    Args:
        reading: with Strips. scene, numbers: as of `kernel.count_block`; inputs, sizes and onsets are those
            of the uniform study. steps: of the descent.
    """
    begun = kernel.prepared(scene, numbers)
    act, onset = scene.act, begun.onset
    xi, extra = kernel.drawn(scene, numbers)
    p = scene.plant.shape[2]

    def recorded(xi: jax.Array) -> tuple[jax.Array, jax.Array]:
        def at(k: jax.Array) -> kernel.Unknowns:
            now = xi[k]
            return list(now[:p]), list(now[p : 2 * p]), list(now[2 * p :]), extra[k]

        return kernel.recorded_scene(scene, begun, at)

    def loss(xi: jax.Array, tau: jax.Array) -> tuple[jax.Array, Array]:
        t, worst = worst_factor(reading, act, onset, *recorded(xi))
        top = jax.lax.stop_gradient(jnp.where(jnp.isfinite(worst), worst, 0))
        shares = jnp.where(t > -jnp.inf, jnp.exp((t - top[None]) / tau), 0)
        smooth = tau * jnp.log(jnp.sum(shares, 0) + 1e-300)
        return jnp.sum(smooth), worst

    def descend(carry: Descent, i: jax.Array) -> tuple[Descent, None]:
        xi, speed, best, least = carry
        left = 1 - i / steps
        tau = SHARPEST * (BLUNTEST / SHARPEST) ** left
        slope, worst = jax.grad(loss, has_aux=True)(xi, tau)
        better = worst < least
        best, least = jnp.where(better[None, None], xi, best), jnp.where(better, worst, least)
        largest = jnp.max(jnp.abs(slope), (0, 1))
        speed = 0.8 * speed + slope / jnp.where(largest > 0, largest, 1)[None, None]
        xi = jnp.clip(xi - 0.3 * (0.01 / 0.3) ** (1 - left) * speed, -1, 1)
        return (xi, speed, best, least), None

    start = xi, jnp.zeros_like(xi), xi, jnp.full_like(begun.size, jnp.inf)
    (xi, _, best, least), _ = jax.lax.scan(descend, start, jnp.arange(steps, dtype=begun.size.dtype))
    _, worst = worst_factor(reading, act, onset, *recorded(xi))
    best = jnp.where((worst < least)[None, None], xi, best)
    us, ys = recorded(best)
    return jnp.moveaxis(us, 2, 0), jnp.moveaxis(ys, 2, 0), onset
