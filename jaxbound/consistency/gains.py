"""Constant tolerances over windows: one linear program in unknowns and gains, its proofs in NumPy.

A reading is y = (1 + theta_i) t + delta, theta_i the same in all samples of output i. With gains g_i = 1 / (1
+ theta_i) a true value lies between g_i (d - rho) and g_i (d + rho), d = y - offset: linear in unknowns and
gains together. So a window is asked once, as one that lacks samples (`search_on_host`): each gain is an
unknown of its own, each row two, of which one side counts. Disturbances are rows with the gain 1.

The unknowns at the gains that were found explain the window, whose rows are then those of a certain model, or
one combination h contradicts it for all gains: the sum of the rows of an output is multiplied by its gain,
and extreme at its ends.

Source: Adrot, Maquin, Ragot 2000, (7)-(9), with theta constant as in Adrot 1999.
"""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import TypeAlias

import jax
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.check import LEAST, UNIT, HostImage
from jaxbound.consistency.host_rows import doubles
from jaxbound.consistency.interface import LinearRelations
from jaxbound.consistency.search_on_host import TOLD, Found, HolesTest
from jaxbound.consistency.strips_on_host import excludes_0
from jaxbound.models.rows import Kind
from jaxbound.recordings.recording import Recording
from jaxbound.sets.strips.chebyshev import fitted

Ends: TypeAlias = tuple[np.ndarray, np.ndarray]
"""(lo, hi) of gains, each (g, 1)."""


