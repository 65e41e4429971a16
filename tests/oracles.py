"""Oracles: plants and windows worked out without any line of jaxbound. Exact numbers by Fraction and
python-flint, programs by HiGHS.

A window of s + 1 samples is consistent iff some state x and some disturbances w within their bounds give
t_lo <= O x + V w + H U <= t_hi, [t_lo, t_hi] the true values t with y = (1 + theta) t + delta, |theta| <=
sigma, |delta| <= noise + resolution + 4 u (max |y| in the window + noise).
"""

from fractions import Fraction
from functools import cached_property
from itertools import combinations
from math import lcm

import flint
import highspy
import linear_programs
import numpy as np

MODELS = {
    "paper": dict(
        A=[[0.8, 1], [0, 0.2]], B=[[0], [1]], C=[[1, 0], [1, 1]], tolerance=[0.02, 0.1], noise=[0.1, 0.01]
    ),
    "noise only": dict(A=[[0.8, 1], [0, 0.2]], B=[[0], [1]], C=[[1, 0], [1, 1]], noise=[0.1, 0.01]),
    "three states": dict(
        A=[[0.9, 0.3, 0], [-0.2, 0.7, 0.1], [0, 0.4, 0.5]],
        B=[[0.1], [1], [0]],
        C=[[1, 0, 0.5], [0, 0, 1]],
        tolerance=[0.01, 0.05],
        noise=[0.2, 0.05],
        resolution=[0.001, "1/300"],
    ),
    "feedthrough": dict(
        A=[[0.5, 1], [-0.3, 0.9]],
        B=[[1], [0.5]],
        C=[[1, 0], [0, 1]],
        D=[[0.7], [0]],
        tolerance=[0.03, 0],
        noise=[0.05, 0.1],
    ),
    "offsets": dict(
        A=[[1.02, 0.1], [0, 0.7]],
        B=[[0.2, 0], [1, -0.4]],
        C=[[1, 0], [1, 1], [0.3, -2]],
        D=[[0, 0], [0, 0.1], [0, 0]],
        tolerance=[0.02, 0, 0.1],
        noise=[0.1, 0.02, 0.3],
        offset={"u": [1.5, -0.2], "y": [12.5, -3.1, "1/3"]},
    ),
    "no input": dict(
        A=[[0.9, 0.2], [-0.1, 0.8]], B=None, C=[[1, 0], [1, 1]], tolerance=[0.02, 0.1], noise=[0.1, 0.01]
    ),
}


def fraction(x):
    """Return the exact meaning of a number in a model: a float is its shortest decimal."""
    return Fraction(repr(x)) if isinstance(x, float) else Fraction(x)


def fractions(a):
    return [[fraction(x) for x in row] for row in a]


def times(a, b):
    return [
        [
            sum((x * y for x, y in zip(row, column, strict=True)), Fraction(0))
            for column in zip(*b, strict=True)
        ]
        for row in a
    ]


def rational_matrix(a):
    """Return a list of rows of Fractions as a flint matrix."""
    return flint.fmpq_mat(
        len(a), len(a[0]), [flint.fmpq(x.numerator, x.denominator) for row in a for x in row]
    )


