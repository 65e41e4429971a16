"""Simulated truth as the witness of healthy windows: counts are those of a search, with hardly any search."""

import numpy as np
import pytest
from oracles import MODELS

import jaxbound as jb
from jaxbound.studies.montecarlo import records

PAPER = MODELS["paper"]
MODEL = {
    "tolerances": PAPER,
    "disturbed": PAPER | dict(disturbance=([[0], [1]], [(-0.02, 0.05)]), offset={"u": [2], "y": [10, -3]}),
}
S, T = 9, 40


@pytest.mark.parametrize("at", [pytest.param("uniform", marks=pytest.mark.long), "vertices"])
@pytest.mark.parametrize("name", ["tolerances", pytest.param("disturbed", marks=pytest.mark.long)])
def test_counts_are_those_without_a_witness(name, at, monkeypatch):
    model = jb.LinearSystem(**MODEL[name])
    relations = jb.parity_relations(model, S)
    searched, detect = [], records.detect

    def counted(relations, u, y, *args, **settings):
        searched.append(y.shape[0] * (y.shape[1] - S))
        return detect(relations, u, y, *args, **settings)

    monkeypatch.setattr(records, "detect", counted)

    def studied(faults):
        searched.clear()
        res = jb.study(model, faults, 60, 5, relations, samples=T, at=at)
        return [{key: x.tolist() for key, x in t.arrays().items()} for t in res.tallies], sum(searched)

    fault = jb.Fault("y1", "bias", 0.5, 25)
    with_truth = [studied(faults) for faults in ((), fault)]
    monkeypatch.setattr(records, "explained_by", lambda *_: None)
    without = [studied(faults) for faults in ((), fault)]
    assert [found for found, _ in with_truth] == [found for found, _ in without]
    if at == "uniform":
        assert with_truth[0][1] < 0.05 * without[0][1]


def test_a_truth_that_explains_nothing_proves_nothing(rng):
    model = jb.LinearSystem(**PAPER)
    test = jb.parity_relations(model, S).test("joint", np.float64)
    u, y = np.zeros((2, T, 1)), np.zeros((2, T, 2))
    assert records.explained_by(test, u, y, y)[:, S:].all()
    for wrong in (y + 1, np.full_like(y, np.nan), np.full_like(y, np.inf)):
        assert not records.explained_by(test, u, y, wrong).any()
    short = jb.parity_relations(model, 1).test("joint", np.float64)
    assert records.explained_by(short, u, y, y) is None
