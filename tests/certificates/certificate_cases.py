"""Six plants and random windows of them, healthy or with a bias: long windows, disturbances, unknown inputs
and gaps among them.
"""

import numpy as np
from oracles import MODELS
from systems import PAPER

import jaxbound as jb

SIX = [
    [0.62, 0.11, 0, 0, -0.05, 0],
    [-0.2, 0.55, 0.1, 0, 0, 0.03],
    [0, 0.3, 0.71, -0.12, 0, 0],
    [0.04, 0, 0.2, 0.48, 0.25, 0],
    [0, 0, -0.1, 0.3, 0.66, 0.08],
    [0.1, 0, 0, 0, 0.2, 0.9],
]
SLOW = [
    [0.951234, 0.031, 0, 0.002],
    [0.02, 0.912345, 0.04, 0],
    [0.006, 0.01, 0.871, 0.0525],
    [0, 0.013, 0.07, 0.934567],
]

PLANTS = {
    "two residuals": (PAPER, 1, 0.0),
    "long": (
        dict(
            A=SLOW,
            B=[[0.5, 0], [0.1, 0.02], [0, 0.3], [0, 0.1]],
            C=[[1, 0, 0, 0], [0, 0, 0.5, 1]],
            noise=[0.4, 0.25],
            resolution=[0.05, 0.05],
            offset={"u": [30, "1/3"], "y": [21.5, 20.25]},
        ),
        15,
        0.0,
    ),
    "disturbance": (PAPER | dict(disturbance=([[0], [1]], 0.05)), 20, 0.0),
    "six states": (
        dict(
            A=SIX,
            B=[[1], [0], [0], [0.5], [0], [0]],
            C=[[1, 0, 0, 0, 0, 0.3], [0, 0, 1, 0, 0, 0], [0, 0, 0, 0.4, 1, 0]],
            tolerance=[0.01, 0, 0.05],
            noise=[0.1, 0.2, 0.05],
        ),
        10,
        0.05,
    ),
    "leak": (
        MODELS["offsets"] | dict(disturbance=([["0.3", 0], [1, "-1/7"]], [[0, "0.04"], [-0.05, 0.01]])),
        4,
        0.05,
    ),
    "unknown inputs": (
        MODELS["offsets"]
        | dict(
            disturbance=([[0], ["0.3"]], 0.02),
            unknown_inputs=([[1, 0], ["1/3", 0]], [[0, 0], [0, 1], [0, 2]]),
        ),
        2,
        0.0,
    ),
}


def plant(name):
    """Return (relations, share of missing samples)."""
    numbers, horizon, gaps = PLANTS[name]
    return jb.parity_relations(jb.LinearSystem(**numbers), horizon), gaps


def floats(a, columns):
    return np.array([[float(x) for x in row] for row in a]).reshape(len(a), columns)


def window(relations, gaps, rng, bias=0.0):
    """Return (u, y) of one window; `bias` times what the bounds of a random sensor allow is added to it from
    a random sample on.
    """
    m, s = relations.model, relations.horizon
    F, D_v = floats(m.F, m.d), floats(m.D_v, m.d)
    A, B, C, D, G = floats(m.A, m.n), floats(m.B, m.m), floats(m.C, m.n), floats(m.D, m.m), floats(m.G, m.g)
    u, x, y = rng.uniform(-1, 1, (s + 1, m.m)), rng.normal(size=m.n), []
    lo, hi = (np.array([float(pair[i]) for pair in m.disturbance]) for i in (0, 1))
    for now in u:
        v = 10 * rng.normal(size=m.d)
        y.append(C @ x + D @ now + D_v @ v)
        x = A @ x + B @ now + F @ v + G @ (lo + (hi - lo) * rng.uniform(size=m.g))
    y, per = np.array(y), lambda v: np.array([float(x) for x in v])
    tolerance, noise = per(m.tolerance), per(m.noise)
    y = y * (1 + tolerance * rng.uniform(-1, 1, y.shape)) + noise * rng.uniform(-1, 1, y.shape)
    i, onset = rng.integers(m.p), rng.integers(s + 1)
    y[onset:, i] += bias * (noise + tolerance * abs(y).max(0))[i] * rng.choice([-1, 1])
    y, u = y + per(m.offset["y"]), u + per(m.offset["u"])
    y[rng.uniform(size=y.shape) < gaps], u[rng.uniform(size=u.shape) < gaps] = np.nan, np.nan
    return u, y
