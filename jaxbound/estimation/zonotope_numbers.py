"""The numbers that a set observer computes with: a model in floats, and the set of its first state."""

from fractions import Fraction
from typing import NamedTuple

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

ROUNDED = 1 + 1e-9
"""Above what rounding does to a few thousand sums and products of numbers >= 0 in float64."""


class FirstSet(NamedTuple):
    """A set {center + generators xi + diag(box) eta}, |xi|, |eta| <= 1, that holds the first state.

    Fields: center (n,), generators (n, q), box (n,): what rounding took off; whole: whether it is no larger
    than what was given, but for the box.
    """

    center: np.ndarray
    generators: np.ndarray
    box: np.ndarray
    whole: bool

    def padded(self, n: int) -> "FirstSet":
        """Return the set with zeros for further states, n in all."""
        more = n - len(self.center)
        return FirstSet(
            np.pad(self.center, (0, more)),
            np.pad(self.generators, ((0, more), (0, 0))),
            np.pad(self.box, (0, more)),
            self.whole,
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
    matrices = system.A, system.B, system.C, system.D, system.offset["u"]
    (A, off_A), (B, off_B), (C, off_C), (D, off_D), (u0, off_u0) = (
        _in_dtype(*middle(x), dtype) for x in matrices
    )
    if linear is not None and linear.g:
        W, w, off_w = _disturbance(linear, dtype)
    else:
        w, half = _in_dtype(*middle(system.w), dtype)
        W, off_w = np.diag(half)[:, half > 0], np.zeros_like(w)
    tolerance, noise = (rounding.round_up(x, dtype) for x in (system.tolerance, system.noise))
    y0 = middle(system.offset["y"])[0].astype(dtype)  # rounded once: `sensor.true_value` counts it
    return Numbers(
        A, off_A, B, off_B, C, off_C, D, off_D, W, w, off_w, u0, off_u0, tolerance, noise, y0, free
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
    ways = directions.ways
    used = np.array([[i in way.outputs for way in ways] for i in range(linear.p)])
    moved = linalg.matmul(linear.C, linalg.transpose(directions.rows))
    return Free(
        *_stacked_matrices([way.M for way in ways], dtype),
        *_stacked_matrices([way.H for way in ways], dtype),
        used,
        before=np.array(directions.before),
        after=np.array(directions.after),
        shown=np.array(list(map(any, moved))),
        first=np.array(all_in_bounds),
    )


def _stacked_matrices(matrices: list[Matrix], dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
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
        with np.errstate(invalid="ignore"):  # of ends that are infinite: refused below
            center, radius = middle(interval(x0))
        generators = np.diag(radius) if radius.ndim == 1 else radius
    if center.shape != (n,):
        raise ValueError(f"x0 needs one interval for each of {n} states: its shape is {center.shape}")
    if not (np.isfinite(center).all() and np.isfinite(generators).all()):
        raise ValueError("x0 must be bounded: give each state an interval, it need not be narrow; or no x0")
    near = Zonotope(jnp.asarray(center.astype(dtype)), jnp.asarray(generators.astype(dtype)))
    off = np.abs(center - center.astype(dtype)) + np.abs(generators - generators.astype(dtype)).sum(1)
    fewer = reduce_order(near, order)
    box = rounding.round_up(off * ROUNDED, dtype)
    return FirstSet(np.asarray(fewer.center), np.asarray(fewer.generators), box, fewer is near)


def _in_dtype(mid: np.ndarray, away: np.ndarray, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
    """Return (mid, away) in floats of a dtype, the second not too small."""
    near = mid.astype(dtype)
    away = away + np.abs(mid - near.astype(np.float64))
    return near, rounding.round_up(np.where(away > 0, np.nextafter(away, np.inf), 0), dtype)


def nearest(rows: Rows, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
    """Return (floats of a dtype, bounds of their errors in float64) of exact rows."""
    exact = np.array(rows, object).reshape(len(rows), -1 if len(rows) else 0)
    near = exact.astype(np.float64).astype(dtype)
    return near, rounding.round_up(np.abs(exact - np.array(exactly(near), object).reshape(near.shape)))


def exactly(floats: np.ndarray) -> Matrix:
    """Return floats (r, n) as the rationals that they are."""
    return tuple(tuple(Fraction(float(x)) for x in row) for row in floats)
