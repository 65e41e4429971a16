"""The numbers that a set observer computes with: a model in floats, and the set of its first state."""

from fractions import Fraction
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.estimation.free_inputs import Free
from jaxbound.estimation.zonotope_steps import Numbers
from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, Rows
from jaxbound.models.intervals import IntervalSystem
from jaxbound.models.system import LinearSystem
from jaxbound.models.unknown_directions import Directions
from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals.interval import Interval, interval
from jaxbound.sets.zonotopes.reduction import reduce_order
from jaxbound.sets.zonotopes.zonotope import Zonotope

__all__ = ["ROUNDED", "FirstSet", "exactly", "first_set", "free_numbers", "middle", "nearest", "numbers"]

ROUNDED = 1 + 1e-9
"""Above what rounding does to a few thousand sums and products of numbers >= 0 in float64."""


class FirstSet(NamedTuple):
    """A set {center + generators xi + diag(box) eta}, |xi|, |eta| <= 1, that holds the first state.

    Fields: center (n,), generators (n, q), box (n,).
    """

    center: np.ndarray
    generators: np.ndarray
    box: np.ndarray

    def padded(self, n: int) -> "FirstSet":
        """Return the set with zeros for further states, n in all."""
        more = n - len(self.center)
        return FirstSet(
            np.pad(self.center, (0, more)),
            np.pad(self.generators, ((0, more), (0, 0))),
            np.pad(self.box, (0, more)),
        )


def middle(x: Interval) -> tuple[np.ndarray, np.ndarray]:
    """Return (middle, how far the ends may be from it) in float64."""
    lo, hi = np.asarray(x.lo, np.float64), np.asarray(x.hi, np.float64)
    mid = 0.5 * lo + 0.5 * hi
    reach = np.nextafter(np.maximum(hi - mid, mid - lo), np.inf)
    return mid, np.where(lo == hi, 0, reach)


def numbers(
    linear: LinearSystem | None, system: IntervalSystem, dtype: np.dtype, free: Free | None = None
) -> Numbers:
    """Return the Numbers of a model in floats of a dtype.

    Args:
        linear: the model, or None of an `interval_system`. system: with intervals as its entries. free: see
            `free_numbers`.
    """
    A, wide_A = _narrowed(*middle(system.A), dtype)
    B, wide_B = _narrowed(*middle(system.B), dtype)
    C, wide_C = _narrowed(*middle(system.C), dtype)
    D, wide_D = _narrowed(*middle(system.D), dtype)
    if linear is not None and linear.g:
        W, w, wide_w = _disturbance(linear, dtype)
    else:
        w, half = _narrowed(*middle(system.w), dtype)
        W, wide_w = np.diag(half)[:, half > 0], np.zeros_like(w)
    u0, wide_u0 = _narrowed(*middle(system.offset["u"]), dtype)
    return Numbers(
        A,
        wide_A,
        B,
        wide_B,
        C,
        wide_C,
        D,
        wide_D,
        W=W,
        w=w,
        wide_w=wide_w,
        u0=u0,
        wide_u0=wide_u0,
        tolerance=rounding.round_up(system.tolerance, dtype),
        noise=rounding.round_up(system.noise, dtype),
        y0=middle(system.offset["y"])[0].astype(dtype),  # rounded once: `sensor.true_value` counts it
        free=free,
    )