class Plant:
    """A model as exact numbers, and its windows of s + 1 samples: O, H over (time, output) rows and (time,
    input) columns.
    """

    def __init__(
        self,
        A,
        B,
        C,
        D=None,
        tolerance=0,
        noise=0,
        resolution=0,
        offset=None,
        disturbance=None,
        unknown_inputs=None,
    ):
        self.A, self.C = fractions(A), fractions(C)
        self.n, self.p = len(self.A), len(self.C)
        self.B = fractions(B) if B is not None else [[] for _ in self.A]
        self.m = len(self.B[0])
        self.D = fractions(D) if D is not None else [[Fraction(0)] * self.m for _ in self.C]
        spread = lambda v, count: [fraction(x) for x in (v if isinstance(v, (list, tuple)) else [v] * count)]
        self.tolerance, self.noise, self.resolution = (
            spread(v, self.p) for v in (tolerance, noise, resolution)
        )
        offset = offset or {}
        self.offset_u, self.offset_y = spread(offset.get("u", 0), self.m), spread(offset.get("y", 0), self.p)
        self.feedthrough = any(x for row in self.D for x in row)
        G, bound = disturbance or ([[] for _ in self.A], [])
        self.G, self.g = fractions(G), len(G[0])
        F, D_v = unknown_inputs or ([[] for _ in self.A], None)
        self.F, self.d = fractions(F), len(F[0])
        self.D_v = fractions(D_v) if D_v is not None else [[Fraction(0)] * self.d for _ in self.C]
        pairs = bound if isinstance(bound, (list, tuple)) else [bound] * self.g
        self.disturbance = [
            tuple(map(fraction, b)) if isinstance(b, (list, tuple)) else (-fraction(b), fraction(b))
            for b in pairs
        ]

    def lags(self, s):
        return s + 1 if self.feedthrough else s

    def unknown_lags(self, s):
        return s + 1 if any(x for row in self.D_v for x in row) else s

    def window(self, s):
        """Return (O, H) of Y = O x + H U, column by column: the response to each unit state and each unit
        input.
        """
        unit = lambda i, count: [Fraction(int(i == j)) for j in range(count)]
        zero = [[Fraction(0)] * self.m] * (s + 1)
        columns = [self.trajectory(unit(i, self.n), zero) for i in range(self.n)]
        for k in range(self.lags(s)):
            for c in range(self.m):
                columns.append(
                    self.trajectory(
                        [Fraction(0)] * self.n, [unit(c, self.m) if j == k else zero[0] for j in range(s + 1)]
                    )
                )
        flat = [[x for row in column for x in row] for column in columns]
        rows = [list(row) for row in zip(*flat, strict=True)]
        return [row[: self.n] for row in rows], [row[self.n :] for row in rows]

    def equation(self, s):
        """Return (E, K) with (Y, w) = E (x, w, v) + K U: disturbances w are unknowns, and rows of their own;
        v has no bound.
        """
        O, H = self.window(s)
        still, count, free = [[Fraction(0)] * self.m] * (s + 1), self.g * s, self.d * self.unknown_lags(s)
        unit = lambda i, count: [Fraction(int(i == j)) for j in range(count)]
        blow = lambda i, count, width: [unit(i, count)[j : j + width] for j in range(0, count, width)]
        respond = lambda **driven: [
            x for row in self.trajectory([Fraction(0)] * self.n, still, **driven) for x in row
        ]
        through = [respond(w=blow(i, count, self.g)) for i in range(count)] + [
            respond(v=blow(i, free, self.d)) for i in range(free)
        ]
        V = [list(row) for row in zip(*through, strict=True)] if through else [[] for _ in O]
        E = [o + v for o, v in zip(O, V, strict=True)] + [
            [Fraction(0)] * self.n + unit(i, count) + [Fraction(0)] * free for i in range(count)
        ]
        return E, H + [[Fraction(0)] * len(H[0]) for _ in range(count)]

    def trajectory(self, x, u, w=(), v=()):
        """Return the exact outputs (deviations) from a first state under inputs (deviations), disturbances
        and unknown inputs.
        """
        out, column = [], lambda v: [[e] for e in v]
        for k, now in enumerate(u):
            feed = times(self.D, column(now)) if self.m else [[Fraction(0)]] * self.p
            out.append([a[0] + b[0] for a, b in zip(times(self.C, column(x)), feed, strict=True)])
            drive = times(self.B, column(now)) if self.m else [[Fraction(0)]] * self.n
            x = [a[0] + b[0] for a, b in zip(times(self.A, column(x)), drive, strict=True)]
            if k < len(w):
                x = [a + b[0] for a, b in zip(x, times(self.G, column(w[k])), strict=True)]
            if k < len(v):
                out[-1] = [a + b[0] for a, b in zip(out[-1], times(self.D_v, column(v[k])), strict=True)]
                x = [a + b[0] for a, b in zip(x, times(self.F, column(v[k])), strict=True)]
        return out

    def circuits(self, s, rows=None):
        """Return every h of minimal support with h E = 0, from the null vectors of subsets of rows. Integers,
        as Fractions.
        """
        O, _ = self.equation(s)
        scale = lcm(*(x.denominator for row in O for x in row))
        whole = [[int(x * scale) for x in row] for row in O]
        found = []
        present = range(len(O)) if rows is None else rows
        for size in range(1, len(O[0]) + 2):
            for subset in combinations(present, size):
                null, nullity = flint.fmpz_mat(
                    [[whole[i][j] for i in subset] for j in range(len(O[0]))]
                ).nullspace()
                h = [int(null[i, 0]) for i in range(size)]
                if nullity == 1 and all(h):
                    row = [Fraction(0)] * len(O)
                    for i, x in zip(subset, h, strict=True):
                        row[i] = Fraction(x)
                    found.append(row)
        return found

    def true_values(self, y, dtype=np.float64):
        """Return exact [t_lo, t_hi] (deviations) of the true values behind one window y (s + 1, p) of floats;
        None where NaN.
        """
        u = Fraction(float(np.finfo(dtype).eps)) / 2
        exact = [[None if np.isnan(v) else Fraction(float(v)) for v in row] for row in y]
        out = []
        for row in exact:
            for i, v in enumerate(row):
                if v is None:
                    out.append(None)
                    continue
                largest = max(abs(r[i]) for r in exact if r[i] is not None)
                rho = self.noise[i] + self.resolution[i] + 4 * u * (largest + self.noise[i])
                ends = [
                    (v - self.offset_y[i] - a * rho) / (1 + b * self.tolerance[i])
                    for a in (-1, 1)
                    for b in (-1, 1)
                ]
                out.append((min(ends), max(ends)))
        return out

    def gauge(self, s, u, y, dtype=np.float64, circuits=None):
        """Return the exact gauge of one window u (s + 1, m), y (s + 1, p): the largest residual over healthy
        size of all circuits.
        """
        ends, reach = self.ends(s, u, y, dtype)
        best = Fraction(0)
        for h in self.circuits(s) if circuits is None else circuits:
            used = [(x, *ends[i], reach[i]) for i, x in enumerate(h) if x]
            size = sum(abs(x) * (hi - lo) / 2 for x, lo, hi, _ in used)
            best = max(best, abs(sum(x * ((lo + hi) / 2 - c) for x, lo, hi, c in used)) / size)
        return best

    def ends(self, s, u, y, dtype=np.float64):
        """Return what is exactly known of each row of the equation of one window: its [lo, hi] (None where
        NaN) and its share of K U.
        """
        _, K = self.equation(s)
        U = [Fraction(float(v)) - self.offset_u[i] for row in u[: self.lags(s)] for i, v in enumerate(row)]
        reach = [sum((a * b for a, b in zip(row, U, strict=True)), Fraction(0)) for row in K]
        return self.true_values(y, dtype) + self.disturbance * s, reach


