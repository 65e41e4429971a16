"""References for tuned bounds, by HiGHS: the smallest scale on a ray, and the smallest weighted sum of bounds
together with all states.
"""

import numpy as np
from scipy.optimize import brentq, linprog
from scipy.sparse import coo_array

from tests.oracles import Windows, floats


def recording(plant, T, rng, share=1.0, level=1.0, mean=0.0):
    """Return (u (T, m), y (T, p)) of one recording with errors and disturbances uniform within `share` of the
    plant's bounds.
    """
    A, B, C, D, G = (floats(a).reshape(len(a), -1) for a in (plant.A, plant.B, plant.C, plant.D, plant.G))
    tolerance, noise = (np.array([float(x) for x in v]) for v in (plant.tolerance, plant.noise))
    ends = np.array([[float(x) for x in pair] for pair in plant.disturbance]).reshape(-1, 2)
    u, y, x = (
        mean + rng.uniform(-1, 1, (T, plant.m)),
        np.zeros((T, plant.p)),
        level * rng.normal(size=plant.n),
    )
    for k in range(T):
        error = share * rng.uniform(-1, 1, (2, plant.p))
        y[k] = (1 + error[0] * tolerance) * (C @ x + D @ u[k]) + error[1] * noise
        x = A @ x + B @ u[k] + G @ (share * (ends[:, 0] + rng.random(len(ends)) * (ends[:, 1] - ends[:, 0])))
    return u, y


def windows_of(s, u, y):
    """Return (N, s + 1, .) windows of a recording."""
    at = np.arange(len(y) - s)[:, None] + np.arange(s + 1)
    return u[at], y[at]


def smallest_scale(plant, s, u, y, moved):
    """Return the smallest factor on the bounds `moved` at which every window u (N, s + 1, m), y (N, s + 1, p)
    has a behaviour.
    """
    windows = Windows(plant, s)
    start = {name: getattr(windows, name) for name in ("tolerance", "noise", "w_lo", "w_hi")}
    ends = {"disturbance": ("w_lo", "w_hi")}

    def excess(scale, which):
        for name in moved:
            for field in ends.get(name, (name,)):
                setattr(windows, field, scale * start[field])
        return windows.gauge_by_program(u[which], y[which]) - 1

    few = np.argsort(-excess(1.0, slice(None)))[:5]
    while True:
        low, high = 1.0, 1.0
        while excess(high, few).max() > 0:
            high *= 1.5
        while excess(low, few).max() <= 0:
            low /= 1.5
        scale = brentq(lambda x, few=few: excess(x, few).max(), low, high, xtol=1e-13, rtol=1e-12)
        left = excess(scale, slice(None))
        if left.max() <= 1e-8:
            return scale
        few = np.union1d(few, np.argsort(-left)[:5])


def smallest_width(plant, s, u, y, weights, tolerance=False, rounds=12):
    """Return (width, {name: bounds}): the least weighted sum of noise (p,), tolerance (p,) and disturbance
    that explains all windows.

    Weights of a disturbance are (g,), then |w| <= bound, or (g, 2), then -first <= w <= second.

    Unknowns are the bounds, and of each window its state and disturbances. Without tolerance that is a linear
    program. With it, what a row may be off by is noise + tolerance |t|, t the true value: a sequence of
    linear programs, each around the values of the one before.
    """
    windows = Windows(plant, s)
    N, p, g = len(y), plant.p, plant.g
    rows, n = (s + 1) * p, windows.O.shape[1]
    O = windows.O[:rows]
    d = (y - windows.offset_y).reshape(N, rows) - windows.reach(u)[:, :rows]
    feed = windows.reach(u)[:, :rows]
    blown = weights.get("disturbance", np.ones(g))
    ends = (
        np.arange(blown.size).reshape(blown.shape) if blown.ndim == 2 else np.arange(g)[:, None].repeat(2, 1)
    )
    first = 2 * p + blown.size  # columns: noise, tolerance, disturbance, then the unknowns of each window
    cost = np.r_[weights["noise"], weights.get("tolerance", np.ones(p)), blown.ravel(), np.zeros(N * n)]
    output = np.tile(np.arange(p), s + 1)
    limit = (
        [(0, None)] * p
        + [(0, None if tolerance else 0)] * p
        + [(0, None)] * blown.size
        + [(None, None)] * (N * n)
    )
    true, sigma = d + feed, np.zeros(p)
    for _ in range(rounds if tolerance else 1):
        entries, right, at = [], [], 0
        for side in (
            1,
            -1,
        ):  # side (O x - d) <= noise + sigma |t|,  |t| ~ sign(t0) (O x + feed) in the share that sigma0 has
            for k in range(N):
                lean = sigma[output] * np.sign(true[k])
                block = np.arange(at, at + rows)
                unknown = first + k * n + np.arange(n)
                entries.append(
                    (np.repeat(block, n), np.tile(unknown, rows), (O * (side - lean)[:, None]).ravel())
                )
                entries.append((block, output, -np.ones(rows)))
                entries.append((block, p + output, -abs(true[k])))
                right.append(side * d[k] + lean * feed[k] - sigma[output] * abs(true[k]))
                at += rows
        for side in (1, -1):
            for k in range(N):
                for j in range(n - plant.n):
                    entries.append(
                        (
                            [at, at],
                            [first + k * n + plant.n + j, 2 * p + ends[j % g, (1 + side) // 2]],
                            [side, -1.0],
                        )
                    )
                    right.append([0.0])
                    at += 1
        i, j, v = (np.concatenate([np.asarray(e[c]) for e in entries]) for c in range(3))
        v = np.where(abs(v) > 1e-10, v, 0)  # far below what the solver tells from 0
        found = linprog(
            cost,
            coo_array((v, (i, j)), (at, len(cost))).tocsr(),
            np.concatenate(right),
            bounds=limit,
            method="highs-ipm",
        )
        assert found.status == 0, found.message
        states = found.x[first:].reshape(N, n)
        true, sigma = states @ O.T + feed, found.x[p : 2 * p]
    bounds = {"noise": found.x[:p], "tolerance": sigma, "disturbance": found.x[2 * p : first]}
    return float(cost[:first] @ found.x[:first]), bounds
