"""Many strips, each with a verdict of its own: which relations of a bank hold, in one pass over the samples.

The test of each strip is that of `strips`. Supports and the known values that a strip uses are static, so
that nothing is computed for a coefficient that is 0. Verdicts are packed, two bits each, and travel with the
margin in one complex number: a kernel with two results does its work twice.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.exact.linalg import Rows
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips.strips import RowValues

__all__ = ["PACKED", "Bank", "bank_of", "bank_range", "bank_verdicts", "unpacked", "verdict_dtypes"]

PACKED = 16
"""Statuses in a word of 32 bits."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Bank:
    """R strips h (over the box), k (over known values) in floats, nearest to the exact rationals.

    Fields: h, k: coefficients that are not 0, strip by strip; rows, known: static, a tuple for each strip of
    what they belong to.
    """

    h: jax.Array | np.ndarray
    k: jax.Array | np.ndarray
    rows: tuple[tuple[int, ...], ...] = field(metadata={"static": True})
    known: tuple[tuple[int, ...], ...] = field(metadata={"static": True})


def bank_of(exact_h: Rows, exact_k: Rows, dtype: DTypeLike) -> Bank:
    """Build a Bank from exact rows.

    Raises ValueError: coefficients that the float type does not hold.
    """
    used = lambda a: tuple(tuple(i for i, x in enumerate(row) if x) for row in a)
    numbers = lambda a: np.array([rounding.fraction_to_float(x) for row in a for x in row if x], dtype)
    h, k = numbers(exact_h), numbers(exact_k)
    size = np.abs(np.concatenate([h, k]))
    if not ((size >= rounding.tiny(dtype)) & (size <= np.finfo(dtype).max)).all():
        raise ValueError(
            f"the coefficients of the bank span more than {np.dtype(dtype).name} holds: rescale the signals "
            f"or use float64"
        )
    return Bank(h, k, used(exact_h), used(exact_k))


def bank_verdicts(
    bank: Bank,
    mid: RowValues,
    rad: RowValues,
    scale: RowValues,
    known: RowValues,
    known_scale: RowValues,
    lift: jax.Array | float,
) -> tuple[jax.Array, ...]:
    """Return the proved Status of each strip alone and the margin of the tightest one, packed as `unpacked`
    reads it.

    Args:
        bank: from `bank_of`. mid, rad, scale, known, known_scale, lift: as for `strips.strip_verdict`.
    """
    words: list[jax.Array] = []
    gauge = jnp.full_like(mid[0], -1)
    for c, (residual, width, error) in enumerate(_each(bank, mid, rad, scale, known, known_scale, lift)):
        size, absent = jnp.abs(residual), jnp.isnan(error)
        fault, holds = size - width > error, width - size > error
        code = (jnp.where(fault, 3, 0) | jnp.where(holds, 1, 0)).astype(
            jnp.uint32
        )  # both comparisons are false for NaN
        code = jnp.where(
            code == 0, jnp.where(absent, jnp.uint32(Status.MISSING), jnp.uint32(Status.UNDECIDED)), code
        )
        code <<= np.uint32(2 * (c % PACKED))
        words = [*words, code] if c % PACKED == 0 else [*words[:-1], words[-1] | code]
        ratio = jnp.where(jnp.abs(size - width) > error, size / width, 1)
        gauge = jnp.maximum(gauge, jnp.where(absent, -1, ratio))
    margin = jnp.where(gauge < 0, jnp.nan, 1 - gauge)
    bits = words[0].astype(_bits(margin.dtype))
    return jax.lax.complex(margin, jax.lax.bitcast_convert_type(bits, margin.dtype)), *words[1:]


def unpacked(first: np.ndarray, *others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the words (words, ...) uint32, strip c in two bits of word c // PACKED, and the margins (...),
    its sign as proved.
    """
    word = np.ascontiguousarray(first.imag).view(_bits(first.real.dtype)).astype(np.uint32)
    return np.stack([word, *others]), np.ascontiguousarray(first.real)


def verdict_dtypes(bank: Bank, dtype: DTypeLike) -> tuple[DTypeLike, ...]:
    """Return the dtypes of what `bank_verdicts` gives for samples of a dtype."""
    return (np.result_type(dtype, np.complex64), *[np.uint32] * (-(-len(bank.rows) // PACKED) - 1))


def _bits(dtype: DTypeLike) -> type[np.unsignedinteger]:
    sizes: dict[int, type[np.unsignedinteger]] = {4: np.uint32, 8: np.uint64}
    return sizes[np.dtype(dtype).itemsize]


def bank_range(
    bank: Bank,
    mid: RowValues,
    rad: RowValues,
    scale: RowValues,
    known: RowValues,
    known_scale: RowValues,
    lift: jax.Array | float,
) -> tuple[jax.Array, jax.Array]:
    """Return (lo, hi), what all strips that have their data say together of one number, h x - k v for every
    strip; entire where none has.

    The number is within the width of the residual; its two ends are off by less than the error bound, which
    also covers their own rounding twice over: it is more than 32 unit roundoffs of everything that enters.
    """
    lo, hi = jnp.full_like(mid[0], -jnp.inf), jnp.full_like(mid[0], jnp.inf)
    for residual, width, error in _each(bank, mid, rad, scale, known, known_scale, lift):
        absent = jnp.isnan(error)
        lo = jnp.maximum(lo, jnp.where(absent, -jnp.inf, residual - width - 2 * error))
        hi = jnp.minimum(hi, jnp.where(absent, jnp.inf, residual + width + 2 * error))
    return lo, hi


def _each(
    bank: Bank,
    mid: RowValues,
    rad: RowValues,
    scale: RowValues,
    known: RowValues,
    known_scale: RowValues,
    lift: jax.Array | float,
) -> Iterator[tuple[jax.Array | int, jax.Array | int, jax.Array]]:
    """Yield (residual, width, error bound of their comparison) of every strip; the last is NaN where data are
    missing.
    """
    widest = max(map(len, bank.rows)) + max(map(len, bank.known))
    gamma, least = rounding.residual_error(widest, mid[0].dtype)
    floor = least * (1 + jnp.max(jnp.abs(bank.h))) * lift
    a = b = 0
    for rows, inputs in zip(bank.rows, bank.known, strict=True):
        residual: jax.Array | int = 0
        width: jax.Array | int = 0
        magnitude: jax.Array | int = 0
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