def floats(a):
    return np.array([[float(x) for x in row] for row in a])


class Windows:
    """Many windows of one plant in plain floats: true values, gauge over all circuits, and the program of
    each window.
    """

    def __init__(self, plant, s, dtype=np.float64):
        self.plant, self.s, self.dtype = plant, s, dtype
        self.O, self.H = (floats(a) for a in plant.equation(s))
        per = lambda v: np.array([float(x) for x in v])
        self.tolerance, self.noise, self.resolution = (
            per(plant.tolerance),
            per(plant.noise),
            per(plant.resolution),
        )
        self.offset_u, self.offset_y = per(plant.offset_u), per(plant.offset_y)
        self.w_lo, self.w_hi = (
            np.tile(per(v), s) for v in (zip(*plant.disturbance, strict=True) if plant.g else ((), ()))
        )

    @cached_property
    def exact_circuits(self):
        return self.plant.circuits(self.s)

    @cached_property
    def circuits(self):
        return floats([[x / max(map(abs, h)) for x in h] for h in self.exact_circuits])

    def reach(self, u):
        """Return K U (N, rows) for inputs (N, s + 1, m)."""
        known = (np.asarray(u, np.float64) - self.offset_u)[:, : self.plant.lags(self.s)]
        return (
            known.reshape(len(known), -1) @ self.H.T
            if self.H.shape[1]
            else np.zeros((len(known), len(self.O)))
        )

    def limits(self, u, y):
        """Return (lo, hi), each (N, rows): bounds of O (x, w). NaN samples give -inf, inf."""
        y = np.asarray(y, np.float64)
        largest = np.nanmax(np.where(np.isnan(y), 0, np.abs(y)), 1, keepdims=True)
        rho = self.noise + self.resolution + 2 * float(np.finfo(self.dtype).eps) * (largest + self.noise)
        d = y - self.offset_y
        ends = [(d + a * rho) / (1 + b * self.tolerance) for a in (-1, 1) for b in (-1, 1)]
        lo, hi = np.minimum.reduce(ends), np.maximum.reduce(ends)
        lo, hi = np.where(np.isnan(y), -np.inf, lo), np.where(np.isnan(y), np.inf, hi)
        reach, still = self.reach(u), np.ones((len(y), 1))
        whole = lambda side, w: np.hstack([side.reshape(len(y), -1), w * still]) - reach
        return whole(lo, self.w_lo), whole(hi, self.w_hi)

    def gauge(self, u, y):
        """Return the gauge (N,) of complete windows by all circuits, in plain floats."""
        lo, hi = self.limits(u, y)
        return (abs((lo + hi) / 2 @ self.circuits.T) / ((hi - lo) / 2 @ abs(self.circuits).T)).max(1)

    def crossing(self, u, centre, y, steps=60):
        """Return factors (N,) f such that the window centre + f (y - centre) lies on the boundary; inf where
        y - centre never leaves.
        """
        at = lambda f: self.gauge(u, centre + f[:, None, None] * (y - centre))
        low, high = np.zeros(len(y)), np.ones(len(y))
        for _ in range(60):
            inside = at(high) <= 1
            if not inside.any():
                break
            high = np.where(inside, 2 * high, high)
        never = at(high) <= 1
        for _ in range(steps):
            middle = (low + high) / 2
            inside = at(middle) <= 1
            low, high = np.where(inside, middle, low), np.where(inside, high, middle)
        return np.where(never, np.inf, low)

    def slack(self, u, y, free=()):
        """Return min e with lo - e c <= O (x, w) <= hi + e c for some x, w (N,), c the noise of each row: e
        <= 0 iff consistent. HiGHS.

        Columns `free` of H stand for missing inputs: unknown like the state.
        """
        weight = np.r_[np.tile(self.noise + self.resolution, self.s + 1), (self.w_hi - self.w_lo) / 2]
        weight = np.maximum(weight, 1e-3)
        unknown = np.hstack([self.O, self.H[:, list(free)]])
        rows, n = unknown.shape
        up = np.hstack([unknown / weight[:, None], np.ones((rows, 1))])
        down = up * np.r_[np.ones(n), -1]
        lo, hi = (x / weight for x in self.limits(u, y))
        program = Program(np.vstack([up, down]), np.r_[np.zeros(n), 1.0])
        open_ = np.full_like(lo, np.inf)
        return program.solve(np.hstack([lo, -open_]), np.hstack([open_, hi]))

    def gauge_by_program(self, u, y):
        """Return min over x of max |b - O x| / r (N,), a linear program of its own for each window. HiGHS."""
        lo, hi = self.limits(u, y)
        out = []
        for a, b in zip(lo, hi, strict=True):
            rows = np.isfinite(a)
            middle, half = (a[rows] + b[rows]) / 2, (b[rows] - a[rows]) / 2
            scaled = self.O[rows] / half[:, None]
            one = np.ones((rows.sum(), 1))
            program = Program(
                np.vstack([np.hstack([scaled, one]), np.hstack([scaled, -one])]),
                np.r_[np.zeros(self.O.shape[1]), 1.0],
            )
            target, free = middle / half, np.full(rows.sum(), np.inf)
            out.append(program.solve(np.r_[target, -free][None], np.r_[free, target][None])[0])
        return np.array(out)


