"""The models and the independent simulation that the tests of studies share."""

from fractions import Fraction

import numpy as np
from oracles import MODELS, Plant, times

import jaxbound as jb

SIMPLE = dict(A=[[0.8]], B=[[1]], C=[[1]], noise=0.1, tolerance=0.005)
EXACT = dict(A=[[0.8]], B=[[1]], C=[[1]], noise=0.1)
GUST = dict(
    A=[[0.8, 1], [0, 0.2]],
    B=[[0], [1]],
    C=[[1, 0], [1, 1]],
    noise=[0.1, 0.01],
    disturbance=([[0], [1]], 0.05),
)


def simple(**changes):
    """Return a model whose kernels compile quickly."""
    return jb.LinearSystem(**(SIMPLE | changes))


def noises(name, s, x, u, y, theta, w):
    """Return the noises (s + 1, p), exact, that a window of floats needs: it starts in x and has these u, y,
    theta and w.

    The exact model runs on from x with fractions; what is left of y beyond (1 + theta) t is the noise.
    """
    plant, exact = (
        Plant(**MODELS.get(name, GUST)),
        lambda a: [[Fraction(float(v)) for v in row] for row in np.atleast_2d(a)],
    )
    inputs = (
        [[v - plant.offset_u[i] for i, v in enumerate(row)] for row in exact(u)]
        if plant.m
        else [[]] * (s + 1)
    )
    state, out = exact(x)[0], []
    column = lambda v: [[e] for e in v]
    for k in range(s + 1):
        feed = times(plant.D, column(inputs[k])) if plant.m else [[Fraction(0)]] * plant.p
        t = [a[0] + b[0] for a, b in zip(times(plant.C, column(state)), feed, strict=True)]
        measured, relative = exact(y[k])[0], exact(theta[k])[0]
        out.append([measured[i] - plant.offset_y[i] - (1 + relative[i]) * t[i] for i in range(plant.p)])
        state = [row[0] for row in times(plant.A, column(state))]
        for matrix, given in ((plant.B, inputs[k]), (plant.G, exact(w[k])[0] if plant.g else [])):
            if given:
                state = [a + b[0] for a, b in zip(state, times(matrix, column(given)), strict=True)]
    return out, plant


def simulated(rng, runs, samples, hold, fault):
    """Simulate section 5 of Adrot 2000 in plain NumPy: fault(k, y, rng) changes the outputs (runs, 2) of
    sample k.
    """
    A, B, C = np.array([[0.8, 1], [0, 0.2]]), np.array([0, 1.0]), np.array([[1.0, 0], [1, 1]])
    u = np.repeat(rng.uniform(-1, 1, (runs, -(-samples // hold))), hold, 1)[:, :samples]
    x, y = np.zeros((runs, 2)), np.empty((runs, samples, 2))
    for k in range(samples):
        t = x @ C.T
        y[:, k] = fault(
            k,
            t * (1 + rng.uniform(-1, 1, t.shape) * [0.02, 0.1]) + rng.uniform(-1, 1, t.shape) * [0.1, 0.01],
            rng,
        )
        x = x @ A.T + u[:, k, None] * B
    return u[..., None], y
