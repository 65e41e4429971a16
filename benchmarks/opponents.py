"""The opponents: the same strip test and the same paving written well in NumPy, and a linear program a
window.
"""

import numpy as np

SUPPORTS = ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))
CIRCUITS = np.array(
    [[1, -5, 5, 0], [2, -6, 0, 5], [4, 0, -30, 25], [0, 4, -10, 5]], float
)  # section 5, golden p0.static
KNOWN = np.array([0, 5, 25, 5], float)
TOLERANCE, NOISE = np.array([0.02, 0.1]), np.array([0.1, 0.01])
RECORDER = 4


def naive(u, y):
    """Margins of section 5 as one would first write them: whole arrays, no blocks, a matrix product for all
    circuits.
    """
    half = np.finfo(y.dtype).eps / 2
    Y = np.concatenate([y[:-1], y[1:]], 1)
    rho = NOISE + RECORDER * half * (np.maximum(abs(y[:-1]), abs(y[1:])) + NOISE)
    rho, sigma = np.tile(rho, 2), np.tile(TOLERANCE, 2)
    hi = np.where(Y + rho >= 0, (Y + rho) / (1 - sigma), (Y + rho) / (1 + sigma))
    lo = np.where(Y - rho >= 0, (Y - rho) / (1 + sigma), (Y - rho) / (1 - sigma))
    residual = (hi + lo) / 2 @ CIRCUITS.T - u[:-1] * KNOWN
    gauge = abs(residual) / ((hi - lo) / 2 @ abs(CIRCUITS).T)
    return np.concatenate([[np.nan], 1 - gauge.max(1)]).astype(y.dtype)


class Blocked:
    """The same in blocks that stay in cache, every operation in place, each sample's interval worked out
    once; statuses on request.
    """

    def __init__(self, dtype, block=8192):
        self.dtype, self.block = np.dtype(dtype), block
        self.buffers = [np.empty(block + 1, dtype) for _ in range(20)]
        e = 1 / (1 - TOLERANCE**2)
        self.h = CIRCUITS * np.tile(e, 2)  # the factor e of every row, once
        self.u_round = float(np.finfo(dtype).eps) / 2

    def run(self, u, y, proof=False):
        """Return margins (T,), or statuses (T,) int8 with the same slack as jaxbound's."""
        out = np.empty(len(y), np.int8 if proof else self.dtype)
        out[0] = 0 if proof else np.nan
        for start in range(0, len(y) - 1, self.block):
            count = min(self.block, len(y) - 1 - start)
            self._one(
                u[start : start + count, 0],
                y[start : start + count + 1],
                out[start + 1 : start + 1 + count],
                proof,
            )
        return out

    def _one(self, u, y, out, proof):
        n = len(u)
        t, numerator, denominator, rho, gauge, error = (b[:n] for b in self.buffers[:6])
        mids, rads, sizes = [None] * 4, [None] * 4, [None] * 4
        for i in range(2):
            v, size = self.buffers[6 + 7 * i][: n + 1], self.buffers[7 + 7 * i][: n + 1]
            np.copyto(v, y[:, i])
            np.abs(v, out=size)
            np.maximum(size[:-1], size[1:], out=rho)
            rho *= RECORDER * self.u_round
            rho += NOISE[i] * (1 + RECORDER * self.u_round)
            for j in range(2):
                mid, rad = self.buffers[8 + 7 * i + 2 * j][:n], self.buffers[9 + 7 * i + 2 * j][:n]
                np.minimum(v[j : j + n], rho, out=mid)
                np.negative(rho, out=t)
                np.maximum(mid, t, out=mid)
                mid *= TOLERANCE[i]
                mid += v[j : j + n]
                np.maximum(size[j : j + n], rho, out=rad)
                rad *= TOLERANCE[i]
                rad += rho
                mids[2 * j + i], rads[2 * j + i], sizes[2 * j + i] = mid, rad, size[j : j + n]
        first = True
        if proof:
            out[:] = 1
        for c, support in enumerate(SUPPORTS):
            np.multiply(mids[support[0]], self.h[c, support[0]], out=numerator)
            np.multiply(rads[support[0]], abs(self.h[c, support[0]]), out=denominator)
            for r in support[1:]:
                np.multiply(mids[r], self.h[c, r], out=t)
                numerator += t
                np.multiply(rads[r], abs(self.h[c, r]), out=t)
                denominator += t
            if KNOWN[c]:
                np.multiply(u, KNOWN[c], out=t)
                numerator -= t
            np.abs(numerator, out=numerator)
            if proof:
                np.multiply(denominator, 40 * self.u_round, out=error)
                for r in support:
                    np.multiply(sizes[r], 40 * 1.1 * self.u_round * abs(self.h[c, r]), out=t)
                    error += t
                if KNOWN[c]:
                    np.abs(u, out=t)
                    t *= 40 * self.u_round * KNOWN[c]
                    error += t
                numerator -= denominator
                np.maximum(
                    out,
                    np.where(numerator > error, 3, np.where(numerator <= -error, 1, 2)),
                    out=out,
                    casting="unsafe",
                )
            else:
                numerator /= denominator
                np.copyto(gauge, numerator) if first else np.maximum(gauge, numerator, out=gauge)
                first = False
        if not proof:
            np.subtract(1, gauge, out=out)