class Program:
    """minimise cost z subject to lower <= M z <= upper: one HiGHS model whose row bounds change from case to
    case.
    """

    def __init__(self, M, cost):
        rows, columns = M.shape
        lp = highspy.HighsLp()
        lp.num_col_, lp.num_row_ = columns, rows
        lp.col_cost_ = cost
        lp.col_lower_, lp.col_upper_ = np.full(columns, -np.inf), np.full(columns, np.inf)
        lp.row_lower_, lp.row_upper_ = np.full(rows, -np.inf), np.full(rows, np.inf)
        lp.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
        lp.a_matrix_.start_ = np.arange(0, rows * columns + 1, columns)
        lp.a_matrix_.index_ = np.tile(np.arange(columns), rows)
        lp.a_matrix_.value_ = M.ravel()
        self.rows = np.arange(rows, dtype=np.int32)
        self.solver = linear_programs.solver(
            presolve="off",
            solver="simplex",
            simplex_scale_strategy=0,
            primal_feasibility_tolerance=1e-10,
            dual_feasibility_tolerance=1e-10,
        )
        self.solver.passModel(lp)

    def solve(self, lower, upper):
        """Return the optimal values (N,) for row bounds (N, rows)."""
        out = np.empty(len(lower))
        for i, (a, b) in enumerate(zip(lower, upper, strict=True)):
            self.solver.changeRowsBounds(len(self.rows), self.rows, a, b)
            assert linear_programs.is_feasible(self.solver)
            out[i] = self.solver.getObjectiveValue()
        return out


