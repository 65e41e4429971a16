"""Can any parameters and any state give the samples of a window? Branch and bound in the state space; it
knows no line of jaxbound.

With X the states of all samples, a window is bilinear:  (M + sum_i v_i M_i) X = b + sum_i v_i b_i,  |v_i| <=
1. In a box of parameters `enclosed` bounds X by a left inverse of the matrix at its middle, McCormick's
envelopes replace the products v_i X_j, and HiGHS says whether a point is left. A box is dropped only by a
combination of rows whose emptiness is recomputed here, a window is called feasible only with a point that
reproduces its samples: neither rests on the solver's word.

Source: McCormick 1976 (envelopes); Neumaier 1990, 4.1 (preconditioned enclosure).
"""

import highspy
import linear_programs
import numpy as np

CLOSE = 1e-9
"""What counts as reproduced: samples and steps of the state met to this, in the user's units."""
ENVELOPE = np.array(
    [[-1, -1, 1], [1, 1, 1], [1, -1, -1], [-1, 1, -1]], float
)  # of v, x, v x within +-1; each row of four is >= -1
NEWTON = 12


class Oracle:
    """Decides windows of s + 1 samples of one system: matrices {"A": .., ..}, parameters [{"name": .., "A":
    .., "varying": ..}].
    """

    def __init__(self, matrices, parameters, s):
        full = {k: np.array(a, float) for k, a in matrices.items()}
        self.n, self.p, self.m, self.s = len(full["A"]), len(full["C"]), full["B"].shape[1], s
        self.M, self.U = self._stack(full, range(s + 1), 1)
        parts = []
        for q in parameters:
            each = [[k] for k in range(s + 1)] if q.get("varying", True) else [range(s + 1)]
            parts += [
                self._stack({k: np.array(a, float) for k, a in q.items() if k in "ABCD"}, lags, 0)
                for lags in each
            ]
        seen = [(M, U) for M, U in parts if M.any() or U.any()]
        self.Mi, self.Ui = (np.array([part[k] for part in seen]) for k in (0, 1))
        self.i, self.j = np.nonzero(self.Mi.any(1))
        self.rows, self.states, self.count = *self.M.shape, len(seen)
        self.bi_any = (self.Mi != 0).any(2) | (self.Ui != 0).any(2)
        self._build()

    def _stack(self, given, lags, one):
        """Return (M, U), M X = (y, 0) + U u: of each sample of `lags` the rows C x_k and x_(k+1) - A x_k (the
        first times `one`).
        """
        n, p, m, s = self.n, self.p, self.m, self.s
        outputs = p * (s + 1)
        M, U = np.zeros((outputs + n * s, n * (s + 1))), np.zeros((outputs + n * s, m * (s + 1)))
        for k in lags:
            x, u, out = slice(n * k, n * k + n), slice(m * k, m * k + m), slice(p * k, p * k + p)
            M[out, x], U[out, u] = given.get("C", 0), -given.get("D", np.zeros((p, m)))
            if k < s:
                step = slice(outputs + n * k, outputs + n * k + n)
                M[step, x], M[step, n * k + n : n * k + 2 * n] = (
                    -given.get("A", np.zeros((n, n))),
                    one * np.eye(n),
                )
                U[step, u] = given.get("B", 0)
        return M, U

    def _build(self):
        """Pass a program with an entry wherever a box can have one: columns (X, v, v X) within +-1, the rows
        of M, then the envelopes.
        """
        i, j, first = self.i, self.j, self.states + self.count
        any_of = np.hstack([(self.M != 0) | (self.Mi != 0).any(0), self.bi_any.T, (self.Mi[i, :, j] != 0).T])
        envelopes = np.zeros((len(i), 4, any_of.shape[1]))
        for k in range(len(i)):
            envelopes[k][:, [self.states + i[k], j[k], first + k]] = ENVELOPE
        self.envelopes, self.places = envelopes.reshape(-1, any_of.shape[1]), np.argwhere(any_of)
        whole = np.vstack([any_of, self.envelopes])
        lp = highspy.HighsLp()
        lp.num_row_, lp.num_col_ = whole.shape
        lp.col_cost_, lp.col_lower_, lp.col_upper_ = (
            np.zeros(lp.num_col_),
            -np.ones(lp.num_col_),
            np.ones(lp.num_col_),
        )
        lp.row_lower_, lp.row_upper_ = (
            -np.ones(lp.num_row_),
            np.r_[np.ones(self.rows), np.full(len(self.envelopes), np.inf)],
        )
        columns, rows = np.nonzero(whole.T)
        lp.a_matrix_.start_, lp.a_matrix_.index_ = np.searchsorted(columns, np.arange(lp.num_col_ + 1)), rows
        lp.a_matrix_.value_ = whole[rows, columns]
        self.solver = linear_programs.solver(
            presolve="off", primal_feasibility_tolerance=1e-10, small_matrix_value=1e-12
        )
        assert self.solver.passModel(lp) == highspy.HighsStatus.kOk

    def decide(self, u, y, most=4000):
        """Return ("feasible", "infeasible" or "open", boxes used) for u (s + 1, m) and y (s + 1, p)."""
        u, y = np.ravel(u), np.ravel(y)
        b, bi = np.r_[y, np.zeros(self.n * self.s)] + self.U @ u, self.Ui @ u
        one, free = np.ones(self.count), np.full(self.states, np.inf)
        stack, used, tries = [(-one, one, -free, free)], 0, 0
        while stack and used < most:
            used += 1
            lo, hi, *X = stack.pop()
            X = self.enclosed(b, bi, lo, hi, *X)
            if (X[0] > X[1]).any():
                continue
            empty, v, gap = self.relaxed(b, bi, lo, hi, *X)
            if empty:
                continue
            if v is not None and used >= 2**tries:
                tries += 1
                if self.reproduced(b, bi, v):
                    return "feasible", used
            axis = np.argmax(gap)
            middle, below, above = 0.5 * (lo[axis] + hi[axis]), hi.copy(), lo.copy()
            below[axis] = above[axis] = middle
            halves = [(lo, below, *X), (above, hi, *X)]
            stack += halves if v is None or v[axis] > middle else halves[::-1]
        return "open" if stack else "infeasible", used

    def enclosed(self, b, bi, lo, hi, low, high):
        """Return bounds of the states under parameters in a box, at most (low, high): |X - P right| <= |P|
        (spread |X| + |bi| radius).
        """
        mid, radius = 0.5 * (lo + hi), 0.5 * (hi - lo)
        M = self.M + np.tensordot(mid, self.Mi, 1)
        P, spread = np.linalg.pinv(M), np.tensordot(radius, abs(self.Mi), 1)
        X, growth = P @ (b + mid @ bi), abs(P) @ spread
        if abs(P @ M - np.eye(self.states)).max() > 1e-9 or max(abs(np.linalg.eigvals(growth))) >= 1:
            return low, high  # not a left inverse, or the box is too wide: halves of it may do
        around = np.linalg.solve(
            np.eye(self.states) - growth, abs(P) @ (spread @ abs(X) + radius @ abs(bi) + CLOSE)
        )
        return np.maximum(low, X - around), np.minimum(high, X + around)

    def relaxed(self, b, bi, lo, hi, low, high):
        """Return (whether no point of a box is left, parameters of the relaxation or None, size of its error
        by parameter).
        """
        mid, radius, i, j = 0.5 * (lo + hi), 0.5 * (hi - lo), self.i, self.j
        if not np.isfinite(high - low).all():
            return False, None, radius * abs(self.Mi).sum((1, 2))
        X, wide, M = 0.5 * (low + high), 0.5 * (high - low), self.M + np.tensordot(mid, self.Mi, 1)
        both = self.Mi[i, :, j] * (radius[i] * wide[j])[:, None]
        now = np.hstack(
            [M * wide, (radius[:, None] * (self.Mi @ X - bi)).T, both.T]
        )  # columns (X, v, v X), each scaled to +-1
        for r, c in self.places:
            self.solver.changeCoeff(r, c, now[r, c])
        rest = b + mid @ bi - M @ X
        self.solver.changeRowsBounds(
            self.rows, np.arange(self.rows, dtype=np.int32), rest - CLOSE, rest + CLOSE
        )
        self.solver.run()
        status = self.solver.getModelStatus()
        if status == highspy.HighsModelStatus.kInfeasible and self._refutes(now, rest):
            return True, None, None
        if status != highspy.HighsModelStatus.kOptimal:
            self.solver.clearSolver()
            return False, None, radius
        x, v, product = np.split(
            np.array(self.solver.getSolution().col_value), [self.states, self.states + self.count]
        )
        return (
            False,
            mid + radius * v,
            np.bincount(i, abs(product - v[i] * x[j]) * abs(both).sum(1), self.count) + CLOSE * radius,
        )

    def _refutes(self, now, rest):
        """Return whether the solver's combination of rows has no value within +-1: it must be a proof here,
        whatever the solver meant.
        """
        ray = np.array(self.solver.getDualRay()[2])
        for h in (ray, -ray):
            rows, envelopes = h[: self.rows], np.maximum(h[self.rows :], 0)
            least = rows @ rest - CLOSE * abs(rows).sum() - envelopes.sum()
            if least > abs(rows @ now + envelopes @ self.envelopes).sum() + 1e-13 * abs(h).sum():
                return True
        return False

    def reproduced(self, b, bi, v):
        """Return whether Newton steps from v, held in the box, reach parameters and states that give the
        samples.
        """
        X = np.linalg.lstsq(self.M + np.tensordot(v, self.Mi, 1), b + v @ bi)[0]
        z, limit = np.r_[X, np.clip(v, -1, 1)], np.r_[np.full(self.states, np.inf), np.ones(self.count)]
        scale = np.r_[
            np.full(self.states, 10 + 10 * abs(X).max()), np.ones(self.count)
        ]  # parameters move least
        for _ in range(NEWTON):
            X, v = np.split(z, [self.states])
            M = self.M + np.tensordot(v, self.Mi, 1)
            rest = M @ X - b - v @ bi
            if abs(rest).max() <= CLOSE:
                return True
            slope = np.hstack([M, (self.Mi @ X - bi).T]) * scale
            step, free = np.zeros_like(z), np.ones(len(z), bool)
            while free[
                self.states :
            ].any():  # what would leave the box is held at its side, and the others make up for it
                step[free] = np.linalg.lstsq(slope[:, free], -rest - slope[:, ~free] @ step[~free])[0]
                out = free & (abs(z + scale * step) > limit)
                if not out.any():
                    break
                step[out], free[out] = np.sign(z + step)[out] - z[out], False
            z = np.clip(z + scale * step, -limit, limit)
        return False
