"""Easy windows of sensors with tolerances, whose radii differ; and recordings in which no window is easy."""

import dataclasses

import jax
import numpy as np
import pytest
from oracles import MODELS

import jaxbound as jb
from jaxbound.consistency import drive, projection
from jaxbound.sets.strips.weighted import factored, solved

PAPER, S, T = MODELS["paper"], 12, 400
GUST = PAPER | dict(disturbance=([[0], [1]], 0.05))


def test_weighted_least_squares_are_those_of_numpy(rng):
    A, weights = rng.normal(size=(9, 4)), 10 ** rng.uniform(-6, 0, (9, 5))
    b = rng.normal(size=(4, 5))
    found = np.asarray(jax.jit(lambda A, w, b: solved(factored(A, w), b))(A, weights, b))
    for x, w, right in zip(found.T, weights.T, b.T, strict=True):
        np.testing.assert_allclose(x, np.linalg.solve((A.T * w) @ A, right), rtol=1e-7)


@pytest.mark.parametrize(
    "spec", [pytest.param(PAPER, id="paper"), pytest.param(GUST, id="gust", marks=pytest.mark.long)]
)
def test_windows_of_their_own_weights_are_easy(spec, rng):
    relations = jb.parity_relations(jb.LinearSystem(**spec), S)
    u = 20 * rng.normal(size=(T, 1))
    y = np.array(jb.simulate(relations.model, u, jax.random.key(1), at="uniform").y)
    stretches = relations.test("joint", y.dtype).easy.stretches
    assert stretches.projection.weighted

    def settled(weighted):
        own = dataclasses.replace(stretches.projection, weighted=weighted)
        given = projection.Given(stretches.reading, own)
        return np.asarray(projection._of_stretch(given, u, y)) > 0

    own, fixed = settled(True), settled(False)
    assert own.mean() > 0.9 and fixed.mean() < own.mean() - 0.2
    status = jb.detect(relations, u, y, margins="exact").status[S:]
    assert (status[own | fixed] == jb.Status.CONSISTENT).all()


def test_sensors_without_tolerances_have_one_matrix():
    relations = jb.parity_relations(jb.LinearSystem(**PAPER | dict(tolerance=0)), S)
    assert not relations.test("joint", np.float64).easy.stretches.projection.weighted


@pytest.mark.usefixtures("as_compiled")
@pytest.mark.usefixtures("many")
def test_where_no_window_is_easy_few_are_asked(monkeypatch, rng):
    asked, judge_all = [], drive._Gathering.judge_all

    def counted(work, starts):
        if isinstance(work.test, projection.EasyWindows):
            asked.append(len(starts))
        return judge_all(work, starts)

    monkeypatch.setattr(drive._Gathering, "judge_all", counted)
    monkeypatch.setattr(drive, "TOGETHER", 128)
    monkeypatch.setattr(drive, "ASKED", 16)
    relations = jb.parity_relations(jb.LinearSystem(**PAPER), S)
    still = np.zeros((T, 1))
    easy = rng.uniform(-1, 1, (T, 2)) * PAPER["noise"] * [3, 3]  # faults, most of them plain
    easy = jb.detect(relations, still, easy)
    assert sum(asked) > T / 2 and easy.counts["FAULT"] > T / 2
    asked.clear()
    lost = rng.uniform(-1, 1, (T, 2)) * PAPER["noise"]
    lost[::S] = np.nan  # windows that lack samples are none of theirs
    hard = jb.detect(relations, still, lost)
    assert asked == [16, 16, 16, 4]
    np.testing.assert_array_equal(hard.status, jb.detect(relations, still, lost, margins="exact").status)
