"""Many strips, each with a verdict of its own: which relations of a bank hold, in one pass over the samples.

The test of each strip is that of `sets.strips`. Supports and the known values that a strip uses are static, so that nothing is computed for
a coefficient that is 0; the verdicts come out packed, two bits each, because a kernel with one result runs twice as fast as one with two.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets import rounding
from jaxbound.sets.status import Status

__all__ = ["PACKED", "Bank", "bank_margin", "bank_of", "bank_range", "bank_statuses"]

PACKED = 16
"""Statuses in a word of 32 bits."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Bank:
    """R strips h (over the box), k (over known values) in floats, nearest to the exact rationals.

    Fields: h, k: coefficients that are not 0, strip by strip; rows, known: static, a tuple for each strip of what they belong to.
    """

    h: jax.Array
    k: jax.Array
    rows: tuple = field(metadata={"static": True})
    known: tuple = field(metadata={"static": True})


def bank_of(exact_h, exact_k, dtype):
    """Build a Bank from exact rows.

    Raises ValueError: coefficients that the float type does not hold.
    """
    used = lambda a: tuple(tuple(i for i, x in enumerate(row) if x) for row in a)
    numbers = lambda a: np.array([rounding.fraction_to_float(x) for row in a for x in row if x], dtype)
    h, k = numbers(exact_h), numbers(exact_k)
    size = np.abs(np.concatenate([h, k]))
    if not ((size >= rounding.tiny(dtype)) & (size <= np.finfo(dtype).max)).all():
        raise ValueError(f"the coefficients of the bank span more than {np.dtype(dtype).name} holds: rescale the signals or use float64")
    return Bank(h, k, used(exact_h), used(exact_k))


def bank_statuses(bank, mid, rad, scale, known, known_scale, lift):
    """Return the proved Status of each strip alone, packed: uint32 words, strip c in two bits of word c // PACKED.

    Args:
        bank: from `bank_of`. mid, rad, scale, known, known_scale, lift: as for `strips.strip_verdict`.
    """
    words = []
    for c, (residual, width, error) in enumerate(_each(bank, mid, rad, scale, known, known_scale, lift)):
        size = jnp.abs(residual)
        fault, holds = size - width > error, width - size > error
        code = (jnp.where(fault, 3, 0) | jnp.where(holds, 1, 0)).astype(jnp.uint32)  # both comparisons are false for NaN
        code = jnp.where(code == 0, jnp.where(jnp.isnan(error), jnp.uint32(Status.MISSING), jnp.uint32(Status.UNDECIDED)), code)
        code <<= np.uint32(2 * (c % PACKED))
        words = [*words, code] if c % PACKED == 0 else [*words[:-1], words[-1] | code]
    return words


def bank_margin(bank, mid, rad, scale, known, known_scale, lift):
    """Return the margin of the tightest strip, its sign as proved, as `strips.strip_verdict`."""
    gauge = jnp.full_like(mid[0], -1)
    for residual, width, error in _each(bank, mid, rad, scale, known, known_scale, lift):
        ratio = jnp.where(jnp.abs(jnp.abs(residual) - width) > error, jnp.abs(residual) / width, 1)
        gauge = jnp.maximum(gauge, jnp.where(jnp.isnan(error), -1, ratio))
    return jnp.where(gauge < 0, jnp.nan, 1 - gauge)


def bank_range(bank, mid, rad, scale, known, known_scale, lift):
    """Return (lo, hi), what all strips that have their data say together of one number, h x - k v for every strip; entire where none has.

    The number is within the width of the residual; its two ends are off by less than the error bound, which also covers their own
    rounding twice over: it is more than 32 unit roundoffs of everything that enters.
    """
    lo, hi = jnp.full_like(mid[0], -jnp.inf), jnp.full_like(mid[0], jnp.inf)
    for residual, width, error in _each(bank, mid, rad, scale, known, known_scale, lift):
        absent = jnp.isnan(error)
        lo = jnp.maximum(lo, jnp.where(absent, -jnp.inf, residual - width - 2 * error))
        hi = jnp.minimum(hi, jnp.where(absent, jnp.inf, residual + width + 2 * error))
    return lo, hi


def _each(bank, mid, rad, scale, known, known_scale, lift):
    """Yield (residual, width, error bound of their comparison) of every strip; the last is NaN where data are missing."""
    widest = max(map(len, bank.rows)) + max(map(len, bank.known))
    gamma, floor = rounding.residual_error(widest, mid[0].dtype)
    floor = floor * (1 + jnp.max(jnp.abs(bank.h))) * lift
    a = b = 0
    for rows, inputs in zip(bank.rows, bank.known, strict=True):
        residual, width, magnitude = 0, 0, 0
        for i in rows:
            size = jnp.abs(bank.h[a])
            residual += bank.h[a] * mid[i]
            width += size * rad[i]
            magnitude += size * scale[i]
            a += 1
        for j in inputs:
            residual -= bank.k[b] * known[j]
            magnitude += jnp.abs(bank.k[b]) * known_scale[j]
            b += 1
        yield residual, width, gamma * magnitude + floor
