"""The factor on bounds outside of training is what recordings that are left out ask for there."""

from types import SimpleNamespace

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.studies.identification.bank import test_as_fitted as as_fitted
from jaxbound.studies.identification.extrapolation import extrapolation
from jaxbound.studies.identification.training import Training

RECIPE = {"order": 1, "horizon": 4, "method": "least squares"}


def days(rng, square, levels=(0.0, 0.5, 1.0)):
    """Return a recording at each level of the input, of a plant that answers to its square, too."""
    recordings = []
    for level in levels:
        u, x, y = level + rng.uniform(-1, 1, (120, 1)), 0.0, np.zeros((120, 1))
        for k in range(120):
            y[k] = x
            x = 0.8 * x + 0.5 * u[k, 0] + square * max(u[k, 0] - 1, 0)
        recordings.append((u, y + rng.uniform(-0.05, 0.05, y.shape)))
    return recordings


def test_a_plant_that_is_another_one_there_asks_for_wider_bounds_and_a_linear_one_does_not(rng):
    bent, straight = (jb.fit(days(rng, square), **RECIPE) for square in (1.0, 0.0))
    assert bent.extrapolation > 1.2 > 1.1 > (straight.extrapolation or 1)
    assert bent.provenance["extrapolation"].startswith("fitted: needs of ")
    assert "outside the ranges of the others" in bent.provenance["extrapolation"]


def test_the_factor_is_the_need_outside_over_that_inside(rng):
    """Of a recording that is left out, by its own windows; needs below 1 are held by any bounds."""
    u = np.zeros((6, 1))
    u[4] = 3.0
    model = {"A": [[0.5]], "B": [[1]], "C": [[1]], "horizon": 1, "inputs": ("u1",)}
    needs = np.array([np.nan, 1.5, 0.2, 1.0, 1.0, 6.0]), np.array([np.nan, 2.0, 1.0, 1.0, 1.0, 0.5])
    left = [SimpleNamespace(model=model, need=need) for need in needs]
    trial = SimpleNamespace(left=left, bound=np.ones(1))
    records = [(u, u, np.zeros(0, int)), (-u, u, np.zeros(0, int))]
    found = extrapolation(trial, Training(None, ("u1",), ("y1",), 1.0, records, {}))
    # 6 over 1.5, and 1 over 2
    assert found.factor == pytest.approx(2**0.5) and (found.windows, found.recordings) == (2, 2)
    for one in left:
        one.need = np.minimum(one.need, 1.0)  # nothing outside asks for more
    assert extrapolation(trial, Training(None, ("u1",), ("y1",), 1.0, records, {})) is None


def test_a_test_without_a_factor_does_not_take_that_of_the_model(rng):
    base = jb.fit(days(rng, 1.0), **RECIPE)
    other = jb.fit(days(rng, 1.0)[:1], **RECIPE)
    assert base.extrapolation > 1 and other.extrapolation is None
    own = as_fitted(base, other.replace(left_out=base.left_out, ranges=base.ranges), "other")
    model = jb.monitor(base.replace(tests=[own])).watches[0].relations.model
    assert model.extrapolation == 1