class GainsTest(HolesTest):
    """Decides windows of sensors whose gains keep one value: FAULT and CONSISTENT are proofs.

    The sign of the margin is that of the verdict, its size that of the unknowns and gains that were found: 1
    - t, t not below the true factor.

    Args:
        relations: with a frame. method, dtype: as of a `WindowTest`.
    """

    block = 2**9
    least = 1e-6

    def __init__(self, relations: LinearRelations, method: str, dtype: DTypeLike) -> None:
        super().__init__(relations, dtype)
        self.method = method

    def image(self, u: np.ndarray, y: np.ndarray) -> "_Gained":
        """Return the rows of windows at gains of 1."""
        frame, outputs = self.reading.frame, len(self.reading.noise)
        rows = HostImage.of(self.reading, u, y, certain=True)
        order = [self.reading.window.all[i] for i in np.concatenate([frame.outer, frame.inner])]
        number = np.array([row.number if row.kind is Kind.READING else outputs for row in order])
        own = number == np.arange(outputs + 1)[:, None]
        sigma = np.append(doubles(self.reading.tolerance), 0)[:, None]
        # the last row, of disturbances, has the gain 1
        low, high, fixed = 1 / (1 + sigma), 1 / (1 - sigma), sigma == 0
        slip = 4 * UNIT
        # a wider box refutes, a narrower one explains: rounding of the ends harms neither
        around = np.where(fixed, 1, low * (1 - slip)), np.where(fixed, 1, high * (1 + slip))
        within = np.minimum(low * (1 + slip), 1), np.maximum(high * (1 - slip), 1)
        return _Gained(**vars(rows), gains=around, inner=within, own=own)

    def hints(self, image: HostImage) -> tuple[Found, HostImage]:
        """Return the hints of a search, and the rows at the gains that it found."""
        assert isinstance(image, _Gained)
        gains, found = image.searched(image.acting)
        tolerance = np.asarray(self.reading.tolerance)[:, None]
        # how much of its tolerance each gain uses counts as any bound does
        off = np.abs(1 / gains[:-1] - 1) / np.where(tolerance > 0, tolerance, np.inf)
        factor = np.maximum(image.factor(gains, found.x), off.max(0))
        return found._replace(t=factor), image.at(np.clip(gains, *image.inner))

    def margins(self, given: Recording) -> jax.Array:
        """Raise: the best gains are found by a search that has no derivative."""
        raise NotImplementedError(
            "margins has no fast path for constant_tolerance, whose gains are searched for: use "
            "detect(...).margin"
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Gained(HostImage):
    """Rows at gains of 1. Fields: gains, inner: (lo, hi), each (g, 1), boxes of gains around all and within
    them, the last for rows that have none; own (g, c + k): which rows each multiplies.
    """

    gains: Ends
    inner: Ends
    own: np.ndarray

    @property
    def hull(self) -> HostImage:
        """The same rows at any gains."""
        lo, hi = map(self._each, self.gains)
        ends = np.minimum(lo * self.lo, hi * self.lo), np.maximum(lo * self.hi, hi * self.hi)
        return self._between(*ends)

    def at(self, gains: np.ndarray) -> HostImage:
        """Return the rows at gains (g, N)."""
        return self._between(self._each(gains) * self.lo, self._each(gains) * self.hi)

    def _each(self, gains: np.ndarray) -> np.ndarray:
        """Return the gain of each row."""
        return np.asarray(self.own.T @ gains)

    def _between(self, lo: np.ndarray, hi: np.ndarray) -> HostImage:
        """Return the rows between ends; twice their magnitudes pay for the products."""
        top = 2 * self.gains[1].max()
        sizes = {"size": top * self.size, "magnitude": top * self.magnitude, "floor": top * self.floor}
        own = {field.name: getattr(self, field.name) for field in fields(HostImage)}
        return HostImage(**own | sizes | {"lo": lo, "hi": hi})

    def excludes(self, weights: np.ndarray, value: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Return (N,) bool: whether weighted rows, less a value, are never 0, whatever the gains.

        Twice the error, times the largest gain, pays for rows that it multiplies once more; as much again for
        the sum over gains, which are fewer than rows.
        """
        (lo, hi), used = self.gains, weights != 0
        one, other = np.where(used, weights * self.lo, 0), np.where(used, weights * self.hi, 0)
        below, above = self.own @ np.minimum(one, other), self.own @ np.maximum(one, other)
        # extreme at the ends of each gain: the sum of its rows is linear in it
        least, most = np.minimum(lo * below, hi * below), np.maximum(lo * above, hi * above)
        return excludes_0(least.sum(0) - value, most.sum(0) - value, 4 * hi.max() * error)

    @cached_property
    def _parts(self) -> np.ndarray:
        """(g, c + k, N): what the middles of the rows of each gain add to z; nothing to inner rows."""
        c, middles = len(self.R), self.own[:, :, None] * self.middle
        return np.concatenate([middles[:, :c] - self.R @ middles[:, c:], 0 * middles[:, c:]], 1)

    @cached_property
    def _rows(self) -> tuple[np.ndarray, np.ndarray]:
        """(columns (N, c + k, k + n), driven (c + k, N)): of unknowns, and of inputs, in all rows."""
        k, columns = self.R.shape[1], self.columns
        inner = np.zeros((len(columns), k, columns.shape[2]))
        inner[:, :, :k] = np.eye(k)
        driven = self.K @ self.known
        return np.concatenate([columns, inner], 1), np.concatenate([driven, np.zeros((k, driven.shape[1]))])

    def searched(self, free: np.ndarray) -> tuple[np.ndarray, Found]:
        """Return gains (g, N) and hints of one linear program: a row lies between two ends that are linear in
        the gains.

        Args: free (N, k + n): which unknowns are without bounds.
        """
        (c, k), (count, width) = self.R.shape, free.shape
        lo, hi = self.gains
        mid, half = ((hi + lo) / 2)[:, 0], ((hi - lo) / 2)[:, 0]
        moves = half > 0
        reach = np.maximum(self._each(hi) * self.radius, LEAST)
        columns, driven = self._rows
        rows, values = [], []
        for sign in (1, -1):  # 0 <= sign (g (middle + sign radius) - value of the row) <= 2 reach
            ends = self._parts + sign * self.own[:, :, None] * self.radius
            gained = -(half[:, None, None] * ends)[moves]
            rows.append(np.concatenate([columns, gained.transpose(2, 1, 0)], 2))
            values.append(np.tensordot(mid, ends, 1) - driven - sign * reach)
        unit = np.tile(reach.T, 2)
        there = np.tile(self.there.T, 2)
        B = np.where(there[:, :, None], np.concatenate(rows, 1) / unit[:, :, None], 0)
        b = np.concatenate(values).T / unit
        b = np.concatenate([b, np.zeros((count, B.shape[2]))], 1)
        every = np.concatenate([free, np.zeros((count, moves.sum()), bool)], 1)
        scale = np.ones_like(every, float)
        scale[:, :k] = reach[c:].T
        largest = np.abs(B).max(1)
        scale = np.where(every, 1 / np.where(largest > 0, largest, 1), scale)
        fit = fitted(B * scale[:, None], b, np.ones_like(b), there, every, TOLD)
        x, h = fit.x * scale, np.where(there, fit.h / unit, 0)
        gains = np.tile(mid[:, None], count)
        gains[moves] += half[moves, None] * x[:, width:].T
        # far outside anyway: a search without a solution must not overflow
        gains = np.clip(gains, lo / 2, 2 * hi)
        # of both sides of a row one at most counts
        h = (h[:, :c] + h[:, c + k : 2 * c + k]).T
        top = np.abs(h).max(0, initial=0)
        telling = np.where(fit.telling < 0, -1, fit.telling % (c + k))[:, :width]
        idle = self.there[:c].sum(0) == (telling >= 0).sum(1)
        return gains, Found(fit.t, x[:, :width].T, h / np.where(top > 0, top, 1), telling, idle)

    def factor(self, gains: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the factor (N,) on the bounds of all rows at which what was found explains them."""
        columns, driven = self._rows
        off = (self._parts * gains[:, None]).sum(0) - driven
        off = np.abs(off - np.einsum("ncq,qn->cn", columns, x))
        room = np.maximum(self._each(gains) * self.radius, LEAST)
        return np.asarray(np.where(self.there, off / room, 0).max(0))
