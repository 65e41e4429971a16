"""The linear programs of constrained zonotopes {x = -b + A xi : rows below the first n are 0}: whether any xi
is left, and between which ends the first n rows are. Proved in float64, for any multipliers that a search
found.
"""

from typing import NamedTuple

import numpy as np

from jaxbound.estimation.arrays import Array
from jaxbound.estimation.constrained_steps import AskedRows
from jaxbound.sets.floats import rounding
from jaxbound.sets.zonotopes import gauges, proof

__all__ = ["Rows", "refuted", "row_hulls", "rows_at"]

HULLS, SEARCH = 256, 12
"""Sets whose hulls are looked for at a time, and steps of it."""


class Rows(NamedTuple):
    """Rows A xi = b +- s of S sets, |xi| <= 1, in float64.

    Fields: b, s (S, k); A (S, k, q).
    """

    b: np.ndarray
    A: np.ndarray
    s: np.ndarray

    def part(self, rows: slice) -> "Rows":
        """Return some of the rows of each set."""
        return Rows(self.b[:, rows], self.A[:, rows], self.s[:, rows])

    def some(self, sets: slice | np.ndarray) -> "Rows":
        """Return some of the sets."""
        return Rows(self.b[sets], self.A[sets], self.s[sets])


def rows_at(asked: AskedRows, at: tuple[np.ndarray, ...]) -> Rows:
    """Return the rows of samples `at`, sets first."""

    def sets_first(x: Array) -> np.ndarray:
        return np.ascontiguousarray(np.moveaxis(np.asarray(x), -1, 1)[at], np.float64)

    return Rows(sets_first(-asked.h), sets_first(asked.H), sets_first(asked.r))


def refuted(asked: AskedRows, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (wrong, margin), (T, N) each: where no xi in the unit box has all rows below the first n at 0,
    and 1 - t there.
    """
    wrong, margin = np.zeros(asked.on.shape, bool), np.full(asked.on.shape, np.inf)
    at = np.nonzero(asked.on)
    if not len(at[0]):
        return wrong, margin
    rows = rows_at(asked, at).part(slice(n, None))
    image = proof.image(rows.A)
    bounds = gauges.gauge_bounds(image, image.scaled(rows.b[:, None]))
    beyond = np.flatnonzero(bounds.lower[:, 0] > 1)
    multipliers = np.ldexp(bounds.l[beyond, 0], image.powers[beyond])
    value, reach = _value_and_reach(rows.some(beyond), multipliers[:, None])
    with np.errstate(all="ignore"):
        far = np.abs(value[:, 0]) / reach[:, 0]
    proved = (far > 1) & np.isfinite(far)
    where = tuple(x[beyond] for x in at)
    wrong[where], margin[where] = proved, np.where(proved, 1 - far, np.inf)
    return wrong, margin


def _value_and_reach(rows: Rows, l: np.ndarray, g: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return (value, reach), (S, d) each: l b, and at least |(g - l A) xi| + |l| s with all that rounding may
    add to both.

    Args:
        l (S, d, k): multipliers. g (S, d, q): directions; None: 0.
    """
    b, A, s = rows
    terms = A.shape[1] + A.shape[2] + 2
    gamma, floor = (float(x) for x in rounding.product_error(terms, np.float64))
    with np.errstate(all="ignore"):
        size = np.abs(l)
        left = -(l @ A)
        if g is not None:
            left = g - l @ A
        reach = np.abs(left).sum(-1) + (size * s[:, None]).sum(-1)
        whole = (size * (np.abs(b) + np.abs(A).sum(2) + s)[:, None]).sum(-1)
        if g is not None:
            whole = np.abs(g).sum(-1) + whole
        largest = (1 + np.abs(b).max(1) + np.abs(A).max((1, 2)))[:, None]
        least = terms * floor * (1 + size.max(-1)) * largest
        return (l * b[:, None]).sum(-1), (reach + gamma * whole + least) * (1 + 1e-9)


def row_hulls(rows: Rows, n: int) -> np.ndarray:
    """Return ends -lo, hi (S, 2 n) of the first n rows, of middle -b, over all xi in the unit box that have
    the others at 0.
    """
    starts = range(0, len(rows.b), HULLS)
    return np.concatenate([_hull(rows.some(slice(first, first + HULLS)), n) for first in starts])


def _hull(rows: Rows, n: int) -> np.ndarray:
    """Return the ends of some sets. For every l: g xi <= l b + |g - l A|_1, the dual program.

    The l are those of least squares, each entry weighted by 1 / |g - l A| of the one before (Lawson 1961),
    with the slope b.
    """
    state, constraints = rows.part(slice(0, n)), rows.part(slice(n, None))
    g = np.concatenate([-state.A, state.A], 1)
    c = np.concatenate([state.b, -state.b], 1)
    r = np.tile(state.s, 2)
    size = np.abs(g).sum(2, keepdims=True) + 1e-300
    l, best = np.zeros((*g.shape[:2], constraints.A.shape[1])), np.full(g.shape[:2], np.inf)
    for step in range(SEARCH):
        with np.errstate(all="ignore"):
            l = _reweighted(constraints, g, l, size * 0.3 ** (step + 3))
        l = np.where(np.isfinite(l).all(-1, keepdims=True), l, 0)
        value, reach = _value_and_reach(constraints, l, g)
        best = np.fmin(best, value + reach + 1e-15 * np.abs(value))
    ends: np.ndarray = c + best + r + 1e-15 * (np.abs(c) + np.abs(best) + r)
    return ends


def _reweighted(rows: Rows, g: np.ndarray, l: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Return the multipliers of the next step of Lawson's least squares. floor: of the entries g - l A."""
    A, count = rows.A, rows.A.shape[1]
    D = 1 / (np.abs(g - l @ A) + floor)
    gram = (A[:, None] * D[:, :, None]) @ A.swapaxes(1, 2)[:, None]
    ridge = 1e-13 * np.trace(gram, axis1=2, axis2=3) + 1e-300
    gram += ridge[..., None, None] * np.eye(count)
    right = (D * g) @ A.swapaxes(1, 2) - rows.b[:, None]
    return np.linalg.solve(gram, right[..., None])[..., 0]
