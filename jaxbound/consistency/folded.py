"""Few strips of windows in one pass over their samples: what no sample changes is worked out once for all.

A strip of `sets.strips.strips` asks |sum_i h_i m_i - sum_j k_j v_j| <= sum_i |h_i| r_i. With d = y - offset
and q = max(|d| - rho, 0) the middle and the radius of a reading (`models.sensor`) are

    m = a (d - c sign(d) q),    r = a (rho + c q),    a = 1 / (1 - sigma),    c = sigma / (1 + sigma),

so that a joins the coefficient, H = h a. Disturbances are numbers and join the constants of a strip. What is
left for a window are seven operations a reading and some twenty a strip, its error bound among them
(`rounding.folded_error`, which has the proof).
"""

from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.reading import Columns, Reading
from jaxbound.models import sensor
from jaxbound.models.rows import Kind
from jaxbound.sets.floats import rounding
from jaxbound.sets.strips.strips import Strips

ROOM = 4
"""Magnitudes are summed so many times as large: where they are finite, nothing else of their strip
overflowed.
"""
Number: TypeAlias = jax.Array | float
"""One for all windows."""


class _Row(NamedTuple):
    """A row of windows, or an input, which has no rad. Fields: mid, rad: without the factor; size: magnitudes
    of the samples that mid is computed of; still: of bounds; factor: a.
    """

    mid: jax.Array
    rad: jax.Array | None
    size: Number
    still: Number
    factor: Number = 1


def folds(reading: Reading) -> bool:
    """Return whether strips can be tested so: those of few circuits, with no sums among their rows."""
    shape = reading.shape
    return isinstance(shape, Strips) and shape.inputs is not None and not reading.window.sums


def folded_verdict(reading: Reading, u: Columns, y: Columns) -> jax.Array:
    """Return the margin (N,) with a proved sign of windows, from their samples as of `Reading.columns`: see
    `sets.strips.strips.strip_verdict`.

    A strip that lacks a datum has NaN for an error bound and for a ratio, which loses every comparison. A
    strip whose magnitudes overflow has an infinite error bound: its ratio is 1 or NaN, and the window is not
    inside.
    """
    like = y[0][0]
    gauge, largest = jnp.full((), -1, like.dtype), jnp.zeros((), like.dtype)
    for residual, width, error in tested(reading, u, y):
        value = jnp.abs(residual)
        # beyond its error bound a computed ratio is on the right side of 1
        ratio = jnp.where(jnp.abs(value - width) <= error, 1, value / width)
        # a larger one of two, written so, is one instruction; `maximum`, which keeps NaN, is four
        gauge = jnp.where(ratio > gauge, ratio, gauge)
        largest = jnp.where(error > largest, error, largest)
    margin = jnp.where((gauge < 1) & (largest == jnp.inf), 0, 1 - gauge)
    # broadcast, since no circuit may look at any sample
    return jnp.broadcast_to(jnp.where(largest > 0, margin, jnp.nan), like.shape)


def tested(reading: Reading, u: Columns, y: Columns) -> Iterator[tuple[jax.Array, jax.Array, jax.Array]]:
    """Yield (residual, width, error bound of their comparison) of each strip, as `rounding.folded_error` has
    it; NaN where a datum is missing.
    """
    strips, dtype = reading.strips, y[0][0].dtype
    gamma, least = rounding.folded_error(strips.h.shape[1] + strips.k.shape[1], dtype)
    floor = least * (1 + jnp.max(jnp.abs(strips.h)) * jnp.max(_factors(reading)))
    top, rows, inputs = np.finfo(dtype).max, _window_rows(reading, u, y), _inputs(reading, u)
    assert strips.supports is not None and strips.inputs is not None
    for c, support in enumerate(strips.supports):
        if not all(reading.window.all[i].seen for i in support):
            nothing = jnp.full((), jnp.nan, dtype)
            yield nothing, nothing, nothing
            continue
        coefficients: dict[int, jax.Array] = {}
        for place, i in enumerate(support):  # a circuit that was filled up has a row more than once
            h = strips.h[c, place]
            coefficients[i] = coefficients[i] + h if i in coefficients else h
        terms = []
        for i, h in coefficients.items():
            terms.append((jnp.clip(h * rows[i].factor, -top, top), rows[i]))
        for b in strips.inputs[c]:
            terms.append((-strips.k[c, b], inputs[b]))
        residual, width, size = _summed(terms)
        yield residual, width, gamma / ROOM * (size + ROOM * width) + floor


