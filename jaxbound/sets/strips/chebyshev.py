"""Chebyshev fits side by side, in NumPy: of N problems, the x for which max |b - B x| / r is smallest.

Each problem has rows and columns of its own: b, r (c,), B (c, q), and a row b = 0, B = e_i with its r for
each unknown x_i that is bounded. It is the search of `separation` where nothing is shared between windows, by
the same steps; see there for the source. Problems are the first axis. No claim.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.one_thread import times

CLOSE = float(10 * rounding.unit(np.float64) ** 0.75)
"""How much the largest error may exceed t where a search is done."""
WORTH = CLOSE**0.5
"""Share of the largest pivot below which none is taken: a small one would spoil the inverse."""
PATIENCE = 10
"""Exchanges per unknown after which a search is given up; it takes 2 to 4."""
NEAR = 2.0**-10
"""How far the inverse may be off, in the sums of a row of 1 - S P, for a Newton step to mend it: squared."""
LEAVE = 8
"""Exchanges after which a search leaves out the problems that are done."""


class Fit(NamedTuple):
    """The least largest errors of N problems, and where they are reached.

    Fields: t (N,), the largest error over its radius; x (N, q); h (N, c), multipliers with |h b| = t (|h| r +
    sum of |h B|_i r_i over bounded x_i) and h B near 0 elsewhere; telling (N, q): the row that tells an
    unknown without bounds, -1 for none; idle (N,): no row is left that tells anything.
    """

    t: np.ndarray
    x: np.ndarray
    h: np.ndarray
    telling: np.ndarray
    idle: np.ndarray


@dataclass
class _Search:
    """The state of some problems.

    Fields: rows (n, c + q, q), values, radius, there (n, c + q): all rows, those of the x_i last; P (n, q, q)
    is the inverse of the basis S (n, q), row numbers; signs (n, q) of its errors; leader (n,): the row beside
    it.
    """

    rows: np.ndarray
    values: np.ndarray
    radius: np.ndarray
    there: np.ndarray
    P: np.ndarray
    S: np.ndarray
    signs: np.ndarray
    leader: np.ndarray

    def of(self, some: np.ndarray) -> "_Search":
        """Return the state of some of the problems."""
        return _Search(*(x[some] for x in vars(self).values()))

    def _picked(self, number: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return one row of each problem, its value and its radius."""
        at = np.arange(len(number))
        return self.rows[at, number], self.values[at, number], self.radius[at, number]

    def _on_S(self, x: np.ndarray) -> np.ndarray:
        """Return numbers of rows (n, c + q), of those of the basis."""
        return x[np.arange(len(x))[:, None], self.S]  # in half the time of take_along_axis

    def exchange_free(self, free: np.ndarray, least: float) -> np.ndarray:
        """Exchange each unknown without bounds, where some row has at least this share of its column, for the
        row that tells it best, the best told one first; return these rows (n, q), -1 for none.

        In any other order unknowns that rows do not tell apart would be told by what rounding leaves.
        """
        at, q = np.arange(len(free)), free.shape[1]
        c = self.rows.shape[1] - q
        table, telling = self.rows[:, :c].copy(), np.full(free.shape, -1)
        size = np.abs(table) / self.radius[:, :c, None]
        largest = size.max(1, initial=0)
        plain = np.abs(table).max(1, initial=0)
        share = np.where(free & (largest > 0), 1 / np.where(largest > 0, largest, 1), 0)
        weight = (self.there / self.radius)[:, :c, None] * share[:, None, :]
        for _ in range(int(free.sum(1).max(initial=0))):
            np.multiply(np.abs(table, out=size), weight, out=size)
            j, s = np.divmod(size.reshape(len(free), -1).argmax(1), q)
            pivoted = (size[at, j, s] > 0) & (np.abs(table[at, j, s]) > least * plain[at, s])
            if not pivoted.any():
                break
            row = table[at, j]
            # a rank-one change puts the unit vector into the place of the column
            row[at, s] -= 1
            row *= np.where(pivoted, 1 / np.where(pivoted, table[at, j, s], 1), 0)[:, None]
            table -= table[at, :, s][:, :, None] * row[:, None]
            self.P -= self.P[at, :, s][:, :, None] * row[:, None]
            own, row_of, slot = at[pivoted], j[pivoted], s[pivoted]
            self.S[own, slot] = telling[own, slot] = row_of
            # a row tells one unknown, and an unknown is told by one row
            weight[own, row_of] = weight[own, :, slot] = 0
        return telling

    def begun(self) -> np.ndarray:
        """Begin with the row that speaks most against the basis; return which problems have none."""
        q = self.P.shape[1]
        c = self.rows.shape[1] - q
        others = self.there[:, :c].copy()
        chosen = self.S < c
        others[np.nonzero(chosen)[0], self.S[chosen]] = False
        T = times(self.rows[:, :c], self.P)
        away = np.abs(self.values[:, :c] - (T @ self._on_S(self.values)[:, :, None])[:, :, 0])
        own = away / (self.radius[:, :c] + (np.abs(T) @ self._on_S(self.radius)[:, :, None])[:, :, 0])
        self.leader = np.where(others, own, -1).argmax(1)
        idle = np.asarray(~others.any(1))
        return idle

    def reference(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return (T, t, sign of the leader's error, x) of the present references."""
        row, value, radius = self._picked(self.leader)
        T = np.einsum("nj,nji->ni", row, self.P)
        on_S, radius_S = self._on_S(self.values), self._on_S(self.radius)
        own = value - (T * on_S).sum(1)
        t = np.abs(own) / (radius + (np.abs(T) * radius_S).sum(1))
        shares = np.abs(T) * radius_S / radius[:, None]
        self.signs = np.where(shares > CLOSE, -np.sign(own)[:, None] * np.sign(T), self.signs)
        x = np.einsum("nij,nj->ni", self.P, on_S - self.signs * t[:, None] * radius_S)
        return T, t, np.sign(own), x

    def step(self) -> np.ndarray:
        """Exchange one row of each problem; return which are done."""
        at = np.arange(len(self.leader))
        T, t, sign_e, x = self.reference()
        error = self.values - (self.rows @ x[:, :, None])[:, :, 0]
        size = np.where(self.there, np.abs(error) / self.radius, -1)
        w = size.argmax(1)
        worst = size[at, w]
        # no row is violated by more than the reference says: it is the optimum
        done = worst <= t + CLOSE * (1 + t)
        sign_w = np.sign(error[at, w])
        T_w = np.einsum("nj,nji->ni", self.rows[at, w], self.P)
        radius_S, radius_e, radius_w = (
            self._on_S(self.radius),
            self.radius[at, self.leader],
            self.radius[at, w],
        )
        shares = np.abs(T) * radius_S / radius_e[:, None]
        change = sign_w[:, None] * T_w * self.signs * radius_S / radius_w[:, None]
        rate = np.where(change > WORTH * np.abs(change).max(1, keepdims=True), change, 0)
        multiplier = shares / np.where(rate > 0, rate, 1)
        moved = np.abs(shares[:, None] - multiplier[:, :, None] * change[:, None])
        after = 1 + multiplier + moved.sum(2)
        slope = worst - t * change.sum(1)
        gained = (t * (1 + shares.sum(1)))[:, None] + multiplier * slope[:, None]
        factor = np.where(rate > 0, gained / after, -1)
        best = factor.max(1)
        near = factor >= (best * (1 - 64 * rounding.unit(np.float64)))[:, None]
        q = np.where(near, np.abs(T_w), -1).argmax(1)
        # else the leader itself leaves: no row of the basis would raise t more
        swap = (best >= slope / (1 + np.abs(change).sum(1))) & ~done
        T_q, T_wq = T[at, q], T_w[at, q]
        by_w = np.abs(T_wq) * radius_e >= np.abs(T_q) * radius_w
        joins = np.where(by_w[:, None], T_w, T)
        joins[at, q] -= 1
        pivot = np.where(by_w, T_wq, T_q)
        row = joins * np.where(swap, 1 / np.where(pivot == 0, 1, pivot), 0)[:, None]
        self.P -= self.P[at, :, q][:, :, None] * row[:, None]
        enters, sign = np.where(by_w, w, self.leader), np.where(by_w, sign_w, sign_e)
        self.S[at[swap], q[swap]], self.signs[at[swap], q[swap]] = enters[swap], sign[swap]
        self.leader = np.where(done | (swap & by_w), self.leader, w)
        return done

    def polished(self) -> None:
        """Bring the inverse as near as floats can: by a Newton step, or anew where exchanges lost it."""
        one = np.eye(self.P.shape[1])
        basis = np.take_along_axis(self.rows, self.S[:, :, None], 1)
        # factoring wakes threads of the library from 100 unknowns on: a step takes products of one
        left = one - times(basis, self.P)
        near = np.abs(left).sum(2).max(1) < NEAR
        self.P[near] += times(self.P[near], left[near])
        lost = np.flatnonzero(~near & np.isfinite(basis).all((1, 2)))
        # an inverse of a singular basis would be noise: the one that was carried stays
        lost = lost[np.linalg.cond(basis[lost], 1) < 1 / rounding.unit(np.float64)]
        self.P[lost] = np.linalg.inv(basis[lost])


def fitted(
    B: np.ndarray, b: np.ndarray, radius: np.ndarray, there: np.ndarray, free: np.ndarray, least: float
) -> Fit:
    """Return the Fit of N problems.

    Args:
        B: (N, c, q). there: (N, c), which rows there are. b, radius: (N, c + q), the values of rows, then of
            unknowns, and how far these may be off. free: (N, q), which unknowns are without bounds. least:
            share of its column that a row has to tell an unknown.
    """
    N, c, q = B.shape
    one = np.broadcast_to(np.eye(q), (N, q, q))
    values = np.concatenate([np.where(there, b[:, :c], 0), b[:, c:]], 1)
    S, signs = np.tile(np.arange(c, c + q), (N, 1)), np.ones((N, q))
    rows = np.concatenate([B, one], 1)
    whole = _Search(
        rows, values, radius, np.concatenate([there, ~free], 1), one.copy(), S, signs, np.zeros(N, np.intp)
    )
    telling = whole.exchange_free(free, least)
    # what no row tells stays where it is
    whole.there[:, c:] |= free & (telling < 0)
    idle = whole.begun()
    if q:  # else there is nothing to exchange
        _exchanged(whole, np.flatnonzero(~idle))
        whole.polished()
    T, t, _, x = whole.reference()
    h = np.zeros((N, c + q))
    np.put_along_axis(h, whole.S, -T, 1)
    np.put_along_axis(h, whole.leader[:, None], 1, 1)
    return Fit(np.where(idle, 0, t), x, h[:, :c], telling, idle)


def _exchanged(whole: _Search, left: np.ndarray) -> None:
    """Search on for the problems that are left, in place."""
    for _ in range(0, PATIENCE * (whole.P.shape[1] + 10), LEAVE):
        if not len(left):
            return
        part = whole.of(left)
        for _ in range(LEAVE):
            done = part.step()
            if done.all():
                break
        for name in ("P", "S", "signs", "leader"):
            getattr(whole, name)[left] = getattr(part, name)
        left = left[~done]
