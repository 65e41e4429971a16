"""Strips with fixed directions: the exact test of whether a known point lies in the image of a box, as one
elementwise kernel.

The set {h-combinations of b : b in a box with middle m and radius r} contains the known value k v iff, for
every circuit h,

    |sum_i h_i m_i - sum_j k_j v_j| <= sum_i |h_i| r_i                                        (strip)

(Source: a zonotope is the intersection of the strips of its circuits; the exactness theorem for Adrot
2000.) The gauge is the largest ratio of the two sides; the margin is 1 - gauge.

m, r and the magnitudes are arrays with one entry a row; an entry is a number (one window) or an array over
windows, and so is the result. A few circuits are unrolled with static supports, so that everything fuses into
one pass over memory; many run in a scan over circuits, whose compile time does not grow with their number.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.exact.linalg import Rows
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.status import Status

UNROLLED = 8  # up to here circuits are unrolled: above, compiling takes longer than a scan loses
FEW = 64  # up to here known values are unrolled in a scan: 366 of them compile for minutes


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Strips:
    """C circuits h with their action k on the known values, in floats (nearest to the exact rationals).

    Fields: rows (C, w): which rows a circuit uses; h (C, w); k (C, l); supports: the rows once more, static,
    if there are few; inputs: then the known values that each circuit uses, static. A circuit shorter than w
    repeats its first row, with that row's coefficient split by powers of two.
    """

    rows: jax.Array | np.ndarray
    h: jax.Array | np.ndarray
    k: jax.Array | np.ndarray
    supports: tuple[tuple[int, ...], ...] | None = field(metadata={"static": True})
    inputs: tuple[tuple[int, ...], ...] | None = field(default=None, metadata={"static": True})

    def astype(self, dtype: DTypeLike) -> Strips:
        """Return the strips in another float dtype; refuse coefficients that it would flush to zero."""
        low = [np.abs(x[x != 0]).min(initial=1) for x in (self.h, self.k)]
        high = [np.abs(x).max(initial=0) for x in (self.h, self.k)]
        if np.min(low) < rounding.tiny(dtype) or np.max(high) > np.finfo(dtype).max:
            raise ValueError(
                f"the coefficients span {np.min(low):.1g} to {np.max(high):.1g}, more than "
                f"{np.dtype(dtype).name} holds: "
                "rescale the signals or use float64"
            )
        return Strips(self.rows, self.h.astype(dtype), self.k.astype(dtype), self.supports, self.inputs)


def strips_of(exact_h: Rows, exact_k: Rows, unrolled: int = UNROLLED) -> Strips:
    """Build Strips from exact rows h (over the box) and k (over the known values), static up to so many."""
    widest = max(sum(1 for x in h if x) for h in exact_h)
    rows, coefficients, of_inputs = [], [], []
    for h, k in zip(exact_h, exact_k, strict=True):
        support = [i for i, x in enumerate(h) if x]
        values, padding = [rounding.fraction_to_float(h[i]) for i in support], widest - len(support)
        for _ in range(padding):  # halves are exact, and unlike 0 they do not turn an infinite row into NaN
            values[0] /= 2
            values.append(values[0])
        rows.append(support + support[:1] * padding)
        coefficients.append(values)
        of_inputs.append([rounding.fraction_to_float(x) for x in k])
    known = np.array(of_inputs).reshape(len(rows), -1)
    supports = inputs = None
    # static supports: each is code of its own
    if len(rows) <= unrolled:
        supports = tuple(map(tuple, rows))
        inputs = tuple(tuple(np.flatnonzero(row).tolist()) for row in known)
    return Strips(np.array(rows, np.int32), np.array(coefficients), known, supports, inputs)


def strip_margin(strips: Strips, mid: jax.Array, rad: jax.Array, known: jax.Array) -> jax.Array:
    """Return 1 - gauge, unrounded and differentiable; NaN where no circuit has all its data.

    Args:
        strips: C circuits over q rows and l known values.
        mid, rad: q middles (NaN: absent) and radii > 0 of the box.
        known: l known values.
    """

    def step(gauge, strip):
        residual, width, _ = _one(strip, mid, rad, rad, known, known)  # nobody reads a magnitude
        absent = jnp.isnan(residual)  # masked before the quotient too, which keeps NaN out of gradients
        return jnp.maximum(gauge, jnp.where(absent, -1, jnp.abs(jnp.where(absent, 0, residual)) / width))

    gauge = _fold(step, jnp.full_like(mid[0], -1), strips)
    return jnp.where(gauge < 0, jnp.nan, 1 - gauge)


def strip_verdict(
    strips: Strips,
    mid: jax.Array,
    rad: jax.Array,
    scale: jax.Array,
    known: jax.Array,
    known_scale: jax.Array,
    lift: jax.Array | float,
) -> jax.Array:
    """Return the margin with a proved sign: > 0 inside, < 0 outside, 0 where rounding cannot tell, NaN where
    no circuit has its data.

    Outside: one circuit is violated by more than its error bound. Inside: every circuit with data holds by
    more than its error bound, and the circuits describe the set exactly. Holds under any rounding that the
    compiler may choose.

    Args:
        strips, mid, rad, known: as for `strip_margin`.
        scale, known_scale: magnitudes of rows and known values as in `rounding.residual_error`, which has the
            proof.
        lift: at least every factor that multiplied a row after its own rounding (scalar).
    """
    gamma, least = rounding.residual_error(strips.h.shape[1] + strips.k.shape[1], mid[0].dtype)
    # what underflowed in a row is multiplied by what multiplies the row (lift), and by its coefficient
    floor = least * (1 + jnp.max(jnp.abs(strips.h))) * lift

    def step(gauge, strip):
        residual, width, magnitude = _one(strip, mid, rad, scale, known, known_scale)
        excess, error = jnp.abs(residual) - width, gamma * magnitude + floor
        # beyond its error bound a computed ratio is on the right side of 1; a strip that rounding leaves open
        # counts as 1
        ratio = jnp.where(jnp.abs(excess) > error, jnp.abs(residual) / width, 1)
        return jnp.maximum(
            gauge, jnp.where(jnp.isnan(magnitude), -1, ratio)
        )  # magnitudes only grow: NaN is absent data, overflow is inf

    gauge = _fold(step, jnp.full_like(mid[0], -1), strips)
    return jnp.where(gauge < 0, jnp.nan, 1 - gauge)


def status_of(margin: jax.Array | np.ndarray) -> Any:
    """Read the proved sign of a margin as a Status (int8); on the host in NumPy, which compiles nothing for
    each number of windows.
    """
    xp: Any = np if isinstance(margin, np.ndarray) else jnp
    status = xp.where(margin < 0, Status.FAULT, xp.where(margin > 0, Status.CONSISTENT, Status.UNDECIDED))
    return xp.where(xp.isnan(margin), Status.MISSING, status).astype(np.int8)


def _one(strip, mid, rad, scale, known, known_scale):
    """Evaluate one strip: the residual, its largest healthy size and the magnitude that its rounding error is
    relative to.
    """
    rows, h, k = strip
    residual: jax.Array | int = 0
    width: jax.Array | int = 0
    magnitude: jax.Array | int = 0
    for a in range(len(rows)):
        i, size = rows[a], jnp.abs(h[a])
        residual += h[a] * mid[i]
        width += size * rad[i]
        magnitude += size * scale[i]
    # many inputs in a loop, which compiles once for all of them
    if k.shape[0] > FEW:
        return residual - _driven(k, known), width, magnitude + _driven(jnp.abs(k), known_scale)
    for b in range(k.shape[0]):  # a missing value counts only where it is used
        residual -= jnp.where(k[b] == 0, 0, k[b] * known[b])
        magnitude += jnp.where(k[b] == 0, 0, jnp.abs(k[b]) * known_scale[b])
    return residual, width, magnitude


def _driven(k, known):
    """Return the sum of k_b known_b by a loop that compiles once."""

    def add(b, total):
        return total + jnp.where(k[b] == 0, 0, k[b] * known[b])

    return jax.lax.fori_loop(0, len(k), add, jnp.zeros_like(known[0]))


def _fold(step, carry, strips):
    """Run `step` over all circuits: unrolled if their supports are static, else in a scan."""
    if strips.supports is not None:
        for c, support in enumerate(strips.supports):
            carry = step(carry, (support, strips.h[c], strips.k[c]))
        return carry
    return jax.lax.scan(lambda c, s: (step(c, s), None), carry, (strips.rows, strips.h, strips.k))[0]