class LinearProgram:
    """Section 5 by HiGHS with one reused model: is there x with t_lo <= C x + H u <= t_hi?"""

    def __init__(self):
        import highspy

        self.solver = highspy.Highs()
        self.solver.setOptionValue("output_flag", False)
        model = highspy.HighsLp()
        model.num_col_, model.num_row_ = 2, 4
        model.col_cost_ = np.zeros(2)
        model.col_lower_, model.col_upper_ = np.full(2, -np.inf), np.full(2, np.inf)
        model.row_lower_, model.row_upper_ = np.zeros(4), np.zeros(4)
        model.a_matrix_.start_ = np.array([0, 4, 7])
        model.a_matrix_.index_ = np.array([0, 1, 2, 3, 1, 2, 3])
        model.a_matrix_.value_ = np.array([1, 1, 0.8, 0.8, 1, 1, 1.2])
        self.solver.passModel(model)
        self.infeasible = highspy.HighsModelStatus.kInfeasible

    def run(self, u, y):
        """Return True where a window is infeasible, (T - 1,)."""
        Y = np.concatenate([y[:-1], y[1:]], 1)
        sigma, rho = np.tile(TOLERANCE, 2), np.tile(NOISE, 2)
        hi = np.where(Y + rho >= 0, (Y + rho) / (1 - sigma), (Y + rho) / (1 + sigma))
        lo = np.where(Y - rho >= 0, (Y - rho) / (1 + sigma), (Y - rho) / (1 - sigma))
        hi[:, 3] -= u[:-1, 0]
        lo[:, 3] -= u[:-1, 0]
        rows = np.arange(4, dtype=np.int32)
        out = np.empty(len(Y), bool)
        for k in range(len(Y)):  # a linear program has no batch
            self.solver.changeRowsBounds(4, rows, lo[k], hi[k])
            self.solver.run()
            out[k] = self.solver.getModelStatus() == self.infeasible
        return out


class Feasibility:
    """HiGHS with one reused model: is there x with lower <= M x <= upper?"""

    def __init__(self, M):
        import highspy

        rows, columns = M.shape
        self.solver, self.status = highspy.Highs(), highspy.HighsModelStatus
        for option, value in dict(output_flag=False, presolve="off", solver="simplex", threads=1).items():
            self.solver.setOptionValue(option, value)
        model = highspy.HighsLp()
        model.num_col_, model.num_row_ = columns, rows
        model.col_cost_ = np.zeros(columns)
        model.col_lower_, model.col_upper_ = np.full(columns, -np.inf), np.full(columns, np.inf)
        model.row_lower_, model.row_upper_ = np.zeros(rows), np.zeros(rows)
        where = [np.flatnonzero(M[:, j]) for j in range(columns)]
        model.a_matrix_.start_ = np.r_[0, np.cumsum([len(i) for i in where])]
        model.a_matrix_.index_ = np.concatenate(where)
        model.a_matrix_.value_ = np.concatenate([M[i, j] for j, i in enumerate(where)])
        self.solver.passModel(model)
        self.rows = np.arange(rows, dtype=np.int32)

    def run(self, lower, upper):
        """Return True where a case is infeasible, (N,)."""
        out = np.empty(len(lower), bool)
        for k in range(len(lower)):
            self.solver.changeRowsBounds(len(self.rows), self.rows, lower[k], upper[k])
            self.solver.run()
            if self.solver.getModelStatus() not in (self.status.kInfeasible, self.status.kOptimal):
                self.solver.clearSolver()  # a basis of another case can lead it astray
                self.solver.run()
            out[k] = self.solver.getModelStatus() == self.status.kInfeasible
        return out


class Batched:
    """moreau with a compiled batch: by how much must bounds be moved apart so that lower <= M x <= upper?"""

    SIZE = 200
    LEAST = 1e-7

    def __init__(self, M):
        import moreau
        from scipy.sparse import csr_matrix

        rows, self.columns = M.shape
        A = csr_matrix(np.block([[M, -np.ones((rows, 1))], [-M, -np.ones((rows, 1))]]))
        self.solver = moreau.CompiledSolver(
            n=self.columns + 1,
            m=2 * rows,
            P_row_offsets=np.zeros(self.columns + 2, int),
            P_col_indices=[],
            A_row_offsets=A.indptr,
            A_col_indices=A.indices,
            cones=moreau.Cones(num_nonneg_cones=2 * rows),
            settings=moreau.Settings(
                batch_size=self.SIZE, device="cpu", solver="active_set", auto_tune=False
            ),
        )
        self.solver.setup([], A.data)

    def run(self, lower, upper):
        """Return True where a case is infeasible, (N,)."""
        cost = np.tile(np.r_[np.zeros(self.columns), 1.0], (self.SIZE, 1))
        out = np.empty(len(lower), bool)
        for first in range(0, len(lower), self.SIZE):
            chosen = np.arange(first, first + self.SIZE).clip(max=len(lower) - 1)
            moved = self.solver.solve(cost, np.hstack([upper[chosen], -lower[chosen]])).x[:, -1]
            stop = min(first + self.SIZE, len(lower))
            out[first:stop] = moved[: stop - first] > self.LEAST
        return out
