"""Other detectors do what textbooks say."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from sklearn.decomposition import PCA
from sklearn.ensemble import IsolationForest

from jaxbound.recordings.recording import Recording
from jaxbound.studies.assessment.peers import Cusum, Forest, OneStep, Principal, Samples, Threshold

NOWHERE = np.zeros(0, int)


def recorded(u, y, starts=NOWHERE):
    return Recording(u, y, np.asarray(starts, int), (), ())


@pytest.fixture
def arx(rng):
    """Return Samples of y[k] = .8 y[k-1] + .3 u[k-1] + 2, exactly."""
    u, y = rng.uniform(-1, 1, (200, 1)), np.zeros((200, 1))
    for k in range(1, 200):
        y[k] = 0.8 * y[k - 1] + 0.3 * u[k - 1] + 2
    return Samples(u, y, NOWHERE)


def test_one_step_errors_of_an_exact_model_are_the_disturbance(arx):
    errors = OneStep([arx], 1, direct=False)
    y = arx.y.copy()
    y[50] += 1.0
    found = errors.errors(arx.u, y)[:, 0]
    assert np.isnan(found[0])
    assert found[50] == pytest.approx(1.0, abs=1e-9)
    assert found[51] == pytest.approx(-0.8, abs=1e-9)
    assert abs(np.delete(found, [0, 50, 51])).max() < 1e-9


def test_errors_across_a_gap_are_no_errors(arx):
    errors = OneStep([arx], 1, direct=False)
    relative = errors.relative(arx._replace(starts=np.array([30])))
    assert np.flatnonzero(np.isnan(relative[:, 0])).tolist() == [0, 30]


def test_a_cusum_adds_what_exceeds_its_slack_and_begins_anew_behind_a_gap():
    relative = np.array([[1.5], [1.5], [np.nan], [1.5], [-9.0], [0.4]])
    stub = SimpleNamespace(order=1, relative=lambda samples: relative)
    needs = Cusum(stub).flags(recorded(np.zeros((6, 0)), np.zeros((6, 1)))).needs
    assert needs[:2].tolist() == [1 / 5, 2 / 5]
    assert np.isnan(needs[2])
    assert needs[3:].tolist() == [1 / 5, 8.5 / 5, 7.6 / 5]


def test_a_threshold_counts_in_standard_deviations():
    stub = SimpleNamespace(order=1, relative=lambda samples: np.array([[np.nan, np.nan], [1.5, -6.0]]))
    needs = Threshold(stub).flags(recorded(np.zeros((2, 0)), np.zeros((2, 2)))).needs
    assert needs[1] == 2 and np.isnan(needs[0])


def test_principal_components_are_those_of_scikit_learn(rng):
    mixed = rng.normal(size=(400, 2)) @ rng.normal(size=(2, 4)) + 0.05 * rng.normal(size=(400, 4))
    samples = Samples(np.zeros((400, 0)), mixed, NOWHERE)
    own = Principal([samples], 0)
    x = (mixed - mixed.mean(0)) / mixed.std(0)
    theirs = PCA().fit(x)
    kept = int(np.searchsorted(np.cumsum(theirs.explained_variance_ratio_), 0.9)) + 1
    inside = theirs.transform(x)[:, :kept]
    t2 = (inside**2 / theirs.explained_variance_[:kept]).sum(1)
    q = (x**2).sum(1) - (inside**2).sum(1)
    needs = own.needs(samples)
    expected = np.maximum(t2 / own._most_t2, q / own._most_q)
    np.testing.assert_allclose(needs, expected, rtol=1e-9)
    assert 0.002 < np.mean(t2 > own._most_t2) < 0.03
    assert 0.002 < np.mean(q > own._most_q) < 0.03


def test_a_forest_alarms_where_scikit_learn_does(rng):
    y = rng.normal(size=(120, 2))
    y[60:] += rng.choice([0, 4], (60, 1))
    samples = Samples(np.zeros((120, 0)), y, NOWHERE)
    training = samples._replace(u=samples.u[:60], y=y[:60])
    own = Forest([training], 1, 0.1, seed=3)
    rows = samples.windows(1)
    theirs = IsolationForest(contamination=0.1, random_state=3).fit(rows[:59]).predict(rows) < 0
    assert (own.needs(samples)[1:] > 1).tolist() == theirs.tolist()
    assert theirs.any() and not theirs.all()


def test_a_forest_without_scikit_learn_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.ensemble", None)
    with pytest.raises(ValueError, match="needs scikit-learn: pip install"):
        Forest([], 1)
