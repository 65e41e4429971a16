"""The factor on bounds outside of training is what recordings that are left out ask for there."""

from types import SimpleNamespace

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.studies.identification.bank import test_as_fitted as as_fitted
from jaxbound.studies.identification.extrapolation import FEW_DAYS_OUTSIDE, extrapolation
from jaxbound.studies.identification.training import Training
from jaxbound.studies.identification.trial import few_days

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
    few = few_days(3, FEW_DAYS_OUTSIDE)
    assert bent.extrapolation > 1.1 * few > straight.extrapolation >= few
    assert bent.provenance["extrapolation"].startswith("fitted: needs of ")
    assert "outside the ranges of the others" in bent.provenance["extrapolation"]


def test_recordings_that_reach_nowhere_alone_tell_nothing_and_few_of_them_ask_for_more(rng):
    two = days(rng, 0.0, (0.0, 0.0))
    for u, _ in two:
        u[[50, 90]] = [[-1], [1]]
    fitted = jb.fit(two, **RECIPE)
    assert 1.5 <= fitted.extrapolation < 1.51
    assert fitted.provenance["extrapolation"].startswith("assumed: times 1.5 for so few recordings")
    alone = jb.fit([two[0]], **RECIPE)
    assert alone.extrapolation == FEW_DAYS_OUTSIDE, "what its blocks say is not of another day"
    assert jb.fit([two[0]], held_out=0, **RECIPE).extrapolation is None, "nothing asks for wider bounds"


def test_the_factor_is_the_need_outside_over_that_inside(rng):
    """Of a recording that is left out, by its own windows; needs below 1 are held by any bounds."""
    u = np.zeros((6, 1))
    u[4] = 3.0
    model = {"A": [[0.5]], "B": [[1]], "C": [[1]], "horizon": 1, "inputs": ("u1",)}
    needs = np.array([np.nan, 1.5, 0.2, 1.0, 1.0, 12.0]), np.array([np.nan, 2.0, 1.0, 1.0, 1.0, 0.5])
    left = [SimpleNamespace(model=model, need=need) for need in needs]
    trial = SimpleNamespace(left=left, bound=np.ones(1))
    records = [(u, u, np.zeros(0, int)), (-u, u, np.zeros(0, int))]
    found = extrapolation(trial, Training(None, ("u1",), ("y1",), 1.0, records, {}))
    # the cube root of 12 over 1.5, and 1 over 2
    assert found.factor == pytest.approx(FEW_DAYS_OUTSIDE * 2**0.5)
    assert (found.windows, found.recordings) == (2, 2)
    for one in left:
        one.need = np.minimum(one.need, 1.0)  # nothing outside asks for more
    found = extrapolation(trial, Training(None, ("u1",), ("y1",), 1.0, records, {}))
    assert found.factor == FEW_DAYS_OUTSIDE


def test_a_test_without_a_factor_does_not_take_that_of_the_model(rng):
    base = jb.fit(days(rng, 1.0), **RECIPE)
    other = jb.fit(days(rng, 1.0)[:1], held_out=0, **RECIPE)
    assert base.extrapolation > 1
    own = as_fitted(base, other.replace(left_out=base.left_out, ranges=base.ranges), "other")
    model = jb.monitor(base.replace(tests=[own])).watches[0].relations.model
    assert model.extrapolation == 1