def _factors(reading: Reading) -> jax.Array:
    """Return a (p,), the last factor of a reading."""
    return 1 / (1 - reading.tolerance)


def _summed(terms: list[tuple[jax.Array, _Row]]) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (residual, width, size) of a strip from its rows and inputs with their coefficients; size: ROOM
    times what errors are relative to beside the width. Numbers are added first.
    """
    residual: Number = 0
    width: Number = 0
    size: Number = 0
    for H, row in terms:
        size += ROOM * jnp.abs(H) * row.still
    for H, row in sorted(terms, key=lambda term: term[1].mid.ndim > 0):
        weight = jnp.abs(H)
        residual += H * row.mid
        if row.rad is not None:
            width += weight * row.rad
        size += ROOM * weight * row.size
    return jnp.asarray(residual), jnp.asarray(width), jnp.asarray(size)


def _window_rows(reading: Reading, u: Columns, y: Columns) -> list[_Row]:
    """Return the rows of windows, those they look at."""
    dtype, factors = y[0][0].dtype, _factors(reading)
    shares = jnp.maximum(reading.tolerance / (1 + reading.tolerance), rounding.tiny(dtype))
    errors = [_sensor_errors(reading, u, y, i) for i in range(len(y[0]))]
    rows = []
    for row in reading.window.all:
        i = row.number
        if row.kind is Kind.DISTURBANCE:
            lo, hi, tiny = reading.disturbance[i, 0], reading.disturbance[i, 1], rounding.tiny(dtype)
            rows.append(_Row(0.5 * (lo + hi), 0.5 * (hi - lo) + tiny, 0, abs(lo) + abs(hi) + tiny))
            continue
        sample, rho = y[row.first][i], errors[i][row.first]
        d = sample - reading.offset_y[i]
        beyond = jnp.where(d > rho, d - rho, jnp.where(d < -rho, d + rho, 0))
        mid, rad = d - shares[i] * beyond, rho + shares[i] * jnp.abs(beyond)
        rows.append(_Row(mid, rad, jnp.abs(sample), jnp.abs(reading.offset_y[i]), factors[i]))
    return rows


def _sensor_errors(reading: Reading, u: Columns, y: Columns, i: int) -> list[jax.Array]:
    """Return rho (N,) of an output at each sample of windows: noise, resolution and what the recorder rounded
    away; a missing sample is no larger than 0.
    """
    dtype = y[0][0].dtype
    ulps = np.asarray(sensor.RECORDER_ULPS * rounding.unit(dtype), dtype)
    largest: jax.Array = jnp.zeros((), dtype)
    for sample, now in enumerate(y):
        if reading.window.looked_at(sample):
            size = jnp.abs(now[i])
            largest = jnp.where(size > largest, size, largest)
    # an infinite sample stays its own row's matter
    rounded = jnp.minimum(largest, np.finfo(dtype).max) * ulps

    def error(noise: jax.Array) -> jax.Array:
        return (noise + reading.resolution[i] + ulps * noise + rounding.tiny(dtype)) + rounded

    if i not in reading.times:
        return [error(reading.noise[i])] * len(y)
    column = len(reading.offset_u) + reading.times.index(i)
    return [error(reading.noise[i] * jnp.where(jnp.isnan(now[column]), 1, now[column])) for now in u]


def _inputs(reading: Reading, u: Columns) -> list[_Row]:
    """Return the inputs of windows."""
    inputs = []
    for b, sample in enumerate(known_columns(reading, u)):
        offset = reading.offset_u[b % len(reading.offset_u)]
        inputs.append(_Row(sample - offset, None, jnp.abs(sample), jnp.abs(offset)))
    return inputs


def known_columns(reading: Reading, u: Columns) -> list[jax.Array]:
    """Return the inputs of windows as columns (N,), time-major."""
    acting = reading.lags if reading.acting is None else reading.acting
    return [x for now in u[:acting] for x in now[: len(reading.offset_u)]]
