"""Models of long windows and disturbances, and windows near the boundary of their sets."""

import json

import numpy as np
from oracles import MODELS, Plant, Windows, draw

import jaxbound as jb
from jaxbound.sets.floats.status import Status

SIX = dict(
    A=[
        [0.62, 0.11, 0, 0, -0.05, 0],
        [-0.2, 0.55, 0.1, 0, 0, 0.03],
        [0, 0.3, 0.71, -0.12, 0, 0],
        [0.04, 0, 0.2, 0.48, 0.25, 0],
        [0, 0, -0.1, 0.3, 0.66, 0.08],
        [0.1, 0, 0, 0, 0.2, 0.9],
    ],
    B=[[1], [0], [0], [0.5], [0], [0]],
    C=[[1, 0, 0, 0, 0, 0.3], [0, 0, 1, 0, 0, 0], [0, 0, 0, 0.4, 1, 0]],
    tolerance=[0.01, 0, 0.05],
    noise=[0.1, 0.2, 0.05],
)
GUST = MODELS["paper"] | dict(disturbance=([[0], [1]], 0.05))
LEAK = MODELS["offsets"] | dict(disturbance=([["0.3"], [1]], [[0, "0.2"]]))


def numbers(name, shared):
    """Return the keywords of a model by name."""
    if name == "tclab":
        fitted = json.loads(shared("data/tclab/model.json").read_text())
        return {key: fitted[key] for key in "ABC"} | dict(noise=1.5)
    return {"section 5": MODELS["paper"], "six states": SIX, "gust": GUST, "leak": LEAK}[name]


def prepared(model, horizon, count, rng, dtype=np.float64, **drawn):
    """Return relations, oracle, u, y: windows (count, s + 1, .), a third of them near the boundary by 1e-8 to
    1e-2.
    """
    relations, oracle = (
        jb.parity_relations(jb.LinearSystem(**model), horizon=horizon),
        Windows(Plant(**model), horizon, dtype),
    )
    u, centre, y = draw(oracle.plant, horizon, count, rng, **drawn)
    near = slice(0, count // 3)
    factor = at_boundary(relations, u[near], centre[near], y[near])
    factor *= 1 + rng.choice([-1, 1], len(factor)) * 10 ** rng.uniform(-8, -2, len(factor))
    y[near] = moved(centre[near], y[near], factor)
    return relations, oracle, u.astype(dtype), y.astype(dtype)


def moved(centre, y, factor):
    return centre + factor[:, None, None] * (y - centre)


def at_boundary(relations, u, centre, y, steps=12):
    """Return the factors (N,) at which centre + factor (y - centre) comes to the boundary (about; 1 where it
    never does).
    """
    factor = np.ones(len(y))
    for _ in range(steps):
        res = jb.detect(relations, u, moved(centre, y, factor), margins="exact")
        gauge = 1 - last(res.margin)
        factor = np.where(
            np.isfinite(gauge) & (gauge > 1e-6) & (gauge != 1), factor / np.maximum(gauge, 1e-6), factor
        )
    return np.where(np.isfinite(factor) & (factor < 1e6), factor, 1)


def last(x):
    """Return the entry of the only whole window of each recording."""
    return x[:, -1]


def agree(status, slack, sure=1e-9):
    """Compare with the program's answer wherever its margin exceeds `sure`; return the share of those that
    are FAULT.
    """
    clear = abs(slack) > sure
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(status[clear], np.where(slack > 0, Status.FAULT, Status.CONSISTENT)[clear])
    assert np.mean(status == Status.UNDECIDED) < 1e-4 + (abs(slack) < sure).mean()
    return float((status == Status.FAULT).mean())
