"""Strips of contiguous samples in one pass: what no sample changes is worked out once for all windows.

A strip of `sets.strips.strips` asks |sum_i h_i m_i - sum_j k_j v_j| <= sum_i |h_i| r_i. With d = y - offset
and q = max(|d| - rho, 0) the middle and the radius of a reading (`models.sensor`) are

    m = a (d - c sign(d) q),    r = a (rho + c q),    a = 1 / (1 - sigma),    c = sigma / (1 + sigma),

so that a joins the coefficient, H = h a. Disturbances are numbers and join the constants of a strip. What is
left for a window are seven operations a reading and some twenty a strip, its error bound among them
(`rounding.folded_error`, which has the proof).
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.reading import Reading
from jaxbound.models import sensor
from jaxbound.models.rows import Kind, Row
from jaxbound.sets.floats import rounding
from jaxbound.sets.strips.strips import Strips

__all__ = ["folded_margin", "folded_verdict", "folds", "known_columns", "tested"]

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


class _Strip(NamedTuple):
    """One strip of windows. Fields: residual; width; size: ROOM times what errors are relative to beside the
    width.
    """

    residual: jax.Array
    width: jax.Array
    size: jax.Array


def folds(reading: Reading) -> bool:
    """Return whether strips can be tested so: those of few circuits, with no sums among their rows."""
    shape = reading.shape
    return isinstance(shape, Strips) and shape.inputs is not None and not reading.window.sums


def folded_margin(reading: Reading, u: jax.Array, y: jax.Array) -> jax.Array:
    """Return 1 - gauge (N,) of the windows of a stretch u (N + s, m), y (N + s, p), unrounded; NaN where no
    circuit has all its data. For numbers alone: a derivative would meet NaN.
    """
    gauge = jnp.full((), -1, y.dtype)
    for residual, width, _ in _strips(reading, u, y):
        ratio = jnp.where(jnp.isnan(residual), -1, jnp.abs(residual) / width)
        gauge = jnp.where(ratio > gauge, ratio, gauge)
    return _each(jnp.where(gauge < 0, jnp.nan, 1 - gauge), reading, y)


def folded_verdict(reading: Reading, u: jax.Array, y: jax.Array) -> jax.Array:
    """Return the margin (N,) with a proved sign of the windows of a stretch u (N + s, m), y (N + s, p): see
    `sets.strips.strips.strip_verdict`.

    A strip that lacks a datum has NaN for an error bound and for a ratio, which loses every comparison. A
    strip whose magnitudes overflow has an infinite error bound: its ratio is 1 or NaN, and the window is not
    inside.
    """
    gauge, largest = jnp.full((), -1, y.dtype), jnp.zeros((), y.dtype)
    for residual, width, error in tested(reading, u, y):
        value = jnp.abs(residual)
        # beyond its error bound a computed ratio is on the right side of 1
        ratio = jnp.where(jnp.abs(value - width) <= error, 1, value / width)
        # a larger one of two, written so, is one instruction; `maximum`, which keeps NaN, is four
        gauge = jnp.where(ratio > gauge, ratio, gauge)
        largest = jnp.where(error > largest, error, largest)
    margin = jnp.where((gauge < 1) & (largest == jnp.inf), 0, 1 - gauge)
    return _each(jnp.where(largest > 0, margin, jnp.nan), reading, y)


def tested(reading: Reading, u: jax.Array, y: jax.Array) -> Iterator[tuple[jax.Array, jax.Array, jax.Array]]:
    """Yield (residual, width, error bound of their comparison) of each strip, as `rounding.folded_error` has
    it; NaN where a datum is missing.
    """
    strips = reading.strips
    gamma, least = rounding.folded_error(strips.h.shape[1] + strips.k.shape[1], y.dtype)
    floor = least * (1 + jnp.max(jnp.abs(strips.h)) * jnp.max(_factors(reading)))
    for residual, width, size in _strips(reading, u, y):
        yield residual, width, gamma / ROOM * (size + ROOM * width) + floor


def _each(margin: jax.Array, reading: Reading, y: jax.Array) -> jax.Array:
    """Return margins (N,), also where no circuit looks at any sample."""
    return jnp.broadcast_to(margin, (y.shape[0] - reading.horizon,))


def _factors(reading: Reading) -> jax.Array:
    """Return a (p,), the last factor of a reading."""
    return 1 / (1 - reading.tolerance)


def _strips(reading: Reading, u: jax.Array, y: jax.Array) -> Iterator[_Strip]:
    """Yield the strips of all circuits, NaN where one needs what windows do not look at."""
    strips, top = reading.strips, np.finfo(y.dtype).max
    rows, inputs = _rows(reading, u, y), _inputs(reading, u, y)
    assert strips.supports is not None and strips.inputs is not None
    for c, support in enumerate(strips.supports):
        if not all(reading.window.all[i].seen for i in support):
            yield _Strip(*[jnp.full((), jnp.nan, y.dtype)] * 3)
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
        yield _strip(terms)


def _strip(terms: list[tuple[jax.Array, _Row]]) -> _Strip:
    """Return a strip from its rows and inputs with their coefficients; numbers are added first."""
    residual: Number = 0
    width: Number = 0
    size: Number = 0
    for H, row in terms:
        size += ROOM * jnp.abs(H) * row.still
    for H, row in sorted(terms, key=_of_samples):
        weight = jnp.abs(H)
        residual += H * row.mid
        if row.rad is not None:
            width += weight * row.rad
        size += ROOM * weight * row.size
    return _Strip(jnp.asarray(residual), jnp.asarray(width), jnp.asarray(size))


def _of_samples(term: tuple[jax.Array, _Row]) -> bool:
    """Return whether a term differs from window to window."""
    return term[1].mid.ndim > 0


def _rows(reading: Reading, u: jax.Array, y: jax.Array) -> list[_Row]:
    """Return the rows of all windows of a stretch y (N + s, p), those they look at."""
    count, factors = y.shape[0] - reading.horizon, _factors(reading)
    shares = jnp.maximum(reading.tolerance / (1 + reading.tolerance), rounding.tiny(y.dtype))
    noises = _noises(reading, u, y)
    rows = []
    for row in reading.window.all:
        if row.kind is Kind.DISTURBANCE:
            rows.append(_disturbance(reading, row, y.dtype))
            continue
        i = row.number
        sample = y[row.first : row.first + count, i]
        d = sample - reading.offset_y[i]
        rho = noises[i](row.first)
        over = jnp.abs(d) - rho
        q = jnp.where(over > 0, over, 0)
        mid, rad = d - shares[i] * _with_sign(q, d), rho + shares[i] * q
        rows.append(_Row(mid, rad, jnp.abs(sample), jnp.abs(reading.offset_y[i]), factors[i]))
    return rows


def _noises(reading: Reading, u: jax.Array, y: jax.Array) -> list[Callable[[int], jax.Array]]:
    """Return rho (N,) of each output, of (number of a sample in the windows): noise, resolution and what the
    recorder rounded away; a missing sample is no larger than 0.
    """
    count = y.shape[0] - reading.horizon
    ulps = np.asarray(sensor.RECORDER_ULPS * rounding.unit(y.dtype), y.dtype)
    noises: list[Callable[[int], jax.Array]] = []
    for i in range(y.shape[1]):
        largest: jax.Array = jnp.zeros((), y.dtype)
        for sample in range(reading.horizon + 1):
            if reading.window.looked_at(sample):
                size = jnp.abs(y[sample : sample + count, i])
                largest = jnp.where(size > largest, size, largest)
        # an infinite sample stays its own row's matter
        largest = jnp.minimum(largest, np.finfo(y.dtype).max)
        noise, rounded = reading.noise_at(u, i), largest * ulps
        still = noise + reading.resolution[i]
        still += ulps * noise + rounding.tiny(y.dtype)
        if i in reading.times:
            noises.append(partial(_at, still, rounded))
        else:
            noises.append(partial(_throughout, still + rounded))
    return noises


def _throughout(rho: jax.Array, first: int) -> jax.Array:
    """Return rho (N,), the same at all samples of a window."""
    return rho


def _at(still: jax.Array, rounded: jax.Array, first: int) -> jax.Array:
    """Return rho (N,) at one sample of windows. still: of each sample of a stretch."""
    return still[first : first + len(rounded)] + rounded


def _with_sign(size: jax.Array, sign: jax.Array) -> jax.Array:
    """Return sizes >= 0 with the signs of other numbers."""
    bits = np.dtype(f"int{8 * size.dtype.itemsize}")
    first = np.iinfo(bits).min
    patterns = [jax.lax.bitcast_convert_type(x, bits) for x in (size, sign)]
    return jax.lax.bitcast_convert_type(patterns[0] | (patterns[1] & first), size.dtype)


def _disturbance(reading: Reading, row: Row, dtype: np.dtype) -> _Row:
    """Return the row of a disturbance, of numbers."""
    lo, hi = reading.disturbance[row.number, 0], reading.disturbance[row.number, 1]
    tiny = rounding.tiny(dtype)
    return _Row(0.5 * (lo + hi), 0.5 * (hi - lo) + tiny, 0, abs(lo) + abs(hi) + tiny)


def _inputs(reading: Reading, u: jax.Array, y: jax.Array) -> list[_Row]:
    """Return the inputs of all windows of a stretch u (N + s, m)."""
    inputs = []
    for b, sample in enumerate(known_columns(reading, u, y.shape[0] - reading.horizon)):
        offset = reading.offset_u[b % len(reading.offset_u)]
        inputs.append(_Row(sample - offset, None, jnp.abs(sample), jnp.abs(offset)))
    return inputs


def known_columns(reading: Reading, u: jax.Array, count: int) -> list[jax.Array]:
    """Return the inputs of N windows of a stretch u (N + s, m) as columns (N,), time-major."""
    lags = reading.lags if reading.acting is None else reading.acting
    return columns(reading.known_inputs(u), lags, count)


def columns(x: jax.Array, lags: int, count: int) -> list[jax.Array]:
    """Return the samples x (N + lags - 1, n) of N windows as columns (N,), time-major."""
    return [x[lag : lag + count, i] for lag in range(lags) for i in range(x.shape[1])]
