"""Disturbances of a model: how they are given, where they act in a window, and that a simulation draws them
within their bounds.
"""

from fractions import Fraction

import jax
import numpy as np
import pytest
from oracles import MODELS, Plant
from systems import paper

import jaxbound as jb
from jaxbound.models import window

PAIR = dict(disturbance=([[0.3, 0], [1, "-1/7"]], [[0, "0.2"], 0.05]))


@pytest.mark.parametrize("name", ["paper", "offsets", "feedthrough", "no input"])
@pytest.mark.parametrize("s", [1, 2, 4])
def test_rows_and_unknowns_of_a_window_are_the_responses_to_each_of_them(name, s):
    spec = MODELS[name] | PAIR
    E, K = window.unknowns(jb.LinearSystem(**spec), s)
    expected = Plant(**spec).equation(s)
    assert ([list(row) for row in E], [list(row) for row in K]) == expected


@pytest.mark.parametrize(
    "bound, pairs",
    [
        (0.1, [("-1/10", "1/10")] * 2),
        ([0.1, "1/3"], [("-1/10", "1/10"), ("-1/3", "1/3")]),
        ([[0, 1], [-2, "0.5"]], [(0, 1), (-2, "1/2")]),
        ([[1, 1], 0], [(1, 1), (0, 0)]),
    ],
)
def test_bounds_are_kept_exactly(bound, pairs):
    model = paper(disturbance=([[1, 0], [0, 1]], bound))
    assert model.g == 2 and model.disturbance == tuple((Fraction(a), Fraction(b)) for a, b in pairs)


@pytest.mark.parametrize("at", ["uniform", "vertices"])
@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.long)])
def test_a_simulation_is_the_exact_trajectory_of_the_disturbances_that_it_drew(at, dtype, rng):
    spec = MODELS["paper"] | PAIR
    plant, u = Plant(**spec), rng.uniform(-1, 1, (25, 1)).astype(dtype)
    t = jb.simulate(jb.LinearSystem(**spec), u, jax.random.key(int(rng.integers(2**31))), at=at)
    exactly = lambda a: [[Fraction(float(v)) for v in row] for row in np.asarray(a)]
    w, theta, noise = exactly(t.disturbance), exactly(t.theta), exactly(t.noise)
    for row in w:
        assert all(lo <= v <= hi for v, (lo, hi) in zip(row, plant.disturbance, strict=True))
    if at == "vertices":
        assert {float(v) for v, *_ in w} == {0.0, float(max(v for v, *_ in w))}
    true, y = plant.trajectory([Fraction(0)] * 2, exactly(u), w), np.asarray(t.y)
    for k in range(25):
        for i in range(2):
            value = (1 + theta[k][i]) * true[k][i] + noise[k][i]
            assert abs(Fraction(float(y[k, i])) - value) <= 2 * float(np.finfo(dtype).eps) * (
                abs(y[:, i]).max() + plant.noise[i]
            )
