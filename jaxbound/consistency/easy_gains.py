"""Easy windows of constant tolerances: gains by least squares, then the steps of a certain model.

Rows of given gains g are those of a certain model, output i being read g_i times as large. With a_i the
middles of output i and b the rest, inputs and disturbances, the errors of the first state that fits best are
linear in the gains,

    e = sum_i g_i e(a_i) + e(b),    e(z) = (z - R P z, -P z),

so the gains that keep them small follow from as many equations as there are outputs. Any gains within the
tolerances do: what they explain is CONSISTENT, and its margin is not above that of the best ones. A gain of
its own for each sample allows whatever a common one does: what contradicts them all is a FAULT. It does not
say how far common gains are from an explanation: the margin is -`LEAST`.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.constant import LEAST, gain_bounds, gain_tolerance, own_factor
from jaxbound.consistency.projection import EasyWindows, Given, Steps, rows_of
from jaxbound.consistency.reading import Reading
from jaxbound.models.rows import Kind
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.unrolled import stored
from jaxbound.sets.strips.projection import Rows, clipped_margin, least_errors

__all__ = ["EasyGains", "nominal"]

SWEEPS = 8
"""Rounds in which each gain is fitted to the others."""


class GivenGains(NamedTuple):
    """Two readings: with gains of 1, and with a gain of each sample's own."""

    nominal: Given
    free: Given


class EasyGains(EasyWindows):
    """Decides windows of sensors whose gains keep one value over a window."""

    @property
    def constants(self) -> GivenGains:  # type: ignore[override]  # what its own kernel takes
        """Both readings, and the projection."""
        return GivenGains(Given(nominal(self.reading), self.projection), Given(self.reading, self.projection))

    @property
    def steps(self) -> Steps:
        """The kernel of both readings."""
        return _of_gains


def nominal(reading: Reading) -> Reading:
    """Return a reading of sensors whose gains are 1."""
    return dataclasses.replace(reading, tolerance=0 * reading.tolerance)


@kernel(wide=True)
def _of_gains(given: GivenGains, u: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (margins (N,), h (c, N)) of windows u (lags, m, N), y (s + 1, p, N)."""
    rows, reading = rows_of(given.nominal, u, y), given.free.reading
    gains = stored(_fitted(given.free, rows))
    of = jnp.take(gains, _gain(given.free), 0)
    top = 2 * jnp.max(gains, 0)  # twice: what the products round
    radius = stored(rows.radius * of)
    heaviest = 1 / jnp.min(radius, 0)
    scaled = Rows(stored(rows.mid * of), radius, rows.known, top * rows.scale, heaviest, 2 * rows.known_size)
    explained, _ = clipped_margin(given.nominal.projection, scaled)
    own = own_factor(reading, gains, jnp)
    margin = jnp.maximum(jnp.minimum(explained, 1 - own), LEAST)
    free, h = clipped_margin(given.free.projection, rows_of(given.free, u, y))
    return jnp.where(explained > 0, margin, jnp.where(free < 0, -LEAST, 0)), h


def _gain(given: Given) -> np.ndarray:
    """Return the number of the gain of each row of a projection, see `gain_bounds`."""
    rows, p = given.reading.window.all, len(given.reading.noise)
    numbers = (*given.projection.outer, *given.projection.inner)
    return np.array([rows[i].number if rows[i].kind is Kind.READING else p for i in numbers])


def _fitted(given: Given, rows: Rows) -> jax.Array:
    """Return gains (g, N) within the tolerances that make errors small; nothing is proved."""
    reading, projection = given
    lo, hi = (x[:, None] for x in gain_bounds(reading, jnp)[2:])
    number, weight = _gain(given), 1 / jnp.square(jnp.min(rows.radius, 1, keepdims=True))
    parts = []
    for i in range(len(lo)):
        own = jnp.where((number == i)[:, None], rows.mid, 0)
        parts.append(stored(least_errors(projection, own, 0 * rows.known)))
    rest = stored(least_errors(projection, 0 * rows.mid, rows.known))
    products = [[jnp.sum(weight * a * b, 0) for b in (*parts, rest)] for a in parts]
    prior = 1 / jnp.maximum(gain_tolerance(reading, jnp), LEAST) ** 2
    gains = [jnp.clip(jnp.ones_like(rest[0]), a, b) for a, b in zip(lo, hi, strict=True)]
    for _ in range(SWEEPS):
        for i, row in enumerate(products):
            others = row[-1]
            for j, g in enumerate(gains):
                if j != i:
                    others = others + row[j] * g
            gains[i] = jnp.clip((prior[i] - others) / (prior[i] + row[i]), lo[i], hi[i])
    return jnp.stack(gains)