def _disturbance(linear: LinearSystem, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (columns (n, g), middle (n,), how far off both are (n,)) of disturbances in their bounds."""
    half = [(hi - lo) / 2 for lo, hi in linear.disturbance]
    centre = [(hi + lo) / 2 for lo, hi in linear.disturbance]
    columns, off = nearest([[a * x for a, x in zip(row, half, strict=True)] for row in linear.G], dtype)
    w, off_w = nearest([(x,) for x in linalg.multiply(linear.G, centre)], dtype)
    return columns, w[:, 0], rounding.round_up((off.sum(1) + off_w[:, 0]) * ROUNDED, dtype)


def free_numbers(
    directions: Directions | None, linear: LinearSystem | None, all_in_bounds: bool, dtype: np.dtype
) -> Free | None:
    """Return the part of unknown inputs that kernels take, if there are any.

    Args:
        all_in_bounds: whether the bounds of a first state speak of all that moves it.
    """
    if directions is None or linear is None:
        return None
    M, wide_M = _stacked([way.M for way in directions.ways], dtype)
    H, wide_H = _stacked([way.H for way in directions.ways], dtype)
    used = np.array([[i in way.outputs for way in directions.ways] for i in range(linear.p)])
    moved = linalg.matmul(linear.C, linalg.transpose(directions.rows))
    return Free(
        M,
        wide_M,
        H,
        wide_H,
        used,
        before=np.array(directions.before),
        after=np.array(directions.after),
        shown=np.array([any(row) for row in moved]),
        first=np.array(all_in_bounds),
    )


def _stacked(matrices: list[Matrix], dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
    """Return (floats, bounds of their errors) of matrices, one behind the other on the last axis."""
    floats, errors = zip(*(nearest(matrix, dtype) for matrix in matrices), strict=True)
    return np.stack(floats, -1), rounding.round_up(np.stack(errors, -1), dtype)


def first_set(x0: Interval | Zonotope, n: int, order: float, dtype: np.dtype) -> FirstSet:
    """Return the set of the first state in a dtype, with at most `order` generators a state.

    Raises:
        ValueError: another number of states, a set without bounds.
    """
    if isinstance(x0, Zonotope):
        center, generators = np.asarray(x0.center, np.float64), np.asarray(x0.generators, np.float64)
    else:
        center, radius = _box(interval(x0))
        generators = np.diag(radius) if radius.ndim == 1 else radius
    if center.shape != (n,):
        raise ValueError(f"x0 needs one interval for each of {n} states: its shape is {center.shape}")
    if not (np.isfinite(center).all() and np.isfinite(generators).all()):
        raise ValueError("x0 must be bounded: give each state an interval, it need not be narrow; or no x0")
    near = Zonotope(jnp.asarray(center.astype(dtype)), jnp.asarray(generators.astype(dtype)))
    off = np.abs(center - center.astype(dtype)) + np.abs(generators - generators.astype(dtype)).sum(1)
    fewer = reduce_order(near, order)
    box = rounding.round_up(off * ROUNDED, dtype)
    return FirstSet(np.asarray(fewer.center), np.asarray(fewer.generators), box)


def _box(x0: Interval) -> tuple[np.ndarray, np.ndarray]:
    """Return (center, radius) of a box; both are inf where it has no bound."""
    bounded = np.isfinite(x0.lo) & np.isfinite(x0.hi)
    center, radius = middle(jax.tree.map(lambda end: np.where(bounded, end, 0), x0))
    return np.where(bounded, center, np.inf), np.where(bounded, radius, np.inf)


def _narrowed(mid: np.ndarray, away: np.ndarray, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
    """Return (mid, away) in floats of a dtype, the second not too small."""
    near = mid.astype(dtype)
    away = away + np.abs(mid - near.astype(np.float64))
    return near, rounding.round_up(np.where(away > 0, np.nextafter(away, np.inf), 0), dtype)


def nearest(rows: Rows, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
    """Return (floats of a dtype, bounds of their errors in float64) of exact rows."""
    width = len(rows[0]) if len(rows) else 0
    near = np.array([[float(x) for x in row] for row in rows]).reshape(len(rows), width).astype(dtype)
    if not width:
        return near, np.zeros(near.shape)
    off = np.empty(near.shape, object)
    for i, row in enumerate(rows):
        off[i] = [abs(x - Fraction(float(y))) for x, y in zip(row, near[i], strict=True)]
    return near, rounding.round_up(off)


def exactly(floats: np.ndarray) -> Matrix:
    """Return floats (r, n) as the rationals that they are."""
    return tuple(tuple(Fraction(float(x)) for x in row) for row in floats)