def draw(plant, s, count, rng, spread=3.0, level=None):
    """Return (u (N, s + 1, m), centre, y (N, s + 1, p)): exact behaviours around the operating point with
    disturbances in the middle of their bounds, and the same with errors of a few noises and disturbances of a
    few bounds.

    The size of the state of a window is 10 ** uniform(-2, 2), unless a level is given.
    """
    (E, K), rows = (floats(a) for a in plant.equation(s)), (s + 1) * plant.p
    size = 10 ** rng.uniform(-2, 2, (count, 1)) if level is None else level
    u = rng.uniform(-1, 1, (count, s + 1, plant.m))
    known = u[:, : plant.lags(s)].reshape(count, -1)
    ends = np.array([[float(x) for x in pair] for pair in plant.disturbance] * s).reshape(-1, 2)
    free = E.shape[1] - plant.n - len(ends)
    unknown = np.hstack(
        [
            rng.normal(size=(count, plant.n)) * size,
            np.tile(ends.mean(1), (count, 1)),
            rng.normal(size=(count, free)) * size,
        ]
    )
    true = unknown @ E[:rows].T + (known @ K[:rows].T if K.shape[1] else 0)
    centre = true.reshape(count, s + 1, plant.p)
    noise, tolerance = (np.array([float(x) for x in v]) for v in (plant.noise, plant.tolerance))
    share = spread * rng.uniform(0, 1, (count, 1, 1))
    error = rng.uniform(-1, 1, centre.shape) * share * (noise + tolerance * abs(centre))
    blown = (
        rng.uniform(-1, 1, (count, len(ends)))
        * share[:, 0]
        * (ends[:, 1] - ends[:, 0])
        / 2
        @ E[:rows, plant.n : plant.n + len(ends)].T
    )
    offset_u, offset_y = (np.array([float(x) for x in v]) for v in (plant.offset_u, plant.offset_y))
    return u + offset_u, centre + offset_y, centre + error + blown.reshape(centre.shape) + offset_y


def as_recording(windows):
    """Lay windows (N, s + 1, c) end to end; window i ends at sample (i + 1) (s + 1) - 1."""
    return windows.reshape(-1, windows.shape[-1])
