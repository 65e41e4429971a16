"""Lags that are suggested see what they are said to see."""

import math

import pytest

import jaxbound as jb
from jaxbound.diagnosis.memory import slowest

PLANT = dict(A=[["0.95", "0.02"], [0, "0.9"]], B=[[1], ["0.5"]], C=[[1, 0], [0, 1]], noise=[0.5, 0.25])


@pytest.mark.parametrize("more", [{}, dict(disturbance=([[1], [0]], 0.01))])
def test_sizes_are_those_that_are_proved(more):
    model = jb.LinearSystem(**PLANT, **more)
    found = jb.suggest_lags(model, count=5, longest=12)
    assert found == (0, 1, 2, 5, 12) and found[-1] == max(lags[-1] for lags in found.sizes)
    for name in ("y1", "u1"):
        assert math.isclose(found.sizes[found][name], jb.detectable(model, name, lags=found), rel_tol=1e-6)
    assert (
        found.text().splitlines()[1].startswith("*") and jb.parity_relations(model, lags=found).lags == found
    )


def test_the_span_is_what_the_plant_remembers_and_no_longer_than_needed():
    model = jb.LinearSystem([["0.98"]], [[1]], [[1]], noise=0.1)
    assert (
        49 < slowest(model) < 50
        and jb.suggest_lags(model)[-1] == 50
        and slowest(jb.LinearSystem([[1]], [[1]], [[1]])) == math.inf
    )
    loose = jb.LinearSystem(
        [["0.98"]], [[1]], [[1], [1]], noise=0.1, disturbance=([[1]], 10)
    )  # y1 - y2 sees all that can be seen, at once
    found = jb.suggest_lags(loose, count=4)
    assert found[-1] < 20 < max(lags[-1] for lags in found.sizes) and found.sizes[found][
        "y1"
    ] == pytest.approx(0.4, rel=1e-4)


def test_what_cannot_be_suggested_is_refused():
    with pytest.raises(ValueError, match="count must be"):
        jb.suggest_lags(jb.LinearSystem(**PLANT), count=1)
    with pytest.raises(ValueError, match="operating_range"):
        jb.suggest_lags(jb.LinearSystem(**PLANT, tolerance=0.01))
    with pytest.raises(ValueError, match="no window"):
        jb.suggest_lags(jb.LinearSystem([[1]], None, [[1]], noise=0.1, disturbance=([[1]], 1)))
    with pytest.raises(NotImplementedError, match="uncertainties"):
        jb.suggest_lags(jb.LinearSystem(**PLANT, uncertainties=[jb.Uncertainty("a", A=[[0.1, 0], [0, 0]])]))
